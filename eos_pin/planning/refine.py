"""Refinement of joints along a whole path: the cost falls, limits and distances are kept, the task stays exact.

Each posture moves along its own self-motion manifold, q = y(z, v) in coordinates of the null space there. The cost
couples neighbours only, so that a step of Newton's method (Gauss and Newton's Hessian) solves a block-tridiagonal
system, cyclic for closed paths. Limits and distances are kept by barriers that fade from round to round.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, solveh_banded

from eos_pin._arrays import Array
from eos_pin.planning.problem import Problem

#: Weight of the barriers in the rounds, relative to the mean cost of a layer.
ROUNDS = (0.3, 0.05, 0.01, 1e-3, 1e-4)
#: Distances beyond this do not count [m].
NEAR = 0.06
#: Most steps in a round, and the relative gain that ends it.
STEPS, GAIN = 25, 1e-4
#: And the gain that ends the last round: joints are off by about the square root of the gain that is left out.
LAST = 1e-7
#: Longest self-motion in one step [rad].
LONGEST = 0.4
#: Step of finite differences along the manifold [rad].
SMALL = 1e-4


@dataclass(frozen=True, eq=False)
class Course:
    """A problem at the points of a path.

    Attributes:
        problem: The problem: limits and costs.
        Z: Task points, (L, size).
        dt: Time from each point to the next, (L,); of an open path the last counts for nothing.
        closed: Whether the last point leads to the first.
        step: Longest step of each joint to the next point, (L, n); None without a bound.
        start: Whether the first posture is given and stays.
        end: Whether the last one is.
    """

    problem: Problem
    Z: Float[Array, "L size"]
    dt: Float[Array, " L"]
    closed: bool
    step: Float[Array, "L n"] | None = None
    start: bool = False
    end: bool = False

    # -- cost --------------------------------------------------------------------------------------------------------

    def motion(self, q: Float[Array, "L n"]) -> Float[Array, "l n"]:
        """Step from each posture to the next; of an open path one fewer."""
        return np.diff(np.concatenate((q, self.problem.again(q)[None])) if self.closed else q, axis=0)

    @property
    def share(self) -> Float[Array, " L"]:
        """Time that each point stands for."""
        before = np.roll(self.dt, 1) if self.closed else np.concatenate(([0.0], self.dt[:-1]))
        after = self.dt if self.closed else np.concatenate((self.dt[:-1], [0.0]))
        return 0.5 * (before + after)

    def cost(self, q: Float[Array, "L n"]) -> float:
        """∫ (|dq/dt|² weighted + cost of postures) dt."""
        step = self.motion(q)
        total = float((self.problem.weights * step**2 / self.dt[: len(step), None]).sum())
        if self.problem.posture_cost is not None:
            total += float((self.share * self.problem.cost(q.T)).sum())
        return total

    def kept(self, q: Float[Array, "L n"]) -> bool:
        """Whether limits, distances and bounds of steps are kept."""
        if not self.problem.allowed(q.T, self.Z.T).all():
            return False
        return self.step is None or bool((np.abs(self.motion(q)) <= self.step[: len(q) if self.closed else -1]).all())


def refine(
    course: Course,
    q: Float[Array, "L n"],
    *,
    rounds: tuple[float, ...] = ROUNDS,
    steps: int = STEPS,
    tick: Callable[[], None] = lambda: None,
    sound: Callable[[Array], bool] = lambda q: True,
) -> Float[Array, "L n"]:
    """Joints of less cost near q, or q itself; limits, distances and bounds that q keeps are kept.

    Args:
        course: The problem at the points of the path.
        q: Joints at these points, on their manifolds, (L, n).
        rounds: Weights of the barriers, round by round.
        steps: Most steps in a round.
        tick: Called at each step; it may raise to stop.
        sound: Whether joints are sound in other ways, as q is; no step leads to others.
    """
    if not course.problem.r:
        return q
    best, least = q, course.cost(q)
    mean = least / len(q)
    for weight in rounds:
        gain = LAST if weight == ROUNDS[-1] else GAIN
        q = descended(course, Barrier(course, max(weight * mean, 1e-12)), q, steps, tick, gain=gain, sound=sound)
        cost = course.cost(q)
        if cost < least:
            best, least = q, cost
    return best


def descended(
    course: Course,
    barrier: Barrier,
    q: Array,
    steps: int = STEPS,
    tick: Callable[[], None] = lambda: None,
    enough: Callable[[Array], bool] = lambda q: False,
    gain: float = GAIN,
    sound: Callable[[Array], bool] = lambda q: True,
) -> Array:
    """Joints of less value near q, by Newton's method with Levenberg's damping.

    Args:
        course: The problem.
        barrier: The value, its slope and its curvature.
        q: Joints, (L, n).
        steps: Most steps.
        tick: Called at each step.
        enough: Whether joints are good enough to end with.
        gain: Relative gain below which it ends.
        sound: Whether joints may be gone to.
    """
    value, damping = barrier.value(q), 1e-3
    for _ in range(steps):
        tick()
        before = value
        system = _System(course, barrier, q)
        for _ in range(6):
            x = system.solve(damping)
            if x is None:
                damping = max(10.0 * damping, 1e-6)
                continue
            q_new, value_new, length = _along(course, barrier, q, value, system, x, sound)
            damping = damping * (0.2 if length == 1.0 else 4.0 if length < 0.2 else 1.0)
            if length:
                q, value = q_new, value_new
                break
        if before - value < gain * abs(before) or enough(q):
            break
    return q


def _along(
    course: Course,
    barrier: Barrier,
    q: Array,
    value: float,
    system: _System,
    x: Array,
    sound: Callable[[Array], bool],
) -> tuple[Array, float, float]:
    """The longest of a few parts of a step that lowers the value, and that part; 0 where none does."""
    move = np.einsum("knr,kr->kn", system.V, x)
    longest = float(np.abs(move / course.problem.scale).max())
    part = min(1.0, LONGEST / max(longest, 1e-300))
    for _ in range(7):
        q_new, found = course.problem.manifold.project((q + part * move).T, course.Z.T, iterations=8)
        if course.start:
            q_new[:, 0] = q[0]
        if course.end:
            q_new[:, -1] = q[-1]
        if found.all():
            value_new = barrier.value(q_new.T)
            if value_new < value and sound(q_new.T):
                return q_new.T, value_new, part
        part *= 0.35
    return q, value, 0.0


class Barrier:
    """The cost, and walls at limits, distances and bounds of steps: infinite beyond those that are kept.

    Args:
        course: The problem.
        weight: Height of the walls.
    """

    #: What the cost of motion counts.
    share = 1.0

    def __init__(self, course: Course, weight: float) -> None:
        self.course, self.weight = course, weight
        problem = course.problem
        span = np.where(np.isfinite(problem.upper - problem.lower), problem.upper - problem.lower, 2.0 * np.pi)
        self._span = np.maximum(span, 1e-9)

    def value(self, q: Float[Array, "L n"]) -> float:
        """Cost and walls."""
        course, problem = self.course, self.course.problem
        total = course.cost(q)
        for room in (q - problem.lower, problem.upper - q):
            if (room < 0.0).any():
                return np.inf
            part = np.where(np.isfinite(room), room / self._span, 1.0)
            total -= self.weight * float(np.log(np.maximum(4.0 * part, 1e-9))[part < 0.25].sum())
        used = np.square(problem.used(q.T, course.Z.T)).sum(axis=2)
        if (used >= 1.0).any():
            return np.inf
        total -= self.weight * float(np.log1p(-used).sum())
        if course.step is not None:
            step = course.motion(q)
            room = 1.0 - (step / course.step[: len(step)]) ** 2
            if (room < 0.0).any():
                return np.inf
            total -= self.weight * float(np.log(np.maximum(room, 1e-12)).sum())
        if problem.clearances is not None and len(problem.clearances):
            room = problem.clearances.pairs(q.T) - problem.gap
            if (room < 0.0).any():
                return np.inf
            total -= self.weight * float(np.log(np.maximum(room[room < NEAR] / NEAR, 1e-9)).sum())
        return total

    def steps(self, step: Array, bound: Array) -> tuple[Array, Array]:
        """Slope and curvature of the walls at the bounds of steps."""
        room = np.maximum(bound**2 - step**2, 1e-12 * bound**2)
        return self.weight * 2.0 * step / room, self.weight * (2.0 / room + 4.0 * step**2 / room**2)

    def slopes(self, q: Float[Array, "L n"], V: Float[Array, "L n r"]) -> tuple[Array, Array, Array, Array]:
        """Slope and curvature in each joint, (L, n) each, and in the coordinates along V, (L, r) and (L, r, r)."""
        problem = self.course.problem
        g, h = np.zeros_like(q), np.zeros_like(q)
        for room, sign in ((q - problem.lower, -1.0), (problem.upper - q, 1.0)):
            near = np.isfinite(room) & (room < 0.25 * self._span)
            inverse = np.where(near, 1.0 / np.where(near, np.maximum(room, 1e-9), 1.0), 0.0)
            g += self.weight * sign * inverse
            h += self.weight * inverse**2
        L, _, r = V.shape
        gx, hx = np.zeros((L, r)), np.zeros((L, r, r))
        if problem.bands is not None:
            used, slope = self._bands(q, V)
            inverse = 1.0 / np.maximum(1.0 - np.square(used).sum(axis=2), 1e-9)
            along = 2.0 * np.einsum("kbd,kbdr->kbr", used, slope)
            gx += self.weight * np.einsum("kb,kbr->kr", inverse, along)
            hx += self.weight * np.einsum("kb,kbr,kbs->krs", inverse**2, along, along)
            hx += self.weight * 2.0 * np.einsum("kb,kbdr,kbds->krs", inverse, slope, slope)
        if problem.clearances is not None and len(problem.clearances):
            here = problem.clearances.pairs(q.T)
            room = here - problem.gap
            near = room < NEAR
            rows = np.flatnonzero(near.any(axis=0))
            slope = np.zeros((len(here), L, r))
            for i in range(r):
                ahead = problem.clearances.pairs((q[rows] + SMALL * V[rows, :, i]).T)
                slope[:, rows, i] = (ahead - here[:, rows]) / SMALL
            inverse = np.where(near, 1.0 / np.maximum(room, 1e-7), 0.0)
            gx -= self.weight * np.einsum("pk,pkr->kr", inverse, slope)
            hx += self.weight * np.einsum("pk,pkr,pks->krs", inverse**2, slope, slope)
        if problem.posture_cost is not None:
            self._posture(q, V, gx, hx)
        return g, h, gx, hx

    def _bands(self, q: Array, V: Array) -> tuple[Array, Array]:
        """Parts of the bands that are used, (L, B, 2), and their slopes along V, (L, B, 2, r)."""
        problem, Z = self.course.problem, self.course.Z.T
        here = problem.used(q.T, Z)
        ahead = [problem.used((q + SMALL * V[:, :, i]).T, Z) for i in range(V.shape[2])]
        return here, (np.stack(ahead, axis=3) - here[:, :, :, None]) / SMALL

    def _posture(self, q: Array, V: Array, gx: Array, hx: Array) -> None:
        """Slope of the cost of postures, and of its curvature the positive part along each coordinate."""
        problem, share = self.course.problem, self.course.share
        h = 10.0 * SMALL
        here = problem.cost(q.T)
        for i in range(V.shape[2]):
            ahead, behind = (problem.cost((q + s * h * V[:, :, i]).T) for s in (1.0, -1.0))
            gx[:, i] += share * (ahead - behind) / (2.0 * h)
            hx[:, i, i] += share * np.maximum((ahead - 2.0 * here + behind) / h**2, 0.0)


class _System:
    """Slope and Hessian of the value in coordinates along the null space at every point."""

    def __init__(self, course: Course, barrier: Barrier, q: Array) -> None:
        problem = course.problem
        self.course = course
        V = problem.manifold.null(q.T, course.Z.T)
        if course.start or course.end:
            V = V.copy()
            V[[k for k, given in ((0, course.start), (-1, course.end)) if given]] = 0.0
        self.V = V
        step = course.motion(q)
        dt = course.dt[: len(step), None]
        W = np.broadcast_to(problem.weights, step.shape) / dt
        pull, stiff = 2.0 * W * step, 2.0 * W
        pull, stiff = pull * barrier.share, stiff * barrier.share
        if course.step is not None:
            more = barrier.steps(step, course.step[: len(step)])
            pull, stiff = pull + more[0], stiff + more[1]
        g, h, gx, hx = barrier.slopes(q, V)
        ahead = slice(None) if course.closed else slice(0, -1)
        g[ahead] -= pull
        h[ahead] += stiff
        if course.closed:
            g += np.roll(pull, 1, axis=0)
            h += np.roll(stiff, 1, axis=0)
            following = np.roll(V, -1, axis=0)
        else:
            g[1:] += pull
            h[1:] += stiff
            following = V[1:]
        self.gradient = np.einsum("knr,kn->kr", V, g) + gx
        self.diagonal = np.einsum("knr,kn,kns->krs", V, h, V) + hx
        self.beside = -np.einsum("knr,kn,kns->krs", V[: len(step)], stiff, following)
        self.typical = float(np.einsum("krr->k", self.diagonal).mean()) / V.shape[2]

    def solve(self, damping: float) -> Array | None:
        """Step −(H + damping)⁻¹ g, (L, r); None where that is not positive definite."""
        L, r = self.gradient.shape
        D = self.diagonal + damping * self.typical * np.eye(r)
        try:
            if not self.course.closed:
                return -_banded(D, self.beside, self.gradient[:, :, None])[:, :, 0]
            # The last point is eliminated: without it the system is a band.
            edge = np.zeros((L - 1, r, r))
            edge[0] = self.beside[-1].T
            edge[-1] += self.beside[-2]
            right = np.concatenate((self.gradient[:-1, :, None], edge), axis=2)
            solved = _banded(D[:-1], self.beside[: L - 2], right)
            S = D[-1] - np.einsum("krs,krt->st", edge, solved[:, :, 1:])
            rest = self.gradient[-1] - np.einsum("krs,kr->s", edge, solved[:, :, 0])
            last = np.linalg.solve(S, rest)
            return -np.concatenate((solved[:, :, 0] - solved[:, :, 1:] @ last, last[None]))
        except LinAlgError:
            return None


def _banded(D: Array, beside: Array, right: Array) -> Array:
    """Solution of a symmetric block-tridiagonal system, (L, r, columns)."""
    L, r, columns = right.shape
    band = np.zeros((2 * r, L * r))
    for i in range(r):
        for j in range(i, r):
            band[j - i, i::r][:L] = D[:, j, i]
        for j in range(r):
            # Entry (row of the next block j, column i).
            if len(beside):
                band[r + j - i, i::r][: len(beside)] = beside[:, i, j]
    solved = solveh_banded(band, right.reshape(L * r, columns), lower=True, check_finite=False)
    return solved.reshape(L, r, columns)


def without_bounds(course: Course) -> Course:
    """The same course without bounds of steps."""
    return replace(course, step=None)
