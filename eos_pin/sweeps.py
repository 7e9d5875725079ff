"""Many closed-loop runs at once: a run in plain values, all combinations of some settings, one table of what happened.

    rows = sweep(trials(robot=["panda", "xarm7"], kp=[50, 100], seed=range(5)), folder="runs/gains", jobs=2)

Finished runs are kept in the folder, a file each, and the same call after an interrupt computes only the others. Runs
go to the processes, threads or cluster of `joblib`: inside `joblib.parallel_config("dask")` they go to a Dask cluster.
"""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import json
import math
import numbers
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache, cached_property
from multiprocessing import resource_tracker
from pathlib import Path
from typing import IO, Any, Literal, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from eos_pin.arrays import JointVector
from eos_pin.controllers import Controller
from eos_pin.errors import EosError, InputError, OutputError, UnknownNameError
from eos_pin.files import write_atomically
from eos_pin.options import ControlOptions, PathOptions, RobotOptions, RunOptions, TaskOptions, check_options
from eos_pin.recording import Observer, uninterrupted
from eos_pin.results import Result, provenance
from eos_pin.robot import Robot

#: What is known of one run: its settings and its figures by name.
Row: TypeAlias = dict[str, Any]

#: Runs of one sweep, at most.
MOST_RUNS = 100_000
GROUPS: Mapping[str, type] = {
    "robot": RobotOptions,
    "task": TaskOptions,
    "path": PathOptions,
    "control": ControlOptions,
    "simulation": RunOptions,
}
#: Group of each setting, and what a setting of few values may be.
PLACES = {field.name: group for group, kind in GROUPS.items() for field in fields(kind)}
CHOICES = {
    name: get_args(hint)
    for kind in GROUPS.values()
    for name, hint in get_type_hints(kind).items()
    if get_origin(hint) is Literal
}
#: Figures that a row has from `Result.summary`.
MEASURED = (
    "status",
    "message",
    "task_error_max",
    "self_motion_error_max",
    "given_up_seconds",
    "chart_switches",
    "kinetic_energy_mean",
    "torque_max",
    "limit_ratio_max",
    "cpu_seconds",
)


@dataclass(frozen=True)
class Trial:
    """One closed-loop run in plain values, with the settings and defaults of `eos-pin track`.

    A subclass may add fields of its own, run a controller of its own in `run`, and measure in `figures`.

    Attributes:
        robot: Which robot.
        task: What the robot must do.
        path: Where it should go.
        control: How it is controlled.
        simulation: How it is simulated.
        seed: Seed of everything random.
    """

    robot: RobotOptions
    task: TaskOptions = TaskOptions()
    path: PathOptions = PathOptions()
    control: ControlOptions = ControlOptions()
    simulation: RunOptions = RunOptions()
    seed: int = 0

    def __post_init__(self) -> None:
        settings = self.settings
        for name, choices in CHOICES.items():
            if settings[name] not in choices:
                raise UnknownNameError(name.replace("_", " "), str(settings[name]), choices)

    @classmethod
    def of(cls, robot: str, **settings: Any) -> Trial:
        """The run with these settings, named as the options of `eos-pin track` are, such as `kp=50, model_error=0.1`.

        Raises:
            UnknownNameError: There is no such setting, or it has no such value.
        """
        own = {field.name for field in fields(cls)} - set(GROUPS)
        groups: dict[str, Row] = {name: {} for name in GROUPS}
        rest: Row = {}
        for name, value in {"robot": robot, **settings}.items():
            if name not in PLACES and name not in own:
                raise UnknownNameError("setting", name, [*PLACES, *own])
            (groups[PLACES[name]] if name in PLACES else rest)[name] = _plain(value, name)
        return cls(**{name: kind(**groups[name]) for name, kind in GROUPS.items()}, **rest)

    @property
    def settings(self) -> Row:
        """All settings by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        grouped = {name: value for group in GROUPS for name, value in vars(values.pop(group)).items()}
        return grouped | values

    @cached_property
    def key(self) -> str:
        """A name that the same run has at any time and place; another where a version or a file it reads is another."""
        paths = [Path(self.robot.robot), Path(self.path.path)]
        digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()]
        # 50 and 50.0 are the same gain.
        settings = json.loads(json.dumps(self.settings, default=str), parse_int=float)
        text = json.dumps([type(self).__qualname__, settings, digests, _versions()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    def prepare(self) -> tuple[Robot, Controller, JointVector, float]:
        """Robot, controller, joints at the start and length of the run [s].

        Raises:
            EosError: The settings do not fit the robot, or each other.
        """
        check_options(self.path, self.control, self.simulation)
        robot = self.robot.load()
        task, q = self.task.make(robot)
        path = self.path.make(task, q)
        return robot, self.control.make(task, path, q, self.simulation.period), q, self.path.length(path)

    def run(self, observer: Observer | None = None) -> Result:
        """Run it; `observer` is called with (t, q) of every sample."""
        return self.simulation.run(*self.prepare(), seed=self.seed, observer=observer)

    def figures(self, result: Result) -> Row:
        """What the table says of the run, in plain values: the chief figures of `Result.summary`."""
        summary = result.summary()
        drift = summary["joint_drift_per_cycle"] or [math.nan]
        found = {name: summary[name] for name in MEASURED} | {"ended": summary["duration"]}
        return found | {"first_drift": drift[0], "last_drift": drift[-1]}


def trials(kind: type[Trial] = Trial, /, **settings: Any) -> list[Trial]:
    """Every combination of settings: a list, range or array is swept, anything else is the same in all runs.

    Args:
        kind: What to make of each combination.
        **settings: Settings as in `Trial.of`; `robot` must be among them.

    Raises:
        UnknownNameError: There is no such setting, or it has no such value.
        InputError: No robot, or too many combinations.
    """
    if "robot" not in settings:
        raise InputError('trials need a robot, such as robot="panda" or robot=["panda", "xarm7"]')
    axes = [value if isinstance(value, list | range | np.ndarray) else [value] for value in settings.values()]
    count = math.prod(len(axis) for axis in axes)
    if count > MOST_RUNS:
        raise InputError(f"these settings make {count:,} runs; up to {MOST_RUNS:,} are possible. Take fewer of each")
    return [kind.of(**dict(zip(settings, values, strict=True))) for values in itertools.product(*axes)]


def sweep(
    trials: Iterable[Trial],
    *,
    folder: str | Path | None = None,
    jobs: int | None = None,
    observer: Callable[[int, int], object] | None = None,
) -> list[Row]:
    """Run all trials and return a row of settings and figures for each, in their order.

    A run that raises becomes a row with status `"failed"` and its message, and is tried again next time. What is kept
    knows its settings, the files it read and the versions of packages, but not code that was changed since. An
    interrupt ends all runs; what was finished by then is kept, and nothing of the others.

    Args:
        trials: The runs; equal ones are computed once.
        folder: Where finished runs are kept, and looked for. By default they are not.
        jobs: Runs at the same time; by default 1, or what `joblib.parallel_config` says.
        observer: Called with the numbers of runs that are done and of all.

    Raises:
        OutputError: The folder cannot be written.
        EosError: A process of the sweep died.
    """
    import joblib

    if jobs == 0:
        raise InputError("jobs must be the number of runs at the same time, or -1 for one on each core; got 0")
    trials = list(trials)
    wanted = {trial.key: trial for trial in trials}
    files = {} if folder is None else {key: Path(folder) / f"{key}.json" for key in wanted}
    kept = {key: _read(file) for key, file in files.items()}
    found = {key: figures for key, figures in kept.items() if figures is not None}
    tell = observer or (lambda done, of: None)
    tell(len(found), len(wanted))
    # One at a time: a run takes seconds, and is kept as soon as it is finished.
    pool = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    todo = [joblib.delayed(_attempt)(trial) for key, trial in wanted.items() if key not in found]
    try:
        finished = None
        try:
            with _unhearing_children():
                finished = pool(todo)
            for key, figures in finished:
                found[key] = figures
                if key in files and figures["status"] != "failed":
                    _write(files[key], wanted[key].settings, figures)
                tell(len(found), len(wanted))
        finally:
            # Ends the processes at once; that runs are lost then is no news.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                if finished is not None:
                    finished.close()
    except BrokenExecutor as error:
        where = f", and kept in {folder}" if files else ""
        raise EosError(
            f"a process of the sweep died, perhaps for lack of memory; {len(found)} of {len(wanted)} are done{where}. "
            "Sweep again with fewer jobs, and look at what the process says"
        ) from error
    return [_cells(trial.settings) | found[trial.key] for trial in trials]


@contextmanager
def _unhearing_children() -> Iterator[None]:
    """Start processes that do not hear Ctrl-C, which a terminal sends to all of them: the first one ends the others."""
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    # Where it is started later it takes the mask away.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def write_table(rows: Sequence[Row], path: str | Path) -> Path:
    """Write rows as a table, .csv or .parquet by the name of the file. What is not a number is left empty.

    Raises:
        InputError: The name ends otherwise, or there is nothing to write.
        OutputError: The file cannot be written, or pyarrow is not installed.
    """
    path = Path(path)
    kinds = {".csv": _to_csv, ".parquet": _to_parquet}
    if path.suffix.lower() not in kinds or not rows:
        raise InputError(
            f"cannot write {len(rows)} runs as {path.name!r}: a table ends in .csv or .parquet, and has rows"
        )
    write = kinds[path.suffix.lower()]
    write_atomically(path, lambda file: write(rows, file))
    return path


def _to_csv(rows: Sequence[Row], file: IO[bytes]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    table = csv.DictWriter(text, _columns(rows))
    table.writeheader()
    table.writerows(rows)
    text.flush()
    text.detach()


def _to_parquet(rows: Sequence[Row], file: IO[bytes]) -> None:
    try:
        from pyarrow import Table, parquet
    except ImportError as error:
        raise OutputError("Parquet needs pyarrow: pip install 'eos-pin[parquet]', or write .csv") from error
    parquet.write_table(Table.from_pydict({name: [row.get(name) for row in rows] for name in _columns(rows)}), file)


def _columns(rows: Sequence[Row]) -> list[str]:
    """Names in any of the rows; a run that failed has no figures."""
    return list(dict.fromkeys(name for row in rows for name in row))


def _attempt(trial: Trial) -> tuple[str, Row]:
    """Key and figures of a run, whatever becomes of it."""
    try:
        figures = trial.figures(uninterrupted(trial.run()))
    except Exception as error:  # one run that fails must not end the others
        told = str(error) if isinstance(error, EosError) else f"{type(error).__name__}: {error}".rstrip(": ")
        figures = {"status": "failed", "message": told}
    return trial.key, _cells(figures)


def _read(path: Path) -> Row | None:
    """Figures of a finished run; None where there is no such file, or it is damaged."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return dict(record["figures"])
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _write(path: Path, settings: Row, figures: Row) -> None:
    text = json.dumps({"settings": settings, "figures": figures}, indent=1, default=str)
    write_atomically(path, lambda file: file.write(text.encode()))


@cache
def _versions() -> dict[str, str]:
    return dict(provenance()["versions"])


def _plain(value: Any, name: str) -> Any:
    """The same as the options hold it: text, truth, number, None, path, or a tuple of these."""
    if value is None or isinstance(value, str | bool | Path):
        return value
    if isinstance(value, numbers.Real):
        return int(value) if isinstance(value, numbers.Integral) else float(value)
    if isinstance(value, Mapping):
        # Joints by name, as on the command line.
        return tuple(f"{key}={_plain(item, name)!r}" for key, item in value.items())
    if isinstance(value, Sequence | np.ndarray):
        return tuple(_plain(item, name) for item in value)
    raise InputError(f"the setting {name} must be text, a number or a few of these, got {value!r}")


def _cells(row: Row) -> Row:
    """The same in types that every table has: a list stands as on the command line, what is not a number is None."""
    return {name: _cell(value) for name, value in row.items()}


def _cell(value: Any) -> str | bool | float | None:
    if isinstance(value, tuple | list):
        return " ".join(map(str, value))
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
