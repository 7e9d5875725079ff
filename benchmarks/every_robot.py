"""Every robot at hand, every branch: does EOS control run on it, and if not, why not?

    python benchmarks/every_robot.py [--robots NAME ...] [--quick] [--json FILE] [--write]

For each URDF that can be loaded by name and each of its leaf links, the chain of joints to it follows the path that
`eos-pin track` would choose, for a position and, from six joints on, for a pose. Leaves behind the same joints count
once. Every run has a time limit, and what C++ writes on the terminal meanwhile is caught and counted.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import tyro
from confined import captured, time_limit
from joblib import Parallel, delayed
from rich.progress import Progress

from eos_pin import EosController, EosError, available_robots, load_robot, simulate
from eos_pin.cli.main import run
from eos_pin.cli.output import (
    console,
    format_number,
    grid,
    stderr,
    write_json,
)
from eos_pin.errors import InputError
from eos_pin.experiments.applicability import TaskKind
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.robot.library import NamedRobot
from eos_pin.robot.reading.urdf import read_urdf

DOCUMENT = Path(__file__).parent.parent / "docs" / "robots.md"
#: A pose needs this many joints.
POSE_JOINTS = 6
#: A run that takes longer than this counts as hanging [s].
TIME_LIMIT = 60.0
#: A run counts only with an error below this [m, rad].
ACCURATE = 1e-6


@dataclass(frozen=True)
class Row:
    """What became of one chain and task.

    Attributes:
        robot: Name of the robot.
        frame: Leaf link at the end of the chain; empty if the file could not be read.
        n: Joints of the chain.
        task: Kind of task, and its coordinates once it is made.
        result: `"ran"`, `"refused"` by an `EosError`, `"ended"` early, `"inaccurate"`, `"crashed"` or `"hung"`.
        reason: Why it did not run.
        error: Largest task error of the whole run [m, rad].
        said: What C++ wrote on the terminal.
        seconds: Wall time.
    """

    robot: str
    frame: str
    n: int
    task: str
    result: str = "ran"
    reason: str = ""
    error: float | None = None
    said: str = ""
    seconds: float = 0.0


def rows_of(robot: NamedRobot) -> list[Row]:
    """Every chain and task of a robot that is to be tried; one row without a frame if its file cannot be read."""
    try:
        urdf = read_urdf(robot.path)
    except EosError as error:
        return [Row(robot.name, "", 0, "", "refused", _plain(error, robot.path))]
    inner = {joint.parent for joint in urdf.joints.values()}
    leaves = [str(link.get("name")) for link in urdf.root.findall("link") if link.get("name") not in inner]
    # The first leaf behind the same joints stands for the others.
    chains = {urdf.chain(leaf): leaf for leaf in reversed(leaves)}
    rows = []
    for joints, leaf in sorted(chains.items(), key=lambda item: leaves.index(item[1])):
        kinds = ("position", "pose") if len(joints) >= POSE_JOINTS else ("position",)
        rows += [Row(robot.name, leaf, len(joints), kind) for kind in kinds]
    return rows


def attempt(row: Row, path: Path, duration: float, limit: float) -> Row:
    """Run one chain in a process of its own, with a time limit, and nothing on its terminal."""
    start = time.perf_counter()
    with captured() as said:
        try:
            with time_limit(limit):
                row = _ran(row, duration)
        except EosError as error:
            row = replace(row, result="refused", reason=_plain(error, path))
        except TimeoutError as error:
            row = replace(row, result="hung", reason=str(error))
        except Exception as error:
            row = replace(row, result="crashed", reason=f"{type(error).__name__}: {error}")
    return replace(row, said="".join(said), seconds=time.perf_counter() - start)


def _ran(row: Row, duration: float) -> Row:
    robot = load_robot(row.robot, chain_to=row.frame)
    kind: TaskKind = "pose" if row.task == "pose" else "position"
    task = make_task(robot, kind, frame=row.frame)
    q = rest_posture(task)
    reference = fitting_path(task, q)
    # Started with the velocity of the path there is no transient, and every sample counts.
    chart = EosController(task, reference).start(0.0, q, 0.0 * q).chart
    dq = chart.acceleration(task.linearize(q)[1], reference(0.0).dz, 0.0 * chart.v_bar)
    result = simulate(robot, EosController(task, reference), q, dq, duration=duration)
    error = float(abs(result.error).max())
    row = replace(row, task=f"{row.task} {','.join(task.labels)}", error=error)
    if not result.ok:
        return replace(row, result="ended", reason=f"{result.status}: {result.message}")
    return row if error < ACCURATE else replace(row, result="inaccurate", reason=f"task error {format_number(error)}")


def every_robot(
    *,
    robots: tuple[str, ...] = (),
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    write: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    duration: float = 2.0,
    limit: float = TIME_LIMIT,
) -> int:
    """Run EOS control on every chain of every robot; a table of what ran, and the reason for what did not.

    Args:
        robots: Names of robots (see `eos-pin robots`); all by default.
        quick: Only the chain with most joints of each robot.
        json_file: File for all rows, machine-readable.
        write: Write docs/robots.md.
        duration: Length of each run [s].
        limit: Time limit of each run [s].
    """
    known = {robot.name: robot for robot in available_robots()}
    if unknown := [name for name in robots if name not in known]:
        raise InputError(f"no robot is named {', '.join(unknown)}; `eos-pin robots` lists all")
    planned = [row for name in robots or known for row in _chosen(rows_of(known[name]), quick)]
    jobs = [row for row in planned if row.result != "refused"]
    done: dict[tuple[str, str, str], Row] = {}
    with Progress(console=stderr, transient=True) as progress:
        bar = progress.add_task("every robot", total=len(jobs))
        pool = Parallel(n_jobs=2, return_as="generator_unordered", timeout=10.0 * limit)
        calls = (delayed(_keyed)(row, known[row.robot].path, duration, limit) for row in jobs)
        for key, row in pool(calls):
            done[key] = row
            progress.update(bar, advance=1, description=row.robot)
    rows = [done.get(_key(row), row) for row in planned]
    console.print(grid("Every robot", ("robot", "branches", "position", "pose", "worst error"), summary(rows)))
    refused = [row for row in rows if row.result != "ran"]
    for row in refused:
        console.print(f"{row.robot} {row.frame} {row.task}: {row.result}: {row.reason}", markup=False, soft_wrap=True)
    noise = sum(len(row.said) for row in rows)
    worst = max((row.error or 0.0 for row in rows if row.result == "ran"), default=0.0)
    verdict = (
        f"{len(rows) - len(refused)} of {len(rows)} ran, the others give reasons; worst error {format_number(worst)}; "
        f"{noise} characters on the terminal; slowest {max(row.seconds for row in rows):.1f} s"
    )
    console.print(verdict)
    if json_file is not None:
        write_json(json_file, {"rows": [asdict(row) for row in rows]})
    if write:
        DOCUMENT.write_text(document(rows, verdict), encoding="utf-8")
    return int(noise > 0 or any(row.result not in ("ran", "refused") for row in rows))


def summary(rows: Sequence[Row]) -> list[tuple[Any, ...]]:
    """A line for each robot."""
    lines = []
    for robot, group in groupby(rows, key=lambda row: row.robot):
        own = list(group)
        counts = []
        for kind in ("position", "pose"):
            tried = [row for row in own if row.task.startswith(kind)]
            ran = sum(row.result == "ran" for row in tried)
            counts.append(f"{ran} of {len(tried)}" if tried else "-")
        errors = [row.error for row in own if row.result == "ran" and row.error is not None]
        branches = len({row.frame for row in own if row.frame})
        lines.append((robot, branches, *counts, max(errors) if errors else "-"))
    return lines


def document(rows: Sequence[Row], verdict: str) -> str:
    """The page docs/robots.md."""
    lines = [
        "# Every robot",
        "",
        "Written by `python benchmarks/every_robot.py --write`. " + " ".join(str(__doc__).split("\n\n")[2].split()),
        "",
        f"{verdict}.",
        "",
        "| robot | branches | position ran | pose ran | worst task error [m, rad] |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {branches} | {position} | {pose} | {error if isinstance(error, str) else format_number(error)} |"
        for name, branches, position, pose, error in summary(rows)
    ]
    failed = [row for row in rows if row.result != "ran"]
    fixed = [row for row in failed if row.frame and not row.n]
    # One line for a link that refuses position and pose for one reason.
    reasons: dict[tuple[str, str, str], list[str]] = {}
    for row in failed:
        if row not in fixed:
            reasons.setdefault((row.robot, row.frame, row.reason), []).append(row.task.split()[0] if row.task else "")
    lines += ["", "## What did not run, and why", ""]
    lines += [f"{len(fixed)} leaf links are fixed to the base, which has no joint to control. The others:", ""]
    lines += ["| robot | link | task | reason |", "|---|---|---|---|"]
    for (robot, frame, reason), tasks in reasons.items():
        lines.append(f"| {robot} | {frame} | {', '.join(tasks)} | {reason.replace('|', '/').replace('<', '&lt;')} |")
    return "\n".join(lines) + "\n"


def _chosen(rows: list[Row], quick: bool) -> list[Row]:
    most = max(row.n for row in rows)
    frame = next(row.frame for row in rows if row.n == most)
    return [row for row in rows if row.frame == frame] if quick else rows


def _key(row: Row) -> tuple[str, str, str]:
    return row.robot, row.frame, row.task


def _keyed(row: Row, path: Path, duration: float, limit: float) -> tuple[tuple[str, str, str], Row]:
    return _key(row), attempt(row, path, duration, limit)


def _plain(error: Exception, path: Path) -> str:
    """Message without the folder that this machine has the file in."""
    return str(error).replace(str(path), path.name)


if __name__ == "__main__":
    sys.exit(run(every_robot))
