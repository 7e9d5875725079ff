"""`eos-pin replay` and `eos-pin robots`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from eos_pin._files import write_atomically
from eos_pin.cli.output import (
    Output,
    console,
    grid,
    print_files,
    print_runs,
    say_notes,
    show,
    write_json,
    write_outputs,
)
from eos_pin.cli.tables import run_table
from eos_pin.errors import EosError, InputError
from eos_pin.robot.library import available_robots

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from collections.abc import Sequence

    from eos_pin.robot.model import Robot
    from eos_pin.simulation.result import Result


def replay(
    runs: tyro.conf.Positional[tuple[Path, ...]] = (),
    output: Output = Output(),
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")] = "",
) -> int:
    """Show saved runs in the browser, or write them as HTML, figure, table or JSON.

    Of several runs the first is solid and the others are ghosts at its place, or they stand side by side; their curves
    lie over each other.

    Args:
        runs: The .npz files that `eos-pin track` and `eos-pin compare` wrote.
        output: Outputs to make; by default the runs are shown in the browser.
        robot: URDF file or name of the robot, where that of the runs has moved. Only replays need it.

    For example:

      eos-pin replay runs/panda-position/run.npz
      eos-pin replay runs/panda-position/run.npz --html panda.html --plot panda.pdf
      eos-pin replay runs/panda-compare/eos.npz runs/panda-compare/task-space.npz
    """
    if not runs:
        raise InputError("a replay needs a run, such as `eos-pin replay runs/panda-position/run.npz`")
    if robot and (output.csv or output.json) and not (output.html or output.plot or output.view or output.out):
        raise InputError(f"--robot {robot} does not apply: samples and figures need no robot; leave it out")
    if len(runs) > 1:
        output.without("csv", "bag", "rerun", reason="it takes one run, not several")
    from eos_pin.simulation.result import Result

    names = {"html": "replay.html", "plot": "overview.png", "json": "summary.json"}
    files = replace(output.within(None, names=names), out=None)
    results = {name: Result.load(file) for name, file in zip(_names(runs), runs, strict=True)}
    plants: dict[str, Robot] = {}
    missing = ""
    for name, result in results.items():
        try:
            plants[name] = result.load_plant(robot)
            say_notes(plants[name])
        except EosError as error:
            if robot:
                raise
            missing = missing or str(error)
    summaries = {name: result.summary() for name, result in results.items()}
    first = next(iter(results))
    if len(runs) == 1:
        console.print(run_table(summaries[first]))
        written = write_outputs(files, results[first], plants.get(first))
    else:
        print_runs(f"{len(runs)} runs", "run", summaries)
        written = _write_several(files, results, plants, summaries)
    print_files(written)
    if missing and (files.html or output.view or not written):
        raise InputError(
            f"there is no replay without the robot: {missing.rstrip('. ')}. Give its URDF with --robot FILE; --csv, "
            "--json and --plot work without"
        )
    if not missing and (output.view or not written):
        show(results, plants)
    return 0


def _names(files: Sequence[Path]) -> list[str]:
    """Names of runs, after their files and as many folders as are needed to distinguish them."""
    paths = [file.resolve().with_suffix("").parts for file in files]
    if len(set(paths)) < len(paths):
        raise InputError(f"each run is shown once, got {', '.join(map(str, files))}")
    names: list[str] = []
    for count in range(1, max(map(len, paths)) + 1):
        names = ["/".join(parts[-count:]) for parts in paths]
        if len(set(names)) == len(names):
            break
    # Where all are called the same, the folders say it.
    return [name.removesuffix("/run") for name in names]


def _write_several(
    files: Output, results: dict[str, Result], plants: dict[str, Robot], summaries: dict[str, Any]
) -> list[Path]:
    """Write figure, JSON and replay of several runs."""
    written = []
    if files.json is not None:
        written.append(write_json(files.json, summaries))
    if files.plot is not None:
        from eos_pin.plots import pages as plots

        written.append(plots.save(plots.comparison(results, next(iter(plants.values()), None)), files.plot))
    if files.html is not None and len(plants) == len(results):
        from eos_pin.viewer.replay import replay_page, scene_of

        text = replay_page(results, {name: scene_of(run, plants[name]) for name, run in results.items()})
        write_atomically(files.html, lambda file: file.write(text.encode()))
        written.append(files.html)
    return written


def robots(name: tyro.conf.Positional[str] = "", output: Output = Output()) -> int:
    """List the robots that can be loaded by name.

    Args:
        name: Part of the names to list; all by default.
        output: Only --json and --out apply: nothing moves here.

    For example:

      eos-pin robots
      eos-pin robots panda
    """
    if any((output.html, output.plot, output.csv, output.view, output.bag, output.rerun)):
        raise InputError("a list of robots cannot be drawn; try `eos-pin info ROBOT --html FILE`")
    files = output.within(None, names={"json": "robots.json"})
    found = [robot for robot in available_robots() if name.lower() in robot.name.lower()]
    if not found:
        raise InputError(f"no robot's name contains {name!r}; `eos-pin robots` lists all")
    console.print(grid("", ("name", "file"), [(robot.name, robot.path.name) for robot in found]))
    if files.json:
        print_files([write_json(files.json, {"robots": [{"name": r.name, "path": r.path} for r in found]})])
    return 0
