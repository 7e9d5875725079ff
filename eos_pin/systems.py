"""What is integrated: the differential equations of a plant under a controller, in joints or in w = (z, v)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin.arrays import JointVector, Vector, VectorLike
from eos_pin.atlas import Atlas
from eos_pin.charts import Inverse
from eos_pin.controllers import Controller
from eos_pin.errors import InputError
from eos_pin.robot import Robot
from eos_pin.tasks import Task


@dataclass(frozen=True)
class TaskForce:
    """A force of the environment on a task, F^z of Eq. (24).

    Attributes:
        task: The task whose coordinates it acts along.
        force: Force as a function of time, (m,) [N, N m].
    """

    task: Task
    force: Callable[[float], VectorLike]

    def torque(self, t: float, q: JointVector) -> JointVector:
        """Joint torques G'ᵀF^z that it is worth [N m or N]."""
        return self.task.linearize(q)[1].T @ np.asarray(self.force(t), dtype=float)


class System(ABC):
    """Differential equations with a memory that changes only in `switch`. The last state is the work done."""

    def __init__(self, plant: Robot, controller: Controller, task_force: TaskForce | None) -> None:
        robot = getattr(controller, "robot", plant)
        if robot.n != plant.n:
            raise InputError(f"the controller is for {robot.n} joints, the plant {plant.name!r} has {plant.n}")
        if task_force is not None and task_force.task.robot.n != plant.n:
            raise InputError(
                f"the task force is on a robot with {task_force.task.robot.n} joints, the plant has {plant.n}"
            )
        self.plant, self.controller, self.task_force = plant, controller, task_force
        self.memory: Any = None

    @property
    def reference_period(self) -> float:
        return float(getattr(getattr(self.controller, "reference", None), "period", math.inf))

    def accelerate(self, t: float, q: JointVector, dq: JointVector, tau: JointVector) -> tuple[JointVector, float]:
        """Acceleration of the plant under the torque and the task force, and the power they bring in [W]."""
        if self.task_force is not None:
            tau = tau + self.task_force.torque(t, q)
        return self.plant.forward_dynamics(q, dq, tau), tau.dot(dq)

    @abstractmethod
    def begin(self, q: JointVector, dq: JointVector) -> Vector:
        """State at the start."""

    @abstractmethod
    def rhs(self, t: float, x: Vector) -> Vector:
        """Time derivative of the state; pure but for warm starts."""

    @abstractmethod
    def joints(self, x: Vector) -> tuple[JointVector, JointVector]:
        """Joints and joint velocities of a state."""

    @abstractmethod
    def margin(self, t: float, x: Vector) -> float:
        """Crosses zero where `switch` is due."""

    @abstractmethod
    def switch(self, t: float, x: Vector) -> Vector:
        """Move on to the next chart; the same state in its coordinates."""


class JointSystem(System):
    """State (q, dq, work); Eq. (31)."""

    def begin(self, q: JointVector, dq: JointVector) -> Vector:
        self.memory = self.controller.start(0.0, q, dq)
        return np.concatenate((q, dq, [0.0]))

    def rhs(self, t: float, x: Vector) -> Vector:
        n = self.plant.n
        q, dq = x[:n], x[n : 2 * n]
        return self.derivative(t, x, self.controller.torque(t, q, dq, self.memory))

    def derivative(self, t: float, x: Vector, tau: JointVector) -> Vector:
        """Time derivative of the state under a torque."""
        n = self.plant.n
        dx = np.empty(2 * n + 1)
        dx[:n] = x[n : 2 * n]
        dx[n : 2 * n], dx[-1] = self.accelerate(t, x[:n], x[n : 2 * n], tau)
        return dx

    def joints(self, x: Vector) -> tuple[JointVector, JointVector]:
        n = self.plant.n
        return x[:n], x[n : 2 * n]

    def margin(self, t: float, x: Vector) -> float:
        return self.controller.margin(t, *self.joints(x), self.memory)

    def switch(self, t: float, x: Vector) -> Vector:
        self.memory = self.controller.update(t, *self.joints(x), self.memory)
        return x


class ExtendedSystem(System):
    """State (coordinates of z about z_bar, v, dz, dv, work) on a chart; Eq. (30)."""

    def __init__(self, plant: Robot, controller: Controller, task_force: TaskForce | None, atlas: Atlas) -> None:
        super().__init__(plant, controller, task_force)
        if atlas.task.robot.n != plant.n:
            raise InputError(f"the atlas is of a robot with {atlas.task.robot.n} joints, the plant has {plant.n}")
        self.atlas = atlas

    def begin(self, q: JointVector, dq: JointVector) -> Vector:
        self.memory = self.controller.start(0.0, q, dq)
        self.chart = self.atlas.start(q)
        return self._enter(dq, 0.0)

    def _enter(self, dq: JointVector, work: float) -> Vector:
        chart, task = self.chart, self.atlas.task
        self._near = Inverse(chart.q_bar, np.zeros(chart.m), chart.B_bar, 0, 0.0)
        dz = task.linearize(chart.q_bar)[1] @ dq
        return np.concatenate((np.zeros(chart.m), chart.v_bar, dz, chart.dv(dq), [work]))

    def rhs(self, t: float, x: Vector) -> Vector:
        chart, task = self.chart, self.atlas.task
        n, m = chart.n, chart.m
        q, dq = self.joints(x)
        ddq, power = self.accelerate(t, q, dq, self.controller.torque(t, q, dq, self.memory))
        point = task.at(q, dq)
        dx = np.empty(2 * n + 1)
        dx[:m] = task.local_rate(x[:m], x[n : n + m])
        dx[m:n] = x[n + m : 2 * n]
        # ddw = H⁻¹ (ddq − E), H⁻¹ = [G'; Vᵀ], −H⁻¹E = (Ġ' dq, 0)
        dx[n : n + m] = point.J.dot(ddq) + point.drift
        dx[n + m : 2 * n] = chart.dv(ddq)
        dx[-1] = power
        return dx

    def joints(self, x: Vector) -> tuple[JointVector, JointVector]:
        q = self._inverse(x).q
        chart, task = self.chart, self.atlas.task
        n, m = chart.n, chart.m
        # dq = H dw without H: [G'; Vᵀ] dq = dw
        return q, chart.acceleration(task.linearize(q)[1], x[n : n + m], x[n + m : 2 * n])

    def _inverse(self, x: Vector) -> Inverse:
        m, n = self.chart.m, self.chart.n
        z = self.atlas.task.plus(self.chart.z_bar, x[:m])
        return self.chart.inverse(z, x[m:n], start=self._near, tol=1e-13)

    def margin(self, t: float, x: Vector) -> float:
        # Newton's method starts from the last state that was accepted, never from one that was only tried.
        self._near = self._inverse(x)
        q, dq = self.joints(x)
        _, J = self.atlas.task.linearize(q)
        return min(
            self.chart.margin(J) - self.atlas.threshold,
            self.atlas.task.local_margin(x[: self.chart.m]),
            self.controller.margin(t, q, dq, self.memory),
        )

    def switch(self, t: float, x: Vector) -> Vector:
        q, dq = self.joints(x)
        if self.controller.margin(t, q, dq, self.memory) <= 1e-9:
            self.memory = self.controller.update(t, q, dq, self.memory)
        self.chart = self.atlas.next(self.chart, q)
        return self._enter(dq, x[-1])
