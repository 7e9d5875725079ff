"""Tasks between two frames, or a frame and a point: relative poses and distances."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Array, Jacobian, TaskVector, checked, vector
from eos_pin.errors import SingularError
from eos_pin.robot.model import Robot
from eos_pin.tasks._flat import FLAT
from eos_pin.tasks.base import Point, Task
from eos_pin.tasks.orientation import PosePoints

#: Least distance that has a direction [m].
NEAREST = 1e-9


class RelativePoseTask(PosePoints, kind="relative_pose"):
    """Pose of a frame seen from another frame of the same robot, in that frame's axes [m, rad].

    The other frame may be fixed or move, such as the other hand of a two-armed robot. z is the position followed by the
    rotation matrix, dz the velocity and angular velocity as seen from the reference.

    Args:
        robot: The robot.
        frame: Frame that is placed.
        reference: Frame it is seen from.
    """

    arguments = ("frame", "reference")
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, frame: str, reference: str) -> None:
        self.frame, self.reference, self.seen_from = frame, reference, reference
        self._id, self._reference_id = robot.frame_id(frame), robot.frame_id(reference)
        super().__init__(robot, ("x", "y", "z", "rx", "ry", "rz"), ["m"] * 3 + ["rad"] * 3, 12)

    def compute_point(self, data: pin.Data) -> Point:
        frame, reference = (self.frame_placement(data, i) for i in (self._id, self._reference_id))
        return reference.actInv(frame).homogeneous.ravel()[FLAT]

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        R, rho = self._relative(data)
        J, J_ref = (self.frame_jacobian(data, i) for i in (self._id, self._reference_id))
        linear = J[:3] - J_ref[:3] + pin.skew(rho).dot(J_ref[3:])
        return np.concatenate((R.T.dot(linear), R.T.dot(J[3:] - J_ref[3:])))

    def compute_drift(self, data: pin.Data) -> TaskVector:
        R, rho = self._relative(data)
        v, v_ref = (self.frame_velocity(data, i) for i in (self._id, self._reference_id))
        a, a_ref = (self.frame_acceleration(data, i) for i in (self._id, self._reference_id))
        omega, slide = v_ref.angular, v.linear - v_ref.linear - np.cross(v_ref.angular, rho)
        # Acceleration seen from a frame that turns: minus Euler, centrifugal and Coriolis terms.
        linear = (
            a.linear
            - a_ref.linear
            - np.cross(a_ref.angular, rho)
            - np.cross(omega, np.cross(omega, rho))
            - 2.0 * np.cross(omega, slide)
        )
        angular = a.angular - a_ref.angular - np.cross(omega, v.angular)
        return np.concatenate((R.T.dot(linear), R.T.dot(angular)))

    def _relative(self, data: pin.Data) -> tuple[Array, Array]:
        frame, reference = (self.frame_placement(data, i) for i in (self._id, self._reference_id))
        return reference.rotation.copy(), frame.translation - reference.translation


class DistanceTask(Task, kind="distance"):
    """Distance of a frame's origin from a point of the world [m].

    Where it is zero it has no direction in which it grows, and its Jacobian raises `SingularError`.

    Args:
        robot: The robot.
        frame: Frame whose origin counts.
        centre: The point [m], (3,).

    Raises:
        InputError: No point.
    """

    arguments = ("frame", "centre")
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, frame: str, centre: Sequence[float] | Array) -> None:
        self.frame, self._centre = frame, vector(centre, 3, "the centre of a DistanceTask")
        self.centre = tuple(self._centre.tolist())
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("distance",), ("m",))

    def compute_point(self, data: pin.Data) -> Point:
        way = self._way(data)
        return np.array([math.sqrt(way.dot(way))])

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return self._outward(data)[0][None].dot(self.frame_jacobian(data, self._id)[:3])

    def compute_drift(self, data: pin.Data) -> TaskVector:
        outward, distance = self._outward(data)
        velocity = self.frame_velocity(data, self._id).linear
        across = velocity - outward.dot(velocity) * outward
        bent = float(outward.dot(self.frame_acceleration(data, self._id).linear))
        return np.array([bent + float(across.dot(across)) / distance])

    def _way(self, data: pin.Data) -> Array:
        return self.frame_placement(data, self._id).translation - self._centre

    def _outward(self, data: pin.Data) -> tuple[Array, float]:
        way = self._way(data)
        distance = math.sqrt(way.dot(way))
        if distance < NEAREST:
            raise SingularError(
                f"frame {self.frame!r} is at the centre of {self!r}: there the distance grows in every direction, and "
                "has no Jacobian. Start elsewhere, or choose a task of position"
            )
        return way / distance, distance
