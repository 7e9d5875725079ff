"""External torques, estimated from the momentum of the joints."""

from __future__ import annotations

import math
from typing import NamedTuple

from eos_pin._arrays import JointVector, checked, number
from eos_pin.robot.model import Robot


class Observed(NamedTuple):
    """State of a `MomentumObserver`.

    Attributes:
        t: Time [s].
        momentum: M dq.
        known: Cᵀ dq − g, the rate of the momentum without torques.
        external: Estimate of the external torques, (n,) [N m or N].
    """

    t: float
    momentum: JointVector
    known: JointVector
    external: JointVector


class MomentumObserver:
    """Estimate of external torques from joints, velocities and the torques that were held; no acceleration is needed.

    p = M dq obeys ṗ = tau + Cᵀ dq − g + tau_ext, and the estimate follows what is left of ṗ with a lag of first order:
    r̂ = tau_ext / (1 + s / rate) (De Luca, Albu-Schäffer, Haddadin, Hirzinger, IROS 2006). Errors of the model and
    friction count as external torques.

    Args:
        robot: The robot as it is known.
        rate: Inverse of the lag [1/s].
    """

    @checked
    def __init__(self, robot: Robot, rate: float) -> None:
        robot.check_dynamics()
        self.robot, self.rate = robot, number(rate, "the rate of the observer", above=0.0)
        self._weightless = robot.with_gravity(0.0)

    def start(self, t: float, q: JointVector, dq: JointVector) -> Observed:
        """State at the start, without an external torque."""
        return Observed(t, *self._parts(q, dq), 0.0 * dq)

    def update(self, t: float, q: JointVector, dq: JointVector, last: Observed, tau: JointVector) -> Observed:
        """State at the end of a period.

        Args:
            t: Time [s].
            q: Joints.
            dq: Joint velocities.
            last: State at its start.
            tau: Torque that was held meanwhile [N m or N].
        """
        period = t - last.t
        if not period > 0.0:
            return last
        momentum, known = self._parts(q, dq)
        left = (momentum - last.momentum) / period - tau - 0.5 * (known + last.known)
        external = last.external + (1.0 - math.exp(-self.rate * period)) * (left - last.external)
        return Observed(t, momentum, known, external)

    def _parts(self, q: JointVector, dq: JointVector) -> tuple[JointVector, JointVector]:
        momentum = self._weightless._inverse_dynamics(q, 0.0 * dq, dq)
        return momentum, self.robot._energy_slope(q, dq) - self.robot._gravity(q)
