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
from eos_pin.cli.tables import fitted, subject
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


#: Words for the columns of a table of several runs.
RUNS = (
    "Errors and drift are in m or rad, energies in J, torques in N m or N. Drift is how far off a joint comes back "
    "from a round: the first, the worst, the last. The last column is the largest part of a limit that is used."
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


def grid(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], key: str = "") -> Table:
    """Table that fits the terminal, in the letters it has, with words for its columns; see `eos_pin.cli.tables`."""

    def spelled(cell: Any) -> Any:
        return cell if isinstance(cell, float) else shown(str(cell), console.encoding)

    table = fitted(spelled(title), columns, [[spelled(cell) for cell in row] for row in rows], console.width)
    table.caption, table.caption_justify = key or None, "left"
    return table


def title_of(robot: Robot, task: Task) -> str:
    """Robot and task in words, such as "panda: pose of panda_hand_tcp"."""
    return f"{robot.name}: {task_words(task)}"


def task_words(task: Task) -> str:
    """Task in words, such as "pose of panda_hand_tcp"."""
    axes = f", {task.axes}" if task.kind == "position" and task.axes != "xyz" else ""
    return subject(task.kind, task.frame) + axes


def print_runs(title: str, what: str, summaries: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table of several runs by name, and a line for each that ended early or passed limits.

    Args:
        title: Heading.
        what: What the names are.
        summaries: Summaries of the runs.
    """
    ended = any(summary["status"] != "finished" for summary in summaries.values())
    rows = []
    for name, summary in summaries.items():
        drift = summary["joint_drift_per_cycle"] or [math.nan]
        figures = ("kinetic_energy_mean", "torque_max", "limit_ratio_max")
        rows.append(
            (
                name,
                *[summary["status"]] * ended,
                summary["task_error_max"],
                *(drift[0], max(drift), drift[-1]),
                *map(summary.get, figures),
            )
        )
    columns = ("task error", "first drift", "worst drift", "last drift", "mean energy", "max torque", "of limits")
    console.print(grid(title, (what, *["status"] * ended, *columns), rows, RUNS))
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
