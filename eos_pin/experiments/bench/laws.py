"""Laws of the bench by name, each made of two gains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import JointVector
from eos_pin.charts.atlas import Atlas
from eos_pin.control.base import Controller
from eos_pin.control.compliant.impedance import ImpedanceController
from eos_pin.control.eos import EosController
from eos_pin.control.following import FollowPlan
from eos_pin.control.limited import LimitedEosController
from eos_pin.control.objectives import Track
from eos_pin.control.operational import NullSpaceLaw, OperationalSpaceController, PostureNullSpace
from eos_pin.control.rivals.hierarchies import HierarchyController, Structure
from eos_pin.control.rivals.least_torque import LeastTorque
from eos_pin.control.rivals.parts import Consistency, PostureController, SpringNullSpace, free_inertia
from eos_pin.control.rivals.resolved import (
    IntegratedVelocity,
    NullSpaceDynamics,
    ResolvedAcceleration,
    ResolvedAccelerationWithTorque,
    ResolvedVelocity,
)
from eos_pin.control.rivals.sliding import SlidingModeController
from eos_pin.errors import InputError, UnknownNameError
from eos_pin.planning.plans import Plan
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

#: Model error that sliding mode is made for on the bench.
STATED_ERROR = 0.2


class Setup(NamedTuple):
    """A law's surroundings and its two gains.

    Attributes:
        task: The task.
        path: Its trajectory.
        posture: Joints at the start of the path, and posture of laws that have one.
        plan: Plan of the path, which begins there; None where there is none.
        period: Control period [s].
        task_rate: Rate ω of the task's error: kp = ω², kd = 2ω [1/s].
        free_rate: The same of the posture or of v [1/s].
    """

    task: Task
    path: Trajectory
    posture: JointVector
    plan: Plan | None
    period: float
    task_rate: float
    free_rate: float

    @property
    def gains(self) -> dict[str, Any]:
        """Gains of the task."""
        return {"kp": self.task_rate**2, "kd": 2.0 * self.task_rate}

    @property
    def posture_gains(self) -> dict[str, Any]:
        """Gains of the posture."""
        return {"kp": self.free_rate**2, "kd": 2.0 * self.free_rate}

    @property
    def all_gains(self) -> dict[str, Any]:
        """Gains of both, as a `PostureController` has them."""
        return self.gains | {f"{name}_posture": value for name, value in self.posture_gains.items()}


@dataclass(frozen=True)
class Law:
    """A law of the bench.

    Attributes:
        title: Name in tables.
        source: Who published it.
        make: The controller, for a setup.
    """

    title: str
    source: str
    make: Callable[[Setup], Controller]


def _posture(kind: type[PostureController]) -> Callable[[Setup], Controller]:
    return lambda s: kind(s.task, s.path, s.posture, **s.all_gains)


def _hierarchy(structure: Structure, consistency: Consistency) -> Callable[[Setup], Controller]:
    return lambda s: HierarchyController(
        s.task, s.path, s.posture, structure=structure, consistency=consistency, **s.all_gains
    )


def _force(law: Callable[[Setup], NullSpaceLaw]) -> Callable[[Setup], Controller]:
    return lambda s: OperationalSpaceController(s.task, s.path, law(s), **s.gains)


def _springs(compensates: bool) -> Callable[[Setup], NullSpaceLaw]:
    def make(s: Setup) -> NullSpaceLaw:
        inertia = free_inertia(s.task.robot, s.posture)
        kp, kd = s.posture_gains.values()
        return SpringNullSpace(s.posture, stiffness=kp * inertia, damping=kd * inertia, compensates=compensates)

    return make


def _eos(s: Setup, metric: str = "identity") -> Controller:
    return EosController(s.task, s.path, Track(**s.posture_gains), atlas=Atlas(s.task, metric=metric), **s.gains)


def _limited(s: Setup) -> Controller:
    return LimitedEosController(s.task, s.path, Track(**s.posture_gains), control_period=s.period, **s.gains)


def _on_plan(s: Setup) -> Controller:
    if s.plan is None:
        raise InputError(f"there is no plan of this path for {s.task.robot.name!r}; leave the law eos-plan out")
    law = FollowPlan(s.plan, s.task.robot, **s.posture_gains)
    return EosController(s.task, law.path, law, **s.gains)


def _impedance(s: Setup) -> Controller:
    """Stiffness and damping that give the same rates at the start, to z with v free to give way and the other way."""
    chart = Atlas(s.task).start(s.posture)
    A = np.vstack((s.task.linearize(s.posture)[1], chart.W.T))
    mobility = A @ np.linalg.solve(s.task.robot.mass(s.posture), A.T)
    m = s.task.m
    of_z, of_v = (np.linalg.inv(block) for block in (mobility[:m, :m], mobility[m:, m:]))
    return ImpedanceController(
        s.task,
        s.path,
        stiffness=s.task_rate**2 * of_z,
        damping=2.0 * s.task_rate * of_z,
        self_motion_stiffness=s.free_rate**2 * of_v,
        self_motion_damping=2.0 * s.free_rate * of_v,
        posture=s.posture,
    )


def _sliding(s: Setup) -> Controller:
    """In its layer kp = ω² and kd = 2ω as in the other laws; v has the rates of the task."""
    return SlidingModeController(s.task, s.path, model_error=STATED_ERROR, rate=s.task_rate, bandwidth=s.task_rate)


_NAKANISHI, _DIETRICH, _HOLLERBACH = "Nakanishi et al. 2008", "Dietrich et al. 2015", "Hollerbach, Suh 1987"
_OWN = "this package"

LAWS: Mapping[str, Law] = {
    "eos": Law("EOS", "Haug et al. 2024", _eos),
    "eos-inertial": Law("EOS, inertial metric", _OWN, lambda s: _eos(s, "inertial")),
    "eos-limited": Law("EOS within limits", _OWN, _limited),
    "eos-plan": Law("EOS on a plan", _OWN, _on_plan),
    "impedance": Law("impedance in (z, v)", _OWN, _impedance),
    "sliding-mode": Law("sliding mode in (z, v)", "Slotine, Li 1991", _sliding),
    "velocity-integrated": Law("velocity, integrated", _NAKANISHI, _posture(IntegratedVelocity)),
    "velocity": Law("velocity", _NAKANISHI, _posture(ResolvedVelocity)),
    "null-space-dynamics": Law("acceleration, null-space dynamics", _NAKANISHI, _posture(NullSpaceDynamics)),
    "acceleration": Law("simplified acceleration 1", _NAKANISHI, _posture(ResolvedAcceleration)),
    "acceleration-torque": Law("simplified acceleration 2", _NAKANISHI, _posture(ResolvedAccelerationWithTorque)),
    "gauss": Law("force (Gauss, Khatib)", _NAKANISHI, _force(_springs(False))),
    "decoupled": Law(
        "dynamical decoupling 1", _NAKANISHI, _force(lambda s: PostureNullSpace(s.posture, **s.posture_gains))
    ),
    "decoupled-springs": Law("dynamical decoupling 2", _NAKANISHI, _force(_springs(True))),
    "successive-static": Law("successive, static", _DIETRICH, _hierarchy("successive", "static")),
    "successive-dynamic": Law("successive, dynamic", _DIETRICH, _hierarchy("successive", "dynamic")),
    "augmented-dynamic": Law("augmented, dynamic", _DIETRICH, _hierarchy("augmented", "dynamic")),
    "augmented-stiffness": Law("augmented, stiffness", _DIETRICH, _hierarchy("augmented", "stiffness")),
    "least-torque": Law("least torque", _HOLLERBACH, lambda s: LeastTorque(s.task, s.path, **s.gains)),
    "least-torque-damped": Law(
        "least torque, damped",
        _HOLLERBACH,
        lambda s: LeastTorque(s.task, s.path, damping=2.0 * s.free_rate, **s.gains),
    ),
}


def chosen_laws(names: Iterable[str]) -> tuple[str, ...]:
    """Names of laws, checked; all where none is given.

    Raises:
        UnknownNameError: There is no such law.
    """
    names = tuple(names) or tuple(LAWS)
    for name in names:
        if name not in LAWS:
            raise UnknownNameError("law", name, LAWS)
    return names
