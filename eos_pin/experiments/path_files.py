"""Paths and points of a task from numbers in a file or on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    Vector,
    VectorLike,
    checked,
    vector,
)
from eos_pin.charts.atlas import Atlas
from eos_pin.errors import InputError
from eos_pin.experiments.defaults import ROOM
from eos_pin.tasks.base import Point, Task
from eos_pin.tasks.extent import check_reach
from eos_pin.trajectories.base import Hold, Trajectory
from eos_pin.trajectories.corners import STOPPING, Corners, check_corners, paced, rounded
from eos_pin.trajectories.spline import check_rows, cubic_spline, rotation_spline, shifted
from eos_pin.trajectories.stacked import StackedTrajectory
from eos_pin.trajectories.through import SAME, directions_in, waypoint_path
from eos_pin.trajectories.tolerated import ToleratedPath
from eos_pin.trajectories.waypoints import Waypoints, pose_numbers, posed, read_waypoints

#: A path without times is no faster than this part of the robot's reach, or 1 rad, per second.
PACE = 0.25
#: A path that takes longer than this [s] at less than this part of the pace is one in another unit of time.
LONG, SLOW = 600.0, 2e-3
#: Points of a path for which joints are looked for, at most.
MOST_POINTS = 300_000
#: Kinds of the parts of a pose.
POSE = ("number", "rotation")
TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


class _Coordinates(NamedTuple):
    """Task coordinates of a table: its first coordinates that are numbers, its rotation, or whole task points."""

    vectors: Float[Array, "K k"] | None = None
    turns: Float[Array, "K 3 3"] | None = None
    notes: tuple[str, ...] = ()
    points: Float[Array, "K size"] | None = None


@checked
def path_from_csv(
    path: str | Path,
    task: Task,
    q: JointVector,
    *,
    patient: bool = False,
    corners: Corners = "smooth",
    blend: float | None = None,
) -> Trajectory:
    """Path of a task through the rows of a text file, twice continuously differentiable.

    Times are counted from the first. Without times the path is followed at about constant speed, as fast as the joints'
    velocity limits allow. Of a pose, an orientation or a position that no column gives is that at q. What was chosen or
    changed is in the `notes` of the path.

    Args:
        path: Text file; see `eos_pin.trajectories.waypoints` for its columns. Or a text of way points, such as
            `"0.4 0 0.5; 0.4 0.2 0.5"`.
        task: The task.
        q: Joints where the robot starts.
        patient: Whether a path that takes more than ten minutes and hardly moves is taken as it is.
        corners: A smooth curve through all way points; straight lines with rounded corners, for paths without times; or
            straight lines with a stop at each way point.
        blend: Distance from a way point at which a rounded corner leaves the line [m], or [rad] where the line only
            turns; by default a tenth of the shorter line.

    Raises:
        InputError: The file cannot be used, its columns do not fit the task, or a point is out of reach. It names file,
            line and cause, and guesses units.
    """
    if task.whole is not task:
        within = path_from_csv(path, task.whole, q, patient=patient, corners=corners, blend=blend)
        return ToleratedPath(task, within)
    table = read_waypoints(path)
    check_rows(table)
    check_corners(corners, blend, table.t is not None)
    given = _of_task(table, task)
    z0 = task.value(q)
    if given.vectors is None and task.form == POSE:
        given = given._replace(vectors=np.tile(z0[:3], (len(table), 1)))
    if given.vectors is not None:
        check_reach(task, given.vectors, str(table.source), table.lines)
    steps = _steps(task, given)
    if table.t is None:
        _check_rests(table, steps)
        if corners == "round":
            points = _points(task, z0, given)
            given = _Coordinates(points=rounded(task, points, blend, closed=_closes(points)))
        times, note = _timed(table, task, q, given, corners)
        notes = (*given.notes, note)
    else:
        if not patient:
            _check_pace(table, float(steps.sum()))
        times, notes = table.t, (*given.notes, *shifted(table))
    curve = _curve(task, z0, given, times, corners)
    object.__setattr__(curve, "notes", notes)
    return curve


def task_point(task: Task, values: VectorLike, q: JointVector) -> Point:
    """Task point from numbers, in any of the usual forms.

    Args:
        task: The task.
        values: For a pose x y z (orientation as at q); x y z roll pitch yaw; x y z qx qy qz qw; or x y z and the
            rotation matrix row by row. For an orientation the same without x y z. For other tasks, m numbers.
        q: Joints where the robot is.

    Raises:
        InputError: Another count, no rotation, or out of reach.
    """
    array = vector(values, None, "the task point")
    if task.form == POSE:
        position, rotation = pose_numbers(array[None], "the task point")
        rest = task.value(q)[3:] if rotation is None else rotation.ravel()
        z = task.point(np.concatenate((position[0], rest)))
    elif task.form == ("rotation",):
        z = task.point(_turns(array[None], "the task point").ravel())
    elif array.size != task.size:
        raise InputError(
            f"the task point must be {task.size} numbers ({', '.join(task.labels)}) for {task!r}, got {array.size}"
        )
    else:
        z = task.point(array)
    check_reach(task, z[None], "the task point")
    return z


def points_along(path: Trajectory, rate: float = 100.0) -> Vector:
    """Times of the points of a path at which joints are looked for [s], its two ends among them.

    Args:
        path: A path that ends or repeats.
        rate: Points per second.

    Raises:
        InputError: There would be more than can be computed.
    """
    length = min(path.duration, path.period)
    if length * rate > MOST_POINTS:
        raise InputError(
            f"a path of {length:,.10g} s has {length * rate:,.0f} points; up to {MOST_POINTS:,} are possible. Make it "
            "shorter; if its times are in milliseconds, divide them by 1000"
        )
    return np.linspace(0.0, length, max(2, round(rate * length) + 1))


# -- columns ---------------------------------------------------------------------------------------------------------


def _of_task(table: Waypoints, task: Task) -> _Coordinates:
    """Task coordinates in the columns of a table."""
    if table.values is not None:
        return _unnamed(table, task, table.values)
    source = table.source
    place, turning = task.axes, table.rotation is not None or table.heading is not None
    if len(place) == task.size:
        if turning:
            raise InputError(
                f"{source} also has orientations ({', '.join(table.columns)}), but the task is a position. Choose the "
                "task pose, or leave these columns out"
            )
        vectors, spare = _along(table, place)
        return _Coordinates(vectors, None, spare)
    if task.form == POSE:
        if table.heading is not None:
            raise InputError(f"{source}: heading is for planar robots; a pose in space takes roll, pitch, yaw")
        return _Coordinates(None if table.position is None else _along(table, place)[0], table.rotation)
    spare = (f"columns {', '.join(table.axes)} of {source} do not count: {task!r}",) if table.axes else ()
    if task.form in (("direction",), ("number", "direction")) and table.heading is None:
        directions = directions_in(table, task)
        if directions is None and place:
            # The direction of the axis stays.
            return _Coordinates(_along(table, place)[0])
        if directions is not None:
            places = _along(table, place)[0] if place else directions[:, :0]
            return _Coordinates(places if places.size else None, points=np.hstack((places, directions)))
    if task.form == ("rotation",):
        if table.rotation is None:
            raise InputError(f"{source}: an orientation takes qw, qx, qy, qz or roll, pitch, yaw")
        return _Coordinates(None, table.rotation, spare)
    if place and not turning and task.form in (("number", "direction"), ("number", "angle")):
        # The direction or the heading stays.
        vectors, spare = _along(table, place)
        return _Coordinates(vectors, None, spare)
    if table.rotation is not None:
        raise InputError(f"{source}: {task!r} takes a heading, not an orientation in space")
    if table.heading is not None and task.form in (("angle",), ("number", "angle")):
        vectors, spare = _along(table, place) if place else (np.empty((len(table), 0)), spare)
        vectors, notes = _unwrapped(table, task, np.column_stack((vectors, table.heading)))
        return _Coordinates(vectors, None, (*spare, *notes))
    raise InputError(
        f"{source}: columns {', '.join(table.columns)} do not give {task!r}; name its coordinates z1 to z{task.m} "
        f"({', '.join(task.labels)})"
    )


def _along(table: Waypoints, axes: str) -> tuple[Array, tuple[str, ...]]:
    """Positions along some axes, and a note about others."""
    missing = [axis for axis in axes if axis not in table.axes]
    if table.position is None or missing:
        raise InputError(
            f"{table.source}: the task needs the columns {', '.join(axes)}; {', '.join(missing)} is missing among "
            f"{', '.join(table.columns)}"
        )
    spare = [axis for axis in table.axes if axis not in axes]
    note = f"column {', '.join(spare)} of {table.source} does not count: the task is along {', '.join(axes)}"
    return table.position[:, [table.axes.index(axis) for axis in axes]], (note,) if spare else ()


def _unnamed(table: Waypoints, task: Task, values: Float[Array, "K k"]) -> _Coordinates:
    """Task coordinates in the columns z1, …, zm."""
    width, source = values.shape[1], str(table.source)
    if task.form == POSE:
        return _Coordinates(*pose_numbers(values, source, table.lines))
    if task.form == ("rotation",):
        return _Coordinates(None, _turns(values, source, table))
    if task.form == ("number", "direction") and width in (3, 6, 7, 12):
        return _of_task(posed(table), task)
    first = task.channels()[0].part.stop
    if task.size != task.m or width not in (first, task.m):
        raise InputError(
            f"{source}: its rows have {width} coordinates, but {task!r} has {task.m} ({', '.join(task.labels)}). The "
            "columns are t and as many as that, or name them in the first row"
        )
    vectors, notes = _unwrapped(table, task, values)
    return _Coordinates(vectors, None, notes)


def _turns(values: Float[Array, "K k"], name: str, table: Waypoints | None = None) -> Float[Array, "K 3 3"]:
    """Rotations from 3, 4 or 9 numbers."""
    count = values.shape[1]
    if count not in (3, 4, 9):
        raise InputError(
            f"{name} has {count} numbers; an orientation is 3 (roll pitch yaw), 4 (qx qy qz qw) or 9 (the rotation "
            "matrix row by row)"
        )
    whole = np.column_stack((np.zeros((len(values), 3)), values))
    rotation = pose_numbers(whole, name, table.lines if table else ())[1]
    assert rotation is not None
    return rotation


def _unwrapped(table: Waypoints, task: Task, vectors: Float[Array, "K k"]) -> tuple[Array, tuple[str, ...]]:
    """The same with headings that do not jump, and a note where they did."""
    smooth = vectors.copy()
    for i, unit in enumerate(task.units[: vectors.shape[1]]):
        if unit == "rad":
            smooth[:, i] = np.unwrap(vectors[:, i])
    if np.allclose(smooth, vectors, atol=1e-9):
        return vectors, ()
    return smooth, (f"headings of {table.source} that jump by more than half a turn are taken the shorter way",)


# -- times -----------------------------------------------------------------------------------------------------------


def _ways(task: Task, points: Float[Array, "K size"]) -> Float[Array, "L m"]:
    """Ways from point to point, in radians and parts `PACE` of the reach."""
    scale = np.array([1.0 / (PACE * task.robot.reach) if unit == "m" else 1.0 for unit in task.units])
    return np.asarray(task.kinematics.minus(points[1:], points[:-1]) * scale)


def _steps(task: Task, given: _Coordinates) -> Vector:
    """Length of the way from row to row, in radians and parts `PACE` of the reach."""
    squares = 0.0
    if given.points is not None:
        return np.linalg.norm(_ways(task, given.points), axis=1)
    if given.vectors is not None:
        units = task.units[: given.vectors.shape[1]]
        scale = np.array([1.0 / (PACE * task.robot.reach) if unit == "m" else 1.0 for unit in units])
        squares = squares + ((np.diff(given.vectors, axis=0) * scale) ** 2).sum(axis=1)
    if given.turns is not None:
        between = given.turns[1:] @ given.turns[:-1].transpose(0, 2, 1)
        squares = squares + np.arccos(np.clip(0.5 * (np.trace(between, axis1=1, axis2=2) - 1.0), -1.0, 1.0)) ** 2
    return np.sqrt(squares)


def _check_rests(table: Waypoints, steps: Vector) -> None:
    """Refuse rows that stay where they are without a time."""
    for k in np.flatnonzero(steps < 1e-9)[:1]:
        raise InputError(
            f"{table.source}, line {table.lines[k + 1]} repeats line {table.lines[k]}, and without a column t there is "
            "no telling how long to stay. Leave it out, or add the times t [s]"
        )


def _timed(table: Waypoints, task: Task, q: JointVector, given: _Coordinates, corners: Corners) -> tuple[Array, str]:
    """Times for a table without, and a note about them."""
    if corners == "round":
        assert given.points is not None
        times = paced(_ways(task, given.points), closed=_closes(given.points))
    else:
        times = np.concatenate(([0.0], np.cumsum(_steps(task, given))))
    if corners == "stop":
        times *= STOPPING
    curve = _curve(task, task.value(q), given, times, corners)
    tried = np.linspace(0.0, times[-1], min(500, 20 * len(times)) + 1)
    found = Atlas(task).follow(q, [curve(t).z for t in tried.tolist()], tol=1e-6)
    rates = np.abs(np.diff(found.q, axis=0)) / (tried[1] - tried[0])
    slower = max(1.0, float((rates / (ROOM * task.robot.velocity)).max(initial=0.0)))
    times = slower * times
    pace = "as fast as joints may" if slower > 1.0 else "at most a quarter of the reach, or 1 rad, per second"
    return times, f"{table.source} has no times: it takes {times[-1]:.3g} s, {pace}"


def _check_pace(table: Waypoints, way: float) -> None:
    """Refuse a path that hardly moves for a long time; its times are in another unit."""
    assert table.t is not None
    span = float(table.t[-1])
    if span <= LONG or way > SLOW * span:
        return
    guess = next(
        (
            f"If its times are in {unit}, divide them by {factor:g}; if they are right"
            for unit, factor in TIME_UNITS.items()
            if (10.0 * SLOW * span / factor < way) or (not way and span / factor <= LONG)
        ),
        "If that is right",
    )
    raise InputError(
        f"{table.source} takes {span:,.10g} s, and hardly moves: {way / span:.2g} of the usual speed. {guess}, give "
        "the length of the run as well (--duration of eos-pin track, or patient=True in Python)"
    )


def _closes(points: Float[Array, "K size"]) -> bool:
    """Whether way points end where they begin."""
    return bool(np.abs(points[-1] - points[0]).max() < SAME)


def _points(task: Task, z0: Point, given: _Coordinates) -> Float[Array, "K size"]:
    """Task points of the rows; coordinates that no column gives are as in z0."""
    if given.points is not None:
        return given.points
    blocks = [block.reshape(len(block), -1) for block in (given.vectors, given.turns) if block is not None]
    rows = np.hstack(blocks)
    kept = np.tile(z0[rows.shape[1] :], (len(rows), 1))
    return np.hstack((rows, kept))


def _curve(task: Task, z0: Point, given: _Coordinates, times: Vector, corners: Corners) -> Trajectory:
    """The path through the rows at given times; coordinates that no column gives stay as in z0."""
    if corners == "stop":
        points = _points(task, z0, given)
        # Two equal points are a rest.
        return waypoint_path(task, points, times, closed=len(points) > 2 and _closes(points), corners=corners)
    if given.points is not None and task.form in (POSE, ("number",)):
        turns = given.points[:, 3:].reshape(-1, 3, 3) if task.form == POSE else None
        given = _Coordinates(given.points if turns is None else given.points[:, :3], turns)
    if given.points is not None:
        return waypoint_path(task, given.points, times, closed=_closes(given.points))
    for repeats in (None, False):
        parts: list[Trajectory] = []
        if given.vectors is not None:
            parts.append(cubic_spline(given.vectors, times, closed=repeats))
        if given.turns is not None:
            parts.append(rotation_spline(given.turns, times, closed=repeats))
        if len({part.period for part in parts}) < 2:
            break
    if given.turns is None and given.vectors is not None and given.vectors.shape[1] < task.size:
        k = given.vectors.shape[1]
        parts.append(Hold(z0[k:], task.m - k))
    return parts[0] if len(parts) == 1 else StackedTrajectory(tuple(parts))
