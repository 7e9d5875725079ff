"""Damaged URDF files by the thousand: each must load, or be refused by an `EosError`, quickly and in silence.

    python benchmarks/fuzz_urdf.py [--count N] [--first SEED] [--json FILE] [--keep FOLDER]

Real and bundled URDFs are mutated, by elements, attributes, numbers, names, bytes and encodings, with the traps of XML
among them. What still loads is used: mass matrix, a task, a chart, one control torque, and for some the shapes. Every
mutation is made from its seed alone, so a failure is repeated by `--first SEED --count 1`.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from confined import captured, time_limit
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import TerminatedWorkerError
from mutations import mutated
from rich.progress import Progress

from eos_pin import ControlLoop, EosController, EosError, Hold, load_robot
from eos_pin.cli.main import run
from eos_pin.cli.output import (
    console,
    format_number,
    grid,
    stderr,
    write_json,
)
from eos_pin.experiments.defaults import make_task

#: Nothing may take more processor time than this [s].
TIME_LIMIT = 5.0
#: Address space of a process; the libraries alone take one gigabyte of it [bytes].
MEMORY_LIMIT = 2 * 2**30
#: Mutations that one process does before it reports.
BATCH = 50
#: The shapes of one in this many robots are read; it takes a hundred times longer than all the rest.
SHAPES_EVERY = 25


@dataclass(frozen=True)
class Outcome:
    """What became of one mutated file.

    Attributes:
        seed: Seed it was made from.
        kind: `"loaded"`, the name of an `EosError`, or of what should not have happened.
        good: Whether that is allowed.
        seconds: Processor time it took.
        detail: Message or traceback.
    """

    seed: int
    kind: str
    good: bool
    seconds: float
    detail: str


def attempt(seed: int, folder: Path) -> Outcome:
    """Load the mutation of a seed and use what loads."""
    path = folder / f"{os.getpid()}.urdf"
    path.write_bytes(mutated(seed))
    start = time.process_time()
    kind, good, detail = "loaded", True, ""
    with captured() as said, warnings.catch_warnings():
        warnings.simplefilter("error")
        # A mesh that cannot be read is left out with a warning.
        warnings.filterwarnings("ignore", message="left out meshes")
        try:
            with time_limit(8.0 * TIME_LIMIT):
                use(path, seed)
        except EosError as error:
            kind, detail = type(error).__name__, str(error)
            good = bool(detail)
        except Exception as error:
            kind, good, detail = type(error).__name__, False, traceback.format_exc()
    seconds = time.process_time() - start
    if said[0]:
        kind, good, detail = "said something on the terminal", False, said[0]
    if seconds > TIME_LIMIT:
        kind, good, detail = "too slow", False, f"{seconds:.1f} s, {kind} {detail}"
    return Outcome(seed, kind, good, seconds, detail)


def use(path: Path, seed: int) -> None:
    """Load a file and do with the robot what everybody does."""
    robot = load_robot(path, chain_to=("", "auto")[seed % 2])
    if seed % SHAPES_EVERY < 2:
        assert robot.visual is not None
        assert robot.collision is not None
    q = np.clip(np.full(robot.n, 0.1), robot.lower, robot.upper)
    assert np.isfinite(robot.mass(q)).all()
    assert np.isfinite(robot.bias(q, 0.1 * q)).all()
    task = make_task(robot)
    tau = ControlLoop(EosController(task, Hold(task.value(q), task.m))).step(0.0, q, 0.0 * q)
    assert np.isfinite(tau).all()


def batch(seeds: Sequence[int], folder: Path) -> tuple[list[Outcome], int]:
    """Outcomes of some seeds, in a process whose memory is limited; and the most memory that it has taken [bytes]."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, resource.getrlimit(resource.RLIMIT_AS)[1]))
    done = []
    for seed in seeds:
        # A crash leaves behind who caused it.
        (folder / f"{os.getpid()}.seed").write_text(str(seed))
        done.append(attempt(seed, folder))
    (folder / f"{os.getpid()}.seed").unlink()
    return done, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def outcomes(seeds: Sequence[int], jobs: int) -> Iterator[tuple[list[Outcome], int]]:
    """All batches, as they are done; a crash of the interpreter is an outcome like any other."""
    batches = [seeds[i : i + BATCH] for i in range(0, len(seeds), BATCH)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            yield from Parallel(jobs, return_as="generator_unordered")(delayed(batch)(b, folder) for b in batches)
        except TerminatedWorkerError:
            crashed = [int(file.read_text()) for file in folder.glob("*.seed")]
            yield [Outcome(seed, "a process crashed here, or ran beside", False, 0.0, "") for seed in crashed], 0


def fuzz(
    *,
    count: int = 10_000,
    first: int = 0,
    jobs: int = 2,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    keep: Path | None = None,
) -> int:
    """Mutate URDFs, load them, and count what happens.

    Args:
        count: Number of mutations.
        first: Seed of the first.
        jobs: Processes.
        json_file: File for the figures, machine-readable.
        keep: Folder for the files that did what they should not.
    """
    start, state = time.perf_counter(), 0
    done: list[Outcome] = []
    with Progress(console=stderr, transient=True) as progress:
        bar = progress.add_task("mutated URDFs", total=count)
        for some, peak in outcomes(range(first, first + count), jobs):
            done += some
            state = max(state, peak)
            progress.update(bar, advance=len(some))
    kinds = Counter((outcome.kind, outcome.good) for outcome in done)
    rows = []
    for (kind, good), number in sorted(kinds.items(), key=lambda item: (item[0][1], -item[1])):
        slowest = max((o.seconds, o.seed) for o in done if o.kind == kind)
        rows.append((kind, number, "allowed" if good else "WRONG", slowest[0], slowest[1]))
    console.print(grid(f"{len(done)} mutated URDFs", ("outcome", "how many", "", "slowest, s", "seed"), rows))
    seconds = time.perf_counter() - start
    console.print(f"most memory of a process {state / 2**20:.0f} MB; {seconds:.0f} s in all")
    bad = sorted((outcome for outcome in done if not outcome.good), key=lambda outcome: outcome.seed)
    for outcome in bad[:20]:
        lines = outcome.detail.strip().splitlines()
        console.print(
            f"seed {outcome.seed}: {outcome.kind}: {lines[-1] if lines else ''}", markup=False, soft_wrap=True
        )
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        for outcome in bad:
            (keep / f"{outcome.seed}.urdf").write_bytes(mutated(outcome.seed))
            (keep / f"{outcome.seed}.txt").write_text(f"{outcome.kind}\n{outcome.detail}\n", encoding="utf-8")
    if json_file is not None:
        figures = {
            "count": len(done),
            "outcomes": {kind: number for (kind, _), number in kinds.items()},
            "wrong": [asdict(outcome) for outcome in bad],
            "slowest_seconds": max(outcome.seconds for outcome in done),
            "memory_bytes": state,
            "seconds": seconds,
        }
        write_json(json_file, figures)
    complete = len(done) == count
    console.print(f"worst time {format_number(max(o.seconds for o in done))} s; {len(bad)} wrong")
    return int(bool(bad) or not complete)


if __name__ == "__main__":
    sys.exit(run(fuzz))
