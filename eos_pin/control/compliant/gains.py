"""Stiffness, damping and inertia of coordinates: the forms in which they may be given, and damping by a ratio."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eos_pin._arrays import Array, VectorLike, as_floats, frozen_copy, number
from eos_pin.errors import InputError, UnknownNameError

#: A gain of several coordinates: one number, one for each, one for each unit or label, or a symmetric matrix.
GainLike: TypeAlias = "float | VectorLike | Mapping[str, float]"
Square: TypeAlias = Float[Array, "k k"]

#: Largest damping ratio that is taken for one; more are likely percent.
MOST_RATIO = 10.0
#: Asymmetry, and eigenvalues below 0, that are taken for rounding, as a part of the largest entry.
ROUNDING = 1e-9


def gain_matrix(
    values: GainLike, labels: Sequence[str], units: Sequence[str], name: str, *, definite: bool = False
) -> Square:
    """Symmetric matrix of a gain, read-only.

    Args:
        values: One number, one for each coordinate, a dictionary of numbers by unit (`{"m": 800, "rad": 40}`) or by
            label, or a symmetric matrix.
        labels: Labels of the coordinates.
        units: Their units.
        name: Name of the gain in messages.
        definite: Whether 0 is refused as well.

    Raises:
        InputError: It is negative, not symmetric, not finite, of another size, or one number for several units.
    """
    k = len(labels)
    if isinstance(values, Mapping):
        matrix = np.diag(_by_name(values, labels, units, name))
    else:
        array = as_floats(values, name)
        if array.ndim == 0 and len(set(units)) > 1:
            example = ", ".join(f'"{unit}": …' for unit in dict.fromkeys(units))
            raise InputError(
                f"{name} is one number, {values!r}, for coordinates in {' and '.join(dict.fromkeys(units))}: give one "
                f"for each unit, {{{example}}}, or one for each of {', '.join(labels)}"
            )
        if array.shape not in ((), (k,), (k, k)):
            raise InputError(
                f"{name} must be one number, {k} numbers ({', '.join(labels)}) or a {k} × {k} matrix, got shape "
                f"{array.shape}"
            )
        matrix = array if array.ndim == 2 else np.diag(np.full(k, array) if array.ndim == 0 else array)
    return _checked(matrix, name, definite)


def _by_name(values: Mapping[str, float], labels: Sequence[str], units: Sequence[str], name: str) -> list[float]:
    """Numbers for each coordinate; that of a label counts before that of its unit."""
    for key in values:
        if key not in labels and key not in units:
            raise UnknownNameError(f"unit or label of {name}", str(key), (*dict.fromkeys(units), *labels))
    missing = [label for label, unit in zip(labels, units, strict=True) if label not in values and unit not in values]
    if missing:
        raise InputError(f"{name} lacks {', '.join(missing)}; got {dict(values)!r}")
    return [
        number(values.get(label, values.get(unit, 0.0)), f"{name} of {label}")
        for label, unit in zip(labels, units, strict=True)
    ]


def _checked(matrix: Array, name: str, definite: bool) -> Square:
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} must be finite, got {matrix.tolist()}")
    size = np.abs(matrix).max(initial=0.0)
    if np.abs(matrix - matrix.T).max(initial=0.0) > ROUNDING * size:
        raise InputError(
            f"{name} must be symmetric, got {matrix.tolist()}: a matrix that is not has no energy, and can drive the "
            "robot for ever. Its symmetric part is 0.5 * (K + K.T)"
        )
    least = float(np.linalg.eigvalsh(matrix)[0]) if matrix.size else 1.0
    if least < -ROUNDING * size or (definite and least <= ROUNDING * size):
        least_allowed = "above 0" if definite else "at least 0"
        raise InputError(
            f"{name} must be {least_allowed} in every direction, got {np.diag(matrix).tolist()} with the least "
            f"eigenvalue {least:.4g}: a negative one pushes away from the target"
        )
    return frozen_copy(0.5 * (matrix + matrix.T))


def ratio(value: float, name: str) -> float:
    """Damping ratio.

    Raises:
        InputError: It is none, such as 0, below 0 or a percentage.
    """
    found = number(value, name, above=0.0)
    if found > MOST_RATIO:
        raise InputError(
            f"{name} must be above 0 and at most {MOST_RATIO:g}, got {value!r}; 1 is critical, 0.7 is usual"
        )
    return found


def damping_of(M: Square, K: Square, damping_ratio: float) -> Square:
    """Damping with which every mode of M ë + D ė + K e = 0 has the same damping ratio.

    Double diagonalisation: M = Q Qᵀ and K = Q diag(k) Qᵀ give D = 2 ζ Q diag(√k) Qᵀ (Albu-Schäffer, Ott, Frese,
    Hirzinger, ICRA 2003). Directions without stiffness get no damping.

    Args:
        M: Mass matrix, symmetric and positive.
        K: Stiffness, symmetric.
        damping_ratio: The ratio ζ.
    """
    if not M.size:
        return M
    L = np.linalg.cholesky(M)
    half = scipy.linalg.solve_triangular(L, K, lower=True)
    k, X = np.linalg.eigh(scipy.linalg.solve_triangular(L, half.T, lower=True))
    Q = L @ X
    return (Q * (2.0 * damping_ratio * np.sqrt(np.maximum(k, 0.0)))) @ Q.T


def plain(matrix: Square) -> Any:
    """A gain for descriptions: its diagonal where it has no other entries."""
    diagonal = np.diag(matrix)
    return diagonal.tolist() if np.array_equal(np.diag(diagonal), matrix) else matrix.tolist()


def clips_of(given: Any) -> tuple[float, float, float]:
    """Errors at which springs stop growing, of lengths, angles and the self-motion.

    Raises:
        InputError: It is no dictionary of positive numbers by `"m"`, `"rad"` or `"v"`.
    """
    given = {} if given is None else given
    if not isinstance(given, dict) or not given.keys() <= {"m", "rad", "v"}:
        raise InputError(f"largest_error must be a dictionary with some of 'm', 'rad' and 'v', got {given!r}")
    lengths, angles, own = (
        number(given[key], f"the largest error {key}", above=0.0) if key in given else math.inf
        for key in ("m", "rad", "v")
    )
    return lengths, angles, own
