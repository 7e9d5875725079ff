"""Robots moved along a task path without dynamics: by joint rates, or through charts."""

from __future__ import annotations

import numpy as np

from eos_pin._arrays import JointVector, number
from eos_pin.charts.atlas import Atlas
from eos_pin.errors import SingularError
from eos_pin.robot.postures import JointsLike
from eos_pin.simulation._recorder import check_run, joint_run, sample_times
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

#: Samples kept per second, besides the exact multiples of the path's period.
RATE = 50.0


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
    t = sample_times(duration, RATE, path.period)
    check_run(task.robot.n, len(t), float(t[-1]), path)
    found = Atlas(task).follow(q, [path(s).z for s in t], tol=tol)
    t = t[: len(found.q)]
    return joint_run(task, t, found.q, found.z, v=found.v, chart=found.chart, period=path.period, message=found.message)
