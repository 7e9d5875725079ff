"""Runs of a sampled controller: the torque is held over each control period."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from eos_pin._arrays import (
    JointVector,
    VectorLike,
    broadcast,
    checked,
    number,
)
from eos_pin.control.base import Controller, agreed_period
from eos_pin.control.loop import ControlLoop
from eos_pin.errors import InputError, refuse_unused, renamed
from eos_pin.robot.model import Robot
from eos_pin.robot.postures import JointsLike
from eos_pin.simulation._recorder import Observer, Recorder, sample_times
from eos_pin.simulation._systems import JointSystem
from eos_pin.simulation.continuous import MOST_PERIODS, _check_speed, _state
from eos_pin.simulation.disturbances import Friction, SensorNoise, TaskForce
from eos_pin.simulation.result import Result

#: Control period where neither the run nor its controller has one [s].
CONTROL_PERIOD = 1e-3


@renamed(period="control_period", rate="record_rate")
@checked
def simulate_sampled(
    plant: Robot,
    controller: Controller,
    q: JointsLike,
    dq: JointsLike | None = None,
    *,
    duration: float,
    control_period: float | None = None,
    substeps: int = 1,
    noise: SensorNoise | None = None,
    delay: float = 0.0,
    dropout: float = 0.0,
    friction: Friction | None = None,
    torque_limits: bool | VectorLike = True,
    torque_rate: float | VectorLike | None = None,
    soft_start: float = 0.0,
    centred: bool = False,
    record_rate: float = 100.0,
    seed: int = 0,
    task_force: TaskForce | None = None,
    observer: Observer | None = None,
) -> Result:
    """Run a controller as a computer would: sampled, its torque held over each period.

    Args:
        plant: The robot that moves; it need not be the robot of the controller's model. A `MujocoPlant` steps itself.
        controller: The controller, called once a period.
        q: Joints at the start, (n,), or some of them by name; others are as near 0 as their limits allow.
        dq: Joint velocities at the start, at rest by default.
        duration: Length of the run [s].
        control_period: Control period [s]; by default the one that the controller is made for, or 1e-3.
        substeps: Steps of the plant in each period, by the Runge–Kutta method of order 4 or its own.
        noise: Errors of the measured state.
        delay: Age of the state that the controller sees [s], rounded to whole periods.
        dropout: Probability that the controller misses a period, and the torque of the last one stays.
        friction: Friction in the joints of the plant, which no controller models.
        torque_limits: Cut the torque: True at the plant's own limits, as `ControlLoop` does at the robot's, False for
            none, or limits of your own, (n,) [N m or N].
        torque_rate: Most that a torque changes in a second, one number or (n,), see `ControlLoop` [N m/s or N/s].
        soft_start: Time in which the torque goes over from that of gravity to the controller's [s].
        centred: Whether torques are those for the middle of the period, see `ControlLoop`.
        record_rate: Samples kept per second, besides the exact multiples of the reference's period.
        seed: Seed of the noise and the dropouts.
        task_force: Force of the environment.
        observer: Called with (t, q) of every sample.

    Raises:
        InputError: Wrong arguments, or another control period than the controller is made for.
        SingularError: The task is singular at the start.
    """
    q, dq = _state(plant, q, dq)
    period = agreed_period(controller, control_period) or CONTROL_PERIOD
    lag = round(number(delay, "the delay", at_least=0.0) / period)
    duration = number(duration, "the duration", above=0.0)
    if max(duration / period * substeps, lag) > MOST_PERIODS:
        raise InputError(
            f"{duration:g} s with a control period of {period:g} s, {substeps} substeps and a delay of {delay:g} s are "
            f"more than {MOST_PERIODS:,} steps; make the run or the delay shorter, or the period longer"
        )
    if substeps < 1 or substeps != int(substeps):
        raise InputError(f"substeps must be a whole number of at least 1, got {substeps}")
    if not 0.0 <= number(dropout, "the dropout") < 1.0:
        raise InputError(f"the dropout must be a probability, at least 0 and below 1, got {dropout}")
    if not noise and not dropout:
        refuse_unused(simulate_sampled, "nothing is random; add noise or dropout", seed=seed)
    random = np.random.default_rng(seed)
    system = JointSystem(plant, controller, task_force, friction)
    system.begin(q, dq)
    if not isinstance(torque_limits, bool):
        torque_limits = broadcast(torque_limits, plant.n, "the torque limits")
    limits = plant.effort if torque_limits is True else torque_limits
    loop = ControlLoop(
        controller,
        control_period=period if centred else None,
        torque_limits=limits,
        jump=math.inf,
        torque_rate=torque_rate,
        soft_start=soft_start,
        centred=centred,
    )
    arguments = {
        "kind": "sampled",
        "control_period": period,
        "substeps": substeps,
        "plant": type(plant).__name__,
        "integrator": getattr(plant, "integrator", "RK4"),
        "noise": [noise.q, noise.dq] if noise else None,
        "delay": lag * period,
        "dropout": float(dropout),
        "friction": None if friction is None else friction.describe(),
        "torque_limits": None if limits is False else np.broadcast_to(limits, plant.n).tolist(),
        "torque_rate": None if torque_rate is None else np.asarray(torque_rate, dtype=float).tolist(),
        "soft_start": float(soft_start),
        "centred": bool(centred),
        "seed": seed,
    }
    record = Recorder(system, sample_times(duration, record_rate, system.reference_period), arguments, observer)
    steps = max(1, math.ceil(duration / period - 1e-9))
    measured: deque[tuple[JointVector, JointVector]] = deque(maxlen=lag + 1)
    x = np.concatenate((q, dq, [0.0]))
    n = plant.n
    with record.until_it_ends(), np.errstate(over="ignore", invalid="ignore"):
        for k in range(steps):
            t, end = k * period, min((k + 1) * period, duration)
            state = x[:n].copy(), x[n : 2 * n].copy()
            if noise:
                state = (
                    state[0] + noise.q * random.normal(size=n),
                    state[1] + noise.dq * random.normal(size=n),
                )
            measured.append(state)
            if not (k and dropout) or random.random() >= dropout:
                tau = loop.step(t, *measured[0])
            if loop.state is not system.state:
                # A memory changes for other reasons, too.
                if k and controller._chart(loop.state) is not controller._chart(system.state):
                    record.switches.append(t)
                system.state = loop.state
            for sample in record.due(t, end):
                record.add(sample, system.advance(t, x, tau, sample - t, substeps) if sample > t else x, tau)
            x = system.advance(t, x, tau, end - t, substeps)
            _check_speed(system, end, x)
        record.add(duration, x, tau)
    return record.result()
