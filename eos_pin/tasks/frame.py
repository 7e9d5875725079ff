"""Common part of the tasks of one frame: they are rows of its pose, its twist and its Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import pinocchio as pin

from eos_pin._arrays import Jacobian, JointVector, TaskVector
from eos_pin._kernels import plain_law
from eos_pin._kernels.dispatch import use_compiled
from eos_pin.robot.model import Robot
from eos_pin.tasks._flat import FLAT
from eos_pin.tasks.base import WORLD, Point, Task, TaskPoint

Frame = use_compiled(plain_law.Frame)


class FrameTask(Task):
    """A part of a frame's pose.

    Args:
        robot: The robot.
        frame: Its name.
        labels: Names of the coordinates.
        units: Their units.
        part: Which numbers of the flat pose are z.
        rows: Which of (velocity of the origin, angular velocity) are dz.
    """

    _needs_frames = False
    #: The compiled ones below are the same as what the hooks give.
    _by_hooks = True

    def __init__(
        self, robot: Robot, frame: str, labels: Sequence[str], units: Sequence[str], part: slice, rows: slice
    ) -> None:
        self.frame, self._part, self._rows = frame, part, rows
        self._id = robot.frame_id(frame)
        super().__init__(robot, labels, units, len(range(12)[part]))

    def compute_point(self, data: pin.Data) -> Point:
        return pin.updateFramePlacement(self._model, data, self._id).homogeneous.ravel()[FLAT[self._part]]

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, WORLD).reshape(6, -1)[self._rows]

    def compute_drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, WORLD).vector[self._rows]

    # -- the same, in one kernel -------------------------------------------------------------------------------------

    @cached_property
    def kernel(self) -> Any:
        """`value`, `linearize` and `at` in one object; None where a subclass overrides a part of them."""
        return Frame(self._model, self._data, self._id, self._part, self._rows, TaskPoint)

    def value(self, q: JointVector) -> Point:
        return super()._value(q) if self.kernel is None else self.kernel.value(q)

    def linearize(self, q: JointVector) -> tuple[Point, Jacobian]:
        return super()._linearize(q) if self.kernel is None else self.kernel.linearize(q)

    def at(self, q: JointVector, dq: JointVector) -> TaskPoint:
        return super()._at(q, dq) if self.kernel is None else self.kernel.at(q, dq)
