"""`plan`: joints along a whole task path, within limits and clear of what is in the way, or the reason why not."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from eos_pin._arrays import Array, VectorLike, checked
from eos_pin.errors import InputError, PlanError
from eos_pin.planning.advice import Change, Deadline, changes_for, components_at, tried
from eos_pin.planning.costs import Cost
from eos_pin.planning.courses import Mended, broken_at, mended, prolonged
from eos_pin.planning.grid import Grid, grid_of
from eos_pin.planning.obstacles.bodies import Bodies
from eos_pin.planning.obstacles.scene import Scene
from eos_pin.planning.plans import Plan
from eos_pin.planning.problem import Problem, given, problem_of, told
from eos_pin.planning.refine import Course, refine, without_bounds
from eos_pin.planning.report import figures
from eos_pin.planning.search import Failure, Layers
from eos_pin.planning.timing import in_time
from eos_pin.planning.whole import WholeLayers
from eos_pin.tasks.base import PointLike, Task
from eos_pin.tasks.batch import Manifold
from eos_pin.trajectories.base import Trajectory

#: Room that is kept from joint limits by default [rad or m].
MARGIN = 0.01
#: Postures in a layer by redundancy; three and more have the last.
POSTURES = (60, 100, 240, 120)
#: Ways through the layers that are refined; twice as many where local minima abound: closed, two redundant joints.
STRATEGIES = 4
#: How many times the points of a path are doubled where the joints between them are not clear.
FINER = 2
#: Most layers of a closed path at first.
LAYERS = 150
#: How many times as far apart layers may be that hold whole manifolds.
WHOLE = 2
#: Weights of the barriers while ways are compared.
ROUGH = (0.3, 0.03)

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Attempt:
    """How finely one attempt searches.

    Attributes:
        stride: Every how many points of the path there is a layer.
        count: Postures in a layer.
        bounded: Whether bounds of steps are kept by the search already.
        seed: What is added to the seed.
    """

    stride: int
    count: int
    bounded: bool
    seed: int = 0


@checked
def plan(
    task: Task,
    path: Trajectory | Sequence[PointLike] | Array,
    *,
    closed: bool | None = None,
    times: VectorLike | None = None,
    scene: Scene | None = None,
    bodies: Bodies | None = None,
    self_collision: bool = False,
    clearance: float = 0.0,
    margin: float = MARGIN,
    limits: tuple[VectorLike, VectorLike] | None = None,
    joint_step: float | VectorLike | None = None,
    cost: Cost | None = None,
    weights: float | VectorLike = 1.0,
    start: VectorLike | None = None,
    end: VectorLike | None = None,
    reconfigurations: bool = False,
    keep_time: bool | None = None,
    acceleration: float | VectorLike | None = None,
    torque: float | VectorLike | bool = False,
    seed: int = 0,
    effort: int = 3,
    progress: Progress = lambda what, part: None,
) -> Plan:
    """Joints along a whole task path: continuous, within limits, clear, and of the least cost that was found.

    The cost is ∫ (|dq/dt|² + cost of the posture) dt. Postures are sampled in layers along the path and connected where
    the robot can go from one to the next; the best ways through, of a closed path those that end where they begin, are
    refined along the self-motion at every point. Where the search loses its last posture it is refined before it gives
    up.

    Args:
        task: The task.
        path: A trajectory that repeats or ends, or way points, which are joined by a smooth curve.
        closed: Whether the joints return to where they began; by default if the path repeats.
        times: Times of the way points [s]; by default an even pace.
        scene: Solids to keep clear of; needs collision shapes of the robot, or `bodies`.
        bodies: The robot's capsules; by default fitted around its collision shapes.
        self_collision: Whether links must keep clear of each other.
        clearance: Least distance [m].
        margin: Room that is kept from joint limits [rad or m].
        limits: Least and largest joints, where they are not the robot's.
        joint_step: Longest step of each joint from one way point to the next [rad or m].
        cost: A further cost, by name: `"posture"` (near to `start`, or to zero), `"limits"`, `"clearance"`,
            `"manipulability"`, `"torque"` (of gravity), `"energy"` (motion weighed by inertia); or a function of
            joints (K, n) with values (K,), per second; or several of these with their weights, as in {"limits": 0.5,
            "torque": 2.0}; see `costs_of`.
        weights: Weight of each joint's motion, one number or (n,).
        start: Joints to begin at, (n,); by default any.
        end: Joints to end at, of an open path, (n,); by default any.
        reconfigurations: Whether the joints may jump where no continuous motion exists, as few times as possible.
        keep_time: Whether the velocity limits hold at the pace of the path; by default if it has times of its own.
        acceleration: Largest accelerations [rad/s² or m/s²]; a given pace is refused where they are exceeded.
        torque: Largest torques [N m or N], kept likewise, or whether those of the robot are kept.
        seed: Seed of everything random; the same seed, the same plan.
        effort: How many times the search is refined before it gives up.
        progress: Called with what is done and which part of it.

    Raises:
        InputError: The path, the limits or the scene cannot be used.
        PlanError: No motion was found; says where it ended, what is in the way there, and what would help.
    """
    began = time.perf_counter()
    grid = grid_of(task, path, closed=closed, times=times)
    problem = problem_of(Manifold(task), scene, bodies, self_collision, clearance, margin, limits, cost, weights, start)
    timed = grid.timed if keep_time is None else keep_time
    step = grid.bounds(task.robot, joint_step, timed)
    if grid.closed and end is not None:
        raise InputError("a closed path ends where it begins; give its start, not its end")
    ends = given(start, task, grid.Z[0], "start"), given(end, task, grid.Z[-1], "end")
    ways = STRATEGIES * (2 if grid.closed and problem.r > 1 else 1)
    search = _Search(problem, grid, step, ends, reconfigurations, seed, progress, ways)
    status = "planned"
    refused: PlanError | None = None
    try:
        q = search.run(effort)
        refused = search.refusal() if q is None else None
    except KeyboardInterrupt:
        q, status = search.best, "interrupted"
        refused = PlanError("stopped before any motion was found", stopped=True) if q is None else None
    if refused is not None or q is None:
        assert refused is not None
        refused.info = {"waypoints": grid.count, "closed": grid.closed, "seconds": time.perf_counter() - began}
        raise refused
    for _ in range(FINER + 1):
        made = Plan(task, grid.path, *grid.knots(q), grid.closed, status, {})
        made = made if timed else grid.slowed(made)
        try:
            info = figures(made, grid, problem, time.perf_counter() - began, jumps=search.jumps(q), seed=seed)
        except PlanError as error:
            unclear = error
        else:
            return in_time(replace(made, info=info, jumps=tuple(search.jumps(q))), timed, acceleration, torque)
        finer = search.finer(q)
        if finer is None:
            break
        q, grid = finer, search.grid
    raise unclear


class _Search:
    """Attempts, the best joints so far, and where the attempts ended."""

    def __init__(
        self,
        problem: Problem,
        grid: Grid,
        step: Array | None,
        ends: tuple[Array | None, Array | None],
        reconfigurations: bool,
        seed: int,
        progress: Progress,
        most: int,
    ) -> None:
        self.problem, self.grid, self.step = problem, grid, step
        self.start, self.end = ends
        self.reconfigurations, self.seed, self.progress, self.most = reconfigurations, seed, progress, most
        self.best: Array | None = None
        self.failures: list[tuple[Failure, int]] = []
        self.notes: list[str] = []
        self.stride = 1
        self.began = time.perf_counter()

    @property
    def course(self) -> Course:
        """The problem at all points."""
        grid = self.grid
        return Course(self.problem, grid.Z, grid.dt, grid.closed, self.step, *self._fixed)

    def finer(self, q: Array) -> Array | None:
        """Joints at twice as many points; the grid and the bounds of steps become finer with them."""
        grid = self.grid.finer()
        rows = np.arange(0, len(grid.Z), 2)
        joints = prolonged(self.problem.manifold, grid, q, rows)
        if joints is None:
            return None
        self.grid = grid
        if self.step is not None:
            self.step = 0.5 * np.repeat(self.step, 2, axis=0)[: len(grid.Z)]
        if not self.course.kept(joints):
            joints = mended(self.course, joints).q
        return None if joints is None else refine(self.course, joints)

    @property
    def _fixed(self) -> tuple[bool, bool]:
        return self.start is not None, self.end is not None

    def run(self, effort: int) -> Array | None:
        """Joints at the points of the path, or None."""
        if self.problem.r == 1 and self.grid.closed and self.start is None and not self.reconfigurations:
            for stride in dict.fromkeys((WHOLE * self.grid.stride, self.grid.stride)):
                self._whole(stride)
                if self.best is not None:
                    return self.best
        for attempt in self._attempts(effort):
            self._attempt(attempt)
            if self.best is not None:
                return self.best
        return None

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

    def _whole(self, stride: int) -> None:
        """Search whole manifolds for closed ways."""
        grid, problem = self.grid, self.problem
        rows = grid.rows(stride)
        dt, total = grid.dt_between(rows), 2 * len(rows)
        whole = WholeLayers(problem, grid.Z[rows], dt, self.seed, lambda done: self.progress("search", done / total))
        self._take(whole.ways(self.most), Course(problem, whole.Z, dt, True), rows, stride > 1)
        if whole.wound:
            self.notes.append(
                f"where it closes, {', '.join(map(repr, whole.wound))} would turn a whole turn each round, which winds "
                "cables up"
            )

    def _attempt(self, attempt: Attempt) -> None:
        grid, problem = self.grid, self.problem
        rows, self.stride = grid.rows(attempt.stride), attempt.stride
        dt = grid.dt_between(rows)
        step = None if self.step is None or not attempt.bounded else grid.summed(self.step, rows)
        total = len(rows) * (2 if grid.closed else 1)
        layers = Layers(
            problem, grid.Z[rows], dt, grid.closed, attempt.count, step, self.reconfigurations,
            self.seed + 1000 * attempt.seed, self.end, lambda done: self.progress("search", min(done / total, 1.0)),
        )  # fmt: skip
        failure = layers.grow(None if self.start is None else self.start[:, None])
        if failure is not None:
            self.failures.append((failure, int(rows[max(failure.layer, 0)])))
            return
        ways = layers.ways(self.most)
        if not ways:
            self.notes.append("the postures that were found do not lead back to where they began")
            return
        self._take(ways, Course(problem, layers.Z, dt, grid.closed, step, *self._fixed), rows, attempt.stride > 1)

    def _take(self, ways: list[Array], coarse: Course, rows: Array, rough: bool) -> None:
        """Refine the best of some ways and keep it, if it is better than the best so far."""
        if not self.reconfigurations and rough:
            ways = [refine(without_bounds(coarse), way, rounds=ROUGH) for way in ways]
        least, tried = np.inf, list[Array]()
        costs = np.array([coarse.cost(way) for way in ways])
        for i in np.argsort(costs, kind="stable").tolist():
            self.progress("refine", i / len(ways))
            # A way that costs more than the best so far before it is refined to the last will hardly beat it.
            if self.best is not None and (costs[i] > 1.02 * least or any(_same(ways[i], way) for way in tried)):
                continue
            tried.append(ways[i])
            found = self._finish(ways[i], rows)
            if found is not None and (self.best is None or self.course.cost(found) < self.course.cost(self.best)):
                self.best, least = found, min(least, costs[i])
        self.progress("refine", 1.0)

    def _finish(self, way: Array, rows: Array) -> Array | None:
        """Joints at all points from joints at some of them; None where something is not kept."""
        if self.reconfigurations:
            return self._pieces(way)
        q = prolonged(self.problem.manifold, self.grid, way, rows)
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
        q = refine(course, q)
        row = broken_at(self.problem.manifold, self.grid, q)
        if row is not None:
            self.notes.append(f"the joints would have to jump at {self.grid.called(row)}")
            return None
        return q

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
        spent = time.perf_counter() - self.began
        if self.failures and not self.notes:
            failure, row = max(self.failures, key=lambda item: item[1])
            helps = self._helps(changes_for(problem, failure.bars, self.reconfigurations), spent)
            if failure.layer < 0:
                return PlanError(
                    f"no joints at {grid.called(0)}, where the path begins: {told(failure.bars)}, of 400 postures "
                    f"that were tried without limits. {helps or self._advice(failure)}",
                    0,
                    0.0,
                )
            following = row + self.stride
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
                f"{'; ' * bool(components)}{components}. {helps or self._advice(failure)}",
                grid.waypoint(row),
                reached,
            )
        reasons = "; ".join(dict.fromkeys(self.notes)) or "the search found none"
        kind = "closed motion" if grid.closed else "motion"
        helps = self._helps(changes_for(problem, (), self.reconfigurations), spent)
        return PlanError(
            f"no {kind} was found ({problem.r} redundant joints, {len(grid.Z)} points): {reasons}. "
            + (helps or "Search longer (--effort), allow less clearance or margin, or lead the path elsewhere"),
            None,
            0.0,
        )

    def _helps(self, changes: Sequence[Change], spent: float) -> str:
        """Changes that were tried, in sentences; empty where time was too short for any."""

        def solve(change: Change, deadline: Deadline) -> Array | None:
            ends = self.start, self.end
            return _Search(change.problem, self.grid, self.step, ends, change.jumps, self.seed, deadline, 2).run(1)

        helpful, useless = tried(changes, solve, spent)
        if helpful:
            return f"With {helpful[0]} there is one" + (f", not yet with {' or '.join(useless)}" if useless else "")
        return f"No quick search found one with {' or '.join(useless)} either" if useless else ""

    def _advice(self, failure: Failure) -> str:
        reasons = " ".join(bar.reason for bar in failure.bars[:2])
        if "too close" in reasons:
            return "More distance from that body would help, or another path"
        if "limit" in reasons:
            return "More range of that joint, less margin or another placement of the path would help"
        if "reach" in reasons:
            return "Move the path towards the robot, or away from the singularity"
        return "Closer way points, another placement of the path, or reconfigurations would help"


def _same(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() < 0.1)  # two ways that are refined to one
