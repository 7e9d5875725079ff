"""Newton's method for u = h(z, v), walks to where it does not converge at once, search without charts; Sec. 3.6."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack

from eos_pin.arrays import Array, Jacobian, JointVector, SelfMotionVector, TaskVector, readonly
from eos_pin.compiled import twin
from eos_pin.linear import is_odd
from eos_pin.tasks import Point, Task

#: Damping at the start of a search: μ in μ e·e; and what is always added, lest J Jᵀ be singular.
DAMPING, FLOOR = 0.01, 1e-14
#: Longest step of one joint in a search [rad or m].
LONGEST = 1.0
#: So many steps in a row that gain less than a tenth end a search.
PATIENCE = 6


class Inverse(NamedTuple):
    """A point of the inverse kinematic map y(z, v), Eq. (13).

    Attributes:
        q: Joints [rad or m].
        u: Coordinates h(z, v) along U.
        B: (G'U)⁻¹ near q, a warm start for the next solve; Eq. (15).
        iterations: Newton steps that were taken, all intermediate points included.
        residual: Task error that is left, the largest entry [m, rad].
    """

    q: JointVector
    u: TaskVector
    B: Float[Array, "m m"]
    iterations: int
    residual: float


def newton(
    task: Task,
    base: JointVector,
    U: Float[Array, "n m"],
    z: Point,
    start: Inverse,
    refresh: bool,
    tol: float,
    max_iterations: int,
) -> Inverse:
    """Solve z = G(base − U u) for u; Eq. (22). It ends early where the residual grows, with whatever it has.

    Args:
        task: The task.
        base: Joints at u = 0, which hold the self-motion coordinates.
        U: Directions of u, (n, m).
        z: Task point to reach.
        start: Where to begin: its u and its B.
        refresh: Compute B anew for each step but the first, and but the last where it can do without; or keep that of
            `start`.
        tol: Largest task error that may be left [m, rad].
        max_iterations: Most steps.
    """
    u, B, last, keep = start.u, start.B, math.inf, True
    q = base - U.dot(u)
    for iteration in range(max_iterations + 1):
        z_q, J = (task.value(q), None) if keep else task.linearize(q)
        error = task.minus(z_q, z)
        residual = largest(error)
        # A step that leads away has left the neighbourhood of convergence, perhaps the chart. NaN ends here too.
        if residual <= tol or not residual < last:
            break
        # Once more with the same B the residual would fall by the same factor as before, to residual² / last.
        if refresh and residual * residual > tol * last:
            renewed = on_chart_inverse(task.linearize(q)[1] if J is None else J, U)
            if renewed is None:
                return Inverse(q, u, start.B, iteration, math.inf)
            B = renewed
        # A step with a new B leads to about residual³ / last²; where the same B then does for one more, no Jacobian is
        # needed there.
        keep = not refresh or residual**5 <= tol * last**4 < math.inf
        last = residual
        u, q = newton_step(base, U, u, B, error)
    return Inverse(q, u, B, iteration, residual if residual == residual else math.inf)


@twin
def largest(error: TaskVector) -> float:
    """The largest entry of a task error."""
    return max(map(abs, error.tolist()))


@twin
def on_chart_inverse(J: Jacobian, U: Float[Array, "n m"]) -> Float[Array, "m m"] | None:
    """B = (G'U)⁻¹, Eq. (15); None beyond the edge of the chart.

    Args:
        J: Jacobian G'.
        U: Directions of u; det G'U > 0 at the base point, so it is positive on all of the chart.
    """
    LU, pivots, B, info = lapack.dgesv(J.dot(U), _identity(U.shape[1]))
    return None if info or is_odd(LU, pivots) else B


@twin
def newton_step(
    base: JointVector, U: Float[Array, "n m"], u: TaskVector, B: Float[Array, "m m"], error: TaskVector
) -> tuple[TaskVector, JointVector]:
    """The next u and its joints; Eqs. (11), (22)."""
    u = u + B.dot(error)
    return u, base - U.dot(u)


@cache
def _identity(m: int) -> Float[Array, "m m"]:
    """Right side of the solve for B, in the order LAPACK wants."""
    return readonly(np.eye(m)).T


def walk(
    task: Task,
    start: tuple[Point, SelfMotionVector],
    goal: tuple[Point, SelfMotionVector],
    visit: Callable[[Point, SelfMotionVector], bool],
    *,
    first: float = 0.5,
    shortest: float = 1e-3,
) -> float:
    """Visit points along the straight line in (z, v) from `start` to `goal`, with steps as long as succeed.

    Args:
        task: Task whose group defines the straight line of z.
        start: Known point.
        goal: Point to reach.
        visit: Tries a point and says whether it was reached.
        first: Length of the first step, as a fraction of the way.
        shortest: Fraction of the way below which a failing step ends the walk.

    Returns:
        The fraction of the way that was reached, 1.0 if all of it.
    """
    (z0, v0), (z1, v1) = start, goal
    delta = task.minus(z1, z0)
    reached, step = 0.0, first
    while reached < 1.0:
        if step < shortest:
            return reached
        ahead = min(1.0, reached + step)
        z, v = (z1, v1) if ahead == 1.0 else (task.plus(z0, ahead * delta), v0 + ahead * (v1 - v0))
        if visit(z, v):
            reached, step = ahead, 2.0 * step
        else:
            step *= 0.5
    return reached


class Descent(NamedTuple):
    """Where a search ended.

    Attributes:
        q: Joints [rad or m].
        residual: Task error that is left, the largest entry [m, rad].
        iterations: Steps that were tried.
    """

    q: JointVector
    residual: float
    iterations: int


def descend(
    task: Task,
    q: JointVector,
    z: Point,
    bounds: tuple[JointVector, JointVector],
    *,
    tol: float,
    max_iterations: int = 60,
) -> Descent:
    """Joints at a task point, by Levenberg and Marquardt's method within bounds; it ends early where it gets stuck.

    The step Jᵀ(J Jᵀ + μ e·e)⁻¹e, with e the error left, is Newton's shortest near a solution and a small one downhill
    far away. Joints that it would push across their bounds stay where they are.

    Args:
        task: The task.
        q: Where to begin.
        z: Task point to reach.
        bounds: Least and largest value of each joint.
        tol: Largest task error that may be left [m, rad].
        max_iterations: Most steps.
    """
    lower, upper = bounds
    q = np.minimum(np.maximum(q, lower), upper)
    z_q, J = task.linearize(q)
    error = task.minus(z, z_q)
    square, mu, slow, iteration = float(error.dot(error)), DAMPING, 0, 0
    while max(map(abs, error.tolist())) > tol and iteration < max_iterations and slow < PATIENCE:
        iteration += 1
        uphill = J.T.dot(error)
        stuck = (q <= lower) & (uphill < 0.0) | (q >= upper) & (uphill > 0.0)
        free = np.where(stuck, 0.0, J) if stuck.any() else J
        A = free.dot(free.T)
        A.flat[:: task.m + 1] += mu * square + FLOOR
        step = free.T.dot(lapack.dposv(A, error)[1])
        longest = max(map(abs, step.tolist()))
        if longest > LONGEST:
            step *= LONGEST / longest
        ahead = np.minimum(np.maximum(q + step, lower), upper)
        z_q, J_ahead = task.linearize(ahead)
        error_ahead = task.minus(z, z_q)
        square_ahead = float(error_ahead.dot(error_ahead))
        slow = 0 if square_ahead < 0.9 * square else slow + 1
        if square_ahead < square:
            q, J, error, square, mu = ahead, J_ahead, error_ahead, square_ahead, 0.25 * mu
        else:
            mu *= 8.0
    return Descent(q, max(map(abs, error.tolist())), iteration)
