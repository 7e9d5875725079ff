"""Points of a path at which joints are planned, and their names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from eos_pin._arrays import (
    Array,
    VectorLike,
    broadcast,
    listed,
    number,
)
from eos_pin.errors import InputError
from eos_pin.planning.plans import Plan
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import PointLike, Task
from eos_pin.trajectories.base import Target, Trajectory
from eos_pin.trajectories.through import WaypointPath, sampled, span, stretched, waypoint_path

#: Longest way between two points, in reaches of the robot and radians together, and between two layers of a search.
FINE, COARSE = 0.03, 0.09
#: Fewest and most points of a path that is a function of time.
FEWEST, MOST = 48, 4000
#: Part of the velocity limits that a path without a pace of its own may use; the limit where there is none [rad/s,
#: m/s].
PACE, UNLIMITED = 0.5, 1.0
#: Least time of a path without a pace of its own [s].
SHORTEST = 4.0


@dataclass(frozen=True, eq=False)
class Grid:
    """Points of a path.

    Attributes:
        task: The task.
        path: The path.
        times: Time of each point [s], (L,); of a closed path without the last, which is the first again.
        Z: Task points, (L, size).
        dt: Time from each point to the next, (L,); of an open path the last counts for nothing.
        closed: Whether the last point leads to the first.
        timed: Whether the path has a pace of its own.
        marks: Rows of the way points; empty for a path that is a function of time.
        count: Number of way points, or of points.
    """

    task: Task
    path: Trajectory
    times: Float[Array, " L"]
    Z: Float[Array, "L size"]
    dt: Float[Array, " L"]
    closed: bool
    timed: bool
    marks: Int[Array, " K"]
    count: int

    @property
    def stride(self) -> int:
        """Number of points from one layer of a first search to the next."""
        gaps = _gaps(self.task, self.Z, self.closed)
        stride = COARSE / max(float(np.median(gaps)), COARSE / len(self.Z))
        return max(1, min(int(stride), len(self.Z) // 16))

    def rows(self, stride: int) -> Int[Array, " l"]:
        """Every `stride`-th point, and the last of an open path."""
        last = len(self.Z) - (0 if self.closed else 1)
        count = max(1, math.ceil(last / stride))
        rows = np.unique(np.round(np.linspace(0, last, count + 1)).astype(int))
        return rows[:-1] if self.closed else rows

    def dt_between(self, rows: Int[Array, " l"]) -> Float[Array, " l"]:
        """Time from each of some points to the next of them."""
        return self.summed(self.dt[:, None], rows)[:, 0]

    def between(self, rows: Int[Array, " l"]) -> Float[Array, "l size"]:
        """Task points halfway from each of some points to the next of them; the last of an open path itself."""
        half = 0.5 * self.dt_between(rows)
        if not self.closed:
            half[-1] = 0.0
        return sampled(self.path, self.times[rows] + half)

    def summed(self, values: Float[Array, "L k"], rows: Int[Array, " l"]) -> Float[Array, "l k"]:
        """Sums of values from each of some points to the next of them."""
        return np.add.reduceat(values, rows, axis=0)

    def bounds(self, robot: Robot, joint_step: float | VectorLike | None, timed: bool) -> Float[Array, "L n"] | None:
        """Longest step of each joint from each point to the next; None without a bound."""
        bound = np.full((len(self.Z), robot.n), np.inf)
        if joint_step is not None:
            longest = broadcast(joint_step, robot.n, "the longest step of joints")
            if not (longest > 0.0).all():
                raise InputError(f"the longest step of joints must be positive, got {longest.tolist()}")
            bound = np.minimum(bound, longest / self._parts()[:, None])
        if timed:
            bound = np.minimum(bound, robot.velocity * self.dt[:, None])
        # Beyond a turn no bound is one.
        return np.minimum(bound, 2.0 * np.pi) if np.isfinite(bound).any() else None

    def _parts(self) -> Array:
        """Number of points on the way from each point's way point to the next."""
        if not len(self.marks):
            return np.ones(len(self.Z))
        ends = np.append(self.marks[1:], len(self.Z)) if self.closed else self.marks[1:]
        lengths = ends - self.marks[: len(ends)]
        parts = np.repeat(lengths, lengths).astype(float)
        return np.append(parts, np.ones(len(self.Z) - len(parts)))

    def knots(self, q: Float[Array, "L n"], again: Float[Array, " n"]) -> tuple[Array, Array]:
        """Times and joints of a plan; of a closed one those where it begins again come last."""
        if not self.closed:
            return self.times, q
        return np.append(self.times, self.times[0] + self.dt.sum()), np.concatenate((q, again[None]))

    def called(self, row: int) -> str:
        """A point in words."""
        row %= len(self.Z)
        if not len(self.marks):
            return f"the point at {self.times[row]:.4g} s"
        before = int(np.searchsorted(self.marks, row, side="right")) - 1
        if self.marks[before] == row:
            return f"way point {before}"
        ends = [*self.marks.tolist(), len(self.Z)]
        part = (row - ends[before]) / (ends[before + 1] - ends[before])
        return f"{part:.0%} of the way from way point {before} to {(before + 1) % self.count}"

    def waypoint(self, row: int) -> int:
        """Number of the way point at or before a point."""
        return int(np.searchsorted(self.marks, row, side="right")) - 1 if len(self.marks) else row

    def at_marks(self, q: Float[Array, "L n"]) -> Float[Array, "K n"]:
        """Joints at the way points, or at all points."""
        return q[self.marks] if len(self.marks) else q

    def slowed(self, plan: Plan) -> Plan:
        """A plan whose pace was not given, at half the velocity limits."""
        robot = plan.robot
        limit = np.where(np.isfinite(robot.velocity), robot.velocity, UNLIMITED)
        fastest = float((np.abs(np.diff(plan.q, axis=0)) / np.diff(plan.times)[:, None] / limit).max())
        length = plan.end - plan.start
        factor = max(fastest / PACE, SHORTEST / length)
        path = stretched(plan.path, factor)
        if path is None:
            return plan
        return replace(plan, path=path, times=plan.start + factor * (plan.times - plan.start))

    def opened(self) -> Grid:
        """One round of a closed path, which ends at its first point once more."""
        marks = np.append(self.marks, len(self.Z)) if len(self.marks) else self.marks
        times, dt = np.append(self.times, self.times[0] + self.dt.sum()), np.append(self.dt, self.dt[-1])
        Z, count = np.concatenate((self.Z, self.Z[:1])), self.count + 1
        return replace(self, times=times, Z=Z, dt=dt, closed=False, marks=marks, count=count)

    def smaller(self, factor: float) -> Grid:
        """The path shrunk towards its first point, orientations as they are."""
        path = _SmallerPath(self.path, factor, self.Z[0], lengths_of(self.task))
        return replace(self, path=path, Z=path.shrunk(self.Z))

    def finer(self, parts: int = 2) -> Grid:
        """The same path with more points."""
        steps = np.arange(parts) / parts
        last = len(self.Z) if self.closed else len(self.Z) - 1
        times = (self.times[:last, None] + steps * self.dt[:last, None]).ravel()
        dt = np.repeat(self.dt[:last] / parts, parts)
        if not self.closed:
            times, dt = np.append(times, self.times[-1]), np.append(dt, self.dt[-1])
        return replace(self, times=times, Z=sampled(self.path, times), dt=dt, marks=self.marks * parts)


@dataclass(frozen=True, eq=False)
class _SmallerPath(Trajectory):
    """A path whose first coordinates, lengths, are shrunk towards a point."""

    path: Trajectory
    factor: float
    point: Array
    lengths: int

    def __call__(self, t: float) -> Target:
        z, dz, ddz = self.path(t)
        k, part = self.lengths, np.ones(len(dz))
        part[:k] = self.factor
        return Target(self.shrunk(z[None])[0], part * dz, part * ddz)

    def shrunk(self, Z: Float[Array, "L size"]) -> Float[Array, "L size"]:
        k, shrunk = self.lengths, Z.copy()
        shrunk[:, :k] = self.point[:k] + self.factor * (Z[:, :k] - self.point[:k])
        return shrunk


def lengths_of(task: Task) -> int:
    """Number of first coordinates of a task's points that are lengths."""
    return next((i for i, unit in enumerate(task.units) if unit != "m"), task.m)


def grid_of(
    task: Task,
    path: Trajectory | Sequence[PointLike] | Array,
    *,
    closed: bool | None = None,
    times: VectorLike | None = None,
) -> Grid:
    """Points of a path, close enough together for the joints between them to be clear.

    Raises:
        InputError: The path cannot be used.
    """
    timed = times is not None or isinstance(path, Trajectory)
    if not isinstance(path, Trajectory):
        rows = path if isinstance(path, np.ndarray) else listed(path, "a path of way points")
        path = waypoint_path(task, rows, times, closed=bool(closed))
    elif times is not None:
        raise InputError("times are for way points, a trajectory has its own; leave them out")
    start, end = span(path)
    if closed is None:
        closed = math.isfinite(path.period)
    if closed and not math.isfinite(path.period):
        gap = float(np.linalg.norm(task.minus(task.point(path(end).z), task.point(path(start).z))))
        raise InputError(
            f"the path is to be closed, but it does not repeat; its end is {gap:.3g} m or rad away from its start"
        )
    if isinstance(path, WaypointPath):
        timed = times is not None
        return _through(task, path, closed, timed)
    number(end - start, "the length of the path in time", above=0.0)
    trial = np.linspace(start, end, 4 * FEWEST + 1)
    Z = np.array([task.point(path(float(t)).z) for t in trial])
    longest = float(_gaps(task, Z, False).max()) * 4 * FEWEST
    count = int(np.clip(math.ceil(longest / FINE), FEWEST, MOST))
    clock = np.linspace(start, end, count + 1)
    if closed:
        clock = clock[:-1]
    dt = np.full(len(clock), (end - start) / count)
    return Grid(task, path, clock, sampled(path, clock), dt, closed, timed, np.empty(0, int), len(clock))


def _through(task: Task, path: WaypointPath, closed: bool, timed: bool) -> Grid:
    gaps = _gaps(task, np.asarray(path.points), False)
    parts = np.maximum(1, np.ceil(gaps / (2.0 * FINE)).astype(int))
    # A path of few way points gets as many points as one that is a function of time.
    parts = np.maximum(parts, math.ceil(FEWEST / len(parts)) if len(parts) < FEWEST // 2 else 1)
    pieces = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(path.times, path.times[1:], parts, strict=False)]
    clock = np.concatenate(pieces)
    ends = np.append(clock, path.times[-1])
    marks = np.concatenate(([0], np.cumsum(parts)))
    if closed:
        return Grid(task, path, clock, sampled(path, clock), np.diff(ends), True, timed, marks[:-1], len(marks) - 1)
    dt = np.append(np.diff(ends), float(np.diff(ends)[-1]))
    return Grid(task, path, ends, sampled(path, ends), dt, False, timed, marks, len(marks))


def _gaps(task: Task, Z: Float[Array, "L size"], closed: bool) -> Array:
    """Way from each point to the next, in reaches of the robot and radians together."""
    following = np.roll(Z, -1, axis=0) if closed else Z[1:]
    steps = task.kinematics.minus(following, Z[: len(following)])
    scale = np.array([1.0 / task.robot.reach if unit == "m" else 1.0 for unit in task.units])
    return np.linalg.norm(steps * scale, axis=1)
