"""Charts: joints as an explicit function q = y(z, v) of the task and of self-motion coordinates.

Around a base configuration q_bar the joints are split along two constant, mutually orthogonal sets of directions,
U = G'(q_bar)ᵀ and an orthonormal basis V of the null space of G'(q_bar). The self-motion coordinates v = Vᵀ q, up to a
constant, are the position along V; u = h(z, v) is then fixed by the task, and so are B, D, H, E of Sec. 3.
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
from eos_pin.charts._basis import RANK_TOLERANCE, Basis, carried, check_rank, iterated_inverse, null_basis
from eos_pin.charts._newton import Inverse, newton, walk
from eos_pin.errors import ChartError, InverseError, Renamed
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks.base import Point, Task, TaskPoint

#: Up to this many joints one n × n solve is cheaper than the m × m form with its extra products.
DENSE_SOLVE = 16
#: A chart ends where a continuous joint has turned this far from its base, before the other side of the circle [rad].
TURN = 2.8
EDGE = "G'U is singular: this configuration is on the edge of the chart; make a chart at it"


@dataclass(frozen=True, eq=False)
class Chart(Checked):
    """A neighbourhood of q_bar on which (z, v) are coordinates of the robot; made by `Chart.from_base`.

    Attributes:
        task: The task z = G(q).
        q_bar: Base configuration.
        z_bar: Its task point.
        v_bar: Its self-motion coordinates, (r,).
        U: Transposed Jacobian at q_bar, (n, m); Eq. (10).
        B_bar: (UᵀU)⁻¹, (m, m); Eq. (15) at q_bar.
        basis: Orthonormal basis V of the Jacobian's null space at q_bar; for many joints it is not written out.
        row_basis: Orthonormal basis of its row space there, (n, m).
    """

    task: Task
    q_bar: JointVector
    z_bar: Point
    v_bar: SelfMotionVector
    U: Float[Array, "n m"]
    B_bar: Float[Array, "m m"]
    basis: Basis
    row_basis: Float[Array, "n m"]
    at = Renamed("from_base")

    @classmethod
    @checked
    def from_base(cls, task: Task, q: JointsLike, *, previous: Chart | None = None) -> Chart:
        """Chart with base point q.

        Args:
            task: The task.
            q: Base configuration; for continuous joints by the angle nearest to the base of `previous`.
            previous: Chart that is left. v continues its value there, and V is turned within the null space to lie
                as close to the previous V as it can (orthogonal Procrustes), so that dv = Vᵀ dq jumps the least.

        Raises:
            SingularError: G'(q) has not full rank.
            InputError: q has the wrong length or is not finite.
        """
        q = task.robot.posture(q, "the base configuration q")
        q_bar = frozen_copy(q if previous is None else previous._unwrap(q))
        z_bar, J = task._linearize(q_bar)
        check_rank(J)
        row_basis = frozen_copy(np.linalg.qr(J.T)[0])
        if previous is None:
            v_bar, basis = np.zeros(task.robot.n - task.m), null_basis(J, row_basis)
        else:
            v_bar, basis = previous._v(q_bar), carried(previous.basis, previous.row_basis, row_basis)
        z_bar, v_bar, U, B_bar = (frozen_copy(array) for array in (z_bar, v_bar, J.T, np.linalg.inv(J @ J.T)))
        return cls(task, q_bar, z_bar, v_bar, U, B_bar, basis, row_basis)

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
        """Whether q, not unwrapped, is so near to the base point that `room` is left for certain."""
        far = q - self.q_bar
        return bool(far.dot(far) < TURN**2)

    @checked
    def room(self, q: JointVector) -> float:
        """How much further a continuous joint may turn before the chart ends [rad]; infinite without such joints."""
        if not self.task.robot.turns:
            return math.inf
        far = np.abs(self._unwrap(q) - self.q_bar)
        return TURN - float(far.max(where=self.task.robot.continuous, initial=0.0))

    @checked
    def v(self, q: JointVector) -> SelfMotionVector:
        """Self-motion coordinates v = v_bar + Vᵀ(q − q_bar), continuous joints wrapped or not; from Eq. (11)."""
        return self.basis.project(self._unwrap(q) if self.task.robot.turns else q) + self._v_zero

    @checked
    def u(self, q: JointVector) -> TaskVector:
        """Coordinates u along U of a configuration, −(UᵀU)⁻¹Uᵀ(q − q_bar); from Eq. (11)."""
        return -self.B_bar.dot(self.U.T.dot(self._unwrap(q) - self.q_bar))

    @checked
    def q(self, v: SelfMotionVector, u: TaskVector) -> JointVector:
        """Joints q = q_bar + V(v − v_bar) − U u; Eq. (11)."""
        return self.q_bar + self.basis.apply(v - self.v_bar) - self.U.dot(u)

    @checked
    def dv(self, dq: JointVector) -> SelfMotionVector:
        """Self-motion velocity Vᵀ dq; Eqs. (19), (27)."""
        return self.basis.project(dq)

    @property
    def V(self) -> Float[Array, "n r"]:
        """Orthonormal basis of the Jacobian's null space at q_bar, written out; Eq. (10)."""
        return self.basis.matrix

    @cached_property
    def Vt(self) -> Float[Array, "r n"]:
        """Vᵀ, laid out for fast products."""
        return frozen_copy(np.ascontiguousarray(self.V.T))

    @cached_property
    def _v_zero(self) -> SelfMotionVector:
        return self.v_bar - self.basis.project(self.q_bar)

    @checked
    def margin(self, J: Jacobian, *, enough: float = math.inf) -> float:
        """How far a configuration with Jacobian J is from the edge of the chart: 1 at the base point, 0 on the edge.

        Cosine of the largest principal angle between the row spaces of J and of G'(q_bar). G'U is singular, and H
        does not exist, exactly where it is zero while J has full rank.

        Args:
            J: Jacobian G'(q).
            enough: Where a lower bound exceeds this, it is returned instead, at a third of the cost: the product of the
                cosines of all principal angles, |det(J Q)| / √det(J Jᵀ).

        Raises:
            SingularError: J itself has not full rank.
        """
        JQ, (L, info) = J.dot(self.row_basis), lapack.dpotrf(J.dot(J.T), lower=1)
        diagonal = L.diagonal().tolist()
        if info or min(diagonal) <= RANK_TOLERANCE * max(diagonal):
            check_rank(J)
        elif enough < 1.0:
            LU, _, _ = lapack.dgetrf(JQ)
            product = abs(math.prod(LU.diagonal().tolist())) / math.prod(diagonal)
            if product > enough:
                return product
        # OpenBLAS starts its threads for dtrtrs whatever the size, which can take a thousand times as long.
        _, _, cosines, _ = lapack.dgesv(L, JQ)
        return float(np.linalg.svd(cosines, compute_uv=False)[-1])

    @checked
    def contains(self, J: Jacobian, threshold: float) -> bool:
        """Whether `margin(J)` exceeds `threshold`."""
        return self._margin(J, enough=threshold) > threshold

    # -- derivatives -------------------------------------------------------------------------------------------------

    @checked
    def point(self, q: JointVector, dq: JointVector) -> ChartPoint:
        """Velocity and acceleration kinematics at a state of the robot; Eqs. (15)–(20)."""
        return ChartPoint(self, self._unwrap(q), dq, self.task._at(q, dq))

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
        """Joint acceleration ddq with J ddq = `task` and Vᵀ ddq = `self_motion`.

        With `task` = ddz − drift and `self_motion` = ddv this is H ddw + E of Eq. (20), without forming H or E; with dz
        and dv it is dq = H dw of Eq. (17).

        Raises:
            ChartError: [G'; Vᵀ] is singular.
        """
        A, b, lifted = self._system(J, np.concatenate((task, self_motion)))
        _, _, x, info = lapack.dgesv(A, b)
        if info:
            raise ChartError(EDGE)
        return x if lifted is None else lifted + self.row_basis.dot(x)

    @checked
    def system(self, J: Jacobian, F: JointVector) -> tuple[Array, Array, JointVector | None]:
        """A and b of A x = b; x is the acceleration that `F` asks for, for many joints its part beside V F_v.

        Args:
            J: Jacobian G'(q).
            F: Acceleration of w = (z, v), the task's part without its drift, (n,).

        Returns:
            A, b, and V F_v; without the last, x is all.
        """
        n, m = self.U.shape
        if n <= DENSE_SOLVE:
            A = self._stacked
            A[:m] = J
            return A, F, None
        lifted = self.basis.apply(F[m:])
        return J.dot(self.row_basis), F[:m] - J.dot(lifted), lifted

    @cached_property
    def _stacked(self) -> Float[Array, "n n"]:
        """Workspace for [G'; Vᵀ], where G' is filled in, in the order LAPACK wants."""
        return np.asfortranarray(np.vstack((self.U.T, self.V.T)))

    # -- inverse kinematics ------------------------------------------------------------------------------------------

    @checked
    def inverse(
        self,
        z: Point,
        v: SelfMotionVector,
        *,
        start: Inverse | None = None,
        refresh: bool = True,
        walking: bool = True,
        tol: float = 1e-10,
        max_iterations: int = 20,
    ) -> Inverse:
        """Joints at the task point z and the self-motion coordinates v; Eqs. (13), (22).

        Newton's method from `start`. Where it does not converge, walk there along the straight line from the known
        point, so that the solution found is the one that is connected to it.

        Args:
            z: Task point.
            v: Self-motion coordinates, (r,).
            start: A solution nearby; the base point by default.
            refresh: Compute B anew after the first step, wherever that pays (best for long steps), or keep that of
                `start` as in Eq. (22) (best for short steps along a path).
            walking: Whether to walk where Newton's method does not converge at once.
            tol: Largest task error that is left [m, rad].
            max_iterations: Newton steps allowed at one point.

        Raises:
            InverseError: Not even a short step towards (z, v) converges: the chart ends before. It has the residual.
        """
        start = start or self._base
        found = self._newton(z, v, start, refresh, tol, max_iterations)
        if found.residual <= tol:
            return found
        current, iterations = start, found.iterations

        def visit(z_next: Point, v_next: SelfMotionVector) -> bool:
            nonlocal current, iterations
            trial = self._newton(z_next, v_next, current, True, tol, max_iterations)
            iterations += trial.iterations
            if trial.residual > tol:
                return False
            current = trial
            return True

        reached = 0.0
        if walking:
            reached = walk(self.task, (self.task._value(start.q), self._v(start.q)), (z, v), visit)
        if reached < 1.0:
            residual = float(np.abs(self.task._minus(self.task._value(current.q), z)).max())
            raise InverseError(
                f"no joints on this chart have the task point asked for: {reached:.1%} of the way from the known "
                f"point the chart ends or the point is out of reach (task error {residual:.3g} left after {iterations} "
                "Newton steps). Start nearer, or follow the path with an Atlas, which changes charts",
                residual,
                iterations,
            )
        return current._replace(iterations=iterations)

    # -- the same without checks, for inner loops ----------------------------------------------------------------------

    _unwrap, _is_near, _room = unchecked(unwrap), unchecked(is_near), unchecked(room)
    _v, _u, _q, _dv = unchecked(v), unchecked(u), unchecked(q), unchecked(dv)
    _margin, _contains, _point, _B = unchecked(margin), unchecked(contains), unchecked(point), unchecked(B)
    _acceleration, _system, _inverse = unchecked(acceleration), unchecked(system), unchecked(inverse)

    @cached_property
    def _base(self) -> Inverse:
        """The base point, from where a solve starts if nothing nearer is known."""
        return Inverse(self.q_bar, np.zeros(self.m), self.B_bar, 0, 0.0)

    def _newton(
        self, z: Point, v: SelfMotionVector, start: Inverse, refresh: bool, tol: float, max_iterations: int
    ) -> Inverse:
        base = self.q_bar + self.basis.apply(v - self.v_bar)
        return newton(self.task, base, self.U, z, start, refresh, tol, max_iterations)


@dataclass(frozen=True, eq=False)
class ChartPoint:
    """Kinematics of a chart at one state; each matrix is computed when it is asked for.

    Attributes:
        chart: The chart.
        q: Joints.
        dq: Joint velocities.
        task: z, J, dz and drift there.
    """

    chart: Chart
    q: JointVector
    dq: JointVector
    task: TaskPoint

    @cached_property
    def v(self) -> SelfMotionVector:
        """Self-motion coordinates; Eq. (11)."""
        return self.chart._v(self.q)

    @cached_property
    def dv(self) -> SelfMotionVector:
        """Self-motion velocity Vᵀ dq; Eqs. (19), (27)."""
        return self.chart._dv(self.dq)

    @cached_property
    def dw(self) -> JointVector:
        """Velocity of w = (z, v), (n,); Eq. (19)."""
        return np.concatenate((self.task.dz, self.dv))

    @cached_property
    def B(self) -> Float[Array, "m m"]:
        """(G'U)⁻¹; Eq. (15)."""
        return self.chart._B(self.task.J)

    @cached_property
    def D(self) -> Float[Array, "n r"]:
        """(I − U B G')V, a basis of the null space of G' at q; Eq. (16)."""
        V = self.chart.V
        return V - self.chart.U @ (self.B @ (self.task.J @ V))

    @cached_property
    def H(self) -> Float[Array, "n n"]:
        """[U B, D], with dq = H dw; Eq. (17)."""
        return np.hstack((self.chart.U @ self.B, self.D))

    @cached_property
    def H_inverse(self) -> Float[Array, "n n"]:
        """[G'; Vᵀ]; Eq. (18)."""
        return np.vstack((self.task.J, self.chart.V.T))

    @cached_property
    def E(self) -> JointVector:
        """−U B Ġ' dq, with ddq = H ddw + E; Eq. (20)."""
        return -self.chart.U @ (self.B @ self.task.drift)
