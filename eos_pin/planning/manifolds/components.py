"""A component of a self-motion manifold with one redundant joint: a closed curve or an open one, by arc length."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin._kernels.kinematics import Kinematics
from eos_pin._kernels.tracing import Curve
from eos_pin.errors import InputError

TAU = 2.0 * np.pi
#: Task error of points between the nodes [m, rad].
EXACT = 1e-13
#: How close the cubics must come to it to say so, relative to the distance of the nodes.
CLOSE = 0.02


class Located(NamedTuple):
    """The point of a component that is nearest to a state.

    Attributes:
        s: Arc length.
        distance: Largest difference of one joint, whole turns of revolute joints left aside [rad or m].
    """

    s: float
    distance: float


@dataclass(frozen=True, eq=False)
class Component:
    """A connected curve of joints at one task point, parametrised by arc length.

    On a closed curve s may be any number: from one round to the next, joints that wind go on by whole turns.

    Attributes:
        kinematics: Kinematics of the task.
        z: The task point.
        curve: Nodes, unit vectors along the curve, and how it ends.
    """

    kinematics: Kinematics
    z: Vector
    curve: Curve

    @property
    def closed(self) -> bool:
        """Whether the curve comes back to its start."""
        return self.curve.ends[1] == "closed"

    @property
    def winding(self) -> Int[Array, " n"]:
        """Whole turns of each joint over one round."""
        return self.curve.winding

    @cached_property
    def nodes(self) -> Vector:
        """Arc length at each node, 0 at the first."""
        # Between two nodes the curve is taken for an arc of a circle, which is off by the fourth power of its angle.
        steps = self.curve.q[1:] - self.curve.q[:-1]
        chords = np.sqrt((steps * steps).sum(axis=1))
        change = self.curve.t[1:] - self.curve.t[:-1]
        half = np.arcsin(np.clip(0.5 * np.sqrt((change * change).sum(axis=1)), 0.0, 1.0))
        return np.concatenate(([0.0], np.cumsum(chords / np.sinc(half / np.pi))))

    @cached_property
    def length(self) -> float:
        """Length of one round, or from end to end."""
        return float(self.nodes[-1])

    @cached_property
    def _steps(self) -> Vector:
        """Arc length of each segment."""
        return self.nodes[1:] - self.nodes[:-1]

    # -- points ------------------------------------------------------------------------------------------------------

    def at(self, s: Array | float) -> Float[Array, "*k n"]:
        """Joints at arc lengths, one or many; exact to rounding in the task."""
        array = np.atleast_1d(np.asarray(s, dtype=float))
        guess = self._hermite(array)
        found = self.kinematics.project(guess, self.z, tol=EXACT, checked=False)
        return found.q if np.ndim(s) else found.q[0]

    def tangent(self, s: Array | float) -> Float[Array, "*k n"]:
        """Unit vectors along the curve at arc lengths, one or many."""
        array = np.atleast_1d(np.asarray(s, dtype=float))
        T = self.along(self.at(array))
        return T if np.ndim(s) else T[0]

    def along(self, Q: Float[Array, "K n"]) -> Float[Array, "K n"]:
        """Unit vectors along the curve at states on it."""
        return self._sense * self.kinematics.tangents(Q, self.z)[0]

    @cached_property
    def _sense(self) -> float:
        """Whether the curve runs along the kernel's unit vectors or against them."""
        middle = len(self.curve.q) // 2
        own = self.kinematics.tangents(self.curve.q[middle : middle + 1], self.z)[0][0]
        return 1.0 if own @ self.curve.t[middle] > 0.0 else -1.0

    def _hermite(self, s: Vector) -> Float[Array, "K n"]:
        """Cubic interpolation of the nodes."""
        rounds = np.floor(s / self.length) if self.closed else np.zeros(len(s))
        s = s - rounds * self.length
        if not self.closed and len(s) and (s.min() < -1e-9 or s.max() > self.length + 1e-9):
            raise InputError(f"arc length must be between 0 and {self.length:g}, got {s.min():g} to {s.max():g}")
        i = np.minimum(np.searchsorted(self.nodes[1:], s, side="right"), len(self.nodes) - 2)
        a, b, c, d = (coefficient[i] for coefficient in self._cubics)
        u = ((s - self.nodes[i]) / self._steps[i])[:, None]
        return a + u * (b + u * (c + u * d)) + TAU * rounds[:, None] * self.winding

    @cached_property
    def _cubics(self) -> tuple[Array, Array, Array, Array]:
        """Coefficients of each segment's cubic in u from 0 to 1, each (K − 1, n)."""
        q, L = self.curve.q, self._steps[:, None]
        t0, t1, step = L * self.curve.t[:-1], L * self.curve.t[1:], np.diff(q, axis=0)
        return q[:-1], t0, 3.0 * step - 2.0 * t0 - t1, t0 + t1 - 2.0 * step

    # -- turning points ----------------------------------------------------------------------------------------------

    @cached_property
    def bends(self) -> tuple[Int[Array, " b"], Vector, Vector]:
        """Turning points of all joints between nodes as the cubics have them: joint, arc length, value there."""
        a, b, c, d = self._cubics
        # Roots of b + 2 c u + 3 d u², in a form without cancellation.
        root = np.sqrt(np.maximum(c * c - 3.0 * b * d, 0.0))
        real = c * c >= 3.0 * b * d
        half = -(c + np.copysign(root, c))
        with np.errstate(divide="ignore", invalid="ignore"):
            candidates = half / (3.0 * d), b / half
        found = []
        for u in candidates:
            inside = real & (u >= 0.0) & (u < 1.0)
            segment, joint = np.nonzero(inside)
            u = u[segment, joint]
            x = (coefficient[segment, joint] for coefficient in (a, b, c, d))
            value = sum(part * u**power for power, part in enumerate(x))
            found.append((joint, self.nodes[segment] + u * self._steps[segment], value))
        joint, s, value = (np.concatenate(parts) for parts in zip(*found, strict=True))
        order = np.argsort(s)
        return joint[order], s[order], np.asarray(value)[order]

    @cached_property
    def turning(self) -> tuple[Array, ...]:
        """Arc lengths of each joint's turning points, where its motion along the curve changes sense."""
        joint, s, _ = self.bends
        exact = self.refine_bends(joint, s)
        return tuple(np.sort(exact[joint == i]) for i in range(self.kinematics.n))

    def refine_bends(self, joint: Int[Array, " b"], s: Vector) -> Vector:
        """Arc lengths where the unit vectors' entries for these joints vanish, from the cubics' turning points."""
        if not len(s):
            return s
        rows, width = np.arange(len(s)), 1e-4
        ends = (0.0, self.length) if not self.closed else (-np.inf, np.inf)
        for _ in range(3):
            here, ahead = np.clip(s - width, *ends), np.clip(s + width, *ends)
            T = self.tangent(np.concatenate((here, ahead)))
            low, high = T[rows, joint], T[len(s) + rows, joint]
            slope = (high - low) / (ahead - here)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.where(slope != 0.0, -0.5 * (low + high) / slope, 0.0)
            # A turn so flat that the secant leads far away stays where the cubic has it.
            s = np.clip(s + np.where(np.abs(step) < 0.05, step, 0.0), *ends)
        return s

    # -- which point is nearest --------------------------------------------------------------------------------------

    def locate(self, q: JointVector) -> Located:
        """The point of the curve nearest to a state that is on it or close by, by Newton's method from a node."""
        # Of two strands side by side q is on the one that runs its way.
        T = self._sense * self.kinematics.tangents(q[None], self.z)[0]
        (i,), (gap,) = self.kinematics.nearest(q[None], T, self.curve)
        if i < 0:
            difference = self._apart(q - self.curve.q)
            i = int((difference * difference).sum(axis=1).argmin())
            gap = difference[i]
        s = float(self.nodes[i] + gap @ self.curve.t[i])
        for _ in range(6):
            if not self.closed:
                s = min(max(s, 0.0), self.length)
            here = self.at(s)
            gap = self._apart(q - here)
            move = float(gap @ self.along(here[None])[0])
            if abs(move) < 1e-13 or np.abs(gap).max() > 1.0:
                break
            s += move
        return Located(s % self.length if self.closed else s, float(np.abs(gap).max()))

    def passes(self, Q: Float[Array, "K n"], T: Float[Array, "K n"]) -> Bool[Array, " K"]:
        """Whether states at z lie on the curve.

        They do where the cubics come close by and the kernel's unit vector `T` has the curve's direction: of two
        branches that nearly meet, the other one runs the other way.
        """
        if not len(Q):
            return np.zeros(0, dtype=bool)
        node, gap = self.kinematics.nearest(Q, self._sense * T, self.curve)
        found = node >= 0
        if not found.all():
            passes = np.zeros(len(Q), dtype=bool)
            passes[found] = self.passes(Q[found], T[found])
            return passes
        ahead = np.einsum("kn,kn->k", gap, self.curve.t[node])
        segment = np.clip(np.where(ahead >= 0.0, node, node - 1), 0, len(self._steps) - 1)
        # A closed curve goes on before its first node and after its last one.
        segment = np.where(self.closed & (node == 0) & (ahead < 0.0), len(self._steps) - 1, segment)
        segment = np.where(self.closed & (node == len(self._steps)) & (ahead > 0.0), 0, segment)
        a, b, c, d = (coefficient[segment] for coefficient in self._cubics)
        step = self._steps[segment]
        u = np.where(segment == node, 0.0, 1.0) + ahead / step
        for _ in range(3):
            w = u[:, None]
            gap = self._apart(Q - (a + w * (b + w * (c + w * d))))
            slope = b + w * (2.0 * c + w * 3.0 * d)
            u = np.clip(u + np.einsum("kn,kn->k", gap, slope) / np.einsum("kn,kn->k", slope, slope), -0.5, 1.5)
        return np.einsum("kn,kn->k", gap, gap) <= (CLOSE * step) ** 2

    def _apart(self, difference: Array) -> Array:
        """Differences of joints, without whole turns of revolute ones."""
        return np.where(self.kinematics.revolute, difference - TAU * np.round(difference / TAU), difference)
