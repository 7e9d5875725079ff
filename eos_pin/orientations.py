"""Tasks of directions: orientation on SO(3), pose on SE(3), and the heading of a planar robot."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from eos_pin.arrays import Jacobian, TaskVector, Vector, numbers, vector
from eos_pin.errors import InputError
from eos_pin.robot import Robot
from eos_pin.tasks import WORLD, Point, PointLike, Task


class OrientationTask(Task, kind="orientation"):
    """Orientation of a frame on SO(3) [rad].

    z is the rotation matrix, dz the angular velocity in world axes, `minus(R1, R0)` the rotation vector of R1 R0ᵀ.

    Args:
        robot: The robot.
        frame: Frame that is oriented.
    """

    arguments = ("frame",)

    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("rx", "ry", "rz"), ["rad"] * 3, 9)

    def _z(self, data: pin.Data) -> Point:
        return pin.updateFramePlacement(self._model, data, self._id).rotation.flatten()

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, WORLD)[3:]

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, WORLD).angular

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return pin.log3(z1.reshape(3, 3).dot(z0.reshape(3, 3).T))

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return pin.exp3(delta).dot(z.reshape(3, 3)).ravel()

    def local_rate(self, delta: TaskVector, dz: TaskVector) -> TaskVector:
        # Jexp3 is for a velocity in the moving frame; transposed it is for one in the frame at rest. Jlog3 would be its
        # inverse for rotations up to π only, and the trial points of an integrator go beyond.
        return np.linalg.solve(pin.Jexp3(delta).T, dz)

    def local_margin(self, delta: TaskVector) -> float:
        return 1.0 - math.sqrt(delta.dot(delta)) / math.pi

    def point(self, value: PointLike) -> Point:
        return _rotation(value.rotation if isinstance(value, pin.SE3) else value, f"a point of {self!r}")


class PoseTask(Task, kind="pose"):
    """Pose of a frame on SE(3): position [m] and orientation [rad].

    z is the position followed by the rotation matrix, dz = (velocity of the origin, angular velocity) in world axes.
    `minus` is the logarithm whose curves are straight lines with a constant axis of rotation: the geodesics of SE(3).

    Args:
        robot: The robot.
        frame: Frame that is placed.
    """

    arguments = ("frame",)

    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("x", "y", "z", "rx", "ry", "rz"), ["m"] * 3 + ["rad"] * 3, 12)

    def _z(self, data: pin.Data) -> Point:
        matrix = pin.updateFramePlacement(self._model, data, self._id).homogeneous
        z = np.empty(12)
        z[:3] = matrix[:3, 3]
        z[3:] = matrix[:3, :3].ravel()
        return z

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, WORLD)

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, WORLD).vector

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        delta = (z1 - z0)[:6]
        delta[3:] = pin.log3(z1[3:].reshape(3, 3).dot(z0[3:].reshape(3, 3).T))
        return delta

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return np.concatenate((z[:3] + delta[:3], pin.exp3(delta[3:]).dot(z[3:].reshape(3, 3)).ravel()))

    def local_rate(self, delta: TaskVector, dz: TaskVector) -> TaskVector:
        return np.concatenate((dz[:3], np.linalg.solve(pin.Jexp3(delta[3:]).T, dz[3:])))

    def local_margin(self, delta: TaskVector) -> float:
        return 1.0 - math.sqrt(delta[3:].dot(delta[3:])) / math.pi

    def point(self, value: PointLike) -> Point:
        name = f"a point of {self!r}"
        if not isinstance(value, pin.SE3):
            array = numbers(value, name)
            if array.shape != (4, 4):
                array = vector(array, 12, f"{name}, a pin.SE3, a 4 × 4 matrix or a flat point,")
                return np.concatenate((array[:3], _rotation(array[3:], name)))
            if array[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
                raise InputError(f"the last row of {name} must be 0, 0, 0, 1, got {array[3].tolist()}")
        else:
            array = value.homogeneous
        return np.concatenate((vector(array[:3, 3], 3, name), _rotation(array[:3, :3], name)))


class HeadingTask(Task, kind="heading"):
    """Heading of a frame on a planar robot: its angle about the world's z axis [rad].

    Args:
        robot: A robot whose revolute joints all turn about the world's z axis.
        frame: Frame whose heading counts.

    Raises:
        InputError: The frame can turn about another axis; use `OrientationTask`.
    """

    arguments = ("frame",)

    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("heading",), ("rad",))
        tilting = pin.computeFrameJacobian(self._model, self._data, self._rest, self._id, WORLD)[3:5]
        if np.abs(tilting).max() > 1e-9:
            raise InputError(f"frame {frame!r} of {robot.name!r} also turns about x or y; use OrientationTask")

    def _z(self, data: pin.Data) -> Point:
        R = pin.updateFramePlacement(self._model, data, self._id).rotation
        return np.array([math.atan2(R[1, 0], R[0, 0])])

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, WORLD)[5:]

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, WORLD).angular[2:]

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return np.array([math.remainder(z1[0] - z0[0], math.tau)])


def _rotation(value: PointLike, name: str) -> Vector:
    """Flat rotation matrix, its rounding errors removed.

    Raises:
        InputError: Not 9 numbers, or not orthonormal to 1e-6.
    """
    R = vector(numbers(value, f"the rotation of {name}").ravel(), 9, f"the rotation of {name}").reshape(3, 3)
    E = R.T.dot(R) - np.eye(3)
    if np.abs(E).max() > 1e-6 or np.linalg.det(R) < 0.0:
        raise InputError(f"the rotation of {name} must be a 3 × 3 matrix with orthonormal columns and determinant 1")
    # R (RᵀR)^(−1/2), the nearest rotation, by its series to order E².
    return (R - R.dot(0.5 * E - 0.375 * E.dot(E))).ravel()
