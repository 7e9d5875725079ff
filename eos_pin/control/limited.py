"""`LimitedEosController`: EOS control that keeps joint position, velocity, acceleration and torque limits.

The torque of EOS control is used wherever it keeps all limits. Elsewhere a quadratic program changes the acceleration
the least, and in a way that affects the task only where no sensible self-motion keeps the limits. Position limits are
kept by viability: a joint is never allowed a speed from which it could not stop. The torque is bounded, and a
continuous function of the state: limits are approached smoothly, and nothing is ever switched over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    Vector,
    VectorLike,
    as_floats,
    broadcast,
    by_value,
    checked,
    frozen_copy,
    number,
    of_type,
)
from eos_pin._kernels import plain_parts
from eos_pin._kernels.dispatch import use_compiled
from eos_pin._kernels.plain_parts import Viability
from eos_pin.charts.atlas import Atlas
from eos_pin.control._smallest_change import SmallestChange
from eos_pin.control.eos import EosController
from eos_pin.control.objectives import Objective
from eos_pin.control.overload import gravity_overload, keeping_order
from eos_pin.control.state import EosState
from eos_pin.control.tolerance import Bands
from eos_pin.errors import InputError, Renamed, renamed
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

Limits = use_compiled(plain_parts.Limits)

#: Rate at which a joint closes in on a limit of position or velocity [1/s].
RATE = 100.0
#: Position limits are kept this distance off, times the period squared: 1e-5 rad at 1 kHz. It covers what the motion
#: over a period differs from its prediction, which falls with the square of the period, too [rad/s² or m/s²].
ROOM = 10.0
#: The same for velocity limits, as a part of them: 0.2 % at 1 kHz; and the most of it [1/s²].
SPEED_ROOM, MOST_SPEED_ROOM = 2000.0, 0.05
#: A limit counts as passed beyond this: of position [rad or m], and of velocity, as a part of it.
POSITION, VELOCITY = 1e-5, 1e-3
#: A torque counts as used up from this part of its limit on; and time before a limit is passed that tells why [s].
USED_UP, BEFORE = 0.999, 0.05
#: Without limits of acceleration: time from rest to the velocity limit [s], and acceleration where there is none
#: [rad/s² or m/s²].
RAMP, ACCELERATION = 0.25, 10.0
#: Where each joint may be accelerated by this much more than it is, limits are not looked at more closely
#: [rad/s² or m/s²].
CLEAR = 20.0
#: Part of its speed limit from which a joint counts as fast: the middle of a period does not tell all of it then.
FAST = 1.1
#: How often the motion of a period is predicted where limits are active, at most, and how well a prediction must be met
#: [rad/s² or m/s²].
TIMES, MET = 6, 1e-4


@by_value
@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of every joint; infinite where there is no limit.

    Attributes:
        lower: Lower positions [rad or m].
        upper: Upper positions [rad or m].
        velocity: Largest speeds [rad/s or m/s].
        acceleration: Largest accelerations [rad/s² or m/s²].
        braking: Decelerations with which every joint can be stopped at any time [rad/s² or m/s²].
        torque: Largest torques or forces [N m or N].
    """

    lower: JointVector
    upper: JointVector
    velocity: JointVector
    acceleration: JointVector
    braking: JointVector
    torque: JointVector

    of = Renamed("from_robot")

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "velocity", "acceleration", "braking", "torque"):
            values = as_floats(getattr(self, name), name)
            if values.ndim != 1 or values.size != np.size(self.lower) or np.isnan(values).any():
                raise InputError(f"{name} must be one number for each joint, got {values.tolist()}")
            object.__setattr__(self, name, frozen_copy(values))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.lower.size

    @classmethod
    @checked
    def from_robot(
        cls,
        robot: Robot,
        *,
        velocity: float | VectorLike | None = None,
        acceleration: float | VectorLike | None = None,
        braking: float | VectorLike | None = None,
        torque: float | VectorLike | None = None,
        position_margin: float = 0.0,
    ) -> JointLimits:
        """Limits of a robot, as its URDF has them.

        Args:
            robot: The robot.
            velocity: Velocity limits instead of the robot's own.
            acceleration: Acceleration limits; a URDF has none.
            braking: Sure decelerations; by default what `guaranteed_deceleration` finds the torque limits to allow.
            torque: Torque limits instead of the robot's own.
            position_margin: Distance kept from the position limits [rad or m].

        Raises:
            InputError: A limit is not positive, or the margin leaves no room.
        """
        margin = number(position_margin, "the margin of the position limits", at_least=0.0)
        lower, upper = robot.lower + margin, robot.upper - margin
        if (lower >= upper).any():
            raise InputError(f"a margin of {margin:g} leaves no room between the position limits of {robot.name!r}")

        def chosen(given: float | VectorLike | None, name: str, own: JointVector) -> JointVector:
            values = own if given is None else broadcast(given, robot.n, f"the {name} limits")
            if not (values > 0.0).all():
                raise InputError(f"the {name} limits must be positive, got {values.tolist()}")
            return frozen_copy(values)

        most_torque = chosen(torque, "torque", robot.effort)
        most = chosen(acceleration, "acceleration", np.full(robot.n, np.inf))
        sure = guaranteed_deceleration(robot, most_torque) if braking is None else robot.lower
        return cls(
            lower=frozen_copy(lower),
            upper=frozen_copy(upper),
            velocity=chosen(velocity, "velocity", robot.velocity),
            acceleration=most,
            braking=np.minimum(chosen(braking, "braking", sure), most),
            torque=most_torque,
        )

    @classmethod
    @checked
    def without_torques(
        cls,
        robot: Robot,
        *,
        velocity: float | VectorLike | None = None,
        acceleration: float | VectorLike | None = None,
        position_margin: float = 0.0,
    ) -> JointLimits:
        """Limits for commands of position or velocity, where the robot sees to its torques; no inertia is needed.

        Args:
            robot: The robot.
            velocity: Velocity limits instead of the robot's own.
            acceleration: Acceleration limits, also for braking; by default those that reach the velocity limit within
                `RAMP` seconds, and `ACCELERATION` where there is none.
            position_margin: Distance kept from the position limits [rad or m].

        Raises:
            InputError: A limit is not positive, or the margin leaves no room.
        """
        fastest = robot.velocity if velocity is None else broadcast(velocity, robot.n, "the velocity limits")
        usual = np.where(np.isfinite(fastest), fastest / RAMP, ACCELERATION)
        most = usual if acceleration is None else acceleration
        return cls.from_robot(
            robot, velocity=velocity, acceleration=most, braking=most, position_margin=position_margin
        )

    @checked
    def accelerations(self, q: JointVector, dq: JointVector, period: float) -> tuple[JointVector, JointVector]:
        """Least and largest acceleration of each joint over one period that keep position, velocity and viability.

        Both change continuously with the state. At the distance s from its limit a joint may move towards it at the
        speed V(s) = √(2 b s + c²) − c, c = b/ρ: far away that is what the braking deceleration b just stops there, near
        it ρ s. Where a ≤ ρ (V − v) − V' v a speed v below V(s) stays below, and because V V' ≤ b no more than b is ever
        needed. ρ is `RATE`. Beyond the limit V = ρ s / (1 + ρ |s| / v), v its velocity limit: there is no hurry
        back. Of both limits a small room is left, `ROOM` and `SPEED_ROOM`.

        Args:
            q: Joints.
            dq: Joint velocities.
            period: Time for which the torque is held [s].
        """
        most = _viability(self, period)(q, dq)
        return np.minimum(-most[q.size :], most[: q.size]), most[: q.size]

    @checked
    def passed(
        self, robot: Robot, t: Vector, q: Float[Array, "T n"], dq: Float[Array, "T n"], tau: Float[Array, "T n"]
    ) -> str:
        """Limits of position and velocity that were passed in a run, with excess and reason; empty where none was.

        Args:
            robot: The robot of the controller's model.
            t: Times [s].
            q: Joints.
            dq: Joint velocities.
            tau: Torques.
        """
        over, speed = np.maximum(q - self.upper, self.lower - q), np.abs(dq) / self.velocity
        sentences = []
        for j, joint in enumerate(robot.joints):
            rows = np.flatnonzero((over[:, j] > POSITION) | (speed[:, j] > 1.0 + VELOCITY))
            if not len(rows):
                continue
            first, length, unit = rows[0], *(("m", "N") if joint.kind == "prismatic" else ("rad", "N m"))
            amounts = []
            if over[:, j].max() > POSITION:
                amounts.append(f"its position limit by {over[:, j].max():.2g} {length}")
            if speed[:, j].max() > 1.0 + VELOCITY:
                amounts.append(f"its velocity limit {speed[:, j].max():.3g} times")
            recent = slice(np.searchsorted(t, t[first] - BEFORE), first + 1)
            if first == 0:
                why = "where it began"
            elif (np.abs(tau[recent, j]) >= USED_UP * self.torque[j]).any():
                weight = max(abs(robot._gravity(row)[j]) for row in q[: first + 1])
                why = (
                    f"as its torque of {self.torque[j]:.3g} {unit} was used up (gravity took up to {weight:.3g} {unit})"
                )
            else:
                why = "though it had torque left: other joints lacked it, or the motion was not the model's"
            sentences.append(f"{joint.name!r} passed {' and '.join(amounts)}, first at t = {t[first]:.4g} s, {why}")
        return f"limits were passed: {'; '.join(sentences)}" if sentences else ""


def _viability(limits: JointLimits, period: float) -> Viability:
    """`JointLimits.accelerations` for one period."""
    rate = min(RATE, 0.5 / period)
    part = 1.0 - min(SPEED_ROOM * period**2, MOST_SPEED_ROOM)
    # Towards the lower limit everything is mirrored.
    return Viability(
        rate,
        ends=np.concatenate((limits.upper, -limits.lower)) - ROOM * period**2,
        fastest=rate * part * np.tile(limits.velocity, 2),
        braking=np.tile(limits.braking, 2),
        acceleration=np.tile(limits.acceleration, 2),
    )


def guaranteed_deceleration(robot: Robot, torque: JointVector, *, seed: int = 0) -> JointVector:
    """Deceleration that all joints can hold together within their torque limits, in any posture at any allowed speed.

    Args:
        robot: The robot.
        torque: Torque limits, (n,) [N m or N].
        seed: Seed of the states that are tried.

    Returns:
        Decelerations [rad/s² or m/s²], from 0.5 to 50.
    """
    random = np.random.default_rng(seed)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    speed = np.minimum(robot.velocity, np.pi)
    states = [(random.uniform(lower, upper), random.uniform(-speed, speed)) for _ in range(300)]
    # What gravity and Coriolis torques leave.
    left = np.maximum(torque - np.abs([robot._bias(q, dq) for q, dq in states]), 0.0)
    masses = np.abs([robot._mass(q) for q, _ in states])
    alike = np.minimum((left / masses.sum(axis=2)).min(axis=0), 50.0)
    # Those were for all joints alike; with one for each, those that brake harder load the others more.
    loads = np.maximum(masses @ alike, 1e-12)
    return np.maximum(min((left / loads).min(), 1.0) * alike, 0.5)


class LimitedEosController(EosController):
    """EOS computed torque within limits; for a sampled loop, because limits are kept from one sample to the next.

    Where no limit is active the torque is that of `EosController`, to the last digit.

    Where no torques keep all limits, joints are lost by a fixed rule. Hopeless joints, which no torques at all keep
    within the bounds of `JointLimits.accelerations`, brake with all the torque they have. The others are kept one after
    the other in the order `keeping_order`, where that is possible together with those before: so a joint too weak for
    what it carries takes no stronger one along. Lost joints brake with what is left. So that the torque is continuous,
    a joint lost just now is still helped while it would lack more than twice the least acceleration that it must lack;
    in this short time it may exclude joints after it. `overload` lists beforehand the joints that cannot bear
    gravity.

    Coordinates with a tolerance are kept in their `Bands`, after the limits of joints and before what is tracked.

    A target may lead out of reach and come back; the task is then taken up again. But the law is local: an arm that
    went through a singularity meanwhile, or began near one, may have come to where joint limits bar every way that
    lessens the error at once. It stays there until the target moves on, and `task_deficit` is the part it lacks. Three
    or four of a hundred random runs in `benchmarks/limits.py` end so.

    Args:
        task: The task.
        reference: Trajectory of the task.
        self_motion: Objective of the self-motion; by default to hold v at its value at the start.
        limits: Limits to keep; by default those of the task's robot.
        control_period: Control period [s]; `simulate_sampled` takes it from here.
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.
    """

    period = Renamed("control_period")

    @renamed(period="control_period")
    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        self_motion: Objective | None = None,
        *,
        limits: JointLimits | None = None,
        control_period: float = 1e-3,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
        atlas: Atlas | None = None,
    ) -> None:
        super().__init__(
            task, reference, self_motion, kp=kp, kd=kd, feedforward=feedforward, gravity=gravity, atlas=atlas
        )
        self.limits = limits or JointLimits.from_robot(task.robot)
        self.control_period: float = control_period
        self._bands = Bands(task) if task.bands else None

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "control_period":
            value = number(value, "the control period", above=0.0)
        elif name == "limits":
            of_type(value, "the limits", JointLimits)
        super().__setattr__(name, value)
        if name in ("limits", "control_period") and "control_period" in vars(self):
            self._viability = _viability(self.limits, self.control_period)
        if name in ("limits", "control_period", "gravity"):
            # It holds copies.
            self.__dict__.pop("_within", None)
            self.__dict__.pop("_smallest", None)

    @checked
    def overload(self, q: JointVector | None = None) -> tuple[str, ...]:
        """Joints that cannot hold themselves against gravity, see `gravity_overload`; to be read before the start.

        Args:
            q: Posture at the start.
        """
        return gravity_overload(self.robot, q, self.limits.torque)

    @property
    def keeping_order(self) -> tuple[int, ...]:
        """Joints in the order in which their limits are kept where not all can be, see `keeping_order`."""
        return keeping_order(self.robot, self.limits.torque)

    def broken_limits(
        self, t: Vector, q: Float[Array, "T n"], dq: Float[Array, "T n"], tau: Float[Array, "T n"]
    ) -> str:
        return self.limits.passed(self.robot, t, q, dq, tau)

    def describe(self) -> dict[str, Any]:
        kept = {name: getattr(self.limits, name).tolist() for name in ("velocity", "braking", "torque")}
        return super().describe() | {"control_period": self.control_period, "limits": kept}

    @cached_property
    def _within(
        self,
    ) -> Callable[[JointVector, JointVector, JointVector, Jacobian], tuple[JointVector, JointVector]]:
        """Torque within all limits, and the change that they make in the joint acceleration."""
        kept = self._viability
        within = Limits(self.control_period, kept.rate, kept.ends, kept.fastest, kept.braking, kept.acceleration,
            self.limits.torque, CLEAR, FAST, TIMES, MET, self._model, self._smallest)  # fmt: skip
        return within if self._bands is None else partial(self._within_bands, within)

    def _within_bands(
        self, within: Any, q: JointVector, dq: JointVector, ddq: JointVector, J: Jacobian
    ) -> tuple[JointVector, JointVector]:
        return within(q, dq, ddq, self._smallest.with_bands(J))

    @cached_property
    def _smallest(self) -> SmallestChange:
        return SmallestChange(self.task.m, self.robot.n, self.keeping_order, bands=len(self.task.bands))

    def _drive(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> tuple[JointVector, float, Jacobian]:
        ddq, margin, J = super()._drive(t, q, dq, state)
        if self._bands is not None:
            bands = self._bands(self.reference, t, q, dq, self._viability(q, dq))
            ddq = ddq + self._smallest.into_bands(J, ddq, *bands)
        return ddq, margin, J
