"""The contract of trajectories: a target (z, dz, ddz) of a task for every time.

Each trajectory is a value that is called with a time. Points are flat arrays as in `eos_pin.tasks`; dz and ddz have the
task's dimension m. The families of trajectories are in `eos_pin.trajectories`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import JointVector, TaskVector, by_value, check_answers, frozen_copy, number
from eos_pin._kernels.overrides import stands_for
from eos_pin.errors import InputError
from eos_pin.tasks._flat import Point, flat_point


@by_value
class Target(NamedTuple):
    """Target of the task at one time.

    Attributes:
        z: Task point.
        dz: Task velocity [m/s, rad/s].
        ddz: Task acceleration [m/s², rad/s²].
    """

    z: Point
    dz: TaskVector
    ddz: TaskVector


@by_value
class JointTarget(NamedTuple):
    """Target of the joints at one time.

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
        notes: Choices and changes made when it was read from a file, in sentences for people.
        constant: The point of a trajectory that never moves; None for any other.
        waves: The same targets as sums of sines and cosines, see `Waves`; None where they are none.
    """

    period: float = math.inf
    duration: float = math.inf
    begin: float = 0.0
    notes: tuple[str, ...] = ()
    constant: Point | None = None
    waves: Any = None

    def __init_subclass__(cls, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        # A subclass of `Hold` or `Harmonic` with a call of its own may move otherwise.
        stands_for(cls, "constant", "__call__")
        stands_for(cls, "waves", "__call__")
        check_answers(cls, "__call__", Trajectory.__call__)

    @abstractmethod
    def __call__(self, t: float) -> Target:
        """Target at time t [s]."""

    def _take_times(self, other: Trajectory) -> None:
        """Take period, duration, beginning and notes from a trajectory that this one is made of."""
        for name in ("period", "duration", "begin", "notes"):
            object.__setattr__(self, name, getattr(other, name))


@by_value
@dataclass(frozen=True, eq=False)
class Hold(Trajectory):
    """One point, at rest. `Task.hold` makes that of a task's value at given joints.

    Attributes:
        z: The point; given as a flat point, or as a `pin.SE3`, 4 × 4 matrix (a pose) or 3 × 3 matrix (a rotation).
        m: Dimension of the task, where it is neither the length of z nor known from a matrix: 6 for a flat pose of
            12 numbers, 3 for a flat rotation of 9.

    Raises:
        InputError: No point, or a matrix of another dimension than m.
    """

    z: Point
    m: int | None = None
    duration = 0.0

    def __post_init__(self) -> None:
        z, m = flat_point(self.z, "the point to hold")
        if self.m is not None:
            if self.m != int(number(self.m, "m, the dimension of the task,", at_least=0.0)):
                raise InputError(f"m, the dimension of the task, must be a whole number, got {self.m!r}")
            if m not in (None, self.m):
                raise InputError(f"the point to hold has the form of a task of dimension {m}, but m={self.m} is given")
        object.__setattr__(self, "z", frozen_copy(z))
        object.__setattr__(self, "m", m if self.m is None else int(self.m))
        rest = frozen_copy(np.zeros(z.size if self.m is None else self.m))
        object.__setattr__(self, "_target", Target(self.z, rest, rest))

    def __call__(self, t: float) -> Target:
        return self._target  # type: ignore[attr-defined]

    @property
    def constant(self) -> Point:  # type: ignore[override]
        """The point."""
        return self._target.z  # type: ignore[attr-defined]
