"""`LimitedEosController`: EOS control that keeps joint position, velocity, acceleration and torque limits.

The torque of EOS control is used wherever it keeps all limits. Elsewhere a quadratic program changes the acceleration
the least, and in a way that the task feels only where no sensible self-motion keeps the limits. Position limits are
kept by viability: a joint is never allowed a speed from which it could not stop. The torque is bounded, and a
continuous function of the state: limits are approached smoothly, and nothing is ever switched over.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import daqp
import numpy as np

from eos_pin.arrays import Jacobian, JointVector, Matrix, TaskVector, Vector, VectorLike, number, readonly, spread
from eos_pin.atlas import Atlas
from eos_pin.controllers import EosController, EosMemory
from eos_pin.errors import InputError
from eos_pin.objectives import Objective
from eos_pin.robot import Robot
from eos_pin.tasks import Task, TaskPoint
from eos_pin.trajectories import Trajectory

#: Rate at which a joint closes in on a limit of position or velocity [1/s].
RATE = 100.0
#: Position limits are kept this distance off, times the period squared: 1e-5 rad at 1 kHz. It covers what the motion
#: over a period differs from its prediction, which falls with the square of the period, too [rad/s² or m/s²].
ROOM = 10.0
#: Price of a change that the task feels against one of the joints, for its size and for its square. The first keeps the
#: task exactly, up to where that would take excessive self-motion; the second shares what must be given up among the
#: directions of the task, so that the robot is not caught where it gives up one of them for ever.
TASK_PRICE, TASK_WEIGHT = 1e3, 1e4
#: Price of position and velocity limits; so high that they give way to nothing but torque limits.
LIMIT_PRICE = 1e10
#: Where each joint may be accelerated by this much more than it is, limits are not looked at more closely
#: [rad/s² or m/s²].
CLEAR = 20.0
#: How daqp is told that there is no bound.
FAR = 1e20


@dataclass(frozen=True, eq=False)
class JointLimits:
    """What every joint must keep; infinite where there is no limit.

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

    @classmethod
    def of(
        cls,
        robot: Robot,
        *,
        velocity: float | VectorLike | None = None,
        acceleration: float | VectorLike | None = None,
        braking: float | VectorLike | None = None,
        torque: float | VectorLike | None = None,
        margin: float = 0.0,
    ) -> JointLimits:
        """Limits of a robot, as its URDF has them.

        Args:
            robot: The robot.
            velocity: Velocity limits instead of the robot's own.
            acceleration: Acceleration limits; a URDF has none.
            braking: Sure decelerations; by default what `sure_braking` finds the torque limits to allow.
            torque: Torque limits instead of the robot's own.
            margin: Distance kept from the position limits [rad or m].

        Raises:
            InputError: A limit is not positive, or the margin leaves no room.
        """
        margin = number(margin, "the margin of the position limits", at_least=0.0)
        lower, upper = robot.lower + margin, robot.upper - margin
        if (lower >= upper).any():
            raise InputError(f"a margin of {margin:g} leaves no room between the position limits of {robot.name!r}")

        def chosen(given: float | VectorLike | None, name: str, own: JointVector) -> JointVector:
            values = own if given is None else spread(given, robot.n, f"the {name} limits")
            if not (values > 0.0).all():
                raise InputError(f"the {name} limits must be positive, got {values.tolist()}")
            return readonly(values)

        most_torque = chosen(torque, "torque", robot.effort)
        most = chosen(acceleration, "acceleration", np.full(robot.n, np.inf))
        sure = sure_braking(robot, most_torque) if braking is None else robot.lower
        return cls(
            lower=readonly(lower),
            upper=readonly(upper),
            velocity=chosen(velocity, "velocity", robot.velocity),
            acceleration=most,
            braking=np.minimum(chosen(braking, "braking", sure), most),
            torque=most_torque,
        )

    def accelerations(self, q: JointVector, dq: JointVector, period: float) -> tuple[JointVector, JointVector]:
        """Least and largest acceleration of each joint over one period that keep position, velocity and viability.

        Both change continuously with the state. At the distance s from its limit a joint may move towards it at the
        speed V(s) = √(2 b s + c²) − c, c = b/ρ: far away that is what the braking deceleration b just stops there, near
        it ρ s. Where a ≤ ρ (V − v) − V' v a speed v below V(s) stays below, and because V V' ≤ b no more than b is ever
        needed. ρ is `RATE`.

        Args:
            q: Joints.
            dq: Joint velocities.
            period: Time for which the torque is held [s].
        """
        most = _Viability(self, period)(q, dq)
        return np.minimum(-most[q.size :], most[: q.size]), most[: q.size]


class _Viability:
    """`JointLimits.accelerations` for one period, in the form of 2n upper bounds: for ddq, and for −ddq."""

    def __init__(self, limits: JointLimits, period: float) -> None:
        rate, n = min(RATE, 0.5 / period), limits.lower.size
        # Towards the lower limit everything is mirrored.
        self.sides = np.vstack((np.eye(n), -np.eye(n)))
        self._ends = np.concatenate((limits.upper, -limits.lower)) - ROOM * period**2
        self._braking, self._acceleration = np.tile(limits.braking, 2), np.tile(limits.acceleration, 2)
        self._fastest = rate * np.tile(limits.velocity, 2)
        self._rate = rate

    def __call__(self, q: JointVector, dq: JointVector) -> Vector:
        b, rate = self._braking, self._rate
        room, speed = self._ends - self.sides.dot(q), self.sides.dot(dq)
        # ρ V = root − b and V' = ρ b / root
        root = np.sqrt(2.0 * rate**2 * b * np.maximum(room, 0.0) + b * b)
        most = root - b + rate**2 * np.minimum(room, 0.0) - rate * b / root * speed
        most = np.minimum(most, self._fastest) - rate * speed
        return np.minimum(np.maximum(most, -self._acceleration), self._acceleration)


def sure_braking(robot: Robot, torque: JointVector, *, seed: int = 0) -> JointVector:
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
    left = np.maximum(torque - np.abs([robot.bias(q, dq) for q, dq in states]), 0.0)
    masses = np.abs([robot.mass(q) for q, _ in states])
    alike = np.minimum((left / masses.sum(axis=2)).min(axis=0), 50.0)
    # Those were for all joints alike; with one for each, those that brake harder load the others more.
    loads = np.maximum(masses @ alike, 1e-12)
    return np.maximum(min((left / loads).min(), 1.0) * alike, 0.5)


class LimitedEosController(EosController):
    """EOS computed torque within limits; for a sampled loop, because limits are kept from one sample to the next.

    Where no limit is active the torque is that of `EosController`, to the last digit.

    Args:
        task: The task.
        reference: Trajectory of the task.
        self_motion: What the self-motion should do; by default hold v at its value at the start.
        limits: What to keep; by default the limits of the task's robot.
        period: Control period [s].
        kp: Gain on the task error, one number or (m,) [1/s²].
        kd: Gain on the task's velocity error, one number or (m,) [1/s].
        feedforward: Whether dz and ddz of the reference are used.
        gravity: Whether the controller compensates gravity.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.
    """

    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        self_motion: Objective | None = None,
        *,
        limits: JointLimits | None = None,
        period: float = 1e-3,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        feedforward: bool = True,
        gravity: bool = True,
        atlas: Atlas | None = None,
    ) -> None:
        super().__init__(
            task, reference, self_motion, kp=kp, kd=kd, feedforward=feedforward, gravity=gravity, atlas=atlas
        )
        self.limits = limits or JointLimits.of(task.robot)
        self.period = number(period, "the control period", above=0.0)
        self._viability = _Viability(self.limits, self.period)
        self._per_torque = 1.0 / self.limits.torque

    def describe(self) -> dict[str, Any]:
        kept = {name: getattr(self.limits, name).tolist() for name in ("velocity", "braking", "torque")}
        return super().describe() | {"period": self.period, "limits": kept}

    def given_up(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> TaskVector:
        return super().given_up(t, q, dq, memory) + self.given_up_to_limits(t, q, dq, memory)

    def given_up_to_limits(self, t: float, q: JointVector, dq: JointVector, memory: EosMemory) -> TaskVector:
        """The part of `given_up` that limits take, on average over a period; a singularity takes the rest."""
        point = self.task.at(q, dq)
        ddq, _ = self._drive(t, q, dq, memory, point)
        return -point.J @ self._within(q, dq, ddq, point.J)[1]

    def _torque(
        self, q: JointVector, dq: JointVector, ddq: JointVector, memory: EosMemory, point: TaskPoint
    ) -> JointVector:
        return self._within(q, dq, ddq, point.J)[0]

    def _within(
        self, q: JointVector, dq: JointVector, ddq: JointVector, J: Jacobian
    ) -> tuple[JointVector, JointVector]:
        """Torque within all limits, and what it changes in the joint acceleration that was asked for."""
        model, half, sides = self._model, 0.5 * self.period, self._viability.sides
        most = self._viability(q, dq)
        tau = model.inverse_dynamics(q, dq, ddq)
        part = tau * self._per_torque
        # Far from all limits nothing needs to be predicted.
        if part.dot(part) < 1.0 and (most - sides.dot(ddq)).min() > CLEAR:
            return tau, np.zeros_like(tau)
        n, torque = ddq.size, self.limits.torque
        most, least = most[:n], np.minimum(-most[n:], most[:n])
        mean = np.minimum(np.maximum(ddq, least), most)
        # A held torque accelerates the joints, on average, as in the middle of the period; twice, because where that is
        # depends on the acceleration.
        for _ in range(2):
            middle = q + half * (dq + 0.5 * half * mean)
            free = model.forward_dynamics(middle, dq + half * mean, tau)
            if (free <= most).all() and (free >= least).all() and (np.abs(part) <= 1.0).all():
                return tau, np.zeros_like(tau)
            M = model.mass(middle)
            change = self._change(J, M, least - free, most - free, -torque - tau, torque - tau)
            mean = free + change
        # For rounding only.
        return np.clip(tau + M @ change, -torque, torque), change

    def _change(
        self,
        J: Jacobian,
        M: Matrix,
        least: JointVector,
        most: JointVector,
        least_torque: JointVector,
        most_torque: JointVector,
    ) -> JointVector:
        """Smallest change of acceleration that keeps all limits, and that the task feels only where it must.

        It is the Δ that minimizes ½|Δ|² + TASK_PRICE Σt + ½ TASK_WEIGHT Σt² + LIMIT_PRICE (w + ½ w²) where |JΔ| ≤ t,
        least − w ≤ Δ ≤ most + w, and MΔ is within the torques. Prices are due from the first bit on, so t and w are
        exactly zero wherever that costs less. The minimum always exists, is unique, and moves continuously.
        """
        m, n = J.shape
        H, prices, rows = self._program
        A = rows.copy()
        A[2 * n :, m + 1 :] = np.concatenate((M, J, J))
        upper = np.concatenate(([FAR], most, np.full(n, FAR), most_torque, np.zeros(m), np.full(m, FAR)))
        lower = np.concatenate(([0.0], np.full(n, -FAR), least, least_torque, np.full(m, -FAR), np.zeros(m)))
        x, _, flag, _ = daqp.solve(H, prices, A, np.minimum(upper, FAR), np.maximum(lower, -FAR))
        # Only numbers beyond all reason have no solution; then every joint for itself.
        return x[m + 1 :] if flag > 0 else np.clip(0.0, least, most)

    @cached_property
    def _program(self) -> tuple[Matrix, Vector, Matrix]:
        """Cost ½ xᵀHx + pᵀx of x = (w, t, Δ), and the rows of what is bounded, with M and J still to be filled in."""
        m, n = self.task.m, self.task.robot.n
        H = np.diag([LIMIT_PRICE] + [TASK_WEIGHT] * m + [1.0] * n)
        prices = np.array([LIMIT_PRICE] + [TASK_PRICE] * m + [0.0] * n)
        rows = np.zeros((3 * n + 2 * m, 1 + m + n))
        rows[: 2 * n, 0] = np.repeat((-1.0, 1.0), n)
        rows[: 2 * n, m + 1 :] = np.tile(np.eye(n), (2, 1))
        rows[3 * n :, 1 : m + 1] = np.concatenate((-np.eye(m), np.eye(m)))
        return H, prices, rows
