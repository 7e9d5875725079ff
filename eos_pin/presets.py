"""Sensible defaults for a robot nobody has described: a posture to start from, and a path that it can follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin

from eos_pin.arrays import JointVector, number, readonly
from eos_pin.atlas import Atlas
from eos_pin.errors import InputError
from eos_pin.loading import default_frame
from eos_pin.orientations import HeadingTask, OrientationTask, PoseTask
from eos_pin.positions import ComTask, PositionTask
from eos_pin.robot import Robot
from eos_pin.tasks import StackedTask, Task
from eos_pin.trajectories import Harmonic, Hold, StackedTrajectory, Trajectory, circle, figure_eight, line

TaskKind: TypeAlias = Literal["position", "pose", "orientation", "heading", "com"]
TASK_KINDS: tuple[TaskKind, ...] = ("position", "pose", "orientation", "heading", "com")
Shape: TypeAlias = Literal["eight", "circle", "line", "hold"]
SHAPES: tuple[Shape, ...] = ("eight", "circle", "line", "hold")
#: Periods that are tried, the shortest first [s].
PERIODS = (4.0, 5.0, 6.0, 8.0, 10.0)
#: Points of a cycle at which a path is tried.
TRIALS = 48
#: A path fits if it stays on charts of at least this margin, within this part of the joint ranges and velocities.
ROOM = 0.6


def rest_posture(task: Task) -> JointVector:
    """A posture inside the limits in which the task is far from singular, with as many joints at zero as can be.

    From the zero posture, one joint after the other is turned in steps of 15° to where task and limits have most room,
    until none wants to move.

    Args:
        task: The task; its robot is meant.
    """
    robot = task.robot
    q = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    choices = [_choices(robot, i) for i in range(robot.n)]
    length = robot.reach
    best = _merit(task, q, length)
    for _ in range(20):
        before = best
        for i in range(robot.n):
            for value in choices[i]:
                trial = q.copy()
                trial[i] = value
                merit = _merit(task, trial, length)
                if merit > best + 1e-9:
                    best, q = merit, trial
        if best == before:
            break
    return readonly(q)


def fitting_path(
    task: Task,
    q: JointVector,
    *,
    shape: Shape = "eight",
    size: float | None = None,
    plane: str | None = None,
    period: float | None = None,
) -> Trajectory:
    """A periodic path through the task point at q that the robot can follow within its limits.

    What is not given is chosen: the largest size up to a quarter of the robot's reach that stays on one chart and
    inside the joint limits, the first plane that has it, and the shortest period at which no joint is too fast.

    Args:
        task: The task; the path runs in its coordinates of length, and holds its orientation.
        q: Joints at the start.
        shape: What it looks like.
        size: Half width or radius [m].
        plane: Plane, such as `"yz"`; one axis for a line.
        period: Time of one round [s].

    Raises:
        InputError: The task has no coordinates of length, or nothing fits.
    """
    if shape not in SHAPES:
        raise InputError(f"the shape of a path is one of {', '.join(SHAPES)}; got {shape!r}")
    z = task.value(q)
    if shape == "hold":
        return Hold(z, task.m)
    free = _lengths(task)
    if not free:
        raise InputError(f"{task!r} has no coordinates of length to draw a path in; use the shape 'hold'")
    sizes = [number(size, "the size of the path", above=0.0)] if size is not None else _sizes(task.robot)
    periods = PERIODS if period is None else (number(period, "the period", above=0.0),)
    failures = []
    for length in sizes:
        for where in [plane] if plane else _planes(free, shape):
            path = _draw(task, z, shape, length, where, free, periods[0])
            slowdown, failure = _fits(task, q, path)
            fast = next((p for p in periods if p >= slowdown * periods[0]), None)
            if not failure and fast is None:
                failure = "a joint is too slow for it"
            if not failure:
                return _draw(task, z, shape, length, where, free, fast or periods[-1])
            failures.append(f"{length:.3g} m in {where}: {failure}")
            if size is not None and plane is not None:
                # Asked for in so many words: it is drawn, and the run will say where it ends.
                return path
    if size is not None:
        return _draw(task, z, shape, sizes[0], _planes(free, shape)[0], free, periods[0])
    raise InputError(
        f"no path of this shape fits at this posture; the smallest tried: {failures[-1]}. Try another posture"
    )


def make_task(robot: Robot, kind: TaskKind = "position", *, frame: str = "", axes: str = "") -> Task:
    """Task of a kind, with what is not given chosen to suit the robot.

    Args:
        robot: The robot.
        kind: What counts. On a planar robot a position has two coordinates, a pose two and the heading.
        frame: Frame that does the task; by default the one `default_frame` names.
        axes: Axes of a position or centre of mass; by default all along which it can move.
    """
    if kind not in TASK_KINDS:
        raise InputError(f"the kind of a task is one of {', '.join(TASK_KINDS)}; got {kind!r}")
    frame = frame or default_frame(robot)
    point: Callable[[str], Task] = partial(PositionTask, robot, frame) if kind != "com" else partial(ComTask, robot)
    free = axes or _free_axes(robot, point)
    if kind in ("position", "com"):
        return point(free)
    if kind == "orientation":
        return OrientationTask(robot, frame)
    if kind == "pose" and len(free) == 3:
        return PoseTask(robot, frame)
    heading = HeadingTask(robot, frame)
    return heading if kind == "heading" else StackedTask([point(free), heading])


def _free_axes(robot: Robot, point: Callable[[str], Task]) -> str:
    """Axes along which a point of the robot can move at all."""
    random = np.random.default_rng(0)
    free = ""
    for axis in "xyz":
        task = point(axis)
        moves = max(np.abs(task.linearize(random.uniform(-1.0, 1.0, robot.n))[1]).max() for _ in range(5))
        free += axis if moves > 1e-9 else ""
    return free or "xyz"


def _choices(robot: Robot, i: int) -> Sequence[float]:
    """Positions of joint i that are tried, those near the middle of its range first."""
    lower, upper = max(robot.lower[i], -math.pi), min(robot.upper[i], math.pi)
    if robot.joints[i].kind == "prismatic":
        values = lower + (upper - lower) * np.linspace(0.2, 0.8, 5) if math.isfinite(robot.lower[i]) else np.zeros(1)
    else:
        step = math.pi / 12.0
        values = step * np.arange(math.ceil(lower / step), math.floor(upper / step) + 1)
    return sorted(values.tolist(), key=abs)


def _merit(task: Task, q: JointVector, length: float) -> float:
    """How good a posture is to start from."""
    robot = task.robot
    _, J = task.linearize(q)
    scale = np.array([1.0 / length if unit == "m" else 1.0 for unit in task.units])
    sigma = np.linalg.svd(scale[:, None] * J, compute_uv=False)
    # Far enough from singular is enough: nobody gains from the last bit.
    merit = float(np.log(np.minimum(sigma / sigma[0], 0.35) + 0.02).sum())
    # Room to the limits, where there are limits: nothing in the middle half of the range, steep at its ends.
    span = robot.upper - robot.lower
    bounded = np.isfinite(span)
    if bounded.any():
        off = np.abs(q[bounded] - robot.lower[bounded] - 0.5 * span[bounded]) / np.maximum(span[bounded], 1e-9)
        merit -= 8.0 * float(np.maximum(off - 0.25, 0.0).sum())
    merit -= 0.05 * float(np.abs(q).sum())
    # An arm that stands on the floor should stay above it, if gravity says which way is down.
    down = robot.model.gravity.linear
    if abs(down[2]) > 0.9 * np.linalg.norm(down) > 0.0:
        pin.forwardKinematics(robot.model, robot._data, q)
        heights = [-math.copysign(1.0, down[2]) * float(p.translation[2]) for p in list(robot._data.oMi)[1:]]
        merit -= 5.0 * max(0.0, heights[0] - min(heights)) / length
    return merit


def _lengths(task: Task) -> list[str]:
    """Axes of the task's first coordinates that are lengths, in order."""
    first = task.tasks[0] if isinstance(task, StackedTask) else task
    return [label for label, unit in zip(first.labels, first.units, strict=True) if unit == "m"]


def _planes(free: Sequence[str], shape: Shape) -> list[str]:
    if shape == "line" or len(free) == 1:
        return list(reversed(free))
    pairs = [a + b for i, a in enumerate(free) for b in free[i + 1 :]]
    # A figure drawn on a wall in front of the robot reads best.
    return sorted(pairs, key=lambda pair: pair != "yz")


def _sizes(robot: Robot) -> list[float]:
    """Sizes that are tried, round numbers from a quarter of the reach downwards [m]."""
    largest = 0.25 * robot.reach
    return [float(f"{largest * 0.8**k:.2g}") for k in range(16)]


def _draw(
    task: Task, z: np.ndarray, shape: Shape, size: float, plane: str, free: Sequence[str], period: float
) -> Trajectory:
    """The path in the task's own coordinates, begun at z."""
    k = len(free)
    center = z[:k]
    axes = "".join("xyz"[i] for i in range(k))
    # Plane and axes are named by the task's labels; the shapes count them from the first.
    unknown = [axis for axis in plane if axis not in free]
    if unknown or len(plane) != (1 if shape == "line" or k == 1 else 2) or len(set(plane)) != len(plane):
        wanted = "one of the axes" if shape == "line" or k == 1 else "two of the axes"
        raise InputError(f"a {shape} of this task lies along {wanted} {', '.join(free)}; got {plane!r}")
    named = "".join(axes[list(free).index(axis)] for axis in plane)
    path: Harmonic
    if shape == "line" or k == 1:
        path = line(center, size * np.eye(k)["xyz".index(named)], period=period)
    elif shape == "circle":
        path = circle(center, size, period=period, plane=named)
    else:
        path = figure_eight(center, size, period=period, plane=named)
    if z.size == k:
        return path
    return StackedTrajectory((path, Hold(z[k:], task.m - k)))


def _fits(task: Task, q: JointVector, path: Trajectory) -> tuple[float, str]:
    """Factor by which the path must be slowed down, and why it does not fit, empty if it does."""
    robot = task.robot
    times = path.period * np.arange(TRIALS + 1) / TRIALS
    found = Atlas(task, threshold=ROOM).follow(q, np.array([path(t).z for t in times]), tol=1e-8)
    if not found.complete:
        return math.inf, found.message
    if len(found.charts) > 1:
        return math.inf, "it needs more than one chart"
    slack = 0.5 * (1.0 - ROOM) * 0.25 * np.where(np.isfinite(robot.upper - robot.lower), robot.upper - robot.lower, 0.0)
    outside = (found.q < robot.lower + slack) | (found.q > robot.upper - slack)
    if outside.any():
        names = [robot.joints[i].name for i in np.flatnonzero(outside.any(axis=0))]
        return math.inf, f"joints {', '.join(names)} come near their limits"
    velocity = np.abs(np.diff(found.q, axis=0)).max(axis=0) * TRIALS / path.period
    return float((velocity / (ROOM * robot.velocity)).max()), ""
