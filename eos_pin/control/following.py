"""Objectives that follow joints given over time, such as those of a plan, or a further task; and sums of laws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    SelfMotionVector,
    TaskVector,
    VectorLike,
    broadcast,
    by_value,
    checked,
    frozen_copy,
    gains,
    number,
    unchecked,
    vector,
    vectors_of,
)
from eos_pin.charts.chart import Chart
from eos_pin.control._sampled_law import SelfTargets, decay
from eos_pin.control.objectives import Damp, Further, Objective
from eos_pin.errors import InputError, PlanError
from eos_pin.planning.plans import Plan
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point, Task
from eos_pin.trajectories.base import Target, Trajectory
from eos_pin.trajectories.pace import Clock, PacedJoints, PacedPath

#: From so near joints are followed: from 24 random postures up to 0.8 rad away the law has always led back [rad or m].
WITHIN = 0.5
#: Largest difference of two times that are the same [s].
SAME_TIME = 1e-12
#: Where the self-motion moves a further task by less than this, it is moved with less force, down to none.
FADING = 0.02


class FollowJoints(Objective):
    """Follow joints q_d(t) that have the task's point at every time: F_v = Wᵀ(q̈_d + kd (q̇_d − q̇) + kp (q_d − q)).

    On every chart the error in v then obeys ε̈ + kd ε̇ + kp ε = 0, so that the joints follow from nearby, whichever
    charts are used. From another component of the self-motion manifold they do not: z and v come to rest without any
    error while the joints stay away. A start further away than `within` is therefore refused, runs report the distance,
    and `distance` is to be watched on a robot.

    Args:
        joints: Function of time [s] that returns q_d, its velocity and its acceleration.
        kp: Gain, one number or (n,) [1/s²].
        kd: Damping, one number or (n,) [1/s]; 2 √kp is critically damped.
        within: Largest difference of a joint at the start [rad or m].
    """

    @checked
    def __init__(
        self,
        joints: Callable[[float], tuple[JointVector, JointVector, JointVector]],
        *,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        within: float = WITHIN,
    ) -> None:
        self.joints, self.within = joints, within
        self.kp: JointVector
        self.kd: JointVector
        self.kp, self.kd = kp, kd  # type: ignore[assignment]
        self._last: tuple[float, tuple[JointVector, JointVector, JointVector]] | None = None

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "within":
            value = number(value, "the distance at the start", above=0.0)
        elif name in ("kp", "kd"):
            value = frozen_copy(gains(value, self._asked(0.0)[0].size, "a gain on joints"))
        elif name == "joints" and not callable(value):
            raise InputError(f"joints must be a function of time, got {value!r}")
        super().__setattr__(name, value)

    @checked
    def at(self, t: float) -> tuple[JointVector, JointVector, JointVector]:
        """Joints, velocities and accelerations at time t; that of the last call is kept."""
        last = self._last
        if last is None or not abs(last[0] - t) <= SAME_TIME:
            last = self._last = t, self._asked(t)
        return last[1]

    _at = unchecked(at)

    def _asked(self, t: float) -> tuple[JointVector, JointVector, JointVector]:
        size = self.kp.size if "kp" in vars(self) else None
        q, dq, ddq = vectors_of("joints to follow", 3, size, self.joints, t)
        return q, dq, ddq

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        return chart._dv(self._joint_acceleration(t, q, dq, chart.task.robot))

    @checked
    def joint_acceleration(self, t: float, q: JointVector, dq: JointVector, robot: Robot) -> JointVector:
        q_d, dq_d, ddq_d = self._at(t)
        return ddq_d + self.kd * (dq_d - dq) + self.kp * robot._way(q, q_d)

    _joint_acceleration = unchecked(joint_acceleration)

    def sampled_targets(self, t: float, period: float, step: float, r: int) -> SelfTargets:
        (now, velocity, _), (ahead, _, _) = self._at(t), self._at(t + step)
        factors = decay(self.kp, self.kd, period)
        return SelfTargets(self.joints, period, now, ahead, now - step * velocity, factors, joints=True)

    def target_on(self, t: float, chart: Chart) -> Target:
        q_d, dq_d, ddq_d = self._at(t)
        return Target(chart._v(q_d), chart._dv(dq_d), chart._dv(ddq_d))

    @checked
    def distance(self, t: float, q: JointVector, robot: Robot | None = None) -> float:
        """Largest difference of a joint from where it should be [rad or m].

        Args:
            t: Time [s].
            q: Joints, (n,).
            robot: The robot; full turns of its continuous joints do not count.
        """
        wanted = self._at(t)[0]
        q = vector(q, wanted.size, "q")
        return float(abs(wanted - q if robot is None else robot._way(q, wanted)).max())

    def joint_distances(self, t: Float[Array, " T"], q: Float[Array, "T n"], robot: Robot) -> Float[Array, " T"]:
        if len(t) != len(q):
            raise InputError(f"joints are needed for each of {len(t)} times, got {len(q)} rows")
        return np.array([self.distance(float(s), row, robot) for s, row in zip(t, q, strict=True)])

    def check_start(self, t: float, q: JointVector, chart: Chart) -> None:
        away = self.distance(t, q, chart.task.robot)
        if away > self.within:
            raise PlanError(
                f"the joints are {away:.3g} rad or m away from those to follow; up to {self.within:g} the law leads "
                "there; from further away the robot may stop on another component of the self-motion. Join them first "
                "with journey(plan, q), or allow more with `within`"
            )

    def check(self, n: int, r: int) -> None:
        if self.kp.size != n:
            raise InputError(f"the joints to follow are {self.kp.size}, the robot has {n}")


class FollowPlan(FollowJoints):
    """Follow a plan, at its own pace or that of a clock.

    Args:
        plan: The plan.
        robot: The robot that is controlled; it must be the one of the plan.
        clock: Pace; see `Clock`.
        kp: Gain, one number or (n,) [1/s²].
        kd: Damping, one number or (n,) [1/s].
        within: Largest difference of a joint at the start [rad or m].

    Raises:
        PlanError: The plan is for another robot, tool or payload, or its joints jump.
    """

    @checked
    def __init__(
        self,
        plan: Plan,
        robot: Robot | None = None,
        *,
        clock: Clock | None = None,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
        within: float = WITHIN,
    ) -> None:
        plan.check_continuous()
        if robot is not None:
            plan.check(robot)
        self.plan = plan
        #: Path of the task at the same pace: the reference of the controller.
        self.path: Trajectory = PacedPath(plan.path, clock) if clock else plan.path
        super().__init__(PacedJoints(plan, clock) if clock else plan, kp=kp, kd=kd, within=within)

    def check_start(self, t: float, q: JointVector, chart: Chart) -> None:
        task = chart.task
        if task.robot is not self.plan.robot:
            self.plan.check(task.robot)
        if task.describe() != self.plan.task.describe():
            raise PlanError(f"the plan is for the task {self.plan.task!r}; the controller has {task!r}")
        super().check_start(t, q, chart)


@by_value
@checked
@dataclass(frozen=True, eq=False)
class TrackTask(Objective):
    """Track a further task by the self-motion, such as the roll of a tool whose axis is the task.

    The further error obeys ε̈ + kd ε̇ + kp ε = 0 in all directions in which the self-motion can move it, whatever the
    task does meanwhile and whichever charts are used: F_v = F_rest + P⁺(F_2 − drift_2 − J_2 ddq), where P = J_2 D and
    ddq is that of the task and of `rest`. In the directions left over the law is `rest`. Where a direction fades, it is
    given up by degrees. Limits of joints and bands of tolerances come before it: where they take it, runs say so.

    The roll of a tool about its axis is tracked by an `OrientationTask` beside a `PointAxisTask`: of the rotation only
    the turn about the axis is free.

    Attributes:
        task: The further task, of the same robot.
        reference: Its trajectory.
        kp: Gain on its error, one number or one for each coordinate [1/s²].
        kd: Gain on its velocity error, likewise [1/s]; 2 √kp is critically damped.
        rest: Law of the self-motion that the further task leaves free.
    """

    task: Task
    reference: Trajectory
    kp: float | VectorLike = 100.0
    kd: float | VectorLike = 20.0
    rest: Objective = Damp()  # noqa: RUF009

    def __post_init__(self) -> None:
        self._gains  # noqa: B018

    @cached_property
    def _gains(self) -> tuple[Array, Array]:
        """Both gains, one number for each coordinate."""
        kp, kd = (
            frozen_copy(broadcast(gain, self.task.m, f"the gain {name} on the further task"))
            for name, gain in (("kp", self.kp), ("kd", self.kd))
        )
        return kp, kd

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        point = chart.task._at(q, dq)
        return self._acceleration_beside(t, q, dq, chart, point.J, -point.drift)

    @checked
    def acceleration_beside(
        self, t: float, q: JointVector, dq: JointVector, chart: Chart, J: Jacobian, task: TaskVector
    ) -> SelfMotionVector:
        self.task._set_time(t)
        z, J_2, dz, drift = self.task._at(q, dq)
        asked = self.task._tracking_acceleration(z, dz, self.reference(t), *self._gains) - drift
        return self._beside(chart, J, task, J_2, asked, self.rest._acceleration_beside(t, q, dq, chart, J, task))

    _acceleration_beside = unchecked(acceleration_beside)

    def _beside(
        self, chart: Chart, J: Jacobian, task: TaskVector, J_2: Jacobian, asked: TaskVector, rest: SelfMotionVector
    ) -> SelfMotionVector:
        """F_v that moves the further task as asked, its drift left out, beside the task and as far as it allows."""
        ddq, D = chart._acceleration_and_basis(J, task, rest)
        left, sizes, right = np.linalg.svd(J_2.dot(D), full_matrices=False)
        lacking = left.T.dot(asked - J_2.dot(ddq))
        return rest + right.T.dot(lacking * sizes / np.maximum(sizes, FADING) ** 2)

    def sampled_targets(self, t: float, period: float, step: float, r: int) -> SelfTargets:
        at, ahead = self.reference(t), self.reference(t + step)
        rest = self.rest._sampled_targets(t, period, step, r)
        before = self.task._plus(at.z, -step * at.dz)
        factors = decay(*self._gains, period)
        return FurtherTargets(self, period, (at.z, rest), ahead.z, (before, None), factors, rest=rest, t=t, step=step)

    def further(self, t: float, q: JointVector, change: JointVector) -> Further:
        z, J = self.task._set_time(t)._linearize(q)
        return Further(self.task, self.task._minus(self.reference(t).z, z), -J.dot(change))

    def check_start(self, t: float, q: JointVector, chart: Chart) -> None:
        self.rest.check_start(t, q, chart)

    def check(self, n: int, r: int) -> None:
        if self.task.robot.n != n:
            raise InputError(f"the further task is that of a robot with {self.task.robot.n} joints, this one has {n}")
        self.rest._check(n, r)


@dataclass(frozen=True, eq=False)
class FurtherTargets(SelfTargets):
    """Targets of a `TrackTask` around one step: points of the further task, and the targets of the law beside it.

    Attributes:
        rest: Targets of the law beside it.
        t: Time of the path [s].
        step: Time of the path that goes by in a period [s].
        goal: Point of the further task at the end of the period; None before it is known.
    """

    rest: SelfTargets | None = None
    t: float = 0.0
    step: float = 0.0
    goal: Point | None = None

    def placed(self, q: JointVector, u: JointVector, before: Any) -> FurtherTargets:
        task, (a1, a2) = self.of.task, self.factors
        z_before = (before or self.before)[0]
        # Where the task itself moves, each point is that of its time.
        earlier = task._set_time(self.t - self.step)._value(q - self.period * u)
        error = a1 * task._minus(task._set_time(self.t)._value(q), self.now[0]) - a2 * task._minus(earlier, z_before)
        return replace(self, goal=task._plus(self.ahead, error))

    def acceleration(
        self, t: float, robot: Robot, chart: Chart, q: JointVector, u: JointVector, before: Any,
        J: Jacobian | None = None, asked: TaskVector | None = None,
    ) -> SelfMotionVector:  # fmt: skip
        assert self.rest is not None
        assert J is not None
        assert asked is not None
        last = before and before[1]
        known = last is not None and last.of is self.rest.of
        rest = self.rest.acceleration(t, robot, chart, q, u, last.now if known else None, J, asked)
        return self._led(chart, J, asked, q + self.period * u, rest, self.period**2)

    def lacking(self, chart: Chart, J: Jacobian, q: JointVector, left: TaskVector) -> SelfMotionVector:
        return self._led(chart, J, left, q, np.zeros(chart.r), 1.0)

    def _led(
        self, chart: Chart, J: Jacobian, asked: TaskVector, q: JointVector, rest: SelfMotionVector, square: float
    ) -> SelfMotionVector:
        z, J_2 = self.of.task._set_time(self.t + self.step)._linearize(q)
        return self.of._beside(chart, J, asked, J_2, self.of.task._minus(self.goal, z) / square, rest)


class SumObjective(Objective):
    """Sum of several objectives.

    Args:
        parts: The objectives.
    """

    @checked
    def __init__(self, parts: Sequence[Objective]) -> None:
        if not parts:
            raise InputError("SumObjective needs at least one objective; Damp(0.0) leaves the self-motion alone")
        self._parts = tuple(parts)

    parts = property(lambda self: self._parts, doc="The objectives.")

    @property
    def independent(self) -> bool:  # type: ignore[override]
        """Whether F_v is the same beside any motion of the task."""
        return all(part.independent for part in self.parts)

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        return np.sum([part._acceleration(t, q, dq, chart) for part in self.parts], axis=0)

    def acceleration_beside(
        self, t: float, q: JointVector, dq: JointVector, chart: Chart, J: Jacobian, task: TaskVector
    ) -> SelfMotionVector:
        return np.sum([part._acceleration_beside(t, q, dq, chart, J, task) for part in self.parts], axis=0)

    def further(self, t: float, q: JointVector, change: JointVector) -> Further | None:
        found = (part._further(t, q, change) for part in self.parts)
        return next((further for further in found if further is not None), None)

    def target(self, t: float, r: int) -> Target | None:
        return next((target for part in self.parts if (target := part._target(t, r)) is not None), None)

    def target_on(self, t: float, chart: Chart) -> Target | None:
        return next((target for part in self.parts if (target := part._target_on(t, chart)) is not None), None)

    def joint_acceleration(self, t: float, q: JointVector, dq: JointVector, robot: Robot) -> JointVector | None:
        found = (part._joint_acceleration(t, q, dq, robot) for part in self.parts)
        return next((a for a in found if a is not None), None)

    def check_start(self, t: float, q: JointVector, chart: Chart) -> None:
        for part in self.parts:
            part.check_start(t, q, chart)

    def joint_distances(self, t: Float[Array, " T"], q: Float[Array, "T n"], robot: Robot) -> Float[Array, " T"] | None:
        found = (part.joint_distances(t, q, robot) for part in self.parts)
        return next((apart for apart in found if apart is not None), None)

    def check(self, n: int, r: int) -> None:
        for part in self.parts:
            part._check(n, r)
