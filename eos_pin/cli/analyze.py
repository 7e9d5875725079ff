"""`eos-pin analyze`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from eos_pin.cli.output import Output, console, print_files, say_notes, stderr, write_outputs
from eos_pin.cli.tables import run_table
from eos_pin.errors import InputError
from eos_pin.experiments.options import RobotOptions, TaskOptions


@dataclass(frozen=True)
class NamedRobot(RobotOptions):
    """A robot that is given by name, as the log comes first on the command line."""

    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")] = ""


def analyze(
    log: tyro.conf.Positional[Path],
    robot: NamedRobot = NamedRobot(),
    task: TaskOptions = TaskOptions(),
    output: Output = Output(),
    period: float | None = None,
    joints: tuple[str, ...] = (),
    degrees: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    topic: str = "",
) -> int:
    """Analyze joints recorded elsewhere: task path, self-motion, drift in each round, and use of limits.

    Files go to runs/LOG-analysis unless --out is given: run.npz, summary.json, replay.html, overview.png.

    Args:
        log: Table (.csv) with a column t [s] and one for each joint by its name [rad or m]; q_NAME and dq_NAME, the
            columns of `eos-pin track --csv` and of `rehearse --log`, will do. Or the folder of a bag of ROS 2.
        robot: The robot that moved.
        task: Task whose motion counts.
        output: Results to keep.
        period: Time of one round [s]; by default it is found.
        joints: Names that the log has for the joints, in the robot's order; by default the robot's own.
        degrees: Angles are in degrees.
        topic: Topic of the joint states in a bag; by default the only one there is.

    For example:

      eos-pin analyze log.csv --robot ur5 --frame tool0
      eos-pin analyze bag --robot panda --topic /joint_states
      eos-pin analyze log.csv --robot robot.urdf --task pose --period 4 --degrees --json drift.json
    """
    if not robot.robot:
        raise InputError(f"whose joints are in {log}? Add --robot NAME, or the path of its URDF")
    if task.q0:
        raise InputError("--q0 does not apply: the log has the joints")
    if task.tolerance:
        raise InputError("--tolerance does not apply: every coordinate of the task counts here; leave it out")
    if task.further != "none" or task.further_path:
        raise InputError("--further and --further-path do not apply: the joints have moved already; leave them out")
    if output.view:
        raise InputError("--view does not apply: the run is over; its replay is --html FILE")
    from eos_pin.experiments.defaults import make_task
    from eos_pin.experiments.joint_logs import read_joint_log
    from eos_pin.simulation.analysis import analyze as analyzed

    names = {"json": "summary.json", "html": "replay.html", "plot": "overview.png"}
    files = output.within(Path("runs") / f"{log.stem}-analysis", names=names)
    machine = robot.load()
    say_notes(machine)
    goal = make_task(machine, task.task, axes=task.axes, **task.chosen(machine, task.task))
    read = read_joint_log(log, machine, joints=joints, degrees=degrees, topic=topic)
    say_notes(read)
    result = analyzed(goal, read.t, read.q, dq=read.dq, period=period, source=str(log))
    summary = result.summary()
    console.print(run_table(summary))
    if not math.isfinite(result.period):
        stderr.print("Note: no rounds were found; --period T gives the time of one.", soft_wrap=True)
    print_files(write_outputs(files, result, machine, figures=summary))
    return 0
