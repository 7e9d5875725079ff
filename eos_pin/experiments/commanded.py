"""Runs of robots that take joint positions or velocities."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eos_pin._arrays import JointVector
from eos_pin.experiments.options import ControlOptions

# As in `options`: so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.control.kinematic import KinematicLoop
    from eos_pin.control.objectives import Objective
    from eos_pin.simulation._recorder import Observer
    from eos_pin.simulation.result import Result
    from eos_pin.tasks.base import Task
    from eos_pin.trajectories.base import Trajectory

#: Control period where none is given: that of a UR's interface [s].
CONTROL_PERIOD = 0.002


def commanded_loop(
    control: ControlOptions,
    task: Task,
    reference: Trajectory,
    q: JointVector,
    *,
    period: float | None = None,
    law: Objective | None = None,
    further: tuple[Task, Trajectory] | None = None,
) -> KinematicLoop:
    """Make a `KinematicLoop` with these options.

    Args:
        control: How it is controlled.
        task: The task.
        reference: Reference that it follows.
        q: Joints at the start.
        period: Control period [s].
        law: Law of the self-motion, where it is made already.
        further: Further task that it does else, and its path; None without one.

    Raises:
        InputError: The options do not fit.
    """
    from eos_pin.charts.atlas import Atlas
    from eos_pin.control.kinematic import KinematicLoop
    from eos_pin.control.limited import JointLimits

    return KinematicLoop(
        task,
        reference,
        law or control._law(task, reference, q, further),
        control_period=period or CONTROL_PERIOD,
        limits=JointLimits.without_torques(task.robot, acceleration=control.acceleration),
        kp=control.kp,
        kd=control.kd,
        atlas=Atlas(task, threshold=control.chart_margin, metric=control.metric),
    )


def run_commanded(loop: KinematicLoop, q: JointVector, duration: float, *, observer: Observer | None = None) -> Result:
    """Run a loop on an ideal joint servo.

    Args:
        loop: The loop.
        q: Joints at the start.
        duration: Length of the run [s].
        observer: Called with (t, q) of every sample.

    Raises:
        KeyboardInterrupt: The run was interrupted; what was computed of it is dropped.
    """
    from eos_pin.simulation._recorder import uninterrupted
    from eos_pin.simulation.kinematic import simulate_kinematic

    return uninterrupted(simulate_kinematic(loop, q, duration=duration, observer=observer))
