"""Every kind of task on one arm: identities, derivatives, both equations of motion, and a plan.

    python benchmarks/tasks.py --robot panda

H [G'; Wᵀ] = I at random states of charts, the drift beside finite differences, runs of `simulate` beside those of
`simulate_extended`, the task error of a run in which the self-motion damps, and whether a short way is planned.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro

from eos_pin import (
    Atlas,
    AxisTask,
    Chart,
    ComTask,
    Damp,
    DistanceTask,
    EosController,
    Hold,
    JointTask,
    LookAtTask,
    OrientationTask,
    PointAxisTask,
    PoseTask,
    PositionTask,
    RelativePoseTask,
    RelativePositionTask,
    StackedTask,
    ToleranceTask,
    load_robot,
    plan,
    simulate,
    simulate_extended,
)
from eos_pin._arrays import JointVector
from eos_pin.errors import EosError
from eos_pin.experiments.defaults import rest_posture
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task

#: States, distance from the chart's base [rad], and step of differences [s].
STATES, AWAY, STEP = 20, 0.2, 1e-5
#: Length of a run [s] and of a step to its goal [m, rad].
DURATION, TO_GOAL = 0.5, 0.05


def kinds(robot: Robot, frame: str) -> Iterator[tuple[str, Task]]:
    """Tasks by name."""
    base, first, last = robot.model.frames[1].name, robot.joint_names[0], robot.joint_names[-1]
    yield "position", PositionTask(robot, frame)
    yield "position, two axes", PositionTask(robot, frame, "xz")
    yield "orientation", OrientationTask(robot, frame)
    yield "pose", PoseTask(robot, frame)
    yield "axis", AxisTask(robot, frame, "-x")
    yield "point with axis", PointAxisTask(robot, frame, (1.0, 2.0, -0.5))
    yield "look at", LookAtTask(robot, frame, (1.3, -0.4, 1.2), "x")
    yield "distance", DistanceTask(robot, frame, (0.4, -1.3, 0.7))
    yield "relative pose", RelativePoseTask(robot, frame, base)
    yield "relative position", RelativePositionTask(robot, frame, base)
    yield "joints", JointTask(robot, [{first: 1.0, last: -0.5}])
    yield "centre of mass", ComTask(robot)
    yield "pose with bands", ToleranceTask(PoseTask(robot, frame), {"rz": 0.2, "x": 0.01})
    yield "point with a cone", ToleranceTask(PointAxisTask(robot, frame), {"cone": 0.26})
    yield "stack", StackedTask([OrientationTask(robot, frame), PositionTask(robot, frame, "z")])


def measured(task: Task, q: JointVector) -> dict[str, object]:
    """Largest errors of one kind."""
    robot, random, worst = task.robot, np.random.default_rng(0), np.zeros(2)
    chart = Chart.from_base(task, q)
    for _ in range(STATES):
        at, dq = q + random.uniform(-AWAY, AWAY, robot.n), random.uniform(-1.0, 1.0, robot.n)
        point = chart.point(at, dq)
        ahead, behind = (task.at(at + sign * STEP * dq, dq).dz for sign in (1.0, -1.0))
        drift = (ahead - behind) / (2.0 * STEP)
        identity = np.abs(point.H @ np.vstack((point.task.J, chart.W.T)) - np.eye(robot.n)).max()
        worst = np.maximum(worst, (identity, np.abs(point.task.drift - drift).max()))
    goal = task.plus(task.value(q), np.full(task.m, TO_GOAL))
    law = Damp() if task.m < robot.n else None
    controller = EosController(task, Hold(goal, task.m), law)
    how = {"duration": DURATION, "rtol": 1e-11, "atol": 1e-12, "record_rate": 10.0}
    run = simulate(robot, controller, q, **how)  # type: ignore[arg-type]
    other = simulate_extended(robot, controller, q, atlas=Atlas(task), **how)  # type: ignore[arg-type]
    try:
        found = plan(task, [task.value(q), goal])
        planned = f"{found.info['task_error_max']:.1e}"
    except EosError as error:
        planned = str(error)
    return {
        "m": task.m, "identity": float(worst[0]), "drift": float(worst[1]),
        "both_equations": float(np.abs(run.q - other.q).max()), "plan": planned,
    }  # fmt: skip


def main(robot: str = "panda", out: Path | None = None) -> None:
    """Measure every kind of task.

    Args:
        robot: Name of the robot.
        out: File for the results.
    """
    arm = load_robot(robot, chain_to="auto")
    frame = str(arm.options["chain_to"])
    q, found = rest_posture(PoseTask(arm, frame)), {}
    for name, task in kinds(arm, frame):
        found[name] = measured(task, q)
        print(name, found[name], flush=True)
    if out is not None:
        out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
