"""Attempts to find joints along a path, each finer than the one before, and the reason where all of them fail."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from eos_pin._arrays import Array
from eos_pin.errors import PlanError
from eos_pin.planning.advice import Change, Deadline, advice, changes_for, components_at, next_steps, tried
from eos_pin.planning.courses import Mended, broken_at, mended, prolonged
from eos_pin.planning.grid import Grid
from eos_pin.planning.problem import Bar, Problem, told
from eos_pin.planning.refine import ROUNDS, Course, refine, without_bounds
from eos_pin.planning.search import Failure, Layers, Ticked
from eos_pin.planning.whole import SPACING, WholeLayers

#: Postures in a layer by redundancy; three and more have the last.
POSTURES = (60, 100, 240, 120)
#: Ways through the layers that are refined: with one redundant joint, and with more, where local minima abound.
STRATEGIES = (4, 12)
#: Most layers of a closed path at first.
LAYERS = 150
#: How many times as far apart layers may be that hold whole manifolds.
WHOLE = 2
#: From this effort on a refusal is confirmed.
CONFIRMED = 2
#: Weights of the barriers while ways are compared.
ROUGH = (0.3, 0.03)
#: Difference up to which joints came back to where they began, whole turns left out [rad or m].
BACK = 1e-3
#: A closed path without a closed way, in words.
ASTRAY = "the postures that were found do not lead back to where they began"

#: Told what is done and which part of it.
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Attempt:
    """Fineness of one attempt of a search.

    Attributes:
        stride: Every how many points of the path there is a layer.
        count: Postures in a layer.
        bounded: Whether bounds of steps are kept by the search already.
        seed: Number added to the seed.
    """

    stride: int
    count: int
    bounded: bool
    seed: int = 0


class Search:
    """Attempts, the best joints so far, and where the attempts ended.

    Args:
        problem: The problem: limits and costs.
        grid: Points of the path.
        step: Longest step of each joint from each point to the next, (L, n); None without a bound.
        ends: Joints at the start and at the end; None for any.
        reconfigurations: Whether the joints may jump.
        seed: Seed of everything random.
        progress: Called with the work that is done.
        most: Most ways through the layers that are refined.
    """

    def __init__(
        self,
        problem: Problem,
        grid: Grid,
        step: Array | None,
        ends: tuple[Array | None, Array | None],
        reconfigurations: bool,
        seed: int,
        progress: Progress,
        most: int | None = None,
    ) -> None:
        self.problem, self.grid, self.step = problem, grid, step
        self.start, self.end = ends
        self.reconfigurations, self.seed, self.progress = reconfigurations, seed, progress
        self.most = most or STRATEGIES[problem.r > 1]
        self.best: Array | None = None
        self.failures: list[tuple[Failure, int]] = []
        self.notes: list[str] = []
        self.last, self.confirmed, self.wound = Attempt(1, 0, False), False, False
        self.began = time.thread_time()

    @property
    def course(self) -> Course:
        """The problem at all points."""
        grid = self.grid
        return Course(self.problem, grid.Z, grid.dt, grid.closed, self.step, *self._fixed)

    def finer(self, q: Array) -> Array | None:
        """Joints at twice as many points; the grid and the bounds of steps become finer with them."""
        grid = self.grid.finer()
        joints = prolonged(self.problem, grid, q, np.arange(0, len(grid.Z), 2))
        if joints is None:
            return None
        self._refine_grid(grid)
        if not self.course.kept(joints):
            joints = mended(self.course, joints).q
        return None if joints is None else refine(self.course, joints)

    def _refine_grid(self, grid: Grid) -> None:
        """Go over to twice as many points."""
        self.grid = grid
        if self.step is not None:
            self.step = 0.5 * np.repeat(self.step, 2, axis=0)[: len(grid.Z)]

    def _within_bands(self) -> bool:
        """Refine a motion that needs no tolerance, where there is a tolerance and such a motion."""
        whole, ends = self.problem.whole, (self.start, self.end)
        if whole is None or self.reconfigurations:
            return False
        problem = replace(self.problem, manifold=whole)
        q = Search(problem, self.grid, self.step, ends, False, self.seed, self.progress, self.most).run(1)
        if q is not None:
            self._take([q], self.course, np.arange(len(q)), False)
        return self.best is not None

    def begin_from(self, guess: Array) -> None:
        """Keep a motion near joints at the way points, (K, n), where there is one."""
        grid, problem = self.grid, self.problem
        rows = grid.marks if len(grid.marks) else np.arange(len(grid.Z))
        on, found = problem.manifold.project(guess.T, grid.Z[rows].T)
        if found.all():
            coarse = Course(problem, grid.Z[rows], grid.dt_between(rows), grid.closed)
            self._take([np.ascontiguousarray(on.T)], coarse, rows, False)

    @property
    def _fixed(self) -> tuple[bool, bool]:
        return self.start is not None, self.end is not None

    def run(self, effort: int) -> Array | None:
        """Joints at the points of the path, or None."""
        if self.best is not None:
            return self.best
        if self._within_bands():
            return self.best
        strides = (WHOLE * self.grid.stride, self.grid.stride)
        attempts = self._attempts(effort)
        if not self._search(strides, attempts) and effort >= CONFIRMED:
            # What was found out about the coarser points is found out anew.
            self.failures, self.notes, self.confirmed = [], [], True
            self._refine_grid(self.grid.finer())
            twice = [replace(a, count=2 * a.count, seed=effort + 1) for a in (attempts[0], attempts[-1])]
            # That a joint turns has nothing to do with arcs too short to be met.
            self._search(strides[1:], twice, SPACING if self.wound else 0.5 * SPACING)
        return self.best

    def _search(self, strides: Sequence[int], attempts: Sequence[Attempt], spacing: float = SPACING) -> bool:
        """Go through attempts until one succeeds; whether one has."""
        if self.problem.r == 1 and self.grid.closed and self.start is None and not self.reconfigurations:
            any_way = False
            for stride in dict.fromkeys(strides):
                any_way |= self._whole(stride, spacing)
                if self.best is not None:
                    return True
            if not any_way and self.problem.clearances is None:
                # Where whole manifolds have no way round, only arcs shorter than their spacing are left: the coarsest
                # attempt finds these, and finer ones found no more on any path that was looked at.
                attempts = attempts[:1]
        for attempt in attempts:
            self._attempt(attempt)
            if self.best is not None:
                return True
        return False

    def _attempts(self, effort: int) -> list[Attempt]:
        count = POSTURES[min(self.problem.r, len(POSTURES) - 1)]
        coarse = self.grid.stride
        if self.grid.closed:
            coarse = max(coarse, len(self.grid.Z) // LAYERS)
        attempts = [] if self.reconfigurations else [Attempt(coarse, count, False)]
        bounded = self.step is not None
        for i in range(effort):
            stride = 1 if bounded or self.reconfigurations else max(1, coarse >> (i + 1))
            attempts.append(Attempt(stride, int(1.5 * count) * 2**i, bounded, i + 1))
        return attempts

    def _whole(self, stride: int, spacing: float) -> bool:
        """Search whole manifolds, postures so far apart, for closed ways; whether there are any."""
        grid, problem = self.grid, self.problem
        rows = grid.rows(stride)
        dt, total = grid.dt_between(rows), 2 * len(rows)
        tick: Ticked = lambda done: self.progress("search", done / total)  # noqa: E731
        whole = WholeLayers(problem, grid.Z[rows], dt, grid.between(rows), spacing, self.seed, tick)
        ways = whole.ways(self.most)
        self._take(ways, Course(problem, whole.Z, dt, True), rows, stride > 1)
        if whole.wound:
            self._note_winding(whole.wound)
        return bool(ways)

    def _note_winding(self, wound: Sequence[str]) -> None:
        """Note joints that turn a whole turn in each closed way, and whether they may be allowed to."""
        may, joints = replace(self.problem, winding=True).winds, self.problem.manifold.robot.joints
        free = {joint.name for joint, free in zip(joints, may, strict=True) if free}
        self.wound = True
        self.notes.append(
            f"where it closes, {', '.join(map(repr, wound))} would turn a whole turn each round, which winds cables up"
            + "; allow_winding=True (--allow-winding) lets them" * (set(wound) <= free)
        )

    def _attempt(self, attempt: Attempt) -> None:
        grid, problem = self.grid, self.problem
        rows, self.last = grid.rows(attempt.stride), attempt
        dt = grid.dt_between(rows)
        step = None if self.step is None or not attempt.bounded else grid.summed(self.step, rows)
        total = len(rows) * (2 if grid.closed else 1)
        layers = Layers(
            problem, grid.Z[rows], dt, grid.closed, attempt.count, step, self.reconfigurations,
            self.seed + 1000 * attempt.seed, grid.between(rows), self.end,
            lambda done: self.progress("search", min(done / total, 1.0)),
        )  # fmt: skip
        failure = layers.grow(None if self.start is None else self.start[:, None])
        if failure is not None:
            self.failures.append((failure, int(rows[max(failure.layer, 0)])))
            return
        ways = layers.ways(self.most)
        if not ways:
            self.notes.append(ASTRAY)
            return
        self._take(ways, Course(problem, layers.Z, dt, grid.closed, step, *self._fixed), rows, attempt.stride > 1)

    def _take(self, ways: list[Array], coarse: Course, rows: Array, rough: bool) -> None:
        """Refine the best of some ways and keep it, if it is better than the best so far."""
        raw = ways
        if not self.reconfigurations and rough:
            ways = [self._refined(without_bounds(coarse), way, rows, ROUGH)[0] for way in ways]
        least, tried = np.inf, list[Array]()
        costs = np.array([coarse.cost(way) for way in ways])
        for i in np.argsort(costs, kind="stable").tolist():
            self.progress("refine", i / len(ways))
            # A way that costs more than the best so far before it is refined to the last will hardly beat it.
            if self.best is not None and (costs[i] > 1.02 * least or any(_same(ways[i], way) for way in tried)):
                continue
            tried.append(ways[i])
            found = self._finish(ways[i], rows)
            if found is None and ways is not raw:
                found = self._finish(raw[i], rows)
            if found is not None and (self.best is None or self.course.cost(found) < self.course.cost(self.best)):
                self.best, least = found, min(least, costs[i])
        self.progress("refine", 1.0)

    def _finish(self, way: Array, rows: Array) -> Array | None:
        """Joints at all points from joints at some of them; None where something is not kept."""
        if self.reconfigurations:
            return self._pieces(way)
        q = prolonged(self.problem, self.grid, way, rows)
        if q is None:
            self.notes.append("between the points that were searched the motion is not continuous")
            return None
        course = self.course
        if not course.kept(q):
            result = mended(course, q)
            if result.q is None:
                self._note(result)
                return None
            q = result.q
        refined, row = self._refined(course, q, np.arange(len(q)), ROUNDS)
        if row is None:
            return refined
        self.notes.append(f"the joints would have to jump at {self.grid.called(row)}")
        return None

    def _refined(self, course: Course, q: Array, rows: Array, rounds: tuple[float, ...]) -> tuple[Array, int | None]:
        """Joints of less cost at some points, and after which of these they jump, as those before do; None without."""
        between = self.grid.between(rows)

        def broken(joints: Array) -> int | None:
            return broken_at(self.problem, joints, between, self.grid.closed)

        refined = refine(course, q, rounds=rounds)
        if broken(refined) is None:
            return refined, None
        row = broken(q)
        if row is not None:
            return refined, int(rows[row])
        # From branch to branch, close to a singularity: refined joints jump where those before do not.
        return refine(course, q, rounds=rounds, sound=lambda joints: broken(joints) is None), None

    def _pieces(self, way: Array) -> Array:
        """A way with jumps, each piece between two of them refined by itself."""
        jumps = self.jumps(way)
        ends = [0, *(k + 1 for k in jumps), len(way)]
        course, out = self.course, []
        for a, b in pairwise(ends):
            piece = Course(
                self.problem, course.Z[a:b], course.dt[a:b], False, None if self.step is None else self.step[a:b]
            )
            out.append(refine(piece, way[a:b]) if b - a > 2 else way[a:b])
        return np.concatenate(out)

    def jumps(self, q: Array) -> list[int]:
        """Points after which the joints jump."""
        if not self.reconfigurations:
            return []
        motion = np.abs(self.course.motion(q))
        if self.step is not None:
            return np.flatnonzero((motion > self.step[: len(motion)]).any(axis=1)).tolist()
        return np.flatnonzero((motion / self.problem.scale > 0.5).any(axis=1)).tolist()

    def _note(self, result: Mended) -> None:
        self.notes.append(f"{result.reason} at {self.grid.called(result.row)}")

    def refusal(self) -> PlanError:
        """Reason and place of a refusal, and a change that would help."""
        grid, problem = self.grid, self.problem
        spent = time.thread_time() - self.began
        twice = ". A search with twice as many points and postures found none either" if self.confirmed else ""
        lost, stride, gap = self.failures if not self.notes else [], self.last.stride, ""
        if grid.closed and not lost and not self.reconfigurations and {*self.notes} <= {ASTRAY}:
            lost, stride, gap = self._once_round()
        if lost:
            failure, row = max(lost, key=lambda item: item[1])
            helps = self._helps(failure.bars, spent)
            if failure.layer < 0:
                return PlanError(
                    f"no joints at {grid.called(0)}, where the path begins: {told(failure.bars)}, of 400 postures "
                    f"that were tried without limits{twice}. {helps or advice(failure.bars)}",
                    0,
                    0.0,
                )
            following = row + stride
            reached = row / max(len(grid.Z) - 1, 1)
            bars = told(failure.bars) if failure.bars else "their steps are longer than joints may go"
            other = (
                f"{failure.solutions} postures allowed there lie on other branches"
                if failure.solutions
                else "no posture at all is allowed there"
            )
            components = components_at(problem, grid.Z[min(following, len(grid.Z) - 1)])
            return PlanError(
                f"no motion from {grid.called(row)} to {grid.called(following)} ({reached:.0%} of the path was "
                f"reached): of {failure.reached} postures reached none goes on ({bars}); {other}"
                f"{'; ' * bool(components)}{components}{twice}. {helps or advice(failure.bars)}",
                grid.waypoint(row),
                reached,
            )
        jump = "the joints would have to jump at "
        at = [note.removeprefix(jump) for note in dict.fromkeys(self.notes) if note.startswith(jump)]
        rest = [note for note in dict.fromkeys(self.notes) if not note.startswith(jump)]
        reasons = "; ".join([*rest[:3], *([jump + ", or at ".join(at[:3])] if at else [])]) or "the search found none"
        kind = "closed motion" if grid.closed else "motion"
        helps = self._helps((), spent)
        return PlanError(
            f"no {kind} was found ({problem.r} redundant joints, {len(grid.Z)} points): {reasons}{gap}{twice}. "
            + (helps or next_steps(problem, ())),
            None,
            1.0 if gap or self.wound else 0.0,
        )

    def _once_round(self) -> tuple[list[tuple[Failure, int]], int, str]:
        """Failures of a round that need not end at its start, and their stride; or the gap of one, in words."""
        step = None if self.step is None else np.concatenate((self.step, self.step[:1]))
        once = Search(self.problem, self.grid.opened(), step, (self.start, None), False, self.seed, self.progress, 1)
        # As fine as where postures were found all the way.
        once._attempt(self.last)
        if (q := once.best) is None:
            return once.failures, once.last.stride, ""
        robot, apart = self.problem.manifold.robot, np.abs(q[-1] - q[0])
        if np.abs(robot._way(q[0], q[-1])).max() < BACK < apart.max():
            self._note_winding([joint.name for joint, way in zip(robot.joints, apart, strict=True) if way > BACK])
            return [], 1, ""
        joint = robot.joints[int(apart.argmax())]
        unit = "m" if joint.kind == "prismatic" else "rad"
        return [], 1, f"; joints that went once round ended with {joint.name!r} {apart.max():.3g} {unit} from its start"

    def _helps(self, bars: Sequence[Bar], spent: float) -> str:
        """Changes that were tried, in sentences; empty where time was too short for any."""
        problem, grid, step = self.problem, self.grid, self.step

        def solve(change: Change, deadline: Deadline) -> Array | None:
            path = grid if change.size == 1.0 else grid.smaller(change.size)
            bounds = None if step is None else step / change.pace
            ends = self.start, self.end if change.size == 1.0 else None
            return Search(change.problem, path, bounds, ends, change.jumps, self.seed, deadline, 2).run(1)

        changes = changes_for(problem, bars, self.reconfigurations, grid.closed and not self.wound, step is not None)
        helpful, useless = tried(changes, solve, spent)
        if helpful:
            return f"With {helpful[0]} there is one" + (f", not yet with {' or '.join(useless)}" if useless else "")
        return next_steps(problem, useless) if useless else ""


def _same(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() < 0.1)  # two ways that are refined to one
