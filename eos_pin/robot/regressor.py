"""Equations of motion as a product of inertial parameters, and bounds of their errors."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, number
from eos_pin.errors import RobotError
from eos_pin.robot.model import Robot


def passive_regressor(
    robot: Robot, q: JointVector, dq: JointVector, dq_r: JointVector, ddq_r: JointVector
) -> Float[Array, "n p"]:
    """Matrix Y of M ddq_r + C(q, dq) dq_r + g = Y θ, with Christoffel's C, for which Ṁ − 2C is skew.

    Slotine and Li's regressor, made of Pinocchio's by polarisation: C(dq) dq_r = (n(dq + dq_r) − n(dq − dq_r))/4 for a
    quadratic form n.

    Args:
        robot: The robot, without joints that follow others.
        q: Joints.
        dq: Joint velocities.
        dq_r: Reference velocities.
        ddq_r: Reference accelerations.
    """
    if robot.coordinates.coupled:
        raise RobotError(f"{robot.name!r} has joints that follow others; there is no regressor of it. Lock them")
    rest, model, data = np.zeros(q.size), robot.model, robot._dynamics
    Y = pin.computeJointTorqueRegressor(model, data, q, rest, ddq_r).copy()
    for velocity, part in ((dq + dq_r, 0.25), (dq - dq_r, -0.25)):
        # Gravity is in both, and drops out.
        Y += part * pin.computeJointTorqueRegressor(model, data, q, velocity, rest)
    return np.asarray(Y)


def passive_torque(robot: Robot, q: JointVector, dq: JointVector, dq_r: JointVector, ddq_r: JointVector) -> JointVector:
    """Torque M ddq_r + C(q, dq) dq_r + g, likewise [N m or N]."""
    rest = np.zeros(q.size)
    apart = robot._bias(q, dq + dq_r) - robot._bias(q, dq - dq_r)
    return robot._inverse_dynamics(q, rest, ddq_r) + 0.25 * apart


def parameter_bounds(robot: Robot, error: float) -> Float[Array, " p"]:
    """Largest error of each inertial parameter, where masses, centres and inertias are off by up to `error`.

    The errors are those of `Robot.perturbed`: of each link's mass, of each coordinate of its centre of mass and of each
    second moment about its principal axes. A body has ten parameters: its mass, mass times centre (3), and the second
    moments about the joint's origin Ixx, Ixy, Iyy, Ixz, Iyz, Izz.

    Args:
        robot: The robot.
        error: Largest relative error.
    """
    e = number(error, "the model error", at_least=0.0)
    twice, thrice = (1.0 + e) ** 2 - 1.0, (1.0 + e) ** 3 - 1.0
    bounds = []
    for body in list(robot.model.inertias)[1:]:
        m, c = body.mass, np.abs(body.lever)
        moments, axes = np.linalg.eigh(body.inertia)
        second = np.maximum(0.5 * moments.sum() - moments, 0.0)
        # Bounds of the second moments Σ about the joint's origin, entry by entry; I = tr(Σ) 1 − Σ.
        S = twice * np.abs(axes) @ (second[:, None] * np.abs(axes).T) + thrice * m * np.outer(c, c)
        x, y, z = np.diag(S)
        bounds.append([e * m, *(twice * m * c), y + z, S[0, 1], x + z, S[0, 2], S[1, 2], x + y])
    return np.array(bounds).ravel()
