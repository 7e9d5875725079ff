"""What a trajectory is: a target (z, dz, ddz) for every time.

Each trajectory is a value that is called with a time. Points are flat arrays as in `eos_pin.tasks`; dz and ddz have the
task's dimension m.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eos_pin._arrays import JointVector, TaskVector, frozen_copy, vector
from eos_pin.errors import InputError
from eos_pin.tasks.base import Point, Task


class Target(NamedTuple):
    """What the task should be at one time.

    Attributes:
        z: Task point.
        dz: Task velocity [m/s, rad/s].
        ddz: Task acceleration [m/s², rad/s²].
    """

    z: Point
    dz: TaskVector
    ddz: TaskVector


class JointTarget(NamedTuple):
    """What the joints should be at one time.

    Attributes:
        q: Joints [rad or m].
        dq: Their velocities.
        ddq: Their accelerations.
    """

    q: JointVector
    dq: JointVector
    ddq: JointVector


class Trajectory(ABC):
    """A target for every time.

    Attributes:
        period: Time after which it repeats [s]; infinite if it does not.
        duration: Time after which it rests [s]; infinite if it never does.
        begin: Time until which it rests [s].
        notes: What was chosen or changed when it was made from a file, in sentences for people.
    """

    period: float = math.inf
    duration: float = math.inf
    begin: float = 0.0
    notes: tuple[str, ...] = ()

    @abstractmethod
    def __call__(self, t: float) -> Target:
        """Target at time t [s]."""


@dataclass(frozen=True)
class Hold(Trajectory):
    """One point, at rest.

    Attributes:
        z: The point.
        m: Dimension of the task, if it is not the length of z (6 for a pose, 3 for an orientation).
    """

    z: Point
    m: int | None = None
    duration = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "z", frozen_copy(vector(self.z, None, "the point to hold")))
        rest = frozen_copy(np.zeros(self.z.size if self.m is None else self.m))
        object.__setattr__(self, "_target", Target(self.z, rest, rest))

    def __call__(self, t: float) -> Target:
        return self._target  # type: ignore[attr-defined]


def check_reference(task: Task, reference: Trajectory) -> None:
    """Refuse a reference that does not fit the task.

    Raises:
        InputError: It does not fit.
    """
    target = reference(0.0)
    try:
        task.point(target.z)
    except InputError as error:
        raise InputError(f"the reference does not fit the task: {error}") from error
    if target.dz.shape != (task.m,):
        raise InputError(f"the reference has {target.dz.size} velocities, but {task!r} has {task.m}; a Hold takes m=")
