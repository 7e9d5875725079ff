"""Limits of velocity, acceleration and torque, and the parts of them that a plan uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, Vector, VectorLike, as_floats, by_value, checked, frozen_copy
from eos_pin.errors import InputError
from eos_pin.planning.plans import Plan
from eos_pin.robot.model import Robot

#: Points at which a plan is looked at for each of its knots, the fewest and the most.
DENSITY, FEWEST, MOST = 6, 600, 6000
#: Part of a limit that rounding may take.
ROUNDING = 1e-9


@by_value
@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of the motion of a robot's joints; infinite where there is none.

    Attributes:
        velocity: Largest velocity of each joint [rad/s or m/s], (n,).
        acceleration: Largest acceleration of each joint [rad/s² or m/s²], (n,).
        torque: Largest torque or force of each joint [N m or N], (n,).
    """

    velocity: JointVector
    acceleration: JointVector
    torque: JointVector

    def __post_init__(self) -> None:
        n = as_floats(self.velocity, "velocity").size
        for what in ("velocity", "acceleration", "torque"):
            object.__setattr__(self, what, frozen_copy(_positive(getattr(self, what), n, what)))

    @classmethod
    @checked
    def of(
        cls,
        robot: Robot,
        *,
        velocity: float | VectorLike | None = None,
        acceleration: float | VectorLike | None = None,
        torque: float | VectorLike | bool = False,
    ) -> MotionLimits:
        """Limits of a robot.

        Args:
            robot: The robot.
            velocity: Largest velocities, one number or (n,); by default those of the robot.
            acceleration: Largest accelerations, one number or (n,); by default none, because URDF has none.
            torque: Largest torques, one number or (n,), or whether those of the robot count.

        Raises:
            InputError: A limit is not positive, or there is a limit of torque and the robot has no masses.
        """
        unlimited = np.full(robot.n, np.inf)
        most = robot.effort if torque is True else unlimited if torque is False else torque
        limits = cls(
            *(
                frozen_copy(unlimited if limit is None else _positive(limit, robot.n, what))
                for limit, what in (
                    (robot.velocity if velocity is None else velocity, "velocities"),
                    (acceleration, "accelerations"),
                    (most, "torques"),
                )
            )
        )
        if np.isfinite(limits.torque).any():
            robot.mass(np.clip(np.zeros(robot.n), robot.lower, robot.upper))
        return limits


class Use(NamedTuple):
    """The largest part of a limit that a motion uses.

    Attributes:
        ratio: Part of the limit, above 1 where it is exceeded.
        joint: Name of the joint.
        t: Time of the plan [s].
    """

    ratio: float
    joint: str
    t: float


@dataclass(frozen=True)
class LimitUse:
    """Parts of the limits that a plan uses at its own pace; None where there is no limit.

    Attributes:
        velocity: Of the velocity limits.
        acceleration: Of the acceleration limits.
        torque: Of the torque limits, by inverse dynamics.
    """

    velocity: Use | None
    acceleration: Use | None
    torque: Use | None

    @property
    def kept(self) -> bool:
        """Whether all limits are kept."""
        return all(use is None or use.ratio <= 1.0 + ROUNDING for use in self._uses.values())

    @property
    def _uses(self) -> dict[str, Use | None]:
        return {"velocity": self.velocity, "acceleration": self.acceleration, "torque": self.torque}

    @property
    def message(self) -> str:
        """The limits that are exceeded, with excess and place; empty where all are kept."""
        return "; ".join(
            f"the {what} of {use.joint!r} is {use.ratio:.4g} times its limit at {use.t:.4g} s"
            for what, use in self._uses.items()
            if use is not None and use.ratio > 1.0 + ROUNDING
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {what: None if use is None else use._asdict() for what, use in self._uses.items()}


@checked
def limit_use(plan: Plan, limits: MotionLimits | None = None) -> LimitUse:
    """Parts of the limits that a plan uses, looked at densely at its own pace.

    Args:
        plan: The plan.
        limits: The limits; by default the robot's velocity limits.
    """
    limits = limits or MotionLimits.of(plan.robot)
    motion = motion_of(plan)
    tau, _ = torques_of(plan.robot, motion, limits)
    names = [joint.name for joint in plan.robot.joints]

    def use(values: Array, most: Vector) -> Use | None:
        if not np.isfinite(most).any():
            return None
        parts = np.abs(values) / most
        row, joint = np.unravel_index(int(parts.argmax()), parts.shape)
        return Use(float(parts[row, joint]), names[joint], float(motion.t[row]))

    return LimitUse(use(motion.dq, limits.velocity), use(motion.ddq, limits.acceleration), use(tau, limits.torque))


def _positive(limit: float | VectorLike, n: int, what: str) -> Vector:
    given = as_floats(limit, f"the largest {what}")
    most = np.broadcast_to(given, (n,)) if given.ndim == 0 else given
    if most.shape != (n,) or not (most > 0.0).all():
        raise InputError(f"the largest {what} must be one positive number or {n}, got {given.tolist()}")
    return most


class Motion(NamedTuple):
    """Joints and their derivatives at many times, (T,) and (T, n)."""

    t: Vector
    q: Float[Array, "T n"]
    dq: Float[Array, "T n"]
    ddq: Float[Array, "T n"]


def motion_of(plan: Plan) -> Motion:
    """Motion of a plan, at places evenly between its knots and in time."""
    count = int(np.clip(DENSITY * len(plan.times), FEWEST, MOST))
    nodes = np.linspace(plan.start, plan.end, count)
    if plan.pace is not None:
        # Accelerations are largest at nodes and next to them.
        t = plan.pace.times
        nodes = np.union1d(nodes, np.concatenate((t, 0.5 * (t[1:] + t[:-1]))))
    rows = [plan(float(t)) for t in nodes]
    return Motion(nodes, *(np.array(column) for column in zip(*rows, strict=True)))


def torques_of(robot: Robot, motion: Motion, limits: MotionLimits) -> tuple[Array, Array]:
    """Torques of a motion, and those that hold it still; zero where there is no limit."""
    if not np.isfinite(limits.torque).any():
        return np.zeros_like(motion.q), np.zeros_like(motion.q)
    rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
    tau = np.array([robot.inverse_dynamics(q, dq, ddq) for q, dq, ddq in rows])
    return tau, np.array([robot.gravity(q) for q in motion.q])
