"""`ControlLoop`: a controller in a control loop of your own, with a watch on what goes in and what comes out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eos_pin.arrays import JointVector, VectorLike, number, readonly, spread, vector
from eos_pin.controllers import Controller
from eos_pin.errors import InputError, StateError


class ControlLoop:
    """A controller with its memory; call `step` once a period.

    What it does about trouble: a state of the wrong shape or not finite, a clock that runs backwards, and a jump of the
    joints raise a `StateError`, change nothing, and the next step may go on; after a jump the next state is believed
    if it is near the one that was refused. Torques beyond the limits are cut, and `saturated` says so. A target that
    cannot be reached, or a singularity of the task, is the controller's own business, and its torque stays bounded.

    Args:
        controller: The controller.
        torque_limits: Cut torques at these limits, (n,) [N m or N]; True for those of the controller's robot.
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
        self._jump_squared = self._jump**2
        self._limits: JointVector | None = None
        if torque_limits is True:
            self._limits = None if robot is None or np.isinf(robot.effort).all() else robot.effort
        elif torque_limits is not False:
            size = np.size(torque_limits) if robot is None else robot.n
            self._limits = readonly(spread(torque_limits, size, "the torque limits"))
            if not (self._limits > 0.0).all():
                raise InputError(f"the torque limits must be above 0, got {self._limits.tolist()}")
        self._per_limit = None if self._limits is None else 1.0 / self._limits
        self.reset()

    def reset(self) -> None:
        """Forget the chart and the last state; the next step starts a run."""
        self.memory = None
        self._last: tuple[float, JointVector] | None = None

    def step(self, t: float, q: VectorLike, dq: VectorLike) -> JointVector:
        """Joint torques at time t [s] in the state (q, dq) [N m or N].

        Raises:
            StateError: The state or the time cannot be used; nothing is changed, the next step may go on.
            SingularError: The task is singular in the first state of a run.
        """
        state = q, dq = self._state(q, dq)
        last, self._last = self._last, (t, q.copy())
        if last is not None:
            moved = q - last[1]
            # The length of the move bounds each joint's, so the usual case is one product.
            if moved.dot(moved) > self._jump_squared:
                self._refuse_jump(t - last[0], moved, dq)
            if not t >= last[0]:
                self._last = last
                raise StateError(
                    f"no torque at this time: t = {t!r} comes after {last[0]!r} s. Use a monotonic clock, or reset() "
                    "the loop to start a new run"
                )
        memory = self.memory
        if memory is None:
            memory = self._start(t, *state)
        tau, self.memory = self.controller.step(t, q, dq, memory)
        if self._per_limit is not None:
            # Parts of the limits whose squares sum to less than one are each less than one.
            part = tau * self._per_limit
            self.saturated = not part.dot(part) <= 1.0 and bool((np.abs(part) > 1.0).any())
            if self.saturated:
                tau = np.minimum(np.maximum(tau, -self._limits), self._limits)  # type: ignore[operator,arg-type]
        return tau

    def _start(self, t: float, q: JointVector, dq: JointVector) -> Any:
        """Memory at the start of a run; a start that is refused leaves no trace."""
        self._last = None
        if not math.isfinite(t):
            raise StateError(f"no torque at this time: it must be finite, got {t!r}")
        memory = self.controller.start(t, q, dq)
        self._last = t, q.copy()
        return memory

    def _refuse_jump(self, gap: float, moved: JointVector, dq: JointVector) -> None:
        """Refuse joints that moved farther than their speed explains."""
        allowed = self._jump + 2.0 * np.abs(dq) * max(gap, 0.0)
        joint = int(np.argmax(np.abs(moved) - allowed))
        if abs(moved[joint]) > allowed[joint]:
            raise StateError(
                f"no torque for this state: q[{joint}] jumped by {moved[joint]:.3g} in {gap:.3g} s, more than "
                f"{allowed[joint]:.3g}. If the next state agrees with this one, the loop goes on"
            )

    def _state(self, q: Any, dq: Any) -> tuple[JointVector, JointVector]:
        try:
            # A product is finite only where every entry is.
            if (
                q.shape == dq.shape == (self._shape or q.shape)
                and math.isfinite(q.dot(q))
                and math.isfinite(dq.dot(dq))
            ):
                return q, dq
        except (AttributeError, TypeError, ValueError):
            pass
        return self._checked(q, "q"), self._checked(dq, "dq")

    def _checked(self, values: VectorLike, name: str) -> JointVector:
        try:
            return vector(values, self._shape[0] if self._shape else None, name)
        except InputError as error:
            raise StateError(f"no torque for this state: {error}") from None
