"""Joint accelerations from commanded accelerations of (z, v), kept bounded and continuous near task singularities."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from scipy.linalg import lapack

from eos_pin._arrays import (
    Jacobian,
    JointVector,
    SelfMotionVector,
    TaskVector,
)
from eos_pin._kernels import plain_law
from eos_pin._kernels.dispatch import DONE, use_compiled
from eos_pin.charts._basis import DENSE
from eos_pin.charts.chart import Chart
from eos_pin.charts.directions import EDGE
from eos_pin.errors import ChartError

#: Returns the accelerations of joints that are followed; None where none are.
Lead: TypeAlias = Callable[[], "JointVector | None"]

MapKernel, LawKernel = use_compiled(plain_law.AccelerationMap), use_compiled(plain_law.TrackingLaw)

#: Below this singular value a direction fades out of a control law: 0.05 of the robot's reach per radian.
SINGULAR_VALUE_FLOOR = 0.05
#: Joint speed beyond which directions fade out earlier: the length of dq [rad/s or m/s].
FAST_SPEED = 4.0
#: Rate at which motion in a direction that fades out is braked [1/s]; more for joints faster than that, in proportion.
BRAKING_RATE = 20.0
#: Joint speed that no self-motion is meant to have: the length of dq. Beyond it self-motion is braked, at this rate for
#: each rad/s more; charts that follow each other faster than v is damped would make it grow without end [rad/s, 1].
OVERSPEED, OVERSPEED_DAMPING = 16.0, 10.0


def speed_ratio_squared(dq: JointVector) -> float:
    """Squared speed ratio max(1, |dq| / FAST_SPEED)²."""
    squared = dq.dot(dq)
    return 1.0 if squared < FAST_SPEED**2 else squared / FAST_SPEED**2


def damped_system(
    J: Jacobian, b: TaskVector, dq: JointVector, lead: JointVector | None = None
) -> tuple[Jacobian, TaskVector]:
    """Regularize J x = b near a rank-deficient J, for joint accelerations x; returns (Y, c) with Y x = c.

    The rows of Y are orthonormal, and x = Yᵀ c is the solution where J is square. Singular values s ≥ ε of J are
    inverted exactly. Below ε, 1/s is replaced by s/ε², so that the direction fades out, and the missing part 1 − s²/ε²
    by braking −β dq. So x is bounded and continuous. ε is SINGULAR_VALUE_FLOOR, β is BRAKING_RATE;
    above FAST_SPEED both grow in proportion to the speed. Coriolis terms grow with its square, as ε² does, so that
    their effect stays bounded. Where joints are followed, their acceleration takes the place of braking; on the joints
    to follow it is x itself, so that nothing fades.

    Args:
        J: Jacobian, its rows weighted so that singular values compare.
        b: Right side, weighted likewise.
        dq: Joint velocities.
        lead: Joint accelerations of a law that follows joints; None without.
    """
    X, s, Y = np.linalg.svd(J, full_matrices=False)
    speed = math.sqrt(speed_ratio_squared(dq))
    epsilon, beta = speed * SINGULAR_VALUE_FLOOR, speed * BRAKING_RATE
    kept = np.minimum((s / epsilon) ** 2, 1.0)
    gain = np.minimum(s / epsilon**2, 1.0 / np.maximum(s, epsilon))
    return Y, gain * (X.T @ b) + (1.0 - kept) * (Y @ (-beta * dq if lead is None else lead))


class AccelerationMap:
    """Joint accelerations of a control law on a chart.

    They are those of `Chart.acceleration`, but directions of the task that are being lost fade out of the law and are
    braked, see `eos_pin.control._regularize.damped_system`; and so is self-motion of joints that are about to run away.

    Args:
        chart: The chart.
        smooth: Whether both is done; if not, singularities and speeds are the caller's business.
    """

    def __init__(self, chart: Chart, *, smooth: bool = True) -> None:
        self.chart, self.smooth = chart, smooth
        robot = chart.task.robot
        # Unit of each row of G', so that singular values compare: metres are measured in reaches.
        self._units = np.array([robot.reach if unit == "m" else 1.0 for unit in chart.task.units])
        self._nothing = np.zeros(chart.n)
        #: Square of the size of U B from which directions may fade.
        self.most = 1.0 / (SINGULAR_VALUE_FLOOR * float(self._units.max(initial=1.0))) ** 2

    @cached_property
    def _kernel(self) -> Any:
        # For many joints products with a basis that is not written out are cheaper.
        return MapKernel(*self._made_from) if self.chart.n <= DENSE else None

    @property
    def _made_from(self) -> tuple[Any, ...]:
        most, runaway = (self.most, OVERSPEED) if self.smooth else (math.inf, math.inf)
        chart = self.chart
        factors = chart._margin_factors
        return chart.Wt, chart.Vt, chart.u_basis.T, factors, most, FAST_SPEED, runaway, OVERSPEED_DAMPING

    def __call__(
        self, J: Jacobian, F: JointVector, dq: JointVector, lead: Lead = lambda: None
    ) -> tuple[JointVector, float]:
        """Joint acceleration, and a lower bound of the chart's margin; 0 where none is computed.

        Args:
            J: Jacobian G'(q).
            F: Acceleration asked of w = (z, v), the task's part without its drift, (n,).
            dq: Joint velocities, to be braked.
            lead: Asked for the accelerations of joints that are followed, where a direction fades; None to brake it.

        Raises:
            ChartError: [G'; Wᵀ] is singular, and nothing fades.
        """
        if self._kernel is None:
            return self._for_many_joints(J, F, dq, lead), 0.0
        status, ddq, margin = self._kernel(J, F, dq)
        return (ddq, margin) if status == DONE else (self._near_singularity(J, F, dq, lead), 0.0)

    def tracking_law(
        self, kp: TaskVector, kd: TaskVector, kp_v: SelfMotionVector, kd_v: SelfMotionVector, v_d: SelfMotionVector
    ) -> Any:
        """Compiled kernel of the control law with constant v_d and the regularization; None if it is not available.

        Args:
            kp: Gain on the task error, (m,).
            kd: Gain on the task's velocity error, (m,).
            kp_v: Gain on v, (r,).
            kd_v: Gain on dv, (r,).
            v_d: Where v is held.
        """
        task = self.chart.task
        # The kernel compares velocities number by number.
        if self._kernel is None or task.is_curved:
            return None
        at, minus = task.kernel or task._at, None if task.is_vector else task._minus
        held = v_d - self.chart._v_zero
        return LawKernel(self._made_from, kp, kd, kp_v, kd_v, held, at, minus)

    def margin(self, J: Jacobian, enough: float) -> float:
        """`Chart.margin`, or a lower bound of it that exceeds `enough`."""
        if self._kernel is not None:
            status, _, bound = self._kernel(J, self._nothing, self._nothing)
            if status == DONE and bound > enough:
                return float(bound)
        return self.chart._margin(J, enough=enough)

    def _for_many_joints(self, J: Jacobian, F: JointVector, dq: JointVector, lead: Lead = lambda: None) -> JointVector:
        """The acceleration where V is not written out: V F_v + U B (F_z − G'V F_v)."""
        chart = self.chart
        if not (math.isfinite(J.sum()) and math.isfinite(dq.dot(dq))):
            return self._near_singularity(J, F, dq, lead)
        JQ, b, lifted = chart._system(J, self._braked(F, dq))
        LU, pivots, info = lapack.dgetrf(JQ)
        B, singular = lapack.dgetri(LU, pivots)
        UB = B.ravel("K")
        if info or singular or (self.smooth and not UB.dot(UB) * speed_ratio_squared(dq) < self.most):
            return self._near_singularity(J, F, dq, lead)
        return lifted + chart.u_basis.dot(B.dot(b))

    def _braked(self, F: JointVector, dq: JointVector) -> JointVector:
        """F with braking of the self-motion, if the joints are about to run away."""
        speed, m = math.sqrt(dq.dot(dq)), self.chart.m
        if not self.smooth or speed <= OVERSPEED:
            return F
        return np.concatenate((F[:m], F[m:] - OVERSPEED_DAMPING * (speed - OVERSPEED) * self.chart._dv(dq)))

    def _near_singularity(self, J: Jacobian, F: JointVector, dq: JointVector, lead: Lead = lambda: None) -> JointVector:
        """Joint acceleration near a singularity, where the kernel has none and directions of the task fade."""
        # A trial state of an integrator may be beyond all numbers; the torque says so.
        if not (math.isfinite(J.sum()) and math.isfinite(dq.dot(dq))):
            return np.full(self.chart.n, math.nan)
        if not self.smooth:
            raise ChartError(EDGE)
        return self._faded(J, self._braked(F, dq), dq, lead())

    def _faded(self, J: Jacobian, F: JointVector, dq: JointVector, a: JointVector | None) -> JointVector:
        """Joint acceleration where the task may be singular."""
        chart = self.chart
        m, Q = chart.m, chart.u_basis
        Y, c = damped_system(J / self._units[:, None], F[:m] / self._units, dq, a)
        # Once more for the self-motion: a chart that is worn and cannot be renewed, and joints far too fast.
        A, b, lifted = chart._system(Y, np.concatenate((c, F[m:])))
        if lifted is None:
            X, x = damped_system(A, b, dq, a)
            return X.T @ x
        X, x = damped_system(A, b, Q.T @ dq, None if a is None else Q.T @ a)
        return lifted + Q @ (X.T @ x)
