"""Task of a tool that points towards a place: a camera, a sensor, a nozzle."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Array, Jacobian, TaskVector, checked, frozen_copy, vector
from eos_pin.errors import SingularError
from eos_pin.robot.model import Robot
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks import _sphere
from eos_pin.tasks.axis import AxisLike, AxisTask
from eos_pin.tasks.base import Point
from eos_pin.tasks.relations import NEAREST
from eos_pin.tasks.target import Hold


class LookAtTask(AxisTask, kind="look_at"):
    """Direction in which a frame sees a point of the world, on the sphere S² [rad].

    z is the unit vector from the frame's origin to the point, in the axes of the frame. Where it is the tool's axis,
    the tool points at the point; `aim()` is that target. Where the origin is at the point there is no direction.

    Args:
        robot: The robot.
        frame: Frame that looks.
        centre: The point in the world [m], (3,).
        axis: Axis in the frame that looks: `"x"`, `"y"`, `"z"`, `"-x"`, `"-y"`, `"-z"`, or three numbers.

    Raises:
        InputError: No axis, or no point.
    """

    arguments = ("frame", "centre", "axis")

    @checked
    def __init__(self, robot: Robot, frame: str, centre: Sequence[float] | Array, axis: AxisLike = "z") -> None:
        self._centre = frozen_copy(vector(centre, 3, "the centre of a LookAtTask"))
        self.centre = tuple(self._centre.tolist())
        super().__init__(robot, frame, axis)

    def aim(self, q: JointsLike | None = None) -> Hold:
        """Goal at which the axis points at the centre, wherever the joints are."""
        return Hold(self._axis, 2)

    def compute_point(self, data: pin.Data) -> Point:
        b = self.frame_placement(data, self._id).rotation.T.dot(self._sight(data)[0])
        return b / math.sqrt(b.dot(b))

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        w, distance = self._sight(data)
        E = _sphere.basis(self._compute_point(data)).dot(self.frame_placement(data, self._id).rotation.T)
        J = self.frame_jacobian(data, self._id)
        # Of the velocity of the line of sight, what is along it does not count: E is normal to it.
        return E.dot(pin.skew(w).dot(J[3:]) - J[:3] / distance)

    def compute_drift(self, data: pin.Data) -> TaskVector:
        w, distance = self._sight(data)
        b = self._compute_point(data)
        E = _sphere.basis(b).dot(self.frame_placement(data, self._id).rotation.T)
        velocity, acceleration = self.frame_velocity(data, self._id), self.frame_acceleration(data, self._id)
        v, omega = velocity.linear, velocity.angular
        closing = float(w.dot(v))
        dw = (closing * w - v) / distance
        ddw = (2.0 * closing * dw - acceleration.linear) / distance
        # Seen from a frame that turns.
        seen = ddw - np.cross(acceleration.angular, w) - 2.0 * np.cross(omega, dw) + np.cross(omega, np.cross(omega, w))
        return E.dot(seen) + _sphere.bending(b, E.dot(dw - np.cross(omega, w)))

    def _sight(self, data: pin.Data) -> tuple[Array, float]:
        """Unit vector from the frame's origin to the centre, in world axes, and the distance."""
        way = self._centre - self.frame_placement(data, self._id).translation
        distance = math.sqrt(way.dot(way))
        if distance < NEAREST:
            raise SingularError(
                f"frame {self.frame!r} is at the point that {self!r} looks at, so there is no direction to it. Start "
                "elsewhere, or choose another point"
            )
        return way / distance, distance
