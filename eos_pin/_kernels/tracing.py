"""Continuation along the self-motion of a task with one redundant joint; `_trace` does the same compiled.

The self-motion {q: G(q) = z} is then a curve. Its unit vector t spans the null space of G', with det [G'; tᵀ] > 0: so
it is continuous along the curve, and turns round where a step crosses a singularity or leads to another branch that
passes close by; such steps are not taken.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin._kernels.plain import PlainChain

#: How a trace ends: back at its start; at a singularity; neither within the length that was allowed.
CLOSED, SINGULAR, LONG = 0, 1, 2
ENDS = ("closed", "singular", "long")
#: A state counts as singular where the least diagonal entry of R in G'ᵀ = Q R, relative to the largest, is below this.
REGULAR = 1e-9


class Curve(NamedTuple):
    """A curve of self-motion, by its nodes.

    Attributes:
        q: Joints of the nodes, continuous, (K, n); the last node of a closed curve is the first, or whole turns of
            revolute joints from it.
        t: Unit vectors along the curve, (K, n).
        ends: How it ends at its first and at its last node: `"closed"`, `"singular"` or `"long"`.
        winding: Whole turns of each joint along a closed curve, (n,).
    """

    q: Float[Array, "K n"]
    t: Float[Array, "K n"]
    ends: tuple[str, str]
    winding: Int[Array, " n"]


def tangents(chain: PlainChain, Q: Float[Array, "K n"], z: Vector) -> tuple[Float[Array, "K n"], Float[Array, " K"]]:
    """Unit vectors of the self-motion, and the regularity of each state, 0 at a singularity."""
    looks = [_look(chain, q, z) for q in Q]
    return np.reshape([look[2] for look in looks], Q.shape), np.array([look[3] for look in looks])


def trace(
    chain: PlainChain,
    start: JointVector,
    z: Vector,
    revolute: Bool[Array, " n"],
    direction: float,
    step: float,
    turn: float,
    length: float,
    shortest: float,
    tol: float,
    most: int,
) -> tuple[Float[Array, "K n"], Float[Array, "K n"], int]:
    """Trace the self-motion from a state, by predictor and corrector.

    Args:
        chain: Kinematics of the task.
        start: Joints at z.
        z: Task point.
        revolute: Which joints turn: their whole turns do not count when the start is looked for.
        direction: 1 along the unit vector, −1 against it.
        step: Largest step of one joint, as it is predicted [rad or m].
        turn: Largest angle between the unit vectors of neighbouring nodes [rad].
        length: Largest length of the trace.
        shortest: A step below this that still fails ends the trace at a singularity.
        tol: Largest task error of a node [m, rad].
        most: Most nodes.

    Returns:
        Joints and unit vectors of the nodes, and how the trace ended; no nodes where the start is singular.
    """
    _, _, t, least = _look(chain, start, z)
    if least < REGULAR:
        return np.empty((0, chain.n)), np.empty((0, chain.n)), SINGULAR
    q, t = start, direction * t
    Q, T, bend, h, travelled = [q], [t], np.zeros(chain.n), 0.1 * step, 0.0
    while travelled < length and len(Q) < most - 1:
        h = min(h, step / float(np.abs(t).max()))
        ahead = _correct(chain, q + h * (t + 0.5 * h * bend), z, 0.2 * h, tol)
        if ahead is None or t.dot(direction * ahead[1]) < math.cos(turn) or not t.dot(way := ahead[0] - q) > 0.5 * h:
            h *= 0.5
            if h < shortest:
                return np.array(Q), np.array(T), SINGULAR
            continue
        taken = math.sqrt(way.dot(way))
        # The start lies within this step: go there exactly, and see whether it is the start.
        back = Q[0] - q
        back = np.where(revolute, back - math.tau * np.round(back / math.tau), back)
        target = float(t.dot(back))
        if len(Q) > 2 and 0.0 < target <= 1.01 * taken and back.dot(back) <= 2.25 * taken * taken:
            goal = q + back
            for _ in range(5):
                landing = _correct(chain, q + target * (t + 0.5 * target * bend), z, 0.2 * h, tol)
                if landing is None:
                    break
                left = direction * float(landing[1].dot(goal - landing[0]))
                target += left
                if abs(left) < 1e-9:
                    break
            if landing is not None and np.abs(goal - landing[0]).max() <= 1e-6:
                return np.array([*Q, goal]), np.array([*T, T[0]]), CLOSED
        change = direction * ahead[1] - t
        bend, angle = change / taken, math.sqrt(change.dot(change))
        travelled += taken
        q, t = ahead[0], direction * ahead[1]
        Q.append(q)
        T.append(t)
        h = taken * min(2.0, 0.7 * turn / angle if angle > 0.35 * turn else 2.0)
    return np.array(Q), np.array(T), LONG


def nearest(
    Q: Float[Array, "K n"],
    T: Float[Array, "K n"],
    nodes: Float[Array, "L n"],
    units: Float[Array, "L n"],
    revolute: Array,
) -> tuple[Int[Array, " K"], Float[Array, "K n"]]:
    """Node nearest to each state among those where the curve runs the same way, and the difference from it.

    Args:
        Q: States.
        T: Unit vectors there.
        nodes: Joints of the nodes.
        units: Unit vectors along the curve at the nodes.
        revolute: Which joints turn: whole turns are left aside.

    Returns:
        Number of the node, −1 where the curve nowhere runs the same way, and the difference, infinite there.
    """
    number, gap = np.full(len(Q), -1, dtype=np.int64), np.full(Q.shape, np.inf)
    for k, (q, t) in enumerate(zip(Q, T, strict=True)):
        difference = q - nodes
        difference = np.where(revolute, difference - math.tau * np.round(difference / math.tau), difference)
        square = np.where(units @ t > 0.0, np.einsum("in,in->i", difference, difference), np.inf)
        i = int(square.argmin())
        if np.isfinite(square[i]):
            number[k], gap[k] = i, difference[i]
    return number, gap


def _look(chain: PlainChain, q: JointVector, z: Vector) -> tuple[float, JointVector, JointVector, float]:
    """Task error, the shortest step that removes it, the unit vector of the self-motion, and the regularity of q."""
    z_q, J = chain.task._linearize(q)
    error = chain.task._minus(z, z_q)
    basis, R = np.linalg.qr(J.T, mode="complete")
    diagonal = np.abs(R.diagonal())
    least = float(diagonal.min() / diagonal.max()) if diagonal.max() > 0.0 else 0.0
    t = basis[:, -1]
    t = t if np.linalg.det(np.vstack((J, t))) > 0.0 else -t
    step = basis[:, :-1] @ np.linalg.solve(R[:-1].T, error) if least > 0.0 else np.zeros(chain.n)
    return float(np.abs(error).max()), step, t, least


def _correct(
    chain: PlainChain, q: JointVector, z: Vector, most: float, tol: float
) -> tuple[JointVector, JointVector] | None:
    """Newton's method to the self-motion: joints and unit vector; None where it leads further away than `most`."""
    for _ in range(8):
        error, step, t, least = _look(chain, q, z)
        if error <= tol:
            return (q, t) if least > 0.0 else None
        way = math.sqrt(step.dot(step))
        if not way <= most:
            return None
        most -= 0.5 * way
        q = q + step
    return None
