"""`KeepTolerance`: a law of the self-motion that keeps the bands of a task with tolerances; and limits of commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from eos_pin._arrays import Array, Jacobian, JointVector, SelfMotionVector, Vector, VectorLike, checked, gains, number
from eos_pin.charts.chart import Chart
from eos_pin.control._sampled_law import SelfTargets
from eos_pin.control._smallest_change import SmallestChange
from eos_pin.control.objectives import Further, Objective
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point, Task
from eos_pin.trajectories.base import Target, Trajectory

#: Rate at which the edge of a band is approached [1/s].
RATE = 20.0
#: Part of the deceleration that joints have for a band by which it counts on being braked: other bands, the path's own
#: acceleration and joints that come to their limits take of it.
BRAKING = 0.5
#: Time over which bands are differenced [s].
STEP = 1e-3
#: Self-motion over which slopes are differenced [rad or m].
SMALL = 1e-5
#: Root of the inverse price of what a band lacks.
SLACK = 1e-4
#: Part of a band that is left alone, so that what is neglected does not leave it.
ROOM = 1e-3
#: Rate at which that speed is approached [1/s], and part of a band from which on it counts.
CLOSING, MIDDLE = 100.0, 0.1
#: How often a command is corrected for curved bands at most, and excess of a band's part, squared, that needs none.
STEPS, NONE = 6, 1e-9
#: Acceleration of the task beyond which a change gave it up [m/s² or rad/s²].
GIVEN_UP = 1e-5


class Bands:
    """Bands of a task with tolerances, as limits of the joint acceleration.

    Of each band the part s that is used, squared, obeys s̈ ≤ 2 ρ (−ṡ) + ρ² (1 − s): then s ≤ 1 wherever it begins below,
    and not too fast towards 1 (an exponential control barrier function); from beyond it comes back. s̈ is linear in the
    joint acceleration.

    Args:
        task: The task.
        rate: Rate ρ at which the edge of a band is approached [1/s].
    """

    def __init__(self, task: Task, rate: float = RATE) -> None:
        self.task, self.rate = task, rate
        self.count = len(task.bands)
        self._sides = SMALL * np.concatenate((np.eye(task.robot.n), -np.eye(task.robot.n)))

    def __call__(
        self, reference: Trajectory, t: float, q: JointVector, dq: JointVector, within: Vector | None = None
    ) -> tuple[Float[Array, "B n"], Float[Array, " B"]]:
        """Rows S and bounds b; S ddq ≤ b keeps every band.

        Where accelerations are limited the edge is approached no faster than they let it be braked, as in
        `CommandLimits`.

        Args:
            reference: Path of the task, the middle of the bands.
            t: Time on it [s].
            q: Joints.
            dq: Joint velocities.
            within: Largest accelerations, and largest negative ones, (2n,).
        """
        n, ahead = q.size, STEP * dq
        targets = np.array([reference(t).z, reference(t + STEP).z, reference(t - STEP).z])
        Q = np.concatenate(([q, q + ahead, q - ahead], q + self._sides))
        Z = np.concatenate((targets, np.broadcast_to(targets[0], (2 * n, len(targets[0])))))
        used = self.task.used(self.task.whole.kinematics.value(Q), Z)
        s = np.square(used).sum(axis=2) / (1.0 - ROOM) ** 2
        rate, bend = (s[1] - s[2]) / (2.0 * STEP), (s[1] - 2.0 * s[0] + s[2]) / STEP**2
        most = -2.0 * self.rate * rate + self.rate**2 * (1.0 - s[0]) - bend
        rows = ((s[3 : n + 3] - s[n + 3 :]) / (2.0 * SMALL)).T
        if within is not None:
            part = np.sqrt(np.maximum(s[0], SMALL))
            slopes, speed, room = rows / (2.0 * part)[:, None], rate / (2.0 * part), 1.0 - part
            brake, fastest = _approach(slopes, -within[n:], within[:n], room, self.rate)
            # The part in use may gain speed up to V(d), and on V(d) it loses V' of it.
            gain = CLOSING * (fastest - speed) - brake / (fastest + brake / self.rate) * speed
            most = np.where(
                (part > MIDDLE) & (room > 0.0), np.minimum(most, 2.0 * (speed**2 + part * gain) - bend), most
            )
        return rows, most


def _approach(
    slopes: Float[Array, "B n"], least: JointVector, most: JointVector, room: Vector, rate: float
) -> tuple[Vector, Vector]:
    """Deceleration b that counts for bands, and the speed V(d) at which their edges may be approached.

    Args:
        slopes: Derivatives of the parts in use by the joints.
        least: Least acceleration of each joint.
        most: Largest one.
        room: Parts d that are left; where they are negative the speed is that of coming back.
        rate: Rate ρ at which an edge is approached that is near [1/s].
    """
    brake = BRAKING * np.maximum(np.maximum(-slopes * least, -slopes * most).sum(axis=1), NONE)
    near = brake / rate
    return brake, np.copysign(np.sqrt(2.0 * brake * np.abs(room) + near**2) - near, room)


class CommandLimits:
    """Limits of joints, and bands of the task, for a loop that commands positions: every command keeps them.

    The edge of a band is approached as joints approach their limits, see `JointLimits.accelerations`: where the part in
    use lacks d to 1, it grows by T V(d) in a period T at most, V(d) = √(2 b d + c²) − c, c = b/ρ. b is `BRAKING` times
    the deceleration that the limits of joints leave to it. So a band is not entered faster than joints can brake, and
    from beyond it comes back likewise. The condition is met by the joints that are commanded, not by their linear
    prediction.

    Args:
        task: The task.
        period: Time T between two commands [s].
    """

    def __init__(self, task: Task, period: float) -> None:
        self.task, self._whole, self._period, self._square = task, task.whole, period, period**2
        self._smallest = SmallestChange(task.m, task.robot.n, bands=len(task.bands))
        self._sides = SMALL * np.concatenate((np.zeros((1, task.robot.n)), np.eye(task.robot.n), -np.eye(task.robot.n)))

    def _used(self, z: Float[Array, "K size"], targets: Float[Array, "#K size"]) -> Float[Array, "K B"]:
        """Parts of the bands that are in use, squared."""
        used: Float[Array, "K B"] = np.square(self.task.used(z, targets)).sum(axis=2) / (1.0 - ROOM) ** 2
        return used

    def used(self, z: Point, target: Point) -> dict[str, float]:
        """Part of each band that a task point uses, by name."""
        if not self.task.bands:
            return {}
        used = np.linalg.norm(self.task.used(z[None], target[None])[0], axis=1)
        return dict(zip(self.task.bands, used.tolist(), strict=True))

    def parts(
        self, z: Point, target: Point, p: JointVector, ahead: Point, least: JointVector, most: JointVector
    ) -> Vector:
        """Largest part of each band, squared, that the next command may use.

        Args:
            z: Task point of the last command.
            target: Its target.
            p: Joints at the end of the period without acceleration.
            ahead: Target there.
            least: Least acceleration of each joint.
            most: Largest one.
        """
        if not self.task.bands:
            return np.zeros(0)
        n = p.size
        Z = np.concatenate((z[None], self._whole.kinematics.value(p + self._sides)))
        used = self.task.used(Z, np.concatenate((target[None], np.broadcast_to(ahead, (2 * n + 1, ahead.size)))))
        now, used = np.linalg.norm(used[0], axis=1) / (1.0 - ROOM), used[1:] / (1.0 - ROOM)
        # Outwards, where the motion leads.
        out = used[0] / np.maximum(np.linalg.norm(used[0], axis=1), SMALL)[:, None]
        slopes = ((used[1 : n + 1] - used[n + 1 :]) * out).sum(axis=2).T / (2.0 * SMALL)
        room = 1.0 - now
        _, speed = _approach(slopes, least, most, room, RATE)
        # Over a long period a band would be left from within otherwise.
        parts: Vector = np.square(
            now + np.where(room > 0.0, np.minimum(self._period * speed, room), self._period * speed)
        )
        return parts

    def kept(self, z: Point, target: Point, parts: Vector) -> bool:
        """Whether a task point uses no more than these parts of its bands."""
        return not parts.size or not (self._used(z[None], target[None]) > parts + NONE).any()

    def within(
        self, p: JointVector, a: JointVector, J: Jacobian, least: JointVector, most: JointVector, target: Point,
        parts: Vector, lacking: Callable[[Jacobian, Point], JointVector | None] | None,
    ) -> tuple[JointVector, Point, bool]:  # fmt: skip
        """Joints and task point after the smallest change of an acceleration, and whether limits of joints needed it.

        Args:
            p: Joints at the end of the period without acceleration.
            a: Acceleration of the law.
            J: Jacobian of the task at p.
            least: Least acceleration of each joint.
            most: Largest one.
            target: Target at the end of the period, the middle of the bands.
            parts: Largest part of each band, squared.
            lacking: Motion to the goal of the task, by the Jacobian and the task point of joints near it, or None if
                they are there; None where the goal cannot be met.
        """
        q, limited = p, False
        for _ in range(STEPS if parts.size else 1):
            change, rows = np.zeros(p.size), J
            if parts.size:
                used = self._used(self._whole.kinematics.value(q + self._sides), target[None])
                slopes = ((used[1 : p.size + 1] - used[p.size + 1 :]) / (2.0 * SMALL)).T
                room = (parts - used[0] - slopes.dot(p - q)) / self._square
                change = self._smallest.into_bands(J, a, slopes, room)
                rows = self._smallest.with_bands(J)
            if ((a + change < least) | (a + change > most)).any():
                limited = True
                change = change + self._smallest.within(rows, least - a - change, most - a - change)
            if limited or np.abs(J.dot(change)).max() > GIVEN_UP:
                lacking = None
            a = a + change
            q = p + self._square * a
            if not parts.size:
                break
            z, J = self.task._linearize(q)
            more = lacking and lacking(J, z)
            if more is None and self.kept(z, target, parts):
                break
            if more is not None:
                a, q = a + more / self._square, q + more
        return q, self.task._value(q), limited


class KeepTolerance(Objective):
    """Another law, changed the least where coordinates with a tolerance would leave their bands.

    For `EosController`; `LimitedEosController` and `KinematicLoop` keep the bands by themselves, within the limits of
    joints, too. See `Bands`.

    Args:
        law: The law that is changed.
        task: The task, whose bands are kept.
        reference: Path of the task, the middle of the bands.
        rate: Rate ρ at which the edge of a band is approached [1/s].
        kp: Gain on the task error, as the controller has it [1/s²].
        kd: Gain on the task's velocity error, likewise [1/s].
    """

    @checked
    def __init__(
        self,
        law: Objective,
        task: Task,
        reference: Trajectory,
        *,
        rate: float = RATE,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
    ) -> None:
        self.law, self.task, self.reference = law, task, reference
        self.rate = number(rate, "the rate", above=0.0)
        self._bands = Bands(task, self.rate)
        self.kp, self.kd = (gains(k, task.m, "a gain on the task") for k in (kp, kd))

    def __setattr__(self, name: str, value: Any) -> None:
        if "kd" in vars(self):
            raise InputError(f"the {name} of a KeepTolerance cannot be changed; make another one")
        super().__setattr__(name, value)

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        point, target = self.task._at(q, dq), self.reference(t)
        F_z = self.task.tracking_acceleration(point.z, point.dz, target, self.kp, self.kd) - point.drift
        asked = self.law._acceleration_beside(t, q, dq, chart, point.J, F_z)
        ddq, D = chart._acceleration_and_basis(point.J, F_z, asked)
        rows, most = self._bands(self.reference, t, q, dq)
        return asked + _smallest(rows.dot(D), most - rows.dot(ddq))

    def joint_acceleration(self, t: float, q: JointVector, dq: JointVector, robot: Robot) -> JointVector | None:
        return self.law._joint_acceleration(t, q, dq, robot)

    def sampled_targets(self, t: float, period: float, step: float, r: int) -> SelfTargets:
        return Objective.sampled_targets(self, t, period, step, r)

    def target_on(self, t: float, chart: Chart) -> Target | None:
        return self.law.target_on(t, chart)

    def add_user(self, controller: Any) -> None:
        self.law.add_user(controller)

    def further(self, t: float, q: JointVector, change: JointVector) -> Further | None:
        return self.law._further(t, q, change)

    def check_start(self, t: float, q: JointVector, chart: Chart) -> None:
        self.law.check_start(t, q, chart)
        if chart.task.describe() != self.task.describe():
            raise InputError(f"the tolerance is that of {self.task!r}; the controller has {chart.task!r}")

    def joint_distances(self, t: Float[Array, " T"], q: Float[Array, "T n"], robot: Robot) -> Float[Array, " T"] | None:
        return self.law.joint_distances(t, q, robot)

    def check(self, n: int, r: int) -> None:
        self.law.check(n, r)


def _smallest(rows: Float[Array, "B r"], most: Float[Array, " B"]) -> SelfMotionVector:
    """The shortest x with rows · x ≤ most, by Lawson and Hanson's least distance programming.

    Where bands exclude each other, or cannot be moved, what is lacking has the price 1 / SLACK².
    """
    bands, r = rows.shape
    if (most >= 0.0).all():
        return np.zeros(r)
    E = np.vstack((-rows.T, SLACK * np.eye(bands), -most))
    f = np.append(np.zeros(r + bands), 1.0)
    residual = E.dot(nnls(E, f)[0]) - f
    return -residual[:r] / residual[-1]
