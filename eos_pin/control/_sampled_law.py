"""Laws of errors in exact samples, targets a period ahead, and the state in the middle of a period."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin._arrays import Jacobian, JointVector, SelfMotionVector, TaskVector
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

    def placed(self, q: JointVector, u: JointVector, before: Any) -> SelfTargets:
        """Targets with the state at the step taken into account; arguments as in `acceleration`."""
        return self

    def acceleration(
        self, t: float, robot: Robot, chart: Chart, q: JointVector, u: JointVector, before: Any,
        J: Jacobian | None = None, asked: TaskVector | None = None,
    ) -> SelfMotionVector:  # fmt: skip
        """Commanded acceleration of v over the period.

        Args:
            t: Time of the step [s].
            robot: The robot.
            chart: The chart.
            q: Joints.
            u: Their velocities over the period before.
            before: Target at the step before; None where that was another's.
            J: Jacobian of the task where the joints would be at the end of the period without it.
            asked: Task acceleration over the period, without its drift.
        """
        if self.factors is None:
            found: SelfMotionVector = (
                self.of.acceleration(t, q, u, chart)
                if self.of.independent
                else self.of._acceleration_beside(t, q, u, chart, J, asked)
            )
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

    def lacking(self, chart: Chart, J: Jacobian, q: JointVector, left: TaskVector) -> SelfMotionVector:
        """Self-motion that a further task lacks at joints q, beside the motion that the task lacks; elsewhere none."""
        return np.zeros(chart.r)


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
    """State in the middle of the period that begins, from the torques of the last ones, and mean torque over it.

    A torque that is held acts on average half a period after the state it was computed for. Computed for the state in
    the middle, as a torque that goes on as the last two did leads there, and raised from there to the mean over the
    period, it is off by a small part of the square of the period. Velocities are those of such a torque, too: samples
    of a motion under held torques that goes through the same joints are h²/12 of M⁻¹ τ̇ beside them.

    Args:
        robot: The robot of the controller's model.
        period: Control period [s].
    """

    def __init__(self, robot: Robot, period: float) -> None:
        self.robot, self.half = robot, 0.5 * period
        self.forget()

    def forget(self) -> None:
        """Begin a run."""
        self._last: Any = None
        self._before: Any = None
        self._ddq: JointVector | None = None

    def step(self, controller: Any, t: float, q: JointVector, dq: JointVector, state: Any) -> tuple[JointVector, Any]:
        """Mean torque of a controller over this period, and its state; at first as if the torque did not change."""
        if self._last is None:
            self._last = self._before = controller._step(t, q, dq, state)[0]
        self._middle, state = controller._step(*self._ahead(t, q, dq), state)
        # h² τ̈ / 24 beside that in the middle.
        self._mean = self._middle + (self._middle - 2.0 * self._last + self._before) / 24.0
        return self._mean, state

    def held(self, tau: JointVector) -> None:
        """Store the torque of this period, the mean one or another instead."""
        self._before, self._last = self._last, self._middle if tau is self._mean else tau

    def _ahead(self, t: float, q: JointVector, dq: JointVector) -> tuple[float, JointVector, JointVector]:
        """Time and state in the middle of the period."""
        h, rise = self.half, 0.5 * (self._last - self._before)
        ddq = self.robot._forward_dynamics(q, dq, self._last + rise)
        # As if the torque rose on and on, instead of in steps.
        dq = dq + h * (ddq - self.robot._forward_dynamics(q, dq, self._last)) / 3.0
        before, self._ddq = self._ddq, ddq
        if before is not None:
            ddq = ddq + 0.25 * (ddq - before)
        return t + h, q + h * (dq + 0.5 * h * ddq), dq + h * ddq
