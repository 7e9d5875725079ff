"""The compiled form of ordinary steps of `KinematicLoop`."""

from __future__ import annotations

from functools import partial
from typing import Any

from eos_pin._kernels.dispatch import kernels
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import TURN
from eos_pin.control._velocity_box import ENDLESS, VelocityBox
from eos_pin.control.objectives import Objective
from eos_pin.control.state import EosState
from eos_pin.trajectories.base import Trajectory


def compiled_step(
    on: EosState,
    reference: Trajectory,
    self_motion: Objective,
    atlas: Atlas,
    factors: tuple[Any, Any],
    box: VelocityBox,
    settings: tuple[float, float, float, float, int],
) -> Any:
    """Compiled step on one chart; None without a compiler, and for tasks that are not made of frames.

    Args:
        on: The chart.
        reference: Reference of the task.
        self_motion: Law of the self-motion.
        atlas: Rule by which charts follow each other.
        factors: Both factors of `decay` for the task.
        box: Velocities within limits.
        settings: Control period, distances by which a measured joint may move and may be away from its command, square
            of the task error that is left, and most steps of Newton's method.
    """
    chart, kinematics = on.chart, on.chart.task.kinematics
    if kernels is None or not kinematics.compiled or on.drive._kernel is None:
        return None
    law, held = self_motion.sampled_targets(on.since, settings[0], 0.0, chart.r), self_motion._held_law(chart.r)
    return kernels.KinematicStep(
        on.drive._made_from, kinematics._chain, (chart.q_bar, chart._v_zero), chart.task.robot.continuous, TURN,
        atlas.threshold, partial(atlas._serves, chart), factors, held and (held[2], *law.factors), law.of, reference,
        box.arrays, ENDLESS, *settings,
    )  # fmt: skip
