"""Costs of postures and of motion by name, alone or as a weighted sum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, number, vector_of
from eos_pin.errors import FunctionError, InputError, UnknownNameError
from eos_pin.planning.obstacles.bodies import Clearances
from eos_pin.tasks.batch import Manifold, ranges

#: A cost of postures: their joints as rows (K, n), and a number for each, (K,).
PostureCost: TypeAlias = Callable[[Float[np.ndarray, "K n"]], Float[np.ndarray, " K"]]
#: A cost by name, a function of one's own, or several with their weights.
Cost: TypeAlias = "str | PostureCost | Mapping[str | PostureCost, float]"

#: Costs that have a name.
NAMES = ("motion", "posture", "limits", "clearance", "manipulability", "torque", "energy")
#: Distance below which clearance costs [m].
FAR = 0.15
#: Random postures that give manipulability and inertia their scale.
TYPICAL = 200


class Costs(NamedTuple):
    """Costs of a plan.

    Attributes:
        weights: Factor of each joint's weight in the cost of motion, (n,).
        posture: Cost of being at a posture, per second; None without.
    """

    weights: Array
    posture: PostureCost | None


def costs_of(
    cost: Cost | None, manifold: Manifold, bounds: tuple[Array, Array], clearances: Clearances | None, reference: Array
) -> Costs:
    """Costs of a plan, each scaled to about one per second.

    Args:
        cost: Names of `NAMES`, functions, or both with weights. `"posture"` is the squared distance from `reference`,
            `"limits"` the squared distance from the middle of the limits relative to their half width, `"clearance"`
            grows as bodies come closer than 0.15 m, `"manipulability"` as √det J Jᵀ falls, `"torque"` is the square of
            the torque that gravity asks for, relative to the effort limits; `"energy"` weighs the motion of each joint
            by its mean inertia, so that the cost is close to kinetic energy.
        manifold: The task's manifolds.
        bounds: Least and largest joints.
        clearances: Distances that count.
        reference: Joints to be near to.

    Raises:
        InputError: A name is not known, a weight is negative, or there is nothing to be clear of.
    """
    robot, ones = manifold.robot, np.ones(manifold.n)
    if cost is None:
        return Costs(ones, None)
    if not (isinstance(cost, (str, Mapping)) or callable(cost)):
        raise InputError(f"a cost is a name, a function, or a mapping of these to weights, got {cost!r}")
    given: Mapping[str | PostureCost, float] = cost if isinstance(cost, Mapping) else {cost: 1.0}
    weights, parts = ones, list[tuple[float, PostureCost]]()
    for what, weight in given.items():
        if not callable(what) and what not in NAMES:
            raise UnknownNameError("cost", str(what), NAMES, ". A cost of your own is a function of joints (K, n)")
        factor = number(weight, f"the weight of the cost {what if isinstance(what, str) else 'function'}", at_least=0.0)
        if what == "motion":
            # Motion always counts, with the weight 1 by itself.
            weights = weights * (factor or 1.0)
        elif what == "energy":
            robot.check_dynamics()
            Q = _typical(manifold).T
            weights = weights + factor * np.mean([np.diag(robot._mass(q)) for q in Q], axis=0)
        elif callable(what):
            parts.append((factor, partial(_answer, what)))
        else:
            parts.append((factor, _named(what, manifold, bounds, clearances, reference)))
    if not parts:
        return Costs(weights, None)
    return Costs(weights, lambda Q: np.sum([f * part(Q) for f, part in parts], axis=0))


def _answer(cost: PostureCost, Q: Float[Array, "K n"]) -> Float[Array, " K"]:
    """Values of a cost function of the caller."""
    values = vector_of("the cost function", len(Q), cost, Q)
    if not np.isfinite(values).all():
        raise FunctionError(f"the result of the cost function must be finite, got {values.tolist()}")
    return values


def _named(
    name: str, manifold: Manifold, bounds: tuple[Array, Array], clearances: Clearances | None, reference: Array
) -> PostureCost:
    """A cost of postures by its name."""
    robot, (lower, upper) = manifold.robot, bounds
    if name == "posture":
        return lambda Q: ((Q - reference) ** 2).sum(axis=1)
    if name == "limits":
        limited = np.isfinite(lower) & np.isfinite(upper)
        if not limited.any():
            raise InputError(f"no joint of {robot.name!r} has limits to keep away from; leave out the cost 'limits'")
        middle, half = 0.5 * (lower + upper)[limited], 0.5 * (upper - lower)[limited]
        return lambda Q: (((Q[:, limited] - middle) / half) ** 2).sum(axis=1)
    if name == "clearance":
        if clearances is None or not len(clearances):
            raise InputError("the cost 'clearance' needs a scene or self_collision: there is nothing to be clear of")
        return lambda Q: (np.maximum(1.0 - clearances.pairs(Q.T) / FAR, 0.0) ** 2).sum(axis=0)
    if name == "manipulability":
        typical = float(np.median(_manipulability(manifold, _typical(manifold))))
        return lambda Q: typical / (_manipulability(manifold, np.ascontiguousarray(Q.T)) + 1e-3 * typical)
    limit = np.where(np.isfinite(robot.effort) & (robot.effort > 0.0), robot.effort, np.nan)
    robot.check_dynamics()
    loads = np.array([robot._gravity(q) for q in _typical(manifold).T])
    scale = np.where(np.isfinite(limit), limit, max(float(np.abs(loads).max()), 1e-9))
    return lambda Q: np.array([((robot._gravity(q) / scale) ** 2).sum() for q in Q])


def _typical(manifold: Manifold) -> Float[Array, "n K"]:
    lower, upper = ranges(manifold.robot)
    return np.random.default_rng(0).uniform(lower, upper, (TYPICAL, manifold.n)).T


def _manipulability(manifold: Manifold, Q: Float[Array, "n K"]) -> Float[Array, " K"]:
    J = manifold.jacobians(Q, manifold.task.value(Q[:, 0])[:, None]).transpose(2, 0, 1)
    return np.sqrt(np.maximum(np.linalg.det(J @ J.transpose(0, 2, 1)), 0.0))
