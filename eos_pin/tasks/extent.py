"""Refusal of task points out of reach, before anything is computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array
from eos_pin.errors import InputError
from eos_pin.tasks.base import Task

#: Units in which people have lengths, the largest first, and how many of them are a metre.
UNITS = {"centimetres": 100.0, "millimetres": 1000.0, "micrometres": 1e6}


def check_reach(task: Task, z: Float[Array, "K size"], name: str, lines: Sequence[int] = ()) -> None:
    """Refuse task points that no posture within limits reaches.

    Args:
        task: The task.
        z: Task points, or their first coordinates.
        name: Source of the points, for the error message.
        lines: Lines of the points in the file `name`, for the error message.

    Raises:
        InputError: A point is out of reach. The message guesses the unit of the points.
    """
    for rows, center, radius in task.balls():
        points = z[:, rows]
        if points.shape[1] < len(center):
            continue
        distances = np.linalg.norm(points - center, axis=1)
        k = int(distances.argmax())
        if distances[k] <= radius * (1.0 + 1e-9):
            continue
        largest = float(np.abs(points).max())
        guess = next(
            (
                f"The largest coordinate is {largest:g}; if these are {unit}, divide by {factor:g}"
                for unit, factor in UNITS.items()
                if np.linalg.norm(points / factor - center, axis=1).max() <= radius
            ),
            "Choose points nearer to the base",
        )
        where = f"{name}, line {lines[k]}" if lines else name
        point = ", ".join(f"{x:g}" for x in points[k])
        raise InputError(
            f"{where}: the point ({point}) m is {distances[k]:.4g} m from the base of the chain, but {task!r} of "
            f"{task.robot.name!r} gets at most {radius:.4g} m away from it. {guess}"
        )
