"""The paper's examples, ready to run.

Haug, De Sapio, Peidró, Robotics 2024, 13(12), 170. Each function makes an `Example`; nothing runs before it is asked
to. What the paper leaves open is decided here, beside the example that needs it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from eos_pin._arrays import JointVector, VectorLike, number
from eos_pin.charts.atlas import Atlas
from eos_pin.control.base import Controller, OpenLoop
from eos_pin.control.eos import EosController
from eos_pin.control.objectives import Damp, DescendPotential, Objective, ReduceKineticEnergy
from eos_pin.control.operational import BASELINES, EnergyNullSpace, OperationalSpaceController
from eos_pin.errors import InputError
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.robot.loading import load_robot
from eos_pin.robot.model import Robot
from eos_pin.simulation._recorder import Observer, uninterrupted
from eos_pin.simulation.continuous import simulate, simulate_extended
from eos_pin.simulation.disturbances import TaskForce
from eos_pin.simulation.kinematic import chart_following, rate_control
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.tasks.position import PositionTask
from eos_pin.trajectories.base import Trajectory
from eos_pin.trajectories.harmonic import circle, figure_eight

#: Sec. 4.3 names no number for g; Sec. 6 does. Down is −y.
GRAVITY, STANDARD_GRAVITY = 9.81, 9.80665

Gradient = Literal["velocity", "configuration"]


class Experiment(ABC):
    """One motion of a robot, ready to run.

    Attributes:
        robot: The robot that moves.
        q: Joints at the start.
        duration: Length of the run [s].
    """

    robot: Robot
    q: JointVector
    duration: float

    @abstractmethod
    def run(self, observer: Observer | None = None) -> Result:
        """Run it; `observer` is called with (t, q) of every sample."""


@dataclass(frozen=True, eq=False)
class ClosedLoop(Experiment):
    """A controller on the robot of its own model, in continuous time.

    Attributes:
        robot: The robot.
        controller: The controller.
        q: Joints at the start.
        duration: Length of the run [s].
        rtol: Tolerance of the integrator.
        atol: Absolute tolerance; that of `rtol` by default.
        dq: Joint velocities at the start, at rest by default.
        task_force: Force of the environment.
        atlas: Charts to integrate in w = (z, v), Eq. (30); joints are integrated without, Eq. (31).
    """

    robot: Robot
    controller: Controller
    q: JointVector
    duration: float
    rtol: float = 1e-9
    atol: float | None = None
    dq: VectorLike | None = None
    task_force: TaskForce | None = None
    atlas: Atlas | None = None

    def run(self, observer: Observer | None = None) -> Result:
        start = self.robot, self.controller, self.q, self.dq
        run = simulate if self.atlas is None else partial(simulate_extended, atlas=self.atlas)
        result = run(
            *start,
            duration=self.duration,
            rtol=self.rtol,
            atol=self.atol,
            task_force=self.task_force,
            observer=observer,
        )
        return uninterrupted(result)


@dataclass(frozen=True, eq=False)
class Kinematic(Experiment):
    """Joints along a task path, without dynamics.

    Attributes:
        task: The task.
        path: Its trajectory.
        q: Joints at the start.
        duration: Length of the run [s].
        law: `rate_control` or `chart_following`, bound to its tolerance.
    """

    task: Task
    path: Trajectory
    q: JointVector
    duration: float
    law: Callable[..., Result]

    @property
    def robot(self) -> Robot:  # type: ignore[override]
        return self.task.robot

    def run(self, observer: Observer | None = None) -> Result:
        result = self.law(self.task, self.path, self.q, duration=self.duration)
        for t, q in zip(result.t, result.q, strict=True) if observer else ():
            observer(float(t), q)  # type: ignore[misc]
        return result


@dataclass(frozen=True, eq=False)
class Example:
    """An example of the paper.

    Attributes:
        section: Where the paper has it.
        title: Title of the figure.
        experiments: Its runs by name, the one to look at first. Controllers have the names they have everywhere.
    """

    section: str
    title: str
    experiments: Mapping[str, Experiment]

    @property
    def robot(self) -> Robot:
        """The robot of the first run."""
        return next(iter(self.experiments.values())).robot

    def only(self, *names: str) -> Example:
        """The same with just these runs."""
        return replace(self, experiments={name: self.experiments[name] for name in names})


class Setting(NamedTuple):
    """Settings that the controllers of an example share.

    Attributes:
        task: Position of the tip in the plane.
        path: The figure eight.
        q: Joints at the start, at rest.
        duration: Length of the run [s].
    """

    task: PositionTask
    path: Trajectory
    q: JointVector
    duration: float

    def loops(self, controllers: Mapping[str, Controller], rtol: float) -> dict[str, Experiment]:
        """A closed loop for each controller."""
        return {
            name: ClosedLoop(self.task.robot, controller, self.q, self.duration, rtol)
            for name, controller in controllers.items()
        }

    def baselines(self, *names: str) -> dict[str, Controller]:
        """Traditional controllers by name."""
        return {name: BASELINES[name](self.task, self.path, self.q) for name in names}


def planar_robot(*, cycles: int = 3, gravity: bool = True) -> Setting:
    """The robot of Fig. 2 and the path of Eq. (34).

    The paper does not give the start: y(0) = 0 at rest is ours, one metre from the path, and so is gravity.
    """
    robot = load_robot("ppr", gravity=(0.0, -GRAVITY if gravity else 0.0, 0.0))
    return Setting(PositionTask(robot, "tip", "xy"), figure_eight((0.0, 0.0)), np.zeros(3), _length(cycles))


def planar_chain(*, cycles: int = 3, gravity: bool = False) -> Setting:
    """The robot of Fig. 15 and the path of Eq. (42); the paper leaves gravity out.

    The paper prints eight of the ten entries of y(0). A closed octagon, which begins on the path, has these ten.
    """
    robot = load_robot("planar_chain_10", gravity=(0.0, -STANDARD_GRAVITY if gravity else 0.0, 0.0))
    q = np.concatenate((np.zeros(2), np.full(8, -0.25 * math.pi)))
    return Setting(PositionTask(robot, "tip", "xy"), figure_eight((0.0, 0.0), 3.0), q, _length(cycles))


def noncyclic(
    *, robot: str = "ppr", path: Literal["eight", "circle"] = "eight", cycles: int = 20, rtol: float = 1e-9
) -> Example:
    """Sec. 2.2 against Sec. 3: velocity control by G'† drifts, inverse kinematics through charts does not.

    Args:
        robot: Name or file of a robot; the paper's two start as in their examples.
        path: Path through the task point at the start.
        cycles: Rounds to run.
        rtol: Tolerance of the integrator of velocity control.
    """
    task: Task
    curve: Trajectory
    if robot in ("ppr", "planar_chain_10"):
        task, _, q, _ = planar_robot() if robot == "ppr" else planar_chain()
        size = 1.0 if robot == "ppr" else 3.0
        eight = figure_eight(task.value(q), size)
        curve = eight if path == "eight" else circle(task.value(q), size, period=math.tau)
    else:
        task = make_task(load_robot(robot, chain_to="auto"))
        q = rest_posture(task)
        curve = fitting_path(task, q, shape=path)
    duration = _length(cycles) / math.tau * curve.period

    laws: dict[str, Callable[..., Result]] = {
        "velocity control": partial(rate_control, rtol=rtol),
        "charts": chart_following,
    }
    experiments = {name: Kinematic(task, curve, q, duration, law) for name, law in laws.items()}
    return Example("2.2", "joint drift without dynamics", experiments)


def equivalence(*, duration: float = 10.0, threshold: float = 0.8, rtol: float = 1e-13) -> Example:
    """Sec. 4.3: the same motion from the differential equations in joints and in w = (z, v).

    The paper does not say how long it ran. Up to 2 s one chart serves; near 5 s y3 passes π, where no single one can.

    Args:
        duration: Length of the run [s].
        threshold: A chart is left where its margin falls to this.
        rtol: Relative tolerance; the absolute one is a tenth of it.
    """
    task, _, q, _ = planar_robot()
    torques = OpenLoop(lambda t: (0.0, 9.0, math.sin(math.pi * t)))
    force = TaskForce(task, lambda t: (0.0, 9.0))
    experiments = {
        name: ClosedLoop(task.robot, torques, q, duration, rtol, 0.1 * rtol, (-1.0, 1.0, 0.0), force, atlas)
        for name, atlas in (("joints", None), ("task and self-motion", Atlas(task, threshold=threshold)))
    }
    return Example("4.3", "two forms of the equations of motion", experiments)


def task_space(*, cycles: int = 3, gravity: bool = True, rtol: float = 1e-9) -> Example:
    """Sec. 5.1: traditional control, as in the paper, and with the null-space posture control of practice.

    Args:
        cycles: Rounds to run.
        gravity: Whether the robot stands upright.
        rtol: Tolerance of the integrator.
    """
    setting = planar_robot(cycles=cycles, gravity=gravity)
    loops = setting.loops(setting.baselines("task-space", "null-space-posture"), rtol)
    return Example("5.1", "traditional task-space control", loops)


def self_motion_tracking(*, cycles: int = 3, gravity: bool = True, rtol: float = 1e-9) -> Example:
    """Sec. 5.2: EOS control with v_d = 0.

    Args:
        cycles: Rounds to run.
        gravity: Whether the robot stands upright.
        rtol: Tolerance of the integrator.
    """
    setting = planar_robot(cycles=cycles, gravity=gravity)
    loops = setting.loops({"eos": EosController(setting.task, setting.path, smooth=False)}, rtol)
    return Example("5.2", "EOS control that holds the self-motion", loops)


def kinetic_energy(
    *, cycles: int = 3, gravity: bool = True, gradient: Gradient = "velocity", gain: float = 1.0, rtol: float = 1e-9
) -> Example:
    """Sec. 5.3: EOS control that lowers the kinetic energy, the same in the null space, and without it.

    Beside the paper's three, null-space damping and posture control, which lower the kinetic energy as well.

    Args:
        cycles: Rounds to run.
        gravity: Whether the robot stands upright.
        gradient: Meaning of ∇T, which the paper leaves open: `"velocity"`, M dq, damps and gives the paper's figure;
            `"configuration"`, ∂T/∂q, drives EOS control out of every chart.
        gain: Factor of the gradient, in both laws; 1 in the paper.
        rtol: Tolerance of the integrator.
    """
    setting = planar_robot(cycles=cycles, gravity=gravity)
    energy = ReduceKineticEnergy(setting.task.robot, gain, gradient)
    controllers: dict[str, Controller] = {
        "eos": EosController(setting.task, setting.path, energy, smooth=False),
        "task-space-energy": OperationalSpaceController(setting.task, setting.path, EnergyNullSpace(energy)),
        **setting.baselines("task-space", "null-space-damping", "null-space-posture"),
    }
    return Example("5.3", "lower kinetic energy", setting.loops(controllers, rtol))


def obstacle(
    *, cycles: int = 3, gravity: bool = True, offset: float = 10.0, damping: float = 0.0, rtol: float = 1e-9
) -> Example:
    """Sec. 5.4: EOS control that repels the rail from an obstacle, U_p = ½ d⁻² with d = l + y2; Eqs. (40), (41).

    The paper gives no l. With l = 10 m the rail stays clear and v nearly constant for three rounds.

    Args:
        cycles: Rounds to run.
        gravity: Whether the robot stands upright.
        offset: The l of the paper [m]. The field repels from y2 = −l, so a negative l is an obstacle above the rail.
        damping: Damping of the self-motion [1/s]; the paper has none.
        rtol: Tolerance of the integrator.
    """
    number(damping, "the damping", at_least=0.0)
    if not number(offset, "l"):
        raise InputError("l must not be 0: the rail would start in the obstacle")
    setting = planar_robot(cycles=cycles, gravity=gravity)
    law = DescendPotential(lambda q: np.array([0.0, -((offset + q[1]) ** -3), 0.0]), kd=damping)
    loops = setting.loops({"eos": EosController(setting.task, setting.path, law, smooth=False)}, rtol)
    return Example("5.4", f"obstacle avoidance, l = {offset:g} m", loops)


def chain_task_space(*, cycles: int = 3, gravity: bool = False, rtol: float = 1e-9) -> Example:
    """Sec. 6.1: traditional control of the chain, as in the paper, and with null-space posture control.

    Args:
        cycles: Rounds to run.
        gravity: Whether the robot stands upright.
        rtol: Tolerance of the integrator.
    """
    setting = planar_chain(cycles=cycles, gravity=gravity)
    loops = setting.loops(setting.baselines("task-space", "null-space-posture"), rtol)
    return Example("6.1", "traditional control of the chain", loops)


def chain_eos(*, cycles: int = 3, rtol: float = 1e-9) -> Example:
    """Sec. 6.2: EOS control of the chain with v_d = 0, and with F_v = 0; each without gravity and with it.

    Args:
        cycles: Rounds to run.
        rtol: Tolerance of the integrator.
    """
    loops: dict[str, Experiment] = {}
    laws: dict[str, Objective | None] = {"eos": None, "F_v = 0": Damp(0.0)}
    for suffix, gravity in (("", False), (", gravity", True)):
        setting = planar_chain(cycles=cycles, gravity=gravity)
        for name, law in laws.items():
            controller = EosController(setting.task, setting.path, law, smooth=False)
            loops |= setting.loops({name + suffix: controller}, rtol)
    return Example("6.2", "EOS control of the chain", loops)


def _length(cycles: int) -> float:
    if cycles < 1:
        raise InputError(f"a run needs at least one cycle, got {cycles}")
    return cycles * math.tau
