"""Tasks of points: the position of a frame in the world or seen from another frame, and the centre of mass."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Array, Jacobian, TaskVector, checked
from eos_pin._kernels.flat import Part
from eos_pin.errors import InputError, RobotError
from eos_pin.robot.model import Robot
from eos_pin.tasks._balls import Ball, com_ball, frame_ball
from eos_pin.tasks.base import WORLD, Point, Task
from eos_pin.tasks.frame import FrameTask


class PositionTask(FrameTask, kind="position"):
    """Position of a frame's origin along some axes of the world [m].

    Args:
        robot: The robot.
        frame: Frame whose origin is placed.
        axes: Which coordinates count, such as `"xyz"`, `"xy"` or `"z"`.
    """

    arguments: tuple[str, ...] = ("frame", "axes")

    @checked
    def __init__(self, robot: Robot, frame: str, axes: str = "xyz") -> None:
        self.axes, rows = axes, _rows(axes)
        super().__init__(robot, frame, list(axes), ["m"] * len(axes), rows, rows)

    def frame_parts(self) -> tuple[Part, ...]:
        return (Part("position", self._id, tuple(range(3)[self._part])),)

    def balls(self) -> tuple[Ball, ...]:
        return (frame_ball(self.robot, self.frame, self.axes),)


class RelativePositionTask(Task, kind="relative_position"):
    """Position of a frame's origin seen from another frame, in that frame's axes [m].

    The reference frame may be fixed (a table) or move with the robot (the other hand of a two-armed robot).

    Args:
        robot: The robot.
        frame: Frame whose origin is placed.
        reference: Frame it is seen from.
        axes: Which coordinates count, such as `"xyz"`.
    """

    arguments = ("frame", "reference", "axes")
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, frame: str, reference: str, axes: str = "xyz") -> None:
        self.frame, self.reference, self.axes = frame, reference, axes
        self._rows = _rows(axes)
        self.seen_from = reference
        self._id, self._reference_id = robot.frame_id(frame), robot.frame_id(reference)
        super().__init__(robot, list(axes), ["m"] * len(axes))

    def compute_point(self, data: pin.Data) -> Point:
        frame = pin.updateFramePlacement(self._model, data, self._id)
        reference = pin.updateFramePlacement(self._model, data, self._reference_id)
        return reference.actInv(frame).translation[self._rows].copy()

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        R, rho, J, J_ref = self._relative(data)
        return (R.T @ (J[:3] - J_ref[:3] + pin.skew(rho) @ J_ref[3:]))[self._rows]

    def compute_drift(self, data: pin.Data) -> TaskVector:
        R, rho, _, _ = self._relative(data)
        velocity, acceleration = (
            [read(self._model, data, i, WORLD) for i in (self._id, self._reference_id)]
            for read in (pin.getFrameVelocity, pin.getFrameClassicalAcceleration)
        )
        omega, alpha = velocity[1].angular, acceleration[1].angular
        slide = velocity[0].linear - velocity[1].linear - np.cross(omega, rho)
        # Acceleration seen from a frame that turns: minus Euler, centrifugal and Coriolis terms.
        seen = (
            acceleration[0].linear
            - acceleration[1].linear
            - np.cross(alpha, rho)
            - np.cross(omega, np.cross(omega, rho))
            - 2.0 * np.cross(omega, slide)
        )
        return (R.T @ seen)[self._rows]

    def _relative(self, data: pin.Data) -> tuple[Array, Array, Array, Array]:
        frame = pin.updateFramePlacement(self._model, data, self._id)
        reference = pin.updateFramePlacement(self._model, data, self._reference_id)
        J, J_ref = (
            pin.getFrameJacobian(self._model, data, i, WORLD).reshape(6, -1) for i in (self._id, self._reference_id)
        )
        return reference.rotation.copy(), frame.translation - reference.translation, J, J_ref


class ComTask(Task, kind="com"):
    """Position of the robot's centre of mass along some axes of the world [m].

    Args:
        robot: The robot.
        axes: Which coordinates count, such as `"xyz"` or `"xy"`.

    Raises:
        RobotError: Nothing that moves has mass.
    """

    arguments = ("axes",)
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, axes: str = "xyz") -> None:
        if not sum(body.mass for body in list(robot.model.inertias)[1:]) > 0.0:
            raise RobotError(
                f"robot {robot.name!r} has no centre of mass: no link that moves has mass. Give the links an "
                "<inertial>, or choose a task of a frame"
            )
        self.axes = axes
        self._rows = _rows(axes)
        super().__init__(robot, list(axes), ["m"] * len(axes))

    def compute_point(self, data: pin.Data) -> Point:
        # The level is explicit: Pinocchio's shortest form would compute the positions again.
        pin.centerOfMass(self._model, data, pin.KinematicLevel.POSITION, False)
        return data.com[0][self._rows].copy()

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return pin.jacobianCenterOfMass(self._model, data, False).reshape(3, -1)[self._rows]

    def compute_drift(self, data: pin.Data) -> TaskVector:
        pin.centerOfMass(self._model, data, pin.KinematicLevel.ACCELERATION, False)
        return data.acom[0][self._rows].copy()

    def balls(self) -> tuple[Ball, ...]:
        return (com_ball(self.robot, self.axes),)


def _rows(axes: str) -> slice:
    """Rows of a 3-vector that `axes` names; every subset of three is a slice, which reads without copying a list."""
    rows = ["xyz".find(axis) for axis in axes]
    if not rows or min(rows) < 0 or rows != sorted(set(rows)):
        raise InputError(f"axes must be some of 'x', 'y', 'z' in this order, such as 'xyz' or 'xy'; got {axes!r}")
    step = rows[1] - rows[0] if len(rows) > 1 else 1
    return slice(rows[0], rows[-1] + 1, step)
