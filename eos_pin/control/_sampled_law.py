"""Laws of errors in exact samples, targets a period ahead, and the state in the middle of a period."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin._arrays import JointVector, SelfMotionVector
from eos_pin.charts.chart import Chart
from eos_pin.robot.model import Robot


@dataclass(frozen=True, eq=False)
class SelfTargets:
    """Targets of the self-motion, v or joints, around one step; none for a law that is an acceleration.

    Attributes:
        of: Whose targets they are; the law itself where it is an acceleration.
        period: Control period [s].
        now: Target at the step.
        ahead: Target a period later.
        before: Target a period before, by its velocity.
        factors: Both factors of `decay`; None for a law that is an acceleration.
        joints: Whether the targets are joints.
    """

    of: Any
    period: float
    now: Any = None
    ahead: Any = None
    before: Any = None
    factors: Any = None
    joints: bool = False

    def acceleration(
        self, t: float, robot: Robot, chart: Chart, q: JointVector, u: JointVector, before: Any
    ) -> SelfMotionVector:
        """Commanded acceleration of v over the period.

        Args:
            t: Time of the step [s].
            robot: The robot.
            chart: The chart.
            q: Joints.
            u: Their velocities over the period before.
            before: Target at the step before; None where that was another's.
        """
        if self.factors is None:
            found: SelfMotionVector = self.of.acceleration(t, q, u, chart)
            return found
        h, (a1, a2) = self.period, self.factors
        before = self.before if before is None else before
        if self.joints:
            # Differences, as the way to a posture half a turn off is shortened.
            error = robot._way(q, self.now)
            left = a1 * error - a2 * robot._way(q - h * u, before)
            return chart._dv(self.ahead - self.now + error - left - h * u) / h**2
        v, moved = chart._v(q), h * chart._dv(u)
        left = a1 * (self.now - v) - a2 * (before - v + moved)
        return (self.ahead - left - v - moved) / h**2


def decay(kp: Any, kd: Any, period: float) -> tuple[Any, Any]:
    """Factors a₁, a₂ of ε(t + h) = a₁ ε(t) − a₂ ε(t − h), which samples ε̈ + kd ε̇ + kp ε = 0 exactly.

    They are the sum and the product of exp(λ h) over both roots λ of λ² + kd λ + kp = 0.

    Args:
        kp: Gain on the error [1/s²].
        kd: Gain on its velocity [1/s].
        period: Time h between two samples [s].
    """
    half = 0.5 * period * np.asarray(kd, dtype=float)
    root = np.sqrt(half.astype(complex) ** 2 - period**2 * np.asarray(kp, dtype=float))
    return (np.exp(root - half) + np.exp(-root - half)).real, np.exp(-2.0 * half)


class MiddleOfPeriod:
    """State in the middle of the period that begins, from the torques of the last ones.

    A torque that is held acts on average half a period after the state it was computed for. Computed for the state in
    the middle, as reached under the torque that the last two lead to, it is off by the square of the period only.

    Args:
        robot: The robot of the controller's model.
        period: Control period [s].
    """

    def __init__(self, robot: Robot, period: float) -> None:
        self.robot, self.half = robot, 0.5 * period
        self.forget()

    def forget(self) -> None:
        """Begin a run."""
        self._last: JointVector | None = None
        self._before: JointVector | None = None

    def __call__(self, t: float, q: JointVector, dq: JointVector) -> tuple[float, JointVector, JointVector]:
        """Time and state in the middle of the period; those that are given where no torque is known yet."""
        if self._last is None or self._before is None:
            return t, q, dq
        # The mean of the first half is that a quarter into the period, 3/4 after the middle of the last one.
        tau = self._last + 0.75 * (self._last - self._before)
        h, ddq = self.half, self.robot._forward_dynamics(q, dq, tau)
        return t + h, q + h * (dq + 0.5 * h * ddq), dq + h * ddq

    def held(self, tau: JointVector) -> None:
        """Store the torque of this period."""
        self._before, self._last = (tau if self._last is None else self._last), tau
