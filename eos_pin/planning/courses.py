"""Joints along a path: ways through layers without jumps, all points from some, mended where limits are broken."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eos_pin._arrays import Array
from eos_pin._kernels.ways import Steps
from eos_pin.planning.grid import Grid
from eos_pin.planning.problem import Problem
from eos_pin.planning.refine import NEAR, SMALL, Barrier, Course, descended

#: Room beyond what is asked for, so that what is mended is well inside: in joints [rad or m], distances [m], steps.
ROOM, CLEAR, WITHIN = 2e-3, 2e-3, 0.97
#: Weights of the cost beside what is broken, round by round.
SHARES = (1e-2, 1e-3, 1e-4)
#: Longer steps are looked at in so many pieces.
LONG, PIECES = 0.7, 8
#: Most searches for ways, each without the steps that the one before turned out to jump with.
SEARCHES = 12
#: Longest step of refined joints that is no jump [rad, scaled].
FAR = 1.5
#: Largest correction of a joint where the path is filled in [rad or m].
CORRECTION = 0.35


class Mended(NamedTuple):
    """Joints that keep all constraints, or the constraints that remain broken.

    Attributes:
        q: Joints, (L, n); None where they could not be mended.
        reason: Constraint that is broken still, in words.
        row: Where it is worst.
    """

    q: Array | None
    reason: str = ""
    row: int = 0


def prolonged(
    problem: Problem, grid: Grid, way: Float[Array, "l n"], rows: Int[Array, " l"]
) -> Float[Array, "L n"] | None:
    """Joints at all points of a path, from a spline through those at some of them; None where they are not near it."""
    if len(rows) == len(grid.Z):
        return way
    from scipy.interpolate import CubicSpline

    times, values, rate = grid.times[rows], way, 0.0 * way[0]
    if grid.closed:
        period = grid.dt.sum()
        # Whole turns are an even motion, and the rest repeats.
        rate = (problem.again(way) - way[0]) / period
        times, values = np.append(times, grid.times[0] + period), way - np.outer(times - times[0], rate)
        values = np.concatenate((values, values[:1]))
    curve = CubicSpline(times, values, bc_type="periodic" if grid.closed else "not-a-knot")
    guess = curve(grid.times) + np.outer(grid.times - times[0], rate)
    q, found = problem.manifold.project(guess.T, grid.Z.T)
    if not found.all() or np.abs(q.T - guess).max() > CORRECTION:
        return None
    q = np.ascontiguousarray(q.T)
    q[rows] = way
    return q


def broken_at(problem: Problem, q: Float[Array, "L n"], between: Float[Array, "L size"], closed: bool) -> int | None:
    """Point after which joints are not continuous: halfway to the next the path's joints are not near; None without.

    Args:
        problem: The problem.
        q: Joints at points of a path.
        between: Task points halfway from each of them to the next.
        closed: Whether the last point leads to the first.
    """
    following = np.concatenate((q[1:], problem.again(q)[None])) if closed else q[1:]
    q, between = q[: len(following)], between[: len(following)]
    motion = (following - q).T
    # A step so long may lead over a limit, or to another branch.
    far = (np.abs(motion) > FAR * problem.scale[:, None]).any(axis=0)
    wrong = far | ~leads_halfway(problem, q.T, motion, between.T)
    return int(wrong.argmax()) if wrong.any() else None


def leads_halfway(
    problem: Problem, a: Array, way: Array, Z: Array, home: Callable[[Array], Array] = lambda Q: Q
) -> Bool[Array, " K"]:
    """Whether motions are continuous and clear halfway: the path's joints are near there, and no thin obstacle is.

    Args:
        problem: The problem.
        a: Joints that they begin at, (n, K).
        way: The motions, (n, K).
        Z: Task points halfway, one for each or one for all.
        home: As in `unbroken`.
    """
    middle = a + 0.5 * way
    on, found = problem.manifold.project(middle, Z, iterations=10)
    near: Bool[Array, " K"] = found & (np.abs(on - middle).max(axis=0) <= 0.3 * np.abs(way).max(axis=0) + 0.02)
    near[near] = problem.clear_halfway(home(on[:, near]), way[:, near])
    return near


class Penalty(Barrier):
    """Weighted cost plus squared violations.

    Args:
        course: The problem.
        share: Weight of the cost.
    """

    def __init__(self, course: Course, share: float) -> None:
        super().__init__(course, 1.0)
        self.share = share

    def _broken(self, q: Array) -> tuple[Array, Array, Array | None]:
        """Excess of joints over their limits, negative below, and lack of distances, in parts of `NEAR`."""
        problem = self.course.problem
        room = np.minimum(ROOM, 0.1 * (problem.upper - problem.lower))
        beyond = np.maximum(q - (problem.upper - room), 0.0) - np.maximum(problem.lower + room - q, 0.0)
        if problem.clearances is None or not len(problem.clearances):
            return beyond, np.empty((0, len(q))), None
        pairs = problem.clearances.pairs(q.T)
        return beyond, np.maximum(problem.gap + CLEAR - pairs, 0.0) / NEAR, pairs

    def value(self, q: Float[Array, "L n"]) -> float:
        course = self.course
        beyond, close, _ = self._broken(q)
        total = self.share * course.cost(q) + float((beyond**2).sum()) + float((close**2).sum())
        over = np.maximum(np.square(course.problem.used(q.T, course.Z.T)).sum(axis=2) - WITHIN**2, 0.0)
        total += float((over**2).sum())
        if course.step is not None:
            step = course.motion(q)
            over = np.maximum(np.abs(step) / course.step[: len(step)] - WITHIN, 0.0)
            total += float((over**2).sum())
        return total

    def steps(self, step: Array, bound: Array) -> tuple[Array, Array]:
        over = np.maximum(np.abs(step) / bound - WITHIN, 0.0)
        return 2.0 * over * np.sign(step) / bound, 2.0 * (over > 0.0) / bound**2

    def slopes(self, q: Float[Array, "L n"], V: Float[Array, "L n r"]) -> tuple[Array, Array, Array, Array]:
        problem = self.course.problem
        L, _, r = V.shape
        beyond, close, here = self._broken(q)
        gx, hx = np.zeros((L, r)), np.zeros((L, r, r))
        rows = np.flatnonzero(close.any(axis=0))
        if here is not None and len(rows):
            assert problem.clearances is not None
            slope = np.zeros((len(here), L, r))
            for i in range(r):
                ahead = problem.clearances.pairs((q[rows] + SMALL * V[rows, :, i]).T)
                slope[:, rows, i] = (ahead - here[:, rows]) / (SMALL * NEAR)
            gx -= 2.0 * np.einsum("pk,pkr->kr", close, slope)
            hx += 2.0 * np.einsum("pk,pkr,pks->krs", (close > 0.0).astype(float), slope, slope)
        if problem.bands is not None:
            used, slope = self._bands(q, V)
            over = np.maximum(np.square(used).sum(axis=2) - WITHIN**2, 0.0)
            along = 2.0 * np.einsum("kbd,kbdr->kbr", used, slope)
            gx += 2.0 * np.einsum("kb,kbr->kr", over, along)
            hx += 2.0 * np.einsum("kb,kbr,kbs->krs", (over > 0.0).astype(float), along, along)
        if problem.posture_cost is not None:
            more = np.zeros_like(gx), np.zeros_like(hx)
            self._posture(q, V, *more)
            gx, hx = gx + self.share * more[0], hx + self.share * more[1]
        return 2.0 * beyond, 2.0 * (beyond != 0.0), gx, hx


def mended(course: Course, q: Float[Array, "L n"]) -> Mended:
    """Joints near q that keep limits, distances and bounds of steps."""
    if course.problem.r:
        mean = course.cost(q) / len(q)
        for share in SHARES:
            q = descended(course, Penalty(course, share / max(mean, 1e-12)), q, 40, enough=course.kept)
            if course.kept(q):
                return Mended(q)
    elif course.kept(q):
        return Mended(q)
    return Mended(None, *_broken(course, q))


def _broken(course: Course, q: Array) -> tuple[str, int]:
    """Violations in words, and the place of the worst."""
    problem, robot = course.problem, course.problem.manifold.robot
    for room, end in ((q - problem.lower, "lower"), (problem.upper - q, "upper")):
        if (room < 0.0).any():
            row, joint = np.unravel_index(int(room.argmin()), room.shape)
            return f"{robot.joints[joint].name!r} is {-room[row, joint]:.3g} beyond its {end} limit", int(row)
    if problem.clearances is not None and len(problem.clearances):
        pairs = problem.clearances.pairs(q.T)
        if (pairs < problem.gap).any():
            pair, row = np.unravel_index(int(pairs.argmin()), pairs.shape)
            a, b = problem.clearances.names[int(pair)]
            return f"{a!r} is {pairs[pair, row]:.3g} m from {b!r}", int(row)
    used = np.sqrt(np.square(problem.used(q.T, course.Z.T)).sum(axis=2))
    if problem.bands is not None and (used > 1.0).any():
        row, band = np.unravel_index(int(used.argmax()), used.shape)
        return f"{used[row, band]:.3g} times the tolerance {problem.bands.bands[int(band)]} would be used", int(row)
    if course.step is not None:
        step = course.motion(q)
        part = np.abs(step) / course.step[: len(step)]
        row, joint = np.unravel_index(int(part.argmax()), part.shape)
        return (
            f"{robot.joints[joint].name!r} would have to go {abs(step[row, joint]):.3g} in one step, "
            f"{part[row, joint]:.3g} times as far as it may",
            int(row),
        )
    return "the motion is not continuous", 0


def unbroken(
    problem: Problem,
    find: Callable[[], list[Array]],
    nodes: list[Array],
    steps: list[Steps],
    between: Float[Array, "L size"],
    motion: Callable[[Array, Array], Array] = lambda a, b: b - a,
    home: Callable[[Array], Array] = lambda Q: Q,
) -> list[Array]:
    """Ways that do not jump: joints halfway along each step are near the manifold there, along long ones allowed, too.

    Close to a singularity branches nearly meet, and steps lead from one to the other. Such steps are left out, and the
    ways are searched for again.

    Args:
        problem: The problem.
        find: Searches for the best ways through the layers by their steps.
        nodes: Postures of the layers.
        steps: Steps from each layer to the next; those that jump are taken out.
        between: Task points halfway along them.
        motion: Motion from postures to others.
        home: Turns postures by whole turns to where limits are looked at.
    """

    def continuous(a: Array, b: Array, Z: Array) -> Bool[Array, " K"]:
        way = motion(a, b)
        near = leads_halfway(problem, a, way, Z, home)
        size = np.abs(way / problem.scale[:, None]).max(axis=0)
        far = np.flatnonzero(near & (size > LONG))
        if len(far):
            near[far] = led(problem, a[:, far], way[:, far], Z if Z.shape[1] == 1 else Z[:, far], home)
        return near

    L, found = len(steps), list[Array]()
    for _ in range(SEARCHES):
        found, broken = find(), np.zeros(L, bool)
        for way in found:
            broken |= ~continuous(way[:L].T, np.roll(way, -1, axis=0)[:L].T, between[:L].T)
        if not broken.any():
            break
        for i in np.flatnonzero(broken).tolist():
            start, end, cost = steps[i]
            kept = continuous(nodes[i][:, start], nodes[(i + 1) % len(nodes)][:, end], between[i][:, None])
            steps[i] = Steps(start[kept], end[kept], cost[kept])
    return found


def led(problem: Problem, a: Array, way: Array, Z: Array, home: Callable[[Array], Array]) -> Bool[Array, " K"]:
    """Whether straight motions, put on the manifold, are continuous and allowed; arguments as in `unbroken`."""
    led, before = np.ones(a.shape[1], bool), a
    longest = (2.5 / PIECES) * np.abs(way / problem.scale[:, None]).max(axis=0)
    for part in np.arange(1, PIECES) / PIECES:
        on, found = problem.manifold.project(a + part * way, Z, iterations=10)
        led &= found & (np.abs((on - before) / problem.scale[:, None]).max(axis=0) < longest)
        led[led] = problem.allowed(home(on[:, led]), Z if Z.shape[1] == 1 else Z[:, led])
        before = on
    return led


def connected(
    problem: Problem, a: Array, b: Array, z: Array, home: Callable[[Array], Array] = lambda Q: Q
) -> Bool[Array, " K"]:
    """Whether postures of one task point are connected: halfway between them there is one, which is allowed.

    Args:
        problem: The problem: limits and costs.
        a: Postures, (n, K).
        b: As many others.
        z: Task point.
        home: Turns postures by whole turns to where limits are looked at.
    """
    middle = 0.5 * (a + b)
    on, found = problem.manifold.project(middle, z[:, None], iterations=6, tol=1e-8)
    scale = problem.scale[:, None]
    apart, off = (np.abs(x / scale).max(axis=0) for x in (a - b, on - middle))
    found &= off < 0.35 * apart
    found[found] = problem.allowed(home(on[:, found]), z[:, None])
    return found
