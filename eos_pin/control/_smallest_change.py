"""`SmallestChange`: the quadratic program behind `LimitedEosController`, and who pays where not all limits can be kept.

Torques are bounded. As long as some torques keep all joints within their bounds of acceleration, the program finds
them. Where none do, a joint is lost whose own torque cannot keep it; it is braked with all the torque it has, and the
others are kept as if it were a load that falls: they have to give way to it in nothing.
"""

from __future__ import annotations

import math
from typing import Any

import daqp
import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Jacobian, JointVector

#: Price of a change that the task feels against one of the joints, for its size and for its square. The first keeps the
#: task exactly, up to where that would take excessive self-motion; the second shares what must be given up among the
#: directions of the task, so that the robot is not caught where it gives up one of them for ever.
TASK_PRICE, TASK_WEIGHT = 1e3, 1e4
#: The same for position and velocity limits; so high that they give way to nothing but torque limits.
LIMIT_PRICE, LIMIT_WEIGHT = 1e8, 1e5
#: Where not all limits can be kept: price of the limits of a joint that is kept and of one that is lost by a hair; the
#: powers of ten by which it falls for each torque limit that the joint lacks, so that the help of other joints ends
#: gently; and by how much at the most.
KEPT_PRICE, LOST_PRICE, FALL, CHEAPEST = 1e10, 1e7, 0.25, 1e-5
#: Rounds in which the lost are told from the kept; the largest ratio of their prices then; and the part of its torque
#: limit that a joint lacks by which it is clearly lost.
ROUNDS, SPREAD, SHARP = 2, 1e-7, 1e-4
#: Torque that a joint has left counts so many times: one that could do more is not lost.
SPARES = 100.0
#: Price of braking torque that a lost joint does not use, for unit inertia.
BRAKING_PRICE = 1e8
#: How daqp is told that a limit may be passed at a price, and how close to zero is zero for the task [m/s² or rad/s²].
SOFT, ZERO = 8, 1e-9
#: Torques beyond this count as no limit [N m or N]; and ratio beyond which joints count as equally heavy.
FAR, MOST_RATIO = 1e12, 100.0


class SmallestChange:
    """Smallest change of acceleration that keeps all limits, and that the task feels only where it must.

    It is the Δ that minimizes ½|Δ|² + Σ(TASK_PRICE t + ½ TASK_WEIGHT t²) + Σ(LIMIT_PRICE w + ½ LIMIT_WEIGHT w²) where
    |JΔ| ≤ t, least − w ≤ Δ ≤ most + w, and MΔ is within the torques. Prices are due from the first bit on, so t and w
    are exactly zero wherever that costs less. The minimum always exists, is unique, and moves continuously.

    Where that is not without w, see `_without_the_lost`.

    Args:
        m: Number of task directions.
        n: Number of joints.
    """

    def __init__(self, m: int, n: int) -> None:
        self._made_from = m, n
        sizes = n, n, m
        # t and w are the slacks that daqp itself gives to soft limits, so only Δ is unknown.
        self._kinds = np.repeat(np.array((SOFT, 0, SOFT), dtype=np.intc), sizes)
        self._rows, self._upper = np.ones((n + m, n)), np.full(2 * n + m, ZERO)
        self._lower = -self._upper
        self._prices = np.repeat((LIMIT_PRICE, 0.0, TASK_PRICE), sizes)
        self._per_weight = np.repeat((1.0 / LIMIT_WEIGHT, 0.0, 1.0 / TASK_WEIGHT), sizes)
        self._model, self._other = (self._made(n) for _ in range(2))

    def _made(self, n: int) -> daqp.Model:
        model = daqp.Model()
        model.setup(np.eye(n), np.zeros(n), self._rows, self._upper, self._lower, self._kinds)
        model.soft_weights(self._per_weight, self._per_weight, self._prices, self._prices)
        return model

    def __call__(
        self, J: Jacobian, M: Float[Array, "n n"], lower: Float[Array, "2*n"], upper: Float[Array, "2*n"]
    ) -> JointVector:
        """Smallest change.

        Args:
            J: Jacobian of the task.
            M: Mass matrix.
            lower: Least change of the accelerations and of the torques [rad/s² or m/s², N m or N].
            upper: Largest change of both.
        """
        n = len(M)
        self._rows[:n], self._rows[n:] = M, J
        self._lower[: 2 * n], self._upper[: 2 * n] = lower, upper
        # The kinds once more, lest the solution before be the start.
        self._model.update(A=self._rows, bupper=self._upper, blower=self._lower, sense=self._kinds)
        change, _, flag, info = self._model.solve()
        if not (flag > 0 and math.isfinite(change.dot(change))):
            # Only numbers beyond all reason have no solution; then every joint for itself.
            return np.clip(0.0, lower[:n], upper[:n])
        # Nobody pays the full price of a limit unless it is passed.
        paid = info["lam"][:n]
        return change if paid.dot(paid) < LIMIT_PRICE**2 else self._without_the_lost(M, lower, upper, change)

    def _without_the_lost(
        self, M: Float[Array, "n n"], lower: Float[Array, "2*n"], upper: Float[Array, "2*n"], change: JointVector
    ) -> JointVector:
        """Smallest change where no torques keep all joints within their bounds.

        With one price for all, strong joints would leave their bounds to ease weak ones. So the price of a joint's
        bounds falls with the torque that it lacks to come back to them by itself: first steeply, for the most wanting
        joint most, which leaves as few joints lost as can be; in the end gently. A lost joint is made to use all its
        torque, which no other joint pays for, because only its own torque limit holds it back. Each round is a
        continuous function of the one before.

        Args:
            M: Mass matrix.
            lower: As above.
            upper: As above.
            change: Smallest change with one price for all.
        """
        n = len(M)
        inertia, torque = np.diag(M), np.minimum(0.5 * (upper[n:] - lower[n:]), FAR)
        root = np.sqrt(inertia)
        # Joint k moves |M_jk / M_jj| ≤ √(M_kk / M_jj) times as much as it eases joint j.
        own = np.minimum(root / root.min(), MOST_RATIO)
        for k in range(ROUNDS + 2):
            # Towards the upper side, and towards the lower one: torque that brings the joint back, and what it has.
            effort, lacking = M.dot(change), np.array((lower[:n] - change, change - upper[:n]))
            spare = np.minimum((upper[n:] - effort, effort - lower[n:]), FAR)
            short = inertia * np.maximum(lacking, 0.0)
            lack = np.maximum(short - SPARES * spare, 0.0) / torque
            lost = np.minimum(lack / SHARP, 1.0)
            if k < ROUNDS:
                price = KEPT_PRICE * SPREAD ** (lack / (lack.max() + SHARP))
            else:
                price = KEPT_PRICE * (LOST_PRICE / KEPT_PRICE) ** lost
            if k > ROUNDS:
                price *= np.maximum(10.0 ** (-FALL * lack), CHEAPEST)
            push = BRAKING_PRICE / inertia * np.minimum(lack / (100.0 * SHARP), 1.0)
            found = self._priced(own * price, M.dot(push[1] - push[0]))
            if found is None:
                break
            change = found
        return change

    def _priced(self, price: Float[Array, "2 n"], pull: JointVector) -> JointVector | None:
        """Smallest change at prices of lower and upper bounds, with a linear cost; None if none is found."""
        n, model = len(pull), self._other
        prices, per_weight = self._prices[None].repeat(2, 0), self._per_weight[None].repeat(2, 0)
        prices[:, :n], per_weight[:, :n] = price, LIMIT_PRICE / (LIMIT_WEIGHT * price)
        model.soft_weights(*per_weight, *prices)
        model.update(f=pull, A=self._rows, bupper=self._upper, blower=self._lower, sense=self._kinds)
        found, _, flag, _ = model.solve()
        return found if flag > 0 and math.isfinite(found.dot(found)) else None

    def __reduce__(self) -> tuple[Any, ...]:
        # The workspace is made anew where it is unpickled.
        return type(self), self._made_from
