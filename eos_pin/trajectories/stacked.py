"""Trajectories of several tasks at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eos_pin._arrays import (
    by_value,
    checked,
    number,
)
from eos_pin.errors import InputError
from eos_pin.trajectories.base import Target, Trajectory
from eos_pin.trajectories.harmonic import Waves


@by_value
@checked
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
        object.__setattr__(self, "begin", min(part.begin for part in self.parts))

    def __call__(self, t: float) -> Target:
        if self._joined is not None:
            return self._joined.at(t if type(t) is float else number(t, "t"))
        z, dz, ddz = zip(*(part(t) for part in self.parts), strict=True)
        return Target(np.concatenate(z), np.concatenate(dz), np.concatenate(ddz))

    @cached_property
    def _joined(self) -> Waves | None:
        """All parts in one, where one of them moves and the others are at rest; the everyday case."""
        moving = [part for part in self.parts if part.constant is None]
        if len(moving) != 1 or moving[0].waves is None:
            return None
        own: Waves = moving[0].waves
        one = np.eye(len(own.blocks[0]))[:, -1]
        parts = [own.blocks if p is moving[0] else [np.outer(one, row) for row in p(0.0)] for p in self.parts]
        return Waves(own.phase, own.frequencies, *map(np.hstack, zip(*parts, strict=True)))
