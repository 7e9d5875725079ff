"""Smaller kernels in NumPy: joint limits and harmonic curves; `limits` and `parts` have them compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import subtract
from scipy.linalg.lapack import dposv

from eos_pin._arrays import Array, Jacobian, JointVector, Vector, VectorLike, frozen_copy
from eos_pin._kernels.dispatch import DONE, NO_ANSWER, UNDECIDED

#: Part of the way from the middle to each limit in which a posture is surely far from the limits; part of the
#: acceleration allowed there that joint speed may take; and length of a way without limits [rad or m].
INNER, SPEEDY, WIDE = 0.75, 0.3, 1e3


class Viability:
    """Upper bounds of accelerations that keep position, velocity and viability: 2n, for ddq and for −ddq.

    Args:
        rate: Rate at which a joint closes in on a limit [1/s].
        ends: Upper limits of q and of −q, (2n,).
        fastest: Rate times the velocity limits, (2n,).
        braking: Decelerations with which a joint can be stopped, (2n,).
        acceleration: Largest accelerations, (2n,).
    """

    def __init__(self, rate: float, ends: Vector, fastest: Vector, braking: Vector, acceleration: Vector) -> None:
        self.rate, self.ends, self.fastest, self.braking, self.acceleration = (
            rate, ends, fastest, braking, acceleration,
        )  # fmt: skip

    def __call__(self, q: JointVector, dq: JointVector) -> Vector:
        b, rate = self.braking, self.rate
        room, speed = self.ends - np.concatenate((q, -q)), rate * np.concatenate((dq, -dq))
        # ρ V = root − b and V' = ρ b / root
        root = np.sqrt(2.0 * rate**2 * b * np.maximum(room, 0.0) + b * b)
        beyond = rate**2 * np.minimum(room, 0.0)
        slower = 1.0 - beyond / self.fastest
        most = root - b + beyond / slower - b / root * speed / slower**2
        most = np.minimum(most, self.fastest) - speed
        return np.minimum(np.maximum(most, -self.acceleration), self.acceleration)


class Limits:
    """Torque within all limits of the joints, for a commanded acceleration.

    Args:
        period: Control period [s].
        rate: As for `Viability`.
        ends: As for `Viability`.
        fastest: As for `Viability`.
        braking: As for `Viability`.
        acceleration: As for `Viability`.
        torque: Largest torques, (n,).
        clear: How much more each joint may be accelerated where limits are not looked at more closely.
        fast: Part of its speed limit from which a joint counts as fast.
        times: How often a change is found for a better prediction of the motion, at most.
        met: How well a prediction must be met.
        model: Robot whose dynamics count.
        smallest: Smallest change of accelerations within bounds, a `SmallestChange`.
    """

    def __init__(
        self,
        period: float,
        rate: float,
        ends: Vector,
        fastest: Vector,
        braking: Vector,
        acceleration: Vector,
        torque: JointVector,
        clear: float,
        fast: float,
        times: int,
        met: float,
        model: Any,
        smallest: Any,
    ) -> None:
        self._made_from = (
            period, rate, ends, fastest, braking, acceleration, torque, clear, fast, times, met, model, smallest,
        )  # fmt: skip
        self._half, self._torque, self._clear, self._fast = 0.5 * period, torque, clear, fast
        self._times, self._met, self._model, self._smallest = times, met, model, smallest
        self._viability = Viability(rate, ends, fastest, braking, acceleration)
        self._middle, self._per_half = self._inner()
        self._most = 1.0 if self._per_half.any() else 0.0
        # A workspace, and its parts.
        self._box = np.empty(4 * torque.size)
        self._box_q, self._box_dq, self._box_ddq, self._box_tau = self._box.reshape(4, -1)
        self._unchanged = frozen_copy(np.zeros(torque.size))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._made_from

    def _inner(self) -> tuple[JointVector, Array]:
        """A box of (q, dq, ddq, tau) that is far from all limits: its middle in q, and the inverse of half its size.

        The bounds of the acceleration fall towards the limits, and with the speed towards them; so those in the corner
        of the box hold in all of it. Of n numbers whose fourth powers sum to less than 1/n the squares sum to less than
        1, by the inequality of Cauchy and Schwarz: so it is with the torques as parts of their limits.
        """
        n, viability = self._torque.size, self._viability
        upper, lower = viability.ends[:n], -viability.ends[n:]
        lower = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0) - WIDE)
        upper = np.where(np.isfinite(upper), upper, lower + WIDE)
        middle, half = 0.5 * (lower + upper), 0.5 * INNER * (upper - lower)
        rest = np.zeros(n)

        def least(speed: JointVector) -> JointVector:
            above, below = viability(middle + half, speed)[:n], viability(middle - half, -speed)[n:]
            return np.minimum(np.minimum(above, below) - self._clear, 1e100)

        speed = SPEEDY * np.maximum(least(rest), 0.0) / viability.rate
        room = np.concatenate((half, speed, least(speed), self._torque / n**0.25))
        # Without any room there is no box, and nothing is in it.
        return middle, 1.0 / room if (room > 0.0).all() else np.zeros_like(room)

    def __call__(
        self, q: JointVector, dq: JointVector, ddq: JointVector, J: Jacobian
    ) -> tuple[JointVector, JointVector]:
        """Torque, and the change of the joint acceleration that the limits make, on average over a period.

        Args:
            q: Joints.
            dq: Joint velocities.
            ddq: Joint acceleration that is asked for.
            J: Jacobian of the task.
        """
        model, n, torque = self._model, q.size, self._torque
        tau, change = model._inverse_dynamics(q, dq, ddq), self._unchanged
        # Numbers whose fourth powers sum to less than 1 are all less than 1.
        inner = self._box
        subtract(q, self._middle, self._box_q)
        self._box_dq[:], self._box_ddq[:], self._box_tau[:] = dq, ddq, tau
        inner *= self._per_half
        inner *= inner
        if inner.dot(inner) < self._most:
            return tau, change
        part = tau / torque
        most = self._viability(q, dq)
        # Far from all limits nothing needs to be predicted.
        if part.dot(part) < 1.0 and (most - np.concatenate((ddq, -ddq))).min() > self._clear:
            return tau, change
        most, least = most[:n], np.minimum(-most[n:], most[:n])
        lower, upper = np.concatenate((least, -torque)), np.concatenate((most, torque))
        shift = np.minimum(np.maximum(ddq, least), most)
        middle, speed = self._halfway(q, dq, shift)
        M = model._mass(middle)
        _, mean, _ = dposv(M, tau - model._bias(middle, speed))
        # Once more, from where the torque leads to.
        shift = np.minimum(np.maximum(mean, least), most)
        middle, speed = self._halfway(q, dq, shift)
        mean += dposv(M, tau - model._inverse_dynamics(middle, speed, mean))[1]
        asked = np.minimum(np.maximum(mean, least), most)
        # So that without a change the middle stays where it is, and the torque is continuous.
        shift -= asked
        now = np.concatenate((self._predicted(q, dq, tau, mean, asked), tau))
        if (lower <= now).all() and (now <= upper).all():
            return tau, change
        for _ in range(self._times):
            change = self._smallest(J, M, lower - now, upper - now)
            asked, linear = mean + change, M.dot(change)
            middle, speed = self._halfway(q, dq, asked + shift)
            held = model._inverse_dynamics(middle, speed, asked)
            found = self._predicted(q, dq, held, asked, asked)
            # What is missed: of the accelerations that were to be, and of the torques that were to give them.
            effort = now[n:] + linear
            miss, off = np.abs(found - now[:n] - change).max(), (np.abs(held - effort) / M.diagonal()).max()
            # Daqp keeps its bounds to 1e-6. Where joints are lost, all depends on what torques can do.
            tight = self._smallest.lost or (np.maximum(np.abs(effort), np.abs(held)) >= (1.0 - 1e-6) * torque).any()
            if miss < self._met and (off < self._met or not tight):
                break
            now = np.concatenate((found - change, held - linear))
        # A torque that is used up is used up to the last digit.
        return np.minimum(np.maximum(effort if tight else held, -torque), torque), change

    def _predicted(
        self, q: JointVector, dq: JointVector, tau: JointVector, mean: JointVector, ddq: JointVector
    ) -> JointVector:
        """Mean acceleration over a period: that of its middle, or of its whole motion where a joint is fast."""
        speed = np.maximum(np.abs(dq), np.abs(dq + 2.0 * self._half * ddq))
        fast = min(self._viability.rate * (speed / self._viability.fastest[: dq.size]).max() - self._fast, 1.0)
        return mean + fast * (self._held(q, dq, tau) - mean) if fast > 0.0 else mean

    def _halfway(self, q: JointVector, dq: JointVector, ddq: JointVector) -> tuple[JointVector, JointVector]:
        """The state in the middle of the period."""
        half = self._half
        speed = dq + half * ddq
        return q + 0.5 * half * (dq + speed), speed

    def _held(self, q: JointVector, dq: JointVector, tau: JointVector) -> JointVector:
        """Mean acceleration over a period in which a torque is held, by a step of Nyström's method."""
        forward, half = self._model._forward_dynamics, self._half
        a = forward(q, dq, tau)
        b = forward(*self._halfway(q, dq, a), tau)
        c = forward(*self._halfway(q, dq, b), tau)
        d = forward(q + 2.0 * half * (dq + half * c), dq + 2.0 * half * c, tau)
        return (a + 2.0 * (b + c) + d) / 6.0


class ChangeProgram:
    """The quadratic program of `SmallestChange`: filled with numbers, and solved.

    Args:
        model: The program, a `daqp.Model` with these arrays.
        rows: Rows M and J of its constraints, (n + m, n).
        upper: Their upper bounds, (2n + m,), those of the variables themselves before them.
        lower: Their lower bounds.
        kinds: Their kinds.
        full_price: Size of the prices of the variables' own bounds from which one of these bounds is passed.
        price: Price of passing a bound of the rows J, for its size; the model knows it, the compiled form must.
        weight: The same for its square.
    """

    def __init__(
        self,
        model: Any,
        rows: Float[Array, "n+m n"],
        upper: Vector,
        lower: Vector,
        kinds: Array,
        full_price: float,
        price: float,
        weight: float,
    ) -> None:
        self._made_from = model, rows, upper, lower, kinds, full_price, price, weight
        self._model, self._rows, self._upper, self._lower = model, rows, upper, lower
        self._kinds, self._full_price = kinds, full_price

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._made_from

    def __call__(
        self, J: Jacobian, M: Float[Array, "n n"], lower: Float[Array, "2*n"], upper: Float[Array, "2*n"]
    ) -> tuple[int, JointVector]:
        """Status and solution: `UNDECIDED` if a bound is passed at the full price, `NO_ANSWER` if the solver failed.

        Args:
            J: Jacobian of the task.
            M: Mass matrix.
            lower: Lower bounds of the variables and of the rows M.
            upper: Their upper bounds.
        """
        n = len(M)
        self._rows[:n], self._rows[n:] = M, J
        self._lower[: 2 * n], self._upper[: 2 * n] = lower, upper
        # The kinds once more, lest the solution before be the start.
        self._model.update(A=self._rows, bupper=self._upper, blower=self._lower, sense=self._kinds)
        change, _, flag, info = self._model.solve()
        if not (flag > 0 and math.isfinite(change.dot(change))):
            return NO_ANSWER, change
        paid = info["lam"][:n]
        return DONE if paid.dot(paid) < self._full_price**2 else UNDECIDED, change


class Curve:
    """Sums of sines and cosines: a target (z, dz, ddz) at each time.

    Args:
        phase: Time by which the start is ahead [s].
        frequencies: ω, 2ω and so on [rad/s].
        rows: Coefficients of z, dz and ddz side by side; a row for each of sin ωt, cos ωt, sin 2ωt and so on, 1.
        first: Where those of dz begin.
        second: Where those of ddz begin.
        target: Named tuple that is returned.
    """

    def __init__(
        self, phase: float, frequencies: VectorLike, rows: Float[Array, "K w"], first: int, second: int, target: type
    ) -> None:
        self._made_from = phase, frequencies, rows, first, second, target
        self._phase, self._frequencies = phase, np.asarray(frequencies, dtype=float).tolist()
        self._columns = np.array(rows.T, dtype=float, order="C")
        self._z, self._dz, self._ddz, self._target = slice(first), slice(first, second), slice(second, None), target

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._made_from

    def __call__(self, t: float) -> Any:
        t += self._phase
        waves: list[float] = []
        for omega in self._frequencies:
            waves += (math.sin(omega * t), math.cos(omega * t))
        waves.append(1.0)
        all_three = self._columns.dot(np.array(waves))
        return tuple.__new__(self._target, (all_three[self._z], all_three[self._dz], all_three[self._ddz]))
