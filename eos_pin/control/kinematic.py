"""`KinematicLoop`: positions and velocities of joints that make a task and its self-motion follow their references."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from eos_pin._arrays import (
    Jacobian,
    JointVector,
    Positive,
    PositiveOrInfinite,
    TaskVector,
    VectorLike,
    checked,
    frozen_copy,
    gains,
    number,
    of_type,
    vector,
)
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.control._regularize import AccelerationMap
from eos_pin.control._sampled_law import SelfTargets, decay
from eos_pin.control._velocity_box import VelocityBox, compiled_step, part_within
from eos_pin.control.eos import law_for
from eos_pin.control.limited import JointLimits
from eos_pin.control.objectives import Objective
from eos_pin.control.state import Command, EosState, KinematicState, Solved
from eos_pin.control.tolerance import CommandLimits
from eos_pin.errors import InputError, SingularError, StateError
from eos_pin.tasks.base import Point, Task
from eos_pin.trajectories.base import Target, Trajectory, check_reference

#: Square of the task error that is corrected by one more step of Newton's method: near rounding, as
#: the law adds up errors of some 1 / (kp h²) steps [m², rad²]. And the most steps.
SOLVED, STEPS = 1e-28, 3
#: Largest difference of two times that are the same [s], and of a period from the control period, as a part of it.
SAME_TIME, LATE = 1e-12, 0.01
#: Largest change of the pace in a second [1/s].
PACE_RATE = 20.0
#: What may be assigned while the loop runs, of which steps are compiled.
CHANGING = {"kp", "kd", "reference", "self_motion", "limits"}


class KinematicLoop:
    """Joint positions and velocities that track z_d(t) and v_d(t) within limits; call `step` once a period.

    For robots that take positions or velocities; no inertia is needed. Errors of task and self-motion follow
    ε̈ + kd ε̇ + kp ε = 0 independently of each other, in exact samples: on the reference the task stays on it to the
    accuracy of Newton's method, whatever the period. Position, velocity and acceleration limits are kept always. Where
    they leave no room for the motion that is asked for, the command changes as little as it can, and in a way that the
    task feels only where it must. Near a singularity the direction that is being lost fades out of the law, as in
    `EosController`. Coordinates with a tolerance are in their bands at every command, as far as limits of joints allow.

    The loop goes on from its own last command, so noise of the encoders does not enter it; measured joints start a run
    and are compared with the command. A state that cannot be used, a clock that runs backwards, a jump, and joints that
    do not follow the command raise a `StateError` and change nothing. `reference`, `self_motion`, `kp`, `kd` and
    `limits` may be assigned at any time, and count from the next step on.

    `pace` is the speed of time along task path and self-motion: 1 at the start, 0 to stop on the path as fast as the
    limits allow, 1 to go on from there. The path time stays behind meanwhile, see `path_delay`.

    Args:
        task: The task.
        reference: Trajectory of the task.
        self_motion: Law of the self-motion; by default hold v at its value at the start. References of `Track`,
            `FollowJoints` and `FollowPlan` are met exactly, other laws as accelerations.
        control_period: Period at which `step` is called [s].
        limits: Limits to keep; by default `JointLimits.without_torques(task.robot)`.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s]; 2 √kp is critically damped.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.
        jump: Distance by which a measured joint may move between two steps [rad or m].
        most_lag: Distance by which a measured joint may be away from its command [rad or m].

    Raises:
        InputError: An argument does not fit the task, or a limit of acceleration is infinite.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        self_motion: Objective | None = None,
        *,
        control_period: Positive,
        limits: JointLimits | None = None,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        atlas: Atlas | None = None,
        jump: PositiveOrInfinite = 0.2,
        most_lag: PositiveOrInfinite = 0.5,
    ) -> None:
        self._period, self._jump, self._most_lag = control_period, jump, most_lag
        if atlas is not None and atlas.task is not task:
            raise InputError("the atlas must be made of the loop's own task object: atlas=Atlas(task)")
        self.task, self.robot, self.atlas = task, task.robot, atlas or Atlas(task)
        self._within = CommandLimits(task, control_period)
        self.pace: float = 1.0
        self._ahead: tuple[Any, float, Target] | None = None
        self._version = object()
        self._box: VelocityBox
        self._decay: tuple[Any, Any]
        self.reference: Trajectory
        self.self_motion: Objective
        self.limits: JointLimits
        self.kp: TaskVector
        self.kd: TaskVector
        self.reference, self.self_motion = reference, law_for(task, self_motion)
        self.kp, self.kd = kp, kd  # type: ignore[assignment]
        self.limits = limits or JointLimits.without_torques(task.robot)
        self.reset()

    def __setattr__(self, name: str, value: Any) -> None:
        n, m = (self.task.robot.n, self.task.m) if "task" in vars(self) else (0, 0)
        if name in ("kp", "kd"):
            value = frozen_copy(np.broadcast_to(gains(value, m, f"the task gain {name}"), (m,)))
        elif name == "reference":
            check_reference(self.task, value)
        elif name == "self_motion":
            of_type(value, "the self-motion", Objective).check(n, n - m)
        elif name == "limits":
            object.__setattr__(self, "_box", VelocityBox(of_type(value, "the limits", JointLimits), n, self._period))
        elif name == "pace":
            value = number(value, "the pace", at_least=0.0)
        elif name in ("task", "robot", "atlas") and name in vars(self):
            raise InputError(f"the {name} of a KinematicLoop cannot be changed; make another loop")
        object.__setattr__(self, name, value)
        if name in CHANGING:
            self.renew()
        if name in ("kp", "kd") and {"kp", "kd"} <= set(vars(self)):
            object.__setattr__(self, "_decay", decay(self.kp, self.kd, self._period))

    def renew(self) -> None:
        """Drop the compiled step and its copies of gains, targets and limits; an objective calls it when it changes."""
        object.__setattr__(self, "_version", object())

    def __getstate__(self) -> dict[str, Any]:
        # What is compiled is made anew where it is unpickled.
        state = self._state and self._state._replace(on=replace(self._state.on, law=None, made_of=None))
        return {**vars(self), "_state": state}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.renew()

    # -- reports -----------------------------------------------------------------------------------------------------

    @property
    def control_period(self) -> float:
        """Period at which `step` is called [s]."""
        return self._period

    @property
    def chart(self) -> Chart | None:
        """Chart that the loop is on; None before the first step."""
        return None if self._state is None else self._state.on.chart

    @property
    def limited(self) -> bool:
        """Whether limits changed the last command."""
        return self._state is not None and self._state.limited

    @property
    def path_delay(self) -> float:
        """Time by which the path is behind the clock, because of a pace of less than 1 [s]."""
        return 0.0 if self._state is None else self._state.behind + (1.0 - self._state.pace) * self._period

    @property
    def lag(self) -> float:
        """Largest distance of a measured joint from its command in the last step [rad or m]."""
        return 0.0 if self._state is None else self._state.lag

    @property
    def task_deficit(self) -> TaskVector | None:
        """Task acceleration that the law commanded and the last command does not cause, (m,) [m/s², rad/s²].

        Zero to rounding where the task is done as it should be; None before the first step.
        """
        return None if self._state is None else self._state.deficit.copy()

    @property
    def tolerance_used(self) -> dict[str, float]:
        """Part of each band that the last command uses, by name; more than 1 where it is beyond.

        Where limits of joints, or a target that jumped, leave no command that keeps a band, it is passed.
        """
        if (state := self._state) is None:
            return {}
        return self._within.used(state.z, self._target(state.t + self._period - self.path_delay).z)

    @property
    def limit_change(self) -> JointVector:
        """Change that limits made in the last joint acceleration, (n,) [rad/s² or m/s²]; zero where they made none."""
        return self._limit_change.copy() if self.limited else np.zeros(self.robot.n)

    def reset(self) -> None:
        """Forget the chart and the last command; the next step starts a run at rest."""
        self._state: KinematicState | None = None
        self._limit_change = np.zeros(self.robot.n)

    # -- the loop ----------------------------------------------------------------------------------------------------

    def step(self, t: float, q: VectorLike) -> Command:
        """Command for the period that begins at time t, for joints that are measured at q.

        A second call at the same time returns the same command.

        Args:
            t: Time [s], best the planned one, a multiple of the period, because velocities are differences in time.
            q: Measured joints, (n,) [rad or m]; angles of continuous joints may be wrapped.

        Raises:
            StateError: The state or the time cannot be used; nothing is changed, the next step may go on.
            SingularError: The task is singular in the first state of a run.
            PlanError: The joints are too far from those to follow in the first state of a run.
        """
        state = self._state
        if state is not None and (following := self._ordinary(t, q, state)) is not None:
            self._state = following
            return Command(following.q.copy(), following.dq.copy())
        try:
            seen, t = np.array(vector(q, self.robot.n, "q")), number(t, "t")
        except InputError as error:
            raise StateError(f"no command for this state: {error}") from None
        if state is None:
            state = self._begun(t, seen)
        else:
            if t < state.t:
                raise StateError(
                    f"no command at this time: t = {t!r} comes after {state.t!r} s. Use a monotonic clock, or reset() "
                    "the loop to start a new run"
                )
            if t == state.t:
                return Command(state.q.copy(), state.dq.copy())
            seen = self.robot._unwrap(seen, state.q)
            try:
                state = state.seen(seen, self.robot, self._period, self._jump, self._most_lag)
            except StateError:
                # If it was a jump, the next state is accepted if it is near this one.
                self._state = state._replace(measured=seen)
                raise
        state = self._next(t, state)
        if state.on.made_of is not self._version and not state.limited:
            state = state._replace(on=replace(state.on, law=self._step_on(state.on), made_of=self._version))
        self._state = state
        return Command(self._state.q.copy(), self._state.dq.copy())

    def _begun(self, t: float, q: JointVector) -> KinematicState:
        """State at rest at q, on a chart based there."""
        self.task._set_time(t)
        chart = self.atlas.start(q)
        self.self_motion.check_start(t, q, chart)
        z, rest = self.task._value(q), np.zeros(q.size)
        on = EosState(drive=AccelerationMap(chart), since=t)
        return KinematicState(t, q, rest, q, z, on, np.zeros(self.task.m), False, 0.0, z, z, None)

    def _ordinary(self, t: float, q: VectorLike, state: KinematicState) -> KinematicState | None:
        """State after the step at time t in the ordinary case; None if `_next` has to compute it."""
        on, h, pace = state.on, self._period, state.pace
        if on.law is None or on.made_of is not self._version or pace != self.pace or not isinstance(t, float):
            return None
        if not abs(t - state.t - h) <= LATE * h:
            return None
        s = t - state.behind - (1.0 - pace) * (t - state.t)
        z_d, z_d_ahead, asked, v_d, of = self._target(s).z, self._target(s + h * pace).z, None, None, None
        if on.law.held is None:
            law = self.self_motion._sampled_targets(s, h, h * pace, self.robot.n - self.task.m)
            v_d, of, before = law.now, law.of, state.v_d if state.objective is law.of else None
            asked = law.acceleration(t, self.robot, on.chart, state.q, state.dq, before)
        more = None if on.carried is None else on.left(t, state.dq)
        found: KinematicState | None = on.law(t, state, q, z_d, z_d_ahead, asked, more, v_d, of)
        return found

    def _step_on(self, on: EosState) -> Any:
        """The compiled step on a chart; None where there is none."""
        self.self_motion._add_user(self)
        settings = self._period, self._jump, self._most_lag, SOLVED, STEPS
        return compiled_step(on, self.reference, self.self_motion, self.atlas, self._decay, self._box, settings)

    def _next(self, t: float, state: KinematicState) -> KinematicState:
        """State after the step at time t."""
        task, h, q, u, r = self.task, self._period, state.q, state.dq, self.robot.n - self.task.m
        known = state.reference is self.reference and abs(t - state.t - h) <= LATE * h
        # Path time stays behind while the pace is less than 1.
        behind, pace = state.behind + (1.0 - state.pace) * (t - state.t), state.pace
        s = t - behind
        now, law = self._target(s), self.self_motion._sampled_targets(s, h, h * pace, r)
        # Where the last target is another's or of another time, the velocity takes its place.
        z_d_before = state.z_d if known else task._plus(now.z, -h * pace * now.dz)
        if not known or state.objective is not law.of or state.v_d is None:
            state = state._replace(v_d=law.before)
        a1, a2 = self._decay
        # Errors of directions are in the axes of the target, where they are added to the next one.
        error = a1 * task._minus(state.z, now.z) - a2 * task._minus(state.z_before, z_d_before)
        p = q + h * u

        def solved(pace: float) -> Solved:
            # A task that moves goes by the time of the path.
            task._set_time(s + h * pace)
            z_p, J = task._linearize(p)
            goal = task._plus(self._target(s + h * pace).z, error)
            v_d = self.self_motion._sampled_targets(s, h, h * pace, r).placed(q, u, state.v_d)
            return Solved(*self._acceleration(t, state, v_d, J, task._minus(goal, z_p) / h**2), J, goal, v_d)

        least, most = self._box(q, u)
        least, most = (least - u) / h, (most - u) / h
        found = solved(pace)
        if pace != self.pace:
            gain = min(max(self.pace - pace, -h * PACE_RATE), h * PACE_RATE)
            other = solved(pace + gain)
            part = part_within(found.a, other.a, least, most)
            pace = self.pace if part == 1.0 and abs(self.pace - pace) <= h * PACE_RATE else pace + part * gain
            found = solved(pace)
        a, on, limitless, J, goal, v_d = found
        target = self._target(s + h * pace).z
        parts = self._within.parts(state.z, now.z, p, target, least, most)
        limited = bool(((a < least) | (a > most)).any())
        if not limited:
            q_next, z = self._solved(on, p, a, J, goal, v_d, exact=limitless)
        if limited or not self._within.kept(z, target, parts):
            lacking = partial(self._lacking, on, goal) if limitless else None
            q_next, z, limited = self._within.within(p, a, J, least, most, target, parts, lacking)
        u_next = (q_next - q) / h
        within = np.minimum(np.maximum(u_next, u + h * least), u + h * most)
        if not math.isfinite(within.dot(within)):
            raise StateError(
                f"no finite command at t = {t!r} s: the reference or the self-motion asks for {a.tolist()}"
            )
        if (within != u_next).any():
            z = task._value(q_next := q + h * within)
        deficit = task._minus(goal, z) / h**2
        self._limit_change = (q_next - p) / h**2 - found.a if limited else 0.0 * u
        return KinematicState(
            t, q_next, within, state.measured, z, on, deficit, limited, state.lag, state.z, now.z, self.reference,
            v_d.now, v_d.of, pace, behind,
        )  # fmt: skip

    def _target(self, t: float) -> Target:
        """The reference at time t; that of the last call is kept."""
        if self._ahead is None or self._ahead[0] is not self.reference or abs(self._ahead[1] - t) > SAME_TIME:
            self._ahead = self.reference, t, self.reference(t)
        return self._ahead[2]

    def _acceleration(
        self, t: float, state: KinematicState, v_d: SelfTargets, J: Jacobian, asked: TaskVector
    ) -> tuple[JointVector, EosState, bool]:
        """Joint acceleration of the law, the chart it is on from here, and whether no direction fades."""
        q, u, on = state.q, state.dq, state.on
        F_v = v_d.acceleration(t, self.robot, on.chart, q, u, state.v_d, J, asked)
        if (more := on.left(t, u)) is not None:
            F_v = F_v + more
        a, margin = on.drive(J, np.concatenate((asked, F_v)), u)
        turned = self.robot.turns and on.chart._room(q) <= 0.0
        if not turned and (margin > self.atlas.threshold or self.atlas._serves(on.chart, J)):
            return a, on, margin > 0.0
        try:
            chart = self.atlas.next(on.chart, q)
        except SingularError:
            return a, on, margin > 0.0
        # The acceleration is continuous: what the law asks for otherwise on the new chart is forgotten by and by.
        F_v = v_d.acceleration(t, self.robot, chart, q, u, state.v_d, J, asked)
        carried = chart._dv(a) - F_v
        on = EosState(drive=AccelerationMap(chart), number=on.number + 1, since=t, carried=carried)
        a, margin = on.drive(J, np.concatenate((asked, F_v + carried)), u)
        return a, on, margin > 0.0

    def _solved(
        self, on: EosState, p: JointVector, a: JointVector, J: Jacobian, goal: Point, v_d: SelfTargets, *, exact: bool
    ) -> tuple[JointVector, Point]:
        """Joints at the end of the period and their task point, by Newton's method where the goal is to be met."""
        q = p + self._period**2 * a
        z = self.task._value(q)
        for _ in range(STEPS if exact else 0):
            if (more := self._lacking(on, goal, J, z, v_d, q)) is None:
                break
            q = q + more
            z = self.task._value(q)
        return q, z

    def _lacking(
        self, on: EosState, goal: Point, J: Jacobian, z: Point, v_d: SelfTargets | None = None, q: Any = None
    ) -> JointVector | None:
        """Joint motion to a goal from a task point, and that of a further task at q; None if they are there."""
        left = self.task._minus(goal, z)
        aside = np.zeros(on.chart.r) if v_d is None else v_d.lacking(on.chart, J, q, left)
        if left.dot(left) + aside.dot(aside) <= SOLVED:
            return None
        return on.drive(J, np.concatenate((left, aside)), np.zeros(self.robot.n))[0]
