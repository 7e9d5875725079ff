"""Defaults for any robot: a posture to start from, and a path that it can follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import get_args

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Array, JointVector, VectorLike, checked, frozen_copy, number
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.control._regularize import SINGULAR_VALUE_FLOOR
from eos_pin.errors import InputError
from eos_pin.experiments.applicability import DIRECTED, POINTED, TaskKind
from eos_pin.experiments.shapes import SHAPES, Shape, drawn, planes, sizes
from eos_pin.experiments.strength import EASY, gravity_load, slowdown_for_torque
from eos_pin.robot.loading import default_frame
from eos_pin.robot.model import Robot
from eos_pin.tasks.axis import AxisTask, PointAxisTask
from eos_pin.tasks.base import Task
from eos_pin.tasks.joints import JointTask
from eos_pin.tasks.look_at import LookAtTask
from eos_pin.tasks.orientation import HeadingTask, OrientationTask, PoseTask
from eos_pin.tasks.position import ComTask, PositionTask
from eos_pin.tasks.relations import DistanceTask, RelativePoseTask
from eos_pin.tasks.stacked import StackedTask
from eos_pin.trajectories.base import Trajectory
from eos_pin.trajectories.tolerated import ToleratedPath

TASK_KINDS: tuple[TaskKind, ...] = get_args(TaskKind)
#: Periods that are tried, the shortest first [s].
PERIODS = (4.0, 5.0, 6.0, 8.0, 10.0)
#: Points of a cycle at which a path is tried.
TRIALS = 48
#: A path fits if it stays on charts of at least this margin, within this part of the joint ranges and velocities.
ROOM = 0.6
#: Least motion of the task, in radians or reaches of the robot per radian of the joints, that a posture should allow.
CLEAR = 2.0 * SINGULAR_VALUE_FLOOR
#: The same for every point of a path.
PASSABLE = 1.5 * SINGULAR_VALUE_FLOOR
#: Where no posture allows more than this, the joints cannot move the task in that direction at all.
STUCK = 1e-3
#: Random postures that show what a robot can do.
SAMPLES = 20


@checked
def rest_posture(task: Task) -> JointVector:
    """A posture inside the limits in which the task is far from singular, with as many joints at zero as can be.

    From the zero posture, one joint after the other is turned in steps of 15° to where task and limits have most room,
    until none moves. Where the joints could hardly hold the robot there, they are turned on to where they can,
    if there is such a posture.

    Args:
        task: The task; its robot is meant.
    """
    robot = task.robot
    zero = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    # What hangs down at the zero posture is a leg, or hangs from the ceiling, and may go on to.
    merit = partial(_merit, task, floor=float(_heights(robot, zero).min()))
    found = [_climb(robot, zero, merit)]
    if regularity(task, found[0]) < CLEAR:
        # The zero posture was a bad place to start from.
        found += [_climb(robot, q, merit) for q in _postures(robot, SAMPLES // 2)]
    best = max(found, key=merit)
    if gravity_load(robot, best) <= EASY:
        return frozen_copy(best)

    def strong(q: JointVector) -> float:
        return merit(q) - 10.0 * math.log(max(gravity_load(robot, q) / EASY, 1.0))

    found = [_climb(robot, q, strong) for q in (best, zero, *_postures(robot, SAMPLES // 2))]
    clear = min(regularity(task, best), CLEAR)
    held = [q for q in found if gravity_load(robot, q) <= 1.0 and regularity(task, q) >= clear]
    return frozen_copy(max(held, key=strong, default=best))


def _climb(robot: Robot, q: JointVector, merit: Callable[[JointVector], float]) -> JointVector:
    """Turn joint after joint to where the merit of the posture is largest."""
    choices = [_choices(robot, i) for i in range(robot.n)]
    best = merit(q)
    for _ in range(20):
        before = best
        for i in range(robot.n):
            for value in choices[i]:
                trial = q.copy()
                trial[i] = value
                gain = merit(trial)
                if gain > best + 1e-9:
                    best, q = gain, trial
        if best == before:
            break
    return q


@checked
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

    What is not given is chosen: the largest size up to a quarter of the robot's reach that stays on one chart, inside
    the joint limits and clear of singularities, the first plane that has it, and the shortest period of a few at which
    no joint is too fast, or needs more torque than it has. Where every size does, it is the smallest, as slow as it
    must be.

    Args:
        task: The task; the path runs in its coordinates of length, and holds its orientation.
        q: Joints at the start.
        shape: Shape of the path; a hold rests where the task is, or aims where it is to look.
        size: Half width or radius [m].
        plane: Plane, such as `"yz"`; one axis for a line.
        period: Time of one round [s].

    Raises:
        InputError: The task has no coordinates of length, or nothing fits.
    """
    if shape not in SHAPES:
        raise InputError(f"the shape of a path is one of {', '.join(SHAPES)}; got {shape!r}")
    if task.whole is not task:
        options = {"shape": shape, "size": size, "plane": plane, "period": period}
        return ToleratedPath(task, fitting_path(task.whole, q, **options))  # type: ignore[arg-type]
    z = task.value(q)
    if shape == "hold":
        if any(given is not None for given in (size, plane, period)):
            raise InputError("a path that holds still has no size, plane or period; leave them out")
        return task.aim(q)
    free = task.lengths
    if not free:
        raise InputError(f"{task!r} has no coordinates of length to draw a path in; use the shape 'hold'")
    if regularity(task, q) < PASSABLE and (size is None or plane is None):
        raise InputError(
            f"no path is clear of singularities at this posture: the smallest singular value of {task!r} is below "
            f"{PASSABLE:g}, with lengths as parts of the robot's reach. Count fewer axes, take another frame, or start "
            "elsewhere"
        )
    tried = [number(size, "the size of the path", above=0.0)] if size is not None else sizes(task.robot)
    periods = PERIODS if period is None else (number(period, "the period", above=0.0),)
    failures, slow = [], None
    for length in tried:
        for where in [plane] if plane else planes(free, shape):
            path = drawn(task, z, shape, length, where, free, periods[0])
            slowdown, failure = _fits(task, q, path)
            fast = next((p for p in periods if p >= slowdown * periods[0]), None)
            if not failure and fast is None:
                failure = "a joint is too slow or too weak for it"
                lasting = math.ceil(slowdown * periods[0]) if math.isfinite(slowdown) else periods[-1]
                slow = drawn(task, z, shape, length, where, free, lasting)
            if not failure:
                return drawn(task, z, shape, length, where, free, fast or periods[-1])
            failures.append(f"{length:.3g} m in {where}: {failure}")
            if size is not None and plane is not None:
                # Asked for in so many words: it is drawn, and the run will say where it ends.
                return path
    if size is not None:
        return drawn(task, z, shape, tried[0], planes(free, shape)[0], free, periods[0])
    if slow is not None and period is None:
        return slow
    raise InputError(
        f"no path of this shape fits at this posture; the smallest tried: {failures[-1]}. Try another posture"
    )


def regularity(task: Task, q: JointVector, chart: Chart | None = None) -> float:
    """Least motion of the task in any direction per radian of the joints, in radians and reaches of the robot.

    It is 0 where the task is singular. Control fades out of directions in which it falls below `SINGULAR_VALUE_FLOOR`.

    Args:
        task: The task.
        q: Joints.
        chart: Chart that is used there; v counts like the task then, and the value is 0 at the edge of the chart, too.
    """
    rows = _scaled(task, q)
    if chart is not None:
        rows = np.concatenate((rows, chart.Wt))
    return float(np.linalg.svd(rows, compute_uv=False)[-1])


@checked
def make_task(
    robot: Robot,
    kind: TaskKind = "position",
    *,
    frame: str = "",
    axes: str = "",
    tool_axis: str = "z",
    point: VectorLike | Trajectory | None = None,
    seen_from: str = "",
    combinations: Sequence[Mapping[str, float]] = (),
) -> Task:
    """Task of a kind; missing choices are made to suit the robot.

    Args:
        robot: The robot.
        kind: Kind of task. On a planar robot a position has two coordinates, a pose two and the heading.
        frame: Frame that does the task; by default the one `default_frame` names.
        axes: Axes of a position, a centre of mass or a planar pose; by default as many as the joints can move it along.
        tool_axis: Axis of the frame that `axis`, `point-axis` and `look-at` direct, such as `"-z"` or `"0 0 1"`.
        point: Point of the world that `look-at` looks at, which may move, or `distance` counts from [m].
        seen_from: Frame from which `relative-pose` is seen.
        combinations: Coordinates of `joints`: factors of joints by name.

    Raises:
        InputError: The joints cannot move the task in all its directions, in no posture.
    """
    if kind not in TASK_KINDS:
        raise InputError(f"the kind of a task is one of {', '.join(TASK_KINDS)}; got {kind!r}")
    if tool_axis != "z" and kind not in DIRECTED:
        raise InputError(
            f"a tool axis, {tool_axis!r}, does not apply to a task of {kind}: it belongs to axis, point-axis, look-at"
        )
    frame = frame or default_frame(robot)
    if (point is None) != (kind not in POINTED):
        raise InputError(f"a point of the world is for the tasks look-at and distance, which need one; got {kind!r}")
    if bool(seen_from) != (kind == "relative-pose"):
        raise InputError(f"a frame from which it is seen is for the task relative-pose, which needs one; got {kind!r}")
    if bool(combinations) != (kind == "joints"):
        raise InputError(f"combinations of joints are for the task joints, which needs one or more; got {kind!r}")
    along: Callable[[str], Task] = partial(PositionTask, robot, frame) if kind != "com" else partial(ComTask, robot)
    task: Task
    if kind in ("position", "com"):
        task = along(axes or _free_axes(robot, along, frame))
    elif axes and (kind != "pose" or not _is_planar(robot, frame)):
        raise InputError(
            f"axes {axes!r} do not apply to a task of {kind}: it counts all of its coordinates. Leave them out, or "
            "choose a task of position"
        )
    elif kind in ("axis", "point-axis"):
        task = (AxisTask if kind == "axis" else PointAxisTask)(robot, frame, tool_axis)
    elif kind == "relative-pose":
        task = RelativePoseTask(robot, frame, seen_from)
    elif kind == "joints":
        task = JointTask(robot, combinations)
    elif kind == "look-at" and point is not None:
        task = LookAtTask(robot, frame, point, tool_axis)
    elif isinstance(point, Trajectory):
        raise InputError("a distance is counted from a point at rest; give three numbers, or choose look-at")
    elif point is not None:
        task = DistanceTask(robot, frame, point)
    elif kind == "orientation":
        task = OrientationTask(robot, frame)
    elif kind == "heading":
        task = HeadingTask(robot, frame)
    elif _is_planar(robot, frame):
        task = StackedTask([along(axes or "xy"), HeadingTask(robot, frame)])
    else:
        task = PoseTask(robot, frame)
    sigma = max((_sigma(task, q) for q in _postures(robot)), key=min)
    if sigma[-1] < STUCK:
        raise InputError(
            f"{task!r} has {task.m} coordinates, but the {robot.n} joints of {robot.name!r} can move only "
            f"{int((sigma >= STUCK).sum())} of them independently, in any posture. Choose fewer axes, another kind "
            "of task, or another frame"
        )
    return task


def _free_axes(robot: Robot, point: Callable[[str], Task], frame: str) -> str:
    """As many axes as the joints can move a point along independently and well; of these, those they do best."""
    rows = [np.concatenate([point(axis).linearize(q)[1] for axis in "xyz"]) / robot.reach for q in _postures(robot)]
    for count in range(min(3, robot.n), 0, -1):
        best = {
            axes: max(np.linalg.svd(J[list(axes)], compute_uv=False)[-1] for J in rows)
            for axes in combinations(range(3), count)
        }
        axes = max(best, key=lambda axes: best[axes])
        if best[axes] >= CLEAR:
            return "".join("xyz"[i] for i in axes)
    raise InputError(
        f"frame {frame!r} of {robot.name!r} stays where it is when the joints move, or nearly so; choose another frame "
        "or, if it turns, a task of orientation"
    )


def _is_planar(robot: Robot, frame: str) -> bool:
    """Whether a frame keeps its height and only ever turns about the vertical."""
    for q in _postures(robot):
        J = pin.computeFrameJacobian(robot.model, robot._data, q, robot.frame_id(frame), pin.LOCAL_WORLD_ALIGNED)
        if np.abs(J.reshape(6, -1)[2:5]).max() > 1e-9:
            return False
    return True


def _postures(robot: Robot, count: int = SAMPLES) -> list[JointVector]:
    """Random postures within the limits, always the same ones."""
    random = np.random.default_rng(0)
    ranges = np.array([_range(robot, i) for i in range(robot.n)])
    return list(random.uniform(ranges[:, 0], ranges[:, 1], (count, robot.n)))


def _scaled(task: Task, q: JointVector) -> Array:
    """Jacobian, lengths measured in reaches of the robot."""
    scale = np.array([1.0 / task.robot.reach if unit == "m" else 1.0 for unit in task.units])
    return scale[:, None] * task.linearize(q)[1]


def _sigma(task: Task, q: JointVector) -> Array:
    """Singular values of the scaled Jacobian."""
    return np.linalg.svd(_scaled(task, q), compute_uv=False)


def _range(robot: Robot, i: int) -> tuple[float, float]:
    """Positions of joint i to try: within its limits, and not far from zero."""
    far = robot.reach if robot.joints[i].kind == "prismatic" else math.pi
    near = float(np.clip(0.0, robot.lower[i], robot.upper[i]))
    return max(float(robot.lower[i]), near - far), min(float(robot.upper[i]), near + far)


def _choices(robot: Robot, i: int) -> Sequence[float]:
    """Positions of joint i that are tried, those near zero first."""
    prismatic = robot.joints[i].kind == "prismatic"
    if prismatic and not math.isfinite(robot.lower[i]) and not math.isfinite(robot.upper[i]):
        return [0.0]
    lower, upper = _range(robot, i)
    step = math.pi / 12.0
    values = step * np.arange(math.ceil(lower / step), math.floor(upper / step) + 1)
    if prismatic or values.size < 3:
        values = lower + (upper - lower) * np.linspace(0.2, 0.8, 5)
    return sorted(values.tolist(), key=abs)


def _merit(task: Task, q: JointVector, floor: float) -> float:
    """Merit of a posture as a start, with no joint below the floor [m]."""
    robot = task.robot
    sigma = _sigma(task, q)
    # Far enough from singular is enough: nobody gains from the last bit.
    merit = float(np.log(np.minimum(sigma / max(sigma[0], STUCK), 0.35) + 0.02).sum())
    merit -= 5.0 * max(0.0, 1.0 - float(sigma[-1]) / CLEAR)
    # Room to the limits, where there are limits: nothing in the middle half of the range, steep at its ends.
    span = robot.upper - robot.lower
    bounded = np.isfinite(span)
    if bounded.any():
        off = np.abs(q[bounded] - robot.lower[bounded] - 0.5 * span[bounded]) / np.maximum(span[bounded], 1e-9)
        merit -= 8.0 * float(np.maximum(off - 0.25, 0.0).sum()) + 50.0 * float(np.maximum(off - 0.4, 0.0).sum())
    merit -= 0.05 * float(np.abs(q).sum())
    # An arm that stands on the floor should stay above it.
    return merit - 5.0 * max(0.0, floor - float(_heights(robot, q).min())) / robot.reach


def _heights(robot: Robot, q: JointVector) -> Array:
    """Heights of the joints against gravity [m]; zeros without gravity."""
    down = robot.model.gravity.linear
    if not abs(down[2]) > 0.9 * np.linalg.norm(down) > 0.0:
        return np.zeros(1)
    pin.forwardKinematics(robot.model, robot._data, q)
    return np.array([-math.copysign(1.0, down[2]) * float(p.translation[2]) for p in list(robot._data.oMi)[1:]])


def _fits(task: Task, q: JointVector, path: Trajectory) -> tuple[float, str]:
    """Factor by which the path must be slowed down, and the reason if it does not fit, empty if it does."""
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
    if min(regularity(task, row, found.charts[0]) for row in found.q) < PASSABLE:
        return math.inf, "it comes near a singularity of the task"
    velocity = np.abs(np.diff(found.q, axis=0)).max(axis=0) * TRIALS / path.period
    factor = slowdown_for_torque(task, path, found.q, found.charts[0])
    return max(float((velocity / (ROOM * robot.velocity)).max()), factor), ""
