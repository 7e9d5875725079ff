"""Output of a run: a table on the terminal, files, a replay in the browser."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from eos_pin._arrays import Array, JointVector
from eos_pin._files import check_writable, write_atomically
from eos_pin.cli.tables import drift_of_cycles, fitted
from eos_pin.cli.tables import format_number as format_number
from eos_pin.cli.terminal import shown, spell_output
from eos_pin.errors import EosError, InputError
from eos_pin.experiments._interrupts import patient_interrupts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from eos_pin.experiments.joint_logs import JointLog
    from eos_pin.planning.obstacles.clearance import Obstacle
    from eos_pin.robot.model import Robot
    from eos_pin.simulation._recorder import Observer
    from eos_pin.simulation.result import Result
    from eos_pin.tasks.base import Task
    from eos_pin.trajectories.base import Trajectory


#: Words for the letters in tables of runs.
KEY = (
    "n joints follow a task of m coordinates, so that r = n - m are to spare: their motion is v. A chart is a range "
    "of joints on which task and v are coordinates; its margin is 1 in the middle and 0 at the edge."
)


class Terminal(Console):
    """A console that lays text out in the letters its encoding has."""

    def render_str(self, text: str, *args: Any, **kwargs: Any) -> Text:
        return super().render_str(shown(text, self.encoding), *args, **kwargs)


#: Where tables go; errors and progress go to stderr.
console = Terminal(highlight=False, emoji=False)
stderr = Terminal(stderr=True, highlight=False, emoji=False)


@dataclass(frozen=True)
class Output:
    """Files to keep, and the live view.

    Attributes:
        out: Folder for all files that have no path of their own.
        json: File for the figures, machine-readable.
        html: File for the browser replay, which plays offline.
        plot: File for the figure (.png, .pdf or .svg).
        csv: File for the samples as a table.
        bag: Folder for the motion as a bag of ROS 2, joint states and a trajectory (pip install 'eos-pin[ros]').
        rerun: File for Rerun's viewer (.rrd), robot and curves (pip install 'eos-pin[rerun]').
        view: Watch the run live in the browser, in real time.
    """

    out: Path | None = None
    json: Path | None = None
    html: Path | None = None
    plot: Path | None = None
    csv: Path | None = None
    bag: Path | None = None
    rerun: Path | None = None
    view: bool = False

    def without(self, *names: str, reason: str) -> None:
        """Refuse options that a command has no use for, with an InputError."""
        for name in names:
            if getattr(self, name):
                raise InputError(f"--{name} {getattr(self, name)} does not apply: {reason}")

    def within(self, folder: Path | None, *, names: Mapping[str, str]) -> Output:
        """The same with a path below `out`, or `folder`, if any, for every file in `names` that has none.

        Args:
            folder: Place if `out` is not given.
            names: File name by the name of the option.

        Raises:
            OutputError: A file cannot be written there.
        """
        base = self.out or folder
        chosen = {key: getattr(self, key) for key in ("json", "html", "plot", "csv", "bag", "rerun")}
        if base is not None:
            chosen |= {key: chosen[key] or base / name for key, name in names.items()}
        check_writable(*filter(None, (base, *chosen.values())))
        return replace(self, out=base, **chosen)


@dataclass(frozen=True)
class SeededOutput(Output):
    """Files to keep, the live view, and the seed.

    Attributes:
        seed: Seed of everything random.
    """

    seed: int = 0


@contextmanager
def progress(
    output: Output,
    robot: Robot,
    q: JointVector,
    duration: float,
    title: str,
    follows: tuple[Task, Trajectory] | None = None,
) -> Iterator[Observer]:
    """Progress bar on the terminal and, if asked for, a live view in the browser.

    Args:
        output: Whether to view.
        robot: The robot that moves.
        q: Joints at the start.
        duration: Length of the run [s].
        title: Name of the run.
        follows: Task and path, of which the live view has line, trace and errors.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} of {task.total:g} s"))
    with Progress(*columns, TimeElapsedColumn(), console=stderr, transient=True) as progress:
        bar = progress.add_task(title, total=duration)
        if not output.view:
            yield lambda t, q: progress.update(bar, completed=t)
            return
        from eos_pin.viewer.curves import live_curves
        from eos_pin.viewer.replay import live_scene
        from eos_pin.viewer.viewer import Viewer

        scene = live_scene(robot, q, duration, follows, title=title)
        with Viewer(scene, q, curves=live_curves(robot, q, follows)) as viewer:
            stderr.print(f"Live view: {viewer.url}")
            if not viewer.open():
                stderr.print("No browser opened; open the address above by hand.")

            def show(t: float, q: JointVector) -> None:
                progress.update(bar, completed=t)
                viewer.show(t, q)

            yield show


def write_outputs(
    output: Output,
    result: Result,
    robot: Robot | None,
    *,
    figures: Mapping[str, Any] | None = None,
    obstacles: Sequence[Obstacle] = (),
    plot: Figure | None = None,
    title: str = "",
    runs: Mapping[str, Result] | None = None,
) -> list[Path]:
    """Write every file that is asked for.

    Args:
        output: Results that are asked for.
        result: The run.
        robot: The robot that moved; without it there is no replay.
        figures: Contents of the JSON; by default the run's summary.
        obstacles: Solids in the replay.
        plot: Figure to save; by default the overview of the run.
        title: Heading of the replay; by default robot and task.
        runs: Runs by name that the replay shows together, instead of this one.

    Returns:
        The files that were written.
    """
    written = []
    if output.out is not None:
        written.append(result.save(output.out / "run.npz"))
    if output.json is not None:
        written.append(write_json(output.json, figures or result.summary()))
    if output.csv is not None:
        written.append(result.to_csv(output.csv))
    if output.plot is not None:
        from eos_pin.plots import pages as plots

        written.append(plots.save(plot or plots.overview(result, robot), output.plot))
    if output.bag is not None:
        written.append(result.to_bag(output.bag))
    if output.rerun is not None and robot is not None:
        from eos_pin.viewer.replay import scene_of
        from eos_pin.viewer.rerun_file import write_rerun

        scene = scene_of(result, robot, obstacles, title=title)
        written.append(write_rerun(output.rerun, scene, result.t, result.q, curves_of(result, robot)))
    if output.html is not None and robot is not None:
        from eos_pin.viewer.replay import write_replay

        written.append(write_replay(output.html, runs or result, robot, obstacles=obstacles, title=title))
    return written


def curves_of(result: Result, robot: Robot) -> dict[str, Array]:
    """Numbers of a run over time, by where they stand in a tree: joints with their limits, task, self-motion, chart."""
    curves: dict[str, Array] = {"chart": result.chart.astype(float)}
    for name in ("q", "dq", "ddq", "tau"):
        values = getattr(result, name)
        if np.isfinite(values).all():
            curves |= {f"joints/{joint}/{name}": values[:, i] for i, joint in enumerate(result.joints)}
    for name, limit in (("lower", robot.lower), ("upper", robot.upper)):
        ends = zip(result.joints, limit, strict=True)
        curves |= {f"joints/{joint}/{name}": np.full_like(result.t, end) for joint, end in ends if math.isfinite(end)}
    for name in ("z", "z_ref", "error", "v", "v_ref"):
        values = getattr(result, name)
        if values.size:
            curves |= {
                f"{'self-motion' if name[0] == 'v' else 'task'}/{name}/{i + 1}": values[:, i]
                for i in range(values.shape[1])
            }
    return curves


def show(
    runs: Mapping[str, Result], robots: Mapping[str, Robot], obstacles: Sequence[Obstacle] = (), *, title: str = ""
) -> None:
    """Hand the replay of runs by name to the browser, which keeps it."""
    from eos_pin.viewer.replay import replay_page, scene_of
    from eos_pin.viewer.viewer import Served

    scenes = {name: scene_of(run, robots[name], obstacles, title=title) for name, run in runs.items()}
    with Served(lambda connect: replay_page(runs, scenes, connect=connect)) as viewer:
        console.print(f"Replay: {viewer.url}")
        if not viewer.open():
            stderr.print("No browser opened; open the address above by hand within a minute.")
            viewer.open(wait=60.0)


def write_json(path: Path, figures: Mapping[str, Any]) -> Path:
    """Write measures as JSON; not-a-number and infinity become null."""
    text = json.dumps(_plain(figures), indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))
    return path


def print_files(files: Sequence[Path]) -> None:
    """Print the names of the files written."""
    if files:
        console.print("Wrote " + ", ".join(str(file) for file in files), soft_wrap=True)


def say_notes(*made: Robot | Trajectory | Task | JointLog) -> None:
    """Print the notes of robots, paths, tasks and logs on the error stream: choices, changes, missing parts."""
    for note in (note for each in made for note in each.notes):
        stderr.print(f"Note: {note}", markup=False, soft_wrap=True)


def warn_of_gravity(robot: Robot, q: JointVector) -> None:
    """Warn on the terminal if gravity needs more torque than the joints have, at the posture of the start."""
    from eos_pin.control.overload import gravity_overload

    for note in gravity_overload(robot, q):
        stderr.print(f"Note: {note}.", soft_wrap=True, markup=False)


def grid(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Table that fits the terminal, in the letters it has; see `eos_pin.cli.tables`."""

    def spelled(cell: Any) -> Any:
        return cell if isinstance(cell, float) else shown(str(cell), console.encoding)

    return fitted(spelled(title), columns, [[spelled(cell) for cell in row] for row in rows], console.width)


def title_of(robot: Robot, task: Task) -> str:
    """Robot and task in words, such as "panda: pose of panda_hand_tcp"."""
    return f"{robot.name}: {task_words(task)}"


def task_words(task: Task) -> str:
    """Task in words, such as "pose of panda_hand_tcp"."""
    if not task.kind:
        return str(task)
    axes = f", {task.axes}" if task.kind == "position" and task.axes != "xyz" else ""
    return f"{task.kind}{f' of {task.frame}' if task.frame else ''}{axes}"


def run_table(summary: Mapping[str, Any]) -> Table:
    """Table of one run."""
    title = f"{summary['robot']}: {summary['frame'] or summary['task'].get('kind', '')}"
    table = Table(title=escape(title), show_header=False)
    for _ in range(2):
        # A path or a name in a message may be longer than a line.
        table.add_column(overflow="fold")
    table.add_row("status", escape(summary["status"] + (f": {summary['message']}" if summary["message"] else "")))
    table.add_row("joints n, task m, redundancy r", f"{summary['n']}, {summary['m']}, {summary['r']}")
    period = f" of {summary['period']:g} s" if summary["period"] else ""
    table.add_row("duration", f"{summary['duration']:g} s, {summary['cycles']} cycles{period}")
    units = " or ".join(dict.fromkeys(summary["units"])) or "m or rad"
    settled = f"after {summary['settled_from']:g} s"
    error = "tool path error" if summary["frame"] else "task error"
    table.add_row(f"{error}, {settled}", f"{format_number(summary['task_error_max'])} {units}")
    nothing = "none: the task takes all joints (r = 0)" if summary["m"] and not summary["r"] else ""
    table.add_row(f"self-motion error, {settled}", nothing or format_number(summary["self_motion_error_max"]))
    table.add_row("joints come back to within", drift_of_cycles(summary["joint_drift_per_cycle"]))
    if any(summary["joint_turns_per_cycle"]):
        table.add_row("whole turns of a joint in a cycle, at most", str(max(summary["joint_turns_per_cycle"])))
    if summary["joint_distance"]:
        apart = summary["joint_distance"]
        text = f"{format_number(apart['max'])} rad or m, at the end {format_number(apart['end'])}"
        table.add_row("joints off the plan, at most", text)
    if summary["further_task"]:
        beside = summary["further_task"]
        what = f"further task, {beside['kind']} of {beside['frame']}: error, {settled}"
        table.add_row(what, format_number(beside["error_max"]))
    table.add_row("chart switches", str(summary["chart_switches"]))
    if summary["coupling"]:
        text = f"median {summary['coupling']['median']:.2f}, at most {summary['coupling']['max']:.2f}"
        table.add_row("inertial coupling of task and self-motion", text)
    if summary["given_up_seconds"]:
        table.add_row("part of the task given up", f"{format_number(summary['given_up_seconds'])} s")
    for what, key, unit in (
        ("kinetic energy, mean", "kinetic_energy_mean", "J"),
        ("largest torque or force", "torque_max", "N m or N"),
        ("computing time", "cpu_seconds", "s"),
    ):
        # Not every run has inertias, torques, or a computer.
        if not math.isnan(summary[key]):
            table.add_row(what, f"{format_number(summary[key])} {unit}")
    if summary["limits"]["message"]:
        text = escape(summary["limits"]["message"])
        table.add_row("limits", f"[bold red]{text}[/]" if summary["limits"]["passed"] else text)
    if summary["m"]:
        table.caption, table.caption_justify = KEY, "left"
    return table


def print_runs(title: str, what: str, summaries: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table of several runs by name, and a line for each that ended early or passed limits.

    Args:
        title: Heading.
        what: What the names are.
        summaries: Summaries of the runs.
    """
    rows = []
    for name, summary in summaries.items():
        drift = summary["joint_drift_per_cycle"] or [math.nan]
        figures = ("kinetic_energy_mean", "torque_max", "limit_ratio_max")
        rows.append(
            (name, summary["status"], summary["task_error_max"], drift[0], drift[-1], *map(summary.get, figures))
        )
    columns = ("task error", "first drift", "last drift", "mean energy", "max torque", "of limits")
    console.print(grid(title, (what, "status", *columns), rows))
    for name, summary in summaries.items():
        if summary["message"]:
            console.print(f"{name}: {summary['message']}", markup=False)
        if summary["limits"]["passed"]:
            console.print(f"{name}: limits {summary['limits']['message']}", markup=False)


def guarded(command: Callable[[], int]) -> int:
    """Exit code of a command; bad input and Ctrl-C are reported in one paragraph."""
    spell_output()
    try:
        with patient_interrupts():
            return command()
    except EosError as error:
        stderr.print(f"[bold red]Error:[/] {escape(str(error))}", soft_wrap=True)
        return 2
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except KeyboardInterrupt as interrupt:
        stderr.print(": ".join(filter(None, ("Interrupted", str(interrupt)))), markup=False)
        return 130


def _plain(value: Any) -> Any:
    """The same in types JSON has; not-a-number and infinity become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
