"""Disturbances of a run: friction, forces on the task, sensor noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin._arrays import (
    Checked,
    JointVector,
    NonNegative,
    VectorLike,
    as_floats,
    broadcast,
    by_value,
    checked,
    frozen_copy,
    number,
    unchecked,
    vector_of,
)
from eos_pin.errors import InputError, refuse_unused
from eos_pin.tasks.base import Task


@by_value
@checked
@dataclass(frozen=True, eq=False)
class TaskForce(Checked):
    """A force of the environment on a task, F^z of Eq. (24).

    Attributes:
        task: The task whose coordinates it acts along.
        force: Force as a function of time, (m,) [N, N m].
    """

    task: Task
    force: Callable[[float], VectorLike]

    @checked
    def torque(self, t: float, q: JointVector) -> JointVector:
        """Joint torques G'ᵀF^z equivalent to the force [N m or N]."""
        return self.task._set_time(t)._linearize(q)[1].T @ vector_of("force of a TaskForce", self.task.m, self.force, t)

    _torque = unchecked(torque)


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Friction(Checked):
    """Friction in the joints of a plant: −viscous dq − coulomb tanh(dq / speed).

    Attributes:
        viscous: Viscous friction, one number or (n,) [N m s/rad or N s/m].
        coulomb: Dry friction of a joint that moves, one number or (n,) [N m or N].
        speed: Speed at which dry friction is three quarters of its full value; the law is smooth, so a joint creeps
            where a real one would stick [rad/s or m/s].
    """

    viscous: VectorLike | float = 0.0
    coulomb: VectorLike | float = 0.0
    speed: float = 0.1

    def __post_init__(self) -> None:
        number(self.speed, "the speed of dry friction", above=0.0)
        for name in ("viscous", "coulomb"):
            values = as_floats(getattr(self, name), name)
            values = frozen_copy(broadcast(values, np.size(values), f"{name} friction"))
            if not (values >= 0.0).all():
                raise InputError(f"{name} friction must be at least 0, got {values.tolist()}")
            object.__setattr__(self, name, values if values.size != 1 else float(values[0]))
        if not np.any(self.coulomb):
            refuse_unused(Friction, "there is no dry friction; add coulomb", speed=self.speed)

    @checked
    def torque(self, dq: JointVector) -> JointVector:
        """Torque on the joints at these velocities [N m or N]."""
        return -np.asarray(self.viscous) * dq - np.asarray(self.coulomb) * np.tanh(dq / self.speed)

    def describe(self) -> dict[str, Any]:
        """The same in plain values."""
        viscous, coulomb = (np.asarray(values).tolist() for values in (self.viscous, self.coulomb))
        return {"viscous": viscous, "coulomb": coulomb, "speed": self.speed}

    _torque = unchecked(torque)


@checked
@dataclass(frozen=True)
class SensorNoise:
    """Normally distributed errors of measured joints and velocities.

    Attributes:
        q: Standard deviation of the joints [rad or m].
        dq: Standard deviation of the joint velocities [rad/s or m/s].
    """

    q: NonNegative = 0.0
    dq: NonNegative = 0.0
