"""Equations of motion in the extended operational coordinates w = (z, v), and Khatib's in z alone.

The first kind is a true system of differential equations for the whole robot, Eqs. (25), (26), (30). The second,
Eqs. (5)–(9), is what traditional task-space control is built on; its terms depend on all joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, TaskVector, checked
from eos_pin.charts._basis import rank_of
from eos_pin.charts.chart import Chart, ChartPoint
from eos_pin.errors import EosError, Renamed, SingularError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import TaskPoint

#: States of a run whose inertial coupling is looked at, about.
COUPLINGS = 50


@checked
@dataclass(frozen=True, eq=False)
class ExtendedDynamics:
    """Equations of motion in w = (z, v) at one state; each term is computed when it is asked for.

    Attributes:
        robot: Robot whose inertia and gravity count.
        point: Kinematics of the chart at the state.
    """

    robot: Robot
    point: ChartPoint

    at = Renamed("from_state")

    @classmethod
    @checked
    def from_state(cls, robot: Robot, chart: Chart, q: JointVector, dq: JointVector) -> ExtendedDynamics:
        """Equations of motion at the state (q, dq)."""
        return cls(robot, chart._point(q, dq))

    @cached_property
    def mass(self) -> Float[Array, "n n"]:
        """Mass matrix Hᵀ M H of w; its blocks are those of Eq. (26)."""
        H = self.point.H
        return H.T @ self.robot._mass(self.point.q) @ H

    @cached_property
    def bias(self) -> JointVector:
        """Force Hᵀ(M E − R) that holds w at zero acceleration; Eq. (26)."""
        # M E − R is the torque of the acceleration E.
        return self.point.H.T @ self.robot._inverse_dynamics(self.point.q, self.point.dq, self.point.E)

    @cached_property
    def coupling(self) -> float:
        """Inertial coupling of z and v, between 0 and 1: the largest singular value of L_z⁻¹ M_zv L_v⁻ᵀ.

        M_zv is the block of `mass` beside M_zz = L_z L_zᵀ and M_vv = L_v L_vᵀ. It is the cosine of the least angle, in
        the metric M, between joint motions that move z only and those that move v only; 0 at the base point of a chart
        whose metric is `"inertial"`, and in general nowhere else.
        """
        # In coordinates in which M is the identity these motions are the spans of two bases.
        root = np.linalg.cholesky(self.robot._mass(self.point.q)).T
        task, self_motion = (np.linalg.qr(root @ X)[0] for X in (self.point.chart.U, self.point.D))
        return float(np.linalg.svd(task.T @ self_motion, compute_uv=False).max(initial=0.0))

    @checked
    def force(self, tau: JointVector, task_force: TaskVector | None = None) -> JointVector:
        """Generalized force on w of joint torques and of a force F^z on the task; right side of Eq. (26).

        Args:
            tau: Joint torques F^y [N m or N].
            task_force: Force from the environment on the task [N, N m], none by default.
        """
        force = self.point.H.T @ tau
        if task_force is not None:
            # G'H = [I, 0]: a force on the task does no work on v.
            force[: self.point.chart.m] += task_force
        return force

    @checked
    def acceleration(self, tau: JointVector, task_force: TaskVector | None = None) -> JointVector:
        """Acceleration ddw = H⁻¹(M⁻¹(R + F^y + G'ᵀF^z) − E), without forming H, M or E; Eq. (30), corrected.

        Args:
            tau: Joint torques F^y [N m or N].
            task_force: Force from the environment on the task [N, N m], none by default.
        """
        point = self.point
        J = point.task.J
        if task_force is not None:
            tau = tau + J.T @ task_force
        ddq = self.robot._forward_dynamics(point.q, point.dq, tau)
        # H⁻¹ = [G'; Wᵀ] and −H⁻¹E = (Ġ' dq, 0)
        return np.concatenate((J @ ddq + point.task.drift, point.chart._dv(ddq)))


def couplings(robot: Robot, states: Sequence[tuple[Chart, JointVector]]) -> dict[str, float] | None:
    """Median and maximum of `ExtendedDynamics.coupling` along a motion; None without self-motion or without inertia.

    Args:
        robot: Robot whose inertia counts.
        states: Charts and joints; of many, some are looked at.
    """
    values = []
    for chart, q in states[:: 1 + len(states) // COUPLINGS]:
        with suppress(EosError):  # on the edge of a chart there is none, nor without inertia
            if chart.r and not chart.task.moves:
                values.append(ExtendedDynamics.from_state(robot, chart, q, np.zeros(q.size)).coupling)
    return {"median": float(np.median(values)), "max": max(values)} if values else None


@checked
@dataclass(frozen=True, eq=False)
class TaskSpaceDynamics:
    """Khatib's task-space dynamics F^z = Λ ddz + μ + p at one state; Eqs. (5)–(9).

    Attributes:
        robot: Robot whose inertia and gravity count.
        q: Joints.
        dq: Joint velocities.
        task: z, J, dz and drift there.

    Raises:
        SingularError: G' has not full rank, so that Λ does not exist.
    """

    robot: Robot
    q: JointVector
    dq: JointVector
    task: TaskPoint

    @property
    def m(self) -> int:
        """Dimension of the task."""
        return self.task.dz.size

    @cached_property
    def _factor(self) -> tuple[Array, Any]:
        # The second is a bool, and an array in newer versions of SciPy.
        return scipy.linalg.cho_factor(self.robot._mass(self.q))

    @cached_property
    def _M_inverse_Jt(self) -> Float[Array, "n m"]:
        return scipy.linalg.cho_solve(self._factor, self.task.J.T)

    @cached_property
    def Lambda(self) -> Float[Array, "m m"]:
        """Task-space mass matrix (G' M⁻¹ G'ᵀ)⁻¹."""
        inverse = self.task.J @ self._M_inverse_Jt
        values = np.linalg.eigvalsh(inverse)
        if not values[0] > 1e-14 * values[-1]:
            raise SingularError(
                "the task is singular here: its mass matrix Λ does not exist. Move away from this configuration",
                *rank_of(self.task.J),
            )
        return np.linalg.inv(inverse)

    @cached_property
    def mu(self) -> TaskVector:
        """Centrifugal and Coriolis force −ΛG'M⁻¹S − ΛĠ'dq [N, N m]."""
        S = self.robot._gravity(self.q) - self.robot._bias(self.q, self.dq)
        return -self.Lambda @ (self._M_inverse_Jt.T @ S + self.task.drift)

    @cached_property
    def p(self) -> TaskVector:
        """Gravity force −ΛG'M⁻¹Q^y [N, N m]."""
        return self.Lambda @ (self._M_inverse_Jt.T @ self.robot._gravity(self.q))

    @cached_property
    def J_sharp(self) -> Float[Array, "n m"]:
        """Dynamically consistent generalized inverse M⁻¹G'ᵀΛ of G'; Eq. (8), transposed."""
        return self._M_inverse_Jt @ self.Lambda

    @cached_property
    def Nt(self) -> Float[Array, "n n"]:
        """Projector Nᵀ = I − G'ᵀΛG'M⁻¹ of torques that do not accelerate the task; Eq. (7)."""
        return np.eye(self.robot.n) - self.task.J.T @ self.J_sharp.T

    @checked
    def force(self, ddz: TaskVector) -> TaskVector:
        """Task force Λ ddz + μ + p that causes the task acceleration ddz [N, N m]; Eq. (9)."""
        # Λ(ddz − drift + G'M⁻¹ bias): μ and p in one.
        bias = self.robot._bias(self.q, self.dq)
        return self.Lambda @ (ddz - self.task.drift + self._M_inverse_Jt.T @ bias)
