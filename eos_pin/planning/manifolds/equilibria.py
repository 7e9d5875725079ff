"""Dynamics of the self-motion while the task is held: equilibria under gravity, their frequencies, ways between them.

The task is held by forces on z alone, torques G'ᵀ F^z: the self-motion then moves as a mechanical system of r degrees
of freedom with the inertia M_vv = Dᵀ M D of Eq. (26) and the potential P(v) = U_g(y(z, v)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    SelfMotionVector,
    Vector,
    VectorLike,
    by_value,
    checked,
    frozen_copy,
    vector,
)
from eos_pin.charts._basis import null_space
from eos_pin.errors import InputError
from eos_pin.planning.manifolds.arcs import Arc
from eos_pin.planning.manifolds.components import EXACT, TAU, Component
from eos_pin.planning.manifolds.manifold import SelfMotionManifold
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task

#: Arc length from sample to sample of the slope of the potential.
SPACING = 0.02
#: Points that a piece is split into where the slope comes near zero without a change of sign between samples.
SPLIT, ROUNDS = 16, 3
#: Step of joints over which gravity is differenced [rad or m].
STEP = 1e-5
#: Slope of the potential that is left at an equilibrium, relative to the weight times the reach.
LEVEL = 1e-12
#: Newton's steps of the search with more than one redundant joint, and the longest of them [rad or m].
MOST_STEPS, LONGEST = 200, 0.2
#: Equilibria whose joints differ by less are one [rad or m].
SAME = 1e-5


@by_value
@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A posture in which gravity leaves the self-motion at rest while the task is held.

    Attributes:
        q: Joints [rad or m].
        potential: Potential energy of gravity [J].
        stiffness: Second derivative of the potential in v on the chart based at q, (r, r).
        inertia: M_vv there, (r, r).
        within_limits: Whether q, or q and whole turns of its joints, is within the joint limits.
        component: Number of the manifold's component; −1 with more than one redundant joint.
        s: Arc length on it; NaN with more than one redundant joint.
        basis: V of the chart based at q, (n, r).
    """

    q: JointVector
    potential: float
    stiffness: Float[Array, "r r"]
    inertia: Float[Array, "r r"]
    within_limits: bool
    component: int
    s: float
    basis: Float[Array, "n r"]

    @cached_property
    def _solved(self) -> tuple[Vector, Array]:
        values, vectors = scipy.linalg.eigh(self.stiffness, self.inertia)
        return frozen_copy(values), frozen_copy(self.basis @ vectors)

    @property
    def eigenvalues(self) -> Vector:
        """Squares ω² of natural angular frequencies, (r,), the least first; negative where unstable [1/s²]."""
        return self._solved[0]

    @property
    def modes(self) -> Float[Array, "n r"]:
        """Joint directions of the modes, one column each, with modesᵀ M modes = I."""
        return self._solved[1]

    @property
    def stable(self) -> bool:
        """Whether small motions stay small."""
        return bool(self.eigenvalues[0] > 0.0)

    @property
    def frequencies(self) -> Vector:
        """Natural frequencies of the modes that oscillate [Hz]."""
        return np.sqrt(self.eigenvalues[self.eigenvalues > 0.0]) / TAU

    @property
    def growth(self) -> Vector:
        """Rates at which small motions grow along the modes that do not oscillate [1/s]."""
        return np.sqrt(-self.eigenvalues[self.eigenvalues <= 0.0])


class Crossing(NamedTuple):
    """The way from one stable equilibrium to the next on a component.

    Attributes:
        start: Number of the equilibrium it starts at.
        end: Number of that it leads to.
        top: Number of the unstable one between them, the highest.
        energy: Energy needed [J].
        within_limits: Whether all of the way is within joint limits.
    """

    start: int
    end: int
    top: int
    energy: float
    within_limits: bool


# -- the reduced system at one posture ---------------------------------------------------------------------------------


def slope(task: Task, q: JointVector) -> tuple[SelfMotionVector, Array]:
    """Slope Vᵀ g of the potential in v on the chart based at q, and V."""
    _, J = task._linearize(q)
    V = null_space(J)
    return V.T @ task.robot._gravity(q), V


def stiffness(task: Task, q: JointVector, V: Float[Array, "n r"]) -> Float[Array, "r r"]:
    """Second derivative of the potential in v at the base point of a chart.

    With y'' = −U B Ġ'ẏ, Eq. (20), it is Vᵀ (∂g/∂q) V − λ · Ġ'ẏ, where λ = (G'G'ᵀ)⁻¹ G' g is the force that holds the
    task, and Ġ'ẏ the drift at ẏ = V dv.
    """
    robot, r = task.robot, V.shape[1]
    g, J = robot._gravity(q), task._linearize(q)[1]
    force = np.linalg.solve(J @ J.T, J @ g)
    columns = [(robot._gravity(q + STEP * x) - robot._gravity(q - STEP * x)) / (2.0 * STEP) for x in V.T]
    K = V.T @ np.column_stack(columns)
    single = [float(force @ task._at(q, x).drift) for x in V.T]
    for i in range(r):
        K[i, i] -= single[i]
        for j in range(i):
            # The drift is a quadratic form of the velocity.
            both = 0.5 * (float(force @ task._at(q, V[:, i] + V[:, j]).drift) - single[i] - single[j])
            K[i, j] -= both
            K[j, i] -= both
    return 0.5 * (K + K.T)


def equilibrium_at(
    manifold: SelfMotionManifold, q: JointVector, component: int = -1, s: float = math.nan
) -> Equilibrium:
    """The equilibrium at joints where the slope of the potential is zero."""
    task, robot = manifold.task, manifold.task.robot
    _, V = slope(task, q)
    return Equilibrium(
        frozen_copy(q),
        robot._potential_energy(q),
        frozen_copy(stiffness(task, q, V)),
        frozen_copy(V.T @ robot._mass(q) @ V),
        _within(manifold, q),
        component,
        s,
        frozen_copy(V),
    )


def _within(manifold: SelfMotionManifold, q: JointVector) -> bool:
    """Whether joints, or joints and whole turns, are within limits."""
    turns = np.where(np.isfinite(manifold.lower), np.ceil((manifold.lower - q) / TAU - 1e-12), 0.0)
    least = np.where(manifold.task.kinematics.revolute, q + TAU * turns, q)
    return bool(((least >= manifold.lower - 1e-9) & (least <= manifold.upper + 1e-9)).all())


# -- all of them -------------------------------------------------------------------------------------------------------


@checked
def equilibria(
    manifold: SelfMotionManifold, *, starts: Sequence[VectorLike] = (), count: int = 12, seed: int = 0
) -> tuple[Equilibrium, ...]:
    """Equilibria of the self-motion under gravity while the task is held.

    With one redundant joint all of them, on every component, whatever the joint limits are: the sign of the potential's
    slope is followed along each curve. With more, those that searches from postures within the limits end at: down to a
    minimum, and by Newton's method to the next of any kind.

    Args:
        manifold: All postures at the task point, from `self_motion_manifold`.
        starts: With more than one redundant joint, postures at the task point to search from, besides random ones.
        count: With more than one redundant joint, how many random ones.
        seed: Which these are.

    Returns:
        By component and arc length; with more redundant joints by potential energy.

    Raises:
        InputError: Gravity does no work on the self-motion, as in a plane that lies flat: every posture is at rest.
        RobotError: The robot has no inertia.
    """
    robot = manifold.task.robot
    robot.check_dynamics()
    if manifold.components:
        found = [
            equilibrium_at(manifold, component.at(s), i, s)
            for i, component in enumerate(manifold.components)
            for s in _levels(robot, component)
        ]
        return tuple(found)
    given = [vector(q, robot.n, "a start") for q in starts]
    drawn = [] if manifold.empty else list(manifold.random(count, seed))
    if not given and not drawn:
        raise InputError("there is no posture to search from: give one as a start that is at the task point")
    return tuple(_searched(manifold, [*given, *drawn]))


def slopes(robot: Robot, component: Component, s: Vector) -> Vector:
    """Slope of the potential along a component [J/rad or J/m]."""
    Q = component.at(s)
    g = np.array([robot._gravity(q) for q in Q])
    return np.asarray(np.einsum("kn,kn->k", g, component.along(Q)))


def _levels(robot: Robot, component: Component) -> list[float]:
    """Arc lengths at which the potential is level."""
    s = np.linspace(0.0, component.length, max(8, math.ceil(component.length / SPACING)) + 1)
    d = slopes(robot, component, s)
    scale = _weight(robot)
    if np.abs(d).max() < 1e-9 * scale:
        raise InputError(
            f"gravity does no work on the self-motion of {robot.name!r}: every posture is at rest. Give a gravity that "
            "does, such as --gravity 0 -9.81 0 for a planar robot that stands upright"
        )
    for _ in range(ROUNDS):
        # Where the slope comes nearest to zero and turns back, a pair of roots may lie between two samples.
        near = np.flatnonzero((np.abs(d[1:-1]) < np.abs(d[:-2])) & (np.abs(d[1:-1]) <= np.abs(d[2:]))) + 1
        near = near[(np.sign(d[near - 1]) == np.sign(d[near])) & (np.sign(d[near]) == np.sign(d[near + 1]))]
        if not len(near):
            break
        more = np.concatenate([np.linspace(s[i - 1], s[i + 1], SPLIT + 2)[1:-1] for i in near])
        s, order = np.unique(np.concatenate((s, more)), return_index=True)
        d = np.concatenate((d, slopes(robot, component, more)))[order]
    cuts = np.flatnonzero((d[1:] >= 0.0) != (d[:-1] >= 0.0))
    low, high, at_low, at_high = s[cuts], s[cuts + 1], d[cuts], d[cuts + 1]
    roots = [_root(robot, component, a, b, x, y) for a, b, x, y in zip(low, high, at_low, at_high, strict=True)]
    return [root for root in roots if not component.closed or root < component.length]


def _root(robot: Robot, component: Component, low: float, high: float, at_low: float, at_high: float) -> float:
    if at_low == 0.0 or at_high == 0.0:
        return low if at_low == 0.0 else high
    from scipy.optimize import brentq

    return float(brentq(lambda s: float(slopes(robot, component, np.array([s]))[0]), low, high, xtol=1e-13))


def _weight(robot: Robot) -> float:
    """Weight times reach, the scale of potential energies [J]."""
    mass = sum(inertia.mass for inertia in robot.model.inertias)
    return float(mass * np.linalg.norm(robot.model.gravity.linear) * robot.reach)


# -- ways between them -------------------------------------------------------------------------------------------------


@checked
def crossings(manifold: SelfMotionManifold, found: Sequence[Equilibrium]) -> tuple[Crossing, ...]:
    """Ways from each stable equilibrium to the next on its component, to both sides; for one redundant joint."""
    ways = []
    for i, component in enumerate(manifold.components):
        own = [k for k, each in enumerate(found) if each.component == i]
        stable = [k for k in own if found[k].stable]
        round_ = component.length if component.closed else 0.0
        for a, b in zip(stable, stable[1:] + stable[:1] if component.closed else stable[1:], strict=False):
            # Onwards from a to b, on a closed component perhaps across its seam.
            start, end = found[a].s, found[b].s
            end += round_ if end <= start else 0.0
            places = [(k, found[k].s + (round_ if found[k].s <= start else 0.0)) for k in own if not found[k].stable]
            between = [k for k, s in places if start < s < end]
            if not between:
                continue
            top = max(between, key=lambda k: found[k].potential)
            inside = any(
                arc.component == i and (arc.closed or _covers(arc, start, end, component)) for arc in manifold.arcs
            )
            ways += [
                Crossing(x, y, top, found[top].potential - found[x].potential, inside)
                for x, y in dict.fromkeys(((a, b), (b, a)))
            ]
    return tuple(ways)


def _covers(arc: Arc, start: float, end: float, component: Component) -> bool:
    """Whether an arc holds the piece from `start` to `end`, in any round."""
    shifts = [k * component.length for k in (range(-2, 3) if component.closed else range(1))]
    return any(arc.start <= start + shift and end + shift <= arc.end for shift in shifts)


# -- more than one redundant joint -------------------------------------------------------------------------------------


def _searched(manifold: SelfMotionManifold, starts: Sequence[JointVector]) -> list[Equilibrium]:
    """Equilibria that searches from postures end at."""
    task, scale = manifold.task, _weight(manifold.task.robot)
    found: list[Equilibrium] = []
    flat = True
    for start in starts:
        for downhill in (True, False):
            q, worked = _descended(task, manifold.z, start, downhill, scale)
            flat &= not worked
            if q is None or any(np.abs(task.robot._way(each.q, q)).max() < SAME for each in found):
                continue
            found.append(equilibrium_at(manifold, q))
    if flat:
        raise InputError(
            f"gravity does no work on the self-motion of {task.robot.name!r}: every posture is at rest. Give a gravity "
            "that does, such as --gravity 0 -9.81 0 for a planar robot that stands upright"
        )
    return sorted(found, key=lambda each: each.potential)


def _descended(task: Task, z: Vector, q: JointVector, downhill: bool, scale: float) -> tuple[JointVector | None, bool]:
    """Joints where a search ends, None if nowhere, and whether gravity did any work; chart after chart."""
    worked = False
    for _ in range(MOST_STEPS):
        d, V = slope(task, q)
        worked |= bool(np.abs(d).max() > 1e-9 * scale)
        if not worked:
            return None, False
        if np.abs(d).max() <= LEVEL * scale:
            return q, True
        values, vectors = np.linalg.eigh(stiffness(task, q, V))
        values = np.maximum(np.abs(values), 1e-9 * scale) if downhill else values
        step = -vectors @ ((vectors.T @ d) / values)
        step *= min(1.0, LONGEST / max(float(np.linalg.norm(step)), 1e-300))
        before = task.robot._potential_energy(q)
        for _ in range(12):
            solved = task.kinematics.project((q + V @ step)[None], z, tol=EXACT, checked=False)
            if solved.found[0] and (
                not downhill
                or task.robot._potential_energy(solved.q[0]) <= before + 1e-4 * float(d @ step) + 1e-13 * scale
            ):
                q = solved.q[0]
                break
            step *= 0.5
        else:
            return None, True
    return None, True
