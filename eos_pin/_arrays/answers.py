"""Functions of the caller: their exceptions and unfit results become errors that name the function."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from eos_pin._arrays.arrays import Vector, as_floats, number, vector
from eos_pin.errors import EosError, FunctionError, InputError

T = TypeVar("T")


def called(name: str, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Result of a function of the caller.

    Raises:
        FunctionError: It raised something else than an `EosError`; that is kept as the cause.
    """
    try:
        return function(*args, **kwargs)
    except EosError:
        raise
    except Exception as error:
        raise FunctionError(f"{name} raised {type(error).__name__}: {error}") from error


def vector_of(name: str, size: int | None, function: Callable[..., Any], *args: Any) -> Vector:
    """Vector that a function of the caller returns, whose numbers may be infinite or NaN.

    Args:
        name: How the function is called in messages.
        size: Required length, or None for any.
        function: The function.
        args: What it is called with.

    Raises:
        FunctionError: It raised, or returned no such vector.
    """
    return _vector(called(name, function, *args), size, f"the result of {name}")


def vectors_of(name: str, count: int, size: int | None, function: Callable[..., Any], *args: Any) -> list[Vector]:
    """Like `vector_of`, of a function that returns several vectors."""
    results = called(name, function, *args)
    if not isinstance(results, Sequence) or len(results) != count:
        raise FunctionError(f"the result of {name} must be {count} vectors, got {results!r}")
    return [_vector(result, size, f"each result of {name}") for result in results]


def number_of(name: str, function: Callable[..., Any], *args: Any) -> float:
    """Finite number that a function of the caller returns; raises as `vector_of` does."""
    result = called(name, function, *args)
    try:
        return number(result, f"the result of {name}")
    except InputError as error:
        raise FunctionError(str(error)) from None


def _vector(result: Any, size: int | None, name: str) -> Vector:
    try:
        array = as_floats(result, name)
        return array if array.ndim == 1 and size in (None, array.size) else vector(array, size, name)
    except InputError as error:
        raise FunctionError(str(error)) from None


def answering(function: Callable[..., Any], name: str, check: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """A method of a caller's class whose result is checked.

    Args:
        function: The method.
        name: How it is called in messages.
        check: Result in the form in which it is used, from what was returned and the arguments.
    """

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        result = called(name, function, *args, **kwargs)
        try:
            return check(result, (*args, *kwargs.values()))
        except InputError as error:
            raise FunctionError(str(error)) from None

    return wrapper
