"""Controllers: from the robot's state to joint torques.

A controller is a value. What it must remember between calls (the chart it is on) is an explicit memory, so that a
driver may evaluate `torque` at trial times and states, as an ODE solver does, without changing anything; only
`update`, called once where a step has been accepted, may move on to the next chart. For a loop of your own,
`eos_pin.ControlLoop` keeps the memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from eos_pin.arrays import Jacobian, JointVector, TaskVector, VectorLike, readonly, spread, vector
from eos_pin.atlas import Atlas
from eos_pin.charts import Chart
from eos_pin.driving import Drive
from eos_pin.errors import InputError, SingularError
from eos_pin.memories import EosMemory, Observation
from eos_pin.objectives import Objective, Track
from eos_pin.robot import Robot
from eos_pin.targets import Target, Trajectory, check_reference
from eos_pin.tasks import Task, TaskPoint


class Controller(ABC):
    """Torques for a robot, as a pure function of time, state and an explicit memory."""

    def start(self, t: float, q: JointVector, dq: JointVector) -> Any:
        """Memory at the start of a run; None for a controller that needs none."""
        return None

    @abstractmethod
    def torque(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> JointVector:
        """Joint torques F^y [N m or N]; never changes anything."""

    def margin(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> float:
        """Positive while `memory` serves; where it crosses zero a driver stops and calls `update`."""
        return 1.0

    def update(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> Any:
        """Memory for the time from here on."""
        return memory

    def take_over(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> Any:
        """Memory at a state where a loop goes over to this controller from another one, whose memory is given.

        By default that at the start of a run.
        """
        return self.start(t, q, dq)

    def step(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> tuple[JointVector, Any]:
        """Torque and memory of one period of a sampled loop: `update` where it is due, then `torque`."""
        if self.margin(t, q, dq, memory) <= 0.0:
            memory = self.update(t, q, dq, memory)
        return self.torque(t, q, dq, memory), memory

    def describe(self) -> dict[str, Any]:
        """What it is, in plain values, for the provenance of a run."""
        return {"kind": type(self).__name__}


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
            return readonly(spread(value, self.task.m, f"the task gain {name}"))
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
        pull = self.kp * self.task.minus(z_d, point.z)
        if not self.feedforward:
            return pull - self.kd * point.dz
        pull += self.kd * (dz_d - point.dz)
        pull += ddz_d
        return pull

    def given_up(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> TaskVector:
        """Task acceleration that the law asks for and the torque does not bring, by the controller's own model.

        Zero to rounding where the controller does all it is asked; see `EosController` and `LimitedEosController` for
        where it does not.
        """
        point = self.task.at(q, dq)
        ddq = self._model.forward_dynamics(q, dq, self.torque(t, q, dq, memory))
        return self.task_acceleration(t, point) - point.J @ ddq - point.drift


class EosController(TaskController):
    """Computed torque in extended operational space: task and self-motion on laws of their own.

    F^y = M(H F* + E) − R, Eqs. (35), (44), with the task part of F* from Eqs. (36), (45) and its self-motion part from
    an objective. H F* + E is the acceleration ddq that solves [G'; Vᵀ] ddq = (F_z − Ġ'dq, F_v), so the torque is
    the inverse dynamics of it and no mass matrix is formed. With an exact model, task and self-motion errors obey
    ε̈ + kd ε̇ + kp ε = 0 independently of each other.

    Near a singularity of the task the direction that is being lost is given up by degrees and braked there, so that the
    torque stays bounded and continuous; it is taken up again as the rank returns. `given_up` says how much is lost.
    Where the chart changes the torque is continuous, too: what the law then asks of v, it gets within 1/20 s.

    Args:
        task: The task.
        reference: Trajectory of the task.
        self_motion: What the self-motion should do; by default hold v at its value at the start.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.
        smooth: Whether the torque is kept bounded and continuous. Without, the law is the paper's to the last: it jumps
            with dv where the chart changes, and ends where the task is singular.
    """

    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        self_motion: Objective | None = None,
        *,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
        atlas: Atlas | None = None,
        smooth: bool = True,
    ) -> None:
        super().__init__(task, reference, kp=kp, kd=kd, feedforward=feedforward, gravity=gravity)
        self.smooth = smooth
        self._rest, self._unchanged = readonly(np.zeros(task.m)), readonly(np.zeros(task.robot.n))
        self._turns = task.robot.turns
        self._renewed: tuple[Any, Any] = (None, None)
        self.self_motion = self_motion or Track()
        self.atlas = atlas or Atlas(task)

    def _accepted(self, name: str, value: Any) -> Any:
        if name == "atlas" and value.task is not self.task:
            raise InputError("the atlas of an EosController must be of the controller's own task object")
        if name == "self_motion" and hasattr(self, name):
            value.check(self.robot.n, self.robot.n - self.task.m)
        return super()._accepted(name, value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # A copy is not yet known to its objective.
        self.renew()

    def start(self, t: float, q: JointVector, dq: JointVector) -> EosMemory:
        chart = self.atlas.start(q)
        self._check_objective(t, q, dq, chart)
        return self._memory(chart, 0)

    def take_over(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> EosMemory:
        """As for any controller; but for the same task on the same robot the chart stays, and with it what v means."""
        if not isinstance(memory, EosMemory) or (
            memory.chart.task is not self.task
            and (memory.chart.task.robot, memory.chart.task.describe()) != (self.robot, self.task.describe())
        ):
            return self.start(t, q, dq)
        chart = memory.chart if memory.chart.task is self.task else replace(memory.chart, task=self.task)
        self._check_objective(t, q, dq, chart)
        return replace(memory, **self._made(chart))

    def _check_objective(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> None:
        """Refuse a wrong shape of v_d or of its gains here, not in the middle of a run."""
        try:
            F_v = self.self_motion.acceleration(t, q, dq, chart)
        except ValueError as error:
            raise InputError(f"the self-motion objective does not fit this robot and task: {error}") from error
        vector(F_v, chart.r, f"what {type(self.self_motion).__name__} asks of the self-motion")

    def _memory(self, chart: Chart, number: int) -> EosMemory:
        return EosMemory(number=number, **self._made(chart))

    def _made(self, chart: Chart) -> dict[str, Any]:
        """What a memory holds of gains, targets and the chart."""
        drive, track, law = Drive(chart, smooth=self.smooth), self.self_motion, None
        # A law of one's own is used as it is.
        if type(track) is Track and type(self).task_acceleration is TaskController.task_acceleration:
            law = drive.tracking_law(self.kp, self.kd, *track.law(chart.r))
            track.users.add(self)
        return {"drive": drive, "law": law, "made_of": self._version}

    def _current(self, memory: EosMemory) -> EosMemory:
        """The same memory, made anew where it was made of other gains or another target than there are now."""
        if memory.made_of is self._version:
            return memory
        if memory.chart.task is not self.task:
            raise InputError(
                "this memory is of a controller with another task object; take_over(t, q, dq, memory) makes one of it"
            )
        before, renewed = self._renewed
        if before is not memory or renewed.made_of is not self._version:
            renewed = replace(memory, **self._made(memory.chart))
            self._renewed = memory, renewed
        return renewed

    def torque(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> JointVector:
        q = memory.chart.unwrap(q)
        ddq, _, J = self._drive(t, q, dq, self._current(memory))
        return self._within(q, dq, ddq, J)[0]

    def _drive(
        self, t: float, q: JointVector, dq: JointVector, memory: EosMemory
    ) -> tuple[JointVector, float, Jacobian]:
        """H F* + E, a bound of the chart's margin, and G'; near a singularity of the task what `Drive` makes of it."""
        more = None if memory.carried is None else memory.left(t, dq)
        if memory.law is not None:
            z_d, dz_d, ddz_d = self.reference(t)
            if not self.feedforward:
                dz_d = ddz_d = self._rest
            driven = memory.law(q, dq, z_d, dz_d, ddz_d, more)
            if driven is not None:
                return driven
        point = self.task.at(q, dq)
        F = self.asked(t, q, dq, memory.chart, point)
        if more is not None:
            F[point.dz.size :] += more
        return *memory.drive(point.J, F, dq), point.J

    def asked(self, t: float, q: JointVector, dq: JointVector, chart: Chart, point: TaskPoint) -> JointVector:
        """F* less the task's drift: (F_z − Ġ'dq, F_v), (n,); Eqs. (36), (45)."""
        F_z = self.task_acceleration(t, point) - point.drift
        return np.concatenate((F_z, self.self_motion.acceleration(t, q, dq, chart)))

    def _within(
        self, q: JointVector, dq: JointVector, ddq: JointVector, J: Jacobian
    ) -> tuple[JointVector, JointVector]:
        """M ddq − R, Eq. (35), and what limits change in ddq on average over a period; nothing here."""
        return self._model.inverse_dynamics(q, dq, ddq), self._unchanged

    def given_up(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> TaskVector:
        found = self.observe(t, q, dq, memory)
        return found.to_singularity + found.to_limits

    def observe(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> Observation:
        """The torque at a state, and what it is made of, for the record of a run."""
        q = memory.chart.unwrap(q)
        ddq, margin, J = self._drive(t, q, dq, self._current(memory))
        tau, change = self._within(q, dq, ddq, J)
        singular = self._rest
        # Where a direction fades no bound of the margin comes with the acceleration.
        if margin <= 0.0:
            point = self.task.at(q, dq)
            singular = self.task_acceleration(t, point) - J.dot(ddq) - point.drift
        limited = self._rest if change is self._unchanged else -J.dot(change)
        return Observation(tau, self.task.value(q), J.dot(dq), singular, limited)

    def margin(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> float:
        _, J = self.task.linearize(q)
        memory = self._current(memory)
        try:
            margin = memory.drive.margin(J, self.atlas.threshold) - self.atlas.threshold
            return min(margin, memory.chart.room(q)) if self._turns else margin
        except SingularError:
            # No chart can be made here; the one there is serves until the task has full rank again.
            return 1.0

    def update(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> EosMemory:
        q = memory.chart.unwrap(q)
        try:
            chart = self.atlas.next(memory.chart, q)
        except SingularError:
            return memory
        following = self._memory(chart, memory.number + 1)
        if not self.smooth:
            return following
        # dv is another on the new chart, and so is what the law asks of it; the difference is forgotten by and by.
        ddq, _, _ = self._drive(t, q, dq, self._current(memory))
        F = self.asked(t, q, dq, chart, self.task.at(q, dq))
        return replace(following, since=t, carried=chart.dv(ddq) - F[chart.m :])

    def step(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> tuple[JointVector, EosMemory]:
        if memory.made_of is not self._version:
            memory = self._current(memory)
        turned = self._turns and not memory.chart.is_near(q)
        if turned:
            q, turned = memory.chart.unwrap(q), memory.chart.room(q) <= 0.0
        ddq, margin, J = self._drive(t, q, dq, memory)
        # The bound that comes with the acceleration saves the chart's exact margin nearly always.
        if turned or (margin <= self.atlas.threshold and not self._holds(memory.chart, J)):
            memory = self.update(t, q, dq, memory)
            ddq, _, J = self._drive(t, q, dq, memory)
        return self._within(q, dq, ddq, J)[0], memory

    def _holds(self, chart: Chart, J: Jacobian) -> bool:
        """Whether the chart serves; where no chart can be made, the one there is does."""
        try:
            return self.atlas.holds(chart, J)
        except SingularError:
            return True

    def describe(self) -> dict[str, Any]:
        return super().describe() | {
            "self_motion": type(self.self_motion).__name__,
            "threshold": self.atlas.threshold,
            "smooth": self.smooth,
        }

    def self_motion_target(self, t: float, memory: EosMemory) -> Target | None:
        """Self-motion that is tracked at time t; None if the objective tracks none."""
        return self.self_motion.target(t, memory.chart.r)


class OpenLoop(Controller):
    """Torques that are a given function of time.

    Args:
        tau: Function of t [s] that returns the torques (n,) [N m or N].
    """

    def __init__(self, tau: Callable[[float], VectorLike]) -> None:
        self.tau = tau

    def torque(self, t: float, q: JointVector, dq: JointVector, memory: Any) -> JointVector:
        return np.asarray(self.tau(t), dtype=float)
