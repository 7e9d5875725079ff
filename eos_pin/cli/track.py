"""`eos-pin track` and `eos-pin compare`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from eos_pin.cli.follow import Planned, loaded_plan, made_plan, obstacles_in, repeat_note
from eos_pin.cli.output import (
    SeededOutput,
    console,
    print_files,
    print_runs,
    progress,
    say_notes,
    stderr,
    title_of,
    warn_of_gravity,
    write_outputs,
)
from eos_pin.cli.tables import run_table
from eos_pin.errors import InputError
from eos_pin.experiments.applicability import EOS
from eos_pin.experiments.commanded import commanded_loop, run_commanded
from eos_pin.experiments.options import (
    ControllerName,
    ControlOptions,
    MetricName,
    PathOptions,
    RobotOptions,
    RunOptions,
    TaskOptions,
    check_options,
)

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.simulation.result import Result


def track(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    path: PathOptions = PathOptions(),
    control: ControlOptions = ControlOptions(),
    simulation: RunOptions = RunOptions(),
    output: SeededOutput = SeededOutput(),
    plan: Path | None = None,
    scene: Path | None = None,
) -> int:
    """Make a robot follow a path under EOS control; print, save and replay the run.

    Files go to runs/ROBOT-TASK, or runs/ROBOT-PLAN, unless --out is given: run.npz, summary.json, replay.html,
    overview.png.

    Args:
        robot: The robot.
        task: Task of the robot.
        path: Path of the task.
        control: Controller and its gains.
        simulation: Simulation of the run.
        output: Results to keep.
        plan: Plan to follow (.npz), made by `eos-pin plan` for this robot; it has its own task and path.
        scene: File of solids to show in the replay, as `eos-pin plan` has it; the robot does not avoid them by itself.

    For example:

      eos-pin track panda
      eos-pin track panda --task pose --swing 0.5 --view
      eos-pin track path/to/robot.urdf --frame tool0 --path circle --size 0.1 --cycles 5
      eos-pin track panda --size 0.3 --path circle --self-motion planned
      eos-pin track panda --plan circle.npz
      eos-pin track ur5 --task point-axis --further orientation --command position
      eos-pin track ur5 --task point-axis --further orientation --further-path "0 0; 2 1; 4 0"
      eos-pin track ur5 --command position --control-rate 500
      eos-pin track panda --control-rate 1000 --noise 1e-5 --model-error 0.1 --torque-limits
    """
    check_options(task, path, control, simulation, seed=output.seed, plan=plan)
    names = {"json": "summary.json", "html": "replay.html", "plot": "overview.png"}
    folder = Path("runs") / f"{Path(robot.robot).stem}-{plan.stem if plan else task.task}"
    files = output.within(folder, names=names)
    machine = robot.load()
    say_notes(machine)
    solids = obstacles_in(scene)
    motion: Planned | None = None
    if plan is not None:
        frame = machine.options["chain_to"] if robot.frame or robot.tool is not None else None
        motion = loaded_plan(machine, plan, task.make(machine)[1] if task.q0 else None, control, frame)
        goal, reference, q = motion.task, motion.path, motion.q
    else:
        kept = control.self_motion == "planned" or control.controller in EOS
        goal, q = task.make(machine, kept=kept, led=True)
        reference = path.make(goal, q)
        if control.self_motion == "planned":
            motion = made_plan(goal, reference, q if task.q0 else None, control, output.seed)
            reference, q = motion.path, motion.q
    say_notes(reference, goal)
    law, further = motion.law if motion else None, task.make_further(machine, q)
    duration, period = path.length(reference), simulation.control_period
    torque = control.command == "torque"
    if torque:
        controller = control.make(goal, reference, q, period, law=law, further=further)
        warn_of_gravity(machine, q)
    else:
        loop = commanded_loop(control, goal, reference, q, period=period, law=law, further=further)
    name = f"{machine.name}, {task.task}"
    with progress(output, machine, q, duration, name, (goal, reference)) as observer:
        if torque:
            start = motion.dq if motion else None
            result = simulation.run(machine, controller, q, duration, seed=output.seed, observer=observer, dq=start)
        else:
            result = run_commanded(loop, q, duration, observer=observer)
    summary = result.summary()
    console.print(run_table(summary))
    note = "" if motion else repeat_note(machine, result, control.self_motion)
    if note:
        stderr.print(note, soft_wrap=True)
    print_files(write_outputs(files, result, machine, figures=summary, obstacles=solids))
    return 0 if result.ok else 1


def compare(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    path: PathOptions = PathOptions(),
    simulation: RunOptions = RunOptions(),
    output: SeededOutput = SeededOutput(),
    controllers: tuple[ControllerName, ...] = (
        "eos",
        "task-space",
        "null-space-damping",
        "null-space-posture",
        "set-point",
    ),
    metric: MetricName = "identity",
) -> int:
    """Compare EOS control with traditional controllers on the same robot and path: a table and a figure.

    Args:
        robot: The robot.
        task: Task of the robot.
        path: Path of the task.
        simulation: Simulation of the run.
        output: Results to keep.
        controllers: Which controllers; in the replay the first is solid and the others are ghosts.
        metric: Metric of the charts of those that have any.

    For example:

      eos-pin compare panda
      eos-pin compare panda --task pose --controllers eos null-space-posture --cycles 10
    """
    check_options(task, path, simulation, seed=output.seed)
    names = {"json": "summary.json", "html": "replay.html", "plot": "comparison.png"}
    files = output.within(Path("runs") / f"{Path(robot.robot).stem}-compare", names=names)
    if len(set(controllers)) < len(controllers):
        raise InputError(f"each controller is compared once, got {', '.join(controllers)}")
    if metric != "identity" and not {*controllers} & {*EOS, "impedance"}:
        raise InputError(f"--metric {metric} does not apply: no controller here has charts; add eos")
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    reference = path.make(goal, q)
    say_notes(reference, goal)
    duration = path.length(reference)
    results: dict[str, Result] = {}
    for kind in controllers:
        controller = ControlOptions(kind, metric=metric).make(goal, reference, q, simulation.control_period)
        name = f"{machine.name}: {kind}"
        with progress(output, machine, q, duration, name, (goal, reference)) as observer:
            results[kind] = simulation.run(machine, controller, q, duration, seed=output.seed, observer=observer)
    summaries = {name: result.summary() for name, result in results.items()}
    print_runs(title_of(machine, goal), "controller", summaries)
    from eos_pin.plots import pages as plots

    written = [result.save(files.out / f"{name}.npz") for name, result in results.items() if files.out]
    first, wanted = results[controllers[0]], replace(files, out=None)
    plot, shown = plots.comparison(results), {name: run for name, run in results.items() if len(run.t)}
    print_files(written + write_outputs(wanted, first, machine, figures=summaries, plot=plot, runs=shown))
    return 0 if first.ok else 1
