"""A control step in NumPy: tasks of one frame, and accelerations by a tracking law on a chart; `law` has it compiled.

Objects hold workspaces, so each is for one thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from numpy import subtract
from pinocchio import (
    LOCAL_WORLD_ALIGNED as WORLD,
)
from pinocchio import (
    computeJointJacobians,
    forwardKinematics,
    getFrameClassicalAcceleration,
    getFrameJacobian,
    updateFramePlacement,
)
from scipy.linalg.blas import ddot
from scipy.linalg.lapack import dgesv

from eos_pin._arrays import Array, Jacobian, JointVector, SelfMotionVector, TaskVector, Vector
from eos_pin._kernels.dispatch import DONE, UNDECIDED


class Frame:
    """Task point, Jacobian, velocity and drift of a task that is part of a frame's pose.

    Args:
        model: Pinocchio model.
        workspace: Its workspace.
        index: Number of the frame.
        part: Which numbers of the flat pose, the position followed by the rotation row by row, are the task point.
        rows: Which of (velocity of the origin, angular velocity) are the task's velocity.
        point_type: Named tuple that `at` returns.
    """

    def __init__(
        self, model: pin.Model, workspace: pin.Data, index: int, part: slice, rows: slice, point_type: type
    ) -> None:
        self._made_from = model, workspace, index, part, rows, point_type
        self._model, self._data, self._index = model, workspace, index
        self._rows, self._rest = rows, np.zeros(model.nv)
        # Both stay where they are, and change with every pass.
        placement = workspace.oMf[index]
        self._translation, self._rotation = placement.translation, placement.rotation
        self._flat: Vector | None = None
        if part.indices(12)[1] <= 3:
            self._place = self._translation[part]
        else:
            self._flat = np.empty(12)
            self._flat_position, self._flat_rotation = self._flat[:3], self._flat[3:].reshape(3, 3)
            self._place = self._flat[part]

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._made_from

    def value(self, q: JointVector) -> Vector:
        """Task point."""
        forwardKinematics(self._model, self._data, q)
        updateFramePlacement(self._model, self._data, self._index)
        return self._placed().copy()

    def linearize(self, q: JointVector) -> tuple[Vector, Jacobian]:
        """Task point and Jacobian."""
        computeJointJacobians(self._model, self._data, q)
        J = getFrameJacobian(self._model, self._data, self._index, WORLD)[self._rows]
        return self._placed().copy(), J if J.ndim == 2 else J[:, None]

    def look(self, q: JointVector, dq: JointVector) -> tuple[Vector, Jacobian, TaskVector]:
        """Task point, in a workspace that the next call fills anew, Jacobian and drift."""
        model, data, index, rows = self._model, self._data, self._index, self._rows
        forwardKinematics(model, data, q, dq, self._rest)
        computeJointJacobians(model, data)
        J = getFrameJacobian(model, data, index, WORLD)[rows]
        # With one joint Pinocchio's bindings make a vector of what should be a column.
        J = J if J.ndim == 2 else J[:, None]
        drift = getFrameClassicalAcceleration(model, data, index, WORLD).vector[rows]
        return self._placed(), J, drift

    def at(self, q: JointVector, dq: JointVector) -> Any:
        """Task point, Jacobian, velocity and drift."""
        z, J, drift = self.look(q, dq)
        return tuple.__new__(self._made_from[5], (z.copy(), J, J.dot(dq), drift))

    def _placed(self) -> Vector:
        """Task point where the frame was placed last, in the workspace; `getFrameJacobian` places it, too."""
        if self._flat is not None:
            self._flat_position[:], self._flat_rotation[:] = self._translation, self._rotation
        return self._place


class AccelerationMap:
    """Joint accelerations for commanded accelerations of (z, v) on one chart, away from singularities.

    Args:
        Wt: Rows Wᵀ that make dv of dq, (r, n).
        Vt: Transposed basis V of the null space at the base point, (r, n); Wt itself where they are equal.
        Qt: Transposed orthonormal basis Q of the columns of U, (m, n).
        factors: T and Y of the margin, (m, m) and (r, n); None where they are I and Vt.
        most: Square of the size of U B from which directions may fade.
        fast: Joint speed from which they fade earlier.
        runaway: Joint speed beyond which self-motion is braked.
        braking: How much it is braked, for each unit of speed more.
    """

    def __init__(
        self,
        Wt: Float[Array, "r n"],
        Vt: Float[Array, "r n"],
        Qt: Float[Array, "m n"],
        factors: tuple[Array, Array] | None,
        most: float,
        fast: float,
        runaway: float,
        braking: float,
    ) -> None:
        self._made_from: tuple[Any, ...] = Wt, Vt, Qt, factors, most, fast, runaway, braking
        self.m, self.n = Qt.shape
        self.r, self.Wt, self._Qt, self._factors = self.n - self.m, np.ascontiguousarray(Wt), Qt, factors
        self._most, self._fast, self._runaway, self._braking = most, fast**2, runaway**2, braking
        # [G'; Wᵀ] and its rows for G', in the order that LAPACK takes.
        self._A = np.asfortranarray(np.vstack((Qt, Wt)))
        self._G, self._identity = self._A[: self.m], np.asfortranarray(np.eye(self.n))
        self._cut, self._nothing = self.m * self.n, np.full(self.n, math.nan)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._made_from

    def __call__(self, J: Jacobian, F: JointVector, dq: JointVector) -> tuple[int, JointVector, float]:
        """Status, joint acceleration, and a lower bound of the chart's margin; the last two are valid if it is `DONE`.

        Args:
            J: Jacobian G'(q).
            F: Acceleration asked of w = (z, v), the task's part without its drift, (n,).
            dq: Joint velocities.
        """
        self._G[:] = J
        return self._solve(F, dq)

    def _solve(self, F: JointVector, dq: JointVector) -> tuple[int, JointVector, float]:
        """The same for the Jacobian that is stored in A."""
        square = ddot(dq, dq)
        if square > self._runaway:
            F, speed = F.copy(), math.sqrt(square)
            F[self.m :] -= self._braking * (speed - math.sqrt(self._runaway)) * self.Wt.dot(dq)
        _, _, H, info = dgesv(self._A, self._identity)
        # H = [U B, D], column by column.
        entries = H.ravel("K")
        UB, D = entries[: self._cut], entries[self._cut :]
        size = ddot(UB, UB)
        if not square <= self._fast:
            size *= square / self._fast
        # The least singular value of G' is at least 1 / |U B|, so no direction fades unnoticed; NaN ends here too.
        if info or not size < self._most:
            return UNDECIDED, self._nothing, 0.0
        # The singular values of D are the inverse cosines of the angles that `Chart.margin` speaks of; all are at least
        # 1, so the largest is at most what their squares leave beyond the others.
        beyond = float(D.dot(D)) - self.r if self._factors is None else self._tangents(H)
        return DONE, H.dot(F), 1.0 / math.sqrt(1.0 + beyond) if beyond > 0.0 else 1.0

    def _tangents(self, H: Float[Array, "n n"]) -> float:
        """The same in the metric: the squares of T (G'Q)⁻¹ G'Yᵀ, where (G'Q)⁻¹ = QᵀU B."""
        assert self._factors is not None
        T, Y = self._factors
        X = T.dot(self._Qt.dot(H[:, : self.m]).dot(self._G.dot(Y.T))).ravel()
        return float(X.dot(X))


class TrackingLaw(AccelerationMap):
    """Joint accelerations of a law for task and self-motion; Eqs. (36), (45).

    Args:
        of_map: The arguments of the `AccelerationMap`.
        kp: Gain on the task error, (m,).
        kd: Gain on the task's velocity error, (m,).
        kp_v: Gain on v, (r,).
        kd_v: Gain on dv, (r,).
        v: Where Wᵀ q should be, (r,).
        at: `Task.at`, or the `Frame` of the task.
        minus: Difference of two task points; None for a vector task.
    """

    def __init__(
        self,
        of_map: tuple[Array, Array, Array, tuple[Array, Array] | None, float, float, float, float],
        kp: TaskVector,
        kd: TaskVector,
        kp_v: SelfMotionVector,
        kd_v: SelfMotionVector,
        v: SelfMotionVector,
        at: Any,
        minus: Callable[[Array, Array], Array] | None,
    ) -> None:
        super().__init__(*of_map)
        self._made_from = of_map, kp, kd, kp_v, kd_v, v, at, minus
        self._look, self._minus = at.look if isinstance(at, Frame) else None, minus
        # A compiled frame is no function, but has one.
        self._at = at if callable(at) else at.at
        # F = K x for x = (z_d − z, Wᵀq, dw, dz_d, ddz_d, drift, 1): one product instead of a sum of many terms.
        task, v_rows = np.eye(self.n)[:, : self.m], np.eye(self.n)[:, self.m :]
        K = (task * kp, v_rows * np.negative(kp_v), np.diag(np.negative((*kd, *kd_v))), task * kd, task, -task)
        self._K = np.hstack((*K, (v_rows * kp_v).dot(v)[:, None]))
        # Workspaces, and the parts of x.
        self._x = np.ones(self._K.shape[1])
        parts = np.split(self._x, np.cumsum([part.shape[1] for part in K]))
        self._error, self._Wq, self._dw, self._dz_d, self._ddz_d, self._drift, _ = parts

    def __call__(  # type: ignore[override]
        self,
        q: JointVector,
        dq: JointVector,
        z_d: Array,
        dz_d: TaskVector,
        ddz_d: TaskVector,
        more: SelfMotionVector | None,
    ) -> tuple[int, JointVector, float, Jacobian]:
        """Status, joint acceleration and bound of the margin as from `AccelerationMap`, and the task's Jacobian.

        Args:
            q: Joints.
            dq: Joint velocities.
            z_d: Task point that is wanted.
            dz_d: Its velocity, (m,).
            ddz_d: Its acceleration, (m,).
            more: Acceleration asked of the self-motion beside this law, (r,), or None.
        """
        if self._look is None:
            z, J, _, drift = self._at(q, dq)
        else:
            z, J, drift = self._look(q, dq)
        self._G[:] = J
        if self._minus is None:
            subtract(z_d, z, self._error)
        else:
            self._error[:] = self._minus(z_d, z)
        self.Wt.dot(q, self._Wq)
        self._A.dot(dq, self._dw)
        self._dz_d[:], self._ddz_d[:], self._drift[:] = dz_d, ddz_d, drift
        F = self._K.dot(self._x)
        if more is not None:
            F[self.m :] += more
        status, ddq, margin = self._solve(F, dq)
        return status, ddq, margin, J
