"""Harmonic curves: lines, circles and figure eights."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    VectorLike,
    by_value,
    checked,
    frozen_copy,
    number,
    vector,
)
from eos_pin._kernels import plain_parts
from eos_pin._kernels.dispatch import use_compiled
from eos_pin.errors import InputError
from eos_pin.tasks.base import Point
from eos_pin.trajectories.base import Target, Trajectory

Curve = use_compiled(plain_parts.Curve)


@by_value
@checked
@dataclass(frozen=True, eq=False)
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
            object.__setattr__(self, name, frozen_copy(amplitudes))
        if self.sines.shape != self.cosines.shape:
            raise InputError(f"sines and cosines must have one shape, got {self.sines.shape} and {self.cosines.shape}")
        object.__setattr__(self, "center", frozen_copy(center))

    @property
    def waves(self) -> Waves:
        """The sum in the form in which it is computed."""
        return self._sum

    @cached_property
    def _sum(self) -> Waves:
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
        try:
            return self._sum.at(t)
        except TypeError:
            return self._sum.at(number(t, "t"))


@dataclass(frozen=True, eq=False)
class Waves:
    """Targets that are linear in sin ωt, cos ωt, sin 2ωt and so on, and 1: one product for z, dz and ddz together.

    Attributes:
        phase: Time by which the start is ahead [s].
        frequencies: ω, 2ω and so on [rad/s].
        z: Coefficients of z, a row for each of sin ωt, cos ωt, sin 2ωt and so on, and for 1.
        dz: Those of dz.
        ddz: Those of ddz.
    """

    phase: float
    frequencies: VectorLike
    z: Array
    dz: Array
    ddz: Array

    def __post_init__(self) -> None:
        # Read-only, because what is compiled has copies.
        for name in ("frequencies", "z", "dz", "ddz"):
            object.__setattr__(self, name, frozen_copy(np.asarray(getattr(self, name))))

    @property
    def blocks(self) -> tuple[Array, Array, Array]:
        """Coefficients of z, dz and ddz."""
        return self.z, self.dz, self.ddz

    @cached_property
    def _rows(self) -> Array:
        return np.hstack(self.blocks)

    @cached_property
    def _cuts(self) -> tuple[int, int]:
        return self.z.shape[1], self.z.shape[1] + self.dz.shape[1]

    @cached_property
    def at(self) -> Callable[[float], Target]:
        """The target at a time."""
        return Curve(self.phase, self.frequencies, self._rows, *self._cuts, Target)


@checked
def line(center: VectorLike, stroke: VectorLike, *, period: float) -> Harmonic:
    """To and fro on a straight line, from `center` to `center + stroke`, to `center − stroke` and back."""
    stroke = vector(stroke, None, "the stroke")
    return Harmonic(vector(center, stroke.size, "the center"), stroke[None], 0.0 * stroke[None], period)


@checked
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


@checked
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


def _in_plane(point: VectorLike, plane: str) -> tuple[Array, tuple[Array, Array]]:
    """The point as an array, and the unit vectors along the two axes of the plane."""
    array = vector(point, None, "the point")
    axes = ["xyz"[: array.size].find(axis) for axis in plane]
    if array.size not in (2, 3) or len(axes) != 2 or min(axes) < 0 or axes[0] == axes[1]:
        raise InputError(f"a plane is two of the axes {'xyz'[: array.size]!r}, such as 'xy'; got {plane!r}")
    basis = np.eye(array.size)
    return array, (basis[axes[0]], basis[axes[1]])
