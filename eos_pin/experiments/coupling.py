"""Inertial coupling of task and self-motion around a base point, by metric."""

from __future__ import annotations

import numpy as np

from eos_pin._arrays import JointVector, checked
from eos_pin.charts.chart import Chart
from eos_pin.charts.dynamics import ExtendedDynamics
from eos_pin.charts.metric import MetricLike
from eos_pin.errors import ChartError
from eos_pin.tasks.base import Task


@checked
def coupling_around(
    task: Task, q: JointVector, metric: MetricLike, *, distance: float = 0.3, count: int = 30, seed: int = 0
) -> tuple[float, list[float]]:
    """Inertial coupling at the base point of a chart, and at joints at a distance from it in random directions.

    Args:
        task: The task.
        q: Base point.
        metric: Metric of the chart.
        distance: Length of q − q_bar [rad or m].
        count: How many directions.
        seed: Which they are.

    Raises:
        SingularError: The task is singular at q.
        RobotError: The robot has no valid inertia.
    """
    chart, random, found = Chart.from_base(task, q, metric=metric), np.random.default_rng(seed), []
    for direction in random.normal(size=(count, q.size)):
        near = q + distance * direction / np.linalg.norm(direction)
        try:
            found.append(ExtendedDynamics.from_state(task.robot, chart, near, 0.0 * q).coupling)
        except ChartError:  # beyond the edge
            continue
    return ExtendedDynamics.from_state(task.robot, chart, q, 0.0 * q).coupling, found
