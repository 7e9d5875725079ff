"""`eos-pin replay` and `eos-pin robots`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from eos_pin.cli.output import (
    Output,
    console,
    grid,
    print_files,
    run_table,
    say_notes,
    scene_of,
    show,
    write_json,
    write_outputs,
)
from eos_pin.errors import EosError, InputError
from eos_pin.robot.library import available_robots

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    pass


def replay(run: tyro.conf.Positional[Path], output: Output = Output(), robot: str = "") -> int:
    """Show a saved run in the browser, or write it as HTML, figure, table or JSON.

    Args:
        run: The .npz file that `eos-pin track` wrote.
        output: Outputs to make; by default it is shown in the browser.
        robot: URDF file or name of the robot, where that of the run has moved. Only replays need it.

    For example:

      eos-pin replay runs/panda-position/run.npz
      eos-pin replay runs/panda-position/run.npz --html panda.html --plot panda.pdf
    """
    output.without("seed", reason="the run is over")
    if robot and (output.csv or output.json) and not (output.html or output.plot or output.view or output.out):
        raise InputError(f"--robot {robot} does not apply: samples and figures need no robot; leave it out")
    from eos_pin.simulation.result import Result

    result = Result.load(run)
    plant, missing = None, ""
    try:
        plant = result.load_plant(robot)
        say_notes(plant)
    except EosError as error:
        if robot:
            raise
        missing = str(error)
    console.print(run_table(result.summary()))
    files = output.within(None, names={"html": "replay.html", "plot": "overview.png", "json": "summary.json"})
    written = write_outputs(replace(files, out=None), result, plant)
    print_files(written)
    if plant is None and (files.html or output.view or not written):
        raise InputError(
            f"there is no replay without the robot: {missing.rstrip('. ')}. Give its URDF with --robot FILE; --csv, "
            "--json and --plot work without"
        )
    if plant is not None and (output.view or not written):
        show(scene_of(result, plant), result)
    return 0


def robots(name: tyro.conf.Positional[str] = "", output: Output = Output()) -> int:
    """List the robots that can be loaded by name.

    Args:
        name: Part of the names to list; all by default.
        output: Only --json and --out apply: nothing moves here.

    For example:

      eos-pin robots
      eos-pin robots panda
    """
    output.without("seed", reason="nothing is random here")
    if any((output.html, output.plot, output.csv, output.view, output.bag, output.rerun)):
        raise InputError("a list of robots cannot be drawn; try `eos-pin info ROBOT --html FILE`")
    found = [robot for robot in available_robots() if name.lower() in robot.name.lower()]
    if not found:
        raise InputError(f"no robot's name contains {name!r}; `eos-pin robots` lists all")
    console.print(grid("", ("name", "file"), [(robot.name, robot.path.name) for robot in found]))
    files = output.within(None, names={"json": "robots.json"})
    if files.json:
        print_files([write_json(files.json, {"robots": [{"name": r.name, "path": r.path} for r in found]})])
    return 0
