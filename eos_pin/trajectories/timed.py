"""A task path in another time: the place on it as a smooth function of time, by nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eos_pin._arrays import Array, Vector, by_value, frozen_copy
from eos_pin.errors import InputError
from eos_pin.trajectories.base import Target, Trajectory


@by_value
@dataclass(frozen=True, eq=False)
class Pace:
    """Place on a path as a function of time, with continuous speed and acceleration: a quintic between two nodes.

    Attributes:
        times: Times of the nodes [s], increasing, (K,).
        places: Place on the path, as its own time [s], increasing, (K,).
        speeds: Change of the place over time, 1 for the path's own time, (K,).
        accelerations: Change of the speed [1/s], (K,).
    """

    times: Vector
    places: Vector
    speeds: Vector
    accelerations: Vector

    def __post_init__(self) -> None:
        rows = [frozen_copy(np.asarray(row, dtype=float)) for row in self._rows]
        for name, row in zip(("times", "places", "speeds", "accelerations"), rows, strict=True):
            object.__setattr__(self, name, row)
        count = self.times.size
        if count < 2 or any(row.shape != (count,) or not np.isfinite(row).all() for row in rows):
            raise InputError("a pace needs times, places, speeds and accelerations of at least two nodes, equally many")
        if not (np.diff(self.times) > 0.0).all() or not (np.diff(self.places) > 0.0).all() or (self.speeds < 0.0).any():
            raise InputError("times and places of a pace must increase from node to node, and no speed may be negative")

    @property
    def _rows(self) -> tuple[Array, Array, Array, Array]:
        return self.times, self.places, self.speeds, self.accelerations

    @cached_property
    def _coefficients(self) -> Array:
        """Of each piece, for falling powers of the time since its first node, (K − 1, 6)."""
        h = np.diff(self.times)
        x, v, a = self.places, self.speeds, self.accelerations
        # What is left of place, speed and acceleration at the second node beyond the parabola of the first.
        place = np.diff(x) - h * (v[:-1] + 0.5 * h * a[:-1])
        speed = h * (np.diff(v) - h * a[:-1])
        bend = h * h * np.diff(a)
        c3 = 10.0 * place - 4.0 * speed + 0.5 * bend
        c4 = -15.0 * place + 7.0 * speed - bend
        c5 = 6.0 * place - 3.0 * speed + 0.5 * bend
        return np.stack((c5 / h**5, c4 / h**4, c3 / h**3, 0.5 * a[:-1], v[:-1], x[:-1]), axis=1)

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Place, speed and acceleration at time t; before the first node and after the last one those there."""
        k = min(max(int(np.searchsorted(self.times, t, side="right")) - 1, 0), len(self.times) - 2)
        x = min(max(t, float(self.times[0])), float(self.times[-1])) - float(self.times[k])
        c5, c4, c3, c2, c1, c0 = self._coefficients[k].tolist()
        place = ((((c5 * x + c4) * x + c3) * x + c2) * x + c1) * x + c0
        speed = (((5.0 * c5 * x + 4.0 * c4) * x + 3.0 * c3) * x + 2.0 * c2) * x + c1
        return place, speed, ((20.0 * c5 * x + 12.0 * c4) * x + 6.0 * c3) * x + 2.0 * c2

    def place(self, times: Array) -> Array:
        """Places at many times."""
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        x = np.clip(times, self.times[0], self.times[-1]) - self.times[k]
        total = np.zeros_like(x)
        for column in self._coefficients[k].T:
            total = total * x + column
        return total

    def time(self, places: Array) -> Array:
        """Times at many places, by bisection to rounding."""
        k = np.clip(np.searchsorted(self.places, places, side="right") - 1, 0, len(self.times) - 2)
        low, high = self.times[k], self.times[k + 1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            below = self.place(middle) < places
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        # At a node its own time, exactly.
        found = np.where(places == self.places[k], self.times[k], 0.5 * (low + high))
        return np.where(places >= self.places[-1], self.times[-1], found)

    def slowed(self, factor: float) -> Pace:
        """The same pace, all times from the first on multiplied by a factor."""
        start = self.times[0]
        times = start + factor * (self.times - start)
        return Pace(times, self.places, self.speeds / factor, self.accelerations / factor**2)


@by_value
@dataclass(frozen=True, eq=False)
class TimedPath(Trajectory):
    """A task path in another time.

    Attributes:
        path: The path in its own time.
        pace: Place on it over time; of a path that repeats, one round of it.
    """

    path: Trajectory
    pace: Pace

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", float(self.pace.times[0]))
        object.__setattr__(self, "begin", self.start)
        if math.isfinite(self.path.period):
            object.__setattr__(self, "period", float(self.pace.times[-1]) - self.start)
        else:
            object.__setattr__(self, "duration", float(self.pace.times[-1]))

    start: float = 0.0

    def __call__(self, t: float) -> Target:
        if math.isfinite(self.period):
            t = self.start + (t - self.start) % self.period
        s, ds, dds = self.pace(t)
        z, dz, ddz = self.path(s)
        if t < self.start or t > self.duration:
            return Target(z, 0.0 * dz, 0.0 * ddz)
        return Target(z, ds * dz, ds * ds * ddz + dds * dz)
