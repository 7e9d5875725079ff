"""Impedance with a posture spring behind a null-space projector, to compare with."""

from __future__ import annotations

from typing import Any

import numpy as np

from eos_pin._arrays import JointVector, VectorLike, checked, frozen_copy, vector
from eos_pin._kernels.plain_springs import shortened, turn_moment
from eos_pin.control.base import Controller
from eos_pin.control.compliant.gains import GainLike, damping_of, gain_matrix, plain, ratio
from eos_pin.control.compliant.law import Gains
from eos_pin.control.compliant.springs import rotation_rows
from eos_pin.control.rivals.parts import Consistency
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory, check_reference


class ProjectedImpedance(Controller):
    """Impedance of the task, and a posture spring behind a null-space projector, for targets at rest.

    tau = g + G'ᵀ(K_z e_z − D_z dz) + N (K_q (q_d − q) − D_q dq), N = 1 − G'ᵀ(G'A⁻¹G'ᵀ)⁻¹G'A⁻¹ with one of three
    weightings A (Dietrich, Ott, Albu-Schäffer, Int. J. Robotics Research 34(11), 2015).

    Args:
        task: The task.
        reference: Trajectory of the task; its velocity is not used.
        posture: Joints q_d, (n,).
        consistency: `"static"`: A = 1; `"dynamic"`: A = M; `"stiffness"`: A = K_q.
        stiffness: K_z, as in `ImpedanceController`.
        joint_stiffness: K_q, one number, (n,) or (n, n) [N m/rad].
        damping_ratio: Damping ratio of both, each for itself.

    Raises:
        InputError: As in `ImpedanceController`; or K_q is singular.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        posture: VectorLike,
        *,
        consistency: Consistency = "dynamic",
        stiffness: GainLike,
        joint_stiffness: float | VectorLike = 20.0,
        damping_ratio: float = 0.7,
    ) -> None:
        task.robot.check_dynamics()
        check_reference(task, reference)
        self.task: Task = task
        self.robot: Robot = task.robot
        self.reference: Trajectory = reference
        self.consistency = consistency
        n = task.robot.n
        self.posture = frozen_copy(vector(posture, n, "the posture"))
        names = list(task.robot.joint_names)
        K_q = gain_matrix(joint_stiffness, names, ["rad"] * n, "the joint stiffness", definite=True)
        K_z = gain_matrix(stiffness, task.labels, task.units, "the stiffness")
        self.gains = Gains(K_z, K_q, damping_ratio=ratio(damping_ratio, "the damping ratio"))
        self._rotations = rotation_rows(task)

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        (z, J), M, gains = self.task._linearize(q), self.robot._mass(q), self.gains
        e = self.task._minus(self.reference(t).z, z)
        turned = [(rows, *shortened(e, rows)) for rows, _ in self._rotations]
        F = gains.stiffness @ e
        for rows, eta, two_epsilon in turned:
            turn_moment(F, rows, eta, two_epsilon)
        Lambda = np.linalg.inv(J @ np.linalg.solve(M, J.T))
        D_z = damping_of(0.5 * (Lambda + Lambda.T), gains.stiffness, gains.damping_ratio)
        K_q = gains.self_motion_stiffness
        own = K_q @ self.robot._way(q, self.posture) - damping_of(M, K_q, gains.damping_ratio) @ dq
        A = {"static": np.eye(q.size), "dynamic": M, "stiffness": K_q}[self.consistency]
        X = np.linalg.solve(A, J.T)
        return self.robot._gravity(q) + J.T @ (F - D_z @ (J @ dq)) + own - J.T @ np.linalg.solve(J @ X, X.T @ own)

    def describe(self) -> dict[str, Any]:
        return super().describe() | {
            "consistency": self.consistency,
            "stiffness": plain(self.gains.stiffness),
            "joint_stiffness": plain(self.gains.self_motion_stiffness),
            "damping_ratio": self.gains.damping_ratio,
            "robot": self.robot.name,
        }
