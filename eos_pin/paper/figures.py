"""Counterparts of the paper's figures, with the same quantities on the axes, and a page for each example."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from eos_pin.plots._style import (
    ACTUAL,
    COLUMN,
    PAGE,
    REFERENCE,
    add_axes,
    draw_legend,
    name_axes,
    name_time,
    style,
    use_decades,
)
from eos_pin.plots.keyframes import plot_key_frames
from eos_pin.plots.panels import (
    plot_charts,
    plot_drift,
    plot_joints,
    plot_kinetic_energy,
    plot_orbit,
    plot_path,
)
from eos_pin.robot.model import Robot
from eos_pin.simulation.result import Result

Runs: TypeAlias = Mapping[str, Result]
#: Draws one row of a page.
Row: TypeAlias = Callable[[Figure, SubplotSpec, Robot], None]

#: The paper's names of three kinetic energies.
ENERGIES = {"task-space": "$T_0$", "task-space-energy": "$T_{OS}$", "eos": "$T_{EOS}$"}
#: Self-motion coordinates that stay within this are drawn on an axis this wide [rad or m].
STILL = 0.5


def plot_operational(ax: Axes, result: Result) -> None:
    """Operational space of a task with two coordinates and one of self-motion: (z1, z2, v), on 3-D axes."""
    reference = np.where(np.isfinite(result.v_ref), result.v_ref, 0.0)
    ax.plot(*result.z_ref.T, *reference.T, color=REFERENCE, linewidth=2.5, label="reference, v = 0")
    ax.plot(*result.z.T, *result.v.T, color=ACTUAL, label="actual")
    ax.plot(*result.z[:1].T, *result.v[:1].T, "o", color=ACTUAL, markerfacecolor="white", markersize=4, label="start")
    reach = max(STILL, 1.2 * float(np.abs(result.v).max()))
    ax.set_zlim(-reach, reach)  # type: ignore[attr-defined]
    name_axes(ax, ["$z_1$ [m]", "$z_2$ [m]", "$v$ [rad, m]"])
    draw_legend(ax, 3)


def page(rows: Sequence[Row], robot: Robot, *, width: float = PAGE, height: float = 3.0) -> Figure:
    """Rows of panels as one figure, sizes in inches."""
    with style():
        figure = Figure((width, height * len(rows)), layout="constrained")
        grid = figure.add_gridspec(len(rows), 1)
        for k, draw in enumerate(rows):
            draw(figure, grid[k], robot)
    return figure


def paths(result: Result) -> Row:
    """Task path and its reference, with v where there is one; beside it the motion in joint space. Figs. 5, 8, 13."""

    def draw(figure: Figure, place: SubplotSpec, robot: Robot) -> None:
        grid = place.subgridspec(1, 2)
        solid = result.v.shape[1] == 1
        left = add_axes(figure, grid[0, 0], solid=solid)
        (plot_operational if solid else plot_path)(left, result)
        right = add_axes(figure, grid[0, 1], solid=result.q.shape[1] == 3)
        plot_orbit(right, result, robot)

    return draw


def motion(result: Result, *, trace: Sequence[str] | None = None) -> Row:
    """Joints over time with key-frame marks; beside them key frames, fading with age. Figs. 6, 9, 14, 16, 17."""

    def draw(figure: Figure, place: SubplotSpec, robot: Robot) -> None:
        grid = place.subgridspec(1, 2)
        plot_joints(add_axes(figure, grid[0, 0]), result, robot, per_cycle=4)
        plot_key_frames(add_axes(figure, grid[0, 1]), result, robot, trace=trace)

    return draw


def energies(runs: Runs, *, drift: bool = True) -> Row:
    """Kinetic energies in one plot, beside the drift of the joints from cycle to cycle."""

    def draw(figure: Figure, place: SubplotSpec, robot: Robot) -> None:
        grid = place.subgridspec(1, 2 if drift else 1)
        left = add_axes(figure, grid[0, 0])
        plot_kinetic_energy(left, runs)
        draw_legend(left, 3)
        if drift:
            right = add_axes(figure, grid[0, 1])
            plot_drift(right, runs, robot)

    return draw


def drifts(runs: Runs) -> Row:
    """Drift of the joints from cycle to cycle, beside the orbit of the first run in joint space."""

    def draw(figure: Figure, place: SubplotSpec, robot: Robot) -> None:
        grid = place.subgridspec(1, 2)
        left = add_axes(figure, grid[0, 0])
        plot_drift(left, runs, robot)
        draw_legend(left, 2)
        first = next(iter(runs.values()))
        right = add_axes(figure, grid[0, 1], solid=robot.n == 3)
        plot_orbit(right, first, robot)

    return draw


def agreement(runs: Runs) -> Row:
    """Joints over time, beside the difference between two runs that should be the same."""

    def draw(figure: Figure, place: SubplotSpec, robot: Robot) -> None:
        grid = place.subgridspec(1, 2)
        first, second = runs.values()
        left = add_axes(figure, grid[0, 0])
        plot_joints(left, second, robot)
        plot_charts(left, second)
        right = add_axes(figure, grid[0, 1])
        rows = min(len(first.t), len(second.t))
        deviation = np.linalg.norm(first.q[:rows] - second.q[:rows], axis=1)
        right.plot(first.t[1:rows], np.maximum(deviation[1:], 1e-17), color=ACTUAL)
        plot_charts(right, second)
        name_time(right, first)
        use_decades(right)
        right.set_ylabel("deviation [m, rad]")

    return draw


def paper_figures(runs: Mapping[str, Runs], planar: Robot, chain: Robot) -> dict[str, Figure]:
    """The counterparts of the paper's figures by file name.

    Args:
        runs: Runs by section, and in each by controller.
        planar: Robot of Sec. 5.
        chain: Robot of Sec. 6.
    """
    traditional, eos, avoiding = runs["5.1"]["task-space"], runs["5.2"]["eos"], runs["5.4"]["eos"]
    wild, calm = runs["6.1"]["task-space"], runs["6.2"]["eos"]
    named = {name: runs["5.3"][key] for key, name in ENERGIES.items()}
    rows = {
        "figure_05": (planar, paths(traditional)),
        "figure_06": (planar, motion(traditional)),
        "figure_08": (planar, paths(eos)),
        "figure_09": (planar, motion(eos)),
        "figure_13": (planar, paths(avoiding)),
        "figure_14": (planar, motion(avoiding, trace=["tip", "rail_tip"])),
        "figure_16": (chain, motion(wild)),
        "figure_17": (chain, motion(calm)),
    }
    figures = {name: page([row], robot) for name, (robot, row) in rows.items()}
    for name, both in (("figure_10", named), ("figure_18", {"task-space": wild, "eos": calm})):
        figures[name] = page([energies(both, drift=False)], planar, width=COLUMN, height=2.4)
    return figures
