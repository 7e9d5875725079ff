"""The command line: `eos-pin`, and the `run` that every script shares."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from eos_pin.arrays import vector
from eos_pin.describing import info
from eos_pin.errors import EosError, InputError
from eos_pin.files import write_csv
from eos_pin.library import available_robots
from eos_pin.options import (
    ControllerName,
    ControlOptions,
    PathOptions,
    RobotOptions,
    RunOptions,
    TaskOptions,
    check_options,
)
from eos_pin.report import (
    Output,
    console,
    deliver,
    figure,
    grid,
    guarded,
    run_table,
    say_files,
    say_notes,
    scene_of,
    show,
    stderr,
    warn_of_gravity,
    watched,
    write_json,
)
from eos_pin.sweeping import sweep

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.atlas import JointPath
    from eos_pin.results import Result


def track(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    path: PathOptions = PathOptions(),
    control: ControlOptions = ControlOptions(),
    simulation: RunOptions = RunOptions(),
    output: Output = Output(),
) -> int:
    """Make a robot follow a path under EOS control; print, save and replay what happened.

    Files go to runs/ROBOT-TASK unless --out says otherwise: run.npz, summary.json, replay.html, overview.png.

    For example:

      eos-pin track panda
      eos-pin track panda --task pose --swing 0.5 --view
      eos-pin track path/to/robot.urdf --frame tool0 --path circle --size 0.1 --cycles 5
      eos-pin track panda --rate 1000 --noise 1e-5 --model-error 0.1 --torque-limits
    """
    check_options(path, control, simulation, seed=output.seed)
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    reference = path.make(goal, q)
    say_notes(reference)
    controller = control.make(goal, reference, q, simulation.period)
    duration = path.length(reference)
    warn_of_gravity(machine, q)
    with watched(output, machine, q, duration, f"{machine.name}, {task.task}") as observer:
        result = simulation.run(machine, controller, q, duration, seed=output.seed, observer=observer)
    names = {"json": "summary.json", "html": "replay.html", "plot": "overview.png"}
    files = output.within(Path("runs") / f"{Path(robot.robot).stem}-{task.task}", names=names)
    console.print(run_table(result.summary()))
    say_files(deliver(files, result, machine))
    return 0 if result.ok else 1


def compare(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    path: PathOptions = PathOptions(),
    simulation: RunOptions = RunOptions(),
    output: Output = Output(),
    controllers: tuple[ControllerName, ...] = (
        "eos",
        "task-space",
        "null-space-damping",
        "null-space-posture",
        "set-point",
    ),
) -> int:
    """Compare EOS control with traditional controllers on the same robot and path: a table and a figure.

    Args:
        robot: Which robot.
        task: What the robot must do.
        path: Where it should go.
        simulation: How it is simulated.
        output: What to keep.
        controllers: Which controllers, the first one in the replay.

    For example:

      eos-pin compare panda
      eos-pin compare panda --task pose --controllers eos null-space-posture --cycles 10
    """
    check_options(path, simulation, seed=output.seed)
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    reference = path.make(goal, q)
    say_notes(reference)
    duration = path.length(reference)
    results: dict[str, Result] = {}
    for kind in controllers:
        controller = ControlOptions(kind).make(goal, reference, q, simulation.period)
        with watched(output, machine, q, duration, f"{machine.name}: {kind}") as observer:
            results[kind] = simulation.run(machine, controller, q, duration, seed=output.seed, observer=observer)
    summaries = {name: result.summary() for name, result in results.items()}
    rows = []
    for name, summary in summaries.items():
        drift = summary["joint_drift_per_cycle"] or [np.nan]
        quantities = (
            summary["task_error_max"],
            drift[0],
            drift[-1],
            summary["kinetic_energy_mean"],
            summary["torque_max"],
            summary["limit_ratio_max"],
        )
        rows.append((name, summary["status"], *quantities))
    columns = (
        "controller",
        "status",
        "task error",
        "first drift",
        "last drift",
        "mean energy",
        "max torque",
        "of limits",
    )
    console.print(grid(f"{machine.name}: {goal!r}", columns, rows))
    for name, summary in summaries.items():
        if summary["message"]:
            console.print(f"{name}: {summary['message']}", markup=False)
        if summary["limits"]["passed"]:
            console.print(f"{name}: limits {summary['limits']['told']}", markup=False)
    names = {"json": "summary.json", "plot": "comparison.png"}
    files = output.within(Path("runs") / f"{Path(robot.robot).stem}-compare", names=names)
    from eos_pin import plots

    written = [result.save(files.out / f"{name}.npz") for name, result in results.items() if files.out]
    first, wanted = results[controllers[0]], replace(files, out=None)
    say_files(written + deliver(wanted, first, machine, figures=summaries, plot=plots.comparison(results)))
    return 0 if first.ok else 1


def ik(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    output: Output = Output(),
    to: tuple[float, ...] = (),
    v: tuple[float, ...] = (),
    path: Path | None = None,
) -> int:
    """Find joints for a task point and self-motion coordinates, or along a path.

    To a point the robot walks on a straight line. Where it cannot, or would end beyond its joint limits, it makes a
    detour or, unless v is given, jumps to other joints; which of these is printed.

    Args:
        robot: Which robot.
        task: What the robot must do; q0 is where v is 0 and the search starts.
        output: What to keep.
        to: Task point; by default that at q0. As many numbers as the task has axes, such as x y z [m]; for a pose x y z
            (the orientation stays), x y z roll pitch yaw [rad], x y z qx qy qz qw, or x y z and the rotation matrix row
            by row; for an orientation these without x y z. In a CSV file the names of the columns say which is which.
        v: Self-motion coordinates [rad or m]; by default 0, the value at q0.
        path: CSV file to follow instead of one point, as that of `eos-pin track`.

    For example:

      eos-pin ik panda --to 0.4 0.1 0.5
      eos-pin ik panda --task pose --to 0.4 0.1 0.5 3.14 0 0 --v 0.3 --view
      eos-pin ik panda --task pose --path poses.csv --csv joints.csv
    """
    from eos_pin.atlas import Atlas
    from eos_pin.pathfiles import path_from_csv, points_along, task_point
    from eos_pin.recording import joint_run

    output.without("seed", reason="nothing is random here")
    if to and path is not None:
        raise InputError("--to and --path exclude each other: joints are found for one point, or along a path")
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    v_goal = vector(v, machine.n - goal.m, "v") if v else None
    found: JointPath | None
    if path is not None:
        curve = path_from_csv(path, goal, q)
        say_notes(curve)
        times = points_along(curve)
        found = Atlas(goal).follow(q, [curve(t).z for t in times.tolist()], v=v_goal)
        residual, message, way, joints = found.residual, found.message, "path", found.q
    else:
        z = task_point(goal, to, q) if to else goal.value(q)
        reached = Atlas(goal).reach(q, z, v=v_goal, points=100)
        residual, message, way, found = reached.residual, reached.message, reached.way, reached.path
        # Of a jump only the end counts.
        joints = np.linspace(q, reached.q, 101) if found is None else found.q
        times = np.linspace(0.0, 1.0, len(joints))
    times, end = times[: len(joints)], joints[-1] if len(joints) else q
    figures = {
        "status": "unreached" if message else "finished",
        "message": message,
        "way": way,
        "joints": [joint.name for joint in machine.joints],
        "q": end,
        "task_error_max": residual,
        "charts": len(found.charts) if found else 0,
    }
    rows = [
        (joint.name, f"{value:.6f}", joint.lower, joint.upper) for joint, value in zip(machine.joints, end, strict=True)
    ]
    console.print(grid(f"{machine.name}: {goal!r}", ("joint", "value", "lower", "upper"), rows))
    console.print(f"{way}, {figures['charts']} charts, task error {figure(residual)}")
    if message:
        stderr.print(f"not reached: {message}", markup=False)
    elif way == "jump":
        stderr.print("These joints are not connected to q0 through charts: v starts anew there.")
    outside = (joints < machine.lower) | (joints > machine.upper)
    if outside.any() and way != "jump":
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
    written += deliver(replace(output, csv=None), result, machine, figures=figures)
    if output.view:
        show(scene_of(result, machine), result)
    say_files(written)
    return 1 if message else 0


def replay(run: tyro.conf.Positional[Path], output: Output = Output(), robot: str = "") -> int:
    """Show a saved run in the browser, or write it as HTML, figure, table or JSON.

    Args:
        run: The .npz file that `eos-pin track` wrote.
        output: What to make of it; by default it is shown in the browser.
        robot: URDF file or name of the robot, where that of the run has moved. Only replays need it.

    For example:

      eos-pin replay runs/panda-position/run.npz
      eos-pin replay runs/panda-position/run.npz --html panda.html --plot panda.pdf
    """
    output.without("seed", reason="the run is over")
    from eos_pin.results import Result

    result = Result.load(run)
    plant, missing = None, ""
    try:
        plant = result.load_plant(robot)
        say_notes(plant)
    except EosError as error:
        if robot:
            raise
        missing = str(error)
    console.print(run_table(result.summary()))
    files = output.within(None, names={"html": "replay.html", "plot": "overview.png", "json": "summary.json"})
    written = deliver(replace(files, out=None), result, plant)
    say_files(written)
    if plant is None and (files.html or output.view or not written):
        raise InputError(
            f"there is no replay without the robot: {missing.rstrip('. ')}. Give its URDF with --robot FILE; --csv, "
            "--json and --plot work without"
        )
    if plant is not None and (output.view or not written):
        show(scene_of(result, plant), result)
    return 0


def robots(name: tyro.conf.Positional[str] = "", output: Output = Output()) -> int:
    """List the robots that can be loaded by name.

    Args:
        name: Part of the names to list; all by default.
        output: Only --json and --out apply: nothing moves here.

    For example:

      eos-pin robots
      eos-pin robots panda
    """
    output.without("seed", reason="nothing is random here")
    if output.html or output.plot or output.csv or output.view:
        raise InputError("a list of robots cannot be drawn; try `eos-pin info ROBOT --html FILE`")
    found = [robot for robot in available_robots() if name.lower() in robot.name.lower()]
    if not found:
        raise InputError(f"no robot's name contains {name!r}; `eos-pin robots` lists all")
    console.print(grid("", ("name", "file"), [(robot.name, robot.path.name) for robot in found]))
    files = output.within(None, names={"json": "robots.json"})
    if files.json:
        say_files([write_json(files.json, {"robots": [{"name": r.name, "path": r.path} for r in found]})])
    return 0


def run(command: Callable[..., int], argv: Sequence[str] | None = None) -> int:
    """Parse arguments, run a command, and turn what went wrong into one paragraph and an exit code.

    Returns:
        0, 1 for a run that failed, 2 for bad input, 130 for an interrupt.
    """
    return guarded(lambda: tyro.cli(command, args=argv, config=_STYLE))


def main(argv: Sequence[str] | None = None) -> int:
    """The command `eos-pin`."""
    if list(sys.argv[1:] if argv is None else argv) == ["--version"]:
        console.print(f"eos-pin {version('eos-pin')}")
        return 0
    commands = {f.__name__: f for f in (track, compare, sweep, info, ik, replay, robots)}
    return guarded(
        lambda: tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="eos-pin",
            description="Extended operational space control of redundant robots, on any URDF.",
            args=argv,
            config=(*_STYLE, tyro.conf.PositionalRequiredArgs, tyro.conf.FlagCreatePairsOff),
        )
    )


_STYLE = (tyro.conf.OmitArgPrefixes,)


if __name__ == "__main__":
    sys.exit(main())
