"""Style that all figures share: colours, sizes, legends and axes.

A colour means the same in every panel: grey is what was asked for, blue what happened, vermilion a limit or an
obstacle, and each controller keeps its own. The colours are those of Okabe and Ito, which people with any kind of
colour vision tell apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from eos_pin._arrays import Array, Vector
from eos_pin.simulation.result import Result

#: Widths of a column and of a page of a two-column paper [in].
COLUMN, PAGE = 3.4, 7.0

#: Curves that move less than this are drawn as the constants they are, not as rounding errors [rad or m].
STILL = 0.02

#: What differs from matplotlib's own defaults; sizes are for a figure printed at its own width.
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
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "legend.frameon": False,
    "legend.handlelength": 1.2,
    "legend.handletextpad": 0.5,
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
LINES = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, OLIVE)
ACTUAL, REFERENCE, LIMIT, MARK = BLUE, "#B5B5B5", VERMILION, "#C8C8C8"

#: Colours of controllers, and of the kinetic energies that the paper names after them.
CONTROLLERS = {
    "eos": BLUE,
    "task-space": VERMILION,
    "task-space-energy": ORANGE,
    "null-space-damping": PURPLE,
    "null-space-posture": GREEN,
    "without-drift": SKY,
    "set-point": BLACK,
    "$t_0$": VERMILION,
    "$t_{os}$": ORANGE,
    "$t_{eos}$": BLUE,
}


@contextmanager
def style() -> Iterator[None]:
    """Context with the package's style of figures, independent of the user's matplotlibrc."""
    with matplotlib.style.context(["default", STYLE]):
        yield


def colors_of(names: Iterable[str]) -> list[str]:
    """A colour for each controller: its own if it has one, and else one that no other has."""
    own = [CONTROLLERS.get(name.lower()) for name in names]
    free = [color for color in LINES if color not in own] or list(LINES)
    spare = iter(free * len(own))
    return [color or next(spare) for color in own]


def faded(color: str, shade: float) -> tuple[float, ...]:
    """The colour mixed with white; unlike transparency it does not add up where lines cross."""
    return tuple(1.0 - shade * (1.0 - channel) for channel in to_rgb(color))


def draw_lines(ax: Axes, t: Vector, values: Float[Array, "T n"], symbol: str) -> list[Any]:
    """A curve for each column with a legend above; where they are many, a colour scale beside.

    Returns:
        The colours.
    """
    n = values.shape[1]
    many = n > len(LINES)
    colors = list(matplotlib.colormaps["viridis"](np.linspace(0.0, 0.92, n))) if many else list(LINES[:n])
    for i, color in enumerate(colors):
        label = None if many else f"${symbol}_{{{i + 1}}}$"
        ax.plot(t, values[:, i], color=color, linestyle=_dashes(values, i), dash_capstyle="butt", label=label)
    if many:
        scale = ScalarMappable(BoundaryNorm(np.arange(n + 1) + 0.5, n), ListedColormap(colors))
        ticks = np.arange(1, n + 1, 1 + n // 13)
        bar = ax.figure.colorbar(scale, ax=ax, ticks=ticks, aspect=30, pad=0.02, fraction=0.05)
        bar.minorticks_off()
        bar.ax.set_yticklabels([f"${symbol}_{{{i}}}$" for i in ticks])
        bar.ax.tick_params(length=0, labelsize=6)
        bar.outline.set_visible(False)
    count = len(ax.get_legend_handles_labels()[1])
    draw_legend(ax, count if count <= 5 else (count + 1) // 2)
    return colors


def _dashes(values: Float[Array, "T n"], i: int) -> Any:
    """Dashes for a curve that would hide an earlier one, so that both are seen; the more it would hide, the shorter."""
    near = 0.01 * max(float(np.ptp(values)), STILL)
    hidden = sum(bool(np.abs(values[:, i] - values[:, k]).max(initial=0.0) < near) for k in range(i))
    length = 8.0 / 2.0 ** min(hidden, 3)
    return (0.0, (length, 8.0 - length)) if hidden else "-"


def keep_still(ax: Axes, least: float = STILL) -> None:
    """Widen axes that show less than this, so that rounding errors are not drawn as motion."""
    for axis in "xyz" if is_solid(ax) else "xy":
        low, high = getattr(ax, f"get_{axis}lim")()
        if high - low < least:
            middle = 0.5 * (low + high)
            getattr(ax, f"set_{axis}lim")(middle - 0.5 * least, middle + 0.5 * least)


def draw_legend(ax: Axes, columns: int) -> None:
    """Legend above the axes, where it covers nothing; on the right, because powers of ten stand on the left."""
    handles, labels = ax.get_legend_handles_labels()
    if not labels:
        return
    # Matplotlib fills columns; people read rows.
    order = [i for column in range(columns) for i in range(column, len(labels), columns)]
    handles, labels = [handles[i] for i in order], [labels[i] for i in order]
    legend = ax.legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns)
    for line in legend.get_lines():
        line.set_linewidth(min(line.get_linewidth(), 2.5))
        line.set_linestyle("-" if line.get_linestyle() == "--" else line.get_linestyle())


def draw_nothing(ax: Axes, why: str) -> None:
    """Write the reason why nothing is drawn."""
    ax.text(0.5, 0.5, why, transform=ax.transAxes, ha="center", va="center", color="#808080")
    ax.set_axis_off()


def name_time(ax: Axes, *results: Result) -> None:
    """Make the horizontal axis the time of the runs."""
    ax.set_xlabel("time [s]")
    ends = [result.t[[0, -1]] for result in results if len(result.t) > 1]
    if ends:
        ax.set_xlim(np.min(ends), np.max(ends))


def name_axes(ax: Axes, names: Sequence[str], *, equal: bool = False) -> None:
    """Label the axes, and with `equal` give them one scale."""
    if equal:
        ax.set_aspect("equal", adjustable="box" if is_solid(ax) else "datalim")
    spans = [float(np.ptp(getattr(ax, f"get_{axis}lim")())) for axis in "xyz"[: len(names)]]
    for axis, name, span in zip("xyz", names, spans, strict=False):
        getattr(ax, f"set_{axis}label")(name)
        count = 6 if not is_solid(ax) else 1 if equal and span < 0.4 * max(spans) else 3
        getattr(ax, f"{axis}axis").set_major_locator(MaxNLocator(count, min_n_ticks=1))


def use_decades(ax: Axes) -> None:
    """Make the vertical axis logarithmic, over one decade at least, with whole decades named."""
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    if high < 10.0 * low:
        middle = (low * high) ** 0.5
        ax.set_ylim(middle / 4.0, middle * 4.0)
    ax.yaxis.set_minor_locator(NullLocator())


def shortened(name: str, most: int = 26) -> str:
    """A name that leaves room for others; one with TeX in it is short as it is seen."""
    return name if len(name) <= most or "$" in name else f"{name[: most - 1]}…"


def focus(ax: Axes, result: Result, values: Array) -> None:
    """Clip large transients so that the rest is not flat, and name their peak."""
    late = values[result.settled_row :]
    if not len(late) or not np.isfinite(values).all():
        return
    span = np.ptp(late)
    if np.ptp(values) > 4.0 * span > 4e-3 * np.ptp(values):
        ax.set_ylim(min(late.min() - 0.3 * span, 0.0), late.max() + 0.3 * span)
        peak = values.flat[np.abs(values).argmax()]
        ax.text(0.03, 0.98, f"start-up to {peak:.4g}", transform=ax.transAxes, va="top", fontsize=6, color="#606060")


def add_axes(figure: Figure, place: Any, *, solid: bool = False) -> Axes:
    """Axes in a place of the grid, plane or 3-D."""
    ax: Any = figure.add_subplot(place, projection="3d" if solid else None)
    if solid:
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
            axis.labelpad = -6.0
        ax.tick_params(pad=-2.0, labelsize=6.0)
        ax.set_box_aspect((1.0, 1.0, 0.8), zoom=1.05)
    return ax


def is_solid(ax: Axes) -> bool:
    """Whether the axes are 3-D."""
    return bool(ax.name == "3d")


def largest(points: Float[Array, "K d"], count: int) -> list[int]:
    """Columns with the largest extents, in their own order."""
    return sorted(np.argsort(-np.ptp(points, axis=0), kind="stable")[:count].tolist())
