"""Task of a tool that points towards a place: a camera, a sensor, a nozzle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Array, Jacobian, JointVector, TaskVector, checked, vector
from eos_pin.errors import SingularError
from eos_pin.robot.model import Robot
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks import _sphere
from eos_pin.tasks.axis import AxisLike, AxisTask
from eos_pin.tasks.base import Point, Task, TaskPoint
from eos_pin.tasks.relations import NEAREST
from eos_pin.tasks.target import Hold, Trajectory

#: Name of the point in messages.
CENTRE = "the centre of a LookAtTask"


class LookAtTask(AxisTask, kind="look_at"):
    """Direction in which a frame sees a point of the world, on the sphere S² [rad].

    z is the unit vector from the frame's origin to the point, in the axes of the frame. Where it is the tool's axis,
    the tool points at the point; `aim()` is that target. Where the origin is at the point there is no direction.

    A point that moves is given as a `Trajectory`. z = G(q, t) then, and the point's velocity is part of dz, its
    acceleration part of the drift, so that the error obeys the same law as with a point at rest. `EosController`,
    `LimitedEosController`, `KinematicLoop` and `simulate_extended` tell the task the time; whoever evaluates it himself
    calls `set_time`. Plans and descriptions of runs need a point at rest.

    Args:
        robot: The robot.
        frame: Frame that looks.
        centre: The point in the world [m], (3,), or its motion.
        axis: Axis in the frame that looks: `"x"`, `"y"`, `"z"`, `"-x"`, `"-y"`, `"-z"`, or three numbers.

    Raises:
        InputError: No axis, or no point.
    """

    arguments = ("frame", "centre", "axis")

    @checked
    def __init__(
        self, robot: Robot, frame: str, centre: Sequence[float] | Array | Trajectory, axis: AxisLike = "z"
    ) -> None:
        self.moves = isinstance(centre, Trajectory)
        motion = centre if isinstance(centre, Trajectory) else Hold(vector(centre, 3, CENTRE))
        self._motion: Trajectory = motion
        for part in motion(0.0):
            vector(part, 3, CENTRE)
        self._now = motion(0.0)
        self.centre = motion if self.moves else tuple(self._now.z.tolist())
        super().__init__(robot, frame, axis)

    def set_time(self, t: float) -> Task:
        if self.moves:
            self._now = self._motion(t)
        return self

    def at(self, q: JointVector, dq: JointVector) -> TaskPoint:
        point = super()._at(q, dq)
        if not self.moves:
            return point
        _, distance = self._sight(self._data)
        E = _sphere.basis(point.z).dot(self.frame_placement(self._data, self._id).rotation.T)
        return point._replace(dz=point.dz + E.dot(self._now.dz) / distance)

    def describe(self) -> dict[str, Any]:
        # How it moves is no plain value.
        return super().describe() | ({"centre": type(self._motion).__name__} if self.moves else {})

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
        # Seen from the point, which may move itself.
        v, omega = velocity.linear - self._now.dz, velocity.angular
        closing = float(w.dot(v))
        dw = (closing * w - v) / distance
        ddw = (2.0 * closing * dw - acceleration.linear + self._now.ddz) / distance
        # Seen from a frame that turns.
        seen = ddw - np.cross(acceleration.angular, w) - 2.0 * np.cross(omega, dw) + np.cross(omega, np.cross(omega, w))
        return E.dot(seen) + _sphere.bending(b, E.dot(dw - np.cross(omega, w)))

    def _sight(self, data: pin.Data) -> tuple[Array, float]:
        """Unit vector from the frame's origin to the centre, in world axes, and the distance."""
        way = self._now.z - self.frame_placement(data, self._id).translation
        distance = math.sqrt(way.dot(way))
        if distance < NEAREST:
            raise SingularError(
                f"frame {self.frame!r} is at the point that {self!r} looks at, so there is no direction to it. Start "
                "elsewhere, or choose another point"
            )
        return way / distance, distance
