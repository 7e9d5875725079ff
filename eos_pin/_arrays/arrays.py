"""Array aliases, and the checks of single values.

Values that outlive a call are read-only: a frozen dataclass around a writable array would not be frozen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from eos_pin.errors import InputError

Array: TypeAlias = np.ndarray
#: Any vector, and the vectors and matrices whose size the paper names: n joints, m task, r = n − m self-motion.
Vector: TypeAlias = Float[np.ndarray, " k"]
JointVector: TypeAlias = Float[np.ndarray, " n"]
TaskVector: TypeAlias = Float[np.ndarray, " m"]
SelfMotionVector: TypeAlias = Float[np.ndarray, " r"]
Matrix: TypeAlias = Float[np.ndarray, "k l"]
Jacobian: TypeAlias = Float[np.ndarray, "m n"]
#: What a caller may hand over where a vector is meant.
VectorLike: TypeAlias = Sequence[float] | np.ndarray


class Above(NamedTuple):
    """Range of a number: greater than `least`, or at least that; infinite only where `endless`."""

    least: float
    reached: bool = False
    endless: bool = False


#: Numbers of a range, for annotations that `checked` reads.
Positive: TypeAlias = Annotated[float, Above(0.0)]
NonNegative: TypeAlias = Annotated[float, Above(0.0, reached=True)]
PositiveOrInfinite: TypeAlias = Annotated[float, Above(0.0, endless=True)]

#: How far RᵀR may be from 1 in a rotation that is taken as it is.
ORTHONORMAL = 1e-14
_IDENTITY = np.eye(3)


def nearest(grid: Vector, values: Float[np.ndarray, " j"]) -> Array:
    """Index of the entry of an increasing grid that is nearest to each value."""
    if len(grid) < 2:
        return np.zeros(len(values), dtype=np.int64)
    i = np.clip(np.searchsorted(grid, values), 1, len(grid) - 1)
    return i - (values - grid[i - 1] < grid[i] - values)


def largest_magnitude(values: Array) -> float:
    """Largest magnitude of the entries that are finite; NaN where there is none."""
    values = np.abs(values[np.isfinite(values)])
    return float(values.max()) if values.size else math.nan


def is_finite(array: Array) -> bool:
    """Whether all entries of a float array are finite."""
    # For a few numbers this takes a quarter of the time of `np.isfinite`.
    if array.ndim == 1 and array.size <= 32:
        return all(map(math.isfinite, array.tolist()))
    return bool(np.isfinite(array).all())


def is_rotation(R: Float[np.ndarray, "3 3"], tolerance: float = ORTHONORMAL) -> bool:
    """Whether a finite matrix is a rotation to rounding.

    Args:
        R: The matrix.
        tolerance: How far RᵀR may be from 1.
    """
    return bool(np.abs(R.T.dot(R) - _IDENTITY).max() <= tolerance and np.linalg.det(R) > 0.0)


def frozen_copy(array: Array, kind: type = float) -> Array:
    """Read-only copy of `array`, by default of floats; later writes to the original do not reach it."""
    try:
        copy: Array = np.array(array, dtype=kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"numbers are needed, got {array!r}") from error
    copy.flags.writeable = False
    return copy


def as_floats(values: VectorLike | Sequence[VectorLike] | float, name: str) -> Array:
    """Float array of any shape.

    Raises:
        InputError: Not real numbers.
    """
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be numbers, got {values!r}") from error


def listed(values: Any, name: str) -> list[Any]:
    """List of several things that a caller gives.

    Raises:
        InputError: It is one thing.
    """
    if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
        raise InputError(f"{name} must be a list, got {values!r}")
    return list(values)


def pair(values: Any, name: str) -> list[Any]:
    """Like `listed`, of two things.

    Raises:
        InputError: They are not two.
    """
    two = listed(values, name)
    if len(two) != 2:
        raise InputError(f"{name} must be a list of two, got {len(two)} of them")
    return two


def vector(values: VectorLike | float, size: int | None, name: str) -> Vector:
    """Finite float vector of `size` entries.

    Args:
        values: Numbers of any real type.
        size: Required length, or None for any.
        name: Name of the vector in the error message.

    Raises:
        InputError: Not numbers, wrong length, or not finite.
    """
    array = as_floats(values, name)
    if array.ndim != 1 or (size is not None and array.shape[0] != size):
        wanted = "one-dimensional" if size is None else f"{size} numbers"
        raise InputError(f"{name} must be {wanted}, got shape {array.shape}")
    if not is_finite(array):
        bad = np.flatnonzero(~np.isfinite(array)).tolist()
        raise InputError(f"{name} must be finite, got {array.tolist()} (entries {bad})")
    return array


def broadcast(values: VectorLike | float, size: int, name: str) -> Vector:
    """Like `vector`, but one number stands for `size` equal ones (gains, tolerances)."""
    array = as_floats(values, name)
    return vector(np.full(size, array) if array.ndim == 0 else array, size, name)


def gains(values: VectorLike | float, size: int | None, name: str) -> Array:
    """Like `broadcast`, of numbers that are at least 0; of any size, and not made longer, where `size` is None."""
    array = as_floats(values, name) if size is None else broadcast(values, size, name)
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        raise InputError(f"{name} must be finite and at least 0, got {as_floats(values, name).tolist()}")
    return array


def number(value: float, name: str, *, above: float = -np.inf, at_least: float = -np.inf) -> float:
    """Finite float; any real number type is accepted.

    Raises:
        InputError: Not a number, not finite, not greater than `above`, or less than `at_least`.
    """
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be a number, got {value!r}") from error
    if not np.isfinite(result) or result <= above or result < at_least:
        bound = f" above {above:g}" if above > -np.inf else f" of at least {at_least:g}" if at_least > -np.inf else ""
        raise InputError(f"{name} must be a finite number{bound}, got {value!r}")
    return result
