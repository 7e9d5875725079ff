"""Orthonormal bases V of null spaces: made, carried from chart to chart, and multiplied without being written out.

A basis for many joints is kept as V = I_r − F Pᵀ, where the columns of I_r are unit vectors of single joints and F and
P have few columns, so that products with V and Vᵀ take time in proportion to n. Carried to another null space it has
this form again, with m columns more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from eos_pin.arrays import Array, Jacobian, readonly
from eos_pin.linear import null_space

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
        return readonly(np.ascontiguousarray(self.matrix.T)).dot

    def less(self, F: Float[Array, "n m"], P: Float[Array, "r m"]) -> DenseBasis:
        """V − F Pᵀ."""
        return DenseBasis(readonly(self.matrix - F @ P.T))


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
        return readonly(self.apply(np.eye(len(self.joints))))

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
        basis = SparseBasis(self.joints, readonly(F), readonly(P), columns)
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
        return DenseBasis(readonly(null_space(J)))
    # Joints whose columns of J are as large and as different as can be: pivots of a QR factorization.
    pivots, left = [], Q.T
    for _ in range(m):
        size = (left * left).sum(axis=0)
        # The last one of about the largest size; ties within rounding then cannot change it.
        pivots.append(int(np.flatnonzero(size >= 0.5 * size.max())[-1]))
        column = left[:, pivots[-1]]
        left = left - np.outer(column, column @ left) / size[pivots[-1]]
    joints = np.delete(np.arange(n), pivots)
    units = SparseBasis(readonly(joints, int), np.zeros((n, 0)), np.zeros((n - m, 0)))
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
