"""Task paths for planning: smooth curves through way points, in the coordinates of any task."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, VectorLike, by_value, frozen_copy, vector
from eos_pin.errors import InputError
from eos_pin.tasks import _sphere
from eos_pin.tasks.base import Kind, PointLike, Task
from eos_pin.tasks.extent import check_reach
from eos_pin.trajectories.base import Hold, Target, Trajectory
from eos_pin.trajectories.corners import STOPPING, Corners, check_corners, rounded
from eos_pin.trajectories.harmonic import Harmonic, circle, figure_eight, line
from eos_pin.trajectories.spline import Geodesic, cubic_at, cubics_at, rotations_along, unrolled
from eos_pin.trajectories.stacked import StackedTrajectory
from eos_pin.trajectories.tolerated import ToleratedPath
from eos_pin.trajectories.waypoints import Waypoints, posed, read_waypoints

#: A gap between way points is a jump where it is this many times the median, and this long in metres and radians.
JUMP, LONG = 20.0, 0.05
#: First and last way point of a closed path are the same up to this [m, rad].
SAME = 1e-6


@by_value
@dataclass(frozen=True, eq=False)
class WaypointPath(Trajectory):
    """A curve through way points with continuous acceleration; it repeats if it is closed.

    Numbers follow cubic splines; a rotation follows the spline of its quaternion, a direction that of its vector, both
    scaled to length 1.

    Attributes:
        task: The task whose points these are.
        points: Way points, (K, size); of a closed path the last is the first again.
        times: Increasing times [s], (K,).
        closed: Whether it repeats.
    """

    task: Task
    points: Float[Array, "K size"]
    times: Float[Array, " K"]
    closed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_copy(self.points))
        object.__setattr__(self, "times", frozen_copy(self.times))
        if self.closed:
            object.__setattr__(self, "period", float(self.times[-1] - self.times[0]))
        else:
            object.__setattr__(self, "begin", float(self.times[0]))
            object.__setattr__(self, "duration", float(self.times[-1]))

    @cached_property
    def _splines(self) -> tuple[Array, Array, Array]:
        """Knots, the cubics between them, (K − 1, 4, width), and the gain of each column from first to last."""
        from scipy.interpolate import CubicSpline

        made, turns, span = list[Array](), list[Array](), self.times[-1] - self.times[0]
        for part, kind in self.task.channels():
            values, times = np.array(self.points[:, part]), self.times
            if kind == "rotation":
                values = unrolled(values)
            elif kind == "angle":
                values = np.unwrap(values, axis=0)
            turn = (values[-1] - values[0]) * (self.closed and kind == "angle")
            values -= np.outer((times - times[0]) / span, turn)
            if self.closed:
                # Where a quaternion comes back negative only two rounds together repeat.
                if kind == "rotation" and values[-1] @ values[0] < 0.0:
                    values = np.concatenate((values, -values[1:]))
                    times = np.concatenate((times, times[1:] + span))
                values[-1] = values[0]
            elif len(times) == 2:
                middle = 0.5 * (values[:1] + values[1:])
                values, times = np.insert(values, 1, middle, axis=0), np.insert(times, 1, times.mean())
            curve = CubicSpline(times, values, bc_type="periodic" if self.closed else "not-a-knot", axis=0)
            cubics = np.array(curve.c.transpose(1, 0, 2))
            cubics[:, 2] += turn / span
            cubics[:, 3] += np.outer((times[:-1] - times[0]) / span, turn)
            made.append(cubics)
            turns.append(turn)
        knots, turned = self.times, np.concatenate(turns)
        if max(map(len, made)) > min(map(len, made)):
            knots = np.concatenate((knots, knots[1:] + span))
            made = [np.resize(cubics, (len(knots) - 1, *cubics.shape[1:])) for cubics in made]
            cubics = np.concatenate(made, axis=2)
            cubics[len(self.times) - 1 :, 3] += turned
            return knots, cubics, 2.0 * turned
        if len(knots) == 2:
            knots = np.insert(knots, 1, knots.mean())
        return knots, np.concatenate(made, axis=2), turned

    @cached_property
    def _parts(self) -> list[tuple[slice, Kind]]:
        """Columns of the splines of each part of the task, and its kind; none where these are z itself."""
        parts, first = list[tuple[slice, Kind]](), 0
        for part, kind in self.task.channels():
            width = 4 if kind == "rotation" else part.stop - part.start
            parts.append((slice(first, first + width), kind))
            first += width
        return parts if {kind for _, kind in parts} & {"rotation", "direction"} else []

    def __call__(self, t: float) -> Target:
        knots, cubics, turned = self._splines
        first, last = knots.item(0), knots.item(-1)
        if self.closed:
            rounds, inside = divmod(t - first, last - first)
            p, dp, ddp = cubic_at(knots, cubics, first + inside)
            if rounds:
                p += rounds * turned
        else:
            p, dp, ddp = cubic_at(knots, cubics, min(max(t, first), last))
        z, dz, ddz = self._point(p, dp, ddp)
        if self.task.whole is not self.task:
            (dz,), (ddz,) = self.task._rates(z[None], dz[None], ddz[None])
        if not (self.closed or first <= t <= last):
            dz, ddz = 0.0 * dz, 0.0 * ddz
        return Target(z, dz, ddz)

    def _point(self, p: Array, dp: Array, ddp: Array) -> tuple[Array, Array, Array]:
        """z, dz, ddz from the splines' values and derivatives, (…, width) each."""
        if not self._parts:
            return p, dp, ddp
        parts = []
        for columns, kind in self._parts:
            part = p[..., columns], dp[..., columns], ddp[..., columns]
            if kind == "rotation":
                part = rotations_along(*part)
            elif kind == "direction":
                part = _direction(*part)
            parts.append(part)
        z, dz, ddz = (np.concatenate(values, axis=-1) for values in zip(*parts, strict=True))
        return z, dz, ddz

    def sample(self, times: Float[Array, " K"]) -> tuple[Array, Array, Array]:
        """z, dz, ddz at several times, each (K, …); an open path rests before its start and after its end."""
        t = np.asarray(times, dtype=float)
        knots, cubics, turned = self._splines
        if self.closed:
            rounds, inside = np.divmod(t - knots[0], knots[-1] - knots[0])
            p, dp, ddp = cubics_at(knots, cubics, knots[0] + inside)
            p += np.outer(rounds, turned)
        else:
            p, dp, ddp = cubics_at(knots, cubics, np.clip(t, knots[0], knots[-1]))
        z, dz, ddz = self._point(p, dp, ddp)
        dz, ddz = self.task._rates(z, dz, ddz)
        if not self.closed:
            resting = (t < knots[0]) | (t > knots[-1])
            dz[resting], ddz[resting] = 0.0, 0.0
        return z, dz, ddz

    def describe(self) -> dict[str, Any]:
        """Plain values from which `WaypointPath(task, …)` makes the same path."""
        return {"points": self.points.tolist(), "times": self.times.tolist(), "closed": self.closed}


def waypoint_path(
    task: Task,
    points: Sequence[PointLike] | Array,
    times: VectorLike | None = None,
    *,
    closed: bool = False,
    names: Sequence[str] = (),
    corners: Corners = "smooth",
    blend: float | None = None,
) -> WaypointPath | Geodesic:
    """Path through way points.

    Args:
        task: The task.
        points: Two way points or more, in any form that `Task.point` takes.
        times: Increasing times [s]; by default the path is run at an even pace, a metre or a radian a second or less.
        closed: Whether the path returns to its first point. The last one may be the first again or the one before it.
        names: How each way point is called in messages; by default its number.
        corners: A smooth curve through all way points; straight lines with rounded corners; or straight lines with a
            stop at each way point.
        blend: Size of rounded corners, see `rounded`.

    Raises:
        InputError: Fewer than two, one twice in a row, a jump between two, a closed path that does not close, or times
            or a blend that do not apply.
    """
    check_corners(corners, blend, times is not None)
    names = names or [f"way point {k}" for k in range(len(points))]
    if len(points) < 2:
        raise InputError(f"a path needs at least two way points, got {len(points)}")
    z = []
    for k, point in enumerate(points):
        try:
            z.append(task.point(point))
        except InputError as error:
            raise InputError(f"{names[k]}: {error}") from error
    whole = task.whole
    steps = np.array([whole.minus(b, a) for a, b in pairwise(z)])
    gaps = _lengths(steps)
    middle = float(np.median(gaps))
    for k in np.flatnonzero(gaps < 1e-9 + 1e-6 * middle).tolist():
        if times is None:
            raise InputError(
                f"{names[k + 1]} is the same as {names[k]}; leave one of them out, or give times to let the robot wait"
            )
    worst = int(gaps.argmax())
    if corners == "smooth" and len(gaps) > 3 and gaps[worst] > JUMP * middle and gaps[worst] > LONG:
        raise InputError(
            f"the path jumps by {gaps[worst]:.3g} m or rad from {names[worst]} to {names[worst + 1]}, {JUMP:g} times "
            f"further than others ({middle:.3g}); add way points between them, or plan two paths"
        )
    if closed:
        gap = float(_lengths(whole.minus(z[0], z[-1])[None])[0])
        if gap > max(1.5 * float(gaps.max()), SAME):
            raise InputError(
                f"the path is to be closed, but its last way point is {gap:.3g} m or rad away from its first, and its "
                f"longest step is {float(gaps.max()):.3g}; leave out --closed, or lead it back"
            )
        if gap <= SAME:
            z[-1] = z[0]
        else:
            z.append(z[0])
            gaps = np.append(gaps, gap)
    if times is None:
        clock = np.concatenate(([0.0], np.cumsum(gaps)))
    else:
        clock = vector(times, len(points), "the times of a path")
        if len(z) > len(points):
            clock = np.append(clock, clock[-1] + float(np.median(np.diff(clock))))
        if not (np.diff(clock) > 0.0).all():
            raise InputError(f"the times of a path must increase, got {clock.tolist()}")
    if corners == "stop":
        return Geodesic(task, np.array(z), clock if times is not None else STOPPING * clock, closed)
    if corners == "round":
        z = [*rounded(task, np.array(z), blend, closed=closed)]
        clock = np.concatenate(([0.0], np.cumsum(_lengths(np.array([whole.minus(b, a) for a, b in pairwise(z)])))))
    return WaypointPath(task, np.array(z), clock, closed)


def read_path(
    path: str | Path,
    task: Task,
    z: Array,
    *,
    closed: bool = False,
    corners: Corners = "smooth",
    blend: float | None = None,
) -> WaypointPath | Geodesic:
    """Path of a task from way points in a file or a text; `z` gives the coordinates without columns.

    Args:
        path: File or text for `read_waypoints`.
        task: The task.
        z: Task point whose rotation is kept where the file has positions only, (size,).
        closed: Whether the path returns to its first point.
        corners: As for `waypoint_path`.
        blend: As for `waypoint_path`.

    Raises:
        InputError: The file cannot be read, or does not fit the task.
    """
    table = read_waypoints(path)
    if table.values is not None and task.form in (("number", "rotation"), ("number", "direction")):
        table = posed(table)
    rows = np.repeat(z[None], len(table), axis=0)
    for part, kind in task.channels():
        width, turning, angle = part.stop - part.start, kind == "rotation", kind == "angle"
        if table.values is not None and table.values.shape[1] in (task.size, width):
            rows[:, part] = table.values[:, part] if table.values.shape[1] == task.size else table.values
        elif turning and table.rotation is not None:
            rows[:, part] = table.rotation.reshape(-1, 9)
        elif kind == "direction" and (directions := directions_in(table, task)) is not None:
            rows[:, part] = directions
        elif angle and table.heading is not None:
            rows[:, part] = table.heading[:, None]
        elif kind == "number" and table.position is not None and table.position.shape[1] >= width:
            rows[:, part] = table.position[:, :width]
        elif kind not in ("rotation", "direction"):
            raise InputError(
                f"{path} has the columns {', '.join(table.columns)}, which do not give {width} coordinates "
                f"({', '.join(task.labels)}) of the task {task!r}"
            )
    if table.position is not None:
        check_reach(task, rows, str(table.source), table.lines)
    names = [f"{path}, line {line}" for line in table.lines]
    return waypoint_path(task, rows, table.t, closed=closed, names=names, corners=corners, blend=blend)


def directions_in(table: Waypoints, task: Task) -> Float[Array, "K 3"] | None:
    """Directions of the axis of a task in a table, from the poses in it if need be; None where there are none."""
    whole = task.whole
    parts: Sequence[Any] = getattr(whole, "tasks", (whole,))
    axis = next((part.axis for part in parts if hasattr(part, "axis")), None)
    return table.direction if table.rotation is None or axis is None else np.asarray(table.rotation @ np.array(axis))


def _direction(s: Array, ds: Array, dds: Array) -> tuple[Array, Array, Array]:
    """Directions, velocities and accelerations of vectors that need not have length 1."""
    if s.ndim == 1:
        (a,), (da,), (dda,) = _direction(s[None], ds[None], dds[None])
        return a, da, dda
    length = np.linalg.norm(s, axis=1)[:, None]
    a = s / length
    rate = (a * ds).sum(axis=1)[:, None]
    da = (ds - a * rate) / length
    dda = (dds - 2.0 * da * rate) / length
    # Along a it is as a vector of constant length has it.
    dda -= a * ((a * dda).sum(axis=1) + (da * da).sum(axis=1))[:, None]
    return a, *_sphere.coordinates(a, da, dda)


def _lengths(steps: Float[Array, "K m"]) -> Array:
    return np.sqrt((steps**2).sum(axis=1))


def sampled(path: Trajectory, times: Array) -> Array:
    """Task points of any trajectory at several times, (K, size)."""
    if isinstance(path, WaypointPath):
        return path.sample(times)[0]
    return np.array([path(float(t)).z for t in times])


def span(path: Trajectory) -> tuple[float, float]:
    """Start and end of a path [s]: one round where it repeats.

    Raises:
        InputError: It neither repeats nor ends.
    """
    first = path.times[0] if isinstance(path, (WaypointPath, Geodesic)) else path.begin
    start = float(getattr(path, "start", first))
    if math.isfinite(path.period):
        return start, start + path.period
    if math.isfinite(path.duration) and path.duration > start:
        return start, path.duration
    raise InputError("the path has neither a period nor an end; plan a path that repeats or ends")


def stretched(path: Trajectory, factor: float) -> Trajectory | None:
    """The same path at a slower pace; None for a function of the caller, which cannot be slowed down."""
    if isinstance(path, (WaypointPath, Geodesic)):
        start = path.times[0]
        return replace(path, times=start + factor * (path.times - start))
    if isinstance(path, Harmonic):
        return replace(path, period=factor * path.period, phase=factor * path.phase)
    if isinstance(path, Hold):
        return path
    if isinstance(path, ToleratedPath):
        slower = stretched(path.path, factor)
        return None if slower is None else ToleratedPath(path.task, slower)
    if isinstance(path, StackedTrajectory):
        parts = [stretched(part, factor) for part in path.parts]
        return None if None in parts else StackedTrajectory(tuple(part for part in parts if part is not None))
    return None


def about(
    task: Task, z: Array, shape: str, centre: VectorLike, size: float, plane: str | None, period: float
) -> Trajectory:
    """Circle or figure eight about a point, or line from it, for a task whose first coordinates are lengths.

    Args:
        task: The task.
        z: Task point whose other coordinates are kept, (size,).
        shape: `"circle"`, `"eight"` or `"line"`.
        centre: Centre, or the first end of a line [m].
        size: Radius, half width or length [m].
        plane: Plane, by default the horizontal one; one axis for a line.
        period: Time of one round [s].

    Raises:
        InputError: The task has no three lengths, or the plane is none.
    """
    if task.whole is not task:
        return ToleratedPath(task, about(task.whole, z, shape, centre, size, plane, period))
    width = len(task.lengths)
    if width < 2:
        raise InputError(f"{task!r} has no plane to draw a path in")
    middle = vector(centre, None, "the centre of the path")[:width]
    if shape == "line":
        axis = "xyz".find(plane or "y")
        if axis < 0 or axis >= width:
            raise InputError(f"a line runs along one of the axes {'xyz'[:width]!r}, got {plane!r}")
        path = line(middle, size * np.eye(width)[axis], period=period)
    elif shape == "circle":
        # It begins at the upper end of the plane's first axis.
        place = "xyz".find((plane or "xy")[0])
        offset = size * np.eye(width)[place] if 0 <= place < width else np.zeros(width)
        path = circle(middle + offset, size, period=period, plane=plane or "xy")
    else:
        path = figure_eight(middle, size, period=period, plane=plane or "xy")
    if z.size == width:
        return path
    return StackedTrajectory((path, Hold(z[width:], task.m - width)))
