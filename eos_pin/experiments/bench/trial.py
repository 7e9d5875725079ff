"""A run of the bench in plain values."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eos_pin._arrays import JointVector
from eos_pin.control.base import Controller
from eos_pin.errors import PlanError
from eos_pin.experiments.bench.laws import LAWS, Setup, chosen_laws
from eos_pin.experiments.bench.settings import RATE, SETTINGS
from eos_pin.experiments.bench.surface import cut_off, with_surface
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.experiments.trial import Row, Trial
from eos_pin.planning.planner import plan
from eos_pin.planning.plans import Plan
from eos_pin.robot.loading import load_robot
from eos_pin.robot.model import Robot
from eos_pin.simulation._recorder import Observer
from eos_pin.simulation.disturbances import Friction, SensorNoise, TaskForce
from eos_pin.simulation.mujoco import MujocoPlant
from eos_pin.simulation.result import Result
from eos_pin.simulation.sampled import simulate_sampled
from eos_pin.tasks.base import Task
from eos_pin.tasks.position import PositionTask
from eos_pin.trajectories.base import Trajectory

#: Period of the figure eight, length of a run, and from when on the error counts [s].
PERIOD, DURATION, SETTLED = 1.1, 2.2, 0.7
#: Half width of the figure as a part of the robot's reach, and standard deviation of the joints at the start [rad].
SIZE, OFF = 0.04, 0.02
#: When a push begins, how long it lasts [s], and its force as a part of the robot's weight.
PUSH_TIME, PUSH_LENGTH, PUSH_FORCE = 1.3, 0.2, 0.1
#: A run that ends early or goes further astray counts as this far off [m].
LOST = 1.0


@dataclass(frozen=True)
class BenchTrial(Trial):
    """One law, on one robot, in one setting, with one seed.

    The path is a figure eight of the tool; the seed draws where the joints begin, the plant's bodies and the noise.

    Attributes:
        law: Name of the law.
        setting: Name of the setting.
        task_rate: Rate of the task's error [1/s].
        free_rate: Rate of the posture's or the self-motion's error [1/s].
    """

    law: str = "eos"
    setting: str = "exact"
    task_rate: float = 10.0
    free_rate: float = 10.0

    def prepare(self) -> tuple[Robot, Controller, JointVector, float]:
        """Robot, controller, joints at the start and length of the run [s]."""
        chosen_laws([self.law])
        task, _, posture, _ = found = scene(self.robot.robot)
        period = 1.0 / SETTINGS[self.setting].options.get("control_rate", RATE)
        setup = Setup(*found, period, self.task_rate, self.free_rate)
        random = np.random.default_rng([self.seed, 1])
        q = posture + OFF * random.normal(size=posture.size)
        return task.robot, LAWS[self.law].make(setup), q, DURATION

    def run(self, observer: Observer | None = None) -> Result:
        """Run it; `observer` is called with (t, q) of every sample."""
        robot, controller, q, duration = self.prepare()
        setting = SETTINGS[self.setting]
        options = dict(setting.options)
        noise, e = options.get("noise", 0.0), options.get("model_error", 0.0)
        plant = robot.perturbed(mass=e, com=e, inertia=e, seed=self.seed) if e else robot
        if setting.payload:
            plant = _loaded(plant, setting.payload)
        inertia = _inertia(self.robot.robot)
        friction = setting.friction
        if setting.contact:
            plant = with_surface(plant, robot.options["chain_to"], *cut_off(scene(self.robot.robot).path, PERIOD))
        elif options.get("plant") == "mujoco":
            plant = MujocoPlant.from_robot(plant)
        return simulate_sampled(
            plant,
            controller,
            q,
            duration=duration,
            control_period=1.0 / options.get("control_rate", RATE),
            noise=SensorNoise(noise, 10.0 * noise) if noise else None,
            delay=options.get("delay", 0.0),
            friction=Friction(viscous=friction * inertia, coulomb=friction * inertia) if friction else None,
            task_force=_push(robot, setting.push, self.seed) if setting.push else None,
            torque_limits=setting.saturation * _most_torque(self.robot.robot) if setting.saturation else False,
            seed=self.seed if noise else 0,
            observer=observer,
        )

    def figures(self, result: Result) -> Row:
        """Task error, torque and its roughness after the start has settled, and drift of the joints."""
        t, error = result.t, np.linalg.norm(result.error, axis=1)
        whole = result.status in ("finished", "degraded")
        late = error[t >= SETTLED]
        rms = math.sqrt(float((late**2).mean())) if whole and late.size else LOST
        # The torque by which a robot that starts beside the path gets there is left out.
        tau = result.tau[t >= SETTLED]
        changes = np.diff(tau, n=2, axis=0)
        return {
            "status": result.status,
            "message": "" if whole else result.message,
            "error": min(rms, LOST),
            "error_max": min(float(late.max()), LOST) if whole and late.size else LOST,
            "drift": float(result.joint_drift_per_cycle[-1])
            if whole and len(result.joint_drift_per_cycle)
            else math.nan,
            "torque": float(np.sqrt((tau**2).mean())) if len(tau) else math.nan,
            "roughness": float(np.sqrt((changes**2).mean())) if len(changes) else math.nan,
            "seconds": float(result.summary()["cpu_seconds"]),
        }


class Scene(NamedTuple):
    """A robot on the bench, the same in all runs: its task, path, posture, and a plan of the path from there."""

    task: Task
    path: Trajectory
    posture: JointVector
    plan: Plan | None


@cache
def scene(name: str) -> Scene:
    """Task and path of a robot; it begins where a plan of the path does, so that laws with and without start alike."""
    robot = load_robot(name, chain_to="auto")
    task = make_task(robot, "position")
    posture = rest_posture(task)
    path = fitting_path(task, posture, size=float(f"{SIZE * robot.reach:.2g}"), period=PERIOD)
    try:
        planned = plan(task, path)
    except PlanError:
        return Scene(task, path, posture, None)
    return Scene(task, path, planned(0.0)[0], planned)


def _inertia(name: str) -> JointVector:
    task, _, posture, _ = scene(name)
    return np.diag(task.robot.mass(posture))


@cache
def _most_torque(name: str) -> JointVector:
    """Largest torque of each joint on the undisturbed path from rest."""
    base = BenchTrial.from_settings(name, law="eos", setting="exact", seed=0)
    result = base.run()
    return np.abs(result.tau).max(axis=0)


def _loaded(plant: Robot, part: float) -> Robot:
    """The robot with a point mass at its tip, as a part of its own mass."""
    model = plant.model.copy()
    own = sum(body.mass for body in list(model.inertias)[1:])
    model.inertias[model.njoints - 1] += pin.Inertia(part * own, np.zeros(3), np.zeros((3, 3)))
    return replace(plant, model=model, name=f"{plant.name} (loaded)", source="", options={}, urdf_sha256="")


def _push(robot: Robot, where: str, seed: int) -> TaskForce:
    """A force in a random direction on the tool, or on the link of the middle joint."""
    frame = robot.options["chain_to"]
    if where == "elbow":
        middle = (robot.model.njoints + 1) // 2
        frame = next((f.name for f in robot.model.frames if f.parentJoint == middle), frame)
    weight = 9.81 * sum(body.mass for body in list(robot.model.inertias)[1:])
    direction = np.random.default_rng([seed, 2]).normal(size=3)
    force = PUSH_FORCE * weight * direction / np.linalg.norm(direction)
    return TaskForce(PositionTask(robot, frame), lambda t: force * (PUSH_TIME <= t < PUSH_TIME + PUSH_LENGTH))
