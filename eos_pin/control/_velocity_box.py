"""Joint velocities that keep position, velocity and acceleration limits where commands are sampled; exact, not a bound.

Over one control period a joint moves with constant velocity u: q⁺ = q + h u. It can stop before an end at distance d if
it can do so by braking a full b h in every period. Velocities that leave that open form an interval, which is never
empty if the velocity before was in its own.
"""

from __future__ import annotations

import numpy as np

from eos_pin._arrays import JointVector, Vector

#: Part of its distance by which a joint beyond an end comes back in a period.
RETURN = 0.1
#: A way beyond this counts as without end [rad or m]; a joint keeps so far from its ends, against rounding.
ENDLESS, ROUNDING = 1e6, 1e-12
#: Part of the room for acceleration that a change of pace uses.
MOST_PART = 0.98


class VelocityBox:
    """Intervals of the next velocities within limits.

    Args:
        lower: Lower positions, (n,) [rad or m].
        upper: Upper positions, (n,).
        velocity: Largest speeds, (n,) [rad/s or m/s].
        acceleration: Largest accelerations, (n,) [rad/s² or m/s²], finite.
        braking: Decelerations with which a joint is stopped before an end, (n,), no larger than those.
        period: Control period [s].
    """

    def __init__(
        self,
        lower: JointVector,
        upper: JointVector,
        velocity: JointVector,
        acceleration: JointVector,
        braking: JointVector,
        period: float,
    ) -> None:
        self._ends = np.concatenate((upper, -lower)) - ROUNDING
        self._fastest = np.tile(velocity, 2)
        self._change = period * np.tile(acceleration, 2)
        self._brake = period * np.tile(braking, 2)
        self._period, self._n = period, lower.size
        self._per_way = 8.0 / (period * self._brake)

    def __call__(self, q: JointVector, u: JointVector) -> tuple[JointVector, JointVector]:
        """Least and largest next velocity.

        Args:
            q: Joints.
            u: Velocities over the period before.
        """
        both = np.concatenate((u, -u))
        room = np.minimum(self._ends - np.concatenate((q, -q)), ENDLESS)
        most = np.minimum(np.minimum(self._stoppable(room), self._fastest), both + self._change)
        # A limit that is passed already is come back to as fast as the acceleration allows.
        most = np.maximum(most, both - self._change)
        upper = most[: self._n]
        return np.minimum(-most[self._n :], upper), upper

    def _stoppable(self, room: Vector) -> Vector:
        """Largest velocity towards an end at a distance from which a joint comes to rest before it.

        In k full steps of braking after this one, h((k + 1) u − b h k(k + 1)/2) is the way; k is the largest number
        for which the velocity is still positive then.
        """
        inside = np.maximum(room, 0.0)
        k = np.floor(0.5 * (np.sqrt(1.0 + self._per_way * inside) - 1.0))
        most = (inside / self._period + 0.5 * self._brake * k * (k + 1.0)) / (k + 1.0)
        return np.where(room < 0.0, RETURN * room / self._period, most)


def part_within(a: JointVector, other: JointVector, least: JointVector, most: JointVector) -> float:
    """Part of the way from one acceleration to another that is within bounds, where the first one is."""
    gain = other - a
    room = np.where(gain > 0.0, most, least) - a
    counts = (gain != 0.0) & (a >= least) & (a <= most)
    parts = room[counts] / gain[counts]
    return float(min(MOST_PART * parts.min(initial=2.0), 1.0))
