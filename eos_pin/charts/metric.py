"""Metrics of charts: symmetric positive matrices A that define orthogonal directions at a base point.

The identity makes the charts of the paper. The mass matrix makes charts that are inertially decoupled at the base
point.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack

from eos_pin._arrays import Array, Jacobian, JointVector, Matrix, as_floats, called, frozen_copy
from eos_pin.charts._basis import RANK_TOLERANCE, check_rank
from eos_pin.errors import FunctionError, InputError
from eos_pin.robot.model import Robot

#: A metric: `"identity"`, `"inertial"` for the mass matrix at the base, a matrix, or a function of the base joints.
MetricLike: TypeAlias = "str | np.ndarray | Sequence[Sequence[float]] | Callable[[JointVector], Array]"

#: How far A may be from symmetric, relative to its largest entry.
SYMMETRIC = 1e-9
#: Least ratio of two diagonal entries of the Cholesky factor of A; below, solving with A is mostly rounding.
DEFINITE = 1e-6


def checked_metric(metric: MetricLike, robot: Robot) -> MetricLike:
    """A metric that fits a robot, matrices as read-only copies.

    Raises:
        InputError: It is neither of the two words, nor a symmetric positive matrix, nor a function.
        RobotError: It is `"inertial"`, and the robot has no valid inertia.
    """
    if isinstance(metric, str):
        if metric not in ("identity", "inertial"):
            raise InputError(
                f"a metric is 'identity', 'inertial', a symmetric positive matrix, or a function of q; got {metric!r}"
            )
        if metric == "inertial":
            robot.check_dynamics()
        return metric
    if callable(metric):
        return metric
    A = frozen_copy(_symmetric(metric, robot.n))
    _factor(A)
    return A


def metric_name(metric: MetricLike) -> str:
    """Name of a metric in a record: its word, `"matrix"` or `"function"`."""
    return metric if isinstance(metric, str) else "function" if callable(metric) else "matrix"


@dataclass(frozen=True, eq=False)
class Weights:
    """A metric A at one base point, factored.

    Attributes:
        A: The symmetric positive matrix, (n, n).
        L: Its lower Cholesky factor, A = L Lᵀ.
    """

    A: Float[Array, "n n"]
    L: Float[Array, "n n"]

    @classmethod
    def from_metric(cls, metric: MetricLike, robot: Robot, q: JointVector) -> Weights | None:
        """The metric at q; None for the identity, which needs no weights.

        Raises:
            InputError: A matrix is not a metric of this robot.
            FunctionError: A function raised, or returned no metric.
        """
        if isinstance(metric, str) and metric == "identity":
            return None
        if callable(metric):
            try:
                A = frozen_copy(_symmetric(called("the function of a metric", metric, q), robot.n))
                return cls(A, _factor(A))
            except InputError as error:
                raise FunctionError(f"the function of a metric returned no metric: {error}") from None
        A = frozen_copy(robot._mass(q) if isinstance(metric, str) else _symmetric(metric, robot.n))
        return cls(A, _factor(A))

    def solve(self, X: Matrix) -> Matrix:
        """A⁻¹ X."""
        return self.whitened.dot(self.whitened.T.dot(X))

    @cached_property
    def whitened(self) -> Float[Array, "n n"]:
        """L⁻ᵀ; in the coordinates Lᵀ q the metric is the identity."""
        # OpenBLAS starts its threads for triangular systems whatever their size.
        return frozen_copy(np.linalg.inv(self.L).T)

    def orthonormal(self, X: Matrix) -> Matrix:
        """Basis Y of the columns' span of X with Yᵀ A Y = I."""
        return self.whitened.dot(np.linalg.qr(self.L.T.dot(X))[0])


def _symmetric(values: Sequence[Sequence[float]] | Array, n: int) -> Array:
    """The symmetric part of a matrix that is symmetric but for rounding."""
    A = as_floats(values, "a metric")
    if A.shape != (n, n):
        raise InputError(f"a metric must be a matrix of shape ({n}, {n}), a row and a column per joint; got {A.shape}")
    if not np.isfinite(A).all():
        raise InputError("a metric must be finite; it has entries that are infinite or NaN")
    gap = float(np.abs(A - A.T).max())
    if gap > SYMMETRIC * float(np.abs(A).max()):
        raise InputError(f"a metric must be symmetric; entries differ by {gap:.3g} from those across the diagonal")
    return 0.5 * (A + A.T)


def _factor(A: Matrix) -> Matrix:
    """Cholesky factor of a metric.

    Raises:
        InputError: It is not positive, or so nearly singular that charts would be rounding.
    """
    L, info = lapack.dpotrf(A, lower=1, clean=1)
    diagonal = L.diagonal()
    if info or not diagonal.min() > DEFINITE * diagonal.max():
        values = np.linalg.eigvalsh(A)
        raise InputError(
            f"a metric must be positive definite; its eigenvalues go from {values[0]:.3g} to {values[-1]:.3g}. Every "
            "direction of the joints needs a weight above zero, and weights within about twelve orders of magnitude"
        )
    return frozen_copy(L)


def cosine(J: Jacobian, Q: Float[Array, "n m"], *, enough: float, given: Jacobian) -> float:
    """Cosine of the largest principal angle between the row space of J and the span of Q.

    Args:
        J: Jacobian, in coordinates in which the metric is the identity.
        Q: Orthonormal basis of the other space.
        enough: Where a lower bound exceeds this, it is returned instead, at a third of the cost: the product of the
            cosines of all principal angles, |det(J Q)| / √det(J Jᵀ).
        given: The Jacobian in joints, by which full rank is decided.

    Raises:
        SingularError: The Jacobian has not full rank.
    """
    JQ, (L, info) = J.dot(Q), lapack.dpotrf(J.dot(J.T), lower=1)
    diagonal = L.diagonal().tolist()
    if info or min(diagonal) <= RANK_TOLERANCE * max(diagonal):
        check_rank(given)
    elif enough < 1.0:
        LU, _, _ = lapack.dgetrf(JQ)
        product = abs(math.prod(LU.diagonal().tolist())) / math.prod(diagonal)
        if product > enough:
            return product
    # OpenBLAS starts its threads for dtrtrs whatever the size, which can take a thousand times as long.
    _, _, cosines, _ = lapack.dgesv(L, JQ)
    return float(np.linalg.svd(cosines, compute_uv=False)[-1])
