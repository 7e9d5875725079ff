"""The contract of controllers, and the part that all task controllers share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from eos_pin._arrays import (
    JointVector,
    TaskVector,
    VectorLike,
    frozen_copy,
    gains,
    number,
)
from eos_pin.errors import InputError, Renamed
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task, TaskPoint
from eos_pin.trajectories.base import Trajectory, check_reference

#: Largest relative difference of two control periods that are the same.
SAME_PERIOD = 1e-9


class Controller(ABC):
    """Torques for a robot, as a pure function of time, state and an explicit memory.

    Attributes:
        control_period: Period at which it has to be called [s]; None where any will do.
    """

    control_period: float | None = None

    def start(self, t: float, q: JointVector, dq: JointVector) -> Any:
        """Memory at the start of a run; None for a controller that needs none."""
        return None

    @abstractmethod
    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        """Joint torques F^y [N m or N]; never changes anything."""

    def validity(self, t: float, q: JointVector, dq: JointVector, state: Any) -> float:
        """Positive while `memory` serves; where it crosses zero a driver stops and calls `update`."""
        return 1.0

    def update(self, t: float, q: JointVector, dq: JointVector, state: Any) -> Any:
        """Memory for the time from here on."""
        return state

    def take_over(self, t: float, q: JointVector, dq: JointVector, state: Any) -> Any:
        """Memory at a state where a loop goes over to this controller from another one, whose memory is given.

        By default that at the start of a run.
        """
        return self.start(t, q, dq)

    def step(self, t: float, q: JointVector, dq: JointVector, state: Any) -> tuple[JointVector, Any]:
        """Torque and memory of one period of a sampled loop: `update` where it is due, then `torque`."""
        if self.validity(t, q, dq, state) <= 0.0:
            state = self.update(t, q, dq, state)
        return self.torque(t, q, dq, state), state

    def describe(self) -> dict[str, Any]:
        """What it is, in plain values, for the provenance of a run."""
        return {"kind": type(self).__name__}


def agreed_period(controller: Controller, given: float | None) -> float | None:
    """Control period of a loop: that of its controller, or the one that is given; None where there is neither.

    Raises:
        InputError: Both are given and differ, or one is not above 0.
    """
    own = controller.control_period
    if given is None:
        return own
    number(given, "the control period", above=0.0)
    if own is not None and abs(own - given) > SAME_PERIOD * given:
        raise InputError(
            f"the controller is made for a control period of {own:g} s, the loop runs at {given:g} s: give the "
            f"{type(controller).__name__} control_period={given:g}, or leave the period of the loop to it"
        )
    return given


class TaskController(Controller):
    """A controller that makes a task follow a trajectory with linear error dynamics; Eq. (37).

    Its attributes may be assigned at any time, and count from the next torque on; a value that does not fit is refused.
    The task stays: for another one a `ControlLoop` takes another controller.

    Args:
        task: The task; its robot is the model the controller knows, which need not be the plant.
        reference: Trajectory of the task.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s]; 2 √kp is critically damped.
        feedforward: Whether dz and ddz of the reference are used. Without them the robot is drawn to where the
            reference is, and trails behind it, as set-point regulators do.
        gravity: Whether the controller compensates gravity.

    Raises:
        RobotError: The robot lacks mass.
        InputError: The reference does not fit the task, or a gain is no number.
    """

    given_up = Renamed("task_deficit")

    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        *,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
    ) -> None:
        task.robot.check_dynamics()
        self._version, self._model = object(), task.robot
        self.task, self.feedforward, self.gravity = task, feedforward, gravity
        self.kp: TaskVector
        self.kd: TaskVector
        self.kp, self.kd, self.reference = kp, kd, reference  # type: ignore[assignment]

    def __setattr__(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, self._accepted(name, value))
        if name in ("kp", "kd", "self_motion", "smooth"):
            self.renew()

    def renew(self) -> None:
        """Make anew, at the next torque, what was made of values that have been assigned since."""
        object.__setattr__(self, "_version", object())

    def _accepted(self, name: str, value: Any) -> Any:
        """A value to be assigned, checked and in the form in which it is kept.

        Raises:
            InputError: It does not fit.
        """
        if name in ("kp", "kd"):
            return frozen_copy(gains(value, self.task.m, f"the task gain {name}"))
        if name == "reference":
            check_reference(self.task, value)
        elif name == "gravity":
            object.__setattr__(self, "_model", self.robot if value else self.robot.with_gravity(0.0))
        elif name in ("task", "robot") and hasattr(self, "task"):
            raise InputError(
                f"the {name} of a controller cannot be changed. Make another controller; a running loop takes it over "
                "by: loop.controller = …"
            )
        return value

    @property
    def robot(self) -> Robot:
        """The model the controller knows."""
        return self.task.robot

    def describe(self) -> dict[str, Any]:
        return super().describe() | {
            "kp": self.kp.tolist(),
            "kd": self.kd.tolist(),
            "feedforward": self.feedforward,
            "gravity": self.gravity,
            "robot": self.robot.name,
            "reference": type(self.reference).__name__,
        }

    def task_acceleration(self, t: float, point: TaskPoint) -> TaskVector:
        """Task part of F*: ddz_d + kd (dz_d − dz) + kp (z_d − z); Eqs. (33), (36)."""
        z_d, dz_d, ddz_d = self.reference(t)
        pull = self.kp * self.task._minus(z_d, point.z)
        if not self.feedforward:
            return pull - self.kd * point.dz
        pull += self.kd * (dz_d - point.dz)
        pull += ddz_d
        return pull

    def task_deficit(self, t: float, q: JointVector, dq: JointVector, state: Any) -> TaskVector:
        """Task acceleration that the law asks for and the torque does not bring, by the controller's own model.

        Zero to rounding where the controller does all it is asked; see `EosController` and `LimitedEosController` for
        where it does not.
        """
        point = self.task._at(q, dq)
        ddq = self._model._forward_dynamics(q, dq, self.torque(t, q, dq, state))
        return self.task_acceleration(t, point) - point.J @ ddq - point.drift


class OpenLoop(Controller):
    """Torques that are a given function of time.

    Args:
        tau: Function of t [s] that returns the torques (n,) [N m or N].
    """

    def __init__(self, tau: Callable[[float], VectorLike]) -> None:
        self.tau = tau

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        return np.asarray(self.tau(t), dtype=float)
