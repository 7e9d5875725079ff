"""Angles of continuous joints, where a whole turn leads to the same place.

`turn` is the angle after which each joint is where it was, (n,): 2π for continuous joints, and 0 for all others.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from eos_pin.arrays import JointVector

#: Part of half a turn from which on a posture draws a continuous joint less, down to nothing where it is opposite.
OPPOSITE = 0.75


def unwrapped(
    q: Float[np.ndarray, "*rows n"], near: Float[np.ndarray, "*others n"], turn: JointVector
) -> Float[np.ndarray, "*all n"]:
    """The same configurations, continuous joints at the angle nearest to `near`.

    Args:
        q: Joints, (n,) or (K, n).
        near: Joints to be near to, (n,) or (K, n).
        turn: Angle after which each joint is where it was.
    """
    return q - turn * np.round((q - near) / math.tau)


def way(
    q: Float[np.ndarray, "*rows n"], goal: Float[np.ndarray, " n"], turn: JointVector
) -> Float[np.ndarray, "*rows n"]:
    """Pull towards a posture: `goal` − q, for continuous joints on the side where it is nearer.

    From 3/4 of half a turn on the pull fades, so that it is a continuous function of q.

    Args:
        q: Joints, (n,) or (K, n).
        goal: The posture.
        turn: Angle after which each joint is where it was.
    """
    away = unwrapped(goal - q, np.zeros_like(goal), turn)
    size = np.abs(away)
    faded = np.minimum(size, (math.pi - size) * (OPPOSITE / (1.0 - OPPOSITE)))
    return np.where(turn > 0.0, np.copysign(faded, away), away)
