"""Differential equations of a plant under a controller, in joints or in w = (z, v)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from eos_pin._arrays import (
    JointVector,
    Vector,
    broadcast,
)
from eos_pin._kernels.dispatch import use_compiled
from eos_pin.charts._newton import Inverse
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.control.base import Controller
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.simulation.disturbances import Friction, TaskForce
from eos_pin.tasks.base import Task


@use_compiled
def state_rate(dq: JointVector, ddq: JointVector, tau: JointVector) -> Vector:
    """Time derivative of (q, dq, work) where the torques tau do the work."""
    return np.concatenate((dq, ddq, [tau.dot(dq)]))


@runtime_checkable
class SteppingPlant(Protocol):
    """A robot with an integrator of its own, such as `MujocoPlant`."""

    def advance(
        self, q: JointVector, dq: JointVector, tau: JointVector, length: float
    ) -> tuple[JointVector, JointVector]:
        """Joints and joint velocities after `length` seconds under a held torque."""


class System(ABC):
    """Differential equations with a memory that changes only in `switch`. The last state is the work done."""

    def __init__(
        self, plant: Robot, controller: Controller, task_force: TaskForce | None, friction: Friction | None = None
    ) -> None:
        plant.check_dynamics()
        controller._check_plant(plant)
        if task_force is not None and task_force.task.robot.n != plant.n:
            raise InputError(
                f"the task force is on a robot with {task_force.task.robot.n} joints, the plant has {plant.n}"
            )
        if friction is not None:
            for name in ("viscous", "coulomb"):
                broadcast(getattr(friction, name), plant.n, f"{name} friction")
        self.plant, self.controller, self.task_force, self.friction = plant, controller, task_force, friction
        #: Whether other torques than the controller's act on the plant.
        self.disturbed = not (task_force is None and friction is None)
        self.state: Any = None

    @property
    def reference_period(self) -> float:
        """Period of the reference [s]; infinite if it does not repeat, or there is none."""
        reference = self.controller.reference
        return math.inf if reference is None else float(reference.period)

    @property
    def task(self) -> Task | None:
        """Task whose errors are recorded."""
        return self.controller.task

    @property
    def recorded_chart(self) -> Chart | None:
        """Chart whose number and self-motion are recorded."""
        return self.controller._chart(self.state)

    def accelerate(self, t: float, q: JointVector, dq: JointVector, tau: JointVector) -> tuple[JointVector, float]:
        """Acceleration of the plant under all torques that act on it, and the power they bring in [W]."""
        if self.disturbed:
            tau = self.acting(t, q, dq, tau)
        return self.plant._forward_dynamics(q, dq, tau), tau.dot(dq)

    def acting(self, t: float, q: JointVector, dq: JointVector, tau: JointVector) -> JointVector:
        """The controller's torque with the task force and friction."""
        if self.task_force is not None:
            tau = tau + self.task_force._torque(t, q)
        if self.friction is not None:
            tau = tau + self.friction._torque(dq)
        return tau

    @abstractmethod
    def begin(self, q: JointVector, dq: JointVector) -> Vector:
        """State at the start."""

    @abstractmethod
    def rhs(self, t: float, x: Vector) -> Vector:
        """Time derivative of the state; pure but for warm starts."""

    @abstractmethod
    def joints(self, t: float, x: Vector) -> tuple[JointVector, JointVector]:
        """Joints and joint velocities of a state at time t."""

    @abstractmethod
    def switch_function(self, t: float, x: Vector) -> float:
        """Function that crosses zero where `switch` is due."""

    @abstractmethod
    def switch(self, t: float, x: Vector) -> Vector:
        """Move on to the next chart; the same state in its coordinates."""


class JointSystem(System):
    """State (q, dq, work); Eq. (31)."""

    def begin(self, q: JointVector, dq: JointVector) -> Vector:
        self.state = self.controller._start(0.0, q, dq)
        return np.concatenate((q, dq, [0.0]))

    def rhs(self, t: float, x: Vector, tau: JointVector | None = None) -> Vector:
        """Time derivative of the state under a torque, by default the controller's."""
        n = self.plant.n
        q, dq = x[:n], x[n:-1]
        if tau is None:
            tau = self.controller._torque(t, q, dq, self.state)
        if self.disturbed:
            tau = self.acting(t, q, dq, tau)
        return state_rate(dq, self.plant._forward_dynamics(q, dq, tau), tau)

    def advance(self, t: float, x: Vector, tau: JointVector, length: float, substeps: int) -> Vector:
        """State after `length` seconds under a held torque, in `substeps` steps of the plant."""
        h = length / substeps
        for i in range(substeps):
            x = self._step(t + i * h, x, tau, h)
        return x

    @cached_property
    def _step(self) -> Callable[[float, Vector, JointVector, float], Vector]:
        return self._own_step if isinstance(self.plant, SteppingPlant) else self._runge_kutta

    def _runge_kutta(self, t: float, x: Vector, tau: JointVector, h: float) -> Vector:
        """One step of the classical method of order 4."""
        f = self.rhs
        a = f(t, x, tau)
        b = f(t + 0.5 * h, x + 0.5 * h * a, tau)
        c = f(t + 0.5 * h, x + 0.5 * h * b, tau)
        d = f(t + h, x + h * c, tau)
        return x + (h / 6.0) * (a + 2.0 * (b + c) + d)

    def _own_step(self, t: float, x: Vector, tau: JointVector, h: float) -> Vector:
        """One step of the plant's own integrator, which holds task force and friction, too."""
        q, dq = self.joints(t, x)
        tau = self.acting(t, q, dq, tau)
        q_next, dq_next = cast(SteppingPlant, self.plant).advance(q, dq, tau, h)
        # The torque is constant, so its work needs no integral.
        return np.concatenate((q_next, dq_next, [x[-1] + tau.dot(q_next - q)]))

    def joints(self, t: float, x: Vector) -> tuple[JointVector, JointVector]:
        n = self.plant.n
        return x[:n], x[n : 2 * n]

    def switch_function(self, t: float, x: Vector) -> float:
        return self.controller._validity(t, *self.joints(t, x), self.state)

    def switch(self, t: float, x: Vector) -> Vector:
        self.state = self.controller._update(t, *self.joints(t, x), self.state)
        return x


class ExtendedSystem(System):
    """State (coordinates of z about z_bar, v, dz, dv, work) on a chart; Eq. (30)."""

    def __init__(self, plant: Robot, controller: Controller, task_force: TaskForce | None, atlas: Atlas) -> None:
        super().__init__(plant, controller, task_force)
        if atlas.task.robot.n != plant.n:
            raise InputError(f"the atlas is of a robot with {atlas.task.robot.n} joints, the plant has {plant.n}")
        self.atlas = atlas

    @property
    def task(self) -> Task:
        return self.controller.task or self.atlas.task

    @property
    def recorded_chart(self) -> Chart:
        return self.chart

    def begin(self, q: JointVector, dq: JointVector) -> Vector:
        self.state = self.controller._start(0.0, q, dq)
        self.atlas.task._set_time(0.0)
        self.chart = self.atlas.start(q)
        return self._enter(dq, 0.0)

    def _enter(self, dq: JointVector, work: float) -> Vector:
        chart, task = self.chart, self.atlas.task
        self._near = Inverse(chart.q_bar, np.zeros(chart.m), chart.B_bar, 0, 0.0)
        dz = task._at(chart.q_bar, dq).dz
        return np.concatenate((np.zeros(chart.m), chart.v_bar, dz, chart._dv(dq), [work]))

    def rhs(self, t: float, x: Vector) -> Vector:
        chart, task = self.chart, self.atlas.task
        n, m = chart.n, chart.m
        q, dq = self.joints(t, x)
        ddq, power = self.accelerate(t, q, dq, self.controller._torque(t, q, dq, self.state))
        point = task._at(q, dq)
        dx = np.empty(2 * n + 1)
        rate = x[n : n + m]
        dx[:m] = task._local_rate(x[:m], rate, chart.z_bar) if task.is_curved else task._local_rate(x[:m], rate)
        dx[m:n] = x[n + m : 2 * n]
        # ddw = H⁻¹ (ddq − E), H⁻¹ = [G'; Wᵀ], −H⁻¹E = (Ġ' dq, 0)
        dx[n : n + m] = point.J.dot(ddq) + point.drift
        dx[n + m : 2 * n] = chart._dv(ddq)
        dx[-1] = power
        return dx

    def joints(self, t: float, x: Vector) -> tuple[JointVector, JointVector]:
        chart, task = self.chart, self.atlas.task
        task._set_time(t)
        q, (n, m) = self._inverse(x).q, (chart.n, chart.m)
        # dq = H dw without H: [G'; Wᵀ] dq = dw, less what the task moves by itself.
        dz = x[n : n + m] - task._at(q, np.zeros(n)).dz if task.moves else x[n : n + m]
        return q, chart._acceleration(task._linearize(q)[1], dz, x[n + m : 2 * n])

    def _inverse(self, x: Vector) -> Inverse:
        m, n = self.chart.m, self.chart.n
        chart, task = self.chart, self.atlas.task
        z = task._plus(chart.z_bar, x[:m])
        found = chart._inverse(z, x[m:n], start=self._near, tol=1e-13)
        # To rounding: an integrator takes what is left for motion.
        u = found.u + found.B.dot(task._minus(task._value(found.q), z))
        return found._replace(q=chart._q(x[m:n], u), u=u)

    def switch_function(self, t: float, x: Vector) -> float:
        # Newton's method starts from the last state that was accepted, never from one that was only tried.
        self.atlas.task._set_time(t)
        self._near = self._inverse(x)
        q, dq = self.joints(t, x)
        _, J = self.atlas.task._linearize(q)
        return min(
            self.chart._margin(J, enough=self.atlas.threshold) - self.atlas.threshold,
            self.atlas.task._local_margin(x[: self.chart.m]),
            self.chart._room(q),
            self.controller._validity(t, q, dq, self.state),
        )

    def switch(self, t: float, x: Vector) -> Vector:
        q, dq = self.joints(t, x)
        if self.controller._validity(t, q, dq, self.state) <= 1e-9:
            self.state = self.controller._update(t, q, dq, self.state)
        self.atlas.task._set_time(t)
        self.chart = self.atlas.next(self.chart, q)
        return self._enter(dq, x[-1])
