"""`EosController`: computed torque in extended operational space, Secs. 5.2 to 6.2."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    TaskVector,
    Vector,
    VectorLike,
    checked,
    frozen_copy,
    of_type,
    truth,
    unchecked,
    vector,
)
from eos_pin._kernels.dispatch import DONE
from eos_pin._kernels.overrides import stands_for
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.control._regularize import AccelerationMap
from eos_pin.control.base import ControlReport, TaskController
from eos_pin.control.objectives import Objective, Track
from eos_pin.control.state import EosState
from eos_pin.errors import InputError, Renamed, SingularError
from eos_pin.tasks.base import Task, TaskPoint
from eos_pin.trajectories.base import Target, Trajectory


def law_for(task: Task, given: Objective | None) -> Objective:
    """Law of the self-motion beside a task, `Track()` by default; where r = 0 a law without a target is refused."""
    law = given or Track()
    if task.m == task.robot.n and law.target(0.0, 0) is None:
        kind = type(law).__name__
        raise InputError(f"self_motion={kind} does not apply: the task takes all joints (r = 0); leave it out")
    return law


class EosController(TaskController):
    """Computed torque in extended operational space: task and self-motion on laws of their own.

    F^y = M(H F* + E) − R, Eqs. (35), (44), with the task part of F* from Eqs. (36), (45) and its self-motion part from
    an objective. H F* + E is the acceleration ddq that solves [G'; Wᵀ] ddq = (F_z − Ġ'dq, F_v), so the torque is
    the inverse dynamics of it and no mass matrix is formed. With an exact model, task and self-motion errors obey
    ε̈ + kd ε̇ + kp ε = 0 independently of each other.

    Near a singularity of the task the direction that is being lost is given up by degrees and braked there, so that the
    torque stays bounded and continuous; it is taken up again as the rank returns. `task_deficit` is the lost part:
    nothing where joints are followed that have the task's point, such as those of a plan.
    Where the chart changes the torque is continuous, too: what the law then asks of v, it gets within 1/20 s.

    Args:
        task: The task.
        reference: Trajectory of the task.
        self_motion: Objective of the self-motion; by default to hold v at its value at the start.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.
        smooth: Whether the torque is kept bounded and continuous. Without, the law is the paper's to the last: it jumps
            with dv where the chart changes, and ends where the task is singular.
    """

    observe = Renamed("evaluate")
    _tells_time = True

    @checked
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
        self._rest, self._unchanged = frozen_copy(np.zeros(task.m)), frozen_copy(np.zeros(task.robot.n))
        self._turns = task.robot.turns
        self._renewed: tuple[Any, Any] = (None, None)
        self.self_motion = law_for(task, self_motion)
        self.atlas = atlas or Atlas(task)

    def __init_subclass__(cls, **rest: Any) -> None:
        # A law of one's own counts.
        stands_for(cls, "compiled_law", "task_acceleration", "asked", off=_no_law)
        super().__init_subclass__(**rest)

    def _accepted(self, name: str, value: Any) -> Any:
        if name == "smooth":
            return truth(value, name)
        if name == "atlas" and of_type(value, "the atlas", Atlas).task is not self.task:
            raise InputError("the atlas must be made of the controller's own task object: atlas=Atlas(task)")
        if name == "self_motion" and hasattr(self, name):
            of_type(value, "the self-motion", Objective).check(self.robot.n, self.robot.n - self.task.m)
        return super()._accepted(name, value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # A copy is not yet known to its objective.
        self.renew()

    def start(self, t: float, q: JointVector, dq: JointVector) -> EosState:
        self.task._set_time(t)
        chart = self.atlas.start(q)
        self._check_objective(t, q, dq, chart)
        return self._memory(chart, 0)

    def take_over(self, t: float, q: JointVector, dq: JointVector, state: Any) -> EosState:
        """Memory from that of another controller; for the same task on the same robot the chart, and so v, stays."""
        if not isinstance(state, EosState) or (
            state.chart.task is not self.task
            and (state.chart.task.robot, state.chart.task.describe()) != (self.robot, self.task.describe())
        ):
            return self._start(t, q, dq)
        chart = state.chart if state.chart.task is self.task else replace(state.chart, task=self.task)
        self._check_objective(t, q, dq, chart)
        return replace(state, **self._made(chart))

    def _check_objective(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> None:
        """Refuse a wrong shape of v_d or of its gains here, not in the middle of a run."""
        try:
            self.self_motion._check(chart.n, chart.r)
            F_v = self.self_motion._acceleration(t, q, dq, chart)
        except ValueError as error:
            raise InputError(f"the self-motion objective does not fit this robot and task: {error}") from error
        vector(F_v, chart.r, f"the self-motion acceleration of {type(self.self_motion).__name__}")
        self.self_motion.check_start(t, q, chart)

    def _memory(self, chart: Chart, number: int) -> EosState:
        return EosState(number=number, **self._made(chart))

    def _made(self, chart: Chart) -> dict[str, Any]:
        """The state's part made of gains, targets and the chart."""
        drive = AccelerationMap(chart, smooth=self.smooth)
        self.self_motion._add_user(self)
        return {"drive": drive, "law": self._compiled_law(drive), "made_of": self._version}

    @checked
    def compiled_law(self, drive: AccelerationMap) -> Any:
        """Compiled kernel of `asked` and `drive`; None if there is none for this law or its target."""
        held = self.self_motion._held_law(drive.chart.r)
        return None if held is None else drive.tracking_law(self.kp, self.kd, *held)

    def _current(self, state: EosState) -> EosState:
        """The same memory, made anew if gains or targets have changed since it was made."""
        if state.made_of is self._version:
            return state
        if state.chart.task is not self.task:
            raise InputError(
                "this memory is of a controller with another task object; take_over(t, q, dq, memory) makes one of it"
            )
        before, renewed = self._renewed
        if before is not state or renewed.made_of is not self._version:
            renewed = replace(state, **self._made(state.chart))
            self._renewed = state, renewed
        return renewed

    def torque(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> JointVector:
        q = state.chart._unwrap(q)
        ddq, _, J = self._drive(t, q, dq, self._current(state))
        return self._within(q, dq, ddq, J)[0]

    def _drive(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> tuple[JointVector, float, Jacobian]:
        """H F* + E, bounded near singularities by `AccelerationMap`, a bound of the chart's margin, and G'."""
        more = None if state.carried is None else state.left(t, dq)
        if state.law is not None:
            z_d, dz_d, ddz_d = self.reference(t)
            if not self.feedforward:
                dz_d = ddz_d = self._rest
            status, ddq, margin, J = state.law(q, dq, z_d, dz_d, ddz_d, more)
            if status == DONE:
                return ddq, margin, J
        self.task._set_time(t)
        point = self.task._at(q, dq)
        F = self._asked(t, q, dq, state.chart, point)
        if more is not None:
            F[point.dz.size :] += more
        lead = partial(self.self_motion._joint_acceleration, t, q, dq, self.robot)
        return *state.drive(point.J, F, dq, lead), point.J

    @checked
    def asked(self, t: float, q: JointVector, dq: JointVector, chart: Chart, point: TaskPoint) -> JointVector:
        """F* less the task's drift: (F_z − Ġ'dq, F_v), (n,); Eqs. (36), (45)."""
        F_z = self._task_acceleration(t, point) - point.drift
        return np.concatenate((F_z, self.self_motion._acceleration_beside(t, q, dq, chart, point.J, F_z)))

    def _within(
        self, q: JointVector, dq: JointVector, ddq: JointVector, J: Jacobian
    ) -> tuple[JointVector, JointVector]:
        """Torque M ddq − R, Eq. (35), and the mean change of ddq that limits make in a period; none here."""
        return self._model._inverse_dynamics(q, dq, ddq), self._unchanged

    def task_deficit(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> TaskVector:
        found = self._evaluate(t, q, dq, state)
        return found.deficit_from_singularity + found.deficit_from_limits

    def evaluate(
        self, t: float, q: JointVector, dq: JointVector, state: EosState, tau: JointVector | None = None
    ) -> ControlReport:
        # What the law asks for and gives up in this state, whatever torque is held.
        q = state.chart._unwrap(q)
        ddq, margin, J = self._drive(t, q, dq, self._current(state))
        asked, change = self._within(q, dq, ddq, J)
        singular = self._rest
        # Where a direction fades no bound of the margin comes with the acceleration.
        if margin <= 0.0:
            point = self.task._at(q, dq)
            singular = self._task_acceleration(t, point) - J.dot(ddq) - point.drift
        limited = self._rest if change is self._unchanged else -J.dot(change)
        dz = self.task._at(q, dq).dz if self.task.moves else J.dot(dq)
        further = self.self_motion._further(t, q, change)
        return ControlReport(asked if tau is None else tau, self.task._value(q), dz, singular, limited, further)

    def validity(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> float:
        self.task._set_time(t)
        _, J = self.task._linearize(q)
        state = self._current(state)
        try:
            margin = state.drive.margin(J, self.atlas.threshold) - self.atlas.threshold
            return min(margin, state.chart._room(q)) if self._turns else margin
        except SingularError:
            # No chart can be made here; the one there is serves until the task has full rank again.
            return 1.0

    def update(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> EosState:
        q = state.chart._unwrap(q)
        self.task._set_time(t)
        try:
            chart = self.atlas.next(state.chart, q)
        except SingularError:
            return state
        following = self._memory(chart, state.number + 1)
        if not self.smooth:
            return following
        # dv is another on the new chart, and so is what the law asks of it; the difference is forgotten by and by.
        ddq, _, _ = self._drive(t, q, dq, self._current(state))
        F = self._asked(t, q, dq, chart, self.task._at(q, dq))
        return replace(following, since=t, carried=chart._dv(ddq) - F[chart.m :])

    def step(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> tuple[JointVector, EosState]:
        if state.made_of is not self._version:
            state = self._current(state)
        turned = self._turns and not state.chart._is_near(q)
        if turned:
            q, turned = state.chart._unwrap(q), state.chart._room(q) <= 0.0
        ddq, margin, J = self._drive(t, q, dq, state)
        # The bound that comes with the acceleration saves the chart's exact margin nearly always.
        if turned or (margin <= self.atlas.threshold and not self.atlas._serves(state.chart, J)):
            state = self._update(t, q, dq, state)
            ddq, _, J = self._drive(t, q, dq, state)
        return self._within(q, dq, ddq, J)[0], state

    _asked, _compiled_law = unchecked(asked), unchecked(compiled_law)

    def describe(self) -> dict[str, Any]:
        return super().describe() | {
            "self_motion": type(self.self_motion).__name__,
            **self.atlas.describe(),
            "smooth": self.smooth,
        }

    def chart(self, state: EosState) -> Chart:
        return state.chart

    def joint_distances(self, t: Vector, q: Float[Array, "T n"]) -> Vector | None:
        return self.self_motion.joint_distances(t, q, self.robot)

    def self_motion_target(self, t: float, state: EosState) -> Target | None:
        """Self-motion that is tracked at time t; None if the objective tracks none."""
        return self.self_motion._target_on(t, state.chart)


def _no_law(self: EosController, drive: AccelerationMap) -> None:
    """None in place of the compiled law, in a subclass with a law of its own."""
