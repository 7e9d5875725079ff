"""`JointMap`: joints in the order and by the names of messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eos_pin._arrays import Array, JointVector, VectorLike, as_floats, by_value, frozen_copy, vector
from eos_pin.errors import InputError, UnknownNameError
from eos_pin.robot.model import Robot


@by_value
@dataclass(frozen=True, eq=False)
class JointMap:
    """Joints of a robot in the order of a message, such as a joint state that lists other joints as well.

    Attributes:
        robot: The robot.
        names: Names in the order of the message; each joint of the robot is among them once.

    Raises:
        UnknownNameError: A joint of the robot is not in the message.
        InputError: A name is given twice.
    """

    robot: Robot
    names: Sequence[str]

    def __post_init__(self) -> None:
        if not isinstance(self.robot, Robot):
            raise InputError(f"robot must be a Robot, got {self.robot!r}")
        if isinstance(self.names, str) or not isinstance(self.names, Sequence):
            raise InputError(f"names must be a list of joint names, got {self.names!r}")
        names = tuple(map(str, self.names))
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"a message names each joint once, got {', '.join(twice)} more than once")
        for joint in self.robot.joints:
            if joint.name not in names:
                raise UnknownNameError("joint in the message", joint.name, names)
        object.__setattr__(self, "names", names)

    @cached_property
    def places(self) -> Array:
        """Index of each joint of the robot in the message, (n,)."""
        return frozen_copy(np.array([self.names.index(joint.name) for joint in self.robot.joints]), int)

    def to_robot(self, values: VectorLike) -> JointVector:
        """Values of the robot's joints, from those of a message.

        Args:
            values: One value for each name of the message; those of other joints may be anything.

        Raises:
            InputError: Another number of values, or one of the robot's joints has none that is finite.
        """
        row = self._row(values)
        return vector(row[self.places], self.robot.n, "the values of the robot's joints")

    def to_message(self, values: VectorLike, others: VectorLike | float = 0.0) -> Array:
        """Values in the order of the message, from those of the robot's joints.

        Args:
            values: Values of the robot's joints.
            others: Values of the message in which the robot's joints are filled in, such as the last one that came, or
                one number for all joints that are not the robot's.
        """
        filled = np.full(len(self.names), others) if isinstance(others, (int, float)) else others
        row = self._row(filled)
        row[self.places] = vector(values, self.robot.n, "the values of the robot's joints")
        return row

    def _row(self, values: VectorLike | float) -> Array:
        """Copy of the values of a message, not all of which need be numbers that count."""
        row = np.array(as_floats(values, "the values of a message"))
        if row.shape != (len(self.names),):
            raise InputError(f"a message has {len(self.names)} values, got shape {row.shape}")
        return row
