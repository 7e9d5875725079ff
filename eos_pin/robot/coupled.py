"""`CoupledRobot`: a robot in which some joints follow others, as mimic joints of a URDF do."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector
from eos_pin.robot.model import Robot


class CoupledRobot(Robot):
    """A robot with joints that have no coordinate and no torque of their own, but follow that of another joint.

    With all joints at S q + s its equations of motion are those of the whole tree, projected: M = SᵀM'S and bias
    Sᵀb'. Pinocchio computes these, Jacobians and drifts; the rest, which it refuses or gets wrong for such models, is
    computed from them here.
    """

    _may_follow = True

    def forward_dynamics(self, q: JointVector, dq: JointVector, tau: JointVector) -> JointVector:
        return np.linalg.solve(self._mass(q), tau - self._bias(q, dq))

    def kinetic_energy(self, q: JointVector, dq: JointVector) -> float:
        return float(0.5 * dq @ self._mass(q) @ dq)

    def potential_energy(self, q: JointVector) -> float:
        center = pin.centerOfMass(self.model, self._dynamics, q)
        return float(-sum(body.mass for body in self.model.inertias[1:]) * self.model.gravity.linear @ center)

    def energy_slope(self, q: JointVector, dq: JointVector) -> JointVector:
        # Coriolis torque is a quadratic form Γ(dq, dq) in the velocities, and ∂T/∂q_i = dqᵀ Γ(e_i, dq).
        def coriolis(velocity: JointVector) -> Float[Array, " n"]:
            return pin.rnea(self._weightless, self._dynamics, q, velocity, np.zeros(self.n))

        mixed = [0.25 * (coriolis(dq + unit) - coriolis(dq - unit)) for unit in np.eye(self.n)]
        return np.array(mixed) @ dq

    @property
    def _weightless(self) -> pin.Model:
        return self.with_gravity(0.0).model
