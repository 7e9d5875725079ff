"""Newton's method for u = h(z, v), and walks to where it does not converge at once; Sec. 3.6."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    SelfMotionVector,
    TaskVector,
    by_value,
    frozen_copy,
)
from eos_pin._kernels.dispatch import use_compiled
from eos_pin.charts._basis import is_odd
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point, Task


@by_value
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
    """Solve z = G(base − U u) for u; Eq. (22). If the residual grows, it ends early and returns the last point.

    Args:
        task: The task.
        base: Joints at u = 0, which hold the self-motion coordinates.
        U: Directions of u, (n, m).
        z: Task point to reach.
        start: Where to begin: its u and its B.
        refresh: If True, B is computed anew in each step but the first, and but the last if convergence is certain;
            if False, it is that of `start` throughout.
        tol: Largest task error that may be left [m, rad].
        max_iterations: Most steps.
    """
    u, B, last = start.u, start.B, math.inf
    # Where the axes of the error turn from point to point, G' and the error must be those of one point.
    curved = task.is_curved
    keep = not curved
    q = base - U.dot(u)
    for iteration in range(max_iterations + 1):
        z_q, J = (task._value(q), None) if keep else task._linearize(q)
        error = -task._minus(z, z_q) if curved else task._minus(z_q, z)
        residual = largest(error)
        # A step that leads away has left the neighbourhood of convergence, perhaps the chart. NaN ends here too.
        if residual <= tol or not residual < last:
            break
        # Once more with the same B the residual would fall by the same factor as before, to residual² / last.
        if curved or (refresh and residual * residual > tol * last):
            renewed = on_chart_inverse(task._linearize(q)[1] if J is None else J, U)
            if renewed is None:
                return Inverse(q, u, start.B, iteration, math.inf)
            B = renewed
        # A step with a new B leads to about residual³ / last²; where the same B then does for one more, no Jacobian is
        # needed there.
        keep = not curved and (not refresh or residual**5 <= tol * last**4 < math.inf)
        last = residual
        u, q = newton_step(base, U, u, B, error)
    return Inverse(q, u, B, iteration, residual if residual == residual else math.inf)


@use_compiled
def largest(error: TaskVector) -> float:
    """The largest entry of a task error."""
    return max(map(abs, error.tolist()))


@use_compiled
def on_chart_inverse(J: Jacobian, U: Float[Array, "n m"]) -> Float[Array, "m m"] | None:
    """B = (G'U)⁻¹, Eq. (15); None beyond the edge of the chart.

    Args:
        J: Jacobian G'.
        U: Directions of u; det G'U > 0 at the base point, so it is positive on all of the chart.
    """
    LU, pivots, B, info = lapack.dgesv(J.dot(U), _identity(U.shape[1]))
    return None if info or is_odd(LU, pivots) else B


@use_compiled
def newton_step(
    base: JointVector, U: Float[Array, "n m"], u: TaskVector, B: Float[Array, "m m"], error: TaskVector
) -> tuple[TaskVector, JointVector]:
    """The next u and its joints; Eqs. (11), (22)."""
    u = u + B.dot(error)
    return u, base - U.dot(u)


@cache
def _identity(m: int) -> Float[Array, "m m"]:
    """Right side of the solve for B, in LAPACK's order."""
    return frozen_copy(np.eye(m)).T


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
    delta = task._minus(z1, z0)
    reached, step = 0.0, first
    while reached < 1.0:
        if step < shortest:
            return reached
        ahead = min(1.0, reached + step)
        z, v = (z1, v1) if ahead == 1.0 else (task._plus(z0, ahead * delta), v0 + ahead * (v1 - v0))
        if visit(z, v):
            reached, step = ahead, 2.0 * step
        else:
            step *= 0.5
    return reached


class Postures:
    """Postures of a robot drawn evenly from within the joint limits, and within a turn.

    Args:
        robot: The robot.
        seed: Which they are; the same seed, the same postures.
        count: How many there are.
    """

    def __init__(self, robot: Robot, seed: int, count: int) -> None:
        self.robot, self.left, self.seed = robot, count, seed

    def __call__(self, count: int) -> Float[Array, "K n"]:
        """Draw `count` more postures, or as many as are left."""
        count = min(count, self.left)
        self.left -= count
        return self._random.uniform(*self._ends, (count, self.robot.n))

    @cached_property
    def _random(self) -> np.random.Generator:
        return np.random.default_rng(self.seed)

    @cached_property
    def _ends(self) -> tuple[JointVector, JointVector]:
        return np.clip(-np.pi, self.robot.lower, self.robot.upper), np.clip(np.pi, self.robot.lower, self.robot.upper)
