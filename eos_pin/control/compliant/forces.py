"""Forces wanted along some coordinates of a task, while the others keep their impedance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eos_pin._arrays import Positive, TaskVector, Vector, by_value, checked, number
from eos_pin.errors import InputError, UnknownNameError
from eos_pin.tasks.base import Task


@by_value
@checked
@dataclass(frozen=True, eq=False)
class ForceGoal:
    """Force that the robot is to exert on its environment along some coordinates of the task.

    Along them there is no spring; the damping D stays. The force is f_d + rate ∫ (f_d − f) dt with the force f that is
    measured or observed. Without contact the tool moves on with f_d over its damping.

    In contact of any stiffness that is stable for rates below D over the mass M along that direction: the loop is
    M s³ + D s² + k s + k rate, stable for D k > M rate k. The default leaves half of the damping. Towards a
    surface that recedes with an acceleration a the force is off by about D a / rate.

    Attributes:
        forces: Wanted force by label of the coordinate, along the axes of the controller's gains, such as
            `{"z": -10.0}` to press downwards with those of the world [N, N m].
        rate: Rate at which an error of the force is forgotten [1/s]; by default half of D / M where the mode or
            the chart begins.
        most: Largest part of the integral, as a multiple of the wanted force and at least so many newtons.
    """

    forces: Mapping[str, float]
    rate: float | None = None
    most: Positive = 2.0

    def __post_init__(self) -> None:
        if not self.forces:
            raise InputError("a ForceGoal needs at least one force, such as {'z': -10.0}")
        if self.rate is not None:
            number(self.rate, "the rate of a ForceGoal", above=0.0)
        object.__setattr__(
            self, "forces", {str(key): number(f, f"the force along {key}") for key, f in self.forces.items()}
        )

    def _check(self, task: Task) -> None:
        """Refuse a task that lacks one of the coordinates.

        Raises:
            UnknownNameError: It lacks one.
        """
        for label in self.forces:
            if label not in task.labels:
                raise UnknownNameError("coordinate of the task", label, task.labels)

    def _rows(self, task: Task) -> list[int]:
        """Numbers of the coordinates."""
        return [task.labels.index(label) for label in self.forces]

    def _wanted(self, task: Task) -> TaskVector:
        """Force that is wanted, zero along the other coordinates."""
        force = np.zeros(task.m)
        force[self._rows(task)] = list(self.forces.values())
        return force

    def _integrated(self, integral: Vector, exerted: Vector, past: float, task: Task, rates: Vector) -> Vector:
        """The integral after some time.

        Args:
            integral: The integral before, (m,).
            exerted: Force on the environment, (m,).
            past: Time [s].
            task: The task.
            rates: Rates where none is given, (m,) [1/s].
        """
        wanted, rows = self._wanted(task), self._rows(task)
        found = integral.copy()
        rate = rates[rows] if self.rate is None else self.rate
        bound = self.most * np.maximum(np.abs(wanted[rows]), 1.0)
        found[rows] = np.clip(found[rows] + rate * past * (wanted - exerted)[rows], -bound, bound)
        return found
