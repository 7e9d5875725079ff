"""Closed loops in simulation: continuous, sampled, and in the extended operational space itself.

A run that cannot go on ends with a status, a message and everything computed so far; only wrong arguments raise.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from eos_pin.arrays import Array, JointVector, Vector, VectorLike, number, spread, vector
from eos_pin.atlas import Atlas
from eos_pin.charts import Inverse
from eos_pin.controllers import Controller, ControlLoop, EosController
from eos_pin.errors import ChartError, EosError, InputError, SingularError
from eos_pin.results import Result, provenance
from eos_pin.robot import Robot
from eos_pin.tasks import Task

Method: TypeAlias = Literal["DOP853", "RK45", "LSODA", "Radau", "BDF"]
#: Called with time and joints of every sample of a run: a progress bar, a live view.
Observer: TypeAlias = Callable[[float, JointVector], None]
#: More accepted steps than this in one run mean that it is stuck.
MOST_STEPS = 1_000_000


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


@dataclass(frozen=True)
class SensorNoise:
    """Normally distributed errors of what the controller measures.

    Attributes:
        q: Standard deviation of the joints [rad or m].
        dq: Standard deviation of the joint velocities [rad/s or m/s].
    """

    q: float = 0.0
    dq: float = 0.0


def simulate(
    plant: Robot,
    controller: Controller,
    q: VectorLike,
    dq: VectorLike | None = None,
    *,
    duration: float,
    method: Method = "DOP853",
    rtol: float = 1e-9,
    atol: float | None = None,
    rate: float = 100.0,
    task_force: TaskForce | None = None,
    observer: Observer | None = None,
) -> Result:
    """Run a controller on a plant in continuous time; Eq. (31).

    Charts change between steps of the integrator, at the root where the controller's margin is used up, and never
    inside a step.

    Args:
        plant: The robot that moves; it need not be the robot the controller knows.
        controller: The controller.
        q: Joints at the start, (n,).
        dq: Joint velocities at the start, at rest by default.
        duration: Length of the run [s].
        method: Integrator of SciPy.
        rtol: Relative tolerance of the integrator.
        atol: Absolute tolerance; that of `rtol` by default.
        rate: Samples kept per second, besides the exact multiples of the reference's period.
        task_force: Force of the environment.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments.
        SingularError: The task is singular at the start.
    """
    system = _JointSystem(plant, controller, task_force)
    x = system.begin(*_state(plant, q, dq))
    arguments = {"kind": "continuous", "method": method, "rtol": rtol, "atol": rtol if atol is None else atol}
    return _integrate(system, x, duration, rate, arguments, observer)


def simulate_eos(
    plant: Robot,
    controller: Controller,
    q: VectorLike,
    dq: VectorLike | None = None,
    *,
    atlas: Atlas,
    duration: float,
    method: Method = "DOP853",
    rtol: float = 1e-9,
    atol: float | None = None,
    rate: float = 100.0,
    task_force: TaskForce | None = None,
    observer: Observer | None = None,
) -> Result:
    """The same motion as `simulate`, integrated in w = (z, v); Eqs. (13), (30).

    The joints never appear as state: they are y(z, v) on the current chart. For a task on a Lie group, z is integrated
    in exponential coordinates about the chart's z_bar.

    Args:
        plant: The robot that moves.
        controller: The controller.
        q: Joints at the start, (n,).
        dq: Joint velocities at the start, at rest by default.
        atlas: Charts whose coordinates are integrated.
        duration: Length of the run [s].
        method: Integrator of SciPy.
        rtol: Relative tolerance of the integrator.
        atol: Absolute tolerance; that of `rtol` by default.
        rate: Samples kept per second, besides the exact multiples of the reference's period.
        task_force: Force of the environment.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments.
        SingularError: The task is singular at the start.
    """
    system = _ExtendedSystem(plant, controller, task_force, atlas)
    x = system.begin(*_state(plant, q, dq))
    arguments = {"kind": "extended", "method": method, "rtol": rtol, "atol": rtol if atol is None else atol}
    return _integrate(system, x, duration, rate, arguments, observer)


def simulate_sampled(
    plant: Robot,
    controller: Controller,
    q: VectorLike,
    dq: VectorLike | None = None,
    *,
    duration: float,
    period: float = 1e-3,
    substeps: int = 1,
    noise: SensorNoise | None = None,
    delay: float = 0.0,
    torque_limits: bool | VectorLike = False,
    rate: float = 100.0,
    seed: int = 0,
    task_force: TaskForce | None = None,
    observer: Observer | None = None,
) -> Result:
    """Run a controller as a computer would: sampled, its torque held over each period.

    Args:
        plant: The robot that moves; it need not be the robot the controller knows.
        controller: The controller, called once a period.
        q: Joints at the start, (n,).
        dq: Joint velocities at the start, at rest by default.
        duration: Length of the run [s].
        period: Control period [s].
        substeps: Runge–Kutta steps (order 4) of the plant in each period.
        noise: Errors of the measured state.
        delay: Age of the state that the controller sees [s], rounded to whole periods.
        torque_limits: Clip the torque: True at the plant's own limits, or at limits of your own, (n,) [N m or N].
        rate: Samples kept per second, besides the exact multiples of the reference's period.
        seed: Seed of the noise.
        task_force: Force of the environment.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments.
        SingularError: The task is singular at the start.
    """
    q, dq = _state(plant, q, dq)
    period = number(period, "the control period", above=0.0)
    lag = round(number(delay, "the delay", at_least=0.0) / period)
    if substeps < 1:
        raise InputError(f"substeps must be at least 1, got {substeps}")
    limits = None
    if torque_limits is not False:
        limits = plant.effort if torque_limits is True else spread(torque_limits, plant.n, "the torque limits")
    random = np.random.default_rng(seed)
    system = _JointSystem(plant, controller, task_force)
    system.begin(q, dq)
    loop = ControlLoop(controller)
    arguments = {
        "kind": "sampled",
        "control_period": period,
        "substeps": substeps,
        "noise": [noise.q, noise.dq] if noise else None,
        "delay": lag * period,
        "torque_limits": None if limits is None else limits.tolist(),
        "seed": seed,
    }
    record = _Recorder(system, _times(duration, rate, system.reference_period), arguments, observer)
    steps = max(1, math.ceil(duration / period - 1e-9))
    measured: list[tuple[JointVector, JointVector]] = []
    x = np.concatenate((q, dq, [0.0]))
    n = plant.n
    with record.until_it_ends():
        for k in range(steps):
            t, end = k * period, min((k + 1) * period, duration)
            state = x[:n].copy(), x[n : 2 * n].copy()
            if noise:
                state = state[0] + noise.q * random.normal(size=n), state[1] + noise.dq * random.normal(size=n)
            measured = (measured + [state])[-lag - 1 :]
            tau = loop.step(t, *measured[0])
            if limits is not None:
                tau = np.clip(tau, -limits, limits)
            if loop.memory is not system.memory:
                if k:
                    record.switches.append(t)
                system.memory = loop.memory
            for sample in record.due(t, end):
                record.add(sample, _runge_kutta(system, t, x, tau, sample - t, substeps) if sample > t else x, tau)
            x = _runge_kutta(system, t, x, tau, end - t, substeps)
            if not math.isfinite(x.dot(x)):
                raise _Stop("diverged", f"the state is no longer finite at t = {end:.4g} s; lower the gains or the period")
        record.add(duration, x, tau)
    return record.result()


# -- systems: what is integrated --------------------------------------------------------------------------------------


class _System(ABC):
    """Differential equations with a memory that changes only in `switch`. The last state is the work done."""

    def __init__(self, plant: Robot, controller: Controller, task_force: TaskForce | None) -> None:
        robot = getattr(controller, "robot", plant)
        if robot.n != plant.n:
            raise InputError(f"the controller is for {robot.n} joints, the plant {plant.name!r} has {plant.n}")
        if task_force is not None and task_force.task.robot.n != plant.n:
            raise InputError(f"the task force is on a robot with {task_force.task.robot.n} joints, the plant has {plant.n}")
        self.plant, self.controller, self.task_force = plant, controller, task_force
        self.memory: Any = None

    @property
    def reference_period(self) -> float:
        return float(getattr(getattr(self.controller, "reference", None), "period", math.inf))

    def accelerate(
        self, t: float, q: JointVector, dq: JointVector, tau: JointVector
    ) -> tuple[JointVector, float]:
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


class _JointSystem(_System):
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


class _ExtendedSystem(_System):
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
        chart, task = self.chart, self.atlas.task
        n, m = chart.n, chart.m
        z = task.plus(chart.z_bar, x[:m])
        self._near = chart.inverse(z, x[m:n], start=self._near, tol=1e-13)
        q = self._near.q
        # dq = H dw without H: [G'; Vᵀ] dq = dw
        return q, chart.acceleration(task.linearize(q)[1], x[n : n + m], x[n + m : 2 * n])

    def margin(self, t: float, x: Vector) -> float:
        q, dq = self.joints(x)
        _, J = self.atlas.task.linearize(q)
        return min(self.chart.margin(J) - self.atlas.threshold, self.controller.margin(t, q, dq, self.memory))

    def switch(self, t: float, x: Vector) -> Vector:
        q, dq = self.joints(x)
        if self.controller.margin(t, q, dq, self.memory) <= 1e-9:
            self.memory = self.controller.update(t, q, dq, self.memory)
        self.chart = self.atlas.next(self.chart, q)
        return self._enter(dq, x[-1])


# -- drivers ----------------------------------------------------------------------------------------------------------


class _Stop(Exception):
    """Ends a run with a status and a message."""


def _integrate(
    system: _System, x: Vector, duration: float, rate: float, arguments: dict[str, Any], observer: Observer | None
) -> Result:
    """Integrate with a solver of SciPy, restarting it where a chart is left."""
    import scipy.integrate
    from scipy.optimize import brentq

    if arguments["method"] not in ("DOP853", "RK45", "LSODA", "Radau", "BDF"):
        raise InputError(f"method must be DOP853, RK45, LSODA, Radau or BDF, got {arguments['method']!r}")
    number(arguments["rtol"], "rtol", above=0.0)
    number(arguments["atol"], "atol", above=0.0)
    record = _Recorder(system, _times(duration, rate, system.reference_period), arguments, observer)
    options = {"rtol": arguments["rtol"], "atol": arguments["atol"]}
    make = getattr(scipy.integrate, arguments["method"])
    with record.until_it_ends():
        t = 0.0
        record.add(t, x)
        solver = make(system.rhs, t, x, duration, **options)
        for _ in range(MOST_STEPS):
            message = solver.step()
            if solver.status == "failed":
                raise _Stop("integration_failed", f"the integrator gave up at t = {solver.t:.4g} s: {message}")
            if not math.isfinite(solver.y.dot(solver.y)):
                raise _Stop("diverged", f"the state is no longer finite at t = {solver.t:.4g} s")
            dense, end = None, solver.t
            crossed = system.margin(solver.t, solver.y) <= 0.0
            if crossed:
                dense = solver.dense_output()
                # Just after a switch the margin is near 1, so the start of the step is on the other side.
                end = brentq(lambda s: system.margin(s, dense(s)), solver.t_old, solver.t, xtol=1e-12)
            for sample in record.due(t, end):
                dense = dense or solver.dense_output()
                record.add(sample, dense(sample))
            t = end
            if crossed:
                x = system.switch(t, dense(t))  # type: ignore[misc]
                record.switches.append(t)
                if t < duration:
                    solver = make(system.rhs, t, x, duration, **options)
            if t >= duration:
                break
        else:
            raise _Stop("stuck", f"the run took {MOST_STEPS} steps and only came to t = {t:.4g} s; loosen rtol")
    return record.result()


def _runge_kutta(system: _JointSystem, t: float, x: Vector, tau: JointVector, length: float, substeps: int) -> Vector:
    """State after `length` seconds under a held torque, by the classical method of order 4."""
    h = length / substeps
    f = system.derivative
    for i in range(substeps):
        s = t + i * h
        a = f(s, x, tau)
        b = f(s + 0.5 * h, x + 0.5 * h * a, tau)
        c = f(s + 0.5 * h, x + 0.5 * h * b, tau)
        d = f(s + h, x + h * c, tau)
        x = x + (h / 6.0) * (a + 2.0 * (b + c) + d)
    return x


class _Recorder:
    """Collects samples, and how the run ended."""

    def __init__(
        self, system: _System, times: Vector, arguments: dict[str, Any], observer: Observer | None
    ) -> None:
        self.system, self.times, self.arguments, self.observer = system, times, arguments, observer
        self.switches: list[float] = []
        self.status, self.message = "finished", ""
        self._rows: list[tuple[Any, ...]] = []
        self._next = 0
        self._clock, self._wall = time.process_time(), time.perf_counter()

    def due(self, start: float, end: float) -> Iterator[float]:
        """Sample times from `start` up to `end` that have not been taken."""
        while self._next < len(self.times) and self.times[self._next] <= end:
            if self.times[self._next] >= start:
                yield float(self.times[self._next])
            else:
                self._next += 1

    def add(self, t: float, x: Vector, tau: JointVector | None = None) -> None:
        """Take a sample; the torque is the controller's unless it was held."""
        if self._rows and t <= self._rows[-1][0]:
            self._next += t >= self.times[min(self._next, len(self.times) - 1)]
            return
        self._next += self._next < len(self.times) and t >= self.times[self._next]
        system = self.system
        q, dq = (np.array(a) for a in system.joints(x))
        if tau is None:
            tau = system.controller.torque(t, q, dq, system.memory)
        ddq, _ = system.accelerate(t, q, dq, tau)
        self._rows.append((t, q, dq, ddq, np.array(tau), x[-1], system.memory, getattr(system, "chart", None)))
        if self.observer is not None:
            self.observer(t, q)

    @contextmanager
    def until_it_ends(self) -> Iterator[None]:
        """Turn whatever ends the run early into a status and a message."""
        try:
            yield
        except _Stop as stop:
            self.status, self.message = stop.args
        except SingularError as error:
            self.status, self.message = "singular", f"the run ended at t = {self._reached:.4g} s: {error}"
        except ChartError as error:
            self.status, self.message = "chart_lost", f"the run ended at t = {self._reached:.4g} s: {error}"
        except EosError as error:
            self.status, self.message = "failed", f"the run ended at t = {self._reached:.4g} s: {error}"
        except KeyboardInterrupt:
            self.status, self.message = "interrupted", f"interrupted at t = {self._reached:.4g} s"

    @property
    def _reached(self) -> float:
        return self._rows[-1][0] if self._rows else 0.0

    def result(self) -> Result:
        """The run as a value; what follows from the state is computed here, out of the loop's way."""
        controller, plant = self.system.controller, self.system.plant
        t, q, dq, ddq, tau, work, memories, charts = zip(*self._rows, strict=True)
        cpu, wall = time.process_time() - self._clock, time.perf_counter() - self._wall
        force = self.system.task_force
        task = getattr(controller, "task", None) or getattr(getattr(self.system, "atlas", None), "task", None)
        task = task or (force.task if force else None)
        columns: dict[str, list[Any]] = {name: [] for name in ("z", "dz", "z_ref", "error", "task_force", "v", "dv", "v_ref", "chart")}
        numbers: dict[int, int] = {}
        for row in range(len(t)):
            chart = charts[row] or getattr(memories[row], "chart", None)
            columns["chart"].append(numbers.setdefault(id(chart), len(numbers)))
            columns["v"].append(chart.v(q[row]) if chart else ())
            columns["dv"].append(chart.dv(dq[row]) if chart else ())
            asked = controller.self_motion_target(t[row], memories[row]) if isinstance(controller, EosController) else None
            columns["v_ref"].append(asked.z if asked else np.full(chart.r if chart else 0, np.nan))
            if task is None:
                for name in ("z", "dz", "z_ref", "error", "task_force"):
                    columns[name].append(())
                continue
            # The plant's own kinematics; the controller's model may differ in inertia only.
            point = task.at(q[row], dq[row])
            reference = getattr(controller, "reference", None)
            z_ref = reference(t[row]).z if reference else np.full(task.size, np.nan)
            columns["z"].append(point.z)
            columns["dz"].append(point.dz)
            columns["z_ref"].append(z_ref)
            columns["error"].append(task.minus(z_ref, point.z) if reference else np.full(task.m, np.nan))
            columns["task_force"].append(np.asarray(force.force(t[row])) if force else np.zeros(task.m))
        info = provenance() | {
            "robot": {
                "name": plant.name,
                "source": plant.source,
                "options": dict(plant.options),
                "urdf_sha256": plant.urdf_sha256,
            },
            "task": task.describe() if task else None,
            "controller": controller.describe(),
            "arguments": self.arguments,
            "cpu_seconds": cpu,
            "wall_seconds": wall,
        }
        return Result(
            t=np.array(t),
            q=np.array(q),
            dq=np.array(dq),
            ddq=np.array(ddq),
            tau=np.array(tau),
            **{name: np.array(values, dtype=float) for name, values in columns.items() if name != "chart"},
            chart=np.array(columns["chart"], dtype=np.int64),
            kinetic_energy=np.array([plant.kinetic_energy(a, b) for a, b in zip(q, dq, strict=True)]),
            work=np.array(work),
            switches=np.array(self.switches, dtype=float),
            period=self.system.reference_period,
            status=self.status,
            message=self.message,
            info=info,
        )


def _state(plant: Robot, q: VectorLike, dq: VectorLike | None) -> tuple[JointVector, JointVector]:
    return vector(q, plant.n, "q at the start"), vector(np.zeros(plant.n) if dq is None else dq, plant.n, "dq at the start")


def _times(duration: float, rate: float, period: float) -> Array:
    """Sample times: a regular grid, the end, and the exact multiples of the period instead of their neighbours."""
    duration, rate = number(duration, "the duration", above=0.0), number(rate, "the sample rate", above=0.0)
    times = np.arange(0.0, duration, 1.0 / rate)
    exact = [duration]
    if math.isfinite(period):
        exact += list(period * np.arange(int(duration / period + 1e-9) + 1))
    exact_times = np.minimum(np.array(exact), duration)
    near = np.abs(times[:, None] - exact_times[None, :]).min(axis=1) < 1e-9 * max(1.0, duration)
    return np.unique(np.concatenate((times[~near], exact_times)))
