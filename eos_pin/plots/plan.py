"""Figures of a plan: joints over the path with their limits, and the redundancy map."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eos_pin._arrays import Array
from eos_pin.planning.obstacles.bodies import Clearances
from eos_pin.planning.plans import Plan
from eos_pin.plots._style import PAGE, colors_of, draw_legend, style
from eos_pin.tasks.batch import Manifold, ranges
from eos_pin.trajectories.through import sampled

#: Places along the path, and postures at each, of a redundancy map.
PLACES, POSTURES = 160, 300
#: Colours of postures that are allowed, beyond limits, and in collision; and of the plan.
ALLOWED, BEYOND, CLOSE, CHOSEN = "#9ecae1", "#d9d9d9", "#f4a582", "#0b3c78"


def picture(plan: Plan, clearances: Clearances | None = None) -> Figure:
    """Joints over the path within their limits and, where one joint is redundant, the redundancy map above them."""
    mapped = plan.robot.n - plan.task.m == 1
    with style():
        figure = Figure(figsize=(PAGE, 0.75 * PAGE if mapped else 0.4 * PAGE), layout="constrained")
        axes = figure.subplots(2 if mapped else 1, 1, sharex=True, squeeze=False)[:, 0]
        if mapped:
            redundancy_map(axes[0], plan, clearances)
        _joints(axes[-1], plan)
    return figure


def redundancy_map(ax: Axes, plan: Plan, clearances: Clearances | None = None) -> int:
    """Draw the postures of the task at each place of the path, and the plan among them.

    The height is that of the joint that moves most along the self-motion; where limits or collisions bar postures they
    are grey or red. Components end at singularities, where the height turns.

    Returns:
        Number of the joint on the vertical axis.
    """
    task, robot = plan.task, plan.robot
    manifold, random = Manifold(task), np.random.default_rng(0)
    times = np.linspace(plan.start, plan.end, PLACES)
    Z = np.repeat(sampled(plan.path, times), POSTURES, axis=0).T
    lower, upper = ranges(robot)
    free = np.minimum(lower, -np.pi), np.maximum(upper, np.pi)
    Q, found = manifold.search(random.uniform(*free, (Z.shape[1], robot.n)).T, Z, free, iterations=25)
    where = np.repeat(times, POSTURES)[found]
    Q = Q[:, found]
    inside = np.logical_and(lower[:, None] <= Q, upper[:, None] >= Q).all(axis=0).reshape(-1)
    close = np.zeros_like(inside)
    if clearances is not None:
        close[inside] = clearances(Q[:, inside]) < 0.0
    V = manifold.null(plan.q.T, sampled(plan.path, plan.times).T)[:, :, 0]
    joint = int(np.abs(V).mean(axis=0).argmax())
    for chosen, color, label in (
        (~inside, BEYOND, "beyond a limit"),
        (close, CLOSE, "in collision"),
        (inside & ~close, ALLOWED, "allowed"),
    ):
        if chosen.any():
            ax.plot(where[chosen], Q[joint, chosen], ".", ms=1.2, color=color, label=label, rasterized=True)
    dense = np.linspace(plan.start, plan.end, 4 * len(plan.times))
    ax.plot(dense, plan.joints(dense)[:, joint], color=CHOSEN, lw=1.6, label="plan")
    ax.set_ylabel(f"{robot.joints[joint].name} [rad]")
    ax.legend(loc="upper right", ncols=4, markerscale=5)
    return joint


def _joints(ax: Axes, plan: Plan) -> None:
    times = np.linspace(plan.start, plan.end, 4 * len(plan.times))
    q, robot = plan.joints(times), plan.robot
    names = [joint.name for joint in robot.joints]
    low, high = robot.lower, robot.upper
    bounded = np.isfinite(low) & np.isfinite(high)
    for i, (name, color) in enumerate(zip(names, colors_of(names), strict=True)):
        values = _part(q[:, i], low[i], high[i]) if bounded[i] else 0.5 + q[:, i] / (2.0 * np.pi)
        ax.plot(times, values, color=color, label=name)
    for end in (0.0, 1.0):
        ax.axhline(end, color="#d55e00", lw=0.8)
    ax.set_ylim(-0.05, 1.05)
    ax.set_ylabel("place between the limits")
    ax.set_xlabel("time [s]")
    draw_legend(ax, columns=min(7, len(names)))


def _part(values: Float[Array, " T"], low: float, high: float) -> Any:
    return (values - low) / (high - low)
