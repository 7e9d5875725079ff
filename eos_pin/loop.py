"""`ControlLoop`: a controller in a control loop of your own, with a watch on what goes in and what comes out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eos_pin.arrays import Array, JointVector, TaskVector, VectorLike, number, numbers, spread, vector
from eos_pin.compiled import twin
from eos_pin.controllers import Controller, TaskController
from eos_pin.errors import InputError, StateError


class ControlLoop:
    """A controller with its memory; call `step` once a period.

    What it does about trouble: a state of the wrong shape or not finite, a clock that runs backwards, and a jump of the
    joints raise a `StateError`, change nothing, and the next step may go on; after a jump the next state is believed
    if it is near the one that was refused. Torques beyond the limits are cut, and `saturated` says so. At a target
    that cannot be reached and at a singularity of the task the torque stays bounded, and `given_up` says what it lacks.

    Args:
        controller: The controller.
        torque_limits: Cut torques at these limits, (n,) [N m or N], infinite where there is none; True for those of the
            controller's robot.
        jump: Distance by which joints may move between two steps beyond what their velocities say [rad or m].

    Attributes:
        memory: What the controller remembers: the chart it is on.
        saturated: Whether the last torque was cut.
    """

    def __init__(self, controller: Controller, *, torque_limits: bool | VectorLike = True, jump: float = 0.2) -> None:
        robot = getattr(controller, "robot", None)
        self.controller = controller
        self.memory: Any = None
        self.saturated = False
        self._shape = None if robot is None else (robot.n,)
        self._jump = math.inf if jump == math.inf else number(jump, "the largest jump", above=0.0)
        self._limits: JointVector = np.array(np.inf)
        if torque_limits is True:
            self._limits = self._limits if robot is None else robot.effort
        elif torque_limits is not False:
            size = np.size(torque_limits) if robot is None else robot.n
            # Infinite where there is none.
            given = np.minimum(numbers(torque_limits, "the torque limits"), np.finfo(float).max)
            self._limits = spread(given, size, "the torque limits")
            if not (self._limits > 0.0).all():
                raise InputError(f"the torque limits must be above 0, got {self._limits.tolist()}")
        # Without any limit a torque passes as long as its square is a number.
        per_limit = np.maximum(1.0 / self._limits, 1e-150)
        self._per_limit = np.array(np.broadcast_to(per_limit, self._shape or per_limit.shape), ndmin=1)
        self.reset()

    def reset(self) -> None:
        """Forget the chart and the last state; the next step starts a run."""
        self.memory = None
        self._watch: Watch | None = None

    def step(self, t: float, q: VectorLike, dq: VectorLike) -> JointVector:
        """Joint torques at time t [s] in the state (q, dq) [N m or N].

        Raises:
            StateError: The state or the time cannot be used; nothing is changed, the next step may go on.
            SingularError: The task is singular in the first state of a run.
        """
        if self._watch is None or not self._watch.follows(t, q, dq):
            q, dq = self._checked(q, "q"), self._checked(dq, "dq")
            self._look(t, q, dq)
        tau, self.memory = self.controller.step(t, q, dq, self.memory)  # type: ignore[arg-type]
        self.saturated = False
        return tau if surely_within(tau, self._per_limit) else self._cut(t, tau)

    def given_up(self, t: float, q: VectorLike, dq: VectorLike) -> TaskVector | None:
        """Task acceleration that is asked for in a state and that a step there does not bring, (m,).

        Zero to rounding where the task is done as it should be; it takes as long as a step, so ask when it matters.
        None before the first step, and for a controller that has no task.

        Raises:
            StateError: The state cannot be used.
        """
        if self.memory is None or not isinstance(self.controller, TaskController):
            return None
        return self.controller.given_up(t, self._checked(q, "q"), self._checked(dq, "dq"), self.memory)

    def _cut(self, t: float, tau: JointVector) -> JointVector:
        """Torques within the limits."""
        parts = (tau * self._per_limit).tolist()
        if not math.isfinite(sum(parts)):
            raise StateError(f"{type(self.controller).__name__} has no finite torque at t = {t!r} s: {tau.tolist()}")
        self.saturated = max(parts) > 1.0 or min(parts) < -1.0
        # Two calls that take a third of the time of np.clip.
        return np.minimum(np.maximum(tau, -self._limits), self._limits) if self.saturated else tau

    def _look(self, t: float, q: JointVector, dq: JointVector) -> None:
        """Start a run, or see whether a state that is not as usual can be used; one that is refused leaves no trace."""
        if self._watch is None:
            if not math.isfinite(t):
                raise StateError(f"no torque at this time: it must be finite, got {t!r}")
            self.memory = self.controller.start(t, q, dq)
            self._watch = Watch(t, q, self._jump**2)
            return
        t_last, q_last = self._watch.last
        if not t_last <= t < math.inf:
            raise StateError(
                f"no torque at this time: t = {t!r} comes after {t_last!r} s. Use a monotonic clock, or reset() "
                "the loop to start a new run"
            )
        # If it is a jump, the next state is believed if it is near this one.
        self._watch.last = t, q
        moved, gap = q - q_last, t - t_last
        allowed = self._jump + 2.0 * np.abs(dq) * gap
        joint = int(np.argmax(np.abs(moved) - allowed))
        if abs(moved[joint]) > allowed[joint]:
            raise StateError(
                f"no torque for this state: q[{joint}] jumped by {moved[joint]:.3g} in {gap:.3g} s, more than "
                f"{allowed[joint]:.3g}. If the next state agrees with this one, the loop goes on"
            )

    def _checked(self, values: VectorLike, name: str) -> JointVector:
        try:
            # Side by side in memory, as what is compiled wants them.
            return np.ascontiguousarray(vector(values, self._shape[0] if self._shape else None, name))
        except InputError as error:
            raise StateError(f"no torque for this state: {error}") from None


@twin
class Watch:
    """Keeps the last state of a loop, and sees whether the next one follows it as is usual.

    Args:
        t: Time of the last state [s].
        q: Its joints.
        jump_squared: Square of how far joints may have moved, together, where no closer look is needed.

    Attributes:
        last: Time and joints of the last state.
    """

    def __init__(self, t: float, q: JointVector, jump_squared: float) -> None:
        self.last, self._jump_squared = (t, q), jump_squared

    @property
    def last(self) -> tuple[float, JointVector]:
        return self._last

    @last.setter
    def last(self, state: tuple[float, JointVector]) -> None:
        self._last = state[0], state[1].copy()

    def follows(self, t: Any, q: Any, dq: Any) -> bool:
        """Whether a state is as usual; if it is, it is the last one now."""
        t_last, q_last = self._last
        try:
            moved = q - q_last
            # The length of the move bounds each joint's, so the usual case is one product; NaN never passes.
            near = moved.dot(moved) < self._jump_squared and t_last <= t < math.inf
            usual = bool(near and math.isfinite(dq.dot(dq)) and q.shape == dq.shape == q_last.shape)
        except (AttributeError, TypeError, ValueError):
            return False
        if usual:
            self.last = t, q
        return usual


@twin
def surely_within(tau: Any, per_limit: Array) -> bool:
    """Whether torques are finite and within limits, by a bound: squared parts that sum to less than one are each less.

    Args:
        tau: Torques.
        per_limit: One divided by each limit.
    """
    part = tau * per_limit
    return bool(part.dot(part) <= 1.0)
