"""Tasks of directions: orientation on SO(3), pose on SE(3), and the heading of a planar robot."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Jacobian, TaskVector, checked
from eos_pin._kernels.flat import Part
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks._balls import Ball, frame_ball
from eos_pin.tasks._flat import checked_pose, flat_rotation, pose_difference
from eos_pin.tasks.base import WORLD, Channel, Point, PointLike, Task
from eos_pin.tasks.frame import FrameTask


class OrientationTask(FrameTask, kind="orientation"):
    """Orientation of a frame on SO(3) [rad].

    z is the rotation matrix, dz the angular velocity in world axes, `minus(R1, R0)` the rotation vector of R1 R0ᵀ.

    Args:
        robot: The robot.
        frame: Frame that is oriented.
    """

    arguments = ("frame",)
    rotations = (0,)

    @checked
    def __init__(self, robot: Robot, frame: str) -> None:
        super().__init__(robot, frame, ("rx", "ry", "rz"), ["rad"] * 3, slice(3, None), slice(3, None))

    def frame_parts(self) -> tuple[Part, ...]:
        return (Part("orientation", self._id),)

    def channels(self) -> tuple[Channel, ...]:
        return (Channel(slice(0, 9), "rotation"),)

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return pin.log3(z1.reshape(3, 3).dot(z0.reshape(3, 3).T))

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return pin.exp3(delta).dot(z.reshape(3, 3)).ravel()

    def local_rate(self, delta: TaskVector, dz: TaskVector, z_bar: Point | None = None) -> TaskVector:
        # Jexp3 is for a velocity in the moving frame; transposed it is for one in the frame at rest. Jlog3 would be its
        # inverse for rotations up to π only, and the trial points of an integrator go beyond.
        return np.linalg.solve(pin.Jexp3(delta).T, dz)

    def local_margin(self, delta: TaskVector) -> float:
        return 1.0 - math.sqrt(delta.dot(delta)) / math.pi

    @checked
    def point(self, value: PointLike) -> Point:
        return flat_rotation(value.rotation if isinstance(value, pin.SE3) else value, self._point_name)


class PosePoints(Task):
    """Part of tasks whose points are poses: z is a position followed by a rotation matrix row by row, 12 numbers."""

    axes = "xyz"
    rotations = (3,)

    def channels(self) -> tuple[Channel, ...]:
        return Channel(slice(0, 3), "number"), Channel(slice(3, 12), "rotation")

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return pose_difference(z1, z0)

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return np.concatenate((z[:3] + delta[:3], pin.exp3(delta[3:]).dot(z[3:].reshape(3, 3)).ravel()))

    def local_rate(self, delta: TaskVector, dz: TaskVector, z_bar: Point | None = None) -> TaskVector:
        return np.concatenate((dz[:3], np.linalg.solve(pin.Jexp3(delta[3:]).T, dz[3:])))

    def local_margin(self, delta: TaskVector) -> float:
        return 1.0 - math.sqrt(delta[3:].dot(delta[3:])) / math.pi

    @checked
    def point(self, value: PointLike) -> Point:
        return checked_pose(value, self._point_name)


class PoseTask(PosePoints, FrameTask, kind="pose"):
    """Pose of a frame on SE(3): position [m] and orientation [rad].

    z is the position followed by the rotation matrix, dz = (velocity of the origin, angular velocity) in world axes.
    `minus` is the logarithm whose curves are straight lines with a constant axis of rotation: the geodesics of SE(3).

    Args:
        robot: The robot.
        frame: Frame that is placed.
    """

    arguments = ("frame",)

    @checked
    def __init__(self, robot: Robot, frame: str) -> None:
        labels, units = ("x", "y", "z", "rx", "ry", "rz"), ["m"] * 3 + ["rad"] * 3
        super().__init__(robot, frame, labels, units, slice(None), slice(None))

    def frame_parts(self) -> tuple[Part, ...]:
        return (Part("pose", self._id),)

    def balls(self) -> tuple[Ball, ...]:
        return (frame_ball(self.robot, self.frame),)


class HeadingTask(Task, kind="heading"):
    """Heading of a frame on a planar robot: its angle about the world's z axis [rad].

    Args:
        robot: A robot whose revolute joints all turn about the world's z axis.
        frame: Frame whose heading counts.

    Raises:
        InputError: The frame can turn about another axis; use `OrientationTask`.
    """

    arguments = ("frame",)
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("heading",), ("rad",))
        tilting = pin.computeFrameJacobian(self._model, self._data, self._rest, self._id, WORLD).reshape(6, -1)[3:5]
        if np.abs(tilting).max() > 1e-9:
            raise InputError(f"frame {frame!r} of {robot.name!r} also turns about x or y; use OrientationTask")

    def compute_point(self, data: pin.Data) -> Point:
        R = pin.updateFramePlacement(self._model, data, self._id).rotation
        return np.array([math.atan2(R[1, 0], R[0, 0])])

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, WORLD).reshape(6, -1)[5:]

    def compute_drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, WORLD).angular[2:]

    def frame_parts(self) -> tuple[Part, ...]:
        return (Part("heading", self._id),)

    def channels(self) -> tuple[Channel, ...]:
        return (Channel(slice(0, 1), "angle"),)

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return np.array([math.remainder(z1[0] - z0[0], math.tau)])
