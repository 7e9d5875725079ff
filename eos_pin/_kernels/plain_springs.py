"""Springs and dampers on (z, v) with targets at rest, in NumPy; `springs` has them compiled.

Rotations are measured by twice the vector part ε of their unit quaternion, so that a spring has the energy ½ eᵀK e.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Jacobian, JointVector


def shortened(e: Float[Array, " k"], rows: slice) -> tuple[float, Float[Array, " 3"]]:
    """Replace a rotation vector in e by twice the vector part of its quaternion; the scalar part η, and 2ε."""
    phi = e[rows]
    a, b, c = phi.tolist()
    half = 0.5 * math.sqrt(a * a + b * b + c * c)
    # sin(θ/2) / (θ/2), by its series where the angle is small.
    phi *= math.sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0
    return math.cos(half), phi


def turn_moment(F: Float[Array, " k"], rows: slice, eta: float, two_epsilon: Float[Array, " 3"]) -> None:
    """Make of F = K e, in place, the moment that is the gradient of ½ eᵀK e: η F − ε × F."""
    x, y, z = F[rows].tolist()
    a, b, c = two_epsilon.tolist()
    F[rows] = (
        eta * x - 0.5 * (b * z - c * y),
        eta * y - 0.5 * (c * x - a * z),
        eta * z - 0.5 * (a * y - b * x),
    )


class Springs:
    """Joint torques G'ᵀF_z + W F_v of springs and dampers F = −∂u/∂w − D dw.

    Args:
        Wt: Rows Wᵀ of dv = Wᵀ dq, (r, n).
        K: Stiffness, symmetric, (n, n).
        D: Damping, (n, n).
        z_d: Task point at which the springs of the task are at rest.
        minus: Difference of two task points; None for a vector task.
        turns: First rows of rotation vectors in that difference.
    """

    def __init__(
        self,
        Wt: Float[Array, "r n"],
        K: Float[Array, "n n"],
        D: Float[Array, "n n"],
        z_d: Array,
        minus: Callable[[Array, Array], Array] | None,
        turns: tuple[int, ...],
    ) -> None:
        self._made_from = Wt, K, D, z_d, minus, turns
        n, r = K.shape[0], Wt.shape[0]
        self._A, self._e, self._m = np.vstack((np.zeros((n - r, n)), Wt)), np.zeros(n), n - r
        self._rows = [slice(i, i + 3) for i in turns]

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._made_from

    def __call__(self, dq: JointVector, z: Array, J: Jacobian, away: JointVector) -> JointVector:
        """Torque, (n,).

        Args:
            dq: Joint velocities.
            z: Task point.
            J: Jacobian G'(q), (m, n).
            away: Way from the joints to those at which the spring of the self-motion is at rest, (n,).
        """
        Wt, K, D, z_d, minus, _ = self._made_from
        A, e, m = self._A, self._e, self._m
        A[:m], e[:m], e[m:] = J, z_d - z if minus is None else minus(z_d, z), Wt.dot(away)
        turned = [(rows, *shortened(e, rows)) for rows in self._rows]
        F = K.dot(e)
        for rows, eta, two_epsilon in turned:
            turn_moment(F, rows, eta, two_epsilon)
        F -= D.dot(A.dot(dq))
        return F.dot(A)
