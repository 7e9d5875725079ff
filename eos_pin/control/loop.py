"""`ControlLoop`: a controller in a control loop of your own, with checks of states and torques."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg.blas import ddot

from eos_pin._arrays import (
    Array,
    JointVector,
    PositiveOrInfinite,
    TaskVector,
    VectorLike,
    as_floats,
    broadcast,
    checked,
    frozen_copy,
    number,
    vector,
)
from eos_pin._kernels.dispatch import use_compiled
from eos_pin.control._sampled_law import MiddleOfPeriod
from eos_pin.control.base import Controller, agreed_period
from eos_pin.errors import InputError, Renamed, StateError, refuse_unused

#: A move of a continuous joint from one state to the next beyond which it is looked at whether its angle was wrapped
#: [rad].
WRAPPED = 0.5 * math.pi


class ControlLoop:
    """A controller with its memory; call `step` once a period.

    What it does about trouble: a state of the wrong shape or not finite, a clock that runs backwards, and a jump of the
    joints raise a `StateError`, change nothing, and the next step may go on; after a jump the next state is believed
    if it is near the one that was refused. Torques beyond the limits are cut, and `saturated` is then True. At a target
    that cannot be reached and at a singularity of the task the torque stays bounded, and `task_deficit` is the
    missing part.

    Angles of continuous joints may come wrapped, such as to (−π, π], or not: the loop counts the turns.

    Attributes of the controller, of its objective and of its gains count from the next step on when they are assigned,
    and so does another controller: see `controller`.

    Args:
        controller: The controller.
        control_period: Period at which `step` is called [s], compared with the one that the controller is made for.
        torque_limits: Cut torques at these limits, (n,) [N m or N], infinite where there is none; True for those of the
            controller's robot.
        jump: Distance by which joints may move between two steps beyond what their velocities say [rad or m].
        torque_rate: Most that a torque changes in a second, one number or (n,) [N m/s or N/s]. The torque then begins
            at `first_torque`, and follows the controller's as fast as this allows.
        soft_start: Time in which a run goes over from `first_torque` to the controller's torque, and to that of another
            controller from the last torque [s]. Meanwhile gravity is compensated, and limits that the controller keeps,
            other than of torque, are not kept.
        centred: Whether torques are those for the middle of the period in which they are held, so that they do not lag
            by half of it; for controllers that are not made for a period themselves.
        first_torque: Torque at the start of a run where one of the last two is given, (n,) [N m or N], such as the
            measured one; by default that which holds the robot against gravity, by the controller's model.

    Attributes:
        memory: Memory of the controller: the chart it is on.
        saturated: Whether the last torque was cut.
        slowed: Whether the last torque was held back by `torque_rate`.

    Raises:
        InputError: A limit or a time is out of its range, or of another size than the robot, or the controller is made
            for another control period.
    """

    memory = Renamed("state")
    given_up = Renamed("task_deficit")

    @checked
    def __init__(
        self,
        controller: Controller,
        *,
        control_period: float | None = None,
        torque_limits: bool | VectorLike = True,
        jump: PositiveOrInfinite = 0.2,
        torque_rate: float | VectorLike | None = None,
        soft_start: float = 0.0,
        first_torque: VectorLike | None = None,
        centred: bool = False,
    ) -> None:
        self._middle: MiddleOfPeriod | None = None
        self._watch: StateMonitor | None
        self._before: StateMonitor | None
        self.saturated = self.slowed = False
        self._jump = math.inf if jump == math.inf else number(jump, "the largest jump", above=0.0)
        self._given = torque_limits, torque_rate, first_torque
        self._period, self._centred = control_period, centred
        soft_start = number(soft_start, "the time of a soft start", at_least=0.0)
        self._ramp = None if torque_rate is None and not soft_start else Ramp(soft_start)
        if self._ramp is None:
            refuse_unused(ControlLoop, "there is no ramp; add soft_start or torque_rate", first_torque=first_torque)
        self._fit(controller)
        self.reset()

    @property
    def controller(self) -> Controller:
        """The controller; another one may be assigned at any time, and is used from the next step on.

        One for the same task on the same robot goes on where the other one was: on its chart, with what v means there.
        One for another task starts anew where the robot is, and v is 0 there; the torque steps to that of the new law,
        unless `torque_rate` or `soft_start` was given. A robot with another number of joints starts a new run.

        Raises:
            InputError: It does not fit the robot, or limits that were given; the controller before stays.
            SingularError: Its task is singular where the robot is; the controller before stays.
        """
        return self._controller

    @controller.setter
    def controller(self, controller: Controller) -> None:
        robot = controller.robot
        watch = self._watch or self._before
        if watch is not None and (self._robot is None or robot is None or self._robot.n == robot.n):
            t, q = watch.last
            # Refused now, not in the middle of the run.
            controller._take_over(t, q, np.zeros(q.size), self.state)
            self._fit(controller)
            self._watch, self._before = None, watch
            if self._ramp is not None:
                self._ramp.begin_again()
        else:
            self._fit(controller)
            self.reset()

    def _fit(self, controller: Controller) -> None:
        """Take a controller and its limits; refuse one that does not fit."""
        period, robot = agreed_period(controller, self._period), controller.robot
        if self._centred and (period is None or robot is None or controller.control_period is not None):
            raise InputError(
                "centred torques need a control_period of the loop, and a controller that has a robot and is not "
                "made for a period itself"
            )
        limits, rate, first = self._given
        bounds: JointVector = np.array(np.inf)
        if limits is True:
            bounds = bounds if robot is None else robot.effort
        elif limits is not False:
            size = np.size(limits) if robot is None else robot.n
            # Infinite where there is none.
            given = np.minimum(as_floats(limits, "the torque limits"), np.finfo(float).max)
            bounds = broadcast(given, size, "the torque limits")
            if not (bounds > 0.0).all():
                raise InputError(f"the torque limits must be above 0, got {bounds.tolist()}")
        if rate is not None:
            rate = broadcast(rate, np.size(rate) if robot is None else robot.n, "the torque rate")
            if not (rate > 0.0).all():
                raise InputError(f"the torque rate must be above 0 N m/s, got {rate.tolist()}")
        if first is not None:
            first = frozen_copy(vector(first, None if robot is None else robot.n, "the first torque"))
        self._controller, self._robot, self._limits = controller, robot, bounds
        self._shape = None if robot is None else (robot.n,)
        if self._ramp is not None:
            self._ramp.rate, self._ramp.first, self._ramp.limits = rate, first, bounds
            self._ramp.gravity = controller.holding_torque
        self._middle = MiddleOfPeriod(robot, period) if self._centred and robot and period else None
        # Without any limit a torque passes as long as its square is a number.
        per_limit = np.maximum(1.0 / bounds, 1e-150)
        self._per_limit = np.array(np.broadcast_to(per_limit, self._shape or per_limit.shape), ndmin=1)

    def reset(self) -> None:
        """Forget the chart, the last state and the last torque; the next step starts a run."""
        self.state: Any = None
        self._watch = None
        #: The watch until now, where another controller takes over at the next step.
        self._before = None
        #: Whole turns by which the encoders are behind; None where there are none.
        self._behind: JointVector | None = None
        if self._ramp is not None:
            self._ramp.forget()
        if self._middle is not None:
            self._middle.forget()

    def step(self, t: float, q: VectorLike, dq: VectorLike) -> JointVector:
        """Joint torques at time t [s] in the state (q, dq) [N m or N].

        Raises:
            StateError: The state or the time cannot be used; nothing is changed, the next step may go on.
            SingularError: The task is singular in the first state of a run.
        """
        seen: Any = q if self._behind is None else _sum(q, self._behind)
        if self._watch is None or not self._watch.accepts(t, seen, dq):
            q, dq = self._checked(q, "q"), self._checked(dq, "dq")
            given: Any = t
            t = given if isinstance(given, float) else number(given, "t")
            seen = self._look(t, q, dq)
        middle, given = self._middle, (t, seen, dq, self.state)
        tau, self.state = self._controller._step(*given) if middle is None else middle.step(self._controller, *given)
        self.saturated = False
        if self._ramp is not None:
            tau, self.slowed = self._ramp(t, seen, self._cut(t, tau))
        elif not within_limits_fast(tau, self._per_limit):
            tau = self._cut(t, tau)
        if middle is not None:
            middle.held(tau)
        return tau

    def task_deficit(self, t: float, q: VectorLike, dq: VectorLike) -> TaskVector | None:
        """Task acceleration that the law commands in a state and a step there does not cause, (m,).

        Zero to rounding where the task is done as it should be; it takes as long as a step, so ask when it matters.
        None before the first step, and for a controller that does not know it.

        Raises:
            StateError: The state cannot be used.
        """
        if self._watch is None:
            return None
        q, dq = self._checked(q, "q"), self._checked(dq, "dq")
        if self._robot is not None:
            q = self._robot._unwrap(q, self._watch.last[1])
        return self._controller._task_deficit(t, q, dq, self.state)

    def _cut(self, t: float, tau: JointVector) -> JointVector:
        """Torques within the limits."""
        parts = (tau * self._per_limit).tolist()
        if not math.isfinite(sum(parts)):
            raise StateError(f"{type(self.controller).__name__} has no finite torque at t = {t!r} s: {tau.tolist()}")
        self.saturated = max(parts) > 1.0 or min(parts) < -1.0
        # Two calls that take a third of the time of np.clip.
        return np.minimum(np.maximum(tau, -self._limits), self._limits) if self.saturated else tau

    def _look(self, t: float, q: JointVector, dq: JointVector) -> JointVector:
        """Start a run, or decide whether an unusual state can be used; a refused one changes nothing.

        Returns:
            The joints, not wrapped.
        """
        watch = self._watch or self._before
        if watch is None:
            if not math.isfinite(t):
                raise StateError(f"no torque at this time: it must be finite, got {t!r}")
            self.state = self._controller._start(t, q, dq)
            near = min(self._jump, WRAPPED) if self._robot is not None and self._robot.turns else self._jump
            self._watch = StateMonitor(t, q, near**2)
            return q
        t_last, q_last = watch.last
        if not t_last <= t < math.inf:
            raise StateError(
                f"no torque at this time: t = {t!r} comes after {t_last!r} s. Use a monotonic clock, or reset() "
                "the loop to start a new run"
            )
        gap = t - t_last
        if self._robot is not None and self._robot.turns:
            with np.errstate(over="ignore"):
                ahead = q_last + gap * dq
            wrapped, q = q, self._robot._unwrap(q, ahead if np.isfinite(ahead).all() else q_last)
            behind = q - wrapped
            self._behind = behind if behind.any() else None
        # If it is a jump, the next state is accepted if it is near this one.
        watch.last = t, q
        moved = q - q_last
        allowed = self._jump + 2.0 * np.abs(dq) * gap
        joint = int(np.argmax(np.abs(moved) - allowed))
        if abs(moved[joint]) > allowed[joint]:
            raise StateError(
                f"no torque for this state: q[{joint}] jumped by {moved[joint]:.3g} in {gap:.3g} s, more than "
                f"{allowed[joint]:.3g}. If the next state agrees with this one, the loop goes on"
            )
        if self._watch is None:
            self.state = self._controller._take_over(t, q, dq, self.state)
            self._watch, self._before = watch, None
        return q

    def _checked(self, values: VectorLike, name: str) -> JointVector:
        try:
            # Side by side in memory, as what is compiled wants them.
            return np.ascontiguousarray(vector(values, self._shape[0] if self._shape else None, name))
        except InputError as error:
            raise StateError(f"no torque for this state: {error}") from None


class Ramp:
    """Torques that begin softly and change at a limited rate.

    Args:
        soft_start: Time in which the torque goes over to the one asked for [s].

    Attributes:
        rate: Most that each torque changes in a second [N m/s or N/s]; None for any.
        first: Torque at the start of a run, (n,); None for that which holds the robot against gravity.
        limits: Largest torques.
        gravity: Torque that holds the robot at rest, as a function of its joints.
    """

    def __init__(self, soft_start: float) -> None:
        self.soft_start = soft_start
        self.rate: JointVector | None = None
        self.first: JointVector | None = None
        self.limits: JointVector = np.array(np.inf)
        self.gravity: Callable[[JointVector], JointVector] = np.zeros_like
        self.forget()

    def forget(self) -> None:
        """Begin a run at the next torque."""
        self._last: tuple[float, JointVector] | None = None
        #: When the soft start began, and what the torque then was beyond gravity.
        self._since, self._beyond = math.nan, np.zeros(0)

    def begin_again(self) -> None:
        """Begin softly once more at the next torque, from the last one."""
        self._since = math.nan

    def __call__(self, t: float, q: JointVector, tau: JointVector) -> tuple[JointVector, bool]:
        """The torque to apply instead of the commanded one, and whether the limit of its rate changed it.

        Args:
            t: Time [s].
            q: Joints.
            tau: Torque that is asked for, within the limits.
        """
        soft = math.isnan(self._since) or t - self._since < self.soft_start
        gravity = self.gravity(q) if soft else np.zeros(tau.size)
        if self._last is None:
            first = gravity if self.first is None else self.first
            self._last = t, np.minimum(np.maximum(first, -self.limits), self.limits)
        t_last, last = self._last
        if math.isnan(self._since):
            self._since, self._beyond = t, last - gravity
        if t - self._since < self.soft_start:
            part = (t - self._since) / self.soft_start
            # Smooth at both ends.
            part *= part * (3.0 - 2.0 * part)
            held = gravity + self._beyond
            tau = np.minimum(np.maximum(held + part * (tau - held), -self.limits), self.limits)
        slowed = False
        if self.rate is not None:
            room = self.rate * (t - t_last)
            asked, tau = tau, np.minimum(np.maximum(tau, last - room), last + room)
            slowed = not np.array_equal(asked, tau)
        self._last = t, tau.copy()
        return tau, slowed


def _sum(q: Any, more: JointVector) -> JointVector | None:
    """Sum of two arrays; None if they do not fit each other."""
    return q + more if isinstance(q, np.ndarray) and q.shape == more.shape and q.dtype == more.dtype else None


@use_compiled
class StateMonitor:
    """Last state of a loop, and the decision whether the next one follows it as is usual.

    Args:
        t: Time of the last state [s].
        q: Its joints.
        jump_squared: Square of how far joints may have moved, together, where no closer look is needed.

    Attributes:
        last: Time and joints of the last state.
    """

    def __init__(self, t: float, q: JointVector, jump_squared: float) -> None:
        self.last, self._jump = (t, q), math.sqrt(jump_squared)

    @property
    def last(self) -> tuple[float, JointVector]:
        return self._t, self._q

    @last.setter
    def last(self, state: tuple[float, JointVector]) -> None:
        self._t, self._q = state[0], state[1].copy()
        self._joints = self._q.tolist()

    def accepts(self, t: Any, q: Any, dq: Any) -> bool:
        """Whether a state is as usual; if it is, it is the last one now."""
        try:
            joints = q.tolist()
            # The length of the move bounds each joint's; NaN never passes.
            if (
                not math.dist(joints, self._joints) < self._jump
                or not self._t <= t < math.inf
                or not math.isfinite(sum(dq.tolist()))
                or not q.shape == dq.shape == self._q.shape
            ):
                return False
        except (AttributeError, TypeError, ValueError, OverflowError):
            return False
        self._t, self._q, self._joints = t, q.copy(), joints
        return True


@use_compiled
def within_limits_fast(tau: Any, per_limit: Array) -> bool:
    """Whether torques are finite and within limits, by a bound: squared parts that sum to less than one are each less.

    Args:
        tau: Torques.
        per_limit: One divided by each limit.
    """
    return bool(ddot(part := tau * per_limit, part) <= 1.0)
