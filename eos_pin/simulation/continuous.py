"""Runs in continuous time, in joint space and in extended operational space."""

from __future__ import annotations

import math
from typing import Any, Literal, TypeAlias

import numpy as np

from eos_pin._arrays import (
    JointVector,
    Vector,
    checked,
    number,
)
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.metric import metric_name
from eos_pin.control.base import Controller
from eos_pin.errors import ChartError, renamed
from eos_pin.robot.model import Robot
from eos_pin.robot.postures import JointsLike, in_order
from eos_pin.simulation._recorder import Observer, Recorder, Stop, sample_times
from eos_pin.simulation._systems import ExtendedSystem, JointSystem, System
from eos_pin.simulation.disturbances import TaskForce
from eos_pin.simulation.result import Result

Method: TypeAlias = Literal["DOP853", "RK45", "LSODA", "Radau", "BDF"]
#: More accepted steps than this, and as many again for each simulated second, mean that a run is stuck.
MOST_STEPS = 5_000
#: A step this short [s] whose trial points still leave the chart ends the run.
SHORTEST_STEP = 1e-9
#: Tolerance below which LSODA does not keep what is asked.
TIGHT = 1e-10
#: Steps of the plant in a sampled run, at most.
MOST_PERIODS = 100_000_000
#: A joint velocity [rad/s or m/s] that no robot has.
TOO_FAST = 1e4
#: Where the smallest singular value of G' is this fraction of the largest, a singularity is why the joints were fast.
NEARLY_SINGULAR = 0.05


@renamed(rate="record_rate")
@checked
def simulate(
    plant: Robot,
    controller: Controller,
    q: JointsLike,
    dq: JointsLike | None = None,
    *,
    duration: float,
    method: Method | None = None,
    rtol: float = 1e-9,
    atol: float | None = None,
    record_rate: float = 100.0,
    task_force: TaskForce | None = None,
    observer: Observer | None = None,
) -> Result:
    """Run a controller on a plant in continuous time; Eq. (31).

    Charts change between steps of the integrator, at the root where the controller's margin is used up, and never
    inside a step.

    Args:
        plant: The robot that moves; it need not be the robot of the controller's model.
        controller: The controller.
        q: Joints at the start, (n,), or some of them by name; others are as near 0 as their limits allow.
        dq: Joint velocities at the start, at rest by default.
        duration: Length of the run [s].
        method: Integrator of SciPy; by default LSODA, which takes half of the time, and DOP853 for tolerances below
            1e-10, which LSODA does not keep.
        rtol: Relative tolerance of the integrator.
        atol: Absolute tolerance; that of `rtol` by default.
        record_rate: Samples kept per second, besides the exact multiples of the reference's period.
        task_force: Force of the environment.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments.
        SingularError: The task is singular at the start.
    """
    system = JointSystem(plant, controller, task_force)
    x = system.begin(*_state(plant, q, dq))
    arguments = {"kind": "continuous", "method": method, "rtol": rtol, "atol": rtol if atol is None else atol}
    return _integrate(system, x, duration, record_rate, arguments, observer)


@renamed(rate="record_rate")
@checked
def simulate_extended(
    plant: Robot,
    controller: Controller,
    q: JointsLike,
    dq: JointsLike | None = None,
    *,
    atlas: Atlas,
    duration: float,
    method: Method | None = None,
    rtol: float = 1e-9,
    atol: float | None = None,
    record_rate: float = 100.0,
    task_force: TaskForce | None = None,
    observer: Observer | None = None,
) -> Result:
    """Motion as by `simulate`, integrated in w = (z, v); Eqs. (13), (30).

    The joints never appear as state: they are y(z, v) on the current chart. For a task on a Lie group, z is integrated
    in exponential coordinates about the chart's z_bar.

    Args:
        plant: The robot that moves.
        controller: The controller.
        q: Joints at the start, (n,), or some of them by name; others are as near 0 as their limits allow.
        dq: Joint velocities at the start, at rest by default.
        atlas: Charts whose coordinates are integrated.
        duration: Length of the run [s].
        method: Integrator of SciPy; by default LSODA, which takes half of the time, and DOP853 for tolerances below
            1e-10, which LSODA does not keep.
        rtol: Relative tolerance of the integrator.
        atol: Absolute tolerance; that of `rtol` by default.
        record_rate: Samples kept per second, besides the exact multiples of the reference's period.
        task_force: Force of the environment.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments.
        SingularError: The task is singular at the start.
    """
    system = ExtendedSystem(plant, controller, task_force, atlas)
    x = system.begin(*_state(plant, q, dq))
    arguments = {"kind": "extended", "method": method, "rtol": rtol, "atol": rtol if atol is None else atol}
    arguments["metric"] = metric_name(atlas.metric)
    return _integrate(system, x, duration, record_rate, arguments, observer)


def _integrate(
    system: System,
    x: Vector,
    duration: float,
    rate: float,
    arguments: dict[str, Any],
    observer: Observer | None,
) -> Result:
    """Integrate with a solver of SciPy, restarting it where a chart is left."""
    import scipy.integrate

    for name in ("rtol", "atol"):
        number(arguments[name], name, above=0.0)
    tight = min(arguments["rtol"], arguments["atol"]) < TIGHT
    method = arguments["method"] or ("DOP853" if tight else "LSODA")
    arguments = arguments | {"method": method}
    record = Recorder(system, sample_times(duration, rate, system.reference_period), arguments, observer)
    options = {"rtol": arguments["rtol"], "atol": arguments["atol"]}
    make = getattr(scipy.integrate, method)
    with record.until_it_ends(), np.errstate(over="ignore", invalid="ignore"):
        t = 0.0
        record.add(t, x)
        solver: Any = None
        shorter: float | None = None
        most = int(MOST_STEPS * (1.0 + duration))
        for _ in range(most):
            try:
                if solver is None:
                    if not np.isfinite(system.rhs(t, x)).all():
                        # With such a first step the solver would never come to an end.
                        raise Stop("integration_failed", f"torque or acceleration is not finite at t = {t:.4g} s")
                    solver = make(system.rhs, t, x, duration, first_step=shorter, **options)
                message = solver.step()
            except ChartError:
                # The trial points of a long step may lie where no chart is, though the motion never goes there.
                shorter = 0.25 * min(shorter or duration, getattr(solver, "h_abs", duration), duration - t)
                if shorter < SHORTEST_STEP:
                    raise
                solver = None
                continue
            x, shorter = solver.y, None
            if solver.status == "failed":
                raise Stop("integration_failed", f"the integrator gave up at t = {solver.t:.4g} s: {message}")
            _check_speed(system, solver.t, solver.y)
            margin = system.switch_function(solver.t, solver.y)
            expired = margin <= 0.0
            dense: Any = solver.dense_output() if expired or record.is_due(solver.t) else None
            end = _expired_at(system, solver, dense, margin) if expired else solver.t
            for sample in record.due(t, end):
                record.add(sample, dense(sample))
            t = end
            if expired:
                x = system.switch(t, dense(t))
                record.switches.append(t)
            if t >= duration:
                break
            if expired:
                solver = None
        else:
            raise Stop("stuck", f"the run took {most} steps and only came to t = {t:.4g} s; loosen rtol")
    return record.result()


def _expired_at(system: System, solver: Any, dense: Any, margin: float) -> float:
    """Time within the solver's last step at which the margin reaches zero; `margin` is that at the end of the step."""
    from scipy.optimize import brentq

    def left(t: float) -> float:
        # Near a singularity a margin computed once more may have the other sign.
        return system.switch_function(t, dense(t)) if t < solver.t else margin

    # A step begins with a margin that is left, just after a switch with one near 1.
    return float(brentq(left, solver.t_old, solver.t, xtol=1e-12)) if left(solver.t_old) > 0.0 else solver.t_old


def _check_speed(system: System, t: float, x: Vector) -> None:
    """End a run whose joints have run away, with the reason."""
    q, dq = system.joints(t, x)
    if dq.dot(dq) < TOO_FAST**2:
        return
    task = system.controller.task
    if task is not None and math.isfinite(x.dot(x)):
        values = np.linalg.svd(task._linearize(q)[1], compute_uv=False)
        if values[-1] < NEARLY_SINGULAR * values[0]:
            raise Stop(
                "singular",
                f"no bounded joint velocity follows the path at t = {t:.4g} s: it leads out of reach or through a "
                f"singularity of the task (singular values of its Jacobian from {values[-1]:.2g} to {values[0]:.2g}). "
                "Make the path smaller, or start elsewhere",
            )
    raise Stop(
        "diverged",
        f"the joints ran away at t = {t:.4g} s; lower the gains or the control period, make the path smaller, or use "
        "LimitedEosController",
    )


def _state(plant: Robot, q: JointsLike, dq: JointsLike | None) -> tuple[JointVector, JointVector]:
    rest = np.zeros(plant.n)
    dq = in_order(rest if dq is None else dq, plant.joint_names, rest, "dq at the start")
    return plant.posture(q, "q at the start"), dq
