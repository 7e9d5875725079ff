"""Journeys to a plan from other joints: a motion along the manifold first, then the plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin._arrays import Array, JointVector, VectorLike, checked, vector
from eos_pin.control.following import FollowJoints
from eos_pin.errors import PlanError
from eos_pin.planning.grid import UNLIMITED
from eos_pin.planning.manifolds.passage import passage
from eos_pin.planning.planner import MARGIN
from eos_pin.planning.planner import plan as planned
from eos_pin.planning.plans import Plan
from eos_pin.planning.problem import problem_of
from eos_pin.tasks.batch import Manifold
from eos_pin.trajectories.base import JointTarget, Target, Trajectory
from eos_pin.trajectories.pace import Clock, PacedJoints, PacedPath
from eos_pin.trajectories.through import WaypointPath

#: A robot this near a plan is on it: the law brings it there [rad or m].
NEAR = 1e-3
#: Part of the velocity limits that joining uses, and its least time [s].
PACE, SHORTEST = 0.3, 1.0
#: Points of a motion of the task that joins, and distance from the start below which there is none [m, rad].
POINTS, THERE = 25, 1e-7


@dataclass(frozen=True)
class Ease:
    """From one place to another and at rest at both, with the least jerk.

    Attributes:
        start: Place at the start.
        length: Way.
        duration: Time it takes [s].
    """

    start: float
    length: float
    duration: float

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Place, speed and acceleration at time t."""
        x, T = min(max(t / self.duration, 0.0), 1.0), self.duration
        return (
            self.start + self.length * x**3 * (10.0 - 15.0 * x + 6.0 * x * x),
            self.length * 30.0 * (x * (1.0 - x)) ** 2 / T,
            self.length * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / T**2,
        )


@dataclass(frozen=True, eq=False)
class Journey:
    """A plan, and the motion that leads onto it.

    Attributes:
        plan: The plan.
        joining: Motion from where the robot stands to the start of the plan; None where it is there.
        seconds: Time until the plan begins [s].
        path: Path of the task: the way there, and then the path of the plan from its start.
        joints: Joints over time: the same.
        clock: Pace of the plan; it begins at rest where there is a way there.
    """

    plan: Plan
    joining: Plan | None
    seconds: float
    path: Trajectory
    joints: Callable[[float], JointTarget]
    clock: Clock

    def law(self, **gains: Any) -> FollowJoints:
        """Law of the self-motion that follows it; gains as for `FollowJoints`."""
        return FollowJoints(self.joints, **gains)


@checked
def journey(plan: Plan, q: VectorLike, **options: Any) -> Journey:
    """Way from joints onto a plan.

    The joints move along the self-motion manifold, with the task in place where it already is at the start of the plan,
    and otherwise along a straight line of the task.

    Args:
        plan: The plan.
        q: Where the robot stands, (n,).
        options: More for `plan`, such as the scene.

    Raises:
        PlanError: No motion leads there: the joints lie on another component of the manifold, or something is in the
            way. The task would follow the path all the same, but the joints would stay away from the plan.
    """
    plan.check_continuous()
    begin = plan(plan.start).q
    joints = plan.robot._unwrap(vector(q, plan.robot.n, "q"), begin)
    if np.abs(joints - begin).max() <= NEAR:
        clock = Clock(0.0, plan.start)
        return Journey(plan, None, 0.0, PacedPath(plan.path, clock), PacedJoints(plan, clock), clock)
    # A robot that stands near a limit may leave it from there.
    room = min(float(np.minimum(row - plan.robot.lower, plan.robot.upper - row).min()) for row in (joints, begin))
    options = {"margin": max(0.0, min(MARGIN, 0.99 * room)), **options}
    try:
        found = _led(plan, joints, begin, options)
    except PlanError as error:
        apart = float(np.abs(joints - begin).max())
        raise PlanError(
            f"the robot cannot join the plan from where it stands, {apart:.3g} rad or m away from its start: {error}",
            error.waypoint,
            error.reached,
        ) from error
    limit = np.where(np.isfinite(plan.robot.velocity), plan.robot.velocity, UNLIMITED)
    fastest = float((np.abs(np.diff(found.q, axis=0)) / np.diff(found.times)[:, None] / limit).max())
    length = found.end - found.start
    # The speed of a motion of least jerk is 15/8 of its mean at the middle.
    seconds = max(1.875 * fastest * length / PACE, SHORTEST)
    ease = Ease(found.start, length, seconds)
    clock = Clock(0.0, plan.start, 0.0)
    clock.set_speed(seconds, 1.0)
    first: tuple[Any, Any] = _paced(found, ease)
    second = PacedPath(plan.path, clock), PacedJoints(plan, clock)
    return Journey(
        plan, found, seconds, _Then(first[0], second[0], seconds), _after(first[1], second[1], seconds), clock
    )


def _led(plan: Plan, joints: JointVector, begin: JointVector, options: dict[str, Any]) -> Plan:
    """Motion from joints to the start of a plan: of the task first, then along the manifold with the task in place."""
    task = plan.task
    z0, z1 = task._value(joints), plan.path(plan.start).z
    way = task._minus(z1, z0)
    Z, Q = z0[None], joints[None]
    if np.abs(way).max() > THERE:
        parts = np.linspace(0.0, 1.0, POINTS)
        Z = np.array([task._plus(z0, part * way) for part in parts])
        line = WaypointPath(task, Z, parts)
        try:
            return planned(task, line, closed=False, start=joints, end=begin, keep_time=False, **options, effort=1)
        except PlanError:
            # The task may arrive on another part of the manifold than the plan, and the joints go on from there.
            Q = planned(task, line, closed=False, start=joints, keep_time=False, **options).at_waypoints()
    given = {"scene": None, "bodies": None, "self_collision": False, "clearance": 0.0, "limits": None} | options
    names = ("scene", "bodies", "self_collision", "clearance", "margin", "limits")
    kept: dict[str, Any] = {name: given[name] for name in names}
    problem = problem_of(Manifold(task), **kept, cost=None, weights=1.0)
    led = passage(problem, z1, Q[-1], begin, int(options.get("seed", 0)))
    if led.q is None:
        raise PlanError(led.reason)
    Z, Q = np.concatenate((Z, np.repeat(z1[None], len(led.q) - 1, axis=0))), np.concatenate((Q, led.q[1:]))
    line = WaypointPath(task, Z, np.linspace(0.0, 1.0, len(Z)))
    return planned(task, line, closed=False, start=joints, end=begin, guess=Q, keep_time=False, **options)


@dataclass(frozen=True)
class _Then(Trajectory):
    """One trajectory until a time, then another."""

    first: Callable[[float], Target]
    second: Callable[[float], Target]
    time: float

    def __call__(self, t: float) -> Target:
        return self.first(t) if t < self.time else self.second(t)


def _after(
    first: Callable[[float], JointTarget], second: Callable[[float], JointTarget], time: float
) -> Callable[[float], JointTarget]:
    return lambda t: first(t) if t < time else second(t)


def _paced(plan: Plan, ease: Ease) -> tuple[Callable[[float], Target], Callable[[float], JointTarget]]:
    def path(t: float) -> Target:
        s, ds, dds = ease(t)
        z, dz, ddz = plan.path(s)
        return Target(z, ds * dz, ds * ds * ddz + dds * dz)

    def joints(t: float) -> JointTarget:
        s, ds, dds = ease(t)
        q, dq, ddq = plan(s)
        return JointTarget(q, ds * dq, ds * ds * ddq + dds * dq)

    return path, joints


def distances(joints: Callable[[float], Any], t: Array, q: Array) -> Array:
    """Largest difference of a joint from where it should be, at each time of a run [rad or m]."""
    return np.array([float(np.abs(joints(float(s))[0] - row).max()) for s, row in zip(t, q, strict=True)])
