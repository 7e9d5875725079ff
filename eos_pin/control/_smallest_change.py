"""`SmallestChange`: the quadratic program behind `LimitedEosController`, and the order in which it gives limits up.

Torques are bounded. As long as some torques keep all joints within their bounds of acceleration, the program finds
them. Where none do, joints are lost by a fixed rule. A joint that no torques at all keep within its bounds is hopeless:
it brakes with all the torque it has. Of the others, one after the other in a fixed order is kept if torques keep it and
all that are kept before it. So a joint is lost only if it is hopeless, or joints before it exclude it.

No continuous torque can drop a joint at once: where it can just be kept it takes all help, and where it just cannot,
none. So the others go on helping a lost joint, up to where it lacks twice the least that it must lack. In this range
its help may still exclude joints after it. It is short: where the joint lacks twice the least, that grows e-fold in the
time in which joints close in on their limits, 10 ms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import daqp
import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Jacobian, JointVector, Vector
from eos_pin._kernels import plain_parts
from eos_pin._kernels.dispatch import DONE, UNDECIDED, use_compiled

ChangeProgram = use_compiled(plain_parts.ChangeProgram)

#: Price of a change that the task feels against one of the joints, for its size and for its square. The first keeps the
#: task exactly, up to where that would take excessive self-motion; the second shares what must be given up among the
#: directions of the task, so that the robot is not caught where it gives up one of them for ever.
TASK_PRICE, TASK_WEIGHT = 1e3, 1e4
#: The same for position and velocity limits; so high that they give way to nothing but torque limits.
LIMIT_PRICE, LIMIT_WEIGHT = 1e8, 1e5
#: Price of the limits of a joint while it is asked whether it can be kept, and of braking torque that a lost joint does
#: not use, for unit inertia.
ASKING_PRICE, BRAKING_PRICE = 1e6, 1e5
#: Part of its prices that the task keeps where a joint is lost: at the full price it would use every weak coupling
#: through the lost joint, and reverse torques where such a coupling changes its sign.
MODEST = 0.1
#: Others help a lost joint while it would lack more than this, and one, times the least that it must lack: the more,
#: the sooner help ends, and the steeper torques are. And parts of its torque limit that it lacks by which it brakes
#: with all it has.
FADE, SHARP = 1.0, 1.0
#: Room for rounding in a bound that is settled [rad/s² or m/s²], more of it where that does not do, and how exactly
#: daqp keeps it.
HAIR, WIDER, EXACT = 1e-8, (1e-6, 1e-4), 1e-12
#: Marks for daqp of a limit that may be passed at a price, and how close to zero is zero for the task [m/s² or rad/s²].
HARD, SOFT, ZERO = 0, 8, 1e-9
#: Torques and accelerations beyond this count as no limit.
FAR = 1e12
#: And more than so much torque counts as so much where it is asked what torques can keep [N m or N].
MOST = 1e6


class SmallestChange:
    """Smallest change of acceleration that keeps all limits, and that affects the task only where nothing else helps.

    It is the Δ that minimizes ½|Δ|² + Σ(TASK_PRICE t + ½ TASK_WEIGHT t²) + Σ(LIMIT_PRICE w + ½ LIMIT_WEIGHT w²) where
    |JΔ| ≤ t, least − w ≤ Δ ≤ most + w, and MΔ is within the torques. Prices are due from the first bit on, so t and w
    are exactly zero wherever that costs less. The minimum always exists, is unique, and moves continuously.

    Where that is not without w, see `_without_the_lost`.

    Args:
        m: Number of task directions.
        n: Number of joints.
        order: Joints in the order in which they are kept; by default from the base outwards.
        bands: Number of bands of the task, which are kept as well: their rows of a change have upper bounds, with the
            prices of task directions. `into_bands` sets them for the next call.

    Attributes:
        program: The quadratic program.
        lost: Whether the last answer was without joints that are lost.
    """

    def __init__(self, m: int, n: int, order: Sequence[int] | None = None, bands: int = 0) -> None:
        self._made_from, self.lost = (m, n, order, bands), False
        m += bands
        self._bands, self._rows_of_bands = bands, np.zeros((bands, n))
        self._order = range(n) if order is None else order
        sizes = n, n, m
        # t and w are the slacks that daqp itself gives to soft limits, so only Δ is unknown.
        self._kinds = np.repeat(np.array((SOFT, HARD, SOFT), dtype=np.intc), sizes)
        self._settled = np.repeat(np.array((HARD, HARD, SOFT), dtype=np.intc), sizes)
        self._rows, self._upper = np.ones((n + m, n)), np.full(2 * n + m, ZERO)
        self._lower = -self._upper
        self._prices = np.repeat((LIMIT_PRICE, 0.0, TASK_PRICE), sizes)
        self._per_weight = np.repeat((1.0 / LIMIT_WEIGHT, 0.0, 1.0 / TASK_WEIGHT), sizes)
        model, self._last = (self._made(2 * n + m, self._prices, self._per_weight) for _ in range(2))
        # Nobody pays the full price of a limit unless it is passed.
        self.program = ChangeProgram(
            model, self._rows, self._upper, self._lower, self._kinds, LIMIT_PRICE, TASK_PRICE, TASK_WEIGHT
        )
        self._stage = self._made(2 * n, np.full(2 * n, ASKING_PRICE), np.full(2 * n, 1.0 / LIMIT_WEIGHT))
        for model in (self._last, self._stage):
            model.settings = model.settings | {"primal_tol": EXACT}

    def _made(self, rows: int, prices: Vector, per_weight: Vector) -> daqp.Model:
        model, n = daqp.Model(), self._rows.shape[1]
        model.setup(
            np.eye(n), np.zeros(n), self._rows[: rows - n], self._upper[:rows], self._lower[:rows], self._kinds[:rows]
        )
        model.soft_weights(per_weight, per_weight, prices, prices)
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
        status, change = self.program(J, M, lower, upper)
        self.lost = status != DONE
        if self.lost:
            # Rarely daqp finds no end among such prices, which the steps below do without.
            return self._without_the_lost(M, lower, upper, change if status == UNDECIDED else None)
        return change

    def _without_the_lost(
        self, M: Float[Array, "n n"], lower: Float[Array, "2*n"], upper: Float[Array, "2*n"], change: JointVector | None
    ) -> JointVector:
        """Smallest change where no torques keep all joints within their bounds.

        Args:
            M: Mass matrix.
            lower: As above.
            upper: As above.
            change: Change within the torque limits, if one is known.
        """
        n, inertia, W = len(M), M.diagonal(), np.linalg.inv(M)
        least, most = np.maximum(lower[:n], -FAR), np.minimum(upper[:n], FAR)
        low, high = np.maximum(lower[n:], -FAR), np.minimum(upper[n:], FAR)
        middle, half = 0.5 * (low + high), 0.5 * np.minimum(high - low, MOST)
        per_torque = 1.0 / (SHARP * half)
        # Hopeless is a joint that all torques together cannot keep.
        down, up = np.minimum(W * low, W * high).sum(axis=1), np.maximum(W * low, W * high).sum(axis=1)
        sign = np.where(least > up, 1.0, np.where(most < down, -1.0, 0.0))
        hopeless = np.minimum(inertia * per_torque * np.maximum(np.maximum(least - up, down - most), 0.0), 1.0)
        span = hopeless * (high - low)
        low, high = np.where(sign > 0.0, low + span, low), np.where(sign < 0.0, high - span, high)
        # Asked of torques, as parts of their limits: no price is too high for these, as it may be for accelerations.
        rows, reach, offset = W * half, (np.abs(W) * half).sum(axis=1), W.dot(middle)
        rows /= reach[:, None]
        below = np.concatenate(((low - middle) / half, np.full(n, -FAR)))
        above = np.concatenate(((high - middle) / half, np.full(n, FAR)))
        kinds, push, known = np.zeros(2 * n, dtype=np.intc), np.zeros(n), change is not None and not span.any()
        if change is None:
            # Only numbers beyond all reason have no solution; then every joint for itself.
            change = np.clip(0.0, lower[:n], upper[:n])
        for j in self._order:
            below[n + j], above[n + j] = (least[j] - offset[j]) / reach[j], (most[j] - offset[j]) / reach[j]
            if known and least[j] <= change[j] <= most[j]:
                continue
            kinds[n + j] = SOFT
            self._stage.update(A=rows, bupper=above, blower=below, sense=kinds)
            found, _, flag, info = self._stage.solve()
            kinds[n + j] = HARD
            if flag > 0:
                info["lam"][n + j] = 0.0
                found = _on_bounds(found, rows, info["lam"], below, above)
                change, known = offset + reach * rows.dot(found), True
            # What it lacks, and which way.
            lack = max(least[j] - change[j], change[j] - most[j], 0.0)
            if lack > 0.0:
                side = 1.0 if change[j] < least[j] else -1.0
                push[j] = side * BRAKING_PRICE / inertia[j] * min(lack * inertia[j] * per_torque[j], 1.0)
            room = (1.0 + FADE) * lack + HAIR
            least[j] -= room
            most[j] += room
            below[n + j], above[n + j] = (least[j] - offset[j]) / reach[j], (most[j] - offset[j]) / reach[j]
        below, above = np.concatenate((least, low)), np.concatenate((most, high))
        self._lower[: 2 * n], self._upper[: 2 * n] = below, above
        part = 1.0 - (1.0 - MODEST) * np.abs(push * inertia).max() / BRAKING_PRICE
        per_weight, prices = self._per_weight / part, self._prices * part
        self._last.soft_weights(per_weight, per_weight, prices, prices)
        for hair in (0.0, *WIDER):
            # Bounds that leave a single point may cross by rounding; the change before knows nothing of the task.
            self._lower[:n], self._upper[:n] = below[:n] - hair, above[:n] + hair
            self._last.update(f=-M.dot(push), A=self._rows, bupper=self._upper, blower=self._lower, sense=self._settled)
            found, _, flag, info = self._last.solve()
            if flag > 0 and math.isfinite(found.dot(found)):
                return _on_bounds(
                    found, self._rows[:n], info["lam"][: 2 * n], self._lower[: 2 * n], self._upper[: 2 * n]
                )
        return change

    def into_bands(
        self, J: Jacobian, ddq: JointVector, rows: Float[Array, "B n"], most: Float[Array, " B"]
    ) -> JointVector:
        """Smallest change of an acceleration that keeps rows · ddq ≤ most.

        The bounds that it leaves count in the next call.

        Args:
            J: Jacobian of the task.
            ddq: Acceleration.
            rows: Rows of the bands.
            most: Their bounds.
        """
        self._rows_of_bands, left, change, n = rows, most - rows.dot(ddq), np.zeros(ddq.size), ddq.size
        bounds = slice(len(self._upper) - self._bands, None)
        self._lower[bounds], self._upper[bounds] = -FAR, left
        if (left < 0.0).any():
            without = np.full(2 * n, FAR)
            change = self(self.with_bands(J), np.eye(n), -without, without)
            # Where a band cannot be kept, nothing is changed further for it.
            self._upper[bounds] = np.maximum(left - rows.dot(change), 0.0)
        return change

    def within(self, J: Jacobian, least: JointVector, most: JointVector) -> JointVector:
        """Smallest change of an acceleration between bounds, where there are no torques.

        Args:
            J: Jacobian of the task, and rows of its bands.
            least: Least change of each joint.
            most: Largest change.
        """
        without = np.full(least.size, FAR)
        # daqp may find no end where bounds are the same to rounding.
        lower, upper = np.concatenate((-without, least - HAIR)), np.concatenate((without, most + HAIR))
        change = self(J, np.eye(least.size), lower, upper)
        return np.minimum(np.maximum(change, least), most)

    def with_bands(self, J: Jacobian) -> Float[Array, "rows n"]:
        """Rows of the task and of the bands."""
        return np.concatenate((J, self._rows_of_bands))

    def __reduce__(self) -> tuple[Any, ...]:
        # The workspace is made anew where it is unpickled.
        return type(self), self._made_from


def _on_bounds(found: JointVector, rows: Float[Array, "n n"], lam: Vector, below: Vector, above: Vector) -> JointVector:
    """The same solution with less rounding: exactly on the bounds that are active."""
    active = np.flatnonzero(lam)
    held = np.concatenate((np.eye(found.size), rows))[active]
    off = np.where(lam > 0.0, above, below)[active] - held.dot(found)
    return found + np.linalg.lstsq(held, off, rcond=None)[0]
