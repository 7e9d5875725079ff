"""The command `eos-pin sweep`: many runs, one table, one figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import numpy as np
import tyro
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from tyro.constructors import PrimitiveConstructorSpec

from eos_pin._arrays import number
from eos_pin._files import check_writable
from eos_pin.cli.output import (
    console,
    grid,
    print_files,
    stderr,
    write_json,
)
from eos_pin.errors import InputError
from eos_pin.experiments.options import (
    ControlOptions,
    PathOptions,
    RobotOptions,
    RunOptions,
    TaskOptions,
)

if TYPE_CHECKING:
    from eos_pin.experiments.trial import Row, Trial


def commas(kind: Callable[[str], Any], name: str, none: str = "chosen") -> PrimitiveConstructorSpec[tuple[Any, ...]]:
    """Reader of several values with commas between, for the command line, with a word for none of them."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{name}[,{name}...]",
        instance_from_str=lambda words: tuple(kind(word) for word in words[0].split(",")),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda values: [",".join(map(str, values)) or none],
    )


Numbers: TypeAlias = Annotated[tuple[float, ...], commas(float, "FLOAT")]
Words: TypeAlias = Annotated[tuple[str, ...], commas(str, "NAME")]


#: Words for the columns of the table.
KEY = (
    "Of the runs of a line the largest: errors and the last drift of a joint in m or rad, torques in N m or N, and the "
    "part of a limit that is used."
)


@dataclass(frozen=True)
class SweepAxes:
    """Settings that differ from run to run: each takes one value or several, with commas between.

    Attributes:
        task: Kind of task: position, pose, orientation, heading or com.
        path: eight, circle, line, hold, or CSV files.
        size: Half width or radius [m]; by default as large as the robot can follow.
        period: Time of one round [s]; by default as short as the joints' velocity limits allow, from 4 s.
        controller: eos, eos-limited, or a traditional one; see `eos-pin track --help`.
        self_motion: Objective of the self-motion: hold, posture, damp, energy or free.
        swing: Amplitude of a sine that v's first coordinate follows [rad or m].
        kp: Gain on the task error [1/s²].
        kd: Gain on the task's velocity error [1/s].
        kp_self_motion: Gain on the self-motion error [1/s²].
        kd_self_motion: Gain on the self-motion's velocity error [1/s].
        chart_margin: A chart is left where its margin falls to this, between 0 and 1.
        metric: Metric of the charts, identity or inertial.
        payload: Mass carried at the frame [kg].
        control_rate: Control periods per second; by default the run is continuous [Hz].
        noise: Standard deviation of measured joints [rad or m], and of measured velocities ten times that per second.
        delay: Age of the state the controller sees [s].
        model_error: Largest relative error of masses, centres of mass and inertias in the controller's model.
    """

    task: Words = (TaskOptions.task,)
    path: Words = (PathOptions.path,)
    size: Numbers = ()
    period: Numbers = ()
    controller: Words = (ControlOptions.controller,)
    self_motion: Words = (ControlOptions.self_motion,)
    swing: Numbers = (ControlOptions.swing,)
    kp: Numbers = (ControlOptions.kp,)
    kd: Numbers = (ControlOptions.kd,)
    kp_self_motion: Numbers = (ControlOptions.kp_self_motion,)
    kd_self_motion: Numbers = (ControlOptions.kd_self_motion,)
    chart_margin: Numbers = (ControlOptions.chart_margin,)
    metric: Words = (ControlOptions.metric,)
    payload: Numbers = (RobotOptions.payload,)
    control_rate: Numbers = ()
    noise: Numbers = (RunOptions.noise,)
    delay: Numbers = (RunOptions.delay,)
    model_error: Numbers = (RunOptions.model_error,)


@dataclass(frozen=True)
class SweepFixed:
    """Settings that are the same in all runs.

    Attributes:
        frame: Frame that does the task; by default the tip. Joints that are not between base and frame are locked.
        axes: Axes that count, such as xy; by default all along which the frame can move.
        gravity: Acceleration of gravity [m/s²].
        cycles: Rounds to run.
        duration: Length of the runs [s], instead of rounds.
        plant: Simulator: our own equations of motion, or MuJoCo.
        torque_limits: Clip torques at the robot's limits.
    """

    frame: str = ""
    axes: str = ""
    gravity: tuple[float, float, float] | None = None
    cycles: int = 3
    duration: float | None = None
    plant: Literal["pinocchio", "mujoco"] = "pinocchio"
    torque_limits: bool = False


@dataclass(frozen=True)
class SweepOutput:
    """Files to keep.

    Attributes:
        out: Folder of all files. Finished runs are in its folder `finished`, and are not computed again.
        table: File for the table, .csv or .parquet; by default runs.csv.
        plot: File for the figure (.png, .pdf or .svg); by default sweep.png.
        json: File for the table as JSON.
    """

    out: Path = Path("runs/sweep")
    table: Path | None = None
    plot: Path | None = None
    json: Path | None = None


def sweep(
    robot: tyro.conf.Positional[tuple[str, ...]] = (),
    swept: SweepAxes = SweepAxes(),
    same: SweepFixed = SweepFixed(),
    kept: SweepOutput = SweepOutput(),
    seeds: int = 1,
    jobs: int = -1,
) -> int:
    """Run every combination of several robots, tasks, gains, errors and seeds: one table and one figure.

    What is finished is kept: the same command after an interrupt goes on where it was.

    Args:
        robot: Names or paths of URDF files.
        swept: Settings that differ from run to run.
        same: Settings that are the same in all runs.
        kept: Files to keep.
        seeds: Runs of each combination, with seeds 0, 1, …
        jobs: Runs at the same time; by default one for each core.

    For example:

      eos-pin sweep panda xarm7 --kp 50,100 --model-error 0,0.2 --seeds 5
      eos-pin sweep panda --controller eos,null-space-posture --control-rate 200,500,1000 --jobs 2 --out runs/rates
    """
    from eos_pin.experiments import sweeps
    from eos_pin.experiments.trial import trials
    from eos_pin.plots import pages as plots

    number(seeds, "the number of seeds", at_least=1)
    check_writable(*filter(None, (kept.out, kept.table, kept.plot, kept.json)))
    axes: dict[str, Sequence[Any]] = {"robot": robot} | {name: values for name, values in vars(swept).items() if values}
    axes |= {"seed": range(seeds)}
    _check(axes, vars(same))
    planned = trials(
        **{name: values if name == "seed" else list(values) for name, values in axes.items()}, **vars(same)
    )
    if seeds > 1 and not any((*swept.noise, *swept.model_error)):
        raise InputError(f"--seeds {seeds} does not apply: nothing is random; add --noise or --model-error")
    rows = _watched(planned, kept.out / "finished", jobs)
    over = [name for name, values in axes.items() if len(values) > 1 and name != "seed"]
    console.print(grid(f"{len(rows)} runs", *_overview(rows, over), KEY))
    failures = Counter(row["message"] for row in rows if row["status"] != "finished")
    for message, times in failures.most_common(5):
        console.print(f"{times} {'run' if times == 1 else 'runs'}: {message}", markup=False)
    written = [sweeps.write_table(rows, kept.table or kept.out / "runs.csv")]
    if any(row["status"] == "finished" for row in rows):
        written.append(plots.save(plots.sweep(rows, over), kept.plot or kept.out / "sweep.png"))
    if kept.json is not None:
        written.append(write_json(kept.json, {"runs": rows}))
    print_files(written)
    return 1 if failures else 0


def _watched(planned: list[Trial], folder: Path, jobs: int) -> list[Row]:
    """Rows of all runs, with a progress bar meanwhile.

    Raises:
        KeyboardInterrupt: The sweep was interrupted; its message has the number of runs done.
    """
    from eos_pin.experiments import sweeps

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    counts = 0, len(planned)
    with Progress(*columns, console=stderr, transient=True) as progress:
        bar = progress.add_task("runs", total=len(planned))

        def tell(done: int, of: int) -> None:
            nonlocal counts
            counts = done, of
            progress.update(bar, completed=done, total=of)

        try:
            return sweeps.sweep(planned, folder=folder, jobs=jobs, observer=tell)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{counts[0]} of {counts[1]} done; run the same command again to go on") from None


def _check(axes: dict[str, Sequence[Any]], same: Row) -> None:
    """Refuse bad input and print the notes before anything runs: each value is tried with the first of all others."""
    from eos_pin.experiments.trial import Trial

    if not axes["robot"]:
        raise InputError("a sweep needs a robot, such as `eos-pin sweep panda`; `eos-pin robots` lists all")
    first = {name: values[0] for name, values in axes.items()} | same
    settings = [first | {name: value} for name, values in axes.items() if name != "seed" for value in values]
    notes: dict[str, None] = {}
    for trial in {trial.key: trial for trial in (Trial.from_settings(**each) for each in settings)}.values():
        machine, controller, *_ = trial.prepare()
        made = [part for part in (machine, controller.reference, controller.task) if part is not None]
        notes.update(dict.fromkeys(f"{machine.name}: {note}" for part in made for note in part.notes))
    for note in notes:
        stderr.print(f"Note: {note}", markup=False, soft_wrap=True)


def _overview(rows: Sequence[Row], over: Sequence[str]) -> tuple[list[str], list[list[Any]]]:
    """Columns and lines of the table on the terminal: a line for each combination, over all its seeds."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in over), []).append(row)
    lines = []
    for values, some in groups.items():
        good = [row for row in some if row["status"] == "finished"]
        quantities = ("task_error_max", "self_motion_error_max", "last_drift", "torque_max", "limit_ratio_max")
        worst = [max((row[name] for row in good if row[name] is not None), default=np.nan) for name in quantities]
        lines.append([*values, f"{len(good)} of {len(some)}", *worst])
    named = [name.replace("_", " ") for name in over]
    return [*named, "finished", "task error", "v error", "drift", "torque", "of limits"], lines
