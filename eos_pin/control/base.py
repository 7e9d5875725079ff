"""The contract of controllers, and the part that all task controllers share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Checked,
    JointVector,
    TaskVector,
    Vector,
    VectorLike,
    by_value,
    checked,
    frozen_copy,
    gains,
    number,
    truth,
    unchecked,
    vector_of,
)
from eos_pin.charts.chart import Chart
from eos_pin.control.objectives import Further
from eos_pin.errors import InputError, Renamed
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point, Task, TaskPoint
from eos_pin.trajectories.base import Target, Trajectory, check_reference


@by_value
class ControlReport(NamedTuple):
    """Torque of a controller in one state, and its effect on the task.

    Attributes:
        tau: Joint torques [N m or N].
        z: Task point; empty without a task.
        dz: Task velocity [m/s, rad/s].
        deficit_from_singularity: Task acceleration given up because the task is nearly singular, (m,); NaN where the
            controller does not measure it.
        deficit_from_limits: Task acceleration given up to limits, (m,); NaN likewise.
        further: Further task that the self-motion tracks; None where none is.
    """

    tau: JointVector
    z: Point
    dz: TaskVector
    deficit_from_singularity: TaskVector
    deficit_from_limits: TaskVector
    further: Further | None = None


#: Largest relative difference of two control periods that are the same.
SAME_PERIOD = 1e-9


class Controller(Checked, ABC):
    """Torques for a robot, as a pure function of time, state and an explicit memory.

    This class is all that the drivers (`simulate`, `simulate_extended`, `simulate_sampled` and `ControlLoop`) ask of a
    controller. A controller of one's own defines `torque`, and sets `robot`, `task` and `reference` in its constructor
    as far as it has them; every other method has a default that fits a controller without memory. See docs/extending.md
    and examples/10_own_controller.py.

    Attributes:
        robot: The model that the controller uses, which need not be the plant; None if it has none.
        task: Task whose errors are recorded; None where there is none.
        reference: Trajectory of the task; None where there is none.
        control_period: Period at which it has to be called [s]; None where any will do.
    """

    robot: Robot | None = None
    task: Task | None = None
    reference: Trajectory | None = None
    control_period: float | None = None

    # -- the law -----------------------------------------------------------------------------------------------------

    @checked
    def start(self, t: float, q: JointVector, dq: JointVector) -> Any:
        """Memory at the start of a run; None for a controller that needs none."""
        return None

    @abstractmethod
    @checked
    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        """Joint torques F^y [N m or N]; never changes anything."""

    @checked
    def validity(self, t: float, q: JointVector, dq: JointVector, state: Any) -> float:
        """Function that is positive while `memory` is valid; at its zero a driver stops and calls `update`."""
        return 1.0

    @checked
    def update(self, t: float, q: JointVector, dq: JointVector, state: Any) -> Any:
        """Memory for the time from here on."""
        return state

    @checked
    def take_over(self, t: float, q: JointVector, dq: JointVector, state: Any) -> Any:
        """Memory at a state where a loop goes over to this controller from another one, whose memory is given.

        By default that at the start of a run.
        """
        return self._start(t, q, dq)

    @checked
    def step(self, t: float, q: JointVector, dq: JointVector, state: Any) -> tuple[JointVector, Any]:
        """Torque and memory of one period of a sampled loop: `update` where it is due, then `torque`."""
        if self._validity(t, q, dq, state) <= 0.0:
            state = self._update(t, q, dq, state)
        return self._torque(t, q, dq, state), state

    def describe(self) -> dict[str, Any]:
        """Name and settings in plain values, for the provenance of a run."""
        return {"kind": type(self).__name__}

    # -- questions of drivers ----------------------------------------------------------------------------------------

    @checked
    def check_plant(self, plant: Robot) -> None:
        """Refuse a plant that does not fit; a controller that needs more of its plant overrides this.

        Raises:
            InputError: The plant has another number of joints than the controller's robot.
        """
        if self.robot is not None and self.robot.n != plant.n:
            raise InputError(f"the controller is for {self.robot.n} joints, the plant {plant.name!r} has {plant.n}")

    @checked
    def evaluate(
        self, t: float, q: JointVector, dq: JointVector, state: Any, tau: JointVector | None = None
    ) -> ControlReport:
        """Torque in a state and its effect on the task, for the record of a run.

        Args:
            t: Time [s].
            q: Joints.
            dq: Joint velocities.
            state: Memory.
            tau: Torque that acts, where a sampled run holds one; by default that of `torque`.
        """
        tau, nothing = self.torque(t, q, dq, state) if tau is None else tau, np.zeros(0)
        if self.task is None:
            return ControlReport(tau, nothing, nothing, nothing, nothing)
        point, unknown = self.task._at(q, dq), np.full(self.task.m, np.nan)
        return ControlReport(tau, point.z, point.dz, unknown, unknown)

    @checked
    def task_deficit(self, t: float, q: JointVector, dq: JointVector, state: Any) -> TaskVector | None:
        """Commanded task acceleration less the one that the torque causes, (m,); None if it is not known."""
        return None

    @checked
    def chart(self, state: Any) -> Chart | None:
        """Chart that the memory is on; None for a controller without charts."""
        return None

    @checked
    def self_motion_target(self, t: float, state: Any) -> Target | None:
        """Self-motion (v, dv, ddv) that is tracked at time t; None if none is."""
        return None

    @checked
    def holding_torque(self, q: JointVector) -> JointVector:
        """Torque at rest from which a soft start begins: that of gravity, by the controller's own model [N m or N]."""
        return np.zeros(q.size) if self.robot is None else self.robot._gravity(q)

    @checked
    def broken_limits(
        self, t: Vector, q: Float[Array, "T n"], dq: Float[Array, "T n"], tau: Float[Array, "T n"]
    ) -> str:
        """Sentence about limits that the controller should keep and a run exceeded; empty if there are none.

        Args:
            t: Times [s], (T,).
            q: Joints, (T, n).
            dq: Joint velocities, (T, n).
            tau: Torques, (T, n).
        """
        return ""

    def joint_distances(self, t: Vector, q: Float[Array, "T n"]) -> Vector | None:
        """Largest difference of a joint from joints that are followed, at each time [rad or m]; None where none are.

        Args:
            t: Times [s], (T,).
            q: Joints, (T, n).
        """
        return None

    # -- the same without checks, for inner loops ----------------------------------------------------------------------

    _start = unchecked(start)
    _torque = unchecked(torque)
    _validity = unchecked(validity)
    _update = unchecked(update)
    _take_over = unchecked(take_over)
    _step = unchecked(step)
    _check_plant = unchecked(check_plant)
    _evaluate = unchecked(evaluate)
    _task_deficit = unchecked(task_deficit)
    _chart = unchecked(chart)
    _self_motion_target = unchecked(self_motion_target)
    _holding_torque = unchecked(holding_torque)
    _broken_limits = unchecked(broken_limits)

    @property
    def unset(self) -> tuple[str, ...]:
        """Names among `task` and `reference` that neither the class nor its constructor has set, not even to None."""
        own = [vars(self), *(vars(base) for base in type(self).__mro__ if base is not Controller)]
        return tuple(name for name in ("task", "reference") if not any(name in names for names in own))


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
        task: The task; its robot is the model that the controller uses, which need not be the plant.
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
    #: Whether the task is told the time before it is evaluated.
    _tells_time = False

    @checked
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
        if not self._tells_time:
            task.check_still(type(self).__name__)
        self._version, self._model = object(), task.robot
        self.robot: Robot = task.robot
        self.task: Task = task
        self.feedforward, self.gravity = feedforward, gravity
        self.kp: TaskVector
        self.kd: TaskVector
        self.reference: Trajectory
        self.kp, self.kd, self.reference = kp, kd, reference  # type: ignore[assignment]

    def __setattr__(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, self._accepted(name, value))
        if name in ("kp", "kd", "self_motion", "smooth"):
            self.renew()

    def renew(self) -> None:
        """Rebuild cached parts at the next torque after an assignment."""
        object.__setattr__(self, "_version", object())

    def _accepted(self, name: str, value: Any) -> Any:
        """A value to be assigned, checked and in the form in which it is kept.

        Raises:
            InputError: It does not fit.
        """
        if name in ("kp", "kd"):
            return frozen_copy(gains(value, self.task.m, f"the task gain {name}"))
        if name in ("feedforward", "gravity"):
            value = truth(value, name)
        if name == "reference":
            check_reference(self.task, value)
        elif name == "gravity":
            object.__setattr__(self, "_model", self.robot if value else self.robot.with_gravity(0.0))
        elif name in ("task", "robot") and name in vars(self):
            raise InputError(
                f"the {name} of a controller cannot be changed. Make another controller; a running loop takes it over "
                "by: loop.controller = …"
            )
        return value

    def describe(self) -> dict[str, Any]:
        return super().describe() | {
            "kp": self.kp.tolist(),
            "kd": self.kd.tolist(),
            "feedforward": self.feedforward,
            "gravity": self.gravity,
            "robot": self.robot.name,
            "reference": type(self.reference).__name__,
        }

    @checked
    def task_acceleration(self, t: float, point: TaskPoint) -> TaskVector:
        """Task part of F*: ddz_d + kd (dz_d − dz) + kp (z_d − z); Eqs. (33), (36)."""
        target = self.reference(t)
        if not self.feedforward:
            rest = np.zeros(self.task.m)
            target = Target(target.z, rest, rest)
        return self.task._tracking_acceleration(point.z, point.dz, target, self.kp, self.kd)

    _task_acceleration = unchecked(task_acceleration)

    def holding_torque(self, q: JointVector) -> JointVector:
        # Without gravity where the controller leaves that to the plant.
        return self._model._gravity(q)

    def task_deficit(self, t: float, q: JointVector, dq: JointVector, state: Any) -> TaskVector:
        """Commanded task acceleration less the one that the torque causes, by the controller's own model.

        Zero to rounding where the controller does all it is asked; see `EosController` and `LimitedEosController` for
        where it does not.
        """
        point = self.task._at(q, dq)
        ddq = self._model._forward_dynamics(q, dq, self._torque(t, q, dq, state))
        return self._task_acceleration(t, point) - point.J @ ddq - point.drift


class OpenLoop(Controller):
    """Torques that are a given function of time.

    Args:
        tau: Function of t [s] that returns the torques (n,) [N m or N].
    """

    task = reference = None

    @checked
    def __init__(self, tau: Callable[[float], VectorLike]) -> None:
        self.tau = tau

    def torque(self, t: float, q: JointVector, dq: JointVector, state: Any) -> JointVector:
        return vector_of("tau of an OpenLoop", q.size, self.tau, t)
