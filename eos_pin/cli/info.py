"""The command `eos-pin info`: a robot's properties, its abilities, and the reasons for those that it lacks."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eos_pin._arrays import Array, JointVector
from eos_pin.cli.output import (
    Output,
    console,
    format_number,
    grid,
    print_files,
    show,
    task_words,
    write_outputs,
)
from eos_pin.errors import EosError, InputError, SingularError
from eos_pin.experiments.options import PathOptions, RobotOptions, TaskOptions

# What the command needs beyond its options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.robot.model import Robot
    from eos_pin.tasks.base import Task


@dataclass
class Findings:
    """Abilities of a robot.

    Attributes:
        q: Joints to start from.
        task: The task, None where it does not fit the robot.
        z: Task point at the start.
        sigma: Singular values of G' at the start.
        coupling: Inertial coupling of task and self-motion by metric of the chart: at the start, and around it.
        cannot: Abilities that are missing, by `"task"`, `"chart"`, `"dynamics"` and `"path"`, and why.
    """

    q: JointVector
    task: Task | None = None
    z: Array | None = None
    sigma: Array = field(default_factory=lambda: np.zeros(0))
    coupling: dict[str, dict[str, float]] = field(default_factory=dict)
    cannot: dict[str, str] = field(default_factory=dict)


def info(robot: RobotOptions, task: TaskOptions = TaskOptions(), output: Output = Output()) -> int:
    """Describe a robot: joints, limits, frames, redundancy for a task, advice, and abilities that it lacks.

    For example:

      eos-pin info panda
      eos-pin info path/to/robot.urdf --frame tool0 --task pose
    """
    from eos_pin.control.overload import gravity_overload
    from eos_pin.robot.loading import leaf_frames

    output.without("csv", "bag", "rerun", reason="nothing moves here")
    files = output.within(None, names={"json": "info.json", "html": "robot.html", "plot": "robot.png"})
    machine = robot.load()
    found = _find_out(machine, task)
    goal, q = found.task, found.q
    source = "URDF text" if machine.source.lstrip().startswith("<") else machine.source
    title = f"{machine.name}: {machine.n} joints to {machine.options['chain_to']} ({source})"
    columns = ("joint", "kind", "lower", "upper", "velocity", "effort", "start")
    rows = [
        (joint.name, joint.kind, joint.lower, joint.upper, joint.velocity, joint.effort, f"{value:.3f}")
        for joint, value in zip(machine.joints, q, strict=True)
    ]
    console.print(grid(title, columns, rows, "Angles are in rad, lengths in m, times in s, efforts in N m or N."))
    lines = []
    if goal is not None:
        r = machine.n - goal.m
        lines.append(f"Task: {task_words(goal)}: m = {goal.m}, redundancy r = n - m = {r}")
        lines.append(f"Singular values of G' at the start: {', '.join(format_number(s) for s in found.sigma)}")
        lines += [_coupling_sentence(found.coupling)] if found.coupling else []
        lines += ["The task takes all joints (r = 0): there is no self-motion to command"] if r == 0 else []
    lines.append(f"Ends of branches: {', '.join(leaf_frames(machine))}")
    lines.append(f"All frames: {', '.join(machine.frames)}")
    lines += [f"Note: {note}" for note in (*machine.notes, *gravity_overload(machine, q))]
    words = {"task": "No such task", "chart": "Warning", "dynamics": "No dynamics, so no control", "path": "No path"}
    lines += [f"{words[kind]}: {reason}" for kind, reason in found.cannot.items()]
    lines += _advice(robot, task, found)
    for line in lines:
        console.print(line, markup=False)
    figures = {
        "robot": machine.name,
        "source": machine.source,
        "frame": machine.options["chain_to"],
        "n": machine.n,
        "m": None if goal is None else goal.m,
        "r": None if goal is None else machine.n - goal.m,
        "joints": [vars(joint) for joint in machine.joints],
        "start": q,
        "z": found.z,
        "singular_values": found.sigma,
        "coupling": found.coupling,
        "singular": found.cannot.get("chart", ""),
        "cannot": found.cannot,
        "frames": machine.frames,
        "leaf_frames": leaf_frames(machine),
        "notes": machine.notes,
    }
    print_files(_still(files, machine, goal, q, figures))
    return 0


def _find_out(robot: Robot, options: TaskOptions) -> Findings:
    """Try one thing after the other, from kinematics to a path; each failure is kept, and none ends it."""
    from eos_pin.charts.chart import Chart
    from eos_pin.experiments.coupling import coupling_around

    cannot: dict[str, str] = {}
    if robot.lacks_dynamics:
        cannot["dynamics"] = robot.lacks_dynamics
    try:
        task, q = options.make(robot, kept=True)
    except InputError as error:
        named = (
            options.q0
            or options.axes
            or options.combine
            or options.point
            or options.tolerance
            or options.further != "none"
            or options.further_path
        )
        if named or options.tool_axis != TaskOptions.tool_axis:
            # Asked for in so many words: a mistake in these is one of the caller.
            raise
        zero = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
        return Findings(zero, cannot={"task": str(error)} | cannot)
    z, J = task.linearize(q)
    found = Findings(q, task, z, np.linalg.svd(J, compute_uv=False), cannot=cannot)
    try:
        Chart.from_base(task, q)
    except SingularError as error:
        found.cannot = {"chart": str(error)} | cannot
        return found
    if task.m < robot.n and not robot.lacks_dynamics:
        for metric in ("identity", "inertial"):
            base, near = coupling_around(task, q, metric)
            found.coupling[metric] = {"start": base, "around": float(np.median(near)) if near else math.nan}
    try:
        PathOptions(path="eight" if "m" in task.units else "hold").make(task, q)
    except EosError as error:
        cannot["path"] = str(error)
    return found


def _coupling_sentence(coupling: dict[str, dict[str, float]]) -> str:
    """Sentence about the coupling with each metric."""
    words = (f"{found['start']:.2f} and {found['around']:.2f} with --metric {name}" for name, found in coupling.items())
    return f"Inertial coupling of task and self-motion at the start, and 0.3 rad or m around it: {', '.join(words)}"


def _advice(robot: RobotOptions, task: TaskOptions, found: Findings) -> list[str]:
    """Advice in a line; none where nothing can be done as asked."""
    words = command_words(robot, task)
    if found.task is None:
        return []
    words += "" if found.task.lengths else " --path hold"
    if "dynamics" in found.cannot:
        return [f"Try: eos-pin ik {command_words(robot, task)}", f"Try: eos-pin track {words} --command position"]
    return [f"Try: eos-pin track {words}"]


def command_words(robot: RobotOptions, task: TaskOptions) -> str:
    """Robot and task as arguments of a command, quoted for a shell."""
    words = [robot.robot]
    for options in (robot, task):
        for each in fields(options):
            value = getattr(options, each.name)
            if each.name == "robot" or value == each.default:
                continue
            values = value if isinstance(value, tuple) else (value,)
            words += ["--" + each.name.replace("_", "-"), *(str(item) for item in values)]
    return shlex.join(words)


def _still(files: Output, robot: Robot, task: Task | None, q: JointVector, figures: dict[str, Any]) -> list[Path]:
    """Files that show a robot at rest."""
    from eos_pin.simulation._recorder import joint_run
    from eos_pin.tasks.position import PositionTask

    # One axis fits any robot, and nothing moves.
    shown = PositionTask(robot, robot.options["chain_to"], "z") if task is None else task
    result = joint_run(shown, np.zeros(1), q[None], shown.value(q)[None])
    written = write_outputs(replace(files, out=None), result, robot, figures=figures)
    if files.view:
        show({"": result}, {"": robot})
    return written
