"""Angles of continuous joints, where a whole turn leads to the same place."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eos_pin._arrays import Array, Checked, JointVector, checked, frozen_copy, unchecked
from eos_pin.robot._coordinates import Coordinates, coordinates_of

#: Part of half a turn from which on a posture draws a continuous joint less, down to nothing where it is opposite.
OPPOSITE = 0.75
#: Pinocchio marks an absent limit by the largest float.
UNLIMITED = 1e30


class Angles(Checked):
    """A robot some of whose joints may be continuous.

    Attributes:
        model: Its Pinocchio model.
    """

    model: Any

    @cached_property
    def coordinates(self) -> Coordinates:
        """Coordinates q, and the joints that each of them moves."""
        return coordinates_of(self.model)

    @cached_property
    def continuous(self) -> Bool[Array, " n"]:
        """Mask of the joints that turn without end, for which angles a whole turn apart are the same place."""
        own = self.coordinates
        # A screw without limits moves on with each turn.
        turning = [self.model.joints[int(i)].shortname().startswith("JointModelR") for i in own.joints]
        for column, factor in zip(own.column[1:], own.factor[1:], strict=True):
            # What follows by a part of a turn is elsewhere after a whole one.
            turning[column] &= float(factor).is_integer()
        ends = np.abs((self.model.lowerPositionLimit, self.model.upperPositionLimit)).min(axis=0)
        return frozen_copy(np.array(turning) & (ends >= UNLIMITED), bool)

    @cached_property
    def turns(self) -> bool:
        """Whether any joint is continuous."""
        return bool(self.continuous.any())

    @cached_property
    def _turn(self) -> JointVector:
        """Angle after which each joint is where it was; 0 where there is none."""
        return np.where(self.continuous, math.tau, 0.0)

    @checked
    def unwrap(self, q: Float[Array, "*rows n"], near: Float[Array, "*others n"]) -> Float[Array, "*all n"]:
        """The same configurations, continuous joints by the angle nearest to another one.

        Encoders often report angles in (−π, π]; with the state before as `near` the angle goes on where it was.

        Args:
            q: Joints, (n,) or (K, n).
            near: Joints to be near to, (n,) or (K, n).
        """
        return q - self._turn * np.round((q - near) / math.tau) if self.turns else q

    @checked
    def way(self, q: Float[Array, "*rows n"], goal: JointVector) -> Float[Array, "*rows n"]:
        """Pull towards a posture: `goal` − q, for continuous joints the shorter way round.

        From 3/4 of half a turn on the pull fades, so that it is a continuous function of q.

        Args:
            q: Joints, (n,) or (K, n).
            goal: The posture.
        """
        if not self.turns:
            return goal - q
        away = self._unwrap(goal - q, np.zeros_like(goal))
        size = np.abs(away)
        faded = np.minimum(size, (math.pi - size) * (OPPOSITE / (1.0 - OPPOSITE)))
        return np.where(self.continuous, np.copysign(faded, away), away)

    _unwrap, _way = unchecked(unwrap), unchecked(way)
