"""Tasks of a tool that may turn about its axis: the axis' direction on the sphere, and a point with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Array, Jacobian, TaskVector, checked
from eos_pin._kernels.flat import Part
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks import _sphere
from eos_pin.tasks.base import Channel, Point, PointLike, Task
from eos_pin.tasks.position import PositionTask
from eos_pin.tasks.stacked import StackedTask

#: An axis of a frame: its name, or three numbers, in text as well.
AxisLike: TypeAlias = "str | Sequence[float] | Array"
#: Axes of a frame by name.
AXES = {sign + name: (-1.0 if sign else 1.0) * np.eye(3)[i] for sign in ("", "-") for i, name in enumerate("xyz")}


class AxisTask(Task, kind="axis"):
    """Direction of an axis of a frame on the sphere S² [rad]; turns about the axis are free.

    z is the direction as a unit vector in world axes, `minus(a1, a0)` the logarithm on the sphere: the angle between
    them along the great circle from a0, in a basis that depends on a0 alone. Where a1 is opposite to a0 every great
    circle is as short; the first vector of that basis is taken.

    Args:
        robot: The robot.
        frame: Frame that has the axis.
        axis: Axis in the frame: `"x"`, `"y"`, `"z"`, `"-x"`, `"-y"`, `"-z"`, or three numbers.

    Raises:
        InputError: No axis.
    """

    arguments: tuple[str, ...] = ("frame", "axis")
    is_curved = True
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, frame: str, axis: AxisLike = "z") -> None:
        self.frame, self._axis = frame, tool_axis(axis)
        self.axis = tuple(self._axis.tolist())
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("tilt1", "tilt2"), ("rad", "rad"), 3)

    def compute_point(self, data: pin.Data) -> Point:
        a = self.frame_placement(data, self._id).rotation.dot(self._axis)
        return a / math.sqrt(a.dot(a))

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        # Velocity ω × a along e1 and e2 = a × e1.
        e1, e2 = _sphere.basis(self._compute_point(data))
        return np.array([e2, -e1]).dot(self.frame_jacobian(data, self._id)[3:])

    def compute_drift(self, data: pin.Data) -> TaskVector:
        a = self._compute_point(data)
        omega = self.frame_velocity(data, self._id).angular
        E = _sphere.basis(a)
        across = np.array([E[1], -E[0]])
        dz = across.dot(omega)
        turning = across.dot(self.frame_acceleration(data, self._id).angular) + omega.dot(a) * E.dot(omega)
        return turning + _sphere.bending(a, dz)

    def frame_parts(self) -> tuple[Part, ...] | None:
        return (Part("axis", self._id, direction=self.axis),)

    def channels(self) -> tuple[Channel, ...]:
        return (Channel(slice(0, 3), "direction"),)

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return _sphere.log(z1, z0)

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return _sphere.exp(z, delta)

    def local_rate(self, delta: TaskVector, dz: TaskVector, z_bar: Point | None = None) -> TaskVector:
        if z_bar is None:
            raise InputError("the local rate of a direction needs z_bar, the direction that the coordinates are about")
        return _sphere.local_rate(delta, dz, z_bar)

    def local_margin(self, delta: TaskVector) -> float:
        return 1.0 - math.sqrt(delta.dot(delta)) / math.pi

    def tracking_acceleration(
        self, z: Point, dz: TaskVector, target: Any, kp: TaskVector, kd: TaskVector
    ) -> TaskVector:
        return _sphere.tracking_acceleration(z, dz, target, kp, kd)

    def point(self, value: PointLike) -> Point:
        turned = value.rotation.dot(self._axis) if isinstance(value, pin.SE3) else value
        return _sphere.direction(turned, self._point_name)


class PointAxisTask(StackedTask, kind="point_axis"):
    """Position of a frame's origin [m] and direction of an axis of it [rad]: a pose up to turns about the axis.

    For tools that look the same from all sides, such as torches, drills and spray guns. z is the position followed by
    the direction, 6 numbers for m = 5.

    Args:
        robot: The robot.
        frame: Frame that does the task.
        axis: Axis in the frame: `"x"`, `"y"`, `"z"`, `"-x"`, `"-y"`, `"-z"`, or three numbers.

    Raises:
        InputError: No axis.
    """

    arguments = ("frame", "axis")

    @checked
    def __init__(self, robot: Robot, frame: str, axis: AxisLike = "z") -> None:
        direction = AxisTask(robot, frame, axis)
        self.axis = direction.axis
        super().__init__([PositionTask(robot, frame), direction])

    def point(self, value: PointLike) -> Point:
        if isinstance(value, pin.SE3):
            value = np.concatenate((value.translation, self.tasks[1].point(value)))
        return super().point(value)

    def describe(self) -> dict[str, Any]:
        return Task.describe(self)


def tool_axis(axis: AxisLike) -> Array:
    """Unit vector of an axis of a frame, by its name or from three numbers.

    Raises:
        InputError: No axis.
    """
    if isinstance(axis, str):
        words = axis.replace(",", " ").split()
        if len(words) == 1 and words[0] in AXES:
            return AXES[words[0]]
        try:
            axis = [float(word) for word in words]
        except ValueError:
            axis = []
        if len(axis) != 3:
            raise InputError(f"a tool axis is one of {', '.join(AXES)}, or three numbers such as '0 0 1'")
    return _sphere.direction(axis, "the tool axis")
