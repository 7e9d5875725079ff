"""Parts that published laws share: generalised inverses, their rates, and the posture that they draw the joints to."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Jacobian, JointVector, TaskVector, VectorLike, checked, frozen_copy, gains, vector
from eos_pin.charts._basis import solve_gram
from eos_pin.control.base import TaskController
from eos_pin.control.operational import NullSpaceLaw
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task, TaskPoint
from eos_pin.trajectories.base import Trajectory

#: Length of the step of central differences, in radians or metres: about the cube root of rounding.
STEP = 6e-6
#: Where a gain kp/kd makes a velocity of a position, kd counts as at least this [1/s].
LEAST_DAMPING = 1e-9
#: Weight of a generalised inverse: the identity, the mass matrix, or a stiffness of the joints.
Consistency: TypeAlias = Literal["static", "dynamic", "stiffness"]


def right_inverse(J: Jacobian, Y: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Generalised inverse Y (J Y)⁻¹ of J; with Y = X Jᵀ the one that is weighted by X⁻¹, for symmetric positive X.

    Raises:
        SingularError: J has not full rank.
    """
    return solve_gram(J, Y, Y.T, "its Jacobian has no generalised inverse").T


def jacobian_rate(task: Task, q: JointVector, dq: JointVector) -> Jacobian:
    """Time derivative of the Jacobian along dq, by central differences."""
    speed = float(np.sqrt(dq.dot(dq)))
    if speed == 0.0:
        return np.zeros((task.m, q.size))
    step = (STEP / speed) * dq
    return (task._linearize(q + step)[1] - task._linearize(q - step)[1]) * (0.5 * speed / STEP)


def inverse_rate(J: Jacobian, dJ: Jacobian, J_plus: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Time derivative of the Moore–Penrose inverse of a J of full row rank: −J⁺J̇J⁺ + (I − J⁺J) J̇ᵀ(J⁺)ᵀJ⁺."""
    outer = dJ.T @ (J_plus.T @ J_plus)
    return outer - J_plus @ (J @ outer + dJ @ J_plus)


def free_inertia(robot: Robot, q: JointVector) -> JointVector:
    """Inertia of each joint with all other joints free, 1/(M⁻¹)ᵢᵢ [kg m² or kg]."""
    return frozen_copy(1.0 / np.diag(np.linalg.inv(robot.mass(q))))


class PostureController(TaskController):
    """A law that tracks a task and draws the joints to a posture as far as the task lets it.

    Args:
        task: The task.
        reference: Trajectory of the task.
        posture: Posture that the joints are drawn to, (n,) [rad or m].
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        kp_posture: Gain on the posture, one number or (n,) [1/s²].
        kd_posture: Damping, one number or (n,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        posture: VectorLike,
        *,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        kp_posture: float | VectorLike = 100.0,
        kd_posture: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
    ) -> None:
        super().__init__(task, reference, kp=kp, kd=kd, feedforward=feedforward, gravity=gravity)
        n = task.robot.n
        self.posture = frozen_copy(vector(posture, n, "the posture"))
        self.kp_posture = frozen_copy(gains(kp_posture, n, "the posture gain kp"))
        self.kd_posture = frozen_copy(gains(kd_posture, n, "the posture gain kd"))
        #: Inertia of each joint at the posture, all others free: it makes torques of gains in 1/s² where a law has no
        #: mass matrix. With all others fixed it is many times as much, and dampers made of that too stiff for any loop.
        self.inertia = free_inertia(task.robot, self.posture)

    def describe(self) -> dict[str, Any]:
        named = ("posture", "kp_posture", "kd_posture")
        return super().describe() | {name: getattr(self, name).tolist() for name in named}

    def pull(self, q: JointVector, dq: JointVector) -> JointVector:
        """Joint acceleration ξ = kp (posture − q) − kd dq that is asked for in the null space."""
        return self.kp_posture * self.robot._way(q, self.posture) - self.kd_posture * dq

    def drawn(self, q: JointVector, dq: JointVector) -> tuple[JointVector, JointVector]:
        """Joint velocity ξ₁ = (kp/kd)(posture − q) that is asked for in the null space, and its time derivative."""
        k = self.kp_posture / np.maximum(self.kd_posture, LEAST_DAMPING)
        return k * self.robot._way(q, self.posture), -k * dq


class AccelerationController(PostureController):
    """Such a law that is made of the task acceleration that is asked for."""

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        point = self.task._at(q, dq)
        return self.law(q, dq, point, self._task_acceleration(t, point) - point.drift)

    @abstractmethod
    def law(self, q: JointVector, dq: JointVector, point: TaskPoint, ddz: TaskVector) -> JointVector:
        """Torque of the law [N m or N].

        Args:
            q: Joints.
            dq: Joint velocities.
            point: Task point there.
            ddz: Task acceleration that is asked for, without the drift: ddz_r − J̇ dq, (m,).
        """


class SpringNullSpace(NullSpaceLaw):
    """A spring and a damper in each joint, in the null space, without the mass matrix.

    Args:
        q: Posture at which the springs rest, (n,) [rad or m].
        stiffness: Stiffness, (n,) [N m/rad or N/m].
        damping: Damping, (n,) [N m s/rad or N s/m].
        compensates: Whether Coriolis and gravity torques are compensated in the null space, too.
    """

    @checked
    def __init__(self, q: VectorLike, *, stiffness: VectorLike, damping: VectorLike, compensates: bool = True) -> None:
        self.q = frozen_copy(vector(q, None, "the posture"))
        self.stiffness = frozen_copy(gains(stiffness, self.q.size, "the stiffness"))
        self.damping = frozen_copy(gains(damping, self.q.size, "the damping"))
        self.compensates = compensates

    def torque(self, robot: Robot, q: JointVector, dq: JointVector) -> JointVector:
        if self.q.size != robot.n:
            raise InputError(f"the posture has {self.q.size} joints, {robot.name!r} has {robot.n}")
        return self.stiffness * robot._way(q, self.q) - self.damping * dq
