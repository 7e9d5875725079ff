"""A run in plain values: groups of options, as the command line has them, and the objects that they make."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eos_pin._arrays import JointVector, checked, number, vector
from eos_pin.errors import InputError, Renamed
from eos_pin.experiments.applicability import check_applicable
from eos_pin.experiments.task_options import TaskOptions as TaskOptions
from eos_pin.robot.postures import by_name
from eos_pin.trajectories.corners import Corners

# Everything else is imported where it is used, so that `eos-pin --help` does not wait for it.
if TYPE_CHECKING:
    from eos_pin.control.base import Controller
    from eos_pin.control.objectives import Objective
    from eos_pin.robot.model import Robot
    from eos_pin.simulation._recorder import Observer
    from eos_pin.simulation.disturbances import TaskForce
    from eos_pin.simulation.result import Result
    from eos_pin.tasks.base import Task
    from eos_pin.trajectories.base import Trajectory

MetricName = Literal["identity", "inertial"]
ControllerName = Literal[
    "eos",
    "eos-limited",
    "impedance",
    "task-space",
    "task-space-energy",
    "null-space-damping",
    "null-space-posture",
    "without-drift",
    "set-point",
]


@checked
@dataclass(frozen=True)
class RobotOptions:
    """The robot.

    Attributes:
        robot: Name (see `eos-pin robots`) or path of a URDF file.
        frame: Frame that does the task; by default the tip. Joints that are not between base and frame are locked.
        lock: Names of further joints to lock, where they are nearest to 0, or at a position, such as elbow=0.2.
        package_dirs: Folders in which `package://` meshes are looked for.
        gravity: Acceleration of gravity [m/s²], such as 0 -9.81 0 for a planar robot that stands upright.
        seen_from: Frame from which relative-pose is seen, such as the other hand; joints between base and it stay, too.
        tool: Offset of a tool frame from the frame [m]; the tool then does the task.
        payload: Mass carried at the frame [kg].
    """

    robot: str
    frame: str = ""
    lock: tuple[str, ...] = ()
    package_dirs: tuple[Path, ...] = ()
    gravity: tuple[float, float, float] | None = None
    seen_from: str = ""
    tool: tuple[float, float, float] | None = None
    payload: float = 0.0

    def load(self) -> Robot:
        """Load the chain from the base to the frame."""
        from eos_pin.robot.loading import Payload, Tool, load_robot

        options: dict[str, Any] = {"lock": by_name(self.lock, "--lock"), "package_dirs": self.package_dirs}
        options |= {"gravity": self.gravity, "branch_to": self.seen_from}
        robot = load_robot(self.robot, chain_to=self.frame or "auto", **options)
        frame = robot.options["chain_to"]
        if self.tool is None and not self.payload:
            return robot
        tool = Tool(frame, self.tool) if self.tool is not None else None
        options["payload"] = Payload(self.payload, frame) if self.payload else None
        return load_robot(self.robot, chain_to=tool.name if tool else frame, tool=tool, **options)


@checked
@dataclass(frozen=True)
class PathOptions:
    """Path of the task.

    Attributes:
        path: Figure eight, circle, line, hold, or a CSV file whose first row names its columns: t [s]; x, y, z [m]; qw,
            qx, qy, qz, or roll, pitch, yaw [rad]. Without t the speed is constant, without orientation it stays. Or the
            way points themselves, such as "0.4 0 0.5; 0.4 0.2 0.5".
        size: Half width or radius [m]; by default as large as the robot can follow.
        plane: Plane of the path, such as yz, or one axis for a line.
        period: Time of one round [s]; by default as short as the joints' velocity limits allow, from 4 s.
        cycles: Rounds to run.
        duration: Length of the run [s], instead of rounds.
        corners: Way points on a smooth curve, on straight lines with rounded corners, or with a stop at each.
        blend: Distance from a way point at which a rounded corner leaves the line [m]; by default a tenth of the line.
    """

    path: str = "eight"
    size: float | None = None
    plane: str | None = None
    period: float | None = None
    cycles: int = 3
    duration: float | None = None
    corners: Corners = "smooth"
    blend: float | None = None

    @checked
    def make(self, task: Task, q: JointVector) -> Trajectory:
        """The path: from a file, or through the task point at q."""
        from eos_pin.experiments.defaults import fitting_path
        from eos_pin.experiments.path_files import path_from_csv
        from eos_pin.trajectories.waypoints import is_table

        if is_table(self.path):
            patient = self.duration is not None
            return path_from_csv(self.path, task, q, patient=patient, corners=self.corners, blend=self.blend)
        if self.path not in ("eight", "circle", "line", "hold"):
            raise InputError(
                "a path is eight, circle, line, hold, the name of a .csv file, or way points separated by semicolons; "
                f"got {self.path!r}"
            )
        return fitting_path(task, q, shape=self.path, size=self.size, plane=self.plane, period=self.period)  # type: ignore[arg-type]

    @checked
    def length(self, reference: Trajectory) -> float:
        """Length of the run [s]."""
        if self.duration is not None:
            return self.duration
        if np.isfinite(reference.period):
            return self.cycles * reference.period
        if self.cycles != PathOptions.cycles:
            raise InputError(f"--cycles {self.cycles} does not apply: the path does not repeat; give --duration")
        return max(reference.duration, 5.0) if np.isfinite(reference.duration) else 10.0


@checked
@dataclass(frozen=True)
class ControlOptions:
    """Controller and its gains.

    Attributes:
        controller: EOS computed torque, the same within joint and torque limits (sampled runs), impedance of task and
            self-motion, or a traditional controller to compare with.
        self_motion: Objective of the self-motion: hold v, draw the joints to the start posture, damp, lower the kinetic
            energy, be left free, or follow a plan that is made first.
        v: Self-motion to hold, r numbers [rad or m]; by default where it is at the start.
        swing: Amplitude of a sine of the path's period that v's first coordinate follows [rad or m].
        kp: Gain on the task error [1/s²].
        kd: Gain on the task's velocity error [1/s].
        kp_self_motion: Gain on the self-motion error [1/s²].
        kd_self_motion: Gain on the self-motion's velocity error [1/s].
        stiffness: Stiffness of an impedance: one number for each coordinate of the task, or one for each of its units,
            lengths first [N/m, N m/rad]; by default 1000 N/m and 50 N m/rad.
        self_motion_stiffness: Stiffness of the self-motion of an impedance, at the start posture [N m/rad].
        damping_ratio: Damping ratio of an impedance.
        chart_margin: A chart is left where its margin falls to this, between 0 and 1.
        metric: Metric of the charts: that of the paper, or the mass matrix at their bases, which decouples task and
            self-motion inertially there.
        command: Command that the robot takes: torque, or joint position or velocity, for which it needs no inertia and
            the task is tracked by a `KinematicLoop`, at 500 Hz by default.
        acceleration: Largest acceleration of every joint where positions or velocities are commanded [rad/s² or m/s²].
    """

    controller: ControllerName = "eos"
    self_motion: Literal["hold", "posture", "damp", "energy", "free", "planned"] = "hold"
    v: tuple[float, ...] = ()
    swing: float = 0.0
    kp: float = 100.0
    kd: float = 20.0
    kp_self_motion: float = 100.0
    kd_self_motion: float = 20.0
    stiffness: tuple[float, ...] = ()
    self_motion_stiffness: float = 20.0
    damping_ratio: float = 0.7
    chart_margin: float = 0.5
    metric: MetricName = "identity"
    command: Literal["torque", "position", "velocity"] = "torque"
    acceleration: float | None = None

    @checked
    def make(
        self,
        task: Task,
        reference: Trajectory,
        q: JointVector,
        period: float | None,
        *,
        law: Objective | None = None,
        further: tuple[Task, Trajectory] | None = None,
    ) -> Controller:
        """The controller, for a run with a control period [s], or None for a continuous one.

        `law` is that of the self-motion, where it is made already; else it does the task `further` on its path.
        """
        from eos_pin.charts.atlas import Atlas
        from eos_pin.control.eos import EosController
        from eos_pin.control.limited import LimitedEosController
        from eos_pin.control.operational import BASELINES
        from eos_pin.control.tolerance import KeepTolerance
        from eos_pin.experiments.softness import soft_controller

        if self.command != "torque":
            raise InputError(
                f"--command {self.command} is for `eos-pin track` and `eos-pin rehearse` only; leave it out"
            )
        if self.controller in BASELINES:
            return BASELINES[self.controller](task, reference, q)
        atlas = Atlas(task, threshold=self.chart_margin, metric=self.metric)
        if self.controller == "impedance":
            return soft_controller(self, task, reference, atlas)
        if law is None:
            law = self._law(task, reference, q, further)
            # The other one keeps bands by itself.
            if task.bands and self.controller == "eos":
                law = KeepTolerance(law, task, reference, kp=self.kp, kd=self.kd)
        if self.controller == "eos":
            return EosController(task, reference, law, kp=self.kp, kd=self.kd, atlas=atlas)
        if period is None:
            raise InputError("a controller that keeps limits needs a sampled run; add --control-rate 1000")
        return LimitedEosController(task, reference, law, control_period=period, kp=self.kp, kd=self.kd, atlas=atlas)

    def _law(
        self, task: Task, reference: Trajectory, q: JointVector, further: tuple[Task, Trajectory] | None = None
    ) -> Objective:
        from eos_pin.control.following import TrackTask
        from eos_pin.control.objectives import Damp, Posture, ReduceKineticEnergy, Track
        from eos_pin.trajectories.harmonic import Harmonic

        gains = {"kp": self.kp_self_motion, "kd": self.kd_self_motion}
        r = task.robot.n - task.m
        if further is not None and r:
            other, path = further
            return TrackTask(other, path, rest=self._law(task, reference, q), **gains)
        named = ("v", "swing", "self_motion", "kp_self_motion", "kd_self_motion", "chart_margin", "metric")
        if not r and (further or any(getattr(self, name) != getattr(ControlOptions, name) for name in named)):
            options = ", ".join("--" + name.replace("_", "-") for name in named)
            raise InputError(
                "there is no self-motion to command: the task takes all joints (r = 0). Leave out "
                f"--further, {options}, count fewer axes, or choose a task with fewer coordinates"
            )
        if self.self_motion == "planned":
            raise InputError(
                "self-motion that is planned is for `eos-pin track` and the controllers eos and eos-limited"
            )
        if self.self_motion == "posture":
            return Posture(q, **gains)
        if self.self_motion == "damp":
            return Damp(self.kd_self_motion)
        if self.self_motion == "energy":
            return ReduceKineticEnergy(task.robot)
        if self.self_motion == "free":
            return Damp(0.0)
        center = vector(self.v, r, "v") if self.v else np.zeros(r)
        if not self.swing:
            return Track(center, **gains)
        period = reference.period if np.isfinite(reference.period) else 4.0
        return Track(Harmonic(center, self.swing * np.eye(r)[:1], np.zeros((1, r)), period), **gains)


@checked
@dataclass(frozen=True)
class RunOptions:
    """Simulation of the run.

    Attributes:
        plant: Simulator: our own equations of motion, or MuJoCo (pip install 'eos-pin[mujoco]'), which runs
            sampled, at 1000 Hz by default.
        control_rate: Run sampled at this many control periods per second, with held torques; continuous by default
            [Hz].
        substeps: Steps of the plant in each control period.
        noise: Standard deviation of measured joints [rad or m], and of measured velocities ten times that per second.
        delay: Age of the state the controller sees [s].
        dropout: Probability that the controller misses a period, and the torque of the last one stays.
        friction: Viscous [N m s/rad or N s/m] and dry friction [N m or N] in every joint, which no controller models.
        push: Force on the frame that does the task [N], from 1 s to 1.2 s by default.
        push_time: When the push begins and ends [s].
        torque_limits: Clip torques at the robot's limits.
        torque_rate: Most that a torque changes in a second [N m/s or N/s].
        soft_start: Time in which the torque goes over from that of gravity to the controller's [s].
        model_error: Largest relative error of masses, centres of mass and inertias in the controller's model.
        method: Integrator of a continuous run; by default LSODA, and DOP853 for tolerances below 1e-10.
        rtol: Tolerance of a continuous run.
    """

    plant: Literal["pinocchio", "mujoco"] = "pinocchio"
    control_rate: float | None = None
    substeps: int = 1
    noise: float = 0.0
    delay: float = 0.0
    dropout: float = 0.0
    friction: tuple[float, float] | None = None
    push: tuple[float, float, float] | None = None
    push_time: tuple[float, float] = (1.0, 1.2)
    torque_limits: bool = False
    torque_rate: float | None = None
    soft_start: float = 0.0
    model_error: float = 0.0
    method: Literal["DOP853", "LSODA", "RK45", "Radau", "BDF"] | None = None
    rtol: float = 1e-9

    rate = Renamed("control_rate")
    period = Renamed("control_period")

    @property
    def control_period(self) -> float | None:
        """Control period of a sampled run [s]; None for a continuous one."""
        if self.control_rate is not None:
            return 1.0 / number(self.control_rate, "the rate", above=0.0)
        if self.plant == "mujoco":
            return 1e-3
        sampled = self.noise, self.delay, self.dropout, self.friction, self.push, self.torque_limits, self.soft_start
        if any(sampled) or self.torque_rate is not None:
            raise InputError(
                "noise, delay, dropout, friction, a push, torque limits, a torque rate and a soft start are those of a "
                "sampled run; add --control-rate 1000"
            )
        return None

    def _task_force(self, robot: Robot) -> TaskForce | None:
        """The push, as a force on the frame that the robot was loaded to."""
        if self.push is None:
            return None
        from eos_pin.simulation.disturbances import TaskForce
        from eos_pin.tasks.position import PositionTask

        (start, end), force = self.push_time, vector(self.push, 3, "the push")
        if not start < end:
            raise InputError(f"a push must end after it begins, got {start:g} to {end:g} s")
        return TaskForce(PositionTask(robot, robot.options["chain_to"]), lambda t: force * (start <= t < end))

    @checked
    def run(
        self,
        robot: Robot,
        controller: Controller,
        q: JointVector,
        duration: float,
        *,
        seed: int = 0,
        observer: Observer | None = None,
        dq: JointVector | None = None,
    ) -> Result:
        """Run the closed loop from joints q and velocities dq, by default at rest; `seed` is that of everything random.

        Raises:
            KeyboardInterrupt: The run was interrupted; what was computed of it is dropped.
        """
        from eos_pin.simulation._recorder import uninterrupted
        from eos_pin.simulation.continuous import simulate
        from eos_pin.simulation.disturbances import Friction, SensorNoise
        from eos_pin.simulation.mujoco import MujocoPlant
        from eos_pin.simulation.sampled import simulate_sampled

        e = self.model_error
        plant = robot.perturbed(mass=e, com=e, inertia=e, seed=seed) if e else robot
        plant = MujocoPlant.from_robot(plant) if self.plant == "mujoco" else plant
        period = self.control_period
        if period is None:
            result = simulate(
                plant, controller, q, dq=dq, duration=duration, method=self.method, rtol=self.rtol, observer=observer
            )
            return uninterrupted(result)
        result = simulate_sampled(
            plant,
            controller,
            q,
            dq=dq,
            duration=duration,
            control_period=period,
            substeps=self.substeps,
            noise=SensorNoise(self.noise, 10.0 * self.noise) if self.noise else None,
            delay=self.delay,
            dropout=self.dropout,
            friction=Friction(*self.friction) if self.friction else None,
            task_force=self._task_force(robot),
            torque_limits=self.torque_limits,
            torque_rate=self.torque_rate,
            soft_start=self.soft_start,
            seed=seed if self.noise or self.dropout else 0,
            observer=observer,
        )
        return uninterrupted(result)


#: Every option of a run that applies only beside some others, at its default.
_GROUPS = (TaskOptions, PathOptions, ControlOptions, RunOptions)
_DEFAULTS = {each.name: each.default for kind in _GROUPS for each in fields(kind)} | {"seed": 0, "plan": None}


def check_options(*groups: Any, seed: int = 0, plan: Path | None = None) -> None:
    """Refuse options of a run, one group or more, that change nothing beside the others.

    Raises:
        InputError: An option does not apply.
    """
    given = {name: value for group in groups for name, value in vars(group).items()}
    check_applicable(given | {"seed": seed, "plan": plan}, _DEFAULTS)
