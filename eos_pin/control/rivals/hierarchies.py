"""Torques of a hierarchy of three levels: the task, a second task, and a posture in the freedom that both leave.

Dietrich, Ott and Albu-Schäffer, *An overview of null space projections for redundant, torque-controlled robots*, Int.
J. Robotics Research 34(11), 2015. Two structures, successive and augmented, and three weights of the generalised
inverse: the identity (static consistency), the mass matrix (dynamic consistency) and a stiffness (stiffness
consistency).
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack

from eos_pin._arrays import Array, Jacobian, JointVector, TaskVector, VectorLike, as_floats, checked, frozen_copy
from eos_pin.charts._basis import solve_gram
from eos_pin.control.rivals.parts import AccelerationController, Consistency, right_inverse
from eos_pin.errors import InputError
from eos_pin.tasks.base import Task, TaskPoint
from eos_pin.tasks.joints import JointTask
from eos_pin.trajectories.base import Trajectory

Structure: TypeAlias = Literal["successive", "augmented"]


class HierarchyController(AccelerationController):
    """Task, second task and posture, each in the null space of those above it.

    tau = Jᵀ Λ ddz + N₂ᵀ J₂ᵀ Λ₂ ddz₂ + N₃ᵀ M ξ + h, where a level's projector is Nᵀ = I − Jᵀ(J^W)ᵀ with the
    W-weighted inverse J^W = W⁻¹Jᵀ(J W⁻¹Jᵀ)⁻¹ of all levels above it, stacked (augmented), or the product of one such
    projector for each (successive). With two levels both are the same. Only the dynamic weight keeps the task free of
    what happens below.

    Args:
        task: The task.
        reference: Trajectory of the task.
        posture: Posture of the third level, (n,); the second task is drawn to where it is there.
        structure: How projectors of several levels are made.
        consistency: Weight of the generalised inverses.
        second: Second task, on the same robot; by default half of the joints that the task leaves free, from the base.
        stiffness: Stiffness matrix of the joints, (n, n), the weight of the stiffness consistency; by default that of
            the posture, kp times the inertia of each joint.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        kp_posture: Gain of the second task, the largest, and of the posture, one number or (n,) [1/s²].
        kd_posture: Damping of both, likewise [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.

    Raises:
        InputError: The second task is of another robot, or takes more joints than the task leaves free, or the
            stiffness is not symmetric and positive.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        posture: VectorLike,
        *,
        structure: Structure = "augmented",
        consistency: Consistency = "dynamic",
        second: Task | None = None,
        stiffness: VectorLike | None = None,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        kp_posture: float | VectorLike = 100.0,
        kd_posture: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
    ) -> None:
        super().__init__(
            task, reference, posture, kp=kp, kd=kd, kp_posture=kp_posture, kd_posture=kd_posture,
            feedforward=feedforward, gravity=gravity,
        )  # fmt: skip
        robot = task.robot
        r = robot.n - task.m
        if second is None and r < 2:
            raise InputError(
                f"a hierarchy needs two joints or more beside the task, {robot.name!r} has {r}: count fewer coordinates"
            )
        self.second = second or JointTask(robot, [{name: 1.0} for name in robot.joint_names[: r // 2]])
        if self.second.robot is not robot or self.second.m > r:
            raise InputError(
                f"the second task must be of the same robot and have at most {r} coordinates, which the task leaves "
                f"free; got {self.second!r}"
            )
        self.structure, self.consistency = structure, consistency
        # Not the gains as they are: with kp = 0 there would be no weight.
        own = np.diag(np.maximum(self.kp_posture, 1.0) * self.inertia)
        K = own if stiffness is None else as_floats(stiffness, "the stiffness")
        if K.shape != own.shape or not np.isfinite(K).all() or not np.allclose(K, K.T) or np.linalg.eigvalsh(K)[0] <= 0:
            raise InputError(
                f"the stiffness must be a symmetric, positive ({robot.n}, {robot.n}) matrix, got {K.tolist()}"
            )
        self._compliance = frozen_copy(np.linalg.inv(K))
        self._target = frozen_copy(self.second.value(self.posture))

    def describe(self) -> dict[str, Any]:
        named = {"structure": self.structure, "consistency": self.consistency}
        return super().describe() | named | {"second": self.second.describe()}

    def law(self, q: JointVector, dq: JointVector, point: TaskPoint, ddz: TaskVector) -> JointVector:
        model, J = self._model, point.J
        other, M = self.second._at(q, dq), model._mass(q)
        kp, kd = float(self.kp_posture.max()), float(self.kd_posture.max())
        ddz_2 = kp * self.second._minus(self._target, other.z) - kd * other.dz - other.drift
        L, _ = lapack.dpotrf(M, lower=1)
        stacked = np.vstack((J, other.J))
        Y, _ = lapack.dpotrs(L, stacked.T, lower=1)
        first, second = (J.T, Y[:, : len(ddz)]), (other.J.T, Y[:, len(ddz) :])
        tau_2, tau_3 = self._pulled(*second, ddz_2), M.dot(self.pull(q, dq))
        # The lowest level upwards: each projector takes out of a torque what those above would feel.
        if self.structure == "augmented":
            tau = self._free(J, first[1], tau_2) + self._free(stacked, Y, tau_3)
        else:
            tau = self._free(J, first[1], tau_2 + self._free(other.J, second[1], tau_3))
        return self._pulled(*first, ddz) + tau + model._bias(q, dq)

    @staticmethod
    def _pulled(Jt: Float[Array, "n k"], Y: Float[Array, "n k"], ddz: TaskVector) -> JointVector:
        """Jᵀ Λ ddz, with Y = M⁻¹Jᵀ."""
        # Y (J Y)⁻¹ is M⁻¹JᵀΛ; times ddz and M would do as well, but costs a product more.
        return Jt.dot(solve_gram(Jt.T, Y, ddz, "its mass matrix Λ does not exist"))

    def _free(self, J: Jacobian, Y: Float[Array, "n k"], tau: JointVector) -> JointVector:
        """Nᵀ tau = tau − Jᵀ(J^W)ᵀ tau."""
        if self.consistency != "dynamic":
            Y = J.T if self.consistency == "static" else self._compliance.dot(J.T)
        return tau - J.T.dot(right_inverse(J, Y).T.dot(tau))
