"""What two cores are worth to a sweep, and that a sweep which is killed goes on where it was.

    python benchmarks/sweep.py [--quick] [--json FILE]

Forty runs of two robots, on one core and on two in turn, wall time with the start of the processes. What two cores are
worth to plain loops at that moment is measured beside it, because other work on the machine takes its part.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import tyro
from joblib.externals.loky import get_reusable_executor

from eos_pin import sweep, trials
from eos_pin.cli.main import run
from eos_pin.cli.output import console, format_number, grid, write_json

SETTINGS: dict[str, Any] = {
    "robot": ["panda", "xarm7"],
    "kp": [50.0, 100.0],
    "model_error": [0.0, 0.1],
    "control_rate": 1000.0,
}
#: The same as a command, to be killed.
COMMAND = [
    "sweep",
    "panda",
    "xarm7",
    "--kp",
    "50,100",
    "--model-error",
    "0,0.1",
    "--control-rate",
    "1000",
    "--jobs",
    "2",
]


def wall(call: Callable[[], object]) -> float:
    """Wall time of a call [s] that starts processes of its own."""
    get_reusable_executor().shutdown(wait=True)
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def loop() -> int:
    """Plain work for one core."""
    return sum(i * i for i in range(20_000_000))


def speedups(rounds: int, seeds: int, cycles: int) -> dict[str, list[float]]:
    """Wall times of the sweep, and of as many plain loops as cores, on one core and on two."""
    planned = trials(**SETTINGS, seed=range(seeds), cycles=cycles)
    found: dict[str, list[float]] = {f"{what}, {jobs}": [] for what in ("sweep", "loops") for jobs in (1, 2)}
    for _ in range(rounds):
        for jobs in (1, 2):
            pool = joblib.Parallel(n_jobs=jobs)
            pool(joblib.delayed(int)(0) for _ in range(jobs))
            start = time.perf_counter()
            pool(joblib.delayed(loop)() for _ in range(2))
            found[f"loops, {jobs}"].append(time.perf_counter() - start)
            found[f"sweep, {jobs}"].append(wall(lambda jobs=jobs: sweep(planned, jobs=jobs)))  # type: ignore[misc]
    return found


def killed(seeds: int, cycles: int) -> dict[str, int]:
    """Kill the command when half of its runs are finished, and start it again."""
    with tempfile.TemporaryDirectory() as folder:
        words = [*COMMAND, "--seeds", str(seeds), "--cycles", str(cycles), "--out", folder]
        command = [sys.executable, "-m", "eos_pin.cli.main", *words]
        total = 8 * seeds
        finished = Path(folder) / "finished"
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen(command, start_new_session=True, **quiet)
        while len(list(finished.glob("*.json"))) < total // 2:
            assert process.poll() is None
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        before = {file: file.stat().st_mtime_ns for file in finished.glob("*.json")}
        subprocess.run(command, check=True, **quiet)
        after = {file: file.stat().st_mtime_ns for file in finished.glob("*.json")}
    again = sum(after[file] != changed for file, changed in before.items())
    return {
        "runs": total,
        "finished when killed": len(before),
        "finished in the end": len(after),
        "computed twice": again,
    }


def benchmark(
    *,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> int:
    """Time a sweep of forty runs on one core and on two, and kill one half-way.

    Args:
        quick: Fewer and shorter runs, one round.
        json_file: File for the figures.
    """
    seeds, cycles = (1, 1) if quick else (5, 6)
    spent = speedups(1 if quick else 3, seeds, cycles)
    rows, ratios = [], {}
    for what, name in (("sweep", f"{8 * seeds} runs"), ("loops", "plain loops")):
        one, two = (np.array(spent[f"{what}, {jobs}"]) for jobs in (1, 2))
        ratios[name] = float(np.median(one / two))
        rows.append((name, float(np.median(one)), float(np.median(two)), ratios[name]))
    console.print(grid("Wall time in seconds, medians", ("what", "one core", "two cores", "ratio"), rows))
    restart = killed(seeds, cycles)
    console.print("Killed half-way: " + ", ".join(f"{name} {count}" for name, count in restart.items()))
    if json_file is not None:
        write_json(json_file, {"seconds": spent, "ratios": ratios, "killed": restart, "load": os.getloadavg()})
    ok = restart["computed twice"] == 0 and restart["finished in the end"] == restart["runs"]
    console.print(f"Load of the machine: {format_number(os.getloadavg()[0])}")
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(run(benchmark))
