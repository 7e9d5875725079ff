"""The contract of trajectories, and whether one fits a task."""

from __future__ import annotations

import numpy as np

from eos_pin._arrays import of_type
from eos_pin.errors import InputError
from eos_pin.tasks.base import Task
from eos_pin.tasks.target import Hold as Hold
from eos_pin.tasks.target import JointTarget as JointTarget
from eos_pin.tasks.target import Target as Target
from eos_pin.tasks.target import Trajectory as Trajectory


def check_reference(task: Task, reference: Trajectory) -> None:
    """Refuse a reference that does not fit the task.

    Raises:
        InputError: It does not fit.
    """
    target = of_type(reference, "the reference", Trajectory)(0.0)
    z, dz = np.asarray(target.z), np.asarray(target.dz)
    if z.shape != (task.size,):
        pose = task.form == ("number", "rotation")
        advice = ". To keep the orientation, use PoseTrajectory(position=curve, orientation=R)" if pose else ""
        given = f"points of {z.size} numbers" if z.ndim == 1 else f"points of shape {z.shape}"
        raise InputError(
            f"the reference does not fit the task: {task!r} takes {'poses of' if pose else 'points of'} {task.size} "
            f"numbers, the trajectory gives {given}{advice}"
        )
    try:
        task.point(z)
    except InputError as error:
        raise InputError(f"the reference does not fit the task: {error}") from error
    if dz.shape != (task.m,):
        advice = f". To hold a point, use task.hold(q) or Hold(z, m={task.m})" if reference.constant is not None else ""
        raise InputError(
            f"the reference does not fit the task: it has {dz.size} velocity components, {task!r} has {task.m}{advice}"
        )
