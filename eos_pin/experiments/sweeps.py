"""Many closed-loop runs at once: a run in plain values, all combinations of some settings, one table of results.

    rows = sweep(trials(robot=["panda", "xarm7"], kp=[50, 100], seed=range(5)), folder="runs/gains", jobs=2)

Finished runs are kept in the folder, a file each, and the same call after an interrupt computes only the others. Runs
go to the processes, threads or cluster of `joblib`: inside `joblib.parallel_config("dask")` they go to a Dask cluster.
"""

from __future__ import annotations

import csv
import io
import json
import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import IO, Any

from eos_pin._arrays import called, checked
from eos_pin._files import write_atomically
from eos_pin.errors import EosError, InputError, MissingDependencyError
from eos_pin.experiments.trial import Row, Trial
from eos_pin.simulation._recorder import uninterrupted


@checked
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
    tell = partial(called, "the observer", observer or (lambda done, of: None))
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
            "Sweep again with fewer jobs, and look at its error output"
        ) from error
    return [_cells(trial.settings) | found[trial.key] for trial in trials]


@contextmanager
def _unhearing_children() -> Iterator[None]:
    """Start processes that ignore Ctrl-C, which a terminal sends to all of them: the first process ends the others."""
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
    """Write rows as a table, .csv or .parquet by the name of the file. NaN is left empty.

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
        raise MissingDependencyError(
            "a Parquet file", "pyarrow", "pip install 'eos-pin[parquet]'", ", or write .csv"
        ) from error
    parquet.write_table(Table.from_pydict({name: [row.get(name) for row in rows] for name in _columns(rows)}), file)


def _columns(rows: Sequence[Row]) -> list[str]:
    """Names in any of the rows; a run that failed has no figures."""
    return list(dict.fromkeys(name for row in rows for name in row))


def _attempt(trial: Trial) -> tuple[str, Row]:
    """Key and figures of a run, also of one that fails."""
    try:
        figures = trial.figures(uninterrupted(trial.run()))
    except Exception as error:  # one run that fails must not end the others
        reason = str(error) if isinstance(error, EosError) else f"{type(error).__name__}: {error}".rstrip(": ")
        figures = {"status": "failed", "message": reason}
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


def _cells(row: Row) -> Row:
    """The same in types that every table has: a list is written as on the command line, NaN is None."""
    return {name: _cell(value) for name, value in row.items()}


def _cell(value: Any) -> str | bool | float | None:
    if isinstance(value, tuple | list):
        return " ".join(map(str, value))
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
