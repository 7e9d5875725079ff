"""Inertia of the task that is designed, in the place of the robot's own."""

from __future__ import annotations

import numpy as np

from eos_pin._arrays import Array, Jacobian, JointVector, Vector
from eos_pin.control.compliant.gains import Square
from eos_pin.control.compliant.law import ImpedanceLaw
from eos_pin.tasks.base import Point

#: Part of the largest mobility of the task below which a direction counts as singular, and is shaped less and less.
SINGULAR = 1e-4


def shaping_torque(
    law: ImpedanceLaw,
    inertia: Square,
    t: float,
    q: JointVector,
    dq: JointVector,
    z: Point,
    J: Jacobian,
    *,
    tau: JointVector,
    external: JointVector,
    force: Vector,
) -> JointVector:
    """Torque G'ᵀF that makes the task move as M_d (z̈ − z̈_d) = K_z e_z + D_z ė_z + f; it leaves the force on v as it is.

    F = (G' M⁻¹ G'ᵀ)⁻¹ (z̈ − z̈_0) with the acceleration z̈_0 that the robot has otherwise.

    Args:
        law: Law of the mode, whose springs count.
        inertia: M_d along the axes of the gains, (m, m).
        t: Time [s].
        q: Joints.
        dq: Joint velocities.
        z: Task point at q.
        J: Jacobian at q.
        tau: All other torque [N m or N].
        external: External torque, (n,) [N m or N].
        force: External force on z, (m,) [N, N m].
    """
    robot, task = law.chart.task.robot, law.chart.task
    M = robot._mass(q)
    spring, M_d, D_d, target = law.designed(t, q, z, inertia)
    wanted = target.ddz + np.linalg.solve(M_d, spring + D_d @ (target.dz - J @ dq) + force)
    inverse = np.linalg.solve(M, np.column_stack((J.T, tau + external - robot._bias(q, dq))))
    mobility: Array = J @ inverse[:, :-1]
    lacking = wanted - J @ inverse[:, -1] - task._at(q, dq).drift
    k, X = np.linalg.eigh(0.5 * (mobility + mobility.T))
    # A singular direction cannot be accelerated, and has no inertia to speak of.
    return J.T @ (X @ (k / (k**2 + (SINGULAR * k[-1]) ** 2) * (X.T @ lacking)))
