"""Torques that a posture or a path needs, relative to those that the joints have."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import JointVector
from eos_pin.charts.chart import Chart
from eos_pin.errors import RobotError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

#: A posture is held with ease, and a path is followed, with this part of the torque limits.
EASY, ENOUGH = 0.8, 0.95
#: Velocity gain of the default controllers, with which a robot at rest joins a path [1/s].
JOINING = 20.0
#: Factors by which a path is slowed down, the least first.
SLOWDOWNS = 1.03 ** np.arange(140)


def gravity_load(robot: Robot, q: JointVector) -> float:
    """Largest ratio of gravity torque to torque limit in a posture; 0 for a robot without inertia or limits."""
    try:
        return float((np.abs(robot.gravity(q)) / robot.effort).max(initial=0.0))
    except RobotError:
        return 0.0


def slowdown_for_torque(task: Task, path: Trajectory, q: Float[np.ndarray, "k n"], chart: Chart) -> float:
    """Least factor by which a periodic path must be slowed down to need no more torque than there is.

    It counts the whole path, and that the robot starts at rest; infinite where the joints cannot even hold the robot.
    Where that is so at the start, torque is left out of account.

    Args:
        task: The task.
        path: Its trajectory.
        q: Joints at equal times over one period, its end included.
        chart: Chart at the start.
    """
    robot, load = task.robot, gravity_load(task.robot, q[0])
    if load > 1.0 or not np.isfinite(robot.effort).any():
        return 1.0
    room = ENOUGH if load < EASY else 0.5 * (1.0 + load)
    q, h, zero = q[:-1], path.period / (len(q) - 1), np.zeros(robot.n)
    after, before = np.roll(q, -1, axis=0), np.roll(q, 1, axis=0)
    dq, ddq = (after - before) / (2.0 * h), (after - 2.0 * q + before) / h**2
    try:
        gravity = np.array([robot.gravity(row) for row in q])
        motion = np.array([robot.inverse_dynamics(*row) for row in zip(q, dq, ddq, strict=True)]) - gravity
    except RobotError:
        return 1.0
    start, J = path(0.0), task.linearize(q[0])[1]
    still = np.zeros(chart.r)
    joining, curve = (
        robot.inverse_dynamics(q[0], zero, chart.acceleration(J, rate, still)) - gravity[0]
        for rate in (JOINING * start.dz, start.ddz)
    )
    s = SLOWDOWNS[:, None]
    need = [(np.abs(gravity + motion / k**2) / robot.effort).max() for k in SLOWDOWNS]
    first = (np.abs(gravity[0] + joining / s + curve / s**2) / robot.effort).max(axis=1)
    enough = np.flatnonzero(np.maximum(need, first) <= room)
    return float(SLOWDOWNS[enough[0]]) if len(enough) else math.inf
