"""Collection of a run's samples, and the `Result` made of them however the run ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from eos_pin._arrays import (
    Array,
    JointVector,
    Vector,
    VectorLike,
    called,
    nearest,
    number,
)
from eos_pin.charts.chart import Chart
from eos_pin.charts.dynamics import couplings
from eos_pin.control.objectives import Further
from eos_pin.errors import ChartError, EosError, FunctionError, InputError, SingularError, take
from eos_pin.robot.model import Robot
from eos_pin.simulation._shortcomings import not_measured, with_shortcomings
from eos_pin.simulation._storage import provenance
from eos_pin.simulation._systems import System
from eos_pin.simulation.limit_use import limits_of
from eos_pin.simulation.result import Result, names_of
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

_TASK_COLUMNS = ("z", "dz", "z_ref", "error", "task_force", "task_deficit", "deficit_from_limits")
#: Samples of a run, and joints in all samples together, that are kept at most.
MOST_SAMPLES, MOST_JOINT_SAMPLES = 1_000_000, 20_000_000
#: Called with time and joints of every sample of a run: a progress bar, a live view.
Observer: TypeAlias = Callable[[float, JointVector], None]


class Stop(Exception):  # noqa: N818 - an ending, not an error
    """End of a run, with a status and a message."""

    def __init__(self, status: str, message: str) -> None:
        self.status, self.message = status, message
        super().__init__(message)


class _Row(NamedTuple):
    """One sample."""

    t: float
    q: JointVector
    dq: JointVector
    ddq: JointVector
    tau: JointVector
    work: float
    state: Any
    chart: Chart | None
    #: z, dz, and the deficits that the controller reports.
    task: tuple[Array, Array, Array, Array]
    #: Further task that the self-motion tracks; None without.
    further: Further | None


class Recorder:
    """Samples of a run, and the way it ended."""

    def __init__(self, system: System, times: Vector, arguments: dict[str, Any], observer: Observer | None) -> None:
        check_run(system.plant.n, len(times), float(times[-1]), system.controller.reference)
        self.system, self.arguments, self.observer = system, arguments, observer
        self.times: list[float] = times.tolist()
        self.switches: list[float] = []
        self.status, self.message = "finished", ""
        self._rows: list[_Row] = []
        self._next = 0
        self._clock, self._wall = time.process_time(), time.perf_counter()

    def due(self, start: float, end: float) -> Iterator[float]:
        """Sample times from `start` up to `end` that have not been taken."""
        while self.is_due(end):
            if self.times[self._next] >= start:
                yield self.times[self._next]
            else:
                self._next += 1

    def is_due(self, end: float) -> bool:
        """Whether there is a sample to take up to `end`."""
        return self._next < len(self.times) and bool(self.times[self._next] <= end)

    def add(self, t: float, x: Vector, tau: JointVector | None = None) -> None:
        """Take a sample; the torque is the controller's unless it was held."""
        if self._rows and t <= self._rows[-1].t:
            self._next += t >= self.times[min(self._next, len(self.times) - 1)]
            return
        self._next += self._next < len(self.times) and t >= self.times[self._next]
        system = self.system
        q, dq = system.joints(t, np.array(x))
        report = system.controller._evaluate(t, q, dq, system.state, tau)
        tau = report.tau
        ddq, _ = system.accelerate(t, q, dq, tau)
        self._rows.append(
            _Row(t, q, dq, ddq, np.array(tau), x[-1], system.state, system.recorded_chart, report[1:5], report.further)
        )
        if self.observer is not None:
            called("the observer", self.observer, t, q)

    @contextmanager
    def until_it_ends(self) -> Iterator[None]:
        """Turn an exception that ends the run into a status and a message; before the first sample it is raised."""
        try:
            yield
        except (Stop, EosError, KeyboardInterrupt) as ending:
            # A fault of the caller's own code is no end of a run.
            if not self._rows or isinstance(ending, FunctionError):
                raise
            if isinstance(ending, KeyboardInterrupt):
                take(ending)
            self.status, self.message = _ending(ending, self._rows[-1].t)

    def result(self) -> Result:
        """Build the `Result`. Quantities that follow from the recorded states are computed here, after the run."""
        controller, plant = self.system.controller, self.system.plant
        t, q, dq, ddq, tau, work, *_ = zip(*self._rows, strict=True)
        cpu, wall = time.process_time() - self._clock, time.perf_counter() - self._wall
        force = self.system.task_force
        task = self.system.task or (force.task if force else None)
        info = provenance() | {
            "robot": _record(plant),
            "limits": limits_of(plant),
            "task": _description(task) if task else None,
            "force_task": force.task.describe() if force else None,
            "controller": controller.describe(),
            "coupling": couplings(plant, [(row.chart, row.q) for row in self._rows if row.chart]),
            "arguments": self.arguments,
            "cpu_seconds": cpu,
            "wall_seconds": wall,
        }
        run = Result(
            t=np.array(t),
            q=np.array(q),
            dq=np.array(dq),
            ddq=np.array(ddq),
            tau=np.array(tau),
            **self._self_motion(),
            **self._task(task),
            kinetic_energy=np.array([plant._kinetic_energy(a, b) for a, b in zip(q, dq, strict=True)]),
            work=np.array(work),
            switches=np.array(self.switches, dtype=float),
            period=self.system.reference_period,
            status=self.status,
            message=self.message,
            info=info,
            **names_of(task),
        )
        apart = controller.joint_distances(run.t, run.q)
        passed = controller._broken_limits(run.t, run.q, run.dq, run.tau) if run.ok else ""
        judged = with_shortcomings(run, task, passed, apart, [row.further for row in self._rows])
        return replace(judged, message=judged.message or not_measured(controller))

    def _self_motion(self) -> dict[str, Any]:
        """Number of the chart and self-motion of each sample."""
        rows, controller = self._rows, self.system.controller
        numbers: dict[Chart | None, int] = {}
        number = np.array([numbers.setdefault(row.chart, len(numbers)) for row in rows])
        r = max((chart.r for chart in numbers if chart), default=0)
        v, dv, v_ref = np.full((3, len(rows), r), np.nan)
        q, dq = np.array([row.q for row in rows]), np.array([row.dq for row in rows])
        for chart, k in numbers.items():
            if chart:
                v[number == k] = chart.v_bar + chart.dual.project((q[number == k] - chart.q_bar).T).T
                dv[number == k] = chart.dual.project(dq[number == k].T).T
        for k, row in enumerate(rows):
            target = controller._self_motion_target(row.t, row.state)
            if target is not None:
                v_ref[k] = target.z
        return {"chart": number, "v": v, "dv": dv, "v_ref": v_ref}

    def _task(self, task: Task | None) -> dict[str, Any]:
        """Task values and errors at each sample."""
        rows, controller, force = self._rows, self.system.controller, self.system.task_force
        if task is None:
            return {name: np.zeros((len(rows), 0)) for name in _TASK_COLUMNS}
        reference, unknown = controller.reference, np.full(task.m, np.nan)
        # The plant's kinematics are those of the controller's model, which may differ in inertia only.
        done = [
            row.task if task is controller.task else (*task._at(row.q, row.dq)[::2], unknown, unknown) for row in rows
        ]
        z, dz, singular, limited = map(np.array, zip(*done, strict=True))
        z_ref, error = np.full_like(z, np.nan), np.full_like(dz, np.nan)
        if reference is not None:
            z_ref = np.array([reference(row.t).z for row in rows])
            error = np.array(list(map(task._minus, z_ref, z)))
        forces = np.array([force.force(row.t) for row in rows], dtype=float) if force else np.zeros_like(dz)
        return dict(zip(_TASK_COLUMNS, (z, dz, z_ref, error, forces, singular + limited, limited), strict=True))


def _ending(ending: BaseException, t: float) -> tuple[str, str]:
    """Status and message of a run that came to time t."""
    if isinstance(ending, Stop):
        return ending.status, ending.message
    if isinstance(ending, KeyboardInterrupt):
        return "interrupted", f"interrupted at t = {t:.4g} s"
    kinds = {SingularError: "singular", ChartError: "chart_lost"}
    status = next((status for kind, status in kinds.items() if isinstance(ending, kind)), "failed")
    return status, f"the run ended at t = {t:.4g} s: {ending}"


def uninterrupted(result: Result) -> Result:
    """The result unchanged; an interrupt that ended the run is raised again, to end the sweep or the command as well.

    Raises:
        KeyboardInterrupt: The run was interrupted.
    """
    if result.status == "interrupted":
        raise KeyboardInterrupt(f"the run is {result.message}, nothing of it is kept")
    return result


def _description(task: Task) -> dict[str, Any]:
    """Plain values of a task, and a mark if it moves: its motion is none of them."""
    return task.describe() | ({"moves": True} if task.moves else {})


def joint_run(
    task: Task,
    t: VectorLike,
    q: Float[Array, "T n"],
    z: Float[Array, "T size"],
    *,
    dq: Float[Array, "T n"] | None = None,
    v: Float[Array, "T r"] | None = None,
    chart: Int[Array, " T"] | None = None,
    period: float = math.inf,
    status: str = "unreached",
    message: str = "",
    info: Mapping[str, Any] | None = None,
    **columns: Array,
) -> Result:
    """Joints over time without dynamics, in the form that figures, tables and replay take.

    Args:
        task: The task.
        t: Times [s].
        q: Joints.
        z: Task points that were asked for, NaN where that is not known.
        dq: Velocities of joints that were measured or commanded; without them the joints are postures.
        v: Self-motion coordinates, if there are charts.
        chart: Number of the chart at each time.
        period: Period of the path [s].
        status: Status of the run where there is a message.
        message: Why it ends early, or what is wrong with it; empty otherwise.
        info: Provenance beside that of robot and task.
        columns: Further columns of the `Result`, each zero by default.
    """
    robot, t = task.robot, np.asarray(t, dtype=float)
    rest, still = np.zeros(len(t)), np.zeros((len(t), robot.n))
    speeds, moving = still if dq is None else dq, dq is not None
    v = np.zeros((len(t), 0)) if v is None else v
    chart = np.zeros(len(t), dtype=np.int64) if chart is None else chart
    reached = np.array([task._set_time(now)._value(row) for now, row in zip(t.tolist(), q, strict=True)])
    reached = reached.reshape(len(t), task.size)
    error = np.full((len(t), task.m), math.nan)
    if np.isfinite(z).all():
        error = np.array([task._minus(a, b) for a, b in zip(z, reached, strict=True)]).reshape(len(t), task.m)
    none = np.zeros_like(error)
    origin = {"robot": _record(robot), "task": _description(task), "arguments": {}}
    origin["controller"] = {"kind": "Kinematics"}
    origin["limits"] = limits_of(robot, moving=moving)
    dz, energy = none, rest
    if moving:
        rows = list(zip(q, speeds, strict=True))
        dz = np.array([task._set_time(now)._at(*row).dz for now, row in zip(t.tolist(), rows, strict=True)])
        dz = dz.reshape(error.shape)
        # Nobody knows the torques, nor their work.
        energy = (
            np.full(len(t), math.nan) if robot.lacks_dynamics else np.array([robot._kinetic_energy(*x) for x in rows])
        )
    given: dict[str, Any] = {
        "ddq": still, "tau": np.full_like(still, math.nan) if moving else still, "task_force": none,
        "task_deficit": none, "deficit_from_limits": none, "dv": 0.0 * v,
        "v_ref": np.full_like(v, np.nan), "switches": t[1:][np.diff(chart) != 0], "kinetic_energy": energy,
        "work": np.full(len(t), math.nan) if moving else rest,
    }  # fmt: skip
    return Result(
        t=t, q=q, dq=speeds, z=reached, dz=dz, z_ref=z, error=error, v=v, chart=chart, period=period,
        status=status if message else "finished", message=message, info=provenance() | origin | dict(info or {}),
        **given | columns, **names_of(task),
    )  # fmt: skip


def _record(robot: Robot) -> dict[str, Any]:
    """Description from which `Result.load_plant` finds the robot again."""
    return {
        "name": robot.name,
        "source": robot.source,
        "options": dict(robot.options),
        "urdf_sha256": robot.urdf_sha256,
        "joints": [joint.name for joint in robot.joints],
        "continuous": np.flatnonzero(robot.continuous).tolist(),
    }


def check_run(n: int, samples: int, duration: float, path: Trajectory | None) -> None:
    """Refuse a run that would keep too much, or end before its path begins.

    Args:
        n: Number of joints.
        samples: Samples that are kept.
        duration: Length of the run [s].
        path: Path that is followed, if there is one.

    Raises:
        InputError: The message has a remedy.
    """
    if samples * n > MOST_JOINT_SAMPLES:
        raise InputError(
            f"{samples:,} samples of {n} joints are more than can be kept; up to {MOST_JOINT_SAMPLES // n:,} are "
            "possible. Make the run shorter, or keep fewer samples per second"
        )
    if path is not None and path.begin >= duration:
        raise InputError(
            f"the path begins at t = {path.begin:.10g} s, when the run from 0 to {duration:g} s has ended. Count its "
            "times from the start of the run, such as times - times[0]"
        )


def sample_times(duration: float, rate: float, period: float) -> Array:
    """Sample times: a regular grid, the end, and the exact multiples of the period instead of their neighbours.

    Raises:
        InputError: The numbers are out of range, or there would be more samples than can be kept.
    """
    duration, rate = number(duration, "the duration", above=0.0), number(rate, "the sample rate", above=0.0)
    count = duration * rate + (duration / period if period > 0.0 else math.inf)
    if count > MOST_SAMPLES:
        raise InputError(
            f"a run of {duration:,.10g} s with {rate:g} samples kept per second would have {count:,.0f} samples; up to "
            f"{MOST_SAMPLES:,} are possible. Make it shorter, or keep fewer per second; if the duration comes from a "
            "path whose times are in milliseconds, divide them by 1000"
        )
    times = np.arange(0.0, duration, 1.0 / rate)
    exact = [duration]
    if math.isfinite(period):
        exact += list(period * np.arange(int(duration / period + 1e-9) + 1))
    exact_times = np.unique(np.minimum(exact, duration))
    near = np.abs(times - exact_times[nearest(exact_times, times)]) < 1e-9 * max(1.0, duration)
    return np.unique(np.concatenate((times[~near], exact_times)))
