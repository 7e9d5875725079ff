"""Motions from one posture to another at one task point: along the arc, or through two trees that grow together."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin.errors import SingularError
from eos_pin.planning.courses import connected
from eos_pin.planning.manifolds.arcs import Arc, arc_joints, arcs_within, clear_arcs
from eos_pin.planning.manifolds.components import Component
from eos_pin.planning.problem import Problem

#: Longest step of a joint from one posture of a motion to the next [rad].
SPACING = 0.1
#: Step of a tree [rad], steps it takes towards the other in a row, and directions in which it grows at once.
STEP, WALK, DIRECTIONS = 0.3, 30, 24
#: Postures of both trees together at which they end.
MOST = 6000
#: Rounds in which a motion is shortened.
SHORTENED = 60
#: Distance below which two postures are one [rad or m].
SAME = 1e-6


class Passage(NamedTuple):
    """A motion at rest in the task, or the reason why there is none.

    Attributes:
        q: Joints from the first posture to the last, (K, n); None where no motion was found.
        reason: Cause of the end of the motion, in words.
        certain: Whether there is none: the arc was followed to both its ends.
    """

    q: Float[Array, "K n"] | None
    reason: str = ""
    certain: bool = False


def passage(problem: Problem, z: Vector, start: JointVector, end: JointVector, seed: int = 0) -> Passage:
    """Motion from one posture to another on the self-motion manifold, within limits and clear.

    With one redundant joint the arc through the first posture is followed to both its ends, so that the answer is
    exact. With more, trees of postures grow from both until they meet.

    Args:
        problem: The problem: limits and costs.
        z: The task point of both.
        start: The first posture, (n,).
        end: The last one, (n,).
        seed: Seed of the trees.
    """
    for q, name in ((start, "first"), (end, "last")):
        if not problem.allowed(q[:, None], z[:, None])[0]:
            return Passage(None, f"the {name} posture is not within the limits and clear")
    if problem.r == 1:
        return _along(problem, z, start, end)
    return _Trees(problem, z, start, end, seed).run()


# -- one redundant joint -----------------------------------------------------------------------------------------------


def _along(problem: Problem, z: Vector, start: JointVector, end: JointVector) -> Passage:
    kinematics = problem.manifold.task.kinematics
    # A trace begins more exactly on the manifold than joints that were measured or searched for.
    exact, found = problem.manifold.project(start[:, None], z[:, None], tol=1e-12)
    try:
        origin = exact[:, 0] if found[0] else start
        component = Component(kinematics, z, kinematics.trace(origin, z=z, step=SPACING))
    except SingularError:
        return Passage(None, "the task is singular at the first posture")
    arcs = arcs_within(component, 0, problem.lower, problem.upper)
    if problem.clearances is not None or problem.bands is not None:
        arcs = [
            piece
            for arc in arcs
            for piece in clear_arcs(component, arc, lambda q: not bool(problem.allowed(q[:, None], z[:, None])[0]))
        ]
    own = next(((arc, s) for arc in arcs if (s := _place(component, arc, start)) is not None), None)
    if own is None:
        return Passage(None, "the first posture is at the very end of an arc within the limits")
    arc, s = own
    there = _place(component, arc, end)
    if there is None:
        causes = " and at the ".join(dict.fromkeys(cause for cause in arc.causes if cause))
        other = component.locate(end).distance < SAME
        where = "another arc of the same component" if other else "another component"
        ends = "is closed" if arc.closed else f"ends at the {causes}" if causes else "is as short as a point"
        return Passage(None, f"the arc on which the robot stands {ends}; the start of the plan lies on {where}", True)
    if arc.closed and abs(there - s) > 0.5 * component.length and not component.winding.any():
        # The other way round is shorter.
        there -= math.copysign(component.length, there - s)
    count = max(2, math.ceil(abs(there - s) / SPACING) + 1)
    q = arc_joints(component, arc, np.linspace(s, there, count))
    return Passage(np.concatenate((start[None], q[1:-1], end[None])))


def _place(component: Component, arc: Arc, q: JointVector) -> float | None:
    """Arc length at which an arc has these joints, turns included; None where it has not."""
    at = component.locate(q)
    if at.distance > SAME:
        return None
    rounds: range = range(1)
    if component.closed:
        slack = 0 if not arc.closed else int(np.abs(q).max() / math.pi) + 2
        rounds = range(
            math.floor((arc.start - at.s) / component.length) - slack,
            math.ceil((arc.end - at.s) / component.length) + slack + 1,
        )
    for s in sorted((at.s + k * component.length for k in rounds), key=abs):
        inside = arc.closed or arc.start - SAME <= s <= arc.end + SAME
        if inside and np.abs(arc_joints(component, arc, np.array([s]))[0] - q).max() < 10.0 * SAME:
            return s if arc.closed else min(max(s, arc.start), arc.end)
    return None


# -- two or more -------------------------------------------------------------------------------------------------------


class _Tree:
    """Postures, each with the one it was reached from.

    Args:
        root: The first posture.
        most: Most postures.
    """

    def __init__(self, root: JointVector, most: int) -> None:
        self._q, self._parent = np.empty((most, root.size)), np.full(most, -1)
        self._q[0], self.count = root, 1

    @property
    def q(self) -> Float[Array, "K n"]:
        """The postures."""
        return self._q[: self.count]

    def add(self, Q: Float[Array, "n K"], parents: Array) -> Array:
        """Numbers of new postures."""
        k = min(Q.shape[1], len(self._q) - self.count)
        own = np.arange(self.count, self.count + k)
        self._q[own], self._parent[own] = Q.T[:k], parents[:k]
        self.count += k
        return own

    def nearest(self, Q: Float[Array, "n K"], scale: Array) -> Array:
        """Number of the posture nearest to each of Q."""
        apart = ((self.q[:, None] - Q.T[None]) / scale) ** 2
        return np.asarray(apart.sum(axis=2).argmin(axis=0))

    def branch(self, i: int) -> Float[Array, "K n"]:
        """Postures from the root to one."""
        rows = []
        while i >= 0:
            rows.append(i)
            i = int(self._parent[i])
        return self._q[rows[::-1]]


class _Trees:
    """Two trees that grow towards random postures and towards each other."""

    def __init__(self, problem: Problem, z: Vector, start: JointVector, end: JointVector, seed: int) -> None:
        self.problem, self.z, self.random = problem, z, np.random.default_rng(seed)
        self.trees = [_Tree(start, MOST), _Tree(end, MOST)]

    def run(self) -> Passage:
        """The motion, or the growth of the trees where there is none."""
        # On a manifold within the limits that is as small as a few steps the trees hardly grow.
        for i in range(MOST // 4):
            one, two = self.trees[i % 2], self.trees[1 - i % 2]
            met = self._met(one, two)
            if met is not None:
                way = np.concatenate((one.branch(met[0]), two.branch(met[1])[::-1]))
                return Passage(self._finished(way if i % 2 == 0 else way[::-1]))
            if one.count + two.count >= MOST:
                break
        return Passage(None, self._apart())

    def _apart(self) -> str:
        """Growth of the trees in words, and the joints that keep them apart."""
        one, two = (tree.q for tree in self.trees)
        words = (
            f"of {len(one)} postures reached from where the robot stands and {len(two)} from the start of the plan no "
            "two are connected"
        )
        for joint, a, b in zip(self.problem.manifold.robot.joints, one.T, two.T, strict=True):
            if a.min() > b.max() or b.min() > a.max():
                words += (
                    f"; {joint.name!r} goes from {a.min():.3g} to {a.max():.3g} there, and from {b.min():.3g} to "
                    f"{b.max():.3g} here"
                )
        return words

    def _met(self, one: _Tree, two: _Tree) -> tuple[int, int] | None:
        """Postures where both trees meet, after one grew in some directions and the other towards its new postures."""
        targets = self.problem.random(self.random, DIRECTIONS)
        # Some of the targets are postures of the other tree.
        targets[:, ::4] = two.q[self.random.integers(two.count, size=len(targets[0, ::4]))].T
        parents = one.nearest(targets, self.problem.scale)
        new, good, _ = self._stepped(one.q[parents].T, targets)
        if not good.any():
            return None
        mine = one.add(new[:, good], parents[good])
        goals = one.q[mine].T
        at = two.nearest(goals, self.problem.scale)
        for _ in range(WALK):
            new, good, arrived = self._stepped(two.q[at].T, goals)
            if (good & arrived).any():
                k = int((good & arrived).argmax())
                return int(mine[k]), int(at[k])
            if not good.any():
                return None
            own = two.add(new[:, good], at[good])
            mine, goals = mine[good][: len(own)], goals[:, good][:, : len(own)]
            at = own
            if not len(own):
                return None
        return None

    def _stepped(self, Q: Array, goals: Array) -> tuple[Array, Array, Array]:
        """Postures one step nearer to goals, whether they are connected, and whether the goal is that step away."""
        way = (goals - Q) / self.problem.scale[:, None]
        far = np.linalg.norm(way, axis=0)
        arrived = far <= STEP
        part = np.minimum(1.0, STEP / np.maximum(far, 1e-9))
        new, good = self.problem.manifold.project(Q + part * (goals - Q), self.z[:, None], iterations=8)
        moved = np.linalg.norm((new - Q) / self.problem.scale[:, None], axis=0)
        # What hardly moves is at its end, and what moves far has jumped.
        good &= (moved < 2.0 * STEP) & ((moved > 0.2 * STEP) | arrived)
        arrived &= np.abs(new - goals).max(axis=0) < SAME
        good[good] = self.problem.allowed(new[:, good], self.z[:, None])
        good[good] = connected(self.problem, Q[:, good], new[:, good], self.z)
        return new, good, arrived

    # -- a motion from a way through the trees -----------------------------------------------------------------------

    def _finished(self, way: Float[Array, "k n"]) -> Float[Array, "K n"]:
        """A way shortened where a straight piece serves, as postures close to each other."""
        way = self._dense(way, way[0], way[-1])
        for _ in range(SHORTENED):
            if len(way) < 3:
                break
            i, j = sorted(self.random.choice(len(way), size=2, replace=False).tolist())
            piece = self._straight(way[i], way[j]) if j > i + 1 else None
            if piece is not None and _length(piece) < 0.999 * _length(way[i : j + 1]):
                way = np.concatenate((way[:i], piece, way[j + 1 :]))
        return way

    def _dense(self, way: Array, first: JointVector, last: JointVector) -> Array:
        """A way with postures between those that are further apart."""
        rows = [first[None]]
        for a, b in pairwise(way):
            piece = self._straight(a, b)
            rows.append(b[None] if piece is None else piece[1:])
        out = np.concatenate(rows)
        out[-1] = last
        return out

    def _straight(self, a: JointVector, b: JointVector) -> Array | None:
        """Postures on the manifold along the straight line from a to b; None where it does not lead there."""
        count = max(2, math.ceil(float(np.abs((b - a) / self.problem.scale).max()) / SPACING) + 1)
        line = a[:, None] + np.linspace(0.0, 1.0, count) * (b - a)[:, None]
        on, found = self.problem.manifold.project(line, self.z[:, None], iterations=8)
        if not found.all() or not self.problem.allowed(on, self.z[:, None]).all():
            return None
        on[:, 0], on[:, -1] = a, b
        step = np.abs(np.diff(on, axis=1) / self.problem.scale[:, None]).max(axis=0)
        if step.max() > 2.0 * SPACING or not connected(self.problem, on[:, :-1], on[:, 1:], self.z).all():
            return None
        return np.ascontiguousarray(on.T)


def _length(q: Float[Array, "K n"]) -> float:
    return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
