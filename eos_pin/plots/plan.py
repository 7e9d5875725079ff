"""Figures of a plan: joints over the path with their limits, and the redundancy map or the cost above them."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from eos_pin._arrays import Array, JointVector
from eos_pin.planning.manifolds.manifold import self_motion_manifold
from eos_pin.planning.obstacles.bodies import Clearances
from eos_pin.planning.plans import Plan
from eos_pin.plots._style import PAGE, colors_of, draw_legend, style
from eos_pin.robot.model import Robot
from eos_pin.tasks.batch import Manifold
from eos_pin.trajectories.through import sampled

#: Places along the path, and postures at each, of a redundancy map.
PLACES, POSTURES = 120, 240
#: The task is near a singularity where the smallest singular value is this part of the largest.
SINGULAR = 0.03
#: Names and colours of postures in the map, and the colour of the plan.
KINDS = (
    ("allowed", "#cfe3f5"),
    ("beyond a limit", "#c8c8c8"),
    ("in collision", "#f0b27a"),
    ("near singular", "#8c6bb1"),
)
CHOSEN = "#0b3c78"


def picture(plan: Plan, clearances: Clearances | None = None) -> Figure:
    """Joints over the path within their limits, below the redundancy map or, with more redundancy, the cost."""
    redundant = plan.robot.n - plan.task.m
    with style():
        figure = Figure(figsize=(PAGE, 0.75 * PAGE if redundant else 0.4 * PAGE), layout="constrained")
        axes = figure.subplots(2 if redundant else 1, 1, sharex=True, squeeze=False)[:, 0]
        if redundant == 1:
            redundancy_map(axes[0], plan, clearances)
        elif redundant:
            _cost(axes[0], plan)
        _joints(axes[-1], plan)
    return figure


def redundancy_map(ax: Axes, plan: Plan, clearances: Clearances | None = None) -> None:
    """Draw the component of the self-motion manifold that a plan is on, at each place of the path, and the plan on it.

    The height is the arc length along the component, from where the joint that moves most along it is as at the start
    of the plan. Where limits, collisions or singularities bar postures, the map is shaded.
    """
    times = np.linspace(plan.start, plan.end, PLACES)
    heights, kinds, chosen = [], [], []
    first = origin = plan(plan.start).q
    moved = Manifold(plan.task).null(plan.q.T, sampled(plan.path, plan.times).T)[:, :, 0]
    joint = int(np.abs(moved).mean(axis=0).argmax())
    for t in times:
        q = plan(float(t)).q
        height, Q, here = _places(plan, float(t), q, origin, joint, float(first[joint]))
        heights.append(height)
        kinds.append(_kinds(plan, Q, clearances))
        chosen.append(here)
        origin = Q[int(np.abs(height).argmin())]
    low, high = min(h[0] for h in heights), max(h[-1] for h in heights)
    grid = np.linspace(low, high, POSTURES)
    image = np.full((POSTURES, PLACES), np.nan)
    for k, (height, kind) in enumerate(zip(heights, kinds, strict=True)):
        inside = (grid >= height[0]) & (grid <= height[-1])
        rows = np.clip(np.searchsorted(height, grid[inside]), 0, len(height) - 1)
        image[inside, k] = kind[rows]
    colors = ListedColormap([color for _, color in KINDS])
    ax.pcolormesh(times, grid, image, cmap=colors, vmin=-0.5, vmax=len(KINDS) - 0.5, rasterized=True)
    (line,) = ax.plot(times, chosen, color=CHOSEN, lw=1.6, label="plan")
    ax.set_ylabel(f"self-motion, arc length [rad]\n(0: {plan.robot.joints[joint].name} as at the start)")
    met = np.unique(image[np.isfinite(image)]).astype(int)
    patches = [Patch(color=KINDS[kind][1], label=KINDS[kind][0]) for kind in met]
    ax.legend(handles=[line, *patches], loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(patches) + 1)


def _places(
    plan: Plan, t: float, q: JointVector, origin: JointVector, joint: int, value: float
) -> tuple[Array, Array, float]:
    """Heights and joints of postures on the component through q, in order, and the height of q.

    Height 0 is near the last origin, where a joint has a value.
    """
    manifold = self_motion_manifold(plan.task, plan.path(t).z, starts=[q], seeds=1, tries=1)
    robot = plan.robot
    component = min(manifold.components, key=lambda one: float(_apart(robot, one.curve.q, q).min()))
    s = np.linspace(0.0, component.length, POSTURES, endpoint=not component.closed)
    Q = component.at(s)
    left = _turned(robot, np.zeros_like(Q) + (value - Q[:, joint])[:, None])[:, joint]
    zero = int((_apart(robot, Q, origin) + 10.0 * np.abs(left)).argmin())
    height = s - s[zero]
    slope = float(component.tangent(float(s[zero]))[joint])
    if abs(slope) > 0.1:
        height -= left[zero] / slope
    if component.closed:
        half = 0.5 * component.length
        height = (height + half) % component.length - half
        order = np.argsort(height)
        height, Q, s = height[order], Q[order], s[order]
    near = int(_apart(robot, Q, q).argmin())
    ahead = float(component.tangent(float(s[near])) @ _turned(robot, q - Q[near]))
    return height, Q, float(height[near]) + ahead


def _turned(robot: Robot, difference: Array) -> Array:
    """Differences of joints without full turns."""
    turns = np.array([joint.kind != "prismatic" for joint in robot.joints])
    return np.where(turns, (difference + np.pi) % (2.0 * np.pi) - np.pi, difference)


def _apart(robot: Robot, Q: Float[Array, "K n"], q: JointVector) -> Float[Array, " K"]:
    return np.asarray(np.linalg.norm(_turned(robot, Q - q), axis=1))


def _kinds(plan: Plan, Q: Float[Array, "K n"], clearances: Clearances | None) -> Int[Array, " K"]:
    """Index in `KINDS` of each posture."""
    robot = plan.robot
    turns = np.array([joint.kind != "prismatic" for joint in robot.joints]) & np.isfinite(robot.lower)
    least = np.where(np.isfinite(robot.lower), robot.lower, 0.0)
    within = np.where(turns, least + (Q - least) % (2.0 * np.pi), Q)
    beyond = ((within < robot.lower) | (within > robot.upper)).any(axis=1)
    _, J = plan.task.kinematics.linearize(np.ascontiguousarray(Q))
    sizes = np.linalg.svd(J, compute_uv=False)
    kind = np.zeros(len(Q), dtype=np.int64)
    kind[sizes[:, -1] < SINGULAR * sizes[:, 0]] = 3
    if clearances is not None:
        kind[clearances(np.ascontiguousarray(Q.T)) < 0.0] = 2
    kind[beyond] = 1
    return kind


def _cost(ax: Axes, plan: Plan) -> None:
    """Draw the cost along the path, |dq/dt|²."""
    times = np.linspace(plan.start, plan.end, 4 * len(plan.times))
    speeds = np.gradient(plan.joints(times), times, axis=0)
    ax.plot(times, (speeds**2).sum(axis=1), color=CHOSEN)
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("cost |dq/dt|² [rad²/s²]")


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
