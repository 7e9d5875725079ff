"""Resolved motion: joint velocities or accelerations from the Moore–Penrose inverse, and computed torque for them.

Five of the eight laws of Nakanishi, Cory, Mistry, Peters and Schaal, *Operational space control: a theoretical and
empirical comparison*, Int. J. Robotics Research 27(6), 2008; the other three are made of `OperationalSpaceController`.
Notation: J⁺ the Moore–Penrose inverse, N = I − J⁺J, h Coriolis and gravity torques, ξ = kp (posture − q) − kd dq, and
ξ₁ = (kp/kd)(posture − q) where a velocity is asked for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import JointVector, TaskVector
from eos_pin.control.rivals.parts import (
    LEAST_DAMPING,
    AccelerationController,
    PostureController,
    inverse_rate,
    jacobian_rate,
    right_inverse,
)
from eos_pin.tasks.base import TaskPoint
from eos_pin.trajectories.base import Target


class ResolvedAcceleration(AccelerationController):
    """Simplified acceleration, variation 1: tau = M(J⁺(ddz_r − J̇dq) + N ξ) + h."""

    def law(self, q: JointVector, dq: JointVector, point: TaskPoint, ddz: TaskVector) -> JointVector:
        J, xi = point.J, self.pull(q, dq)
        ddq = xi + right_inverse(J, J.T).dot(ddz - J.dot(xi))
        return self._model._inverse_dynamics(q, dq, ddq)


class ResolvedAccelerationWithTorque(AccelerationController):
    """Simplified acceleration, variation 2: tau = M J⁺(ddz_r − J̇dq) + h + N τ, the null space's τ a torque.

    τ = I ξ with the inertia I of each joint at the posture, a constant, so that gains mean about the same as elsewhere.
    The projector is not consistent with the inertia: τ disturbs the task.
    """

    def law(self, q: JointVector, dq: JointVector, point: TaskPoint, ddz: TaskVector) -> JointVector:
        J, torque = point.J, self.inertia * self.pull(q, dq)
        J_plus = right_inverse(J, J.T)
        return self._model._inverse_dynamics(q, dq, J_plus.dot(ddz)) + torque - J_plus.dot(J.dot(torque))


class _Desired(PostureController):
    """Desired joint velocity J⁺(dz_d + k (z_d − z)) + N ξ₁ with k = kp/kd, and its time derivative."""

    def desired(self, t: float, q: JointVector, dq: JointVector, point: TaskPoint) -> tuple[JointVector, JointVector]:
        """Desired joint velocity and its time derivative."""
        z_d, dz_d, ddz_d = self.reference(t)
        rest = np.zeros(self.task.m)
        if not self.feedforward:
            dz_d = ddz_d = rest
        k = self.kp / np.maximum(self.kd, LEAST_DAMPING)
        dz_r = self.task._tracking_acceleration(point.z, rest, Target(z_d, rest, dz_d), k, rest)
        ddz_r = self.task._tracking_acceleration(point.z, point.dz, Target(z_d, dz_d, ddz_d), rest, k)
        J = point.J
        xi, dxi = self.drawn(q, dq)
        J_plus = right_inverse(J, J.T)
        dJ = jacobian_rate(self.task, q, dq)
        dJ_plus = inverse_rate(J, dJ, J_plus)
        lack = dz_r - J.dot(xi)
        # d/dt (ξ₁ + J⁺(dz_r − J ξ₁))
        rate = dxi + dJ_plus.dot(lack) + J_plus.dot(ddz_r - dJ.dot(xi) - J.dot(dxi))
        return xi + J_plus.dot(lack), rate


class ResolvedVelocity(_Desired):
    """Velocity without integration: tau = M ddq_d + K (dq_d − dq) + h with K = kd I, I the inertia at the posture."""

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        dq_d, ddq_d = self.desired(t, q, dq, self.task._at(q, dq))
        damping = float(self.kd.max()) * self.inertia
        return self._model._inverse_dynamics(q, dq, ddq_d) + damping * (dq_d - dq)


class Integrated(NamedTuple):
    """Desired joints of `IntegratedVelocity`, the desired velocity there, and when."""

    t: float
    q: JointVector
    dq: JointVector


class IntegratedVelocity(_Desired):
    """Velocity, integrated: tau = M(ddq_d + kd (dq_d − dq) + kp (q_d − q)) + h, q_d the integral of dq_d.

    The integral goes on once a period, by the trapezoidal rule; so it is a law for a sampled loop.
    """

    def start(self, t: float, q: JointVector, dq: JointVector) -> Integrated:
        return Integrated(t, q.copy(), self.desired(t, q, dq, self.task._at(q, dq))[0])

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Integrated) -> JointVector:
        return self._of(q, dq, *self._advanced(t, q, dq, state))

    def step(self, t: float, q: JointVector, dq: JointVector, state: Integrated) -> tuple[JointVector, Integrated]:
        following, ddq_d = self._advanced(t, q, dq, state)
        return self._of(q, dq, following, ddq_d), following

    def _advanced(self, t: float, q: JointVector, dq: JointVector, state: Integrated) -> tuple[Integrated, JointVector]:
        dq_d, ddq_d = self.desired(t, q, dq, self.task._at(q, dq))
        return Integrated(t, state.q + 0.5 * (t - state.t) * (state.dq + dq_d), dq_d), ddq_d

    def _of(self, q: JointVector, dq: JointVector, desired: Integrated, ddq_d: JointVector) -> JointVector:
        kp, kd = float(self.kp.max()), float(self.kd.max())
        ddq = ddq_d + kd * (desired.dq - dq) + kp * self.robot._way(q, desired.q)
        return self._model._inverse_dynamics(q, dq, ddq)


class NullSpaceDynamics(AccelerationController):
    """Acceleration with null-space dynamics: tau = M(J⁺(ddz_r − J̇dq) + φ) + h (Hsu, Hauser and Sastry, 1989).

    φ = N(dξ₁ + kd (ξ₁ − dq)) − (J⁺J̇J⁺ + d(J⁺)/dt) J (ξ₁ − dq), with which the null-space velocity error N(ξ₁ − dq)
    decays at the rate kd of the posture.
    """

    def law(self, q: JointVector, dq: JointVector, point: TaskPoint, ddz: TaskVector) -> JointVector:
        J = point.J
        J_plus, dJ = right_inverse(J, J.T), jacobian_rate(self.task, q, dq)
        xi, dxi = self.drawn(q, dq)
        e = xi - dq
        wanted = dxi + self.kd_posture * e
        Je = J.dot(e)
        turned = J_plus.dot(dJ.dot(J_plus.dot(Je))) + inverse_rate(J, dJ, J_plus).dot(Je)
        ddq = J_plus.dot(ddz - J.dot(wanted)) + wanted - turned
        return self._model._inverse_dynamics(q, dq, ddq)
