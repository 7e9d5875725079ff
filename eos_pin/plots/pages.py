"""Figures of a run: pages made of a few panels, as plain `Figure` objects without a window, and `save`.

The panels are here too. Each draws on axes that you give; for your own figure, begin it inside `style()`.
"""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from eos_pin._arrays import Array, checked
from eos_pin._files import write_atomically
from eos_pin.errors import EosError, InputError, UnknownNameError
from eos_pin.plots._style import (
    LINES,
    PAGE,
    add_axes,
    colors_of,
    draw_nothing,
    shortened,
    style,
    use_decades,
)
from eos_pin.plots.keyframes import is_spatial, plot_key_frames
from eos_pin.plots.panels import (
    has_depth,
    joint_units,
    joints_at,
    key_times,
    plot_charts,
    plot_drift,
    plot_errors,
    plot_joints,
    plot_kinetic_energy,
    plot_orbit,
    plot_path,
    plot_self_motion,
    plot_task_error,
    plot_torques,
    plot_velocities,
)
from eos_pin.robot.model import Robot
from eos_pin.simulation.result import Result

__all__ = [
    "comparison",
    "joints_at",
    "key_times",
    "overview",
    "plot_charts",
    "plot_drift",
    "plot_errors",
    "plot_joints",
    "plot_key_frames",
    "plot_kinetic_energy",
    "plot_orbit",
    "plot_path",
    "plot_self_motion",
    "plot_task_error",
    "plot_torques",
    "plot_velocities",
    "save",
    "style",
    "sweep",
]


@style()
@checked
def overview(result: Result, robot: Robot | None = None) -> Figure:
    """One page with an overview of a run.

    Args:
        result: The run.
        robot: The plant; by default it is loaded again from the provenance, and left out if that fails.
    """
    robot = robot or _plant(result)
    figure = Figure((PAGE, 8.6), layout="constrained")
    grid = figure.add_gridspec(4, 2)
    plot_path(add_axes(figure, grid[0, 0], solid=has_depth(result)), result)
    if robot:
        ax = add_axes(figure, grid[0, 1], solid=is_spatial(robot, result))
        plot_key_frames(ax, result, robot, label_times=False)
    else:
        plot_drift(add_axes(figure, grid[0, 1]), result)
    plot_joints(add_axes(figure, grid[1, 0]), result, robot)
    plot_orbit(add_axes(figure, grid[1, 1], solid=result.q.shape[1] == 3), result, robot)
    ax = add_axes(figure, grid[2, 0])
    if result.v.size:
        plot_self_motion(ax, result, robot)
        plot_charts(ax, result)
    else:
        plot_drift(ax, result, robot)
    ax = add_axes(figure, grid[2, 1])
    if np.isfinite(result.error).any() or np.isfinite(result.self_motion_error).any():
        plot_errors(ax, result)
    else:
        plot_drift(ax, result, robot)
    known = bool(np.isfinite(result.tau).any())
    (plot_torques if known else plot_velocities)(add_axes(figure, grid[3, 0]), result, robot)
    plot_kinetic_energy(add_axes(figure, grid[3, 1]), result)
    names = [result.info.get(key, {}).get(word, "") for key, word in (("robot", "name"), ("controller", "kind"))]
    title = ", ".join(word for word in (*names, result.message or result.status) if word)
    figure.suptitle(textwrap.fill(title, 110), parse_math=False)
    return figure


@style()
@checked
def comparison(results: Mapping[str, Result], robot: Robot | None = None) -> Figure:
    """Several controllers on the same robot and path: task error, joint drift, kinetic energy, and each one's orbit.

    Args:
        results: Runs by name. The names in `BASELINES` and `"eos"` keep their colours in every figure.
        robot: The plant; by default it is loaded again from the provenance, and left out if that fails.
    """
    if not results:
        raise InputError("a comparison needs at least one run")
    robot = robot or _plant(next(iter(results.values())))
    columns = min(len(results), 4)
    rows = math.ceil(len(results) / columns)
    figure = Figure((PAGE, 2.4 + 1.9 * rows), layout="constrained")
    outer = figure.add_gridspec(2, 1, height_ratios=(1.9, 1.8 * rows))
    top, orbits = outer[0].subgridspec(1, 3), outer[1].subgridspec(rows, columns)
    axes = [add_axes(figure, top[i]) for i in range(3)]
    plot_task_error(axes[0], results)
    plot_drift(axes[1], results, robot)
    plot_kinetic_energy(axes[2], results)
    names = [shortened(name) for name in results]
    figure.legend(axes[2].lines, names, loc="outside upper center", ncols=4)
    for k, (name, result, color) in enumerate(zip(names, results.values(), colors_of(results), strict=True)):
        ax = add_axes(figure, orbits[divmod(k, columns)])
        plot_orbit(ax, result, robot, color=color)
        drift = result.joint_drift_per_cycle
        last = f"\nlast drift {drift[-1]:.2g} {' or '.join(joint_units(robot))}" if len(drift) else ""
        ax.set_title(f"{name}{last}", fontsize=7, color=color)
        ax.locator_params(nbins=4)
        ax.xaxis.label.set_fontsize(7)
        ax.yaxis.label.set_fontsize(7)
    return figure


#: What the figure of a sweep shows: column of the table and label.
SWEPT = {
    "task_error_max": "task error [m, rad]",
    "self_motion_error_max": "self-motion error [rad, m]",
    "last_drift": "joint drift, last cycle [rad, m]",
    "torque_max": "largest torque [N m, N]",
}


@style()
@checked
def sweep(rows: Sequence[Mapping[str, Any]], over: Sequence[str]) -> Figure:
    """Chief figures of many runs over one setting, a colour for each combination of the others.

    Dots are medians of the runs that finished, bars hold all of these. The setting drawn along the axis is the one with
    the most values; numbers come before words.

    Args:
        rows: Rows that `eos_pin.sweep` returned.
        over: Names of the settings that differ from run to run, besides the seed.
    """
    if not rows:
        raise InputError("a figure of a sweep needs at least one run")
    for row in rows:
        for name in (*(over or ["robot"]), "status", *(SWEPT if row.get("status") == "finished" else ())):
            if name not in row:
                raise UnknownNameError("column in each run", str(name), [str(key) for key in row])
    values = {name: list(dict.fromkeys(row[name] for row in rows)) for name in over or ["robot"]}
    along = max(values, key=lambda name: (not isinstance(values[name][0], str), len(values[name])))
    places, joined = values[along], not isinstance(values[along][0], str)
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        name = ", ".join(f"{_words(other)} {_words(row[other])}" for other in values if other != along)
        groups.setdefault(name, []).append(row)
    colors = LINES if len(groups) <= len(LINES) else colormaps["viridis"](np.linspace(0.0, 0.92, len(groups)))
    figure = Figure((PAGE, 5.4), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    for k, (column, label) in enumerate(SWEPT.items()):
        ax = add_axes(figure, grid[divmod(k, 2)])
        for i, (name, some) in enumerate(groups.items()):
            x, low, middle, high = _spread(some, along, places, column)
            x += 0.3 * ((i + 0.5) / len(groups) - 0.5)
            ax.errorbar(
                x,
                middle,
                (middle - low, high - middle),
                fmt="o-" if joined else "o",
                markersize=3,
                linewidth=0.8,
                color=colors[i],
                label=shortened(name, 60),
            )
        if not any(np.size(line.get_xdata()) for line in ax.lines):
            draw_nothing(ax, f"no {label.split(' [')[0]}")
            continue
        use_decades(ax)
        ax.set_xticks(range(len(places)), [shortened(_words(place)) for place in places])
        ax.set_xlim(-0.5, len(places) - 0.5)
        ax.set_xlabel(_words(along))
        ax.set_ylabel(label)
    if len(groups) > 1:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2 if len(groups) > 3 else 1)
    return figure


def _spread(rows: Sequence[Mapping[str, Any]], along: str, places: Sequence[Any], column: str) -> Array:
    """Place, least, median and largest of a figure, a column for each place that has one; (4, places)."""
    found = []
    for i, place in enumerate(places):
        own = [row[column] for row in rows if row[along] == place and row["status"] == "finished"]
        own = [x for x in own if x is not None]
        if own:
            found.append((i, min(own), np.median(own), max(own)))
    return np.array(found, dtype=float).reshape(-1, 4).T


def _words(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")


@checked
def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG (200 dots per inch), PDF or SVG; equal figures give equal files.

    Raises:
        InputError: The suffix is none of these.
        OutputError: The file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower().removeprefix(".")
    undated: dict[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    if suffix not in undated:
        raise InputError(f"cannot write a figure as {path.name!r}: its name must end in .png, .pdf or .svg")
    with style(), warnings.catch_warnings():
        # Letters that the font lacks are drawn as boxes; that is to be seen, and needs no line on the terminal.
        warnings.filterwarnings("ignore", "Glyph ")
        write_atomically(path, lambda file: figure.savefig(file, format=suffix, metadata=undated[suffix]))
    return path


def _plant(result: Result) -> Robot | None:
    try:
        return result.load_plant()
    except EosError:
        return None
