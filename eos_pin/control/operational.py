"""Traditional task-space control, to compare with.

`OperationalSpaceController` is the paper's, Eqs. (32), (33), (38), (43), and with other null-space laws the controller
in everyday use. Each popular variant has a name in `BASELINES`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lapack

from eos_pin._arrays import (
    Checked,
    JointVector,
    NonNegative,
    VectorLike,
    by_value,
    checked,
    of_type,
    truth,
    unchecked,
)
from eos_pin.charts._basis import solve_gram
from eos_pin.control.base import TaskController
from eos_pin.control.objectives import ReduceKineticEnergy, posture_value
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory


class NullSpaceLaw(Checked, ABC):
    """A torque F⁰ that acts through Nᵀ, and so does not accelerate the task.

    Attributes:
        compensates: Whether Coriolis and gravity torques are also compensated in the null space. The paper's control
            does not: there the robot falls freely wherever the task lets it.
    """

    compensates: bool = True

    @abstractmethod
    @checked
    def torque(self, robot: Robot, q: JointVector, dq: JointVector) -> JointVector:
        """Torque F⁰ before projection [N m or N]."""

    _torque = unchecked(torque)


@dataclass(frozen=True)
class FreeNullSpace(NullSpaceLaw):
    """No torque in the null space: Eqs. (32), (33), (43) as printed."""

    compensates = False

    def torque(self, robot: Robot, q: JointVector, dq: JointVector) -> JointVector:
        return np.zeros(robot.n)


@by_value
@dataclass(frozen=True, eq=False)
class EnergyNullSpace(NullSpaceLaw):
    """Negative gradient of the kinetic energy; Eq. (38).

    Attributes:
        objective: Whose gradient it is, and how much of it.
    """

    objective: ReduceKineticEnergy
    compensates = False

    def torque(self, robot: Robot, q: JointVector, dq: JointVector) -> JointVector:
        return -self.objective.gain * self.objective.energy_gradient(q, dq)


@checked
@dataclass(frozen=True)
class DampedNullSpace(NullSpaceLaw):
    """Joint damping M (−kd dq) in the null space.

    Attributes:
        kd: Damping [1/s].
    """

    kd: NonNegative = 20.0

    def torque(self, robot: Robot, q: JointVector, dq: JointVector) -> JointVector:
        return robot._mass(q) @ (-self.kd * dq)


class PostureNullSpace(NullSpaceLaw):
    """Posture control M (kp (q_rest − q) − kd dq) in the null space, the most common law.

    Continuous joints go the shorter way round, see `Robot.way`. `q`, `kp` and `kd` may be assigned at any time.

    Args:
        q: Posture, (n,) [rad or m].
        kp: Gain [1/s²].
        kd: Damping [1/s].
    """

    @checked
    def __init__(self, q: VectorLike, *, kp: float | VectorLike = 100.0, kd: float | VectorLike = 20.0) -> None:
        self.q: JointVector
        self.q, self.kp, self.kd = q, kp, kd  # type: ignore[assignment]

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, posture_value(self, name, value))

    def torque(self, robot: Robot, q: JointVector, dq: JointVector) -> JointVector:
        if self.q.size != robot.n:
            raise InputError(f"the posture has {self.q.size} joints, {robot.name!r} has {robot.n}")
        return robot._mass(q) @ (self.kp * robot._way(q, self.q) - self.kd * dq)


class OperationalSpaceController(TaskController):
    """Khatib's task-space control F^y = G'ᵀ(Λ F* + μ + p) + NᵀF⁰; Eqs. (32), (33), (38), (43).

    Args:
        task: The task.
        reference: Trajectory of the task.
        null_space: Law for the null space; by default none, as in the paper.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        drift: Whether the Jacobian's time derivative (Ġ'dq in μ) is used; many implementations leave it out.
        gravity: Whether the controller compensates gravity.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        null_space: NullSpaceLaw | None = None,
        *,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        feedforward: bool = True,
        drift: bool = True,
        gravity: bool = True,
    ) -> None:
        super().__init__(task, reference, kp=kp, kd=kd, feedforward=feedforward, gravity=gravity)
        self.null_space = null_space or FreeNullSpace()
        self.drift = drift

    def _accepted(self, name: str, value: Any) -> Any:
        if name == "drift":
            return truth(value, name)
        return super()._accepted(
            name, of_type(value, "the null space", NullSpaceLaw) if name == "null_space" else value
        )

    def describe(self) -> dict[str, Any]:
        return super().describe() | {
            "null_space": type(self.null_space).__name__,
            "drift": self.drift,
        }

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        point, model = self.task._at(q, dq), self._model
        ddz = self._task_acceleration(t, point)
        if self.drift:
            ddz = ddz - point.drift
        # The torque is G'ᵀΛ(ddz + G'M⁻¹(bias − F⁰)) + F⁰, with M = LLᵀ and Y = M⁻¹G'ᵀ, so that Λ = (G'Y)⁻¹. OpenBLAS
        # starts its threads for dtrtrs whatever the size, which can take a thousand times as long; not for dpotrs.
        bias = model._bias(q, dq)
        null = self.null_space._torque(model, q, dq)
        if self.null_space.compensates:
            null = null + bias
        L, _ = lapack.dpotrf(model._mass(q), lower=1)
        Y, _ = lapack.dpotrs(L, point.J.T, lower=1)
        force = solve_gram(point.J, Y, ddz + Y.T.dot(bias - null), "its mass matrix Λ does not exist")
        return point.J.T.dot(force) + null


#: Ready-made variants by name. Each is a function of the task, its trajectory and the posture at the start.
BASELINES: Mapping[str, Callable[[Task, Trajectory, JointVector], OperationalSpaceController]] = {
    "task-space": lambda task, reference, q: OperationalSpaceController(task, reference),
    "task-space-energy": lambda task, reference, q: OperationalSpaceController(
        task, reference, EnergyNullSpace(ReduceKineticEnergy(task.robot))
    ),
    "null-space-damping": lambda task, reference, q: OperationalSpaceController(task, reference, DampedNullSpace()),
    "null-space-posture": lambda task, reference, q: OperationalSpaceController(task, reference, PostureNullSpace(q)),
    "without-drift": lambda task, reference, q: OperationalSpaceController(
        task, reference, PostureNullSpace(q), drift=False
    ),
    "set-point": lambda task, reference, q: OperationalSpaceController(
        task, reference, PostureNullSpace(q), drift=False, feedforward=False
    ),
}
