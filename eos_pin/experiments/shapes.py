"""Shapes of paths through a task point: their axes, planes and sizes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np

from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Hold, Trajectory
from eos_pin.trajectories.harmonic import Harmonic, circle, figure_eight, line
from eos_pin.trajectories.stacked import StackedTrajectory

Shape: TypeAlias = Literal["eight", "circle", "line", "hold"]
SHAPES: tuple[Shape, ...] = ("eight", "circle", "line", "hold")


def planes(free: Sequence[str], shape: Shape) -> list[str]:
    """Planes, or axes, in which a shape is tried, the best first."""
    if shape == "line" or len(free) == 1:
        return list(reversed(free))
    pairs = [a + b for i, a in enumerate(free) for b in free[i + 1 :]]
    # A figure drawn on a wall in front of the robot reads best.
    return sorted(pairs, key=lambda pair: pair != "yz")


def sizes(robot: Robot) -> list[float]:
    """Sizes that are tried, round numbers from a quarter of the reach downwards [m]."""
    largest = 0.25 * robot.reach
    factors = np.concatenate((0.8 ** np.arange(12), 0.8**12 * 0.5 ** np.arange(7)))
    return [float(f"{largest * factor:.2g}") for factor in factors]


def drawn(
    task: Task, z: np.ndarray, shape: Shape, size: float, plane: str, free: Sequence[str], period: float
) -> Trajectory:
    """The path in the task's own coordinates, begun at z."""
    k = len(free)
    center = z[:k]
    axes = "".join("xyz"[i] for i in range(k))
    # Plane and axes are named by the task's labels; the shapes count them from the first.
    chosen = [plane] if plane in free else list(plane)
    unknown = [axis for axis in chosen if axis not in free]
    if unknown or len(chosen) != (1 if shape == "line" or k == 1 else 2) or len(set(chosen)) != len(chosen):
        wanted = "one of the axes" if shape == "line" or k == 1 else "two of the axes"
        raise InputError(f"a {shape} of this task lies along {wanted} {', '.join(free)}; got {plane!r}")
    named = "".join(axes[list(free).index(axis)] for axis in chosen)
    path: Harmonic
    if shape == "line" or k == 1:
        path = line(center, size * np.eye(k)["xyz".index(named)], period=period)
    elif shape == "circle":
        path = circle(center, size, period=period, plane=named)
    else:
        path = figure_eight(center, size, period=period, plane=named)
    if z.size == k:
        return path
    return StackedTrajectory((path, Hold(z[k:], task.m - k)))
