"""Curves through given points: splines of vectors and of rotations, and the geodesics of a task's own group."""

from __future__ import annotations

from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    TaskVector,
    Vector,
    VectorLike,
    as_floats,
    by_value,
    checked,
    frozen_copy,
    listed,
    number,
    of_type,
    vector,
)
from eos_pin.errors import InputError, renamed
from eos_pin.tasks._flat import PointLike, checked_pose
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Target, Trajectory
from eos_pin.trajectories.pose import PoseTrajectory
from eos_pin.trajectories.waypoints import Waypoints, read_waypoints

#: Where the quaternions of a spline get as short as this between two rotations, it is no curve that anybody means.
SHORT = 0.4
#: Part of a line over which the turning of axes is differenced, to fourth order.
TURN = 1e-3


@dataclass(frozen=True, eq=False)
class _SplineTrajectory(Trajectory):
    """A curve by a piecewise polynomial of SciPy; it rests at its end, or repeats if it is closed.

    Attributes:
        curve: The polynomial.
        start: Time of its first point [s].
        end: Time of its last point [s].
        closed: Whether it repeats.
    """

    curve: Any
    start: float
    end: float
    closed: bool = False

    def __post_init__(self) -> None:
        if self.closed:
            object.__setattr__(self, "period", self.end - self.start)
        else:
            object.__setattr__(self, "begin", self.start)
            object.__setattr__(self, "duration", self.end)

    @cached_property
    def _derivatives(self) -> tuple[Any, Any, Any]:
        return self.curve, self.curve.derivative(1), self.curve.derivative(2)

    def __call__(self, t: float) -> Target:
        if self.closed:
            t = self.start + (t - self.start) % (self.end - self.start)
        target = self._target(*(derivative(min(max(t, self.start), self.end)) for derivative in self._derivatives))
        if not self.closed and not self.start <= t < self.end:
            return Target(target.z, 0.0 * target.dz, 0.0 * target.ddz)
        return target

    @abstractmethod
    def _target(self, p: Vector, dp: Vector, ddp: Vector) -> Target:
        """Target for the polynomial's value and its first two derivatives."""


@by_value
class Spline(_SplineTrajectory):
    """A smooth curve through points of a vector task; it rests at its end, or repeats if it is closed.

    Made by `minimum_jerk`, `cubic_spline` and `spline_from_csv`. Its polynomial has values (m,).
    """

    def _target(self, p: Vector, dp: Vector, ddp: Vector) -> Target:
        return Target(p, dp, ddp)


@checked
def minimum_jerk(points: Sequence[VectorLike] | Array, times: VectorLike) -> Spline:
    """Curve through `points` at `times` with the least integral of squared jerk, at rest at both ends.

    Args:
        points: Points of a vector task, (K, m), K ≥ 2.
        times: Increasing times [s], (K,).
    """
    from scipy.interpolate import make_interp_spline

    points, times = _knots(points, times)
    rest = np.zeros(points.shape[1])
    # The minimizer is the quintic spline with velocity and acceleration given at its ends.
    ends = [(1, rest), (2, rest)]
    return Spline(make_interp_spline(times, points, k=5, bc_type=(ends, ends)), float(times[0]), float(times[-1]))


@checked
def cubic_spline(points: Sequence[VectorLike] | Array, times: VectorLike, *, closed: bool | None = None) -> Spline:
    """Cubic spline through `points` at `times`, twice continuously differentiable.

    Args:
        points: Points of a vector task, (K, m), K ≥ 2.
        times: Increasing times [s], (K,).
        closed: Whether it repeats; by default if its first and last point are equal. An open one rests at its ends.
    """
    from scipy.interpolate import CubicSpline

    points, times = _knots(points, times)
    if closed is None:
        closed = len(points) > 2 and np.array_equal(points[0], points[-1])
    elif closed and not np.array_equal(points[0], points[-1]):
        raise InputError(f"the first and last point of a closed path must be equal, got {points[0]} and {points[-1]}")
    curve = CubicSpline(times, points, bc_type="periodic" if closed else "clamped")
    return Spline(curve, float(times[0]), float(times[-1]), closed)


@checked
def spline_from_csv(path: str | Path) -> Spline:
    """Cubic spline of a vector task through the rows of a text file; `path_from_csv` is the same for any task.

    Columns are t, and x, y, z or z1, …, zm; see `eos_pin.trajectories.waypoints`. Times are counted from the first.

    Raises:
        InputError: The file cannot be used. It names the line.
    """
    table = read_waypoints(path)
    columns = [table.values, table.position, None if table.heading is None else table.heading[:, None]]
    if table.t is None or table.rotation is not None:
        raise InputError(
            f"{path}: a spline of a vector takes columns t, and x, y, z or z1, …, zm, got {', '.join(table.columns)}. "
            "path_from_csv also takes poses, and chooses times that are not given"
        )
    check_rows(table)
    spline = cubic_spline(np.hstack([block for block in columns if block is not None]), table.t)
    object.__setattr__(spline, "notes", shifted(table))
    return spline


def check_rows(table: Waypoints) -> None:
    """Refuse a table of one row where a path is meant."""
    if len(table) < 2:
        raise InputError(f"{table.source}: a path needs at least two rows; found {len(table)}")


def shifted(table: Waypoints) -> tuple[str, ...]:
    """Note that the times of a file are counted from the first, if that changes them."""
    if not table.start:
        return ()
    return (f"the times of {table.source} begin at {table.start:.10g} s; they are counted from there",)


@by_value
class RotationSpline(_SplineTrajectory):
    """A smooth curve through rotations, for a task of orientation; it rests at its end, or repeats if it is closed.

    It is the cubic spline through the quaternions, projected to length 1: R, angular velocity and angular acceleration
    are continuous, and the curve does not depend on the axes of the world or of the frame. Made by `rotation_spline`.
    Its polynomial is one of quaternions (x, y, z, w), not normalized.
    """

    def _target(self, p: Vector, dp: Vector, ddp: Vector) -> Target:
        return Target(*rotations_along(p, dp, ddp))


@checked
def rotation_spline(
    rotations: Sequence[Array] | Array, times: VectorLike, *, closed: bool | None = None
) -> RotationSpline:
    """Smooth curve through rotations at given times, twice continuously differentiable.

    From one rotation to the next it takes the shorter way.

    Args:
        rotations: Rotation matrices, (K, 3, 3) or row by row (K, 9), K ≥ 2.
        times: Increasing times [s], (K,).
        closed: Whether it repeats; by default if its first and last rotation are equal. An open one rests at its ends.

    Raises:
        InputError: No rotations, or so far apart that the curve between them is not clear.
    """
    from scipy.interpolate import CubicSpline

    array = as_floats(listed(rotations, "rotations"), "the rotations of a path")
    if array.size != 9 * len(array):
        raise InputError(f"the rotations of a path are matrices (K, 3, 3) or rows (K, 9), got shape {array.shape}")
    flat, times = _knots(array.reshape(-1, 9), times)
    R = flat.reshape(-1, 3, 3)
    if np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max() > 1e-6 or not (np.linalg.det(R) > 0.0).all():
        raise InputError("the rotations of a path must have orthonormal columns and determinant 1")
    points = unrolled(flat)
    returns = float(points[0].dot(points[-1]))
    equal = abs(returns) > 1.0 - 1e-14
    if closed is None:
        closed = len(points) > 2 and equal
    elif closed and not equal:
        raise InputError("the first and last rotation of a closed path must be equal")
    if closed:
        # After a full turn the quaternion has the other sign, and only after two the same.
        second = np.sign(returns) * points
        knots = np.concatenate((times, times[-1] + times[1:] - times[0]))
        cycle = np.concatenate((points[:-1], second[:-1], points[:1]))
        curve = CubicSpline(knots, cycle, bc_type="periodic")
    else:
        curve = CubicSpline(times, points, bc_type="clamped")
    between = np.linspace(times[:-1], times[1:], 9)
    shortest = np.linalg.norm(curve(between), axis=-1).min(axis=0)
    if shortest.min() < SHORT:
        k = int(shortest.argmin())
        raise InputError(
            f"the rotations at {times[k]:g} s and {times[k + 1]:g} s and those around them are too far apart to "
            "determine the turn from one to the next; put others between them"
        )
    return RotationSpline(curve, float(times[0]), float(times[-1]), closed)


@renamed(positions="poses", rotations="poses")
@checked
def pose_spline(poses: Sequence[PointLike] | Array, times: VectorLike, *, closed: bool | None = None) -> PoseTrajectory:
    """Smooth curve through poses at given times, for a `PoseTask`, twice continuously differentiable.

    Args:
        poses: Poses, each a `pin.SE3`, a 4 × 4 matrix or a task point of a `PoseTask`; K ≥ 2 of them.
        times: Increasing times [s], (K,).
        closed: Whether it repeats; by default if its first and last pose are equal. An open one rests at its ends.

    Raises:
        InputError: Not poses, or their rotations too far apart.
    """
    points = np.array([checked_pose(pose, f"pose {k}") for k, pose in enumerate(listed(poses, "poses"))]).reshape(
        -1, 12
    )
    positions, rotations = points[:, :3], points[:, 3:]
    place, turn = cubic_spline(positions, times, closed=closed), rotation_spline(rotations, times, closed=closed)
    if place.closed != turn.closed:
        place, turn = cubic_spline(positions, times, closed=False), rotation_spline(rotations, times, closed=False)
    return PoseTrajectory(place, turn)


@by_value
@dataclass(frozen=True, eq=False)
class Geodesic(Trajectory):
    """Straight lines of the task's own group from point to point, each at rest at both ends (minimum jerk).

    For a pose this is the geodesic of SE(3): the origin on a straight line, the rotation about a constant axis.

    Attributes:
        task: Task whose `plus` and `minus` define the lines.
        points: Points, (K, size), K ≥ 2.
        times: Increasing times [s], (K,).
        closed: Whether it repeats; the last point is then the first again.
    """

    task: Task
    points: Float[Array, "K size"]
    times: Float[Array, " K"]
    closed: bool = False

    def __post_init__(self) -> None:
        of_type(self.task, "task", Task)
        of_type(self.closed, "closed", bool)
        points, times = _knots([self.task.point(p) for p in listed(self.points, "points")], self.times)
        object.__setattr__(self, "points", frozen_copy(points))
        object.__setattr__(self, "times", frozen_copy(times))
        if self.closed:
            gap = float(np.abs(self.task._minus(points[-1], points[0])).max())
            if gap > 1e-9:
                raise InputError(
                    f"the first and last point of a closed path must be equal, but they are {gap:.3g} apart"
                )
            object.__setattr__(self, "period", float(times[-1] - times[0]))
        else:
            object.__setattr__(self, "begin", float(times[0]))
            object.__setattr__(self, "duration", float(times[-1]))
        steps = [self.task._minus(b, a) for a, b in pairwise(points)]
        object.__setattr__(self, "_steps", steps)

    def __call__(self, t: float) -> Target:
        times, t = self.times, t if type(t) is float else number(t, "t")
        if self.closed:
            t = times[0] + (t - times[0]) % self.period
        k = min(max(bisect_right(times, t) - 1, 0), len(times) - 2)
        T = times[k + 1] - times[k]
        s = min(max((t - times[k]) / T, 0.0), 1.0)
        step = self._steps[k]  # type: ignore[attr-defined]
        # 10 s³ − 15 s⁴ + 6 s⁵ and its derivatives; the axis of rotation is constant, so dz is along the step.
        way = s**3 * (10 + s * (-15 + 6 * s))
        rate, bend = 30 * (s * (1 - s)) ** 2 / T, 60 * s * (1 - s) * (1 - 2 * s) / T**2
        z = self.task._plus(self.points[k], way * step)
        if not self.task.is_curved:
            return Target(z, rate * step, bend * step)
        # The axes of dz turn along the line, at a rate that is the slope of what they make of the step.
        ahead, behind = (
            8.0 * self._along(k, way + side * TURN) - self._along(k, way + 2.0 * side * TURN) for side in (1.0, -1.0)
        )
        along = self._along(k, way)
        return Target(z, rate * along, bend * along + rate**2 * (ahead - behind) / (12.0 * TURN))

    def _along(self, k: int, way: float) -> TaskVector:
        """Velocity in the axes of the point at a part of line k whose local coordinates grow by the whole step."""
        task, start, step = self.task, self.points[k], self._steps[k]  # type: ignore[attr-defined]
        columns = [task._local_rate(way * step, unit, start) for unit in np.eye(task.m)]
        return np.linalg.solve(np.array(columns).T, step)


def _knots(points: Sequence[VectorLike] | Array, times: VectorLike) -> tuple[Array, Array]:
    try:
        array = np.array([np.asarray(p, dtype=float) for p in points])
    except (TypeError, ValueError) as error:
        raise InputError(f"the points of a path must be rows of equally many numbers: {error}") from error
    if array.ndim != 2 or len(array) < 2 or not np.isfinite(array).all():
        raise InputError(f"a path needs at least two finite points as rows, got shape {array.shape}")
    knots = vector(times, len(array), "the times of a path")
    if not (np.diff(knots) > 0.0).all():
        raise InputError(f"the times of a path must increase, got {knots.tolist()}")
    return array, knots


def unrolled(rotations: Float[Array, "K 9"]) -> Float[Array, "K 4"]:
    """Quaternions (x, y, z, w) of rotation matrices; of q and −q, the same rotation, the one nearer to that before."""
    from scipy.spatial.transform import Rotation

    # SciPy 1.13 takes no arrays that are read-only.
    quaternions = Rotation.from_matrix(np.reshape(rotations, (-1, 3, 3)).copy()).as_quat()
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(flips)[:, None]
    return quaternions


def rotations_along(
    p: Float[Array, "*K 4"], dp: Float[Array, "*K 4"], ddp: Float[Array, "*K 4"]
) -> tuple[Float[Array, "*K 9"], Float[Array, "*K 3"], Float[Array, "*K 3"]]:
    """Rotation matrices row by row, angular velocities and accelerations, of quaternions (x, y, z, w) of any length.

    Args:
        p: Quaternions, of one time or of several.
        dp: Their rates.
        ddp: The rates of these.
    """
    # Of one time plain numbers are faster than arrays of one number each.
    x, y, z, w = p.tolist() if p.ndim == 1 else p.T
    a, b, c, d = dp.tolist() if p.ndim == 1 else dp.T
    e, f, g, h = ddp.tolist() if p.ndim == 1 else ddp.T
    s = 2.0 / (x * x + y * y + z * z + w * w)
    R = (
        1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y),
    )  # fmt: skip
    # Twice the vector part of dp p̄ over |p|².
    i, j, k = (
        s * (w * a - x * d - b * z + c * y),
        s * (w * b - y * d - c * x + a * z),
        s * (w * c - z * d - a * y + b * x),
    )
    # The vector part of dp p̄ has the derivative ddp p̄, because that of dp times its own conjugate is zero.
    slope = s * (x * a + y * b + z * c + w * d)
    alpha = (
        s * (w * e - x * h - f * z + g * y) - slope * i,
        s * (w * f - y * h - g * x + e * z) - slope * j,
        s * (w * g - z * h - e * y + f * x) - slope * k,
    )
    return np.array(R).T, np.array((i, j, k)).T, np.array(alpha).T


def cubic_at(knots: Float[Array, " K"], cubics: Float[Array, "k 4 width"], t: float) -> Float[Array, "3 width"]:
    """Values, first and second derivatives of cubics, highest power first, from each of some knots to the next."""
    k = min(max(int(knots.searchsorted(t, "right")) - 1, 0), len(knots) - 2)
    x = t - knots.item(k)
    powers = np.array(((x * x * x, x * x, x, 1.0), (3.0 * x * x, 2.0 * x, 1.0, 0.0), (6.0 * x, 2.0, 0.0, 0.0)))
    return np.asarray(powers.dot(cubics[k]))


def cubics_at(
    knots: Float[Array, " K"], cubics: Float[Array, "k 4 width"], t: Float[Array, " T"]
) -> Float[Array, "3 T width"]:
    """The same at several times."""
    k = np.clip(knots.searchsorted(t, "right") - 1, 0, len(knots) - 2)
    x = (t - knots[k])[:, None]
    a, b, c, d = cubics[k].transpose(1, 0, 2)
    return np.array((((a * x + b) * x + c) * x + d, (3.0 * a * x + 2.0 * b) * x + c, 6.0 * a * x + 2.0 * b))
