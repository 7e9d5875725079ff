"""How long control steps, inverse kinematics and whole runs take, beside other libraries.

    python benchmarks/run.py [--quick] [--targets] [--count N] [--peers NAME ...] [--json FILE] [--write]

The peers are those that `benchmarks/peers.py setup` has installed; without any, eos_pin is compared with Pinocchio.
All get the same file, state and targets, and what they answer is checked before it is timed. One thread each, CPU time,
rounds that take turns, medians; what counts are ratios within one run. `--write` writes docs/performance.md. With
`--targets` only inverse kinematics to random targets is measured, and written into docs/planning.md.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import platform
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import tyro
from crew import Crew, crew
from marked import PLANNING, fill, table
from peers import PEERS
from performance_page import DOCUMENT, page, shown
from ratios import ratios
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from sections import QUICK, Effort, Section, inverse, long_loop, random_targets, steps, whole_runs
from setting import both

from eos_pin._kernels.dispatch import kernels
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.errors import InputError


def machine(team: Crew) -> dict[str, str]:
    """What all was measured on and with."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        flags = next((line for line in lines if line.startswith("flags")), "")
        processor = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
        processor += " with AVX-512" if "avx512f" in flags else ""
    except (OSError, StopIteration):
        processor = platform.processor() or platform.machine()
    found = {"processor": processor, "cores": str(os.cpu_count()), "system": platform.system()}
    found["Python"] = platform.python_version()
    found["eos_pin"] = "compiled" if kernels else "not compiled"
    return found | {name: version(name) for name in ("pin", "numpy", "scipy", "daqp")} | team.versions


def measure(team: Crew, effort: Effort, folder: Path, targets: bool) -> Iterator[Section]:
    """All tables, one after the other, or those of random targets alone."""
    settings = {name: both(name, folder) for name in effort.robots}
    for setting in () if targets else settings["panda"]:
        team.take(setting.problem())
        for made in (steps, inverse, long_loop):
            yield made(team, setting, effort)
        yield whole_runs(setting, effort)
    for whole in (False, True):
        yield random_targets(team, [pair[whole] for pair in settings.values()], effort)


def benchmark(
    *,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    targets: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    count: int | None = None,
    peers: tuple[str, ...] | None = None,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    write: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> int:
    """Time control steps, inverse kinematics and whole runs, beside other libraries.

    Args:
        quick: Few rounds, one robot, to see that all works; the figures say little.
        targets: Only inverse kinematics to random targets.
        count: How many targets for each robot and task.
        peers: Which of the installed peers; all by default.
        json_file: File for the figures.
        write: Write docs/performance.md; with `targets` the tables of docs/planning.md.
    """
    unknown = sorted({*(peers or ())} - {*PEERS})
    if unknown:
        raise InputError(f"no peer {unknown[0]!r}; there are {', '.join(PEERS)}")
    effort = QUICK if quick else Effort()
    effort = replace(effort, targets=count or effort.targets)
    sections: list[Section] = []
    bar = Progress(SpinnerColumn(), TextColumn("measuring"), TimeElapsedColumn(), console=stderr, transient=True)
    # Narrower, the tables would lose columns; in a pipe nobody minds.
    wide = Console(highlight=False, width=max(console.width, 120))
    with tempfile.TemporaryDirectory() as folder, crew(peers) as team, bar:
        bar.add_task("measuring", total=None)
        for section in measure(team, effort, Path(folder), targets):
            sections.append(section)
            rows = [[shown(cell) for cell in row] for row in section.rows]
            wide.print(grid(section.title, section.columns, rows))
        where = machine(team)
    if targets:
        if json_file is not None:
            write_json(json_file, {"machine": where, "sections": [asdict(section) for section in sections]})
        if write:
            parts = [
                f"{part.title}:\n{table(part.columns, ([shown(x) for x in row] for row in part.rows))}"
                for part in sections
            ]
            fill(PLANNING, "targets", "\n\n" + "\n".join(parts) + f"\n{sections[-1].note}\n")
        return 0
    found = ratios(sections)
    wide.print(grid("Ratios", ("what", "task", "measured", "aim", "met"), [ratio.row for ratio in found]))
    if team.missing:
        wide.print(grid("Not measured", ("what", "why"), team.missing.items()))
    if json_file is not None:
        tables = [asdict(section) for section in sections]
        figures = [asdict(ratio) for ratio in found]
        write_json(json_file, {"machine": where, "sections": tables, "ratios": figures, "missing": team.missing})
    if write:
        DOCUMENT.write_text(page(where, sections, found, team.missing), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(run(benchmark))
