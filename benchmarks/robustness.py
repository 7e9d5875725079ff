"""What noise, delay, wrong models, limits, missed samples, pushes and friction do to control of Panda.

    python benchmarks/robustness.py [--quick] [--jobs 2] [--json FILE]

Each run is simulated at 1 kHz with held torques. The plant's friction and model error are unknown to the controllers;
all have the same gains and follow the same figure eight.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import joblib
import numpy as np
import tyro
from rich.progress import track

from eos_pin import (
    Controller,
    EosController,
    Friction,
    LimitedEosController,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Result,
    SensorNoise,
    Task,
    TaskForce,
    Trajectory,
    figure_eight,
    load_robot,
    simulate_sampled,
)
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.control.operational import BASELINES

POSTURE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
FRAME = "panda_hand_tcp"
#: Period of the figure eight, when the push begins and how long it lasts [s], its force [N].
PERIOD, PUSHED, LENGTH, FORCE = 4.0, 5.0, 0.2, np.array([0.0, 20.0, -20.0])
#: A disturbance is forgotten where the error is back at what it is in the last cycle, up to this much [m, rad].
FORGOTTEN = 1e-4

CONTROLLERS: Mapping[str, Callable[[Task, Trajectory], Controller]] = {
    "EOS": EosController,
    "limited": LimitedEosController,
    "posture": lambda task, path: BASELINES["null-space-posture"](task, path, POSTURE),
}


@dataclass(frozen=True)
class Scenario:
    """What is against the robot.

    Attributes:
        sampled: Arguments of `simulate_sampled`.
        model_error: Relative error of masses, centres of mass and inertias; the worst of some seeds is told.
        push: Whether the frame is pushed.
        offset: How far beside its start the path begins [m].
    """

    sampled: Mapping[str, Any] = field(default_factory=dict)
    model_error: float = 0.0
    push: bool = False
    offset: float = 0.0


JOINT_FRICTION = Friction(viscous=0.5, coulomb=0.5)
EVERYTHING: Mapping[str, Any] = {
    "noise": SensorNoise(1e-5, 1e-3),
    "delay": 2e-3,
    "dropout": 0.01,
    "friction": JOINT_FRICTION,
    "torque_limits": True,
}
SCENARIOS: Mapping[str, Scenario] = {
    "nothing": Scenario(),
    "noise 1e-5 rad": Scenario({"noise": SensorNoise(1e-5, 1e-3)}),
    "noise 1e-4 rad": Scenario({"noise": SensorNoise(1e-4, 1e-2)}),
    "delay 1 ms": Scenario({"delay": 1e-3}),
    "delay 2 ms": Scenario({"delay": 2e-3}),
    "delay 5 ms": Scenario({"delay": 5e-3}),
    "model 20 % off": Scenario(model_error=0.2),
    "start 0.3 m off": Scenario({"torque_limits": True}, offset=0.3),
    "1 % missed": Scenario({"dropout": 0.01}),
    "20 % missed": Scenario({"dropout": 0.2}),
    "push 28 N, 0.2 s": Scenario(push=True),
    "joint friction": Scenario({"friction": JOINT_FRICTION}),
    "all at once": Scenario(EVERYTHING, model_error=0.2, push=True),
}
QUICK = ("nothing", "delay 5 ms", "model 20 % off", "all at once")


@dataclass(frozen=True)
class Row:
    """What one controller made of one scenario.

    Attributes:
        task: Kind of the task.
        scenario: Name of the scenario.
        controller: Name of the controller.
        status: How the run ended.
        task_error_max: Largest task error after the first cycle [m, rad].
        recovery: Time after the push, or after the start beside the path, until it is forgotten [s].
        torque_max: Largest torque [N m].
        joint_drift: Largest change of a joint over the last cycle [rad].
        given_up: Time for which part of the task was given up [s].
    """

    task: str
    scenario: str
    controller: str
    status: str
    task_error_max: float
    recovery: float
    torque_max: float
    joint_drift: float
    task_deficit: float


def measure(kind: Literal["position", "pose"], name: str, controller: str, *, cycles: int, seeds: int) -> Row:
    """Run one controller in one scenario, and where the model is wrong take the worst of some models."""
    scenario = SCENARIOS[name]
    rows = [_measure(kind, name, controller, cycles, seed) for seed in range(seeds if scenario.model_error else 1)]
    return max(rows, key=lambda row: (row.status != "finished", row.task_error_max))


def _measure(kind: Literal["position", "pose"], name: str, controller: str, cycles: int, seed: int) -> Row:
    scenario = SCENARIOS[name]
    robot = load_robot("panda", chain_to=FRAME)
    task = PositionTask(robot, FRAME) if kind == "position" else PoseTask(robot, FRAME)
    z = task.value(POSTURE)
    path: Trajectory = figure_eight(z[:3] - (scenario.offset, 0.0, 0.0), 0.1, period=PERIOD, plane="yz")
    if kind == "pose":
        path = PoseTrajectory(path, pose=z)
    e = scenario.model_error
    push = TaskForce(PositionTask(robot, FRAME), lambda t: FORCE * (PUSHED <= t < PUSHED + LENGTH))
    result = simulate_sampled(
        robot.perturbed(mass=e, com=e, inertia=e, seed=seed) if e else robot,
        CONTROLLERS[controller](task, path),
        POSTURE,
        duration=cycles * PERIOD,
        task_force=push if scenario.push else None,
        seed=seed,
        **scenario.sampled,
    )
    summary = result.summary()
    since = PUSHED + LENGTH if scenario.push else 0.0 if scenario.offset else np.nan
    return Row(
        kind,
        name,
        controller,
        result.status,
        summary["task_error_max"],
        _recovery(result, since),
        summary["torque_max"],
        (summary["joint_drift_per_cycle"] or [np.nan])[-1],
        result.deficit_seconds,
    )


def _recovery(result: Result, since: float) -> float:
    """Time from `since` until the error is what it is in the last cycle; NaN where nothing happened."""
    size = np.linalg.norm(result.error, axis=1)
    usual = size[result.t >= result.t[-1] - PERIOD].max() + FORGOTTEN
    late = (result.t >= since) & (size > usual)
    if not since >= 0.0 or not result.cycles or since > result.t[-1] - PERIOD:
        return float("nan")
    return float(result.t[late][-1] - since) if late.any() else 0.0


def robustness(
    *,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    jobs: int = 1,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> int:
    """Control Panda against noise, delay, wrong models, limits, missed samples, pushes and friction.

    Args:
        quick: A few scenarios, and one wrong model instead of three.
        jobs: Processes that share the work.
        json_file: File for the figures.
    """
    calls = [
        joblib.delayed(measure)(kind, name, controller, cycles=3, seeds=1 if quick else 3)
        for kind in ("position", "pose")
        for name in (QUICK if quick else SCENARIOS)
        for controller in CONTROLLERS
    ]
    found = joblib.Parallel(n_jobs=jobs, return_as="generator")(calls)
    rows: list[Row] = list(track(found, "Simulating", total=len(calls), console=stderr, transient=True))
    for kind in ("position", "pose"):
        title = f"Panda, {kind}: error and drift in mm or mrad, torque in N m, times to forget and of giving up in s"
        columns = ("against it", "control", "status", "error", "forget", "torque", "drift", "given up")
        console.print(grid(title, columns, [_cells(row) for row in rows if row.task == kind]))
    if json_file is not None:
        write_json(json_file, {"rows": [asdict(row) for row in rows]})
    # The end of a run is a finding, but not one to overlook.
    return 0 if all(row.status in ("finished", "degraded") for row in rows) else 1


def _cells(row: Row) -> tuple[Any, ...]:
    error, drift = 1e3 * row.task_error_max, 1e3 * row.joint_drift
    return row.scenario, row.controller, row.status, error, row.recovery, row.torque_max, drift, row.task_deficit


if __name__ == "__main__":
    sys.exit(run(robustness))
