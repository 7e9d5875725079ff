"""Key frames: the robot at several times in one picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from eos_pin._arrays import (
    Array,
    VectorLike,
    called,
    checked,
    listed,
    number,
    vector,
)
from eos_pin.errors import InputError
from eos_pin.plots._style import (
    ACTUAL,
    GREEN,
    LIMIT,
    ORANGE,
    PURPLE,
    REFERENCE,
    draw_legend,
    faded,
    is_solid,
    largest,
    name_axes,
    shortened,
)
from eos_pin.plots.panels import joints_at, key_times
from eos_pin.robot.loading import leaf_frames
from eos_pin.robot.model import Robot
from eos_pin.simulation.result import Result

#: Discs (x, y, radius) in the plane of the drawing [m], or a function of time [s] that gives them.
Obstacles: TypeAlias = Sequence[Sequence[float]] | Callable[[float], Sequence[Sequence[float]]]

LINK, SLIDE = "#30343B", "#8A8F98"


@checked
def plot_key_frames(
    ax: Axes,
    result: Result,
    robot: Robot,
    *,
    times: VectorLike | None = None,
    trace: Sequence[str] | None = None,
    obstacles: Obstacles = (),
    label_times: bool = True,
) -> None:
    """The robot at some times in one picture, earlier ones fading, with the path of its tip between them.

    Bodies are lines between the origins of joints, the travel of a slider is a thin one. On plane axes the robot is
    seen along the axis of its smallest extent, which for a planar robot is the one across its plane.

    Args:
        ax: Plane or 3-D axes.
        result: The run.
        robot: The plant.
        times: Times to draw [s]; by default eight in the last complete cycle, and its end.
        trace: Frames whose paths are drawn; by default that of the task, or else all ends of the robot.
        obstacles: Discs, on plane axes only; those of a function of time fade as the robot does.
        label_times: Whether each frame's time stands at its tip, on plane axes.
    """
    if times is None:
        times = key_times(result, per_cycle=8, first=max(result.cycles - 1, 0))
    times = vector(times, None, "times")
    if not times.size:
        raise InputError("times must be one or more")
    if trace is None:
        trace = [result.frame] if result.frame else leaf_frames(robot)
    shades = np.linspace(0.2, 1.0, len(times)) ** 1.5 if len(times) > 1 else np.ones(1)
    points = _points(robot, joints_at(result, times))
    columns = largest(np.concatenate([*points.values()]), 3 if is_solid(ax) else 2)
    if not is_solid(ax):
        _draw_discs(ax, obstacles, times.tolist(), shades.tolist())
    for k, shade in enumerate(shades):
        for start, end, slides in _links(robot):
            line = np.array([points[start][k], points[end][k]])[:, columns]
            color = faded(SLIDE if slides else LINK, shade)
            ax.plot(*line.T, color=color, linewidth=0.7 if slides else 1.8, zorder=2)
            dot: dict[str, Any] = {
                "marker": "s" if slides else "o",
                "markersize": 2.4,
                "markerfacecolor": "white",
                "zorder": 3,
            }
            ax.plot(*line[1:].T, color=color, linestyle="", **dot)
    axes = result.axes
    known = bool(result.frame and not result.seen_from and np.isfinite(result.z_ref).any())
    if known and all("xyz"[i] in axes for i in columns):
        rows = [axes.index("xyz"[i]) for i in columns]
        ax.plot(*result.z_ref[:, rows].T, color=REFERENCE, linewidth=2.5, zorder=1, label="reference")
    between = joints_at(result, np.linspace(times[0], times[-1], 300))
    for k, name in enumerate(trace):
        path = _path_of(robot, name, between)[:, columns]
        ax.plot(*path.T, color=(ACTUAL, ORANGE, GREEN, PURPLE)[k % 4], zorder=4, label=f"path of {shortened(name)}")
    name_axes(ax, [f"{'xyz'[i]} [m]" for i in columns], equal=True)
    if label_times and trace and not is_solid(ax):
        _label_times(ax, times.tolist(), _path_of(robot, trace[0], joints_at(result, times))[:, columns])
    draw_legend(ax, 2)


def is_spatial(robot: Robot, result: Result) -> bool:
    """Whether the robot leaves a plane of two axes."""
    rows = np.linspace(0, len(result.t) - 1, 31).astype(int)
    points = np.concatenate([*_points(robot, result.q[rows]).values()])
    extents = np.sort(np.ptp(points, axis=0))
    return bool(extents[0] > 1e-6 * extents[2])


def _links(robot: Robot) -> list[tuple[str, str, bool]]:
    """Lines to draw a robot: frame where it starts, frame where it ends, and whether it is the travel of a slider."""
    model = robot.model
    joints = [
        (model.names[model.parents[i]], model.names[i], bool(robot.coordinates.slides[i]))
        for i in range(1, model.njoints)
    ]
    ends = [(model.names[model.frames[robot.frame_id(end)].parentJoint], end, False) for end in leaf_frames(robot)]
    return joints + ends


def _points(robot: Robot, qs: Float[Array, "K n"]) -> dict[str, Float[Array, "K 3"]]:
    """Places of the ends of all links, in each of the configurations."""
    names = dict.fromkeys(name for start, end, _ in _links(robot) for name in (start, end))
    return {name: _path_of(robot, name, qs) for name in names}


def _path_of(robot: Robot, frame: str, qs: Float[Array, "K n"]) -> Float[Array, "K 3"]:
    return np.array([robot.placement(q, frame).translation for q in qs])


def _draw_discs(ax: Axes, obstacles: Obstacles, times: list[float], shades: list[float]) -> None:
    if callable(obstacles):
        found = [called("obstacles", obstacles, t) for t in times]
        layers = [(_discs(discs), shade) for discs, shade in zip(found, shades, strict=True)]
    else:
        layers = [(_discs(obstacles), 1.0)]
    for discs, shade in layers:
        for x, y, radius in discs:
            ax.add_patch(Circle((x, y), radius, color=faded(LIMIT, 0.5 * shade), zorder=1))


def _discs(discs: Any) -> list[list[float]]:
    rows = [vector(disc, 3, "each disc: x, y and its radius").tolist() for disc in listed(discs, "obstacles")]
    for *_, radius in rows:
        number(radius, "the radius of a disc", at_least=0.0)
    return rows


def _label_times(ax: Axes, times: list[float], tips: Float[Array, "K 2"]) -> None:
    """Write each time at its tip; times at which the tip is at the same place share a label."""
    near = 0.03 * max(np.ptp(tips, axis=0).max(), 1e-9)
    digits = 1 if times[-1] - times[0] > 4.0 else 2
    groups: list[tuple[Array, list[str]]] = []
    for t, tip in zip(times, tips, strict=True):
        same = next((words for place, words in groups if np.abs(place - tip).max() < near), None)
        if same is None:
            groups.append((tip, same := []))
        same.append(f"{t:.{digits}f}")
    for place, words in groups:
        ax.annotate(
            "\n".join(words) + " s",
            (float(place[0]), float(place[1])),
            xytext=(3.0, 3.0),
            textcoords="offset points",
            fontsize=5.5,
            zorder=6,
            path_effects=[withStroke(linewidth=1.5, foreground="white")],
        )
