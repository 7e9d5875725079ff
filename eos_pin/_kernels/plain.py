"""Kinematics of any task through its own methods, with the contract of the compiled `Chain`."""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lapack

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    TaskVector,
    Vector,
)

#: Damping at the start of a search: μ in μ e·e; and what is always added, lest J Jᵀ be singular.
DAMPING, FLOOR = 0.01, 1e-14
#: Longest step of one joint in a search [rad or m].
LONGEST = 1.0
#: So many steps in a row that gain less than a tenth end a search.
PATIENCE = 6


@runtime_checkable
class TaskFunctions(Protocol):
    """The methods of a task that kinematics needs."""

    m: int
    size: int

    def _value(self, q: JointVector) -> Vector:
        """Task point."""

    def _linearize(self, q: JointVector) -> tuple[Vector, Jacobian]:
        """Task point and Jacobian."""

    def _minus(self, z1: Vector, z0: Vector) -> TaskVector:
        """Step from z0 to z1."""


class PlainChain:
    """Kinematics of a task, one row after the other.

    Args:
        task: The task.
        n: Number of joints.
    """

    def __init__(self, task: TaskFunctions, n: int) -> None:
        self.task, self.n, self.m, self.size = task, n, task.m, task.size

    def value(self, Q: Float[Array, "K n"]) -> Float[Array, "K size"]:
        """Task points."""
        return np.reshape([self.task._value(q) for q in Q], (len(Q), self.size))

    def linearize(self, Q: Float[Array, "K n"]) -> tuple[Float[Array, "K size"], Float[Array, "K m n"]]:
        """Task points and Jacobians."""
        Z, J = np.empty((len(Q), self.size)), np.empty((len(Q), self.m, self.n))
        for k, q in enumerate(Q):
            Z[k], J[k] = self.task._linearize(q)
        return Z, J

    def minus(self, Z1: Array, Z0: Array) -> Float[Array, "K m"]:
        """Steps from Z0 to Z1; either may have one row for all."""
        count = max(len(Z1), len(Z0))
        pairs = zip(*(np.broadcast_to(Z, (count, self.size)) for Z in (Z1, Z0)), strict=True)
        return np.reshape([self.task._minus(z1, z0) for z1, z0 in pairs], (count, self.m))

    def search(
        self,
        Q: Float[Array, "K n"],
        Z: Array,
        lower: JointVector,
        upper: JointVector,
        tol: float,
        most: int,
        first: bool,
    ) -> tuple[Float[Array, "L n"], Float[Array, " L"], Int[Array, " L"]]:
        """Search from each row of Q for the task point in the same row of Z, or in its only one.

        With `first` the search ends at the first that is found. The joints, task errors and steps of those tried.
        """
        found, left, steps = np.array(Q), np.empty(len(Q)), np.empty(len(Q), dtype=np.int64)
        tried = len(Q)
        for k, q in enumerate(Q):
            z = Z[k if len(Z) > 1 else 0]
            found[k], left[k], steps[k] = descend(self.task, q, z, (lower, upper), tol=tol, most=most)
            if first and left[k] <= tol:
                tried = k + 1
                break
        return found[:tried], left[:tried], steps[:tried]

    def one(
        self, q: JointVector, z: Vector, lower: JointVector, upper: JointVector, tol: float, most: int
    ) -> tuple[JointVector, float]:
        """Search from one state: joints and the task error that is left."""
        found, left, _ = descend(self.task, q, z, (lower, upper), tol=tol, most=most)
        return found, left


def descend(
    task: TaskFunctions,
    q: JointVector,
    z: Vector,
    bounds: tuple[JointVector, JointVector],
    *,
    tol: float,
    most: int = 60,
) -> tuple[JointVector, float, int]:
    """Search for joints at a task point, by Levenberg and Marquardt's method within bounds.

    The step Jᵀ(J Jᵀ + μ e·e)⁻¹e, with e the error left, is Newton's shortest near a solution and a small one downhill
    far away. Joints that it would push across their bounds stay where they are. It ends early where it gets stuck.

    Args:
        task: The task.
        q: Where to begin.
        z: Task point to reach.
        bounds: Least and largest value of each joint.
        tol: Largest task error that may be left [m, rad].
        most: Most steps.

    Returns:
        Joints, the task error that is left, the largest entry [m, rad], and the number of steps that were tried.
    """
    lower, upper = bounds
    q = np.minimum(np.maximum(q, lower), upper)
    z_q, J = task._linearize(q)
    error = task._minus(z, z_q)
    square, mu, slow, iteration = float(error.dot(error)), DAMPING, 0, 0
    if not math.isfinite(square):
        return q, math.inf, 0
    while max(map(abs, error.tolist())) > tol and iteration < most and slow < PATIENCE:
        iteration += 1
        uphill = J.T.dot(error)
        stuck = (q <= lower) & (uphill < 0.0) | (q >= upper) & (uphill > 0.0)
        free = np.where(stuck, 0.0, J) if stuck.any() else J
        A = free.dot(free.T)
        A.flat[:: task.m + 1] += mu * square + FLOOR
        _, solution, info = lapack.dposv(A, error)
        if info:
            break
        step = free.T.dot(solution)
        longest = max(map(abs, step.tolist()))
        if longest > LONGEST:
            step *= LONGEST / longest
        ahead = np.minimum(np.maximum(q + step, lower), upper)
        z_q, J_ahead = task._linearize(ahead)
        error_ahead = task._minus(z, z_q)
        square_ahead = float(error_ahead.dot(error_ahead))
        slow = 0 if square_ahead < 0.9 * square else slow + 1
        if square_ahead < square:
            q, J, error, square, mu = ahead, J_ahead, error_ahead, square_ahead, 0.25 * mu
        else:
            mu *= 8.0
    return q, max(map(abs, error.tolist())), iteration
