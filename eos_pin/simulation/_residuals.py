"""A run checked again from its raw arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eos_pin._arrays import largest_magnitude
from eos_pin.robot.model import Robot
from eos_pin.simulation.disturbances import Friction
from eos_pin.tasks.stacked import task_from_description


def residuals_of(run: Any, robot: Robot) -> dict[str, float]:
    """Residuals of task, torque and power of a `Result`; see `Result.residuals`."""
    found: dict[str, float] = {}
    # How a task moves is not written down.
    if run.info.get("task") and not run.info["task"].get("moves"):
        task = task_from_description(robot, run.info["task"])
        rows = zip(run.q, run.z, strict=True)
        found["task"] = largest_magnitude(np.array([task._minus(z, task._value(q)) for q, z in rows]))
    if robot.lacks_dynamics:
        return found | {"torque": math.nan, "power": math.nan}
    torque = np.array([robot._inverse_dynamics(*row) for row in zip(run.q, run.dq, run.ddq, strict=True)])
    bias = np.array([robot._bias(*row) for row in zip(run.q, run.dq, strict=True)])
    torque -= run.tau
    friction = run.info.get("arguments", {}).get("friction")
    if friction:
        torque -= np.array([Friction(**friction)._torque(dq) for dq in run.dq])
    if run.info.get("force_task"):
        pushed = task_from_description(robot, run.info["force_task"])
        rows = zip(run.q, run.task_force, strict=True)
        torque -= np.array([pushed.linearize(q)[1].T @ f for q, f in rows])
    energy = np.array(
        [robot._kinetic_energy(q, dq) + robot._potential_energy(q) for q, dq in zip(run.q, run.dq, strict=True)]
    )
    scale = max(np.ptp(energy), np.ptp(run.work), run.kinetic_energy.max(), 1e-12)
    found["torque"] = largest_magnitude(torque) / max(largest_magnitude(run.tau), largest_magnitude(bias), 1e-12)
    found["power"] = largest_magnitude(energy - energy[0] - (run.work - run.work[0])) / float(scale)
    return found
