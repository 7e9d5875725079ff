"""Curves to follow: circles, figure eights, splines, geodesics, and several side by side."""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin.arrays import Array, VectorLike, number, readonly, vector
from eos_pin.compiled import kernels
from eos_pin.errors import InputError
from eos_pin.targets import Hold, Target, Trajectory
from eos_pin.tasks import Point, Task


@dataclass(frozen=True)
class Harmonic(Trajectory):
    """Sum of sines and cosines: z = center + Σ_k (sines[k−1] sin kωt + cosines[k−1] cos kωt), ω = 2π / period.

    Attributes:
        center: Constant part, (m,).
        sines: Amplitudes of sin kωt, (K, m).
        cosines: Amplitudes of cos kωt, (K, m).
        period: Time of one turn [s].
        phase: Time by which the start is ahead [s].
    """

    center: Point
    sines: Float[Array, "K m"]
    cosines: Float[Array, "K m"]
    period: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        number(self.period, "the period", above=0.0)
        center = vector(self.center, None, "the center")
        for name in ("sines", "cosines"):
            amplitudes = np.asarray(getattr(self, name), dtype=float)
            if amplitudes.ndim != 2 or amplitudes.shape[1] != center.size or not np.isfinite(amplitudes).all():
                raise InputError(f"{name} must be finite and of shape (K, {center.size}), got shape {amplitudes.shape}")
            object.__setattr__(self, name, readonly(amplitudes))
        if self.sines.shape != self.cosines.shape:
            raise InputError(f"sines and cosines must be as many, got {self.sines.shape} and {self.cosines.shape}")
        object.__setattr__(self, "center", readonly(center))

    @cached_property
    def waves(self) -> Waves:
        """The sum in the form in which it is computed."""
        frequencies = [math.tau * (k + 1) / self.period for k in range(len(self.sines))]
        z, dz, ddz = [], [], []
        for omega, a, b in zip(frequencies, self.sines, self.cosines, strict=True):
            z += [a, b]
            dz += [-omega * b, omega * a]
            ddz += [-(omega**2) * a, -(omega**2) * b]
        rest = np.zeros(self.center.size)
        return Waves(
            self.phase, frequencies, np.array([*z, self.center]), np.array([*dz, rest]), np.array([*ddz, rest])
        )

    def __call__(self, t: float) -> Target:
        return self.waves.at(t)


class Waves:
    """Targets that are linear in sin ωt, cos ωt, sin 2ωt and so on, and 1: one product for z, dz and ddz together.

    Args:
        phase: Time by which the start is ahead [s].
        frequencies: ω, 2ω and so on [rad/s].
        z: Coefficients of z, a row for each of sin ωt, cos ωt, sin 2ωt and so on, and for 1.
        dz: Those of dz.
        ddz: Those of ddz.
    """

    def __init__(self, phase: float, frequencies: VectorLike, z: Array, dz: Array, ddz: Array) -> None:
        self.phase, self.frequencies, self.blocks = phase, np.array(frequencies, dtype=float), (z, dz, ddz)
        self._rows = np.hstack(self.blocks)
        self._cuts = z.shape[1], z.shape[1] + dz.shape[1]

        self.at: Callable[[float], Target] = self.readable
        if kernels:
            self.at = kernels.Curve(phase, self.frequencies, self._rows, *self._cuts, Target)

    def readable(self, t: float) -> Target:
        """Target at time t; what is compiled does the same."""
        angles = (self.frequencies * (t + self.phase)).tolist()
        together = np.dot([wave for angle in angles for wave in (math.sin(angle), math.cos(angle))] + [1.0], self._rows)
        return Target(*np.split(together, self._cuts))


def line(center: VectorLike, stroke: VectorLike, *, period: float) -> Harmonic:
    """To and fro on a straight line, from `center` to `center + stroke`, to `center − stroke` and back."""
    stroke = vector(stroke, None, "the stroke")
    return Harmonic(vector(center, stroke.size, "the center"), stroke[None], 0.0 * stroke[None], period)


def circle(start: VectorLike, radius: float, *, period: float, plane: str = "xy") -> Harmonic:
    """Circle that begins and ends at `start`, with its centre at the lower end of the plane's first axis.

    Args:
        start: First point, (2,) or (3,) [m].
        radius: Radius [m].
        period: Time of one turn [s].
        plane: Plane of the circle, such as `"yz"`.
    """
    start, (a, b) = _in_plane(start, plane)
    radius = number(radius, "the radius", above=0.0)
    return Harmonic(start - radius * a, radius * b[None], radius * a[None], period)


def figure_eight(
    center: VectorLike,
    size: float | tuple[float, float] = 1.0,
    *,
    period: float = math.tau,
    plane: str = "xy",
) -> Harmonic:
    """The paper's figure eight, z = center + (a sin ωt, b sin ωt cos ωt); Eqs. (34), (42).

    Args:
        center: Crossing point, where it begins, (2,) or (3,) [m].
        size: Half width a and b, or one number for both [m].
        period: Time of one round [s].
        plane: Plane of the curve, such as `"yz"`.
    """
    center, (a, b) = _in_plane(center, plane)
    width, height = (number(s, "the size", above=0.0) for s in (size if isinstance(size, tuple) else (size, size)))
    # sin x cos x = ½ sin 2x
    sines = np.stack((width * a, 0.5 * height * b))
    return Harmonic(center, sines, np.zeros_like(sines), period)


@dataclass(frozen=True, eq=False)
class Spline(Trajectory):
    """A smooth curve through points of a vector task; it rests at its end, or repeats if it is closed.

    Made by `minimum_jerk`, `cubic_spline` and `spline_from_csv`.

    Attributes:
        curve: A piecewise polynomial of SciPy with values (m,).
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
            object.__setattr__(self, "duration", self.end)

    @cached_property
    def _derivatives(self) -> tuple[Any, Any, Any]:
        return self.curve, self.curve.derivative(1), self.curve.derivative(2)

    def __call__(self, t: float) -> Target:
        if self.closed:
            t = self.start + (t - self.start) % (self.end - self.start)
        z, dz, ddz = (d(min(max(t, self.start), self.end)) for d in self._derivatives)
        if not self.closed and not self.start <= t < self.end:
            return Target(z, 0.0 * dz, 0.0 * ddz)
        return Target(z, dz, ddz)


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


def spline_from_csv(path: str | Path) -> Spline:
    """Cubic spline through the rows `t, z1, …, zm` of a CSV file; a first row of names is skipped.

    Raises:
        InputError: The file cannot be read, a row is not numbers, or the times do not increase. It names the line.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [(i, row) for i, row in enumerate(csv.reader(file), 1) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot read the path {path}: {error}") from error
    rows: list[list[float]] = []
    for i, row in lines:
        try:
            rows.append([float(cell) for cell in row])
        except ValueError:
            if rows or i > lines[0][0]:
                raise InputError(f"{path}, line {i}: every entry must be a number, got {row}") from None
            continue
        if len(row) != len(rows[0]) or len(row) < 2:
            raise InputError(
                f"{path}, line {i}: expected {max(len(rows[0]), 2)} columns (t, z1, …, zm), got {len(row)}"
            )
        if not np.isfinite(rows[-1]).all():
            raise InputError(f"{path}, line {i}: every entry must be finite, got {row}")
        if len(rows) > 1 and not rows[-1][0] > rows[-2][0]:
            raise InputError(f"{path}, line {i}: the times must increase, got {rows[-1][0]} after {rows[-2][0]}")
    if len(rows) < 2:
        raise InputError(f"{path}: a path needs at least two rows t, z1, …, zm; found {len(rows)}")
    table = np.array(rows)
    return cubic_spline(table[:, 1:], table[:, 0])


@dataclass(frozen=True, eq=False)
class Geodesic(Trajectory):
    """Straight lines of the task's own group from point to point, each at rest at both ends (minimum jerk).

    For a pose this is the geodesic of SE(3): the origin on a straight line, the rotation about a constant axis.

    Attributes:
        task: Task whose `plus` and `minus` define the lines.
        points: Points, (K, size), K ≥ 2.
        times: Increasing times [s], (K,).
    """

    task: Task
    points: Float[Array, "K size"]
    times: Float[Array, " K"]

    def __post_init__(self) -> None:
        points, times = _knots([self.task.point(p) for p in self.points], self.times)
        object.__setattr__(self, "points", readonly(points))
        object.__setattr__(self, "times", readonly(times))
        object.__setattr__(self, "duration", float(times[-1]))
        steps = [self.task.minus(b, a) for a, b in pairwise(points)]
        object.__setattr__(self, "_steps", steps)

    def __call__(self, t: float) -> Target:
        times = self.times
        k = min(max(bisect_right(times, t) - 1, 0), len(times) - 2)
        T = times[k + 1] - times[k]
        s = min(max((t - times[k]) / T, 0.0), 1.0)
        step = self._steps[k]  # type: ignore[attr-defined]
        # 10 s³ − 15 s⁴ + 6 s⁵ and its derivatives; the axis of rotation is constant, so dz is along the step.
        z = self.task.plus(self.points[k], (s**3 * (10 + s * (-15 + 6 * s))) * step)
        return Target(z, (30 * (s * (1 - s)) ** 2 / T) * step, (60 * s * (1 - s) * (1 - 2 * s) / T**2) * step)


@dataclass(frozen=True, eq=False)
class StackedTrajectory(Trajectory):
    """Targets of several tasks one after the other, for a `StackedTask`, or position and orientation of a pose.

    Attributes:
        parts: The trajectories; their periods must agree where they are finite.
    """

    parts: tuple[Trajectory, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        if not self.parts:
            raise InputError("a stacked trajectory needs at least one part")
        periods = sorted({part.period for part in self.parts if part.period < math.inf})
        if len(periods) > 1:
            raise InputError(f"the parts of a stacked trajectory repeat after different times: {periods} s")
        moving = any(part.duration == math.inf and part.period == math.inf for part in self.parts)
        object.__setattr__(self, "period", periods[0] if periods and not moving else math.inf)
        object.__setattr__(self, "duration", max(part.duration for part in self.parts))

    def __call__(self, t: float) -> Target:
        if self._waves is not None:
            return self._waves.at(t)
        z, dz, ddz = zip(*(part(t) for part in self.parts), strict=True)
        return Target(np.concatenate(z), np.concatenate(dz), np.concatenate(ddz))

    @cached_property
    def _waves(self) -> Waves | None:
        """All parts in one, where one of them moves and the others are at rest; the everyday case."""
        moving = [part for part in self.parts if not isinstance(part, Hold)]
        if len(moving) != 1 or not isinstance(moving[0], Harmonic):
            return None
        own = moving[0].waves
        one = np.eye(len(own.blocks[0]))[:, -1]
        parts = [own.blocks if p is moving[0] else [np.outer(one, row) for row in p(0.0)] for p in self.parts]
        return Waves(own.phase, own.frequencies, *map(np.hstack, zip(*parts, strict=True)))


def _in_plane(point: VectorLike, plane: str) -> tuple[Array, tuple[Array, Array]]:
    """The point as an array, and the unit vectors along the two axes of the plane."""
    array = vector(point, None, "the point")
    axes = ["xyz"[: array.size].find(axis) for axis in plane]
    if array.size not in (2, 3) or len(axes) != 2 or min(axes) < 0 or axes[0] == axes[1]:
        raise InputError(f"a plane is two of the axes {'xyz'[: array.size]!r}, such as 'xy'; got {plane!r}")
    basis = np.eye(array.size)
    return array, (basis[axes[0]], basis[axes[1]])


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
