"""`plan`: joints along a whole task path, within limits and clear of obstacles, or the reason why there are none."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from eos_pin._arrays import Array, VectorLike, as_floats, called, checked, listed
from eos_pin.errors import InputError, PlanError, take
from eos_pin.planning.attempts import Progress, Search
from eos_pin.planning.costs import Cost
from eos_pin.planning.courses import mended
from eos_pin.planning.grid import grid_of
from eos_pin.planning.limit_use import MotionLimits, limit_use
from eos_pin.planning.obstacles.bodies import Bodies
from eos_pin.planning.obstacles.scene import Scene
from eos_pin.planning.plans import Plan
from eos_pin.planning.problem import Problem, given, problem_of
from eos_pin.planning.refine import refine
from eos_pin.planning.report import figures
from eos_pin.planning.timing import check_limits, in_time
from eos_pin.tasks.base import PointLike, Task
from eos_pin.tasks.batch import Manifold
from eos_pin.trajectories.base import Trajectory

#: Room that is kept from joint limits by default [rad or m].
MARGIN = 0.01
#: How many times a plan is improved that is not as it should be between its points.
FINER = 3
#: Distance that is kept at points for each unit that is lacking between them, and more in any case [m].
FURTHER, SPARE = 1.25, 1e-4
#: Distances that further searches keep where an obstacle is thinner than steps are long, in reaches.
WIDER = (2.5e-3, 1e-3, 2.5e-4)
#: Part of the velocity limits that is left free where they were exceeded between points.
SLOWER = 2e-3
#: Part of the velocity limits beyond them from which a pace that was given is refused.
TOO_FAST = 1e-3
#: Part of the velocity limits at points from which they may be exceeded between them.
BRISK = 0.95


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
    guess: Array | Sequence[VectorLike] | None = None,
    reconfigurations: bool = False,
    allow_winding: bool = False,
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
        guess: Joints near a motion at the way points, (K, n), which is looked at before any search; of a closed path
            without the first once more at the end.
        reconfigurations: Whether the joints may jump where no continuous motion exists, as few times as possible.
        allow_winding: Whether joints without limits may end each round of a closed path whole turns away from where
            they began (`Plan.winding`).
        keep_time: Whether the velocity limits hold at the pace of the path; by default if it has times of its own.
        acceleration: Largest accelerations [rad/s² or m/s²]; a given pace is refused where they are exceeded.
        torque: Largest torques [N m or N], kept likewise, or whether those of the robot are kept.
        seed: Seed of everything random; the same seed, the same plan.
        effort: How many times the search is refined before it gives up. From two on a refusal is confirmed at first, by
            a search with twice as many points and postures.
        progress: Called with what is done and which part of it.

    Raises:
        InputError: The path, the limits or the scene cannot be used.
        PlanError: No motion was found; the message has the place where it ended, the obstacle there, and a remedy.
    """
    began = time.perf_counter()
    progress = partial(called, "progress", progress)
    task.check_still("plan")
    grid = grid_of(task, path, closed=closed, times=times)
    problem = problem_of(
        Manifold(task), scene, bodies, self_collision, clearance, margin, limits, cost, weights, start, allow_winding
    )
    timed = grid.timed if keep_time is None else keep_time
    step = grid.bounds(task.robot, joint_step, timed)
    if grid.closed and end is not None:
        raise InputError("a closed path ends where it begins; give its start, not its end")
    if allow_winding and not (grid.closed and np.isinf(problem.upper - problem.lower).any()):
        raise InputError(
            "allow_winding changes nothing here: it is for closed paths of robots with joints that turn without limits"
        )
    ends = given(start, task, grid.Z[0], "start"), given(end, task, grid.Z[-1], "end")
    search = Search(problem, grid, step, ends, reconfigurations, seed, progress)
    try:
        rows = None if guess is None else _rows(guess, (grid.count, task.robot.n))
        return in_time(_clear(search, rows, effort, timed, began), timed, acceleration, torque)
    except PlanError as error:
        error.info = {
            "waypoints": grid.count,
            "closed": grid.closed,
            "seconds": time.perf_counter() - began,
            **error.info,
        }
        raise


def _clear(search: Search, guess: Array | None, effort: int, timed: bool, began: float) -> Plan:
    """The plan that a search finds, or a further one where that leads through something thin between two points."""
    problem = search.problem
    whole = partial(
        Search, grid=search.grid, step=search.step, ends=(search.start, search.end), reconfigurations=False,
        seed=search.seed, progress=search.progress,
    )  # fmt: skip
    made = _searched(search, problem, guess, effort, timed, began)
    if made.status == "planned" and not search.reconfigurations and _lacking(made, problem) > SPARE:
        made = _around(made, whole, problem, timed, began)
    if timed and made.status == "planned" and (made.info["velocity_part_max"] or 0.0) > 1.0 + TOO_FAST:
        check_limits(made, MotionLimits.of(made.robot))
    return made


def _around(through: Plan, whole: Callable[[Problem], Search], problem: Problem, timed: bool, began: float) -> Plan:
    """A plan that keeps more distance at its points, in place of one that leads through something thin between two."""
    refused = PlanError("")
    for part in WIDER:
        wider = replace(problem, gap=problem.gap + part * problem.manifold.robot.reach, sag=0.0)
        begin = f"{through.info['message']}, and of motions that keep {wider.gap:.3g} m at the points "
        try:
            made = _searched(whole(wider), problem, None, 1, timed, began)
        except PlanError as error:
            if error.stopped:
                raise
            refused = PlanError(f"{begin}none was found: {error}", error.waypoint, error.reached)
            continue
        if made.status != "planned" or _lacking(made, problem) <= SPARE:
            return made
        refused = PlanError(f"{begin}the best does so, too; the passage is too narrow", None, 1.0)
    raise refused


def _searched(search: Search, problem: Problem, guess: Array | None, effort: int, timed: bool, began: float) -> Plan:
    """The plan that a search finds, or the best so far where a person stops it; measured by a problem."""
    status = "planned"
    try:
        if guess is not None:
            search.begin_from(guess)
        q = search.run(effort)
        if q is None:
            raise search.refusal()
    except KeyboardInterrupt as interrupt:
        take(interrupt)
        q, status = search.best, "interrupted"
        if q is None:
            raise PlanError("stopped before any motion was found", stopped=True) from None
    return _finished(search, q, problem, status, timed, began)


def _lacking(made: Plan, problem: Problem) -> float:
    """Distance that is lacking between points [m]."""
    clear = made.info["clearance_between_min"]
    return 0.0 if clear is None else max(problem.gap - clear, 0.0)


def _finished(search: Search, q: Array, problem: Problem, status: str, timed: bool, began: float) -> Plan:
    """The plan through joints at the points, more and tighter ones where between them something is not kept."""
    best: Plan | None = None
    least, task, seed = np.inf, problem.manifold.task, search.seed
    for looked in range(FINER + 1):
        grid = search.grid
        made = Plan(task, grid.path, *grid.knots(q, problem.again(q)), grid.closed, status, {})
        made = made if timed else grid.slowed(made)
        again: Array | None = None
        try:
            info = figures(made, grid, problem, time.perf_counter() - began, jumps=search.jumps(q), seed=seed)
        except PlanError as error:
            unclear = error
            again = search.finer(q)
        else:
            made = replace(made, info=info, jumps=tuple(search.jumps(q)))
            lacking = _lacking(made, problem)
            fast = _fast(made, info) if timed and not search.reconfigurations else 0.0
            short = lacking + max(fast - 1.0, 0.0)
            if short < least:
                best, least = made, short
            if short > 0.0 and status == "planned" and not search.reconfigurations:
                # A chord cuts the corner of a box: less with more points, and the rest is kept clear of by distance.
                again = search.finer(q) if lacking and not looked else _tighter(search, q, lacking, fast)
        if again is None:
            break
        q = again
    if best is None:
        raise unclear
    return best


def _tighter(search: Search, q: Array, lacking: float, fast: float) -> Array | None:
    """Joints with more distance, by the one that is lacking between points, and slower; or at more points; or None."""
    before = search.problem, search.step
    if lacking > 0.0:
        search.problem = replace(search.problem, gap=search.problem.gap + FURTHER * lacking + SPARE)
    if search.step is not None and fast > 1.0:
        search.step = search.step / (fast + SLOWER)
    kept = mended(search.course, q).q
    if kept is not None:
        return refine(search.course, kept)
    search.problem, search.step = before
    return search.finer(q)


def _fast(plan: Plan, info: dict[str, Any]) -> float:
    """Part of the velocity limits that a plan uses between its points, too; written into its figures."""
    part = info["velocity_part_max"] or 0.0
    if part <= BRISK or (use := limit_use(plan).velocity) is None:
        return part
    info["velocity_part_max"] = use.ratio
    if use.ratio > 1.0 + 1e-6:
        info["message"] = f"{info['message']}; " * bool(info["message"]) + (
            f"between way points, at {use.t:.4g} s, {use.joint!r} is {use.ratio:.4g} times as fast as it may be"
        )
    return use.ratio


def _rows(guess: Array | Sequence[VectorLike], shape: tuple[int, int]) -> Array:
    rows = as_floats(guess if isinstance(guess, np.ndarray) else listed(guess, "the guess"), "the guess")
    if rows.shape != shape:
        raise InputError(f"the guess must have a row of {shape[1]} joints for each of {shape[0]} way points")
    return rows
