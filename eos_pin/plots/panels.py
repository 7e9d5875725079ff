"""Panels: one view of a run, drawn on axes that you give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import is_color_like
from matplotlib.ticker import MaxNLocator

from eos_pin._arrays import (
    Array,
    Vector,
    VectorLike,
    checked,
    vector,
)
from eos_pin.errors import InputError
from eos_pin.plots._style import (
    ACTUAL,
    BLACK,
    GREEN,
    LIMIT,
    MARK,
    ORANGE,
    PURPLE,
    REFERENCE,
    VERMILION,
    colors_of,
    draw_legend,
    draw_lines,
    draw_nothing,
    faded,
    focus,
    is_solid,
    keep_still,
    largest,
    name_axes,
    name_time,
    use_decades,
)
from eos_pin.robot.model import Robot
from eos_pin.simulation.limit_use import POSITION_PASSED
from eos_pin.simulation.result import Result

#: A joint that uses more of its range than this is near its limits, and the colour in which it passes them.
NEAR, PASSED = 0.8, "#E00000"
#: Kinetic energy below which a robot rests [J].
REST = 1e-6


@checked
def plot_path(ax: Axes, result: Result) -> None:
    """Task path against its reference; a task that is no path in space is drawn over time.

    On plane axes a spatial path is seen along the axis of its smallest extent; on 3-D axes it is drawn whole.
    """
    if not result.z.size:
        return draw_nothing(ax, "no task")
    names = result.axes
    if len(names) < 2:
        ax.plot(result.t, result.z_ref, color=REFERENCE, linewidth=3.5)
        draw_lines(ax, result.t, result.z, "z")
        keep_still(ax)
        name_time(ax, result)
        return _set_ylabel(ax, result.labels[0] if len(result.labels) == 1 else "task point", result.units)
    columns = largest(_seen_path(result), 3 if is_solid(ax) else 2)
    if np.isfinite(result.z_ref).any():
        ax.plot(*result.z_ref[:, columns].T, color=REFERENCE, linewidth=2.5, label="reference")
    ax.plot(*result.z[:, columns].T, color=ACTUAL, label="actual")
    ax.plot(*result.z[:1, columns].T, "o", color=ACTUAL, markerfacecolor="white", markersize=4, label="start")
    keep_still(ax)
    name_axes(ax, [f"{names[i]} [m]" for i in columns], equal=True)
    return draw_legend(ax, 3)


@checked
def plot_joints(ax: Axes, result: Result, robot: Robot | None = None, *, per_cycle: int = 1) -> None:
    """Joints over time, with a grey line and dots at each exact 1/`per_cycle` of the reference's period.

    A joint's limits are dashed lines in its colour where the run comes near them, and it is red where it passes them.
    """
    colors = draw_lines(ax, result.t, result.q, "q")
    keep_still(ax)
    _draw_joint_limits(ax, result, colors)
    if result.cycles:
        times = key_times(result, per_cycle=per_cycle)
        # More marks than these would be a grey area.
        times = times[:: 1 + len(times) // 50]
        for t in times:
            ax.axvline(t, color=MARK, linewidth=0.5, zorder=0)
        for color, row in zip(colors, joints_at(result, times).T, strict=True):
            ax.plot(times, row, "o", color=color, markersize=2.4, clip_on=False)
    name_time(ax, result)
    _set_ylabel(ax, "joints", joint_units(robot))


def _draw_joint_limits(ax: Axes, result: Result, colors: Sequence[Any]) -> None:
    """Limits of the joints that use most of their range, as far as they are in view."""
    limits, used = result.info.get("limits") or {}, result.limits.get("position", {})
    low, high = ax.get_ylim()
    for side, sign in (("lower", -1.0), ("upper", 1.0)):
        parts = zip(colors, result.q.T, limits.get(side, ()), used.get("per_joint", {}).values(), strict=False)
        for color, q, limit, ratio in parts:
            if limit is None or not (ratio > NEAR and low < limit < high):
                continue
            ax.axhline(limit, color=color, linewidth=0.7, linestyle="--", zorder=1)
            beyond = np.where(sign * (q - limit) > POSITION_PASSED, q, np.nan)
            if np.isfinite(beyond).any():
                ax.plot(result.t, beyond, color=PASSED, linewidth=2.5, alpha=0.7)
    ax.set_ylim(low, high)


@checked
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
    if not is_color_like(color):
        raise InputError(f"color must be a color of matplotlib, such as 'tab:blue', got {color!r}")
    points, names = _projection(result, robot, 3 if is_solid(ax) else 2, joints)
    rows = [*dict.fromkeys((*result.cycle_rows.tolist(), len(result.t) - 1))]
    shades = np.linspace(0.3 if len(rows) > 2 else 1.0, 1.0, len(rows))[1:]
    for (first, last), shade in zip(pairwise(rows), shades, strict=True):
        ax.plot(*points[first : last + 1].T, color=faded(color, shade))
    if result.cycles:
        ax.plot(*points[result.cycle_rows].T, "o", color=BLACK, markersize=2.5, zorder=5)
    ax.plot(*points[:1].T, "o", color=BLACK, markerfacecolor="white", markersize=4, zorder=6)
    keep_still(ax)
    name_axes(ax, names)


@checked
def plot_self_motion(ax: Axes, result: Result, robot: Robot | None = None) -> None:
    """Self-motion coordinates v against v_ref over time."""
    if not result.v.size:
        return draw_nothing(ax, "no self-motion coordinates")
    if np.isfinite(result.v_ref).any():
        ax.plot(result.t, result.v_ref[:, :1], color=REFERENCE, linewidth=3.5, label="reference")
        ax.plot(result.t, result.v_ref[:, 1:], color=REFERENCE, linewidth=3.5)
    draw_lines(ax, result.t, result.v, "v")
    keep_still(ax)
    name_time(ax, result)
    return _set_ylabel(ax, "self-motion", joint_units(robot))


@checked
def plot_charts(ax: Axes, result: Result) -> None:
    """Charts on a time axis: a bar and a number for each, a line where one is left for the next."""
    if not len(result.switches):
        return
    edges = np.concatenate((result.t[:1], result.switches, result.t[-1:]))
    for k, (start, end) in enumerate(pairwise(edges)):
        if k % 2:
            ax.axvspan(start, end, color="#F0F0F0", zorder=-1, linewidth=0)
        if end - start > 0.025 * (edges[-1] - edges[0]):
            middle = 0.5 * (start + end)
            number = result.chart[min(np.searchsorted(result.t, middle), len(result.t) - 1)]
            place: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "ha": "center", "va": "top"}
            ax.text(middle, 0.99, str(number), fontsize=6, color="#606060", **place)
    for t in result.switches:
        ax.axvline(t, color=VERMILION, linewidth=0.6, linestyle=":", zorder=0)
    name_time(ax, result)


@checked
def plot_errors(ax: Axes, result: Result) -> None:
    """Task error by unit, self-motion error and that of a further task, as norms on a logarithmic axis over time."""
    units = np.array(result.units or ["m, rad"] * result.error.shape[1])
    names = {"m": "position" if result.axes else "task", "rad": "rotation"}
    curves = [
        (f"{names.get(unit, 'task')} [{unit}]", result.error[:, units == unit], color)
        for unit, color in zip(dict.fromkeys(units.tolist()), cycle((ACTUAL, VERMILION, ORANGE, PURPLE)), strict=False)
    ]
    curves += [("self-motion", result.self_motion_error, GREEN), ("further task", result.further_error, BLACK)]
    curves = [curve for curve in curves if np.isfinite(curve[1]).any()]
    if not curves:
        return draw_nothing(ax, "nothing was asked for")
    for name, error, color in curves:
        ax.plot(result.t, _positive(np.linalg.norm(error, axis=1)), color=color, label=name)
    name_time(ax, result)
    use_decades(ax)
    ax.set_ylabel("error")
    return draw_legend(ax, 3)


@checked
def plot_task_error(ax: Axes, results: Mapping[str, Result]) -> None:
    """Norm of the task error of several runs on a logarithmic axis over time."""
    for k, (name, result) in enumerate(results.items()):
        if np.isfinite(result.error).any():
            error, color = np.linalg.norm(result.error, axis=1), colors_of(results)[k]
            # The first one, which the others are compared with, lies on top.
            ax.plot(result.t, _positive(error), color=color, linewidth=0.9, label=name, zorder=3.0 - 0.01 * k)
    use_decades(ax)
    name_time(ax, *results.values())
    _set_ylabel(ax, "task error", [unit for result in results.values() for unit in result.units])


@checked
def plot_kinetic_energy(ax: Axes, results: Result | Mapping[str, Result]) -> None:
    """Kinetic energy of one run, or of several by name, over time; logarithmic where they differ by orders."""
    runs = results if isinstance(results, Mapping) else {"": results}
    for k, (name, result) in enumerate(runs.items()):
        color = colors_of(runs)[k] if name else ACTUAL
        ax.plot(result.t, result.kinetic_energy, color=color, label=name or None, zorder=3.0 - 0.01 * k)
    # A robot at rest has rounding errors for an energy.
    means = [mean for result in runs.values() if (mean := result._mean(result.kinetic_energy)) > REST]
    if means and max(means) > 30.0 * min(means):
        use_decades(ax)
        # Where a motion turns, its energy is zero; that is no reason to show ten decades.
        ax.set_ylim(bottom=1e-2 * min(means))
    else:
        if len(runs) == 1:
            focus(ax, result, result.kinetic_energy)
        ax.set_ylim(0.0, max(ax.get_ylim()[1], REST))
    name_time(ax, *runs.values())
    ax.set_ylabel("kinetic energy [J]")


@checked
def plot_drift(ax: Axes, results: Result | Mapping[str, Result], robot: Robot | None = None) -> None:
    """Largest change of a joint over each cycle, measured between exact multiples of the period."""
    runs = results if isinstance(results, Mapping) else {"": results}
    if not any(result.cycles for result in runs.values()):
        return draw_nothing(ax, "no complete cycle")
    for k, (name, result) in enumerate(runs.items()):
        drift, color = _positive(result.joint_drift_per_cycle), colors_of(runs)[k] if name else ACTUAL
        cycles = 1 + np.arange(len(drift))
        ax.plot(cycles, drift, "o-", color=color, markersize=3, label=name or None, zorder=3.0 - 0.01 * k)
    use_decades(ax)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("cycle")
    return _set_ylabel(ax, "joint drift", joint_units(robot))


@checked
def plot_torques(ax: Axes, result: Result, robot: Robot | None = None) -> None:
    """Torques over time, with the range beyond the limits shaded.

    Where the joints have different limits, each torque is drawn relative to its own.
    """
    effort = robot.effort if robot else np.full(result.tau.shape[1], np.inf)
    units = [{"m": "N", "rad": "N m"}[unit] for unit in joint_units(robot)]
    _plot_within(ax, result, result.tau, effort, "torque", "\\tau", units)


@checked
def plot_velocities(ax: Axes, result: Result, robot: Robot | None = None) -> None:
    """Velocities of joints over time, drawn as `plot_torques` draws torques."""
    fastest = robot.velocity if robot else np.full(result.dq.shape[1], np.inf)
    _plot_within(ax, result, result.dq, fastest, "velocity", "\\dot q", [f"{unit}/s" for unit in joint_units(robot)])


def _plot_within(
    ax: Axes, result: Result, values: Array, bounds: Array, quantity: str, symbol: str, units: list[str]
) -> None:
    """A quantity of each joint over time, with the range beyond its limits shaded."""
    limits = np.unique(bounds[np.isfinite(bounds)])
    relative = len(limits) > 1 and bool(np.isfinite(bounds).all())
    values, limits = (values / bounds, np.ones(1)) if relative else (values, limits)
    draw_lines(ax, result.t, values, symbol)
    keep_still(ax)
    focus(ax, result, values)
    low, high = ax.get_ylim()
    far = limits[limits > 1.5 * max(-low, high)]
    for limit in limits[: len(limits) - len(far)]:
        low, high = min(low, -1.1 * limit), max(high, 1.1 * limit)
        for side in (-1.0, 1.0):
            ax.axhspan(side * limit, side * 1e3 * limit, color=LIMIT, alpha=0.15, linewidth=0)
            ax.axhline(side * limit, color=LIMIT, linewidth=0.7, linestyle="--")
    ax.set_ylim(low, high)
    name_time(ax, result)
    if relative:
        ax.set_ylabel(f"{quantity} / limit")
        return
    _set_ylabel(ax, quantity, units)
    if len(far):
        # Shading that far away would flatten the curves.
        place: dict[str, Any] = {"transform": ax.transAxes, "ha": "right", "va": "top"}
        ax.text(0.99, 0.98, f"limit {far[0]:g}", fontsize=6, color=LIMIT, **place)


# -- what the axes show ----------------------------------------------------------------------------------------------


@checked
def key_times(result: Result, *, per_cycle: int = 1, first: int = 0, last: int | None = None) -> Vector:
    """Times at regular fractions of the period, from the start of cycle `first` to the end of the complete cycles.

    Args:
        result: The run.
        per_cycle: Times in each cycle.
        first: Cycles to leave out at the start.
        last: Cycle to end before; by default all complete ones count. A run without a complete cycle counts as one.
    """
    period = result.period if result.cycles else float(result.t[-1] - result.t[0])
    last = max(result.cycles, 1) if last is None else last
    return result.t[0] + period * np.arange(first * per_cycle, last * per_cycle + 1) / per_cycle


@checked
def joints_at(result: Result, times: VectorLike) -> Float[Array, "K n"]:
    """Joints at any times, interpolated between the samples [rad or m]."""
    times = vector(times, None, "times")
    return np.column_stack([np.interp(times, result.t, q) for q in result.q.T])


def has_depth(result: Result) -> bool:
    """Whether the task path is far from any plane of two axes."""
    extents = np.sort(np.ptp(_seen_path(result), axis=0)) if result.z.size else np.zeros(0)
    return bool(len(extents) == 3 and extents[0] > 0.15 * extents[2])


def joint_units(robot: Robot | None) -> list[str]:
    """The units that occur in q; both where the robot is not known."""
    kinds = {joint.kind == "prismatic" for joint in robot.joints} if robot else {False, True}
    return [unit for unit, slides in (("rad", False), ("m", True)) if slides in kinds]


def _set_ylabel(ax: Axes, name: str, units: Sequence[str]) -> None:
    ax.set_ylabel(f"{name} [{', '.join(dict.fromkeys(units)) or 'm, rad'}]")


def _positive(values: Vector) -> Vector:
    """Values for a logarithmic axis, zeros raised to below rounding."""
    return np.maximum(values, 1e-17)


def _seen_path(result: Result) -> Array:
    """Positions of the task that decide from where its path is seen: those asked for, or else those reached."""
    z = result.z_ref if np.isfinite(result.z_ref).all() else result.z
    return z[:, : len(result.axes)]


def _projection(
    result: Result, robot: Robot | None, size: int, joints: Sequence[int] | None
) -> tuple[Float[Array, "T size"], list[str]]:
    """Points of a joint motion in two or three dimensions, and its axes."""
    q, n = result.q, result.q.shape[1]
    units = [f"[{', '.join(joint_units(robot))}]"] * n
    if robot is not None:
        units = ["[m]" if joint.kind == "prismatic" else "[rad]" for joint in robot.joints]
    if joints is None and n == size:
        joints = range(n)
    if joints is not None:
        numbers = vector(joints, size, f"joints, of which these axes show {size},")
        if not np.isin(numbers, np.arange(-n, n)).all():
            raise InputError(f"these axes show {size} of the joints 0 to {n - 1}, got {numbers.tolist()}")
        joints = numbers.astype(int).tolist()
        return q[:, list(joints)], [f"$q_{{{i % n + 1}}}$ {units[i]}" for i in joints]
    if n < size:
        points = np.column_stack((q, result.dq, result.ddq))[:, :size]
        return points, [f"$q_1$ {units[0]}", f"$\\dot q_1$ {units[0][:-1]}/s]", ""]
    late = q[result.settled_row :]
    late = late[np.isfinite(late).all(axis=1)]
    center = late.mean(axis=0) if len(late) else np.zeros(n)
    offsets = (late - center) / (np.abs(late - center).max(initial=0.0) or 1.0)
    shares, directions = np.linalg.eigh(offsets.T @ offsets)
    directions = directions[:, ::-1][:, :size]
    # A direction has no sign of its own: its largest entry is positive.
    directions = directions * np.sign(directions[np.abs(directions).argmax(axis=0), np.arange(size)])
    percent = 100.0 * shares[::-1][:size] / (shares.sum() or 1.0)
    unit = f"[{', '.join(joint_units(robot))}]"
    return (q - center) @ directions, [f"direction {k + 1} {unit}, {p:.0f} %" for k, p in enumerate(percent)]
