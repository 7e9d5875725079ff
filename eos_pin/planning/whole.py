"""Closed paths with one redundant joint: layers that hold whole self-motion manifolds, every few degrees a posture.

Each component is traced once around, so no branch of the layer is missing that a posture of the layer before leads to.
Postures that differ by whole turns of joints are one; how often joints turned is told when a way is unrolled.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from eos_pin._arrays import Array
from eos_pin._kernels.kinematics import Kinematics
from eos_pin._kernels.ways import Steps, closed_ways
from eos_pin.errors import SingularError
from eos_pin.planning.courses import connected, unbroken
from eos_pin.planning.manifolds.components import Component
from eos_pin.planning.problem import TAU, Problem
from eos_pin.planning.search import SHORT, Ticked, rows_of, tree_of, way_between

#: Distance of neighbouring postures along a component [rad].
SPACING = 0.12
#: Longest self-motion between two layers, in radians, and most steps from each posture at this spacing.
STRIDE, NEIGHBOURS = 0.55, 10
#: Random postures that look for further components: in the first layer, and in each other.
FIRST, FURTHER = 300, 16
#: Postures that lead from layer to layer: one of so many.
CARRIED = 6
#: Largest step of one joint from node to node of a trace [rad].
TRACE = 0.12


@dataclass
class WholeLayers:
    """Whole manifolds at the points of a closed path, and the steps between their postures.

    Attributes:
        problem: The problem; one joint is redundant.
        Z: Task points of the layers, (L, size).
        dt: Time from each layer to the next, (L,).
        between: Task points halfway from each layer to the next, (L, size).
        spacing: Distance of neighbouring postures along a component [rad].
        seed: Seed of the random postures.
        tick: Called with the number of layers done; it may raise to stop.
        wound: Names of the joints that turn a whole turn in ways that were left out for it.
        rolled: Joints of which postures whole turns apart are one, (n,): all that have room for a turn, but those of
            `wound` in a second search, which would otherwise find the same ways.
    """

    problem: Problem
    Z: Float[Array, "L size"]
    dt: Float[Array, " L"]
    between: Float[Array, "L size"]
    spacing: float = SPACING
    seed: int = 0
    tick: Ticked = lambda done: None
    wound: list[str] = field(default_factory=list)
    rolled: Bool[Array, " n"] = field(init=False)

    def __post_init__(self) -> None:
        problem = self.problem
        revolute = np.array([joint.kind != "prismatic" for joint in problem.manifold.robot.joints])
        self.rolled = revolute & (problem.upper - problem.lower >= TAU)

    def _home(self, Q: Float[Array, "n K"]) -> Float[Array, "n K"]:
        """Postures with each joint that turns as near the middle of its range as whole turns bring it."""
        problem = self.problem
        finite = np.isfinite(problem.lower) & np.isfinite(problem.upper)
        middle = np.where(finite, 0.5 * (np.nan_to_num(problem.lower) + np.nan_to_num(problem.upper)), 0.0)
        revolute = np.array([joint.kind != "prismatic" for joint in problem.manifold.robot.joints])
        turn = np.where(revolute, TAU, 0.0)
        away = np.round((Q - middle[:, None]) / TAU)
        return Q - turn[:, None] * away

    def _way(self, a: Array, b: Array) -> Array:
        return way_between(a, b, self.rolled)

    def ways(self, most: int) -> list[Array]:
        """The best ways round that differ, as joints (L, n): closed, winding only where joints may wind."""
        nodes = self._nodes()
        if nodes is None:
            return []
        found = self._round(nodes, most)
        if found or not self.wound:
            return found
        names = [joint.name for joint in self.problem.manifold.robot.joints]
        held = np.array([name in self.wound for name in names])
        self.rolled &= ~held
        return self._round([self._copied(Q, np.flatnonzero(held)) for Q in nodes], most)

    def _copied(self, Q: Float[Array, "n K"], joints: Int[Array, " j"]) -> Float[Array, "n M"]:
        """Postures, and those a whole turn of some joints away that are within limits."""
        for joint in joints:
            turn = TAU * (np.arange(len(Q)) == joint)[:, None]
            Q = np.hstack((Q, Q - turn, Q + turn))
            Q = Q[:, self.problem.inside(Q)]
        return Q

    def _round(self, nodes: list[Array], most: int) -> list[Array]:
        """The best ways round through layers of postures."""
        L = len(nodes)
        first = int(np.argmin([layer.shape[1] for layer in nodes]))
        order = np.roll(np.arange(L), -first)
        steps = [self._steps(k, int(order[(i + 1) % L]), nodes) for i, k in enumerate(order.tolist())]
        layers = [nodes[k] for k in order]
        found = unbroken(
            self.problem, lambda: closed_ways(layers, steps, self.problem.scale, most), layers, steps,
            self.between[order], self._way, self._home,
        )  # fmt: skip
        unrolled = (self._unrolled(np.roll(way, first, axis=0)) for way in found)
        return [way for way in unrolled if way is not None]

    def _nodes(self) -> list[Array] | None:
        """Allowed postures of each layer; None where a layer has none."""
        problem, random = self.problem, np.random.default_rng(self.seed)
        kinematics = problem.manifold.task.kinematics
        lower, upper = problem.lower, problem.upper
        out: list[Array] = []
        carried = np.empty((problem.manifold.n, 0))
        # The second lap carries what was found late on to the first layers.
        for lap in range(2):
            for k, z in enumerate(self.Z):
                count = FURTHER if lap or k else FIRST
                drawn = problem.random(random, 0 if lap else count)
                drawn, good = problem.manifold.search(drawn, z[:, None], (lower, upper))
                if carried.shape[1]:
                    on, found = problem.manifold.project(carried, z[:, None])
                    drawn = np.hstack((on[:, found], drawn[:, good]))
                else:
                    drawn = drawn[:, good]
                if lap:
                    # Only what the first lap has not got.
                    if not drawn.shape[1]:
                        break
                    near = cKDTree(out[k].T).query(self._home(drawn).T, k=1, p=np.inf)[0] < 2.0 * self.spacing
                    drawn = drawn[:, ~near]
                Q = self._whole(kinematics, self._home(drawn), z)
                carried = Q[:, ::CARRIED]
                Q = Q[:, problem.allowed(Q, z[:, None])]
                if lap:
                    out[k] = np.hstack((out[k], Q))
                else:
                    if not Q.shape[1]:
                        return None
                    out.append(Q)
                self.tick(lap * len(self.Z) + k + 1)
        return out

    def _whole(self, kinematics: Kinematics, Q: Array, z: Array) -> Array:
        """Postures every few degrees of all components that lead through some of Q."""
        if not Q.shape[1]:
            return Q
        rows = np.ascontiguousarray(Q.T)
        T, _ = kinematics.tangents(rows, z)
        known, made = np.zeros(len(rows), bool), []
        for i, q in enumerate(rows):
            if known[i]:
                continue
            try:
                curve = kinematics.trace(q, z=z, step=TRACE, turn=0.3, length=60.0, tol=1e-9, checked=False)
            except SingularError:
                continue
            if len(curve.q) < 2:
                continue
            component = Component(kinematics, z, curve)
            known[i:] |= component.passes(rows[i:], T[i:])
            known[i] = True
            made.append(_resampled(component, self.spacing))
        if not made:
            return Q[:, :0]
        found, good = self.problem.manifold.project(np.vstack(made).T, z[:, None], iterations=6)
        return self._home(found[:, good])

    def _steps(self, k: int, following: int, nodes: list[Array]) -> Steps:
        problem, Q, new = self.problem, nodes[k], nodes[following]
        scale = problem.scale[:, None]
        there, found = problem.manifold.project(Q, self.Z[following][:, None])
        found &= (np.abs(there - Q) / scale).max(axis=0) < 1.0
        ok = np.flatnonzero(found)
        if not len(ok):
            return Steps(ok, ok, np.empty(0))
        tree, asked = tree_of(problem, new, self.rolled), rows_of(problem, there[:, ok], self.rolled)
        most = min(round(NEIGHBOURS * SPACING / self.spacing), new.shape[1])
        distance, end = tree.query(asked, k=most, p=np.inf, distance_upper_bound=STRIDE)
        distance, end = distance.reshape(len(ok), -1), end.reshape(len(ok), -1)
        start = np.repeat(ok, end.shape[1])
        distance, end = distance.ravel(), end.ravel()
        near = np.isfinite(distance)
        start, end, distance = start[near], end[near], distance[near]
        far = np.flatnonzero(distance > SHORT)
        near = np.ones(len(start), bool)
        a = there[:, start[far]]
        near[far] = connected(problem, a, a + self._way(a, new[:, end[far]]), self.Z[following], self._home)
        start, end = start[near], end[near]
        motion = self._way(Q[:, start], new[:, end])
        cost = (problem.weights[:, None] * motion**2).sum(axis=0) / self.dt[k]
        cost += self.dt[k] * problem.cost(new)[end]
        order = np.argsort(end, kind="stable")
        return Steps(start[order], end[order], cost[order])

    def _unrolled(self, way: Float[Array, "L n"]) -> Float[Array, "L n"] | None:
        """Continuous joints of a way within limits; None where they turn, or do not fit."""
        steps = self._way(way.T, np.roll(way, -1, axis=0).T).T
        turned = (np.abs(steps.sum(axis=0)) > 1e-6) & ~self.problem.winds
        if turned.any():
            names = [
                joint.name for joint, turns in zip(self.problem.manifold.robot.joints, turned, strict=True) if turns
            ]
            self.wound += [name for name in names if name not in self.wound]
            return None
        q = way[0] + np.concatenate((0.0 * steps[:1], np.cumsum(steps[:-1], axis=0)))
        problem = self.problem
        below = np.where(np.isfinite(problem.lower), problem.lower - q.min(axis=0), 0.0)
        shift = np.where(self.rolled & (below > 0.0), TAU * np.ceil(below / TAU), 0.0)
        above = np.where(np.isfinite(problem.upper), q.max(axis=0) + shift - problem.upper, 0.0)
        shift -= np.where(self.rolled & (above > 0.0), TAU * np.ceil(above / TAU), 0.0)
        q = q + shift
        return q if problem.inside(q.T).all() else None


def _resampled(component: Component, spacing: float) -> Float[Array, "K n"]:
    """Points of a component at even distances, near it."""
    count = max(2, int(np.ceil(component.length / spacing)))
    s = np.linspace(0.0, component.length, count, endpoint=not component.closed)
    return component._hermite(s)
