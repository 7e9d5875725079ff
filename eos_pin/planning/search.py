"""Search for joints along a path: layers of postures at its points, steps between them, and the best way through.

Every posture of a layer is a continuation of postures of the layer before, or lies on the same self-motion manifold
near one, so that the steps are motions of the robot and not jumps between branches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from eos_pin._arrays import Array
from eos_pin._kernels.ways import Steps, closed_ways, open_ways
from eos_pin.planning.courses import connected, unbroken
from eos_pin.planning.problem import TAU, Bar, Problem

#: Longest self-motion between two layers, in radians.
STRIDE = 0.7
#: Steps to so many neighbours are tried from each posture.
NEIGHBOURS = 12
#: And from so many neighbours to each.
INCOMING = 4
#: Self-motion shorter than this is not looked at halfway.
SHORT = 0.12
#: Pieces of a step in which postures without self-motion are led on where the whole step does not lead.
PIECES = 32
#: Called with the number of layers done; it may raise to stop.
Ticked: TypeAlias = Callable[[int], None]
#: Odd numbers that make one of the coordinates of a cell.
_HASH = np.random.default_rng(1).integers(1, 2**62, 256) | 1


def way_between(a: Float[Array, "n K"], b: Float[Array, "n #K"], rolled: Bool[Array, " n"]) -> Float[Array, "n K"]:
    """Motion from a to b, the short way round for joints of which postures whole turns apart are one."""
    d = b - a
    d[rolled] -= TAU * np.round(d[rolled] / TAU)
    return d


def tree_of(problem: Problem, Q: Float[Array, "n K"], rolled: Bool[Array, " n"]) -> cKDTree:
    """Tree of postures, those whole turns of some joints apart being one; ask it for `rows_of` postures."""
    if not rolled.any():
        return cKDTree(rows_of(problem, Q, rolled))
    return cKDTree(rows_of(problem, Q, rolled), boxsize=np.where(rolled, TAU, 1e6) / problem.scale)


def rows_of(problem: Problem, Q: Float[Array, "n K"], rolled: Bool[Array, " n"]) -> Float[Array, "K n"]:
    """Postures as rows, some joints from 0 to a turn and then the others far from the ends of their box."""
    if rolled.any():
        Q = np.where(rolled[:, None], np.mod(Q, TAU), Q + 2.5e5 * problem.scale[:, None])
        Q[rolled] = np.where(Q[rolled] >= TAU, 0.0, Q[rolled])
    return np.asarray((Q / problem.scale[:, None]).T)


@dataclass
class Failure:
    """Place at which a search ended before the end of the path.

    Attributes:
        layer: Last layer that was reached.
        reached: Postures that were reached there.
        bars: Reasons why their continuations ended.
        solutions: Postures that are allowed at the next layer, found anew.
    """

    layer: int
    reached: int
    bars: list[Bar]
    solutions: int = 0


@dataclass
class Layers:
    """Postures at the points of a path, and the steps between them.

    Attributes:
        problem: The problem: limits and costs.
        Z: Task points of the layers, (L, size); of a closed path the last is not the first again.
        dt: Time from each layer to the next, (L,); of an open path the last counts for nothing.
        closed: Whether the last layer leads to the first.
        count: Postures in a layer.
        step: Longest step of each joint between layers, (L, n); None without a bound.
        jumps: Whether reconfigurations are allowed.
        seed: Seed of the random postures.
        between: Task points halfway from each layer to the next, (L, size).
        goal: Joints to end at, (n,); None for any.
        tick: Called with the number of layers done; it may raise to stop.
    """

    problem: Problem
    Z: Float[Array, "L size"]
    dt: Float[Array, " L"]
    closed: bool
    count: int
    step: Float[Array, "L n"] | None = None
    jumps: bool = False
    seed: int = 0
    between: Float[Array, "L size"] | None = None
    goal: Array | None = None
    tick: Ticked = lambda done: None
    nodes: list[Array] = field(default_factory=list)
    steps: list[Steps] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        # Of joints that may wind postures whole turns apart are one.
        self._rolled = self.problem.winds & self.closed
        self.begin: Array | None = None

    # -- postures ----------------------------------------------------------------------------------------------------

    def first(self, start: Array | None = None) -> Array:
        """Postures of the first layer: found from random ones, and spread along the manifold; or those given."""
        problem = self.problem
        if start is not None:
            return start
        found, wanted = np.empty((problem.manifold.n, 0)), self.count if self.step is None else 4 * self.count
        for _ in range(8):
            Q, good = problem.solutions(np.repeat(self.Z[:1].T, 3 * self.count, axis=1), self._random)
            found = np.hstack((found, Q[:, good]))
            if found.shape[1] >= wanted:
                break
        if problem.r == 1 and found.size:
            for _ in range(3):
                found = np.hstack((found, self._spread(found, self.Z[0], 2 * wanted, 0.3)))
        return self._thinned(found, wanted)

    def _spread(self, Q: Array, z: Array, count: int, size: float) -> Array:
        """Allowed postures near some of Q on the same manifold."""
        problem = self.problem
        if not Q.size or not problem.r or count < 1:
            return Q[:, :0]
        chosen = Q[:, self._random.integers(Q.shape[1], size=count)]
        V = problem.manifold.null(chosen, z[:, None])
        x = self._random.uniform(-1.0, 1.0, (count, problem.r)) * size
        moved = chosen + np.einsum("knr,kr->nk", V, x) * problem.scale.min()
        moved = np.clip(moved, problem.lower[:, None], problem.upper[:, None])
        moved, found = problem.manifold.project(moved, z[:, None], iterations=8)
        found &= (np.abs(moved - chosen) / problem.scale[:, None]).max(axis=0) < 2.0 * size
        moved = moved[:, found]
        return moved[:, problem.allowed(moved, z[:, None])]

    def _thinned(self, Q: Array, count: int) -> Array:
        """At most `count` postures that lie apart, those that come first before others."""
        if Q.shape[1] <= count:
            return Q
        scaled, size = Q / self.problem.scale[:, None], 0.03
        while True:
            # One number for each cell of a grid; that two cells share one does no harm.
            cells = np.floor(scaled / size + 0.37).astype(np.int64).T @ _HASH[: len(Q)]
            _, index = np.unique(cells, return_index=True)
            if len(index) <= count:
                break
            size *= 1.5
        # Some more from the cells that were left, so that the coarser grid does not cost half of them.
        rest = np.delete(np.arange(Q.shape[1]), index)
        more = rest[np.linspace(0, len(rest) - 1, count - len(index)).astype(int)]
        return Q[:, np.sort(np.concatenate((index, more)))]

    def grow(self, start: Array | None = None) -> Failure | None:
        """Fill the layers, one after the other, and connect them."""
        L, self.begin = len(self.Z), start
        self.nodes, self.steps = [self.first(start)], []
        if not self.nodes[0].shape[1]:
            return Failure(-1, 0, self._bars_at(0), 0)
        back = self._from_goal()
        alive = np.ones(self.nodes[0].shape[1], bool)
        rounds, again = 2 if self.closed else 1, list[Array]()
        for lap in range(rounds):
            for k in range(L if self.closed else L - 1):
                following = (k + 1) % L
                live = self.nodes[k][:, alive] if lap == 0 and not self.jumps else self.nodes[k]
                there, found = self._continued(live, following)
                old = self.nodes[following] if following < len(self.nodes) else there[:, :0]
                if back:
                    old = back[following]
                new = self._candidates(old, live, there, found, k, following)
                if self.goal is not None and following == L - 1:
                    new = np.hstack((self.goal[:, None], new))
                if not new.shape[1]:
                    return self._failure(k, live, there, found)
                if following < len(self.nodes):
                    self.nodes[following] = new
                else:
                    self.nodes.append(new)
                if self.closed:
                    alive, again = np.ones(new.shape[1], bool), [*again, there][-L:]
                else:
                    whole = np.full(self.nodes[k].shape, np.nan)
                    whole[:, alive if not self.jumps else slice(None)] = there
                    self.steps.append(self._steps(k, following, whole))
                    alive = np.zeros(new.shape[1], bool)
                    alive[self.steps[-1].end] = True
                    if not alive.any() and not self.jumps:
                        return self._failure(k, live, there, found)
                self.tick(lap * L + k + 1)
        if self.closed:
            # The first layer is the only one whose postures became others after they were continued.
            again[0], _ = self._continued(self.nodes[0], 1 % L)
            self.steps += [self._steps(k, (k + 1) % L, there) for k, there in enumerate(again)]
        return None

    def _from_goal(self) -> list[Array]:
        """Postures of the layers that lead to the joints at the end; none without such."""
        if self.goal is None:
            return []
        turned = replace(
            self, Z=self.Z[::-1], dt=np.roll(self.dt[::-1], -1), count=self.count // 2, goal=None, nodes=[], steps=[],
            step=None if self.step is None else np.roll(self.step[::-1], -1, axis=0),
        )  # fmt: skip
        turned.grow(self.goal[:, None])
        missing = len(self.Z) - len(turned.nodes)
        return [self.goal[:, None][:, :0]] * missing + turned.nodes[::-1]

    def _continued(self, Q: Array, following: int) -> tuple[Array, Array]:
        """Postures of the next layer to which the shortest motions lead, NaN where there is none."""
        goal = self.Z[following]
        there, found = self.problem.manifold.project(Q, goal[:, None])
        if not self.problem.r and not found.all():
            # Close to a singularity joints go far in a short step, and without self-motion nothing else leads on.
            lost = np.flatnonzero(~found)
            there[:, lost], found[lost] = self._led(Q[:, lost], self.Z[following - 1], goal)
        # A long way for a short step of the task is a jump to another branch.
        found &= (np.abs(there - Q) / self.problem.scale[:, None]).max(axis=0) < 1.0
        there[:, ~found] = np.nan
        return there, found

    def _led(self, Q: Array, z: Array, goal: Array) -> tuple[Array, Array]:
        """Continuations in small pieces of the way from one task point to the next, and whether they were found."""
        manifold, Q, found = self.problem.manifold, Q.copy(), np.ones(Q.shape[1], bool)
        way = manifold.task._minus(goal, z)
        for part in np.arange(1, PIECES + 1) / PIECES:
            live = np.flatnonzero(found)
            if not live.size:
                break
            Q[:, live], found[live] = manifold.project(Q[:, live], manifold.task._plus(z, part * way)[:, None])
        return Q, found

    def _candidates(self, old: Array, live: Array, there: Array, found: Array, k: int, layer: int) -> Array:
        problem = self.problem
        z, on = self.Z[layer], there[:, found]
        good = on[:, problem.allowed(on, z[:, None])]
        more = []
        if self.step is None:
            # Continuations beyond the limits come back along the manifold where it leads back.
            out = on[:, ~problem.inside(on)]
            if out.shape[1]:
                back, ok = problem.manifold.search(out, z[:, None], (problem.lower, problem.upper), iterations=15)
                ok &= (np.abs(back - out) / problem.scale[:, None]).max(axis=0) < STRIDE
                back = back[:, ok]
                good = np.hstack((good, back[:, problem.allowed(back, z[:, None])]))
            more.append(self._spread(good, z, 2 * self.count, 0.5))
            if good.shape[1] < 0.3 * self.count:
                more.append(self._spread(on[:, problem.inside(on)], z, 2 * self.count, 0.5))
        else:
            aside = self._aside(live[:, found], on, self.step[k], z)
            # The ends of what can be reached come first, so that they are kept.
            good = np.hstack((aside, good))
        if self.jumps or (self.closed and len(self.nodes) <= layer):
            Q, ok = problem.solutions(np.repeat(z[:, None], self.count // 2, axis=1), self._random)
            more.append(Q[:, ok])
        # Continuations come before others: each is the next point of a way that exists.
        kept = self._thinned(np.hstack((old, good)), int(0.7 * self.count) if more else self.count)
        return np.hstack((kept, *([self._thinned(np.hstack(more), self.count - kept.shape[1])] if more else [])))

    def _aside(self, Q: Array, there: Array, step: Array, z: Array) -> Array:
        """Allowed postures beside continuations of Q, up to as far along the manifold as the bounds of the step go."""
        problem = self.problem
        if not problem.r or not Q.shape[1]:
            return Q[:, :0]
        V = problem.manifold.null(there, z[:, None])
        if problem.r == 1:
            directions = [V[:, :, 0], -V[:, :, 0]]
        else:
            x = self._random.normal(size=(4, len(V), problem.r))
            directions = list(np.einsum("knr,ikr->ikn", V, x))
        made = []
        for d in directions:
            room = (step * np.sign(d) - (there - Q).T) / np.where(np.abs(d) > 1e-9, d, 1e-9)
            far = 0.97 * np.maximum(room.min(axis=1), 0.0)
            parts = (1.0, 0.4) if problem.r == 1 else (self._random.uniform(0.2, 1.0, len(far)),)
            made += [there + (part * far * d.T) for part in parts]
        moved = np.hstack(made)
        moved = moved[:, problem.inside(moved)]
        moved, found = problem.manifold.project(moved, z[:, None], iterations=6)
        moved = moved[:, found]
        return moved[:, problem.allowed(moved, z[:, None])]

    # -- steps -------------------------------------------------------------------------------------------------------

    def _steps(self, k: int, following: int, there: Array) -> Steps:
        problem, Q, new = self.problem, self.nodes[k], self.nodes[following]
        ok = np.flatnonzero(np.isfinite(there).all(axis=0))
        if not len(ok):
            return Steps(ok, ok, np.empty(0))
        tree = tree_of(problem, new, self._rolled)
        # In three dimensions or more postures are sparse, and manifolds hang together.
        stride = (
            (STRIDE if problem.r < 3 else np.inf)
            if self.step is None
            else 2.0 * float((self.step[k] / problem.scale).max())
        )
        neighbours = min(NEIGHBOURS if self.step is None and problem.r < 3 else 2 * NEIGHBOURS, new.shape[1])
        asked = rows_of(problem, there[:, ok], self._rolled)
        distance, end = tree.query(asked, k=neighbours, p=np.inf, distance_upper_bound=stride)
        distance, end = distance.reshape(len(ok), -1), end.reshape(len(ok), -1)
        start = np.repeat(ok, end.shape[1])
        distance, end = distance.ravel(), end.ravel()
        # The other way round, too: no posture is left without the ones that are nearest to it.
        other, asked = tree_of(problem, there[:, ok], self._rolled), rows_of(problem, new, self._rolled)
        back, of = other.query(asked, k=min(INCOMING, len(ok)), p=np.inf, distance_upper_bound=stride)
        distance, of = np.append(distance, back.ravel()), np.append(ok, -1)[of.reshape(new.shape[1], -1)].ravel()
        start, end = np.append(start, of), np.append(end, np.repeat(np.arange(new.shape[1]), len(of) // new.shape[1]))
        near = np.isfinite(distance)
        start, end, distance = start[near], end[near], distance[near]
        if self.step is not None:
            near = (np.abs(self._way(Q[:, start], new[:, end])) <= self.step[k][:, None]).all(axis=0)
            start, end, distance = start[near], end[near], distance[near]
        elif problem.r < 3:
            far = np.flatnonzero(distance > SHORT)
            near = np.ones(len(start), bool)
            a = there[:, start[far]]
            near[far] = connected(problem, a, a + self._way(a, new[:, end[far]]), self.Z[following])
            start, end = start[near], end[near]
        motion = self._way(Q[:, start], new[:, end])
        cost = (problem.weights[:, None] * motion**2).sum(axis=0) / self.dt[k]
        cost += self.dt[k] * problem.cost(new)[end]
        order = np.argsort(end, kind="stable")
        return Steps(start[order], end[order], cost[order])

    def _failure(self, k: int, live: Array, there: Array, found: Array) -> Failure:
        following = (k + 1) % len(self.Z)
        bars = self.problem.bars(there, found, self.Z[following]) if live.shape[1] else []
        _, ok = self.problem.solutions(np.repeat(self.Z[following][:, None], 4 * self.count, axis=1), self._random)
        return Failure(k, live.shape[1], bars, int(ok.sum()))

    def _bars_at(self, layer: int) -> list[Bar]:
        """Causes that exclude postures at a task point, found without regard to limits."""
        problem = self.problem
        Z = np.repeat(self.Z[layer][:, None], 400, axis=1)
        Q, found = problem.manifold.project(problem.random(self._random, 400), Z, iterations=30)
        turn = np.array([0.0 if joint.kind == "prismatic" else 2.0 * np.pi for joint in problem.manifold.robot.joints])
        turned = Q - turn[:, None] * np.round(Q / np.where(turn, turn, 1.0)[:, None])
        return problem.bars(turned, found, self.Z[layer])

    # -- the best ways through -----------------------------------------------------------------------------------------

    def _way(self, a: Array, b: Array) -> Array:
        return way_between(a, b, self._rolled)

    def ways(self, most: int = 4) -> list[Array]:
        """The best ways through the layers that differ, as joints (L, n); no step is a jump where none is allowed."""
        if self.jumps or self.between is None:
            return self._ways(most)
        found = unbroken(self.problem, lambda: self._ways(most), self.nodes, self.steps, self.between, self._way)
        return [self._unrolled(way) for way in found] if self._rolled.any() else found

    def _unrolled(self, way: Float[Array, "L n"]) -> Float[Array, "L n"]:
        """Continuous joints of a way; those that may wind begin near 0 where the start is not given."""
        q = np.cumsum(np.vstack((way[:1], self._way(way[:-1].T, way[1:].T).T)), axis=0)
        turns = np.where(self._rolled, np.round(q[0] / TAU), 0.0)
        return q if self.begin is not None else q - TAU * turns

    def _ways(self, most: int) -> list[Array]:
        if self.closed:
            begin = None if self.begin is None else 0
            return closed_ways(self.nodes, self.steps, self.problem.scale, most, begin=begin)
        first = self.dt[0] * self.problem.cost(self.nodes[0])
        end = None if self.goal is None else 0
        return open_ways(self.nodes, self.steps, self.problem.scale, most, first, end=end, jumps=self.jumps)
