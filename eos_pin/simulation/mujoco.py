"""`MujocoPlant`: the same robot, moved by MuJoCo instead of Pinocchio.

A control law that was only ever tried on the library it is made with may share that library's mistakes. MuJoCo has
dynamics and integrators of its own, written by other people, and is an extra: `pip install 'eos-pin[mujoco]'`.

MuJoCo's model is made from the robot's, body by body, and not from its URDF: so locked joints, a payload, another
gravity and a model error reach the plant, and nothing is bounded or merged on the way. That MuJoCo's own reader of the
URDF arrives at the same robot is a test.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from types import ModuleType
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, checked
from eos_pin.errors import InputError, MissingDependencyError, Renamed
from eos_pin.robot.model import Robot

Integrator: TypeAlias = Literal["RK4", "Euler", "implicit", "implicitfast"]


@checked
@dataclass(frozen=True, eq=False, repr=False)
class MujocoPlant(Robot):
    """A robot whose equations of motion are MuJoCo's; for `simulate_sampled`, and for `simulate` as well.

    Names, limits, kinematics and energies stay those of the robot it is made of. As there, nothing collides, joints
    have no stops, and friction and damping of the URDF are left out.

    Attributes:
        integrator: Integrator of a sampled run: RK4 of order 4, Euler (semi-implicit) of order 1, or one of the two
            that are implicit in the velocity.

    Raises:
        MissingDependencyError: MuJoCo is not installed.
        InputError: MuJoCo has no such integrator or joint.
        RobotError: The robot lacks mass.
    """

    integrator: Integrator = "RK4"

    of = Renamed("from_robot")

    @classmethod
    @checked
    def from_robot(cls, robot: Robot, *, integrator: Integrator = "RK4") -> MujocoPlant:
        """The robot as MuJoCo moves it."""
        if robot.coordinates.coupled:
            raise InputError("a MujocoPlant has no joints that follow others; lock them, or use Pinocchio as the plant")
        return cls(**{item.name: getattr(robot, item.name) for item in fields(Robot)}, integrator=integrator)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_dynamics()
        _ = self._mujoco

    def mass(self, q: JointVector) -> Float[Array, "n n"]:
        mujoco, model, data = self._mujoco
        self._forward(q, np.zeros(self.n), np.zeros(self.n))
        M = np.empty((self.n, self.n))
        for column, unit in zip(M, np.eye(self.n), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
        return M

    def bias(self, q: JointVector, dq: JointVector) -> JointVector:
        _, _, data = self._mujoco
        self._forward(q, dq, np.zeros(self.n))
        return data.qfrc_bias.copy()

    def inverse_dynamics(self, q: JointVector, dq: JointVector, ddq: JointVector) -> JointVector:
        return self._mass(q).dot(ddq) + self._bias(q, dq)

    def forward_dynamics(self, q: JointVector, dq: JointVector, tau: JointVector) -> JointVector:
        _, _, data = self._mujoco
        self._forward(q, dq, tau)
        return data.qacc.copy()

    @checked
    def advance(
        self, q: JointVector, dq: JointVector, tau: JointVector, length: float
    ) -> tuple[JointVector, JointVector]:
        """Joints and joint velocities after one step of MuJoCo's integrator under a held torque.

        Args:
            q: Joints.
            dq: Joint velocities.
            tau: Torque [N m or N].
            length: Length of the step [s].
        """
        if not math.isfinite(q.dot(q) + dq.dot(dq) + tau.dot(tau)):
            # MuJoCo would start over from its zero posture.
            return np.full(self.n, np.nan), np.full(self.n, np.nan)
        mujoco, model, data = self._mujoco
        model.opt.timestep = length
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, dq, tau
        mujoco.mj_step(model, data)
        return data.qpos.copy(), data.qvel.copy()

    def _forward(self, q: JointVector, dq: JointVector, tau: JointVector) -> None:
        mujoco, model, data = self._mujoco
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, dq, tau
        mujoco.mj_forward(model, data)

    @cached_property
    def _mujoco(self) -> tuple[ModuleType, Any, Any]:
        """The library, its model and its workspace."""
        mujoco = _import_mujoco()
        model = _compile(mujoco, self.model, self._more)
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        data = mujoco.MjData(model)
        for warning in data.warning:
            # It speaks up the first time only, on the terminal and in a file; who drives the run says it better.
            warning.number = 1
        return mujoco, model, data

    def _more(self, mujoco: ModuleType, spec: Any, bodies: list[Any]) -> None:
        """Add to MuJoCo's specification, and to the bodies of the joints; here nothing."""

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in super().__getstate__().items() if key != "_mujoco"}

    def __repr__(self) -> str:
        return f"MujocoPlant({self.name!r}, n={self.n}, {self.integrator})"


def _import_mujoco() -> ModuleType:
    try:
        import mujoco
    except ImportError as error:
        raise MissingDependencyError("a MujocoPlant", "mujoco", "pip install 'eos-pin[mujoco]'") from error
    return mujoco


def _compile(
    mujoco: ModuleType, robot: pin.Model, more: Callable[[ModuleType, Any, list[Any]], None] | None = None
) -> Any:
    """MuJoCo's model of the same joints and bodies.

    Args:
        mujoco: The library.
        robot: The robot.
        more: Adds to MuJoCo's specification and to the bodies of the joints, given the library and both; further bodies
            come after the robot's.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = robot.gravity.linear
    off = mujoco.mjtDisableBit
    # A state that has run away is to be seen, not replaced by the zero posture.
    spec.option.disableflags = off.mjDSBL_CONSTRAINT | off.mjDSBL_AUTORESET
    bodies = [spec.worldbody]
    inertias = [(0.0, np.zeros(3))]
    data = robot.createData()
    for i in range(1, robot.njoints):
        placement, inertia = robot.jointPlacements[i], robot.inertias[i]
        moments, axes = np.linalg.eigh(inertia.inertia)
        # Principal axes must be right-handed to be a rotation.
        axes = axes * np.linalg.det(axes)
        bodies.append(
            bodies[robot.parents[i]].add_body(
                name=f"body {i}",
                pos=placement.translation,
                quat=_quaternion(placement.rotation),
                # Whatever is positive: what it is follows below.
                mass=1.0,
                inertia=np.ones(3),
                ipos=inertia.lever,
                iquat=_quaternion(axes),
                explicitinertial=True,
            )
        )
        inertias.append((inertia.mass, moments))
        motion = pin.computeJointJacobian(robot, data, pin.neutral(robot), i).reshape(6, -1)[:, i - 1]
        linear, angular = np.split(motion, 2)
        if linear.any() and angular.any():
            raise InputError(f"joint {robot.names[i]!r} is a screw ({robot.joints[i].shortname()}); MuJoCo has none")
        kind = mujoco.mjtJoint.mjJNT_SLIDE if linear.any() else mujoco.mjtJoint.mjJNT_HINGE
        bodies[i].add_joint(name=robot.names[i], type=kind, axis=linear + angular, armature=robot.armature[i - 1])
    if more is not None:
        more(mujoco, spec, bodies)
    model = spec.compile()
    # Its compiler refuses point masses, bodies without mass, and inertias that no real body has; its dynamics does not.
    of_robot = slice(len(inertias))
    model.body_mass[of_robot] = [mass for mass, _ in inertias]
    model.body_inertia[of_robot] = [moments for _, moments in inertias]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _quaternion(rotation: Float[Array, "3 3"]) -> Float[Array, " 4"]:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])
