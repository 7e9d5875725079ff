"""Directions of a chart: the constant bases along which joints are split, their duals, and where they serve.

At a base configuration q_bar they are orthogonal in a metric A: U = A⁻¹G'(q_bar)ᵀ, and an orthonormal basis V of the
null space of G'(q_bar). Their duals are G' and W = A V (VᵀAV)⁻¹. In the paper's charts A = I, U = G'ᵀ and W = V.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack

from eos_pin._arrays import (
    Array,
    Checked,
    Jacobian,
    JointVector,
    SelfMotionVector,
    TaskVector,
    checked,
    frozen_copy,
    unchecked,
)
from eos_pin.charts._basis import DENSE, Basis, iterated_inverse
from eos_pin.charts.metric import MetricLike, Weights, cosine
from eos_pin.errors import ChartError
from eos_pin.tasks.base import Point, Task

#: A chart ends where a continuous joint has turned this far from its base, before the other side of the circle [rad].
TURN = 2.8
EDGE = "G'U is singular: this configuration is on the edge of the chart; make a chart at it"


@dataclass(frozen=True, eq=False)
class Directions(Checked):
    """Directions U and V at a base configuration, and the linear maps that are made of them.

    Its attributes are described at `Chart`, the class for use.
    """

    task: Task
    q_bar: JointVector
    z_bar: Point
    v_bar: SelfMotionVector
    U: Float[Array, "n m"]
    B_bar: Float[Array, "m m"]
    basis: Basis
    row_basis: Float[Array, "n m"]
    metric: MetricLike
    weights: Weights | None
    dual: Basis
    u_basis: Float[Array, "n m"]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.U.shape[0]

    @property
    def m(self) -> int:
        """Dimension of the task."""
        return self.U.shape[1]

    @property
    def r(self) -> int:
        """Degree of redundancy n − m."""
        return self.v_bar.size

    @checked
    def unwrap(self, q: JointVector) -> JointVector:
        """The same configuration, continuous joints at the angle nearest to the base point."""
        if not self.task.robot.turns:
            return q
        return q if self._is_near(q) else self.task.robot._unwrap(q, self.q_bar)

    @checked
    def is_near(self, q: JointVector) -> bool:
        """Whether q, not unwrapped, is certainly so near to the base point that `room` is positive."""
        far = q - self.q_bar
        return bool(far.dot(far) < TURN**2)

    @checked
    def room(self, q: JointVector) -> float:
        """Angle that a continuous joint may still turn before the chart ends [rad]; infinite without such joints."""
        if not self.task.robot.turns:
            return math.inf
        far = np.abs(self._unwrap(q) - self.q_bar)
        return TURN - float(far.max(where=self.task.robot.continuous, initial=0.0))

    @checked
    def v(self, q: JointVector) -> SelfMotionVector:
        """Self-motion coordinates v = v_bar + Wᵀ(q − q_bar), continuous joints wrapped or not; from Eq. (11)."""
        return self.dual.project(self._unwrap(q) if self.task.robot.turns else q) + self._v_zero

    @checked
    def u(self, q: JointVector) -> TaskVector:
        """Coordinates u along U of a configuration, −(G'U)⁻¹G'(q − q_bar), G' at the base; from Eq. (11)."""
        return -self.B_bar.dot(self.J_bar.dot(self._unwrap(q) - self.q_bar))

    @checked
    def q(self, v: SelfMotionVector, u: TaskVector) -> JointVector:
        """Joints q = q_bar + V(v − v_bar) − U u; Eq. (11)."""
        return self.q_bar + self.basis.apply(v - self.v_bar) - self.U.dot(u)

    @checked
    def dv(self, dq: JointVector) -> SelfMotionVector:
        """Self-motion velocity Wᵀ dq; Eqs. (19), (27)."""
        return self.dual.project(dq)

    @checked
    def along(self, gradient: JointVector) -> SelfMotionVector:
        """Slope Vᵀg along v of a function of the joints with gradient g, or v's part of torques g; at the base.

        Velocities and accelerations have Wᵀ instead, see `dv`; for A = I both are the same.
        """
        return self.basis.project(gradient)

    @property
    def V(self) -> Float[Array, "n r"]:
        """Orthonormal basis of the Jacobian's null space at q_bar, written out; Eq. (10)."""
        return self.basis.matrix

    @property
    def W(self) -> Float[Array, "n r"]:
        """A V (VᵀAV)⁻¹, written out: WᵀV = I and WᵀU = 0; V itself where A = I."""
        return self.dual.matrix

    @cached_property
    def Vt(self) -> Float[Array, "r n"]:
        """Vᵀ, laid out for fast products."""
        return frozen_copy(np.ascontiguousarray(self.V.T))

    @cached_property
    def Wt(self) -> Float[Array, "r n"]:
        """Wᵀ, laid out for fast products."""
        return self.Vt if self.dual is self.basis else frozen_copy(np.ascontiguousarray(self.W.T))

    @cached_property
    def J_bar(self) -> Float[Array, "m n"]:
        """G' at q_bar."""
        return self.U.T if self.weights is None else frozen_copy((self.weights.A @ self.U).T)

    @cached_property
    def _v_zero(self) -> SelfMotionVector:
        return self.v_bar - self.dual.project(self.q_bar)

    @checked
    def margin(self, J: Jacobian, *, enough: float = math.inf) -> float:
        """Distance of a configuration with Jacobian J from the edge of the chart: 1 at the base point, 0 on the edge.

        Cosine, in the metric A, of the largest principal angle between the null spaces of J and of G'(q_bar); for A = I
        that of their row spaces. G'U is singular, and H does not exist, exactly where it is zero while J has full rank.

        Args:
            J: Jacobian G'(q).
            enough: Where a lower bound exceeds this, it is returned instead, at a third of the cost.

        Raises:
            SingularError: J itself has not full rank.
        """
        if self.weights is None:
            return cosine(J, self.row_basis, enough=enough, given=J)
        return cosine(J.dot(self.weights.whitened), self._whitened_rows, enough=enough, given=J)

    @cached_property
    def _whitened_rows(self) -> Float[Array, "n m"]:
        """Orthonormal basis of the row space of G'(q_bar) in coordinates in which the metric is the identity."""
        assert self.weights is not None
        return frozen_copy(np.linalg.qr(self.J_bar.dot(self.weights.whitened).T)[0])

    @cached_property
    def _margin_factors(self) -> tuple[Float[Array, "m m"], Float[Array, "r n"]] | None:
        """T and Y with |T (G'Q)⁻¹ G'Yᵀ| the tangents of the angles that `margin` is of; None where they are I and Vᵀ.

        Q is `u_basis`, and the rows of Y are a basis of the null space at q_bar that is orthonormal in the metric.
        """
        if self.weights is None:
            return None
        T = self._whitened_rows.T.dot(self.weights.L.T.dot(self.u_basis))
        return frozen_copy(T), frozen_copy(self.weights.orthonormal(self.V).T)

    @checked
    def B(self, J: Jacobian, start: Float[Array, "m m"] | None = None, *, tol: float = 1e-12) -> Float[Array, "m m"]:
        """B = (G'U)⁻¹ where the Jacobian is J; Eq. (15).

        Args:
            J: Jacobian G'(q).
            start: Value at a point nearby. With it, B is found by the iteration of Eq. (21), which needs products only;
                without, by a direct m × m solve.
            tol: The iteration ends where no entry of G'U B − I exceeds this.

        Raises:
            ChartError: G'U is singular, or the iteration does not converge from `start`.
        """
        GU = J @ self.U
        if start is None:
            _, _, B, info = lapack.dgesv(GU, np.eye(self.m))
            if info:
                raise ChartError(EDGE)
            return B
        return iterated_inverse(GU, start, tol=tol)

    @checked
    def acceleration(self, J: Jacobian, task: TaskVector, self_motion: SelfMotionVector) -> JointVector:
        """Joint acceleration ddq with J ddq = `task` and Wᵀ ddq = `self_motion`.

        With `task` = ddz − drift and `self_motion` = ddv this is H ddw + E of Eq. (20), without forming H or E; with dz
        and dv it is dq = H dw of Eq. (17).

        Raises:
            ChartError: [G'; Wᵀ] is singular.
        """
        return self._solved(J, np.concatenate((task, self_motion)))

    @checked
    def acceleration_and_basis(
        self, J: Jacobian, task: TaskVector, self_motion: SelfMotionVector
    ) -> tuple[JointVector, Float[Array, "n r"]]:
        """`acceleration`, and D of Eq. (16), the columns that v may add to it, by one factorization.

        Raises:
            ChartError: [G'; Wᵀ] is singular.
        """
        F = np.eye(self.n, 1 + self.r, 1 - self.m)
        F[:, 0] = np.concatenate((task, self_motion))
        found = self._solved(J, F)
        return found[:, 0], found[:, 1:]

    def _solved(self, J: Jacobian, F: Array) -> Array:
        """Joint accelerations that `F` commands, as `_system` takes it."""
        A, b, lifted = self._system(J, F)
        _, _, x, info = lapack.dgesv(A, b)
        if info:
            raise ChartError(EDGE)
        return x if lifted is None else lifted + self.u_basis.dot(x)

    def _system(self, J: Jacobian, F: Float[Array, "n *columns"]) -> tuple[Array, Array, Array | None]:
        """Linear system for the joint acceleration that `F` commands: ddq is A⁻¹b, or V F_v + Q A⁻¹b for many joints.

        The second form needs no V that is written out: it is for chains of tens and hundreds of joints.

        Args:
            J: Jacobian G'(q).
            F: Acceleration of w = (z, v), the task's part without its drift, (n,), or several as columns.

        Returns:
            A, b, and V F_v; the last is None where ddq is A⁻¹b. Q is `u_basis`.
        """
        n, m = self.U.shape
        if n <= DENSE:
            A = self._stacked
            A[:m] = J
            return A, F, None
        lifted = self.basis.apply(F[m:])
        return J.dot(self.u_basis), F[:m] - J.dot(lifted), lifted

    @cached_property
    def _stacked(self) -> Float[Array, "n n"]:
        """Workspace for [G'; Wᵀ] in LAPACK's order, in which G' is filled in."""
        return np.asfortranarray(np.vstack((self.U.T, self.W.T)))

    # -- the same without checks, for inner loops ----------------------------------------------------------------------

    _unwrap, _is_near, _room = unchecked(unwrap), unchecked(is_near), unchecked(room)
    _v, _u, _q, _dv, _along = unchecked(v), unchecked(u), unchecked(q), unchecked(dv), unchecked(along)
    _margin, _B = unchecked(margin), unchecked(B)
    _acceleration, _acceleration_and_basis = unchecked(acceleration), unchecked(acceleration_and_basis)
