"""Tasks of joints: linear combinations of joint positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Jacobian, JointVector, TaskVector, checked, frozen_copy, number
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point, Task, TaskPoint


class JointTask(Task, kind="joints"):
    """Linear combinations of joints, such as one joint, or the difference of two [rad or m].

    Args:
        robot: The robot.
        combinations: For each coordinate the names of joints and their factors, such as `[{"elbow": 1.0}]`.

    Raises:
        InputError: No such joint, no finite factor, or coordinates that depend on each other.
    """

    arguments = ("combinations",)
    _needs_frames = False

    @checked
    def __init__(self, robot: Robot, combinations: Sequence[Mapping[str, float]]) -> None:
        names = list(robot.joint_names)
        self.combinations = [
            {name: number(factor, f"the factor of joint {name!r}") for name, factor in row.items()}
            for row in combinations
        ]
        unknown = sorted({name for row in self.combinations for name in row} - set(names))
        if unknown:
            raise InputError(f"{robot.name!r} has no joint {', '.join(unknown)}; its joints are {', '.join(names)}")
        A = np.array([[row.get(name, 0.0) for name in names] for row in self.combinations]).reshape(-1, robot.n)
        if not len(A) or np.linalg.matrix_rank(A) < len(A):
            raise InputError("a JointTask needs one combination of joints or more, none of which follows from others")
        self._A = frozen_copy(A)
        kinds = {joint.name: joint.kind for joint in robot.joints}
        slides = [all(kinds[name] == "prismatic" for name in row) for row in self.combinations]
        labels = [_label(row) for row in self.combinations]
        super().__init__(robot, labels, ["m" if slide else "rad" for slide in slides])

    # The joints themselves are not in `data`.
    def value(self, q: JointVector) -> Point:
        return self._A.dot(q)

    def linearize(self, q: JointVector) -> tuple[Point, Jacobian]:
        return self._A.dot(q), self._A.copy()

    def at(self, q: JointVector, dq: JointVector) -> TaskPoint:
        return TaskPoint(self._A.dot(q), self._A.copy(), self._A.dot(dq), np.zeros(self.m))

    def compute_point(self, data: pin.Data) -> Point:
        raise InputError("a JointTask needs no hooks: call value, linearize or at")

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return self._A.copy()

    def compute_drift(self, data: pin.Data) -> TaskVector:
        return np.zeros(self.m)


def _label(row: Mapping[str, float]) -> str:
    return " ".join(name if factor == 1.0 else f"{factor:+g} {name}" for name, factor in row.items())
