"""What eos_pin and its peers are all given: robot, file, state and target; and whether what they answer is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from eos_pin import (
    Chart,
    EosController,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Task,
    Trajectory,
    figure_eight,
    load_robot,
)
from eos_pin.experiments.defaults import rest_posture
from eos_pin.robot.geometry import Shapes
from eos_pin.robot.model import Robot

#: Postures that people use; other robots rest where the task has most room.
POSTURES = {"panda": (0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8)}
#: Task error at which inverse kinematics ends, in each library's own measure of it [m, rad].
TOL = 1e-10
#: Task error of an answer that counts, in one measure for all [m, rad]; norms and charts of rotations differ a little.
RIGHT = 2e-10
#: Joints without limits get these in the file that all read, because not all read infinity [rad].
FAR = 100.0
SIZE, ROUND, T, PERIOD, KP, KD = 0.1, 4.0, 0.1, 1e-3, 100.0, 20.0


@dataclass(frozen=True)
class Setting:
    """One robot and one task.

    Attributes:
        name: Name of the robot.
        whole: Whether the task is the frame's pose, not just its position.
        urdf: File that all read.
    """

    name: str
    whole: bool
    urdf: Path

    @classmethod
    def make(cls, name: str, whole: bool, folder: Path) -> Setting:
        """Setting for a robot's own end effector, with a file written for it.

        Args:
            name: Name of the robot.
            whole: Whether orientation counts.
            folder: Where the file goes.
        """
        robot = load_robot(name, chain_to="auto")
        assert isinstance(robot.shapes, Shapes)
        root = etree.fromstring(robot.shapes.urdf)
        for element in root.xpath("//visual | //collision | //transmission | //gazebo"):
            element.getparent().remove(element)
        for limit in root.iter("limit"):
            for key, value in limit.items():
                if abs(float(value)) > FAR and key in ("lower", "upper"):
                    limit.set(key, str(np.copysign(FAR, float(value))))
        path = folder / f"{name}.urdf"
        path.write_bytes(etree.tostring(root))
        return cls(name, whole, path)

    @property
    def kind(self) -> str:
        """Name of the task."""
        return "pose" if self.whole else "position"

    @cached_property
    def frame(self) -> str:
        """Frame that is moved."""
        return str(load_robot(self.name, chain_to="auto").options["chain_to"])

    @cached_property
    def robot(self) -> Robot:
        """The robot in the file."""
        return load_robot(self.urdf)

    @cached_property
    def task(self) -> Task:
        """The task."""
        return (PoseTask if self.whole else PositionTask)(self.robot, self.frame)

    @cached_property
    def posture(self) -> np.ndarray:
        """Rest posture."""
        own = POSTURES.get(self.name)
        return rest_posture(PoseTask(self.robot, self.frame)) if own is None else np.array(own)

    @cached_property
    def path(self) -> Trajectory:
        """Figure eight that a control step follows."""
        z = self.task.value(self.posture)
        eight = figure_eight(z[:3], SIZE, period=ROUND, plane="yz")
        return PoseTrajectory(eight, pose=z) if self.whole else eight

    @cached_property
    def controller(self) -> EosController:
        """EOS control, the yardstick of what a step computes."""
        return EosController(self.task, self.path, kp=KP, kd=KD)

    @cached_property
    def dq(self) -> np.ndarray:
        """Joint velocities of the state in which a step is timed; its joints are the rest posture.

        There the self-motion law of EOS control and a posture task ask for the same.
        """
        return 0.1 * np.random.default_rng(0).normal(size=self.robot.n)

    @cached_property
    def acceleration(self) -> np.ndarray:
        """What the controller asks of the joints in that state."""
        state = self.controller.start(0.0, self.posture, self.dq)
        tau = self.controller.torque(T, self.posture, self.dq, state)
        return self.robot.forward_dynamics(self.posture, self.dq, tau)

    @cached_property
    def tight(self) -> np.ndarray:
        """Acceleration limits, one of them active there: the joint that self-motion moves most may have nine tenths."""
        limits = np.full(self.robot.n, 1e3)
        joint = np.linalg.norm(Chart.from_base(self.task, self.posture).V, axis=1).argmax()
        limits[joint] = 0.9 * abs(self.acceleration[joint])
        return limits

    def placement(self, q: np.ndarray) -> np.ndarray:
        """Placement of the frame, (4, 4)."""
        return np.array(self.robot.placement(q, self.frame).homogeneous)

    def moved(self, distance: float) -> np.ndarray:
        """Rest placement shifted along the diagonal by a distance [m]."""
        target = self.placement(self.posture)
        target[:3, 3] += distance / np.sqrt(3.0)
        return target

    def reachable(self, count: int, *, seed: int = 0) -> list[np.ndarray]:
        """Placements of the frame at joints drawn evenly from within their limits."""
        random = np.random.default_rng(seed)
        lower, upper = np.maximum(self.robot.lower, -np.pi), np.minimum(self.robot.upper, np.pi)
        return [self.placement(random.uniform(lower, upper)) for _ in range(count)]

    def problem(self) -> dict[str, Any]:
        """What a worker is told; see `Problem` in peers_workers/serve.py."""
        robot, target = self.robot, self.placement(self.posture)
        z_d, dz_d, ddz_d = self.path(T)
        target[:3, 3] = z_d[:3]
        rates = {"dz": dz_d, "ddz": ddz_d}
        limits = ("lower", "upper", "velocity", "effort")
        return {
            "urdf": str(self.urdf),
            "frame": self.frame,
            "joints": [str(name) for name in robot.model.names[1:]],
            "whole": self.whole,
            "posture": self.posture.tolist(),
            "target": target.tolist(),
            **{key: np.resize(np.append(rate, np.zeros(6)), 6).tolist() for key, rate in rates.items()},
            "t": T,
            "size": SIZE,
            "round": ROUND,
            "kp": KP,
            "kd": KD,
            "rate": np.sqrt(KP),
            "period": PERIOD,
            **{name: np.clip(getattr(robot, name), -1e6, 1e6).tolist() for name in limits},
            "acceleration": self.tight.tolist(),
            "tol": TOL,
            "max_iterations": 100,
        }

    @property
    def state(self) -> list[float]:
        """Input of a control step."""
        return [*self.posture, *self.dq]

    def search(self, target: np.ndarray) -> list[float]:
        """Input of inverse kinematics from the rest posture."""
        return [*self.posture, *target.ravel()]

    # -- are answers right? -----------------------------------------------------------------------------------------

    def off(self, q: Sequence[float], target: np.ndarray) -> float:
        """Task error that joints leave, by Pinocchio's forward kinematics [m, rad]."""
        if len(q) != self.robot.n or not np.isfinite(q).all():
            return float("inf")
        placement = self.placement(np.array(q))
        error = np.abs(target[:3, 3] - placement[:3, 3]).max()
        if self.whole:
            error = max(error, np.abs(pin.log3(placement[:3, :3].T @ target[:3, :3])).max())
        return float(error)

    def within(self, q: Sequence[float]) -> bool:
        """Whether joints are within their limits, full turns of revolute joints taken off."""
        lower, upper = self.robot.lower, self.robot.upper
        turns = np.array([2.0 * np.pi if joint.kind == "revolute" else np.inf for joint in self.robot.joints])
        least = np.where(np.isfinite(turns), np.array(q) - np.ceil((np.array(q) - upper) / turns) * turns, q)
        return bool(((least >= lower - 1e-9) & (least <= upper + 1e-9)).all())

    def torque_off(self, tau: np.ndarray) -> float:
        """How far a torque is from doing what is asked of the task [m/s², rad/s²]."""
        q, dq = self.posture, self.dq
        point = self.task.at(q, dq)
        error = point.J @ self.robot.forward_dynamics(q, dq, tau) + point.drift
        return float(np.abs(error - self.controller.task_acceleration(T, point)).max())

    def velocity_off(self, dq: np.ndarray) -> float:
        """How far joint velocities are from doing what is asked of the task, as a part of it."""
        error = np.sqrt(KP) * self.task.minus(self.path(T).z, self.task.value(self.posture))
        return float(np.linalg.norm(self.task.linearize(self.posture)[1] @ dq - error) / np.linalg.norm(error))

    def motion(self) -> list[list[float]]:
        """States of one round of the figure eight, one a period, self-motion at rest."""
        times = np.arange(0.0, ROUND, PERIOD)
        chart = Chart.from_base(self.task, self.posture)
        found, start = [], None
        for t in times:
            start = chart.inverse(self.path(t).z, chart.v_bar, start=start)
            found.append(start.q)
        q = np.array(found)
        dq = (np.roll(q, -1, axis=0) - np.roll(q, 1, axis=0)) / (2.0 * PERIOD)
        return np.hstack((q, dq)).tolist()


def both(name: str, folder: Path) -> tuple[Setting, Setting]:
    """Settings of a robot for its position and its pose."""
    setting = Setting.make(name, False, folder)
    return setting, replace(setting, whole=True)
