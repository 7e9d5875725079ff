"""Paths of tasks with tolerances, from paths of the whole tasks."""

from __future__ import annotations

from dataclasses import dataclass

from eos_pin._arrays import by_value, checked
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Target, Trajectory


@by_value
@checked
@dataclass(frozen=True, eq=False)
class ToleratedPath(Trajectory):
    """Path of a task with tolerances: the points of a path of the whole task, and rates of the tracked coordinates.

    Attributes:
        task: The task with tolerances.
        path: A path of its whole task.
    """

    task: Task
    path: Trajectory

    def __post_init__(self) -> None:
        self._take_times(self.path)

    def __call__(self, t: float) -> Target:
        z, dz, ddz = self.path(t)
        (rate,), (bend,) = self.task._rates(z[None], dz[None], ddz[None])
        return Target(z, rate, bend)
