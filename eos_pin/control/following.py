"""Objectives that follow joints given over time, such as those of a plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    SelfMotionVector,
    VectorLike,
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
from eos_pin.control.objectives import Objective
from eos_pin.errors import InputError, PlanError
from eos_pin.planning.plans import Plan
from eos_pin.robot.model import Robot
from eos_pin.trajectories.base import Target, Trajectory
from eos_pin.trajectories.pace import Clock, PacedJoints, PacedPath

#: From so near joints are followed: from 24 random postures up to 0.8 rad away the law has always led back [rad or m].
WITHIN = 0.5
#: Largest difference of two times that are the same [s].
SAME_TIME = 1e-12


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
