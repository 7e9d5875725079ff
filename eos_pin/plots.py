"""Figures of a run: panels `plot_…` that draw on axes you give them, and pages made of a few panels each.

Pages are plain `Figure` objects without a window. A colour means the same in every panel: grey is what was asked for,
blue what happened, vermilion a limit or an obstacle, and each controller keeps its own. The colours are those of Okabe
and Ito, which people with any kind of colour vision tell apart.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib
import matplotlib.style
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from eos_pin.arrays import Array, Vector, VectorLike
from eos_pin.errors import EosError, InputError
from eos_pin.loading import leaf_frames
from eos_pin.files import write_atomically
from eos_pin.results import Result
from eos_pin.robot import Robot

#: Widths of a column and of a page of a two-column paper [in].
COLUMN, PAGE = 3.4, 7.0

#: Everything that differs from matplotlib's own defaults, in sizes that are read in a two-column paper.
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "figure.titlesize": 8.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "grid.linewidth": 0.4,
    "lines.linewidth": 1.1,
    "lines.solid_capstyle": "round",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "legend.frameon": False,
    "legend.handlelength": 1.2,
    "legend.handletextpad": 0.4,
    "legend.columnspacing": 1.0,
    "legend.borderaxespad": 0.2,
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,
    "svg.hashsalt": "eos_pin",
}

BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY, BLACK, OLIVE = "#CC79A7", "#56B4E9", "#000000", "#9A8F00"
ACTUAL, REFERENCE, LIMIT, MARK, LINK = BLUE, "#B5B5B5", VERMILION, "#C8C8C8", "#30343B"
LINES = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, OLIVE)
CONTROLLERS = {
    "eos": BLUE,
    "task-space": VERMILION,
    "task-space-energy": ORANGE,
    "null-space-damping": PURPLE,
    "null-space-posture": GREEN,
    "without-drift": SKY,
    "set-point": BLACK,
}

#: Discs in the drawing plane (x, y, radius) [m], or a function of time [s] that gives them.
Obstacles: TypeAlias = Sequence[Sequence[float]] | Callable[[float], Sequence[Sequence[float]]]


@contextmanager
def style() -> Iterator[None]:
    """Context in which figures look like ours, whatever the user's matplotlibrc says."""
    with matplotlib.style.context(["default", STYLE]):
        yield


# -- panels ----------------------------------------------------------------------------------------------------------


def plot_path(ax: Axes, result: Result) -> None:
    """Task path against its reference; a task that is no path in space is drawn over time.

    On plane axes a spatial path is seen along the axis of its smallest extent; on 3-D axes it is drawn whole.
    """
    names = _places(result.info.get("task") or {})
    if not result.z.size:
        return _nothing(ax, "no task")
    if len(names) < 2:
        ax.plot(result.t, result.z_ref, color=REFERENCE, linewidth=2.5)
        _lines(ax, result.t, result.z, "z")
        _time_axis(ax, result)
        ax.set_ylabel(f"task point {_in(_task_units(result))}")
        return None
    columns = _largest(_path(result), 3 if _is_3d(ax) else 2)
    ax.plot(*result.z_ref[:, columns].T, color=REFERENCE, linewidth=2.5, label="reference")
    ax.plot(*result.z[:, columns].T, color=ACTUAL, label="actual")
    ax.plot(*result.z[:1, columns].T, "o", color=ACTUAL, markerfacecolor="white", markersize=4, label="start")
    _name_axes(ax, [f"{names[i]} [m]" for i in columns], equal=True)
    _legend(ax, 3)
    return None


def plot_joints(ax: Axes, result: Result, robot: Robot | None = None, *, per_cycle: int = 1) -> None:
    """Joints over time, with a grey line and dots at each exact 1/`per_cycle` of the reference's period."""
    colors = _lines(ax, result.t, result.q, "q")
    times = key_times(result, per_cycle=per_cycle) if result.cycles else np.zeros(0)
    # More marks than these would be a grey area.
    times = times[:: 1 + len(times) // 50]
    for t in times:
        ax.axvline(t, color=MARK, linewidth=0.5, zorder=0)
    for color, row in zip(colors, at(result, times).T, strict=True):
        ax.plot(times, row, "o", color=color, markersize=2.2)
    _time_axis(ax, result)
    ax.set_ylabel(f"joints {_in(_joint_units(robot))}")


def plot_orbit(
    ax: Axes,
    result: Result,
    robot: Robot | None = None,
    *,
    joints: Sequence[int] | None = None,
    color: str = ACTUAL,
) -> None:
    """Motion in joint space, each cycle darker than the one before, with a dot at each exact multiple of the period.

    A cyclic motion is one closed curve through one dot.

    Args:
        ax: Plane or 3-D axes.
        result: The run.
        robot: The plant, for the units.
        joints: Two or three joints to draw, counted from 0. By default all, if they are as many as `ax` has
            dimensions, and else the principal directions of the motion after transients.
        color: Colour of the orbit.
    """
    points, names = _projection(result, 3 if _is_3d(ax) else 2, joints, _in(_joint_units(robot)))
    rows = list(result.cycle_rows) if result.cycles else [0]
    rows += [len(result.t) - 1] if rows[-1] < len(result.t) - 1 else []
    shades = np.linspace(0.3 if len(rows) > 2 else 1.0, 1.0, max(len(rows) - 1, 1))
    for first, last, shade in zip(rows, rows[1:], shades, strict=False):
        ax.plot(*points[first : last + 1].T, color=_faded(color, shade))
    if result.cycles:
        ax.plot(*points[result.cycle_rows].T, "o", color=BLACK, markersize=2.5, zorder=5, label="whole periods")
    ax.plot(*points[:1].T, "o", color=BLACK, markerfacecolor="white", markersize=4, zorder=6, label="start")
    _name_axes(ax, names)


def plot_self_motion(ax: Axes, result: Result, robot: Robot | None = None) -> None:
    """Self-motion coordinates v against v_ref over time."""
    if not result.v.size:
        return _nothing(ax, "no self-motion coordinates")
    if np.isfinite(result.v_ref).any():
        ax.plot(result.t, result.v_ref[:, :1], color=REFERENCE, linewidth=2.5, label="reference")
        ax.plot(result.t, result.v_ref[:, 1:], color=REFERENCE, linewidth=2.5)
    _lines(ax, result.t, result.v, "v")
    _time_axis(ax, result)
    ax.set_ylabel(f"self-motion {_in(_joint_units(robot))}")
    return None


def plot_charts(ax: Axes, result: Result) -> None:
    """Charts on a time axis: a band and a number for each, a line where one is left for the next."""
    if not len(result.switches):
        return
    edges = np.concatenate((result.t[:1], result.switches, result.t[-1:]))
    for k, (start, end) in enumerate(zip(edges, edges[1:], strict=False)):
        if k % 2:
            ax.axvspan(start, end, color="#F2F2F2", zorder=-1, linewidth=0)
        if end - start > 0.025 * (edges[-1] - edges[0]):
            number = result.chart[min(np.searchsorted(result.t, 0.5 * (start + end)), len(result.t) - 1)]
            ax.text(
                0.5 * (start + end), 0.99, str(number), transform=ax.get_xaxis_transform(),
                ha="center", va="top", fontsize=6, color="#606060",
            )  # fmt: skip
    for t in result.switches:
        ax.axvline(t, color=VERMILION, linewidth=0.6, linestyle=":", zorder=0)
    _time_axis(ax, result)


def plot_errors(ax: Axes, result: Result) -> None:
    """Task error by unit, and self-motion error, as norms on a logarithmic axis over time."""
    units = np.array(_task_units(result) or ["m, rad"] * result.error.shape[1])
    names = {"m": "position", "rad": "rotation"}
    curves = [
        (f"{names.get(unit, 'task')} [{unit}]", result.error[:, units == unit], color)
        for unit, color in zip(dict.fromkeys(units), (ACTUAL, VERMILION), strict=False)
    ]
    curves.append(("self-motion", result.self_motion_error, GREEN))
    curves = [curve for curve in curves if np.isfinite(curve[1]).any()]
    if not curves:
        return _nothing(ax, "nothing was asked for")
    for name, error, color in curves:
        ax.semilogy(result.t, _positive(np.linalg.norm(error, axis=1)), color=color, label=name)
    _time_axis(ax, result)
    ax.set_ylabel("error")
    _legend(ax, 3)
    return None


def plot_task_error(ax: Axes, results: Mapping[str, Result]) -> None:
    """Norm of the task error of several runs on a logarithmic axis over time."""
    for (name, result), color in zip(results.items(), colors_of(results), strict=True):
        if np.isfinite(result.error).any():
            ax.semilogy(result.t, _positive(np.linalg.norm(result.error, axis=1)), color=color, label=name)
    _time_axis(ax, *results.values())
    ax.set_ylabel(f"task error {_in(_task_units(next(iter(results.values()))))}")


def plot_kinetic_energy(ax: Axes, results: Result | Mapping[str, Result]) -> None:
    """Kinetic energy of one run, or of several by name, over time; logarithmic where they differ by orders."""
    runs = results if isinstance(results, Mapping) else {"": results}
    colors = colors_of(runs) if isinstance(results, Mapping) else [ACTUAL]
    for (name, result), color in zip(runs.items(), colors, strict=True):
        ax.plot(result.t, result.kinetic_energy, color=color, label=name or None)
    means = [mean for result in runs.values() if (mean := result.mean(result.kinetic_energy)) > 0.0]
    if means and max(means) > 30.0 * min(means):
        ax.set_yscale("log")
        # Where a motion turns, its energy is zero; that is no reason to show ten decades.
        ax.set_ylim(bottom=1e-3 * min(means))
    else:
        ax.set_ylim(bottom=0.0)
    _time_axis(ax, *runs.values())
    ax.set_ylabel("kinetic energy [J]")


def plot_drift(ax: Axes, results: Result | Mapping[str, Result], robot: Robot | None = None) -> None:
    """Largest change of a joint over each cycle, measured between exact multiples of the period."""
    runs = results if isinstance(results, Mapping) else {"": results}
    if not any(result.cycles for result in runs.values()):
        return _nothing(ax, "no complete cycle")
    for (name, result), color in zip(runs.items(), colors_of(runs), strict=True):
        drift = result.joint_drift_per_cycle
        ax.semilogy(1 + np.arange(len(drift)), _positive(drift), "o-", color=color, markersize=3, label=name or None)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("cycle")
    ax.set_ylabel(f"joint drift {_in(_joint_units(robot))}")
    return None


def plot_torques(ax: Axes, result: Result, robot: Robot | None = None) -> None:
    """Torques over time, with what the joints cannot give shaded.

    Where the joints have different limits, each torque is drawn relative to its own.
    """
    effort = robot.effort if robot else np.full(result.tau.shape[1], np.inf)
    limits = np.unique(effort[np.isfinite(effort)])
    relative = len(limits) > 1 and bool(np.isfinite(effort).all())
    tau, limits = (result.tau / effort, np.ones(1)) if relative else (result.tau, limits)
    _lines(ax, result.t, tau, "\\tau")
    low, high = ax.get_ylim()
    for limit in limits:
        # A limit that is far away would flatten the curves; it is named instead.
        if limit < 1.5 * np.abs(tau).max(initial=0.0):
            low, high = min(low, -1.1 * limit), max(high, 1.1 * limit)
        for side in (-1.0, 1.0):
            ax.axhspan(side * limit, side * 1e3 * limit, color=LIMIT, alpha=0.15, linewidth=0)
            ax.axhline(side * limit, color=LIMIT, linewidth=0.7, linestyle="--")
    ax.set_ylim(low, high)
    _time_axis(ax, result)
    unit = _in([{"m": "N", "rad": "N m"}[u] for u in _joint_units(robot)])
    far = f" (limit {limits[0]:g})" if len(limits) == 1 and not relative and limits[0] > max(-low, high) else ""
    ax.set_ylabel("torque / limit" if relative else f"torque {unit}{far}")


def plot_key_frames(
    ax: Axes,
    result: Result,
    robot: Robot,
    *,
    times: VectorLike | None = None,
    trace: Sequence[str] | None = None,
    obstacles: Obstacles = (),
) -> None:
    """The robot at some times in one picture, earlier ones fading, with the path of its tip between them.

    Bodies are lines between the origins of joints, travels of sliders thin ones. On plane axes the robot is seen along
    the axis of its smallest extent, which for a planar robot is the one across its plane.

    Args:
        ax: Plane or 3-D axes.
        result: The run.
        robot: The plant.
        times: Times to draw [s]; by default eight in the last complete cycle, and its end.
        trace: Frames whose paths are drawn; by default that of the task, or else all ends of the robot.
        obstacles: Discs to draw; with a function of time they fade as the robot does. On plane axes only.
    """
    if times is None:
        times = key_times(result, per_cycle=8, first=max(result.cycles - 1, 0))
    times = np.asarray(times, dtype=float)
    task = result.info.get("task") or {}
    if trace is None:
        trace = [task["frame"]] if task.get("frame") else leaf_frames(robot)
    links = _links(robot)
    names = list(dict.fromkeys(name for link in links for name in link[:2]))
    points = [{name: robot.placement(q, name).translation for name in names} for q in at(result, times)]
    columns = _largest(np.array([list(p.values()) for p in points]).reshape(-1, 3), 3 if _is_3d(ax) else 2)
    discs = obstacles if callable(obstacles) else None
    for disc in () if callable(obstacles) else obstacles:
        ax.add_patch(Circle((disc[0], disc[1]), disc[2], color=_faded(LIMIT, 0.5), zorder=1))
    for t, point, shade in zip(times, points, np.linspace(0.15, 1.0, len(times)) ** 1.5, strict=True):
        for disc in discs(t) if discs else ():
            ax.add_patch(Circle((disc[0], disc[1]), disc[2], color=_faded(LIMIT, 0.5 * shade), zorder=1))
        for start, end, slides in links:
            line = np.array([point[start], point[end]])[:, columns]
            width, color = (0.7, "#8A8F98") if slides else (1.8, LINK)
            ax.plot(*line.T, color=_faded(color, shade), linewidth=width, zorder=2)
            dot = "s" if slides else "o"
            ax.plot(*line[1:].T, dot, color=_faded(color, shade), markersize=2.4, markerfacecolor="white", zorder=3)
    axes = _places(task)
    if task.get("kind") in ("position", "pose") and all("xyz"[i] in axes for i in columns):
        rows = [axes.index("xyz"[i]) for i in columns]
        ax.plot(*result.z_ref[:, rows].T, color=REFERENCE, linewidth=2.5, zorder=1, label="reference")
    span = np.linspace(times[0], times[-1], 300) if len(times) else times
    for k, name in enumerate(trace):
        path = np.array([robot.placement(q, name).translation for q in at(result, span)]).reshape(-1, 3)[:, columns]
        ax.plot(*path.T, color=(ACTUAL, ORANGE, GREEN, PURPLE)[k % 4], zorder=4, label=f"path of {name}")
    _name_axes(ax, [f"{'xyz'[i]} [m]" for i in columns], equal=True)
    _legend(ax, 2)


# -- pages -----------------------------------------------------------------------------------------------------------


@style()
def overview(result: Result, robot: Robot | None = None) -> Figure:
    """One page with what a person wants to see of a run.

    Args:
        result: The run.
        robot: The plant; by default it is loaded again from the provenance, and left out if that fails.
    """
    robot = robot or _plant(result)
    figure = Figure((PAGE, 8.6), layout="constrained")
    grid = figure.add_gridspec(4, 2)
    plot_path(_axes(figure, grid[0, 0], _has_depth(result)), result)
    if robot:
        plot_key_frames(_axes(figure, grid[0, 1]), result, robot)
    else:
        plot_drift(_axes(figure, grid[0, 1]), result)
    plot_joints(_axes(figure, grid[1, 0]), result, robot)
    plot_orbit(_axes(figure, grid[1, 1], result.q.shape[1] == 3), result, robot)
    ax = _axes(figure, grid[2, 0])
    plot_self_motion(ax, result, robot)
    plot_charts(ax, result)
    plot_errors(_axes(figure, grid[2, 1]), result)
    plot_torques(_axes(figure, grid[3, 0]), result, robot)
    plot_kinetic_energy(_axes(figure, grid[3, 1]), result)
    info = result.info
    about = [info.get(key, {}).get(name, "") for key, name in (("robot", "name"), ("controller", "kind"))]
    title = ", ".join(word for word in (*about, result.message or result.status) if word)
    figure.suptitle(textwrap.fill(title, 110), parse_math=False)
    return figure


@style()
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
    figure = Figure((PAGE, 2.5 + 1.9 * rows), layout="constrained")
    outer = figure.add_gridspec(2, 1, height_ratios=(1.9, 1.75 * rows))
    top, orbits = outer[0].subgridspec(1, 3), outer[1].subgridspec(rows, columns)
    axes = [_axes(figure, top[i]) for i in range(3)]
    plot_task_error(axes[0], results)
    plot_drift(axes[1], results, robot)
    plot_kinetic_energy(axes[2], results)
    handles = {line.get_label(): line for ax in axes for line in reversed(ax.lines)}
    figure.legend(
        [handles[name] for name in results if name in handles],
        [name for name in results if name in handles],
        loc="outside upper center",
        ncols=4,
    )
    for k, ((name, result), color) in enumerate(zip(results.items(), colors_of(results), strict=True)):
        ax = _axes(figure, orbits[divmod(k, columns)], result.q.shape[1] == 3)
        plot_orbit(ax, result, robot, color=color)
        drift = result.joint_drift_per_cycle
        last = f"\nlast drift {drift[-1]:.1e}" if len(drift) else ""
        ax.set_title(f"{name}{last}", fontsize=7, color=color, parse_math=False)
    return figure


@style()
def tracking(result: Result, robot: Robot | None = None) -> Figure:
    """Task path against its reference, beside the motion in joint space."""
    figure = Figure((PAGE, 3.0), layout="constrained")
    left, right = figure.add_gridspec(1, 2)
    plot_path(_axes(figure, left, _has_depth(result)), result)
    plot_orbit(_axes(figure, right, result.q.shape[1] == 3), result, robot)
    return figure


@style()
def motion(
    result: Result,
    robot: Robot,
    *,
    per_cycle: int = 1,
    times: VectorLike | None = None,
    trace: Sequence[str] | None = None,
    obstacles: Obstacles = (),
) -> Figure:
    """Joints over time, beside key frames of the robot; the arguments are those of the two panels."""
    figure = Figure((PAGE, 3.0), layout="constrained")
    left, right = figure.add_gridspec(1, 2)
    plot_joints(_axes(figure, left), result, robot, per_cycle=per_cycle)
    plot_key_frames(_axes(figure, right), result, robot, times=times, trace=trace, obstacles=obstacles)
    return figure


@style()
def kinetic_energies(results: Mapping[str, Result]) -> Figure:
    """Kinetic energies of several runs in one plot, one column wide."""
    figure = Figure((COLUMN, 2.4), layout="constrained")
    ax = figure.add_subplot()
    plot_kinetic_energy(ax, results)
    _legend(ax, 3)
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG (200 dots per inch), PDF or SVG; equal figures give equal files.

    Raises:
        InputError: The suffix is none of these.
        ResultError: The file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower().removeprefix(".")
    undated: dict[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    if suffix not in undated:
        raise InputError(f"cannot write a figure as {path.name!r}: its name must end in .png, .pdf or .svg")
    with style():
        write_atomically(path, lambda file: figure.savefig(file, format=suffix, metadata=undated[suffix]))
    return path


# -- parts -----------------------------------------------------------------------------------------------------------


def key_times(result: Result, *, per_cycle: int = 1, first: int = 0, last: int | None = None) -> Vector:
    """Times at regular fractions of the period, from the start of cycle `first` to the end of the complete cycles.

    Args:
        result: The run.
        per_cycle: Times in each cycle.
        first: Cycles to leave out at the start.
        last: Cycle to end before; by default all complete ones count. A run without a complete cycle counts as one.
    """
    period = result.period if result.cycles else float(np.ptp(result.t)) if len(result.t) else 0.0
    last = max(result.cycles, 1) if last is None else last
    start = result.t[0] if len(result.t) else 0.0
    return start + period * np.arange(first * per_cycle, last * per_cycle + 1) / per_cycle


def at(result: Result, times: VectorLike) -> Float[Array, "K n"]:
    """Joints at any times, interpolated between the samples [rad or m]."""
    rows = [np.interp(times, result.t, q) for q in result.q.T]
    return np.array(rows).T.reshape(-1, result.q.shape[1])


def colors_of(names: Mapping[str, Any] | Sequence[str]) -> list[str]:
    """A colour for each controller: its own if it has one, and else one that no other has."""
    own = [CONTROLLERS.get(name.lower()) for name in names]
    free = [color for color in LINES if color not in own] or list(LINES)
    spare = iter(free * len(own))
    return [color or next(spare) for color in own]


def _lines(ax: Axes, t: Vector, values: Float[Array, "T n"], symbol: str) -> list[Any]:
    """A curve for each column with a legend above; a colour scale beside instead where they are many."""
    n = values.shape[1]
    many = n > len(LINES)
    colors = list(matplotlib.colormaps["viridis"](np.linspace(0.0, 0.92, n))) if many else list(LINES[:n])
    for i, color in enumerate(colors):
        ax.plot(t, values[:, i], color=color, label=None if many else f"${symbol}_{{{i + 1}}}$")
    if many:
        scale = ScalarMappable(BoundaryNorm(np.arange(n + 1) + 0.5, n), ListedColormap(colors))
        ticks = np.unique(np.linspace(1, n, 6).round().astype(int))
        bar = ax.figure.colorbar(scale, ax=ax, ticks=ticks, aspect=30, pad=0.02, fraction=0.05)
        bar.ax.set_yticklabels([f"${symbol}_{{{i}}}$" for i in ticks])
        bar.ax.tick_params(length=0)
        bar.outline.set_visible(False)
    _legend(ax, 4 if n > 4 else 5)
    return colors


def _legend(ax: Axes, columns: int) -> None:
    """Legend above the axes, where it covers nothing."""
    handles, labels = ax.get_legend_handles_labels()
    if labels:
        ax.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)


def _time_axis(ax: Axes, *results: Result) -> None:
    ax.set_xlabel("time [s]")
    ends = [result.t[[0, -1]] for result in results if len(result.t) > 1]
    if ends:
        ax.set_xlim(np.min(ends), np.max(ends))


def _name_axes(ax: Axes, names: Sequence[str], *, equal: bool = False) -> None:
    for axis, name in zip("xyz", names, strict=False):
        getattr(ax, f"set_{axis}label")(name)
    if equal:
        ax.set_aspect("equal", adjustable="datalim")


def _nothing(ax: Axes, why: str) -> None:
    ax.text(0.5, 0.5, why, transform=ax.transAxes, ha="center", va="center", color="#808080")
    ax.set_axis_off()


def _axes(figure: Figure, place: Any, solid: bool = False) -> Axes:
    """Axes in a place of the grid, plane or 3-D."""
    ax: Any = figure.add_subplot(place, projection="3d" if solid else None)
    if solid:
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
            axis.set_major_locator(MaxNLocator(4))
            axis.labelpad = -6.0
        ax.tick_params(pad=-2.0, labelsize=6.0)
        ax.set_box_aspect((1, 1, 0.85), zoom=0.9)
    return ax  # type: ignore[no-any-return]


def _is_3d(ax: Axes) -> bool:
    return bool(ax.name == "3d")


def _path(result: Result) -> Array:
    """Positions of the task that decide from where its path is seen: those asked for, or else those reached."""
    z = result.z_ref if np.isfinite(result.z_ref).all() else result.z
    return z[:, : len(_places(result.info.get("task") or {}))]


def _has_depth(result: Result) -> bool:
    """Whether the task path is far from any plane of two axes."""
    extents = np.sort(np.ptp(_path(result), axis=0)) if result.z.size else np.zeros(0)
    return bool(len(extents) == 3 and extents[0] > 0.15 * extents[2])


def _largest(points: Float[Array, "K d"], count: int) -> list[int]:
    """Columns with the largest extents, in their own order."""
    return sorted(np.argsort(-np.ptp(points, axis=0), kind="stable")[:count].tolist())


def _places(task: Mapping[str, Any]) -> str:
    """Axes of the positions that a task point begins with."""
    if task.get("kind") == "stacked":
        return _places(task["tasks"][0])
    return "xyz" if task.get("kind") == "pose" else str(task.get("axes", ""))


def _task_units(result: Result, task: Mapping[str, Any] | None = None) -> list[str]:
    """Unit of each coordinate of the task error; empty for a task that is not known here."""
    task = task or result.info.get("task") or {}
    if task.get("kind") == "stacked":
        return [unit for part in task["tasks"] for unit in _task_units(result, part)]
    turns = {"orientation": 3, "pose": 3, "heading": 1}.get(task.get("kind", ""), 0)
    return ["m"] * len(_places(task)) + ["rad"] * turns


def _joint_units(robot: Robot | None) -> list[str]:
    """The units that occur in q; both where the robot is not known."""
    kinds = {joint.kind == "prismatic" for joint in robot.joints} if robot else {False, True}
    return [unit for unit, slides in (("rad", False), ("m", True)) if slides in kinds]


def _in(units: Sequence[str]) -> str:
    return f"[{', '.join(dict.fromkeys(units)) or 'm, rad'}]"


def _positive(values: Vector) -> Vector:
    """Values for a logarithmic axis, zeros raised to below rounding."""
    return np.maximum(values, 1e-17)


def _faded(color: str, shade: float) -> tuple[float, ...]:
    """The colour mixed with white; unlike transparency it does not add up where lines cross."""
    return tuple(1.0 - shade * (1.0 - channel) for channel in to_rgb(color))


def _plant(result: Result) -> Robot | None:
    try:
        return result.load_plant()
    except EosError:
        return None


def _links(robot: Robot) -> list[tuple[str, str, bool]]:
    """Lines to draw a robot: frame where it starts, frame where it ends, and whether it is the travel of a slider."""
    model = robot.model
    joints = [
        (model.names[model.parents[i + 1]], joint.name, joint.kind == "prismatic")
        for i, joint in enumerate(robot.joints)
    ]
    ends = [(model.names[model.frames[robot.frame_id(end)].parentJoint], end, False) for end in leaf_frames(robot)]
    return joints + ends


def _projection(
    result: Result, size: int, joints: Sequence[int] | None, unit: str
) -> tuple[Float[Array, "T size"], list[str]]:
    """Points of a joint motion in two or three dimensions, and what its axes are."""
    q = result.q
    n = q.shape[1]
    if joints is None and n == size:
        joints = range(n)
    if joints is not None:
        if len(joints) != size or not all(-n <= i < n for i in joints):
            raise InputError(f"these axes show {size} of the joints 0 to {n - 1}, got {list(joints)}")
        return q[:, list(joints)], [f"$q_{{{i % n + 1}}}$ {unit}" for i in joints]
    if n == 1:
        return np.column_stack((q, result.dq)), [f"$q_1$ {unit}", f"$\\dot q_1$ {unit[:-1]}/s]"]
    late = q[result.settled_row :]
    late = late[np.isfinite(late).all(axis=1)]
    center = late.mean(axis=0) if len(late) else np.zeros(n)
    scale = np.abs(late - center).max(initial=0.0) or 1.0
    shares, directions = np.linalg.eigh(((late - center) / scale).T @ ((late - center) / scale))
    # A direction has no sign of its own: its largest entry is positive.
    directions = directions[:, ::-1][:, :size]
    directions = directions * np.sign(directions[np.abs(directions).argmax(axis=0), np.arange(size)])
    percent = 100.0 * shares[::-1][:size] / (shares.sum() or 1.0)
    return (q - center) @ directions, [f"direction {k + 1} {unit}, {p:.0f} %" for k, p in enumerate(percent)]
