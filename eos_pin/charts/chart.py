"""Charts: joints as an explicit function q = y(z, v) of the task and of self-motion coordinates.

Around a base configuration q_bar the joints are split along constant `Directions` U and V. The self-motion coordinates
v are the position along V; u = h(z, v), that along U, is then fixed by the task, and so are B, D, H, E of Sec. 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Jacobian, JointVector, SelfMotionVector, brief, checked, frozen_copy, unchecked
from eos_pin.charts._basis import carried, check_rank, null_basis
from eos_pin.charts._newton import Inverse, newton, walk
from eos_pin.charts.directions import Directions
from eos_pin.charts.metric import MetricLike, Weights, checked_metric
from eos_pin.errors import InverseError, Renamed
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks.base import Point, Task, TaskPoint


@brief("task", "q_bar", "v_bar")
@dataclass(frozen=True, eq=False)
class Chart(Directions):
    """A neighbourhood of q_bar on which (z, v) are coordinates of the robot; made by `Chart.from_base`.

    Attributes:
        task: The task z = G(q).
        q_bar: Base configuration.
        z_bar: Its task point.
        v_bar: Its self-motion coordinates, (r,).
        U: A⁻¹G'ᵀ at q_bar, (n, m); Eq. (10), where A = I.
        B_bar: (G'U)⁻¹, (m, m); Eq. (15) at q_bar.
        basis: Orthonormal basis V of the Jacobian's null space at q_bar; for many joints it is not written out.
        row_basis: Orthonormal basis of its row space there, (n, m).
        metric: The metric A, as it was given.
        weights: A at q_bar; None for the identity.
        dual: W with WᵀV = I and WᵀU = 0; V itself where A = I.
        u_basis: Orthonormal basis of the columns of U, (n, m); `row_basis` itself where A = I.
    """

    at = Renamed("from_base")

    @classmethod
    @checked
    def from_base(
        cls, task: Task, q: JointsLike, *, metric: MetricLike | None = None, previous: Chart | None = None
    ) -> Chart:
        """Chart with base point q.

        Args:
            task: The task.
            q: Base configuration; for continuous joints by the angle nearest to the base of `previous`.
            metric: The metric A: `"identity"`, as in the paper; `"inertial"`, the mass matrix at q, by which task and
                self-motion are inertially decoupled at q; a symmetric positive (n, n) matrix; or a function of q that
                returns one. By default that of `previous`, or the identity.
            previous: Chart that is left. v continues its value there, whatever its metric, and V is turned within the
                null space to lie as close to the previous V as it can (orthogonal Procrustes), so that for A = I
                dv = Vᵀ dq jumps the least.

        Raises:
            SingularError: G'(q) has not full rank.
            InputError: q has the wrong length or is not finite, or the metric is not one for this robot.
        """
        q = task.robot.posture(q, "the base configuration q")
        if metric is not None:
            metric = checked_metric(metric, task.robot)
        else:
            metric = "identity" if previous is None else previous.metric
        return cls._from_base(task, q, metric, previous)

    @classmethod
    def _from_base(cls, task: Task, q: JointVector, metric: MetricLike, previous: Chart | None) -> Chart:
        """The same for a metric that was checked."""
        q_bar = frozen_copy(q if previous is None else previous._unwrap(q))
        z_bar, J = task._linearize(q_bar)
        check_rank(J)
        row_basis = frozen_copy(np.linalg.qr(J.T)[0])
        if previous is None:
            v_bar, basis = np.zeros(task.robot.n - task.m), null_basis(J, row_basis)
        else:
            v_bar, basis = previous._v(q_bar), carried(previous.basis, previous.row_basis, row_basis)
        weights = Weights.from_metric(metric, task.robot, q_bar)
        if weights is None:
            U, B_bar, dual, u_basis = J.T, np.linalg.inv(J @ J.T), basis, row_basis
        else:
            U = weights.solve(J.T)
            B_bar, u_basis = np.linalg.inv(J @ U), frozen_copy(np.linalg.qr(U)[0])
            # W = A V (VᵀAV)⁻¹ in a form that needs no r × r matrix.
            dual = basis.less(J.T, basis.project(U @ B_bar))
        z_bar, v_bar, U, B_bar = (frozen_copy(array) for array in (z_bar, v_bar, U, B_bar))
        return cls(task, q_bar, z_bar, v_bar, U, B_bar, basis, row_basis, metric, weights, dual, u_basis)

    @checked
    def contains(self, J: Jacobian, threshold: float) -> bool:
        """Whether `margin(J)` exceeds `threshold`."""
        return self._margin(J, enough=threshold) > threshold

    # -- derivatives -------------------------------------------------------------------------------------------------

    @checked
    def point(self, q: JointVector, dq: JointVector) -> ChartPoint:
        """Velocity and acceleration kinematics at a state of the robot; Eqs. (15)–(20)."""
        return ChartPoint(self, self._unwrap(q), dq, self.task._at(q, dq))

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

    _contains, _point, _inverse = unchecked(contains), unchecked(point), unchecked(inverse)

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
        """Self-motion velocity Wᵀ dq; Eqs. (19), (27)."""
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
        """[G'; Wᵀ]; Eq. (18)."""
        return np.vstack((self.task.J, self.chart.W.T))

    @cached_property
    def E(self) -> JointVector:
        """−U B Ġ' dq, with ddq = H ddw + E; Eq. (20)."""
        return -self.chart.U @ (self.B @ self.task.drift)
