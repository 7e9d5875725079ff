"""Equality and short descriptions of values that hold arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

#: Classes that are decorated.
_VALUES: set[type] = set()
#: Attributes by which curves of SciPy, which compare by identity, are the same: knots, coefficients, degree.
_CURVE = ("x", "t", "c", "k", "axis", "extrapolate")


def by_value(kind: type[T]) -> type[T]:
    """Make values of a frozen dataclass or a named tuple equal where all their parts are, with equal hashes.

    Arrays are equal where all their entries are, NaN to NaN. Parts with an equality of their own keep it, so that a
    robot, a task or a function is equal to itself only; and so is a value of a subclass that is not decorated itself.
    """

    def equal(self: Any, other: object) -> Any:
        return _key(self) == _key(other) if type(self) is type(other) else NotImplemented

    def unequal(self: Any, other: object) -> Any:
        return NotImplemented if (same := equal(self, other)) is NotImplemented else not same

    for name, method in (("__eq__", equal), ("__ne__", unequal), ("__hash__", lambda self: hash(_key(self)))):
        setattr(kind, name, method)
    _VALUES.add(kind)
    return kind


def brief(*names: str) -> Callable[[type[T]], type[T]]:
    """Give a class a short `repr` of some attributes; of a large array it has the shape."""

    def decorate(kind: type[T]) -> type[T]:
        def written(self: Any) -> str:
            return f"{type(self).__name__}({', '.join(f'{name}={_brief(getattr(self, name))}' for name in names)})"

        kind.__repr__ = written  # type: ignore[method-assign]
        return kind

    return decorate


def _brief(value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return f"{value:.3g}" if isinstance(value, float) else repr(value)
    if value.size > 12:
        return f"<{' × '.join(map(str, value.shape))}>"
    return np.array2string(value, separator=", ", max_line_width=200, formatter={"all": lambda each: f"{each:.4g}"})


def _key(value: Any) -> Any:
    """Hashable key of a value, for comparisons."""
    kind = type(value)
    if kind in _VALUES:
        names = getattr(kind, "_fields", None) or [field.name for field in fields(kind)]
        return (kind, *(_key(getattr(value, name)) for name in names))
    if _VALUES.intersection(kind.__mro__):
        return kind, id(value)
    if isinstance(value, np.ndarray):
        # Adding zero makes one of the two zeros.
        return value.shape, (value + 0.0).tobytes() if value.dtype.kind == "f" else value.tobytes()
    if isinstance(value, Mapping):
        return frozenset((key, _key(item)) for key, item in value.items())
    if isinstance(value, (tuple, list)):
        return tuple(map(_key, value))
    if isinstance(value, float) and value != value:
        return "NaN"
    if hasattr(value, "homogeneous"):
        return _key(value.homogeneous)
    if hasattr(value, "c") and hasattr(value, "extrapolate"):
        return (kind, *(_key(getattr(value, name, None)) for name in _CURVE))
    return value
