"""The problem that a plan solves: allowed joints at task points, allowed steps between them, and their cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from eos_pin._arrays import (
    Array,
    VectorLike,
    as_floats,
    broadcast,
    frozen_copy,
    number,
    pair,
    vector,
)
from eos_pin.errors import InputError
from eos_pin.planning.costs import Cost, PostureCost, costs_of
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.planning.obstacles.scene import Scene
from eos_pin.tasks.base import Task
from eos_pin.tasks.batch import Manifold

TAU = 2.0 * np.pi
#: Part of a band that is planned with: between points of the path the rest is used.
BANDS = 0.98


class Bar(NamedTuple):
    """Causes that exclude postures.

    Attributes:
        reason: The reason in words.
        postures: How many of the postures.
        joint: Number of the joint whose limit it is, if any.
        below: Whether it is the lower limit.
        solid: Name of the solid that is too close, if any.
    """

    reason: str
    postures: int
    joint: int | None = None
    below: bool = False
    solid: str = ""


@dataclass(frozen=True, eq=False)
class Problem:
    """Constraints and cost of a plan.

    Attributes:
        manifold: The task's manifolds.
        lower: Least joints, margin included; −inf without limit.
        upper: Largest joints.
        clearances: Distances that count; None without.
        gap: Least distance that is allowed [m].
        weights: Weight of each joint's motion in the cost, (n,).
        posture_cost: Cost of being at a posture, per unit of time; None without.
        winding: Whether joints without limits may end a closed path whole turns away from where they began.
        sag: Part of the reach that a chord of a radian may sag into an obstacle halfway between allowed postures.
    """

    manifold: Manifold
    lower: Array
    upper: Array
    clearances: Clearances | None
    gap: float
    weights: Array
    posture_cost: PostureCost | None = None
    winding: bool = False
    sag: float = 0.25

    @cached_property
    def bands(self) -> Task | None:
        """The task, if it has bands to be kept."""
        task = self.manifold.task
        return task if task.bands else None

    @cached_property
    def whole(self) -> Manifold | None:
        """Manifolds of the task without its tolerance."""
        return Manifold(self.bands.whole) if self.bands is not None else None

    @property
    def r(self) -> int:
        """Degree of redundancy."""
        return self.manifold.n - self.manifold.m

    @cached_property
    def sampling(self) -> tuple[Array, Array]:
        """Bounds within which postures are drawn: the limits, or a turn, or for a slide the robot's reach."""
        robot = self.manifold.robot
        far = np.array([robot.reach if joint.kind == "prismatic" else np.pi for joint in robot.joints])
        lower = np.where(np.isfinite(self.lower), self.lower, np.minimum(-far, self.upper - 2.0 * far))
        upper = np.where(np.isfinite(self.upper), self.upper, np.maximum(far, self.lower + 2.0 * far))
        # A joint that may turn more than once has the same postures a turn further; one turn in the middle is enough to
        # begin with, and continuations go on from there.
        turns = np.array([joint.kind != "prismatic" for joint in robot.joints]) & (upper - lower > 2.0 * np.pi)
        middle = np.clip(0.0, lower + np.pi, np.maximum(upper - np.pi, lower + np.pi))
        return np.where(turns, middle - np.pi, lower), np.where(turns, middle + np.pi, upper)

    @cached_property
    def scale(self) -> Array:
        """Motion of each joint that counts like a radian, (n,) [rad or m]."""
        robot = self.manifold.robot
        return np.array([0.3 * robot.reach if joint.kind == "prismatic" else 1.0 for joint in robot.joints])

    @cached_property
    def winds(self) -> Bool[Array, " n"]:
        """Joints that may wind."""
        free = np.isneginf(self.lower) & np.isposinf(self.upper)
        return free & np.array([self.winding and joint.kind != "prismatic" for joint in self.manifold.robot.joints])

    def again(self, q: Float[Array, "L n"]) -> Float[Array, " n"]:
        """Joints where a closed path begins again: those at its start, whole turns away where joints wind."""
        turns = np.round((q[-1] - q[0]) / TAU)
        return q[0] + TAU * np.where(self.winds, turns, 0.0)

    def inside(self, Q: Float[Array, "n K"]) -> Bool[Array, " K"]:
        """Whether postures are within the limits."""
        return np.logical_and(self.lower[:, None] <= Q, self.upper[:, None] >= Q).all(axis=0).reshape(-1)

    def used(self, Q: Float[Array, "n K"], Z: Float[Array, "size #K"]) -> Float[Array, "K B 2"]:
        """Parts of the bands that postures use at task points, `BANDS` of their widths counting as all of them."""
        if self.bands is None:
            return np.empty((Q.shape[1], 0, 2))
        return self.bands.used(self.bands.whole.kinematics.value(Q.T), Z.T) / BANDS

    def allowed(self, Q: Float[Array, "n K"], Z: Float[Array, "size #K"]) -> Bool[Array, " K"]:
        """Whether postures are within the limits, in the bands about task points, and clear of everything."""
        allowed = self.inside(Q)
        if self.bands is not None:
            allowed &= (np.square(self.used(Q, Z)).sum(axis=2) <= 1.0).all(axis=1)
        if self.clearances is not None and len(self.clearances) and allowed.any():
            allowed[allowed] = self.clearances(Q[:, allowed]) >= self.gap
        return allowed

    def clear_halfway(self, Q: Float[Array, "n K"], motion: Float[Array, "n K"]) -> Bool[Array, " K"]:
        """Whether postures halfway along motions are as clear as those at their ends, but for the sag of a chord.

        Args:
            Q: Postures halfway.
            motion: Motions whose ends are clear; a thin obstacle may lie between these.
        """
        if self.clearances is None or not len(self.clearances):
            return np.ones(Q.shape[1], bool)
        sag = self.sag * self.manifold.robot.reach * np.square(np.abs(motion / self.scale[:, None]).max(axis=0))
        return np.asarray(self.clearances(Q) >= self.gap - sag)

    def random(self, random: np.random.Generator, count: int) -> Float[Array, "n count"]:
        """Random postures within the bounds for sampling."""
        lower, upper = self.sampling
        return random.uniform(lower, upper, (count, lower.size)).T

    def solutions(self, Z: Float[Array, "size #K"], random: np.random.Generator) -> tuple[Array, Array]:
        """Postures at task points, searched for from random ones, and whether each was found and is allowed."""
        Q = self.random(random, Z.shape[1])
        if self.whole is not None:
            # From postures at the target itself: random ones are rarely within bands.
            Q, _ = self.whole.search(Q, Z, (self.lower, self.upper))
        Q, found = self.manifold.search(Q, Z, (self.lower, self.upper))
        found[found] = self.allowed(Q[:, found], Z[:, found])
        return Q, found

    def cost(self, Q: Float[Array, "n K"]) -> Float[Array, " K"]:
        """Cost of being at postures, per unit of time."""
        if self.posture_cost is None:
            return np.zeros(Q.shape[1])
        return np.asarray(self.posture_cost(Q.T), dtype=float)

    def bars(self, Q: Float[Array, "n K"], found: Bool[Array, " K"], z: Array) -> list[Bar]:
        """Causes that exclude postures at a task point, most frequent first: none found, limits, bands, distances."""
        robot, bars = self.manifold.robot, list[Bar]()

        def note(reason: str, count: int, joint: int | None = None, below: bool = False, solid: str = "") -> None:
            if count:
                bars.append(Bar(reason, count, joint, below, solid))

        note("a singularity of the task or the end of its reach", int((~found).sum()))
        Q = Q[:, found]
        below, above = self.lower[:, None] > Q, self.upper[:, None] < Q
        first = np.where((below | above).any(axis=0), (below | above).argmax(axis=0), -1)
        for j, joint in enumerate(robot.joints):
            note(f"the lower limit of {joint.name!r}", int(((first == j) & below[j]).sum()), j, True)
            note(f"the upper limit of {joint.name!r}", int(((first == j) & ~below[j]).sum()), j)
        Q = Q[:, first < 0]
        if self.bands is not None:
            over = np.square(self.used(Q, z[:, None])).sum(axis=2) > 1.0
            first = np.where(over.any(axis=1), over.argmax(axis=1), -1)
            for i, name in enumerate(self.bands.bands):
                note(f"the tolerance {name}", int((first == i).sum()))
            Q = Q[:, first < 0]
        if self.clearances is not None and len(self.clearances) and Q.shape[1]:
            distances = self.clearances.pairs(Q)
            worst = distances.argmin(axis=0)[distances.min(axis=0) < self.gap]
            for pair in np.unique(worst).tolist():
                a, b = self.clearances.names[pair]
                solid = b if b in self.clearances.scene.names else ""
                note(f"{a!r} too close to {b!r}", int((worst == pair).sum()), solid=solid)
        return sorted(bars, key=lambda bar: -bar.postures)


def told(bars: Sequence[Bar]) -> str:
    """Causes that exclude the postures, in words."""
    return ", ".join(f"{bar.postures} by {bar.reason}" for bar in bars) or "none"


def problem_of(
    manifold: Manifold,
    scene: Scene | None,
    bodies: Bodies | None,
    self_collision: bool,
    clearance: float,
    margin: float,
    limits: tuple[VectorLike, VectorLike] | None,
    cost: Cost | None,
    weights: float | VectorLike,
    reference: VectorLike | None = None,
    winding: bool = False,
) -> Problem:
    """Problem on a manifold; arguments as in `plan`.

    Raises:
        InputError: A joint has no room to move, the scene is empty, or a number is out of its range.
    """
    robot = manifold.robot
    room = number(margin, "the margin from joint limits", at_least=0.0)
    lower, upper = robot.lower, robot.upper
    if limits is not None:
        lower, upper = (as_floats(end, "limits") for end in pair(limits, "limits"))
        if lower.shape != (robot.n,) or upper.shape != (robot.n,):
            raise InputError(
                f"limits must be two rows of {robot.n} numbers, got shapes {lower.shape} and {upper.shape}"
            )
    # A joint without this much room moves within half of what it has.
    room_of = np.minimum(room, 0.25 * np.maximum(upper - lower, 0.0))
    for joint, least, most in zip(robot.joints, lower, upper, strict=True):
        if not least < most:
            raise InputError(f"joint {joint.name!r} has no room to move: its limits are {least:g} and {most:g}")
    weight = broadcast(weights, robot.n, "the weights of joints")
    if not (weight > 0.0).all():
        raise InputError(f"the weights of joints must be positive, got {weight.tolist()}")
    clearances = None
    if scene is not None and not len(scene):
        raise InputError("the scene is empty; leave it out where nothing is in the way")
    if scene is not None or self_collision:
        bodies = bodies or Bodies.fitted(robot)
        if not self_collision:
            bodies = Bodies(robot, bodies.capsules, ())
        clearances = Clearances(bodies, scene or Scene())
    gap = number(clearance, "the clearance", at_least=0.0)
    if clearances is None and (gap or bodies is not None):
        raise InputError(
            f"{'a clearance' if gap else 'bodies'} without a scene or self_collision: there is nothing to be clear of"
        )
    lower, upper = lower + room_of, upper - room_of
    middle = np.clip(0.0, lower, upper)
    if reference is not None:
        middle = vector(reference, robot.n, "the joints to begin at")
    costs = costs_of(cost, manifold, (lower, upper), clearances, middle)
    return Problem(manifold, lower, upper, clearances, gap, frozen_copy(weight * costs.weights), costs.posture, winding)


def given(q: VectorLike | None, task: Task, z: Array, name: str) -> Array | None:
    """Joints that are to be at a task point, moved there from nearby; None stays None.

    Raises:
        InputError: They are not there.
    """
    if q is None:
        return None
    joints = vector(q, task.robot.n, f"the joints at the {name}")
    error = float(np.abs(task.minus(z, task.value(joints))).max())
    if error > 1e-3:
        raise InputError(
            f"the joints at the {name} are {error:.3g} m or rad away from that point of the path; move there first, or "
            "plan from any joints"
        )
    found, good = Manifold(task).project(joints[:, None], z[:, None])
    return found[:, 0] if good[0] else joints
