"""Robots moved without dynamics: by joint rates, or through charts; and a joint motion as a `Result`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin.arrays import Array, JointVector, VectorLike, number, vector
from eos_pin.atlas import Atlas
from eos_pin.dynamics import pseudoinverse
from eos_pin.errors import SingularError
from eos_pin.recording import sample_times
from eos_pin.results import Result, provenance
from eos_pin.tasks import Task
from eos_pin.trajectories import Trajectory


def rate_control(
    task: Task,
    reference: Trajectory,
    q: VectorLike,
    *,
    duration: float,
    rtol: float = 1e-9,
    rate: float = 50.0,
) -> Result:
    """Joints under dq = G'†(q) dz_d, the generalized-inverse velocity control of Eqs. (3), (4).

    Args:
        task: The task.
        reference: Its trajectory; the run begins on it if it passes through the task point at q.
        q: Joints at the start, (n,).
        duration: Length of the run [s].
        rtol: Relative and absolute tolerance of the integrator.
        rate: Samples kept per second, besides the exact multiples of the reference's period.
    """
    from scipy.integrate import solve_ivp

    def velocity(t: float, q: JointVector) -> JointVector:
        _, J = task.linearize(q)
        try:
            return pseudoinverse(J) @ reference(t).dz
        except np.linalg.LinAlgError:
            raise SingularError(f"the task is singular at t = {t:.4g} s", 0, ()) from None

    number(rtol, "rtol", above=0.0)
    q = vector(q, task.robot.n, "q at the start")
    t = sample_times(duration, rate, reference.period)
    status, message = "finished", ""
    found = solve_ivp(velocity, (0.0, t[-1]), q, method="DOP853", t_eval=t, rtol=rtol, atol=rtol)
    if not found.success:
        status, message = "integration_failed", f"the integrator gave up: {found.message}"
    t, joints = t[: found.y.shape[1]], found.y.T
    dq = np.array([velocity(*row) for row in zip(t, joints, strict=True)])
    return motion_result(task, reference, t, joints, dq=dq, kind="RateControl", status=status, message=message)


def chart_following(
    task: Task,
    reference: Trajectory,
    q: VectorLike,
    *,
    duration: float,
    tol: float = 1e-12,
    rate: float = 50.0,
) -> Result:
    """Joints y(z_d(t), v) with v held where it is at q: inverse kinematics through charts, Sec. 3.

    Args:
        task: The task.
        reference: Its trajectory.
        q: Joints at the start, (n,).
        duration: Length of the run [s].
        tol: Largest task error at each sample [m, rad].
        rate: Samples kept per second, besides the exact multiples of the reference's period.
    """
    t = sample_times(duration, rate, reference.period)
    found = Atlas(task).follow(q, [reference(s).z for s in t], tol=tol)
    switches = t[1:][: len(found.q)][np.diff(found.chart) > 0] if len(found.q) else np.zeros(0)
    return motion_result(
        task,
        reference,
        t[: len(found.q)],
        found.q,
        v=found.v,
        chart=found.chart,
        switches=switches,
        kind="ChartFollowing",
        status="finished" if found.complete else "unreached",
        message=found.message,
    )


def motion_result(
    task: Task,
    reference: Trajectory,
    t: Float[Array, " T"],
    q: Float[Array, "T n"],
    *,
    dq: Float[Array, "T n"] | None = None,
    v: Float[Array, "T r"] | None = None,
    chart: Array | None = None,
    switches: Array | None = None,
    kind: str = "Kinematics",
    status: str = "finished",
    message: str = "",
) -> Result:
    """A joint motion in the form that figures, replays and files take; accelerations and torques are zero.

    Args:
        task: What the motion should do.
        reference: Where the task should be.
        t: Times [s].
        q: Joints at these times.
        dq: Joint velocities; by default differences of q.
        v: Self-motion coordinates, if it has any; they count as asked for.
        chart: Number of the chart of each sample.
        switches: Times at which a chart was left [s].
        kind: What moved it, for the provenance.
        status: How it ended.
        message: The same in a sentence.
    """
    robot, rows = task.robot, len(t)
    if dq is None:
        dq = np.gradient(q, t, axis=0) if rows > 1 else np.zeros_like(q)
    points = [task.at(*row) for row in zip(q, dq, strict=True)]
    z_ref = np.array([reference(s).z for s in t]).reshape(rows, task.size)
    error = np.array([task.minus(z, p.z) for z, p in zip(z_ref, points, strict=True)]).reshape(rows, task.m)
    v = np.zeros((rows, 0)) if v is None else v
    info: dict[str, Any] = provenance() | {
        "robot": {
            "name": robot.name,
            "source": robot.source,
            "options": dict(robot.options),
            "urdf_sha256": robot.urdf_sha256,
        },
        "task": task.describe(),
        "controller": {"kind": kind},
    }
    return Result(
        t=t,
        q=q,
        dq=dq,
        ddq=np.zeros_like(q),
        tau=np.zeros_like(q),
        z=np.array([p.z for p in points]).reshape(rows, task.size),
        dz=np.array([p.dz for p in points]).reshape(rows, task.m),
        z_ref=z_ref,
        error=error,
        task_force=np.zeros_like(error),
        given_up=np.zeros_like(error),
        v=v,
        dv=np.zeros_like(v),
        v_ref=v,
        chart=np.zeros(rows, dtype=np.int64) if chart is None else chart,
        kinetic_energy=np.array([robot.kinetic_energy(a, b) for a, b in zip(q, dq, strict=True)]),
        work=np.zeros(rows),
        switches=np.zeros(0) if switches is None else switches,
        period=reference.period if math.isfinite(reference.period) else math.inf,
        status=status,
        message=message,
        info=info,
    )
