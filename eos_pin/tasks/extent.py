"""Upper bounds of a task's reach, by which unreachable points are refused before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, Vector
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.tasks.orientation import PoseTask
from eos_pin.tasks.position import ComTask, PositionTask
from eos_pin.tasks.stacked import StackedTask

#: Units in which people have lengths, the largest first, and how many of them are a metre.
UNITS = {"centimetres": 100.0, "millimetres": 1000.0, "micrometres": 1e6}


class Ball(NamedTuple):
    """A ball that some coordinates of a task never leave.

    Attributes:
        rows: Which coordinates of z.
        center: Its centre in these coordinates [m].
        radius: Its radius [m].
    """

    rows: slice
    center: Vector
    radius: float


def balls(task: Task) -> tuple[Ball, ...]:
    """Balls about the base of the chain that the lengths in a task never leave, whatever the joints within limits.

    The radius is the length from joint to joint with all travel of sliders; where a slider has no limits, there is no
    ball. Along some axes only, the ball counts in these.

    Args:
        task: The task; of tasks of one's own nothing is known.
    """
    return tuple(ball for ball in _balls(task) if math.isfinite(ball.radius))


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
    for rows, center, radius in balls(task):
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


def _balls(task: Task) -> Iterator[Ball]:
    if isinstance(task, StackedTask):
        first = 0
        for part in task.tasks:
            for rows, center, radius in _balls(part):
                yield Ball(slice(first + rows.start, first + rows.stop), center, radius)
            first += part.size
    elif isinstance(task, (PositionTask, PoseTask)):
        model = task.robot.model
        frame = model.frames[task.robot.frame_id(task.frame)]
        center, radius = _chain(task.robot, frame.parentJoint)
        axes = ["xyz".index(axis) for axis in task.axes]
        yield Ball(slice(0, len(axes)), center[axes], radius + float(np.linalg.norm(frame.placement.translation)))
    elif isinstance(task, ComTask):
        # The centre of mass is a mean of those of the bodies, which all lie in a ball about the origin.
        radius = 0.0
        for joint, body in enumerate(task.robot.model.inertias):
            if joint and body.mass > 0.0:
                center, length = _chain(task.robot, joint)
                radius = max(radius, float(np.linalg.norm(center)) + length + float(np.linalg.norm(body.lever)))
        yield Ball(slice(0, task.m), np.zeros(task.m), radius)


def _chain(robot: Robot, joint: int) -> tuple[Vector, float]:
    """Place of the first joint on the way to a joint, and the length of the rest of the way [m]."""
    model: pin.Model = robot.model
    way = [i for i in model.supports[joint] if i]
    if not way:
        return np.zeros(3), 0.0
    center = model.jointPlacements[way[0]].translation.copy()
    length = sum(float(np.linalg.norm(model.jointPlacements[i].translation)) for i in way[1:])
    own = robot.coordinates
    travel = [
        max(abs(own.factor[i] * end[own.column[i]] + own.offset[i]) for end in (robot.lower, robot.upper))
        for i in way
        if own.slides[i]
    ]
    return center, length + float(sum(travel))
