"""The self-motion manifold {q: G(q) = z}: all postures of a robot at one task point."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float, Int

from eos_pin._arrays import (
    Array,
    JointVector,
    Vector,
    VectorLike,
    as_floats,
    checked,
    frozen_copy,
    listed,
    number_of,
    pair,
    vector,
)
from eos_pin._kernels.kinematics import Kinematics
from eos_pin.errors import InputError, SingularError, refuse_unused
from eos_pin.planning.manifolds.arcs import Arc, arc_joints, arcs_within, clear_arcs
from eos_pin.planning.manifolds.components import Component
from eos_pin.planning.manifolds.covering import Covering, covering, descended, scattered
from eos_pin.tasks.base import Point, PointLike, Task

#: Whether a robot collides at joints.
Collision = Callable[[JointVector], bool]
#: Starts of one round of the search for components.
ROUND = 100
#: The search goes on while a component was met less often than this.
OFTEN = 3
#: Postures of each component that are turned over in search of others.
SIDES = 8
#: Task error of what is handed out [m, rad].
TOLERANCE = 1e-10
#: Points of an arc among which the best for a criterion is looked for, for each unit of arc length.
DENSITY = 20
#: Best postures of a covering from which the best of all is looked for.
BEST = 3


@dataclass(frozen=True, eq=False)
class SelfMotionManifold:
    """All postures of a robot at one task point, made by `self_motion_manifold`.

    Attributes:
        task: The task.
        z: The task point.
        lower: Least value of each joint, (n,).
        upper: Largest value of each joint, (n,).
        components: With one redundant joint: the connected curves it consists of, whatever the limits are.
        arcs: With one redundant joint: the pieces of the components on which joints are within limits and clear of
            collision.
        covering: With more redundant joints: postures that cover what is within limits, and their neighbours.
        solved: Random starts that led to the task point.
        since_new: How many of them, the last ones, have led to what was known already.
        hits: How many led to each component.
        collision: Whether the robot collides at joints; None where that does not count.
    """

    task: Task
    z: Point
    lower: JointVector
    upper: JointVector
    components: tuple[Component, ...]
    arcs: tuple[Arc, ...]
    covering: Covering | None
    solved: int
    since_new: int
    hits: tuple[int, ...]
    collision: Collision | None

    @property
    def r(self) -> int:
        """Dimension."""
        return self.task.robot.n - self.task.m

    @property
    def empty(self) -> bool:
        """Whether no posture within limits and clear of collision was found."""
        return not (self.arcs or (self.covering is not None and len(self.covering.q)))

    @checked
    def missed(self, share: float) -> float:
        """Probability that a component was missed to which the given share of random starts leads."""
        if not 0.0 < share <= 1.0:
            raise InputError(f"the share must be above 0 and at most 1, got {share!r}")
        return (1.0 - share) ** self.since_new

    # -- postures ----------------------------------------------------------------------------------------------------

    @checked
    def joints(self, arc: Arc, s: VectorLike) -> Float[Array, "K n"]:
        """Joints of an arc at arc lengths, within limits."""
        return self._exact(arc_joints(self.components[arc.component], arc, vector(s, None, "s")))

    @checked
    def sampled(self, spacing: float) -> tuple[Float[Array, "K n"], ...]:
        """Joints of each arc at even distances, both ends included, no further apart than `spacing`."""
        return tuple(
            self.joints(arc, np.linspace(arc.start, arc.end, max(2, math.ceil(arc.length / spacing) + 1)))
            for arc in self.arcs
        )

    @checked
    def random(self, count: int, seed: int = 0) -> Float[Array, "count n"]:
        """Postures within limits and clear of collision, drawn evenly by arc length or about those of the covering.

        Raises:
            InputError: There is none.
        """
        self._need_one()
        random = np.random.default_rng(seed)
        if self.covering is not None:
            limits = self.lower, self.upper
            return scattered(self.covering, self.z, count, limits, self.collision, random)
        lengths = np.array([arc.length for arc in self.arcs])
        chosen = random.choice(len(self.arcs), size=count, p=lengths / lengths.sum())
        places = random.random(count)
        postures = np.empty((count, self.task.robot.n))
        for i, arc in enumerate(self.arcs):
            own = chosen == i
            postures[own] = self.joints(arc, arc.start + places[own] * arc.length)
        return postures

    @checked
    def nearest(self, q: VectorLike) -> JointVector:
        """Posture within limits and clear of collision that is nearest to joints, as the robot would move.

        Raises:
            InputError: There is none, or q has the wrong length.
        """
        goal = vector(q, self.task.robot.n, "q")
        return self.best(lambda x: float((x - goal) @ (x - goal)))

    @checked
    def best(self, criterion: Callable[[JointVector], float]) -> JointVector:
        """Posture within limits and clear of collision at which a criterion is least.

        Looked for on all arcs, or from the best postures of the covering, and between nodes, too.

        Raises:
            InputError: There is none.
        """
        self._need_one()
        criterion = partial(number_of, "the criterion", criterion)
        found: list[tuple[float, JointVector]] = []
        if self.covering is not None:
            best = np.argsort([criterion(q) for q in self.covering.q], kind="stable")[:BEST]
            rest = self.z, criterion, (self.lower, self.upper), self.collision
            found += [descended(self.covering, q, *rest) for q in self.covering.q[best]]
        for arc in self.arcs:
            s = np.linspace(arc.start, arc.end, max(3, math.ceil(DENSITY * arc.length)))
            values = np.array([criterion(q) for q in self.joints(arc, s)])
            i = int(values.argmin())
            span = (s[max(i - 1, 0)], s[min(i + 1, len(s) - 1)])
            found.append(self._least(arc, criterion, span, s[i]))
        return min(found, key=lambda pair: pair[0])[1]

    def _least(
        self, arc: Arc, criterion: Callable[[JointVector], float], span: tuple[float, float], start: float
    ) -> tuple[float, JointVector]:
        """Least value of a criterion on a piece of an arc, by golden sections, and where it is."""
        ratio = 0.5 * (math.sqrt(5.0) - 1.0)

        def value(s: float) -> tuple[float, JointVector]:
            q = self.joints(arc, np.array([s]))[0]
            return criterion(q), q

        best = value(start)
        low, high = span
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        at_a, at_b = value(a), value(b)
        while high - low > 1e-7:
            if at_a[0] < at_b[0]:
                high, b, at_b = b, a, at_a
                a = high - ratio * (high - low)
                at_a = value(a)
            else:
                low, a, at_a = a, b, at_b
                b = low + ratio * (high - low)
                at_b = value(b)
        return min((best, at_a, at_b), key=lambda pair: pair[0])

    def _exact(self, Q: Float[Array, "K n"]) -> Float[Array, "K n"]:
        """Postures of arcs, put inside the limits where rounding led beyond them."""
        found = self._kinematics.project(Q, self.z, lower=self.lower, upper=self.upper, tol=TOLERANCE)
        return found.q

    @property
    def _kinematics(self) -> Kinematics:
        return self.task.kinematics

    @cached_property
    def reasons(self) -> tuple[str, ...]:
        """Causes that cut the components' arcs short, most frequent first."""
        causes = [cause for arc in self.arcs for cause in arc.causes if cause]
        return tuple(sorted(set(causes), key=lambda cause: (-causes.count(cause), cause)))

    def _need_one(self) -> None:
        if self.empty:
            raise InputError(
                f"no posture of {self.task!r} within limits and clear of collision was found at this task point "
                f"({self.solved} random starts led there, to {len(self.components)} components)"
            )


@checked
def self_motion_manifold(
    task: Task,
    z: PointLike,
    *,
    limits: tuple[VectorLike, VectorLike] | None = None,
    collision: Collision | None = None,
    starts: Sequence[VectorLike] | Float[Array, "K n"] = (),
    seeds: int = 150,
    tries: int = 1000,
    seed: int = 0,
    step: float = 0.1,
    resolution: float = 0.5,
    most: int = 2000,
) -> SelfMotionManifold:
    """All postures of a robot at one task point.

    With one redundant joint random postures lead to the components, and each is traced whole. With more, postures
    within limits are spread over the manifold from chart to chart.

    Args:
        task: The task, with fewer coordinates than the robot has joints.
        z: Task point, in any form that `Task.point` takes.
        limits: Least and largest value of each joint; by default those of the robot.
        collision: Whether the robot collides at joints.
        starts: Postures to begin from, before random ones.
        seeds: The search for components ends after so many random starts in a row have led to what is known, and each
            component was met three times.
        tries: It ends at the latest after so many random starts.
        seed: Which these are; the same seed, the same manifold.
        step: Largest step of one joint from node to node of a component [rad or m].
        resolution: Distance of neighbouring postures of a covering [rad or m].
        most: Most postures of a covering.

    Raises:
        InputError: Wrong shapes, limits without room, a robot without redundancy for the task, or an argument that
            is for another redundancy.
    """
    robot, z = task.robot, task.point(z)
    if task.m >= robot.n:
        raise InputError(
            f"{robot.name!r} has {robot.n} joints and {task!r} {task.m} coordinates: it has no self-motion; choose a "
            "smaller task"
        )
    lower, upper = (
        (robot.lower, robot.upper) if limits is None else (_bound(bound, robot.n) for bound in pair(limits, "limits"))
    )
    if not (lower <= upper).all():
        names = [joint.name for joint, a, b in zip(robot.joints, lower, upper, strict=True) if not a <= b]
        raise InputError(f"the limits of {', '.join(names)} leave no room: the least value is above the largest")
    if seeds < 1 or tries < 1 or most < 1 or not 0.0 < step <= 1.0 or not resolution > 0.0:
        raise InputError(
            "seeds, tries and most must be at least 1, step above 0 and at most 1, and resolution above 0; got "
            f"{seeds}, {tries}, {most}, {step} and {resolution}"
        )
    if robot.n - task.m > 1:
        reason = "more than one joint is redundant: postures cover the manifold, nothing is traced"
        refuse_unused(self_motion_manifold, reason, step=step)
    else:
        reason = "one joint is redundant: components are traced whole, none is covered"
        refuse_unused(self_motion_manifold, reason, resolution=resolution)
    given = np.reshape([vector(q, robot.n, "a start") for q in listed(starts, "starts")], (-1, robot.n))
    search = _Search(task, z, lower, upper, given, seed)
    if robot.n - task.m > 1:
        found = search.within(min(seeds, tries))
        cover = covering(task, z, found, (lower, upper), collision, resolution, most)
        return SelfMotionManifold(task, z, lower, upper, (), (), cover, len(found), 0, (), collision)
    components, hits, solved, since_new = search.components(seeds, tries, step)
    arcs = [arc for i, component in enumerate(components) for arc in arcs_within(component, i, lower, upper)]
    if collision is not None:
        arcs = [piece for arc in arcs for piece in clear_arcs(components[arc.component], arc, collision)]
    return SelfMotionManifold(
        task, z, lower, upper, tuple(components), tuple(arcs), None, solved, since_new, tuple(hits), collision
    )


class _Search:
    """Random starts that lead to a task point."""

    def __init__(
        self, task: Task, z: Vector, lower: JointVector, upper: JointVector, given: Float[Array, "K n"], seed: int
    ) -> None:
        self.kinematics, self.z, self.given = task.kinematics, z, given
        self.random = np.random.default_rng(seed)
        self.lower, self.upper = lower, upper
        revolute, reach = self.kinematics.revolute, task.robot.reach
        # All components are looked for, so joints that turn start anywhere, those that slide within their limits.
        self.least = np.where(revolute, -np.pi, np.where(np.isfinite(lower), lower, -reach))
        self.most = np.where(revolute, np.pi, np.where(np.isfinite(upper), upper, reach))

    def components(self, seeds: int, tries: int, step: float) -> tuple[list[Component], list[int], int, int]:
        """The components, starts that led to each, those that led to the task point, and those since the last find."""
        components: list[Component] = []
        hits: list[int] = []
        solved = since_new = tried = turned = 0
        # Where one was met only once or twice, another one as rare may well be missing.
        while tried < tries and (since_new < seeds or min(hits, default=OFTEN) < OFTEN):
            count = min(ROUND, tries - tried)
            starts = self.random.uniform(self.least, self.most, (count, len(self.least)))
            if not tried:
                starts = np.concatenate((self.given, starts))
            tried += count
            known = len(components)
            numbers = self._lead(starts, components, step)
            solved += len(numbers)
            hits = [*hits, *[0] * (len(components) - known)]
            for number in numbers:
                hits[number] += 1
            # Starts after the one that met a component first.
            firsts = [int(np.argmax(numbers == number)) for number in range(known, len(components))]
            since_new = len(numbers) - 1 - max(firsts) if firsts else since_new + len(numbers)
            while turned < len(components):
                # Each turned component may be new, and is turned as well.
                known = len(components)
                self._lead(self._turned(components[turned]), components, step)
                turned += 1
                if len(components) > known:
                    hits += [0] * (len(components) - len(hits))
                    since_new = 0
        return components, hits, solved, since_new

    def _lead(self, starts: Float[Array, "K n"], components: list[Component], step: float) -> Int[Array, " L"]:
        """Number of the component that each start leads to, without those that lead nowhere; new ones are traced."""
        # The nodes of what is traced are checked.
        found = self.kinematics.project(starts, self.z, tol=1e-11, checked=False)
        Q = found.q[found.found]
        T, _ = self.kinematics.tangents(Q, self.z)
        numbers = np.full(len(Q), -1, dtype=np.int64)
        for i, component in enumerate(components):
            numbers[component.passes(Q, T) & (numbers < 0)] = i
        for k, q in enumerate(Q):
            if numbers[k] >= 0:
                continue
            try:
                curve = self.kinematics.trace(self._wrapped(q), z=self.z, step=step)
            except SingularError:
                continue
            if len(curve.q) < 2:
                continue
            components.append(Component(self.kinematics, frozen_copy(self.z), curve))
            own = components[-1].passes(Q[k:], T[k:]) & (numbers[k:] < 0)
            own[0] = True
            numbers[k:][own] = len(components) - 1
        return numbers[numbers >= 0]

    def _turned(self, component: Component) -> Float[Array, "K n"]:
        """Postures of a component with three joints in a row the other way round, as a wrist has two sides.

        Where the three axes meet at right angles the tip stays where it is; elsewhere the search has little left to do.
        Small components, which random starts rarely meet, have others like them there.
        """
        Q = component.at(component.length * np.arange(SIDES) / SIDES)
        turned = np.repeat(Q[:, None], max(0, Q.shape[1] - 2), axis=1)
        for j in range(turned.shape[1]):
            if self.kinematics.revolute[j : j + 3].all():
                turned[:, j, j] += np.pi
                turned[:, j, j + 1] *= -1.0
                turned[:, j, j + 2] += np.pi
        return turned.reshape(-1, Q.shape[1])

    def within(self, tries: int) -> Float[Array, "K n"]:
        """Postures at the task point within limits."""
        least, most = (np.clip(end, self.lower, self.upper) for end in (self.least, self.most))
        starts = np.concatenate((self.given, self.random.uniform(least, most, (tries, len(least)))))
        found = self.kinematics.project(starts, self.z, lower=self.lower, upper=self.upper, tol=TOLERANCE)
        return found.q[found.found]

    def _wrapped(self, q: JointVector) -> JointVector:
        """Joints with each revolute one within half a turn of zero."""
        return np.where(self.kinematics.revolute, np.remainder(q + np.pi, 2.0 * np.pi) - np.pi, q)


def _bound(values: VectorLike, n: int) -> JointVector:
    """Limits, which may be infinite."""
    array = as_floats(values, "limits")
    if array.shape != (n,) or np.isnan(array).any():
        raise InputError(f"limits must be two vectors of {n} numbers, ±inf for none; got shape {array.shape}")
    return frozen_copy(array)
