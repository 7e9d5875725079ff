"""Joint velocities that keep position, velocity and acceleration limits where commands are sampled; exact, not a bound.

Over one control period a joint moves with constant velocity u: q⁺ = q + h u. It can stop before an end at distance d if
it can do so by braking a full b h in every period. Velocities that leave that open form an interval, which is never
empty if the velocity before was in its own. `compiled_step` makes the ordinary steps of `KinematicLoop` within them.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from eos_pin._arrays import JointVector, Vector
from eos_pin._kernels.dispatch import kernels
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.directions import TURN
from eos_pin.control.limited import JointLimits
from eos_pin.control.objectives import Objective
from eos_pin.control.state import EosState
from eos_pin.errors import InputError
from eos_pin.trajectories.base import Trajectory

#: Part of its distance by which a joint beyond an end comes back in a period.
RETURN = 0.1
#: A way beyond this counts as without end [rad or m]; a joint keeps so far from its ends, against rounding.
ENDLESS, ROUNDING = 1e6, 1e-12
#: Part of the room for acceleration that a change of pace uses.
MOST_PART = 0.98


class VelocityBox:
    """Intervals of the next velocities within limits.

    Args:
        limits: The limits; joints brake before an end as it is said there, but no harder than the acceleration allows.
        n: Number of joints.
        period: Control period [s].

    Raises:
        InputError: The limits are for another number of joints, or one of acceleration is infinite.
    """

    def __init__(self, limits: JointLimits, n: int, period: float) -> None:
        if limits.lower.size != n:
            raise InputError(f"the limits are for {limits.lower.size} joints, the robot has {n}")
        if not np.isfinite(limits.acceleration).all():
            raise InputError(
                "a kinematic loop needs a finite limit of every acceleration. Give "
                "limits=JointLimits.without_torques(robot, acceleration=…)"
            )
        self._ends = np.concatenate((limits.upper, -limits.lower)) - ROUNDING
        self._fastest = np.tile(limits.velocity, 2)
        self._change = period * np.tile(limits.acceleration, 2)
        self._brake = period * np.tile(np.minimum(limits.braking, limits.acceleration), 2)
        self._period, self._n = period, n
        self._per_way = 8.0 / (period * self._brake)

    @property
    def arrays(self) -> tuple[Vector, Vector, Vector, Vector]:
        """Ends of both ways, largest speeds, changes of velocity in a period, and those of braking, (2n,) each."""
        return self._ends, self._fastest, self._change, self._brake

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


def compiled_step(
    on: EosState,
    reference: Trajectory,
    self_motion: Objective,
    atlas: Atlas,
    factors: tuple[Any, Any],
    box: VelocityBox,
    settings: tuple[float, float, float, float, int],
) -> Any:
    """Compiled step on one chart; None without a compiler, for tasks not made of frames, and for laws beside them.

    Args:
        on: The chart.
        reference: Reference of the task.
        self_motion: Law of the self-motion.
        atlas: Rule by which charts follow each other.
        factors: Both factors of `decay` for the task.
        box: Velocities within limits.
        settings: Control period, distances by which a measured joint may move and may be away from its command, square
            of the task error that is left, and most steps of Newton's method.
    """
    chart, kinematics = on.chart, on.chart.task.kinematics
    # The kinematics of a tolerance are of another task, with other points.
    own = kinematics.compiled and kinematics.task is chart.task
    if kernels is None or not own or on.drive._kernel is None or not self_motion.independent:
        return None
    law, held = self_motion.sampled_targets(on.since, settings[0], 0.0, chart.r), self_motion._held_law(chart.r)
    return kernels.KinematicStep(
        on.drive._made_from, kinematics._chain, (chart.q_bar, chart._v_zero), chart.task.robot.continuous, TURN,
        atlas.threshold, partial(atlas._serves, chart), factors, held and (held[2], *law.factors), law.of, reference,
        box.arrays, ENDLESS, *settings,
    )  # fmt: skip
