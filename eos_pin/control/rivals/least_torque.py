"""Least torques: of all that bring the task's acceleration, the smallest in some norm.

Hollerbach and Suh, *Redundancy resolution of manipulators through torque optimization*, IEEE J. Robotics and Automation
3(4), 1987. The joints build up speed in the null space over long motions, until the torques are beyond all bounds; with
damping there they do not.
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.linalg import lapack

from eos_pin._arrays import JointVector, VectorLike, checked, frozen_copy, number
from eos_pin.control.base import TaskController
from eos_pin.control.rivals.parts import right_inverse
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

Norm: TypeAlias = Literal["torque", "range", "acceleration"]


class LeastTorque(TaskController):
    """Least torque that brings the task's acceleration, plus damping in the null space.

    With A = J M⁻¹ the task's acceleration is A (tau − h) + J̇dq, and tau = A^Q(ddz − J̇dq + A h) + (I − A^Q A) τ₀ with
    the Q-weighted inverse A^Q = Q⁻¹Aᵀ(A Q⁻¹Aᵀ)⁻¹ is nearest to τ₀ in the norm √(tauᵀQ tau). Without damping τ₀ = 0;
    with it τ₀ = h − kd M dq, which alone would bring the joints to rest.

    Args:
        task: The task.
        reference: Trajectory of the task.
        norm: `"torque"` for |tau|, `"range"` for torques as parts of their limits, or `"acceleration"` for |M⁻¹tau|.
        damping: Damping kd in the null space [1/s]; None for none.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        *,
        norm: Norm = "torque",
        damping: float | None = None,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
    ) -> None:
        super().__init__(task, reference, kp=kp, kd=kd, feedforward=feedforward, gravity=gravity)
        self.norm = norm
        self.damping = None if damping is None else number(damping, "the damping", at_least=0.0)
        effort = task.robot.effort
        # Without limits torques are compared as they are.
        ranges = np.where(np.isfinite(effort), effort, 1.0) if norm == "range" else np.ones(task.robot.n)
        self._squares = frozen_copy(ranges**2)

    def describe(self) -> dict[str, Any]:
        return super().describe() | {"norm": self.norm, "damping": self.damping}

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        point, model = self.task._at(q, dq), self._model
        J = point.J
        ddz = self._task_acceleration(t, point) - point.drift
        h, M = model._bias(q, dq), model._mass(q)
        L, _ = lapack.dpotrf(M, lower=1)
        At, _ = lapack.dpotrs(L, J.T, lower=1)
        # Q⁻¹Aᵀ: with Q = M⁻² it is M Jᵀ.
        Y = M.dot(J.T) if self.norm == "acceleration" else self._squares[:, None] * At
        wanted = np.zeros(h.size) if self.damping is None else h - self.damping * M.dot(dq)
        return wanted + right_inverse(At.T, Y).dot(ddz + At.T.dot(h - wanted))
