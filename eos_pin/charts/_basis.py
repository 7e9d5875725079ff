"""Bases of null spaces, carried from chart to chart, and the linear algebra that charts need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from operator import ne
from typing import TypeAlias

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int
from scipy.linalg import lapack

from eos_pin._arrays import (
    Array,
    Jacobian,
    Matrix,
    frozen_copy,
)
from eos_pin.errors import ChartError, SingularError

#: G' counts as rank deficient where its smallest singular value falls below this fraction of the largest.
RANK_TOLERANCE = 1e-7


def rank_of(J: Jacobian) -> tuple[int, list[float]]:
    """Rank and singular values of a Jacobian."""
    values = np.linalg.svd(J, compute_uv=False)
    return int((values > RANK_TOLERANCE * values[0]).sum()), values.tolist()


def check_rank(J: Jacobian) -> None:
    """Refuse a Jacobian without full rank.

    Raises:
        SingularError: It has the rank and the singular values.
    """
    rank, values = rank_of(J)
    if rank < J.shape[0]:
        raise SingularError(
            f"the task is singular here: its Jacobian has rank {rank} of {J.shape[0]} (singular values "
            f"{', '.join(f'{s:.2g}' for s in values)}). Move away from this configuration, or drop the lost direction "
            "from the task",
            rank,
            values,
        )


def solve_gram(J: Jacobian, Y: Float[Array, "n m"], b: Array, lacks: str) -> Array:
    """Solution x of J Y x = b, where J Y is symmetric, and positive if J has full rank.

    Args:
        J: Jacobian.
        Y: X⁻¹Jᵀ for a symmetric positive X.
        b: Right side, a vector or columns.
        lacks: End of the message where J Y is not positive although J has full rank.

    Raises:
        SingularError: J has not full rank.
    """
    R, x, info = lapack.dposv(J.dot(Y), b)
    diagonal = R.diagonal().tolist()
    if info or min(diagonal) <= RANK_TOLERANCE * max(diagonal):
        check_rank(J)
    if info:
        raise SingularError(f"the task is singular here: {lacks}")
    return np.asarray(x)


def null_space(J: Jacobian) -> Float[Array, "n r"]:
    """Orthonormal basis of the null space of J, the same on every machine: the sign of each column is fixed."""
    m = J.shape[0]
    V = scipy.linalg.qr(J.T)[0][:, m:]
    size = np.abs(V)
    # The last entry of about the largest size is positive; ties within rounding then cannot flip the sign.
    about = size >= 0.5 * size.max(axis=0, initial=0.0)
    last = V.shape[0] - 1 - about[::-1].argmax(axis=0)
    V[:, V[last, range(V.shape[1])] < 0.0] *= -1.0
    return V


def iterated_inverse(A: Matrix, B: Matrix, *, tol: float) -> Matrix:
    """Inverse of A by products only, from an approximation B; Eq. (21).

    Raises:
        ChartError: The iteration does not converge from B.
    """
    for _ in range(60):
        product = A @ B
        error = np.abs(product - np.eye(len(A))).max()
        if error <= tol:
            return B
        # Each iteration squares the residual, so one that is large will not come back.
        if not error < 1e6:
            break
        B = 2.0 * B - B @ product
    raise ChartError(f"the iteration for B diverges from this start (residual {error:.3g}); solve directly instead")


def is_odd(LU: Array, pivots: Array) -> bool:
    """Whether the determinant of a factored matrix is negative."""
    negative, swapped = map((0.0).__gt__, LU.diagonal().tolist()), map(ne, pivots.tolist(), count())
    return (sum(negative) + sum(swapped)) % 2 == 1


#: Up to this many joints V is written out, which is faster.
DENSE = 40
#: Columns of F and P beyond which those that count for nothing are looked for.
COLUMNS = 32
#: What counts for nothing, as a part of V.
NEGLIGIBLE = 1e-15


@dataclass(frozen=True, eq=False)
class DenseBasis:
    """A basis V that is written out.

    Attributes:
        matrix: V.
    """

    matrix: Float[Array, "n r"]

    @cached_property
    def apply(self) -> Callable[[Array], Array]:
        """The product V y, of a vector or of the columns of a matrix."""
        return self.matrix.dot

    @cached_property
    def project(self) -> Callable[[Array], Array]:
        """The product Vᵀ x, of a vector or of the columns of a matrix."""
        # Laid out for fast products.
        return frozen_copy(np.ascontiguousarray(self.matrix.T)).dot

    def less(self, F: Float[Array, "n m"], P: Float[Array, "r m"]) -> DenseBasis:
        """V − F Pᵀ."""
        return DenseBasis(frozen_copy(self.matrix - F @ P.T))


@dataclass(frozen=True, eq=False)
class SparseBasis:
    """A basis V = I_r − F Pᵀ, with the same products.

    Attributes:
        joints: Joints whose unit vectors are the columns of I_r, (r,).
        F: Left factor, (n, k).
        P: Right factor, (r, k).
        columns: How large k may become before negligible columns are looked for.
    """

    joints: Int[Array, " r"]
    F: Float[Array, "n k"]
    P: Float[Array, "r k"]
    columns: int = COLUMNS

    @cached_property
    def matrix(self) -> Float[Array, "n r"]:
        """V, written out."""
        return frozen_copy(self.apply(np.eye(len(self.joints))))

    def apply(self, y: Array) -> Array:
        """The product V y, of a vector or of the columns of a matrix."""
        x = -self.F.dot(self.P.T.dot(y))
        x[self.joints] += y
        return x

    def project(self, x: Array) -> Array:
        """The product Vᵀ x, of a vector or of the columns of a matrix."""
        return x[self.joints] - self.P.dot(self.F.T.dot(x))

    def less(self, F: Float[Array, "n m"], P: Float[Array, "r m"]) -> SparseBasis | DenseBasis:
        """V − F Pᵀ."""
        F, P, columns = np.hstack((self.F, F)), np.hstack((self.P, P)), self.columns
        if F.shape[1] > columns:
            # A motion that repeats comes through the same null spaces again, so the rank of F Pᵀ stops growing.
            (F, R), (P, S) = np.linalg.qr(F), np.linalg.qr(P)
            X, s, Yt = np.linalg.svd(R @ S.T, full_matrices=False)
            kept = s > NEGLIGIBLE
            F, P = F @ (X[:, kept] * s[kept]), P @ Yt[kept].T
            columns = max(columns, 2 * F.shape[1])
        basis = SparseBasis(self.joints, frozen_copy(F), frozen_copy(P), columns)
        # Beyond half of r columns the products would take longer than with V written out.
        return basis if columns < len(self.joints) else DenseBasis(basis.matrix)


Basis: TypeAlias = DenseBasis | SparseBasis


def null_basis(J: Jacobian, Q: Float[Array, "n m"]) -> Basis:
    """Basis of the null space of J, the same on every machine.

    For many joints it is the one that lies nearest to the unit vectors of all joints but m.

    Args:
        J: Jacobian of full rank.
        Q: Orthonormal basis of its row space.
    """
    m, n = J.shape
    if n <= DENSE:
        return DenseBasis(frozen_copy(null_space(J)))
    # Joints whose columns of J are as large and as different as can be: pivots of a QR factorization.
    pivots, left = [], Q.T
    for _ in range(m):
        size = (left * left).sum(axis=0)
        # The last one of about the largest size; ties within rounding then cannot change it.
        pivots.append(int(np.flatnonzero(size >= 0.5 * size.max())[-1]))
        column = left[:, pivots[-1]]
        left = left - np.outer(column, column @ left) / size[pivots[-1]]
    joints = np.delete(np.arange(n), pivots)
    units = SparseBasis(frozen_copy(joints, int), np.zeros((n, 0)), np.zeros((n - m, 0)))
    dropped = np.zeros((n, m))
    dropped[pivots, range(m)] = 1.0
    return carried(units, dropped, Q)


def carried(basis: Basis, old: Float[Array, "n m"], new: Float[Array, "n m"]) -> Basis:
    """The basis of another null space that lies nearest to `basis`: orthogonal Procrustes, without an r × r matrix.

    It is `basis`, turned by the direct rotation of one null space onto the other, which moves vectors in the span of
    both row spaces only.

    Args:
        basis: Basis V of the one null space.
        old: Orthonormal basis of the row space that belongs to it.
        new: Orthonormal basis of the other row space.
    """
    X, cosines, Yt = np.linalg.svd(old.T @ new)
    # Principal vectors: column i of `new` is column i of `old` X, turned by angle i towards V P_i, whose length is its
    # sine.
    new = new @ Yt.T
    P = basis.project(new)
    F = basis.apply(P / (1.0 + cosines)) + old @ X
    # newᵀ(V − F Pᵀ) is zero because newᵀF = I, which is restored lest rounding errors collect from chart to chart.
    F += new @ (np.eye(len(cosines)) - new.T @ F)
    return basis.less(F, P)
