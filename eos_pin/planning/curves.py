"""Cubic splines through rows of values, in pieces where they jump."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from eos_pin._arrays import Array


def spline(
    times: Array, values: Array, closed: bool, jumps: Sequence[int] = (), turned: Array | None = None
) -> tuple[Array, Array]:
    """Knots (K,) and coefficients of a cubic spline, highest power first, (K − 1, 4, columns).

    A jump makes one more knot, in the middle between two others: the spline before it is prolonged up to there,
    and that after it begins there.

    Args:
        times: Times of the values.
        values: Values, (T, columns).
        closed: Whether the last value is the first, and the spline periodic.
        jumps: Numbers of the values after which they jump.
        turned: How far the first of the columns are at the last value, if the spline is periodic but for them.
    """
    if not jumps:
        if turned is None or not turned.any():
            return np.array(times), _cubic(times, values, closed)
        # Whole turns are an even motion, and the rest repeats.
        rate = np.zeros(values.shape[1])
        rate[: len(turned)] = turned / (times[-1] - times[0])
        ramp = np.outer(times - times[0], rate)
        made = _cubic(times, np.concatenate((values[:-1] - ramp[:-1], values[:1])), closed)
        made[:, 2] += rate
        made[:, 3] += ramp[:-1]
        return np.array(times), made
    knots, parts = list[Array](), list[Array]()
    ends = [0, *(k + 1 for k in jumps), len(times)]
    middles = [None, *(0.5 * (times[k] + times[k + 1]) for k in jumps), None]
    for (a, b), (before, after) in zip(pairwise(ends), pairwise(middles), strict=True):
        rows = times[a:b]
        part = _cubic(rows, values[a:b], False) if b - a > 1 else _constant(values[a:b])[:0]
        first, last = _constant(values[a:b]), _constant(values[a:b])
        if len(part):
            first, last = part[:1], _moved(part[-1:], rows[-1] - rows[-2])
        if before is not None:
            knots.append(np.array([before]))
            parts.append(_moved(first, before - rows[0]))
        knots.append(rows)
        parts.append(part)
        if after is not None:
            parts.append(last)
    return np.concatenate(knots), np.ascontiguousarray(np.concatenate(parts))


def _cubic(times: Array, values: Array, closed: bool) -> Array:
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(times, values, bc_type="periodic" if closed else "not-a-knot")
    return np.ascontiguousarray(np.asarray(curve.c).transpose(1, 0, 2))


def _constant(value: Array) -> Array:
    """Coefficients of a constant, (1, 4, columns)."""
    return np.concatenate((np.zeros((3, value.shape[1])), value[:1]))[None]


def _moved(part: Array, x: float) -> Array:
    """Coefficients of the same cubic about a place x further on."""
    a, b, c, d = part[0]
    return np.array([[a, b + 3.0 * a * x, c + x * (2.0 * b + 3.0 * a * x), d + x * (c + x * (b + a * x))]])
