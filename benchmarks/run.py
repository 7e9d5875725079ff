"""How long a control step, an inverse-kinematics solve and a whole run take.

    python benchmarks/run.py [--quick] [--json FILE]

One thread, CPU time, interleaved rounds, medians; what counts are ratios to the bare Pinocchio calls measured in the
same run. Before anything is timed, results are checked.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio as pin
import tyro

from eos_pin import (
    BASELINES,
    Chart,
    ControlLoop,
    EosController,
    Hold,
    PoseTask,
    PositionTask,
    StackedTrajectory,
    Task,
    Trajectory,
    figure_eight,
    load_robot,
    simulate,
)
from eos_pin.cli import run
from eos_pin.report import console, grid

POSTURE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])


@dataclass(frozen=True)
class Case:
    """Something to time.

    Attributes:
        name: What it is.
        call: One repetition.
        repeats: Repetitions in one round.
    """

    name: str
    call: Callable[[], object]
    repeats: int


def cases() -> list[Case]:
    """Everything that is timed, checked first."""
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    found = []
    rng = np.random.default_rng(0)
    q, dq = POSTURE + 0.02 * rng.normal(size=7), 0.1 * rng.normal(size=7)
    model, data = robot.model, robot.model.createData()
    frame, rest = robot.frame_id("panda_hand_tcp"), np.zeros(7)

    def bare() -> None:
        """The Pinocchio calls that any torque control of a frame needs."""
        pin.forwardKinematics(model, data, q, dq, rest)
        pin.computeJointJacobians(model, data)
        pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacement(model, data, frame)
        pin.rnea(model, data, q, dq, rest)

    found.append(Case("bare Pinocchio calls of a step", bare, 2000))
    for task in (PositionTask(robot, "panda_hand_tcp"), PoseTask(robot, "panda_hand_tcp")):
        found += _control(task, q, dq) + _inverse(task)
    return found


def _control(task: Task, q: np.ndarray, dq: np.ndarray) -> list[Case]:
    kind, path = task.kind, _path(task)
    controller = EosController(task, path)
    loop = ControlLoop(controller)
    traditional = ControlLoop(BASELINES["null-space-posture"](task, path, POSTURE))
    for some in (loop, traditional):
        some.step(0.0, POSTURE, 0.0 * dq)
    # The short form is the paper's M(H F* + E) − R.
    chart = loop.memory.chart
    point = chart.point(q, dq)
    F = np.concatenate(
        (controller.task_acceleration(0.1, point.task), controller.self_motion.acceleration(0.1, q, dq, chart))
    )
    long = task.robot.mass(q) @ (point.H @ F + point.E) + task.robot.bias(q, dq)
    assert np.abs(loop.step(0.1, q, dq) - long).max() < 1e-10
    return [
        Case(f"{kind}: EOS control step", lambda: loop.step(0.1, q, dq), 1000),
        Case(f"{kind}: traditional control step, posture", lambda: traditional.step(0.1, q, dq), 500),
    ]


def _inverse(task: Task) -> list[Case]:
    chart = Chart.at(task, POSTURE)
    far, near = np.zeros(task.m), np.zeros(task.m)
    far[:3], near[:3] = 0.1 / np.sqrt(3.0), 0.001 / np.sqrt(3.0)
    z_far, z_near = task.plus(chart.z_bar, far), task.plus(chart.z_bar, near)
    for z in (z_far, z_near):
        assert np.abs(task.minus(task.value(chart.inverse(z, chart.v_bar).q), z)).max() < 1e-10
    return [
        Case(f"{task.kind}: IK from 0.1 m away to 1e-10", lambda: chart.inverse(z_far, chart.v_bar), 300),
        Case(
            f"{task.kind}: IK from 1 mm away, constant B",
            lambda: chart.inverse(z_near, chart.v_bar, refresh=False),
            500,
        ),
        Case(f"{task.kind}: new chart", lambda: Chart.at(task, POSTURE, previous=chart), 200),
    ]


def _path(task: Task) -> Trajectory:
    z = task.value(POSTURE)
    eight = figure_eight(z[:3], 0.1, period=4.0, plane="yz")
    return eight if z.size == 3 else StackedTrajectory((eight, Hold(z[3:], 3)))


def runs() -> dict[str, float]:
    """CPU seconds of 10 s under EOS control, continuous at 1e-9."""
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    seconds = {}
    for task in (PositionTask(robot, "panda_hand_tcp"), PoseTask(robot, "panda_hand_tcp")):
        result = simulate(robot, EosController(task, _path(task)), POSTURE, duration=10.0)
        assert result.ok
        assert result.summary()["task_error_max"] < 1e-6
        seconds[f"{task.kind}: continuous run of 10 s at 1e-9"] = float(result.info["cpu_seconds"])
    return seconds


def benchmark(
    *,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> int:
    """Time control steps, inverse kinematics and whole runs on Panda.

    Args:
        quick: Fewer rounds.
        json_file: File for the figures.
    """
    rounds = 5 if quick else 25
    timed = cases()
    spent: dict[str, list[float]] = {case.name: [] for case in timed}
    for _ in range(rounds):
        for case in timed:
            start = time.process_time()
            for _ in range(case.repeats):
                case.call()
            spent[case.name].append(1e6 * (time.process_time() - start) / case.repeats)
    whole = [runs() for _ in range(2 if quick else 5)]
    bare = np.median(spent[timed[0].name])
    rows = [
        (name, float(np.median(t)), float(np.min(t)), float(np.max(t)), float(np.median(t) / bare))
        for name, t in spent.items()
    ]
    console.print(grid("Panda, one thread", ("what", "median, µs", "least", "most", "× bare"), rows))
    seconds = [(name, float(np.median([run[name] for run in whole]))) for name in whole[0]]
    console.print(grid("Whole runs", ("what", "CPU seconds"), seconds))
    if json_file is not None:
        figures = {"microseconds": {row[0]: row[1] for row in rows}, "seconds": dict(seconds)}
        json_file.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(run(benchmark))
