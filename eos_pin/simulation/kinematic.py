"""Robots moved along a task path without dynamics: by commands of positions, by joint rates, or through charts."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, Vector, checked, number
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.charts.dynamics import couplings
from eos_pin.control.kinematic import KinematicLoop
from eos_pin.control.objectives import Further, Objective
from eos_pin.errors import EosError, InputError, SingularError
from eos_pin.robot.postures import JointsLike
from eos_pin.simulation._recorder import Observer, check_run, joint_run, sample_times
from eos_pin.simulation._shortcomings import with_shortcomings
from eos_pin.simulation.continuous import MOST_PERIODS
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

#: Samples kept per second, besides the exact multiples of the path's period.
RATE = 50.0
#: Part of a control period within which two times are the same.
SAME = 1e-6


@checked
def simulate_kinematic(
    loop: KinematicLoop,
    q: JointsLike,
    *,
    duration: float,
    record_rate: float = 100.0,
    observer: Observer | None = None,
) -> Result:
    """Run a `KinematicLoop` on an ideal joint servo, which moves to each command at constant velocity in one period.

    The run begins at rest; a loop that ran before is reset. Samples are multiples of the control period, besides the
    exact multiples of the path's period. Kinetic energy is that of the motion where the inertias are known; torques are
    NaN, as they are unknown.

    Args:
        loop: The loop.
        q: Joints at the start, (n,), or some of them by name; others are as near 0 as their limits allow.
        duration: Length of the run [s].
        record_rate: Samples kept per second, at most one a control period.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments.
        SingularError: The task is singular at the start.
        PlanError: The joints are too far from those to follow at the start.
    """
    robot, task, h, path = loop.robot, loop.task, loop.control_period, loop.reference
    joints, rest = robot.posture(q, "q at the start"), np.zeros(robot.n)
    count = number(duration, "the duration", above=0.0) / h
    if count > MOST_PERIODS:
        raise InputError(
            f"{duration:g} s with a control period of {h:g} s are more than {MOST_PERIODS:,} steps; make the run "
            "shorter or the period longer"
        )
    stride = max(1, round(1.0 / (number(record_rate, "the sample rate", above=0.0) * h)))
    times = sample_times(duration, 1.0 / (stride * h), path.period)
    check_run(robot.n, len(times), float(times[-1]), path)
    loop.reset()
    rows: list[tuple[float, JointVector, JointVector, JointVector]] = []
    lost, charts, further, status, message, at = [], list[Chart](), list[Further | None](), "finished", "", 0
    clock, wall = time.process_time(), time.perf_counter()
    dq = rest
    try:
        for k in range(math.ceil(count - 1e-9)):
            command = loop.step(k * h, joints)
            change = (command.dq - dq) / h
            deficit, chart = loop.task_deficit, loop.chart
            assert deficit is not None
            assert chart is not None
            # A sample at the end of a period is that period's; the first one is at rest.
            while at < len(times) and times[at] <= (k + 1 + SAME) * h:
                now = float(times[at])
                there = joints + min(max(now - k * h, 0.0), h) * command.dq
                rows.append((now, there, command.dq if now > k * h else dq, change))
                lost.append((deficit, deficit if loop.limited else 0.0 * deficit))
                charts.append(chart)
                further.append(loop.self_motion._further(now, there, loop.limit_change))
                at += 1
                if observer is not None:
                    observer(now, there)
            joints, dq = command.q, command.dq
    except (EosError, KeyboardInterrupt) as ending:
        if not rows:
            raise
        status = "interrupted" if isinstance(ending, KeyboardInterrupt) else "failed"
        message = f"the run ended at t = {rows[-1][0]:.4g} s" + (f": {ending}" if status == "failed" else "")
    t, Q, dQ, ddQ = map(np.array, zip(*rows, strict=True))
    deficits = np.array(lost)
    arguments = {"kind": "kinematic", "control_period": h, "acceleration": loop.limits.acceleration.tolist()}
    controller = {
        "kind": "KinematicLoop",
        "self_motion": type(loop.self_motion).__name__,
        **loop.atlas.describe(),
    }
    run = joint_run(
        task, t, Q, np.array([path(s).z for s in t]), dq=dQ, period=path.period, status=status, message=message,
        ddq=ddQ, task_deficit=deficits[:, 0], deficit_from_limits=deficits[:, 1],
        **_self_motion(loop.self_motion, t, Q, dQ, charts), info={
            "controller": controller | {"kp": loop.kp.tolist(), "kd": loop.kd.tolist()}, "arguments": arguments,
            "coupling": couplings(robot, list(zip(charts, Q, strict=True))),
            "cpu_seconds": time.process_time() - clock, "wall_seconds": time.perf_counter() - wall,
        },
    )  # fmt: skip
    return with_shortcomings(run, task, "", loop.self_motion.joint_distances(run.t, run.q, robot), further)


def _self_motion(
    law: Objective, t: Vector, q: Float[Array, "T n"], dq: Float[Array, "T n"], charts: Sequence[Chart]
) -> dict[str, Array]:
    """Number of the chart and self-motion of each sample, and the target of its law."""
    numbers: dict[Chart, int] = {}
    v, dv, v_ref = np.full((3, len(t), charts[0].r), np.nan)
    for k, chart in enumerate(charts):
        numbers.setdefault(chart, len(numbers))
        v[k], dv[k] = chart._v(q[k]), chart._dv(dq[k])
        target = law._target_on(float(t[k]), chart)
        if target is not None:
            v_ref[k] = target.z
    return {"chart": np.array([numbers[chart] for chart in charts]), "v": v, "dv": dv, "v_ref": v_ref}


def rate_control(task: Task, path: Trajectory, q: JointsLike, *, duration: float, rtol: float = 1e-9) -> Result:
    """Joints under dq = G'†(q) dz_d, the generalized-inverse velocity control of Eqs. (3), (4).

    Args:
        task: The task.
        path: Its trajectory; without feedback, the run is on it if it begins on it.
        q: Joints at the start, (n,).
        duration: Length of the run [s].
        rtol: Relative and absolute tolerance of the integrator.

    Raises:
        SingularError: The task is singular on the way.
    """
    from scipy.integrate import solve_ivp

    def velocity(t: float, q: JointVector) -> JointVector:
        _, J = task._linearize(q)
        try:
            return np.linalg.pinv(J) @ path(t).dz
        except np.linalg.LinAlgError:
            raise SingularError(f"the task is singular at t = {t:.4g} s; try a smaller path") from None

    task.check_still("rate_control")
    number(rtol, "rtol", above=0.0)
    q = task.robot.posture(q, "q at the start")
    t = sample_times(duration, RATE, path.period)
    check_run(task.robot.n, len(t), float(t[-1]), path)
    found = solve_ivp(velocity, (0.0, t[-1]), q, method="DOP853", t_eval=t, rtol=rtol, atol=rtol)
    t = t[: found.y.shape[1]]
    message = "" if found.success else f"the integrator gave up: {found.message}"
    return joint_run(task, t, found.y.T, np.array([path(s).z for s in t]), period=path.period, message=message)


def chart_following(task: Task, path: Trajectory, q: JointsLike, *, duration: float, tol: float = 1e-12) -> Result:
    """Joints y(z_d(t), v) with v held where it is at q: inverse kinematics through charts, Sec. 3.

    Args:
        task: The task.
        path: Its trajectory.
        q: Joints at the start, (n,).
        duration: Length of the run [s].
        tol: Largest task error at each sample [m, rad].
    """
    task.check_still("chart_following")
    t = sample_times(duration, RATE, path.period)
    check_run(task.robot.n, len(t), float(t[-1]), path)
    found = Atlas(task).follow(q, [path(s).z for s in t], tol=tol)
    t = t[: len(found.q)]
    return joint_run(task, t, found.q, found.z, v=found.v, chart=found.chart, period=path.period, message=found.message)
