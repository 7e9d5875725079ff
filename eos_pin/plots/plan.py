"""Figures of a plan: joints over the path with their limits, and the redundancy map or the cost above them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin.planning.manifolds.components import Component
from eos_pin.planning.manifolds.manifold import self_motion_manifold
from eos_pin.planning.obstacles.bodies import Clearances
from eos_pin.planning.plans import Plan
from eos_pin.plots._style import PAGE, colors_of, style
from eos_pin.robot.model import Robot
from eos_pin.tasks.batch import Manifold
from eos_pin.trajectories.through import sampled

#: Places along the path, and postures at each, of a redundancy map.
PLACES, POSTURES = 60, 200
#: Random starts in a row, at each place, that find no further component.
SEEDS = 15
#: Postures of a component that say which one it is at the next place.
VOTES = 8
#: Distance between the components that a plan is not on, drawn one above the other [rad].
GAP = 1.5
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
    strips = redundancy_strips(plan, clearances) if redundant == 1 else []
    heights = [1.0] * min(redundant, 1) + [0.15 + 0.09 * len(strips)] * (len(strips) > 1) + [1.0]
    with style():
        figure = Figure(figsize=(PAGE, 0.375 * PAGE * sum(heights)), layout="constrained")
        axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        if strips:
            handles = redundancy_map(axes[:-1].tolist(), plan, strips)
            figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
        elif redundant:
            _cost(axes[0], plan)
        _joints(axes[-1], plan)
        lines = axes[-1].get_lines()[: plan.robot.n]
        figure.legend(handles=lines, loc="outside lower center", ncols=min(7, len(lines)))
    return figure


# -- the redundancy map ----------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Strip:
    """A component of the self-motion manifold, followed along a path.

    Attributes:
        joint: Joint that moves along it; height 0 is where it has the value it had first.
        value: That value.
        origin: Posture at height 0, at the last place.
        last: Postures at the last place.
        columns: Heights and kinds of postures, in order, by the number of the place.
        chosen: Height of the plan at each place, if it is on this component.
    """

    joint: int
    value: float
    origin: JointVector
    last: Array
    columns: dict[int, tuple[Array, Array]] = field(default_factory=dict)
    chosen: list[float] = field(default_factory=list)


def redundancy_strips(plan: Plan, clearances: Clearances | None = None) -> list[Strip]:
    """Components of the self-motion manifold along the path of a plan, the plan's own first.

    Where two meet and become one, the strip of one of them ends; where one parts in two, another begins.
    """
    times = np.linspace(plan.start, plan.end, PLACES)
    moved = Manifold(plan.task).null(plan.q.T, sampled(plan.path, plan.times).T)[:, :, 0]
    q = plan(plan.start).q
    joint = int(np.abs(moved).mean(axis=0).argmax())
    strips = [Strip(joint, float(q[joint]), q, q[None])]
    for place, t in enumerate(times.tolist()):
        q = plan(t).q
        known = [strip.last[:: max(1, len(strip.last) // VOTES)] for strip in strips if place - 1 in strip.columns]
        starts = np.concatenate([q[None], *known])
        found = self_motion_manifold(plan.task, plan.path(t).z, starts=starts, seeds=SEEDS)
        rest = list(found.components)
        own = min(rest, key=lambda one: _apart(plan.robot, one.curve.q, q).min())
        rest.remove(own)
        height = _extended(plan, strips[0], own, place, clearances)
        near = int(_apart(plan.robot, strips[0].last, q).argmin())
        ahead = float(own.along(strips[0].last[near][None])[0] @ _turned(plan.robot, q - strips[0].last[near]))
        strips[0].chosen.append(float(height[near]) + ahead)
        goes_on = [strip for strip in strips[1:] if place - 1 in strip.columns]
        for strip in sorted(goes_on, key=lambda strip: -np.ptp(strip.columns[place - 1][0])):
            on = _continued(plan.robot, strip, found.components)
            if on in rest:
                rest.remove(on)
                _extended(plan, strip, on, place, clearances)
        for component in rest:
            # Strips that ended take up what begins, so that there are no more of them than components at one place.
            ended = [strip for strip in strips[1:] if place not in strip.columns and place - 1 not in strip.columns]
            start = component.at(0.0)
            if not ended:
                strips.append(Strip(joint, float(start[joint]), start, start[None]))
            strip = min(ended, key=lambda old: _apart(plan.robot, old.last, start).min()) if ended else strips[-1]
            _extended(plan, strip, component, place, clearances)
    return strips


def _continued(robot: Robot, strip: Strip, components: Sequence[Component]) -> Component:
    """The component that most postures of a strip are nearest to."""
    votes = [
        int(np.argmin([_apart(robot, one.curve.q, q).min() for one in components]))
        for q in strip.last[:: max(1, len(strip.last) // VOTES)]
    ]
    return components[int(np.bincount(votes).argmax())]


def _extended(plan: Plan, strip: Strip, component: Component, place: int, clearances: Clearances | None) -> Array:
    """Heights of postures on a component, in order, with which a strip goes on at a place."""
    robot, joint = plan.robot, strip.joint
    s = np.linspace(0.0, component.length, POSTURES, endpoint=not component.closed)
    Q = component.at(s)
    left = _turned(robot, np.zeros_like(Q) + (strip.value - Q[:, joint])[:, None])[:, joint]
    zero = int((_apart(robot, Q, strip.origin) + 10.0 * np.abs(left)).argmin())
    height = s - s[zero]
    slope = float(component.tangent(float(s[zero]))[joint])
    if abs(slope) > 0.1:
        height -= left[zero] / slope
    if component.closed:
        half = 0.5 * component.length
        height = (height + half) % component.length - half
        order = np.argsort(height)
        height, Q = height[order], Q[order]
    strip.origin, strip.last = Q[int(np.abs(height).argmin())], Q
    strip.columns[place] = height, _kinds(plan, Q, clearances)
    return height


def redundancy_map(axes: Sequence[Axes], plan: Plan, strips: Sequence[Strip]) -> list[Artist]:
    """Draw the components of the self-motion manifold at each place of the path, and the plan on its own.

    The height is the arc length along the component, from where the joint that moves most along it is as at the start
    of the plan. Where limits, collisions or singularities bar postures, the map is shaded. The second axes have the
    components that the plan is not on, one above the other.

    Returns:
        The line of the plan and a patch for each colour, for a legend.
    """
    times = np.linspace(plan.start, plan.end, PLACES)
    met = set(_shaded(axes[0], times, strips[0], 0.0))
    (line,) = axes[0].plot(times, strips[0].chosen, color=CHOSEN, lw=1.6, label="plan")
    name = plan.robot.joints[strips[0].joint].name
    axes[0].set_ylabel(f"component of the plan,\narc length [rad]\n(0: {name} as at the start)")
    ticks, top = list[float](), 0.0
    for strip in strips[1:]:
        low, high = _ends(strip)
        met |= set(_shaded(axes[1], times, strip, top - low))
        ticks.append(top + 0.5 * (high - low))
        top += high - low + GAP
    if ticks:
        axes[1].set_yticks(ticks, [str(i) for i in range(2, len(ticks) + 2)])
        axes[1].set_ylim(-GAP, top)
        axes[1].set_ylabel("other components\n(arc lengths to one scale)")
    return [line, *(Patch(color=KINDS[kind][1], label=KINDS[kind][0]) for kind in sorted(met))]


def _ends(strip: Strip) -> tuple[float, float]:
    heights = [height for height, _ in strip.columns.values()]
    return min(float(h[0]) for h in heights), max(float(h[-1]) for h in heights)


def _shaded(ax: Axes, times: Vector, strip: Strip, base: float) -> list[int]:
    """Draw a strip above a base, and return the kinds of postures it has."""
    grid = np.linspace(*_ends(strip), POSTURES)
    image = np.full((POSTURES, PLACES), np.nan)
    for k, (height, kind) in strip.columns.items():
        inside = (grid >= height[0]) & (grid <= height[-1])
        rows = np.clip(np.searchsorted(height, grid[inside]), 0, len(height) - 1)
        image[inside, k] = kind[rows]
    colors = ListedColormap([color for _, color in KINDS])
    ax.pcolormesh(times, base + grid, image, cmap=colors, vmin=-0.5, vmax=len(KINDS) - 0.5, rasterized=True)
    return [int(kind) for kind in np.unique(image[np.isfinite(image)])]


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


def _part(values: Float[Array, " T"], low: float, high: float) -> Any:
    return (values - low) / (high - low)
