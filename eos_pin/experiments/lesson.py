"""One lesson on redundancy: a hand that stays where it is while the elbow moves, and an elbow without a command."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import JointVector, checked
from eos_pin.control.eos import EosController
from eos_pin.control.following import FollowJoints
from eos_pin.control.operational import BASELINES
from eos_pin.errors import InputError
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.planning.manifolds.arcs import Arc
from eos_pin.planning.manifolds.manifold import SelfMotionManifold, self_motion_manifold
from eos_pin.robot.model import Robot
from eos_pin.simulation._recorder import uninterrupted
from eos_pin.simulation.continuous import simulate
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Hold
from eos_pin.trajectories.spline import Spline, cubic_spline

#: Part of their velocity limits that the joints use while the elbow sweeps.
PACE = 0.7
#: Points of the sweep for each unit of arc length.
DENSITY = 40
#: Least number of rounds under traditional control.
ROUNDS = 4
#: What is left free at the ends of the loop, as a part of its length.
SPARE = 0.04


@dataclass(frozen=True, eq=False)
class Lesson:
    """Two runs of one robot, made by `lesson`.

    Attributes:
        task: The task.
        elbow: Joint whose origin moves furthest while the hand rests.
        held: The hand holds its point while the elbow sweeps, under EOS control.
        free: The hand goes round a circle under traditional control, with damping in the null space.
        complete: Whether the elbow went all the way round; otherwise from limit to limit.
    """

    task: Task
    elbow: str
    held: Result
    free: Result
    complete: bool

    @property
    def rounds(self) -> int:
        """Rounds of the circle."""
        return len(self.free.cycle_rows) - 1

    @cached_property
    def swept(self) -> float:
        """Length of the elbow's way while the hand rests [m]."""
        return float(np.linalg.norm(np.diff(_origins(self.task.robot, self.held.q, self.elbow), axis=0), axis=1).sum())

    @cached_property
    def strayed(self) -> float:
        """Largest distance of the hand from its point meanwhile [m]."""
        frame = self.task.robot.options["chain_to"]
        tips = np.array([self.task.robot.placement(q, frame).translation for q in self.held.q])
        return float(np.linalg.norm(tips - tips[0], axis=1).max())

    @cached_property
    def returned(self) -> float:
        """Largest difference of a joint between start and end of the sweep, whole turns left aside [rad or m]."""
        robot = self.task.robot
        return float(np.abs(robot._way(self.held.q[0], self.held.q[-1])).max())

    @cached_property
    def drifted(self) -> float:
        """Largest difference of a joint between start and end of all rounds under traditional control [rad or m]."""
        rows = self.free.cycle_rows
        return float(np.abs(self.task.robot._way(self.free.q[rows[0]], self.free.q[rows[-1]])).max())


@checked
def lesson(robot: Robot) -> Lesson:
    """Simulate both runs.

    Args:
        robot: A robot with one joint more than a pose or a position of its tip has coordinates.

    Raises:
        InputError: The robot has more or fewer joints, or no room to move its elbow.
    """
    task = _task(robot)
    q = rest_posture(task)
    manifold = self_motion_manifold(task, task.value(q), starts=[q])
    arc, s = _place(manifold, q)
    path = fitting_path(task, q, shape="circle")
    sweep = _sweep(manifold, arc, s, path.period)
    hold = EosController(task, Hold(task.value(q), task.m), FollowJoints(lambda t: _joints(sweep, t)))
    held = uninterrupted(simulate(robot, hold, q, duration=sweep.end))
    free = BASELINES["null-space-damping"](task, path, q)
    round_trip = uninterrupted(simulate(robot, free, q, duration=sweep.end))
    for run in (held, round_trip):
        if not run.ok:
            raise InputError(f"{robot.name!r} is no robot for this lesson: a run of it ended early, {run.message}")
    return Lesson(task, elbow_of(robot, held.q), held, round_trip, arc.closed)


def elbow_of(robot: Robot, Q: Float[np.ndarray, "K n"]) -> str:
    """Joint whose origin moves furthest in a motion."""
    ways = [np.ptp(_origins(robot, Q, joint), axis=0) for joint in robot.joint_names]
    return robot.joint_names[int(np.argmax(np.linalg.norm(ways, axis=1)))]


def _origins(robot: Robot, Q: Float[np.ndarray, "K n"], joint: str) -> Float[np.ndarray, "K 3"]:
    return np.array([robot.placement(q, joint).translation for q in Q])


def _task(robot: Robot) -> Task:
    """Pose or position of the tip, whichever leaves one joint over."""
    for kind in ("pose", "position"):
        try:
            task = make_task(robot, kind)
        except InputError:
            continue
        if robot.n - task.m == 1:
            return task
    raise InputError(
        "the lesson is for a robot with one joint more than its hand's pose or position has coordinates, such as panda "
        f"or xarm7; {robot.name!r} has {robot.n} joints. Try `eos-pin track {robot.name} --swing 0.5 --view`"
    )


def _place(manifold: SelfMotionManifold, q: JointVector) -> tuple[Arc, float]:
    """The arc that a posture is on, and the arc length there."""
    for arc in manifold.arcs:
        component = manifold.components[arc.component]
        at = component.locate(q)
        rounds = range(math.floor((arc.start - at.s) / component.length), math.ceil(arc.end / component.length) + 1)
        for s in (at.s + k * component.length for k in rounds):
            if arc.start <= s <= arc.end and np.abs(manifold.joints(arc, [s])[0] - q).max() < 1e-6:
                return arc, s
    raise InputError(f"the elbow of {manifold.task.robot.name!r} has no room to move at its start posture")


def _sweep(manifold: SelfMotionManifold, arc: Arc, s: float, period: float) -> Spline:
    """Joints over whole periods: once round a closed loop, else from the start to one limit, to the other and back."""
    spare = SPARE * arc.length
    ends = [s, s + arc.length] if arc.closed else [s, arc.end - spare, arc.start + spare, s]
    along, times = [np.array(ends[:1])], [np.zeros(1)]
    for start, end in pairwise(ends):
        # From rest to rest, with the least jerk.
        u = np.arange(1, max(2, math.ceil(DENSITY * abs(end - start))) + 1)
        u = u / u[-1]
        along.append(start + (end - start) * u**3 * (10.0 - 15.0 * u + 6.0 * u * u))
        times.append(times[-1][-1] + abs(end - start) * u)
    Q, t = manifold.joints(arc, np.concatenate(along)), np.concatenate(times)
    # As slow as the fastest joint needs to keep its pace.
    duration = t[-1] * float((np.abs(np.gradient(Q, t, axis=0)) / manifold.task.robot.velocity).max()) / PACE
    rounds = max(ROUNDS, math.ceil(duration / period))
    return cubic_spline(Q, t * (rounds * period / t[-1]), closed=False)


def _joints(sweep: Spline, t: float) -> tuple[JointVector, JointVector, JointVector]:
    target = sweep(t)
    return target.z, target.dz, target.ddz
