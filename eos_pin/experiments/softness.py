"""The impedance that plain options stand for."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from eos_pin.charts.atlas import Atlas
from eos_pin.control.compliant.impedance import ImpedanceController
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory


@runtime_checkable
class Softness(Protocol):
    """Options of an impedance, as `ControlOptions` has them."""

    @property
    def stiffness(self) -> tuple[float, ...]:
        """One number for each coordinate or each unit of the task; empty for the default."""

    @property
    def self_motion_stiffness(self) -> float:
        """Stiffness of the self-motion [N m/rad]."""

    @property
    def damping_ratio(self) -> float:
        """Damping ratio."""


def soft_controller(options: Softness, task: Task, reference: Trajectory, atlas: Atlas) -> ImpedanceController:
    """Controller from options; numbers that are as many as the task has units are one for each of them."""
    units, given = tuple(dict.fromkeys(task.units)), options.stiffness
    by_unit = len(given) == len(units) != task.m
    return ImpedanceController(
        task,
        reference,
        stiffness=(dict(zip(units, given, strict=True)) if by_unit else given) or None,
        self_motion_stiffness=options.self_motion_stiffness,
        damping_ratio=options.damping_ratio,
        atlas=atlas,
    )
