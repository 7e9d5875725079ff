"""Changes that would help where no motion was found: each is tried before it is advised."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eos_pin._arrays import Array
from eos_pin.errors import EosError
from eos_pin.planning.grid import lengths_of
from eos_pin.planning.manifolds.manifold import self_motion_manifold
from eos_pin.planning.obstacles.bodies import Clearances
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.planning.problem import Bar, Problem

#: Distances by which a solid is made smaller all around [m], and ranges by which limits are widened [rad or m].
DISTANCES, RANGES = (0.03, 0.1), (0.1, 0.4)
#: Size of the smaller path that is tried, as a part of its own.
SIZE = 0.8
#: Seconds of the processor that changes are tried for: at least, at most, and as a part of the search's.
LEAST, MOST, PART = 2.0, 15.0, 1.0
#: Causes that are looked at, most frequent first.
CAUSES = 2


@dataclass(frozen=True, eq=False)
class Change:
    """A change of a problem.

    Attributes:
        words: The change in words, after "with".
        problem: The problem with it.
        jumps: Whether joints may jump.
        size: Size of the path as a part of its own.
        pace: Pace as a part of its own; joints may go steps that are longer by as much.
    """

    words: str
    problem: Problem
    jumps: bool = False
    size: float = 1.0
    pace: float = 1.0


class _TimeUpError(Exception):
    """The time for trials is over."""


class Deadline:
    """A progress report that ends a search when its time of the processor is over.

    Args:
        seconds: The time from now on.
    """

    def __init__(self, seconds: float) -> None:
        self.end = time.thread_time() + seconds

    def __call__(self, what: str, part: float) -> None:
        if time.thread_time() > self.end:
            raise _TimeUpError


def tried(
    changes: Sequence[Change], solve: Callable[[Change, Deadline], Array | None], spent: float
) -> tuple[list[str], list[str]]:
    """Changes with which a motion was found, one of each kind, and those with which none was.

    Args:
        changes: The changes, of each kind the smallest first.
        solve: Searches for a motion with a change.
        spent: Time of the processor that the refused search took [s].
    """
    deadline = Deadline(float(np.clip(PART * spent, LEAST, MOST)))
    helpful, useless = list[str](), list[str]()
    for change in changes:
        try:
            deadline("", 0.0)
            found = solve(change, deadline)
        except _TimeUpError:
            break
        except EosError:
            continue
        (useless if found is None else helpful).append(change.words)
        if found is not None:
            break
    return helpful, useless


def changes_for(
    problem: Problem, bars: Sequence[Bar], jumps: bool, closed: bool, bounded: bool = False
) -> list[Change]:
    """Changes that take away the most frequent causes, or make a motion easier to find, those not there yet.

    After the causes come whole turns where they may help, jumps, a slower path and a smaller one.

    Args:
        problem: The problem.
        bars: Causes.
        jumps: Whether joints may jump.
        closed: Whether the path is closed.
        bounded: Whether steps of joints are bounded.
    """
    made: list[Change] = []
    for i, bar in enumerate(bars[:CAUSES]):
        if bar.joint is not None:
            made += _wider(problem, bar)
        elif bar.solid and bar.solid not in [other.solid for other in bars[:i]]:
            made += _further(problem, bar.solid)
    winding = replace(problem, winding=True)
    if closed and not problem.winding and winding.winds.any():
        made.append(Change("whole turns each round allowed (allow_winding=True, --allow-winding)", winding))
    if not jumps:
        made.append(Change("reconfigurations allowed", problem, jumps=True))
    if bounded:
        made.append(Change("steps of joints twice as long (half the pace)", problem, jumps, pace=0.5))
    if lengths_of(problem.manifold.task):
        made.append(Change(f"the path at {SIZE:.0%} of its size", problem, jumps, size=SIZE))
    return made


def next_steps(problem: Problem, useless: Sequence[str]) -> str:
    """Changes that were tried in vain, and those that are left to try, in words."""
    task = problem.manifold.task
    left = ["lead the path elsewhere", "search longer (--effort)"]
    if any("size" in words for words in useless):
        left[0] = "move the path, or make it smaller still"
    elif lengths_of(task):
        left[0] = "move the path or make it smaller"
    if 0 < lengths_of(task) < task.m:
        left.insert(0, "leave the orientation free (--task position) or give it a tolerance (--tolerance)")
    ways = f"{', '.join(left[:-1])}, or {left[-1]}" if left[1:] else left[0]
    tries = f"Quick searches found none either with {'; '.join(useless)}. " if useless else ""
    return f"{tries}Next, {ways}"


def _wider(problem: Problem, bar: Bar) -> list[Change]:
    """Changes of one limit."""
    made, joint = [], problem.manifold.robot.joints[bar.joint or 0]
    for room in RANGES:
        lower, upper = problem.lower.copy(), problem.upper.copy()
        if bar.below:
            lower[bar.joint] -= room
        else:
            upper[bar.joint] += room
        unit = "m" if joint.kind == "prismatic" else "rad"
        words = f"{room:g} {unit} beyond the {'lower' if bar.below else 'upper'} limit of {joint.name!r}"
        made.append(Change(words, replace(problem, lower=lower, upper=upper)))
    return made


def _further(problem: Problem, name: str) -> list[Change]:
    """Changes that give more distance from one solid."""
    assert problem.clearances is not None
    scene, made = problem.clearances.scene, []
    for distance in DISTANCES:
        smaller = Scene(
            [_smaller_box(box, distance) if box.name == name else box for box in scene.boxes],
            [_smaller_capsule(c, distance) if c.name == name else c for c in scene.capsules],
            scene.meshes,
        )
        changed = replace(problem, clearances=Clearances(problem.clearances.bodies, smaller))
        made.append(Change(f"{100.0 * distance:g} cm more distance from {name!r}", changed))
    return made


def _smaller_box(box: Box, distance: float) -> Box:
    return replace(box, size=np.maximum(np.asarray(box.size) - 2.0 * distance, 1e-3))


def _smaller_capsule(capsule: Capsule, distance: float) -> Capsule:
    return replace(capsule, radius=max(capsule.radius - distance, 0.0))


def advice(bars: Sequence[Bar]) -> str:
    """Change that would help against the most frequent causes, in words."""
    reasons = " ".join(bar.reason for bar in bars[:2])
    if "too close" in reasons:
        return "More distance from that body would help, or another path"
    if "tolerance" in reasons:
        return "A wider tolerance would help, or another placement of the path"
    if "limit" in reasons:
        return "More range of that joint, less margin or another placement of the path would help"
    if "reach" in reasons:
        return "Move the path towards the robot, or away from the singularity"
    return "Closer way points, another placement of the path, or reconfigurations would help"


def components_at(problem: Problem, z: Array) -> str:
    """Number of components at a task point and the causes that end their arcs, in words; empty without such."""
    if problem.r != 1:
        return ""
    try:
        there = self_motion_manifold(
            problem.manifold.task, z, limits=(problem.lower, problem.upper), seeds=40, tries=300
        )
    except EosError:
        return ""
    count = len(there.components)
    if not count:
        return "its self-motion manifold there is empty"
    open_ = sum(not component.closed for component in there.components)
    words = f"its self-motion manifold there has {count} component{'s' * (count > 1)}"
    if open_:
        words += f", {open_} of which end{'s' * (open_ == 1)} at singularities"
    if not there.arcs:
        return f"{words}, none within the limits"
    inside = len({arc.component for arc in there.arcs})
    causes = ", ".join(there.reasons[:3])
    return f"{words}, {inside} with arcs within the limits" + (f", which end at the {causes}" if causes else "")
