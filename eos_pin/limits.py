"""`LimitedEosController`: EOS control that keeps joint position, velocity, acceleration and torque limits.

The nominal acceleration of EOS control is used wherever it keeps all limits. Elsewhere the self-motion gives way, by
the quadratic program that changes its acceleration the least; only where no self-motion keeps the limits does the task
give way too. Position limits are kept by viability: a joint is never allowed a speed from which it could not stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np

from eos_pin.arrays import Array, JointVector, VectorLike, number, readonly, spread
from eos_pin.atlas import Atlas
from eos_pin.controllers import EosController, EosMemory
from eos_pin.errors import InputError
from eos_pin.objectives import Objective
from eos_pin.robot import Robot
from eos_pin.tasks import Task, TaskPoint
from eos_pin.trajectories import Trajectory

#: Weight of the task against the self-motion where both must give way; the task is worth a thousand times as much.
TASK_WEIGHT = 1e6
#: How daqp marks a constraint that may be violated.
SOFT = 8


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

        Viable is a state from which the joint stops before its limit at its braking deceleration b, so the next state
        must be viable too: (dq + a T)² ≤ 2 b (q_max − q − dq T − ½ a T²) for a joint that moves towards q_max.

        Args:
            q: Joints.
            dq: Joint velocities.
            period: Time T for which the acceleration is held [s].
        """
        # Both sides at once: towards the lower limit everything is mirrored.
        room = np.stack((self.upper - q, q - self.lower))
        speed = np.stack((dq, -dq))
        A, T = self.braking, period
        ahead = room - speed * T
        half = T * (speed + 0.5 * A * T)
        discriminant = half * half - T * T * (speed * speed - 2.0 * A * ahead)
        viable = (np.sqrt(np.maximum(discriminant, 0.0)) - half) / (T * T)
        # To stop within the period is always allowed; where even that is not enough it is the best there is.
        stop = -speed / T
        most = np.where(discriminant >= 0.0, np.maximum(viable, stop), stop)
        most = np.minimum(np.minimum(most, 2.0 * ahead / (T * T)), (self.velocity - speed) / T)
        most = np.clip(most, -self.acceleration, self.acceleration)
        return np.minimum(-most[1], most[0]), most[0]


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
    least = np.full(robot.n, 50.0)
    for _ in range(300):
        q, dq = random.uniform(lower, upper), random.uniform(-speed, speed)
        # What gravity and Coriolis torques leave, shared with the joints it is coupled to.
        left = (torque - np.abs(robot.bias(q, dq))) / np.abs(robot.mass(q)).sum(axis=1)
        least = np.minimum(least, left)
    return np.maximum(least, 0.5)


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

    def describe(self) -> dict[str, Any]:
        kept = {name: getattr(self.limits, name).tolist() for name in ("velocity", "braking", "torque")}
        return super().describe() | {"period": self.period, "limits": kept}

    def _torque(
        self, q: JointVector, dq: JointVector, ddq: JointVector, memory: EosMemory, point: TaskPoint
    ) -> JointVector:
        least, most = self.limits.accelerations(q, dq, self.period)
        tau = self._model.inverse_dynamics(q, dq, ddq)
        torque = self.limits.torque
        if (ddq <= most).all() and (ddq >= least).all() and (np.abs(tau) <= torque).all():
            return tau
        ddq = self._within(q, dq, ddq, memory, point, least, most)
        # Rounding, and states from which no torque keeps all limits: there the torque limit has the last word.
        return np.clip(self._model.inverse_dynamics(q, dq, ddq), -torque, torque)

    def _within(
        self,
        q: JointVector,
        dq: JointVector,
        nominal: JointVector,
        memory: EosMemory,
        point: TaskPoint,
        least: JointVector,
        most: JointVector,
    ) -> JointVector:
        """Acceleration within all limits that changes the self-motion least, and the task only where it must."""
        chart = memory.chart
        M, bias = self._model.mass(q), self._model.bias(q, dq)
        # A joint that must brake harder than its torque allows brakes as hard as it can: torque before position.
        rows = np.vstack((np.eye(chart.n), M))
        upper = np.concatenate((most, self.limits.torque - bias))
        lower = np.concatenate((least, -self.limits.torque - bias))
        offset = rows @ nominal
        if chart.r:
            # Along D the task does not feel a change: G'D = 0.
            D = self._self_motion_basis(chart, point)
            change = _solve(np.eye(chart.r), np.zeros(chart.r), rows @ D, lower - offset, upper - offset)
            if change is not None:
                return nominal + D @ change
        # The task gives way: least weighted change of (task, self-motion) from what was asked for.
        K = np.vstack((np.sqrt(TASK_WEIGHT) * point.J, chart.Vt))
        H = K.T @ K + 1e-9 * np.trace(K.T @ K) * np.eye(chart.n)
        change = _solve(H, np.zeros(chart.n), rows, lower - offset, upper - offset)
        if change is None:
            # No acceleration keeps both; the torque does, and comes as near to the rest as it can.
            change = _solve(H, np.zeros(chart.n), rows, lower - offset, upper - offset, soft=chart.n)
        return nominal if change is None else nominal + change

    @staticmethod
    def _self_motion_basis(chart: Any, point: TaskPoint) -> Array:
        """D = (I − U B G')V; Eq. (16)."""
        return chart.V - chart.U @ np.linalg.lstsq(point.J @ chart.U, point.J @ chart.V, rcond=1e-9)[0]


def _solve(H: Array, f: Array, A: Array, lower: Array, upper: Array, *, soft: int = 0) -> Array | None:
    """Minimum of ½ xᵀHx + fᵀx within lower ≤ A x ≤ upper, where the first `soft` rows may be violated at a price.

    Returns:
        None if there is no such x.
    """
    sense = np.where(np.arange(len(A)) < soft, SOFT, 0).astype(np.int32)
    x, _, flag, _ = daqp.solve(H, f, A, np.minimum(upper, 1e20), np.maximum(lower, -1e20), sense)
    return x if flag > 0 else None
