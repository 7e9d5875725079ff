"""Common part of the scripts of the cited applications: follow the path with and without avoidance, and compare."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import coal
import numpy as np

from eos_pin.cli.output import (
    Output,
    console,
    format_number,
    grid,
    show,
    write_outputs,
)
from eos_pin.paper.obstacle_examples import Application
from eos_pin.simulation.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Largest task error that is accepted along the path [m, rad].
TASK_ERROR = 1e-9

#: Rows of the table: what a person reads, and the figure it is.
ROWS = {
    "status": "status",
    "least distance of a body from an obstacle, m": "clearance_min",
    "the same between the points of the path, m": "clearance_min_between_points",
    "body": "closest_body",
    "obstacle": "closest_obstacle",
    "largest task error, m or rad": "task_error_max",
    "largest joint step from point to point, rad": "joint_step_max",
    "largest joint speed, rad/s": "joint_speed_max",
    "least way to a joint limit, rad": "joint_limit_room_min",
    "joint drift in the last cycle, rad": "joint_drift_last",
    "chart switches": "chart_switches",
    "wall time, s": "wall_seconds",
}


def run_obstacle_example(application: Application, output: Output, title: str) -> int:
    """Run an application, print its table, and write and show the chosen outputs.

    Returns:
        0; 1 if a body touched an obstacle, the task was missed, a joint limit exceeded, or the path not completed.
    """
    robot, obstacles = application.task.robot, application.clearance.obstacles
    runs = {"v constant": application.run(avoiding=False), "v makes way": application.run()}
    measured = {name: application.figures(result) for name, result in runs.items()}
    last = {name: (found["joint_drift_per_cycle"] or [np.nan])[-1] for name, found in measured.items()}
    cells = [
        (label, *({**found, "joint_drift_last": last[name]}[key] for name, found in measured.items()))
        for label, key in ROWS.items()
    ]
    console.print(grid(title, ("", *runs), cells))
    avoiding, result = measured["v makes way"], runs["v makes way"]
    if result.message:
        console.print(result.message, markup=False)
    holds = {
        "the path is completed": result.ok,
        "every body is clear of every obstacle": avoiding["clearance_min_between_points"] > 0.0,
        f"the task error is at most {format_number(TASK_ERROR)}": avoiding["task_error_max"] <= TASK_ERROR,
        "joint limits are kept": avoiding["joint_limit_room_min"] >= 0.0,
    }
    for claim, kept in holds.items():
        console.print(f"{'holds' if kept else '[bold red]FAILS[/]'}: {claim}")
    files = output.within(None, names={"json": "summary.json", "html": "replay.html", "plot": "figure.png"})
    figures = avoiding | {"claims": holds, "constant_v": measured["v constant"]}
    plot = draw(application, runs) if files.plot else None
    written = write_outputs(files, result, robot, figures=figures, obstacles=obstacles, plot=plot, title=title)
    if written:
        console.print("Wrote " + ", ".join(map(str, written)), soft_wrap=True)
    if output.view:
        show({"": result}, {"": robot}, obstacles, title=title)
    return 0 if all(holds.values()) else 1


def draw(application: Application, runs: Mapping[str, Result]) -> Figure:
    """Key frames among the obstacles, distance from them with and without making way, joints, self-motion."""
    from matplotlib.figure import Figure

    from eos_pin.plots._style import PAGE, add_axes, style
    from eos_pin.plots.keyframes import is_spatial, plot_key_frames
    from eos_pin.plots.panels import plot_joints, plot_self_motion

    robot, result = application.task.robot, runs["v makes way"]
    with style():
        page = Figure((PAGE, 5.6), layout="constrained")
        cells = page.add_gridspec(2, 2, height_ratios=(1.25, 1.0))
        solid = is_spatial(robot, result)
        ax = add_axes(page, cells[0, 0], solid=solid)
        obstacles = () if solid else lambda t: discs(application, t)
        plot_key_frames(ax, result, robot, trace=[robot.frames[-1]], obstacles=obstacles, label_times=False)
        if solid:
            _draw_balls(ax, application)
        _plot_clearance(add_axes(page, cells[0, 1]), application, runs)
        plot_joints(add_axes(page, cells[1, 0]), result, robot)
        plot_self_motion(add_axes(page, cells[1, 1]), result, robot)
    return page


def discs(application: Application, t: float) -> list[tuple[float, float, float]]:
    """Centre and radius of the obstacles at time t, seen from above [m]."""
    obstacles = application.clearance.obstacles
    return [(*obstacle.at(t).translation[:2].tolist(), obstacle.shape.radius) for obstacle in obstacles]


def _plot_clearance(ax: Axes, application: Application, runs: Mapping[str, Result]) -> None:
    from eos_pin.plots._style import (
        ACTUAL,
        LIMIT,
        ORANGE,
        draw_legend,
        name_time,
    )

    for (name, result), color in zip(runs.items(), (ORANGE, ACTUAL), strict=True):
        ax.plot(result.t, application.clearance.along(result.t, result.q), color=color, label=name)
    ax.axhline(0.0, color=LIMIT, linewidth=0.8, linestyle="--")
    name_time(ax, *runs.values())
    ax.set_ylabel("least distance [m]")
    draw_legend(ax, 2)


def _draw_balls(ax: Any, application: Application) -> None:
    from eos_pin.plots._style import LIMIT

    around, up = np.mgrid[0.0 : 2.0 * np.pi : 13j, 0.0 : np.pi : 7j]
    sphere = np.array([np.cos(around) * np.sin(up), np.sin(around) * np.sin(up), np.cos(up)])
    for obstacle in application.clearance.obstacles:
        if isinstance(obstacle.shape, coal.Sphere):
            center = obstacle.at(0.0).translation[:, None, None]
            ax.plot_wireframe(*(center + obstacle.shape.radius * sphere), color=LIMIT, linewidth=0.4)
