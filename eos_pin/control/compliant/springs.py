"""Springs of a task and of the self-motion, as gradients of an energy.

A spring's energy is u = ½ eᵀK e in an error e that has a form for each kind of coordinate: differences of numbers and
angles, and twice the vector part ε of the unit quaternion of R_d Rᵀ for rotations. So the moment of a rotation is
2 (η K ε − ε × K ε): for small angles K times the rotation vector, bounded, smooth at every angle, and without work over
a closed way (Caccavale, Natale, Siciliano, Villani, IEEE Trans. Robot. Autom. 15(6), 1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Vector
from eos_pin.errors import InputError
from eos_pin.tasks.base import Point, Task

#: Rows of dz that a part of a task point of each kind has.
ROWS = {"rotation": 3, "angle": 1, "direction": 2}


def rotation_rows(task: Task) -> tuple[tuple[slice, slice], ...]:
    """Rows of dz that are angular velocities, and entries of z that are the rotation matrices, in pairs.

    Raises:
        InputError: The task has directions, in which a stiffness has no axes of its own.
    """
    found, row = [], 0
    for part, kind in task.channels():
        rows = ROWS.get(kind, part.stop - part.start)
        if kind == "direction":
            raise InputError(
                f"an impedance needs coordinates with fixed axes; those of {task!r} turn from point to point. Use a "
                "pose with little stiffness about the tool's axis"
            )
        if kind == "rotation":
            found.append((slice(row, row + rows), part))
        row += rows
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Clip:
    """Bound of a spring's force: beyond an energy the force keeps its size, and stays the gradient of an energy.

    The energy is u up to `level` and 2 √(u · level) − level beyond, so that the force is K e times √(level / u).

    Attributes:
        rows: Coordinates that the bound is for.
        K: Their stiffness, (k, k).
        level: Energy from which the force is bounded [J].
    """

    rows: slice
    K: Float[Array, "k k"]
    level: float

    def factor(self, e: Vector) -> float:
        """Factor of the force K e."""
        part = e[self.rows]
        u = 0.5 * float(part.dot(self.K.dot(part)))
        return math.sqrt(self.level / u) if u > self.level else 1.0

    def saved(self, e: Vector) -> float:
        """Energy by which the bounded spring has less than the other [J]."""
        part = e[self.rows]
        u = 0.5 * float(part.dot(self.K.dot(part)))
        return u + self.level - 2.0 * math.sqrt(u * self.level) if u > self.level else 0.0


def tool_axes(task: Task, rotations: tuple[tuple[slice, slice], ...], z: Point) -> Float[Array, "m m"]:
    """Matrix that turns components along the tool's axes at z into those along the world's."""
    T = np.eye(task.m)
    R = z[rotations[0][1]].reshape(3, 3)
    for i in range(0, task.m, 3):
        T[i : i + 3, i : i + 3] = R
    return T


def check_tool_axes(task: Task, rotations: tuple[tuple[slice, slice], ...]) -> None:
    """Refuse axes of the tool where the task does not have its orientation.

    Raises:
        InputError: It has not.
    """
    if len(rotations) != 1 or task.m not in (3, 6) or task.seen_from:
        raise InputError(
            f"axes='tool' needs a task that has the tool's orientation, such as PoseTask or OrientationTask; {task!r} "
            "has not. Give the gains along the axes of the task itself: axes='world'"
        )
