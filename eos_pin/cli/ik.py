"""`eos-pin ik`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eos_pin._arrays import vector
from eos_pin._files import write_csv
from eos_pin.cli.output import (
    Output,
    console,
    format_number,
    grid,
    print_files,
    say_notes,
    show,
    stderr,
    title_of,
    write_outputs,
)
from eos_pin.errors import InputError
from eos_pin.experiments.options import (
    MetricName,
    RobotOptions,
    TaskOptions,
)

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.charts.solutions import JointPath


def ik(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    output: Output = Output(),
    to: tuple[float, ...] = (),
    v: tuple[float, ...] = (),
    path: Path | None = None,
    metric: MetricName = "identity",
) -> int:
    """Find joints for a task point and self-motion coordinates, or along a path.

    A point is first approached along the straight line in task and self-motion (continuation). Where that fails, or
    would end beyond the joint limits, continuation goes via other points or, unless v is given, other joints are
    searched for; the strategy that succeeded is printed.

    Args:
        robot: The robot.
        task: Task of the robot; at q0 v is 0 and the search starts.
        output: Results to keep.
        to: Task point; by default that at q0. As many numbers as the task has axes, such as x y z [m]; for a pose x y z
            (the orientation stays), x y z roll pitch yaw [rad], x y z qx qy qz qw, or x y z and the rotation matrix row
            by row; for an orientation these without x y z. In a CSV file the columns are found by their names.
        v: Self-motion coordinates [rad or m]; by default 0, the value at q0.
        path: CSV file to follow instead of one point, as that of `eos-pin track`.
        metric: Metric of the charts in which v is counted, as that of `eos-pin track`.

    For example:

      eos-pin ik panda --to 0.4 0.1 0.5
      eos-pin ik panda --task pose --to 0.4 0.1 0.5 3.14 0 0 --v 0.3 --view
      eos-pin ik panda --task pose --path poses.csv --csv joints.csv
    """
    from eos_pin.charts.atlas import Atlas
    from eos_pin.experiments.path_files import path_from_csv, points_along, task_point
    from eos_pin.simulation._recorder import joint_run

    output.within(None, names={})
    if to and path is not None:
        raise InputError("--to and --path exclude each other: joints are found for one point, or along a path")
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    say_notes(goal)
    if goal.m == machine.n and (v or metric != "identity"):
        option = "--v" if v else f"--metric {metric}"
        raise InputError(f"{option} does not apply: the task takes all joints (r = 0), there is no self-motion")
    v_goal = vector(v, machine.n - goal.m, "v") if v else None
    found: JointPath | None
    if path is not None:
        curve = path_from_csv(path, goal, q)
        say_notes(curve)
        times = points_along(curve)
        found = Atlas(goal, metric=metric).follow(q, [curve(t).z for t in times.tolist()], v=v_goal)
        residual, message, strategy, joints = found.residual, found.message, "path", found.q
    else:
        z = task_point(goal, to, q) if to else goal.value(q)
        reached = Atlas(goal, metric=metric).solve(q, z, v=v_goal, points=100)
        residual, message, strategy, found = reached.residual, reached.message, reached.strategy, reached.path
        # Of a search only the end counts.
        joints = np.linspace(q, reached.q, 101) if found is None else found.q
        times = np.linspace(0.0, 1.0, len(joints))
    times, end = times[: len(joints)], joints[-1] if len(joints) else q
    figures = {
        "status": "unreached" if message else "finished",
        "message": message,
        "strategy": strategy,
        "joints": [joint.name for joint in machine.joints],
        "q": end,
        "task_error_max": residual,
        "charts": len(found.charts) if found else 0,
    }
    rows = [
        (joint.name, f"{value:.6f}", joint.lower, joint.upper) for joint, value in zip(machine.joints, end, strict=True)
    ]
    console.print(grid(title_of(machine, goal), ("joint", "value", "lower", "upper"), rows))
    charts = f"{len(found.charts)} chart{'s' * (len(found.charts) != 1)}, " if found else ""
    console.print(f"{strategy}, {charts}task error {format_number(residual)}")
    if message:
        stderr.print(f"not reached: {message}", markup=False)
    elif strategy == "search":
        stderr.print("These joints are not connected to q0 through charts: v starts anew there.")
    outside = (joints < machine.lower) | (joints > machine.upper)
    if outside.any() and strategy != "search":
        names = [machine.joints[i].name for i in np.flatnonzero(outside.any(axis=0))]
        where = "at the end" if outside[-1].any() else "on the way"
        stderr.print(f"{', '.join(names)} exceeds its limits {where}; try another v or q0.")
    written = []
    if output.csv is not None:
        names = ["t", *(joint.name for joint in machine.joints)]
        write_csv(output.csv, names, np.column_stack((times, joints)).tolist())
        written.append(output.csv)
    if found:
        result = joint_run(goal, times, joints, found.z, v=found.v, chart=found.chart, message=message)
    else:
        result = joint_run(goal, times, joints, np.array([goal.value(row) for row in joints]), message=message)
    written += write_outputs(replace(output, csv=None), result, machine, figures=figures)
    if output.view:
        show({"": result}, {"": machine})
    print_files(written)
    return 1 if message else 0
