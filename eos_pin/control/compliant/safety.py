"""Safety of a compliant arm: filtered velocities, friction, joint limits, and self-motion that yields first."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin._arrays import Array, JointVector, NonNegative, Positive, by_value, checked, number
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Safety:
    """Additions of an impedance for real arms; none of them is passive, and `energies` has the power of each.

    Largest errors are an argument of `ImpedanceController`, limits of the torque's rate one of `ControlLoop`.

    Attributes:
        velocity_cutoff: Frequency from which measured velocities are damped out by a filter of first order [Hz]; None
            for none.
        friction: Friction of the joints that is compensated, an object with `torque(dq)` such as `Friction`.
        limit_stiffness: Stiffness with which joints are pushed away from their limits, by self-motion only [N m/rad].
        limit_zone: Distance from a limit at which that begins [rad or m].
        yielding: Whether the force on v is lessened first where a torque would exceed its limit, so that the task keeps
            its force as long as it can.
    """

    velocity_cutoff: float | None = None
    friction: Any = None
    limit_stiffness: NonNegative = 0.0
    limit_zone: Positive = 0.2
    yielding: bool = False

    def __post_init__(self) -> None:
        if self.velocity_cutoff is not None:
            number(self.velocity_cutoff, "the cutoff of the velocities", above=0.0)
        if self.friction is not None and not callable(getattr(self.friction, "torque", None)):
            raise InputError(f"the friction must be an object with torque(dq), such as Friction, got {self.friction!r}")

    def _filtered(self, past: float, before: JointVector, dq: JointVector) -> JointVector:
        """Velocities from those before and the measured ones.

        Args:
            past: Time since those before [s].
            before: Filtered velocities then.
            dq: Measured velocities.
        """
        if self.velocity_cutoff is None:
            return dq
        return before + (1.0 - math.exp(-math.tau * self.velocity_cutoff * past)) * (dq - before)

    def _limit_torque(self, robot: Robot, q: JointVector) -> JointVector | None:
        """Torque −∂u/∂q of springs in the zone of the joint limits; None where all joints are clear of it."""
        inside = np.maximum(robot.lower + self.limit_zone - q, 0.0) - np.maximum(q - robot.upper + self.limit_zone, 0.0)
        return self.limit_stiffness * inside if inside.any() else None


def yielded(tau: JointVector, own: JointVector, limits: JointVector) -> JointVector:
    """The torque with as much of the self-motion's part as the limits leave.

    Args:
        tau: All of the torque.
        own: The part of it that is lessened.
        limits: Largest torques.
    """
    rest = tau - own
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(own > 0.0, limits - rest, -limits - rest) / own
    most = float(np.min(room, where=own != 0.0, initial=1.0))
    return rest + max(most, 0.0) * own


def pulled_back(A: Array, tau: JointVector) -> JointVector | None:
    """Force Q on (z, v) equivalent to joint torques, Aᵀ Q = tau with A = H⁻¹; None where A is singular."""
    try:
        return np.linalg.solve(A.T, tau)
    except np.linalg.LinAlgError:
        return None
