"""The check of a parameter, or of a result, by its annotation."""

from __future__ import annotations

import functools
import inspect
import math
import operator
import os
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from eos_pin._arrays.arrays import Above, Array, as_floats, is_finite, number
from eos_pin.errors import InputError

#: What stands for each size in messages.
SIZES = {"n": "one per joint", "m": "one per task velocity", "r": "n − m, the degree of redundancy", "size": ""}


#: So many owners a function remembers; see `border.Accepted`.
FEW = 4


class Never:
    """Mark of an argument that is checked in every call; it is a class that no object has."""


class Check(NamedTuple):
    """The check of a parameter: the argument that the function takes, and the mark of an argument that it accepted.

    Both are functions of the argument and of all arguments.
    """

    run: Callable[[Any, Sequence[Any]], Any]
    mark: Callable[[Any, Sequence[Any]], Any] = lambda value, known: type(value)


def _unmarked(value: Any, known: Sequence[Any]) -> type:
    return Never


def hint_of(annotation: Any, names: dict[str, Any]) -> Any:
    """The type that an annotation names; None for one that only a type checker can read."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, names)
    except NameError as error:
        # A module that imports a public name for type checkers only.
        public = getattr(sys.modules["eos_pin"], str(error.name), None)
        return None if public is None else hint_of(annotation, {**names, str(error.name): public})
    except TypeError:
        return None


def check_of(name: str, hint: Any, default: Any, *, result: bool = False) -> Check | None:
    """The check of one parameter, or of a result; None for a parameter that the function checks itself.

    Of a result arrays need not be finite, and tuples have their length.
    """
    choices = typing.get_args(hint)
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        others = [choice for choice in choices if choice is not type(None)]
        check = _either(name, others) if len(others) > 1 else check_of(name, others[0], default, result=result)
        return check if check is None or len(others) == len(choices) else _or_none(check)
    if hint is bool:
        return Check(lambda value, known: truth(value, name))
    origin = typing.get_origin(hint)
    # Of parameters only those of different classes: things of one kind are looked at one by one.
    if origin is tuple and Ellipsis not in choices and (result or _differ(choices)):
        parts = [check_of(f"each part of {name}", choice, math.inf, result=result) for choice in choices]
        return _fixed(name, parts, (tuple,) if result else (tuple, list))
    if origin in _SEVERAL:
        return Check(lambda value, known: _several(value, name, origin, choices), _unmarked)
    if origin is Callable:
        return Check(lambda value, known: _callable(value, name))
    if hint is float or typing.get_origin(hint) is Annotated:
        bound = next((extra for extra in choices[1:] if isinstance(extra, Above)), Above(-math.inf))
        if choices and choices[0] is not float:
            return None
        endless = bound.endless or (isinstance(default, float) and math.isinf(default))
        return Check(lambda value, known: _number(value, name, bound, endless), lambda value, known: bound.least)
    if hint is int:
        return Check(lambda value, known: _integer(value, name))
    if typing.get_origin(hint) is Literal:
        return Check(lambda value, known: _one_of(value, name, choices), _unmarked)
    if hasattr(hint, "dim_str"):
        more, *rest = hint.dim_str.replace("#", "").split()
        sizes, any_rows = (rest, True) if more.startswith("*") else ([more, *rest], False)
        if not (all(size.isidentifier() or size.isdigit() for size in sizes) and "float64" in hint.dtypes):
            return None
        return Check(
            lambda value, known: _array(value, name, sizes, known, any_rows, not result),
            lambda value, known: _array_mark(value, sizes, known),
        )
    if not _is_class(hint):
        return None
    if getattr(hint, "_is_protocol", False) and not getattr(hint, "_is_runtime_protocol", False):
        return Check(lambda value, known: _callable(value, name)) if "__call__" in vars(hint) else None
    if issubclass(hint, tuple) and hasattr(hint, "_fields"):
        return _named_tuple(name, hint, result)
    return Check(lambda value, known: of_type(value, name, hint))


def _named_tuple(name: str, kind: Any, result: bool) -> Check:
    """The check of a named tuple and of its parts, of any sizes."""

    @functools.cache
    def checks() -> list[Check | None]:
        names = vars(sys.modules[kind.__module__])
        hints = {part: hint_of(hint, names) for part, hint in kind.__annotations__.items()}
        return [check_of(f"{part} of {name}", hint, math.inf, result=result) for part, hint in hints.items()]

    def run(value: Any, known: Sequence[Any]) -> Any:
        parts = zip(of_type(value, name, kind), checks(), strict=True)
        made = [part if check is None else check.run(part, ()) for part, check in parts]
        return value if all(map(operator.is_, made, value)) else kind(*made)

    return Check(run, _unmarked)


def _differ(choices: Sequence[Any]) -> bool:
    """Whether these are classes, and not all the same."""
    return all(map(_is_class, choices)) and len(set(choices)) > 1


def _fixed(name: str, checks: Sequence[Check | None], kinds: tuple[type[Any], ...]) -> Check:
    """The check of a tuple of some length, part by part, given as one of some kinds."""

    def run(value: Any, known: Sequence[Any]) -> Any:
        if not isinstance(value, kinds) or len(value) != len(checks):
            raise InputError(f"{name} must be a tuple of {len(checks)}, got {value!r}")
        parts = zip(value, checks, strict=True)
        return tuple(part if check is None else check.run(part, known) for part, check in parts)

    return Check(run, _unmarked)


def _or_none(check: Check) -> Check:
    """The same check where None is allowed as well."""
    return Check(
        lambda value, known: None if value is None else check.run(value, known),
        lambda value, known: type(None) if value is None else check.mark(value, known),
    )


def _is_class(hint: Any) -> bool:
    # Python 3.11 made a class of `Any`.
    return isinstance(hint, type) and hint is not typing.Any and hint is not inspect.Parameter.empty


#: What stands for several things.
_SEVERAL = (Sequence, Iterable, Mapping, tuple, list)
#: Classes that stand for collections among other classes.
_WHOLE: dict[Any, Any] = {Mapping: Mapping, Sequence: Sequence, tuple: tuple}
#: Classes that are asked for by name alone, and what else is meant.
_ALSO: dict[type, tuple[type, ...]] = {Path: (os.PathLike,)}


def _either(name: str, others: Sequence[Any]) -> Check | None:
    """The check of one of several classes; None where one of them has other forms, such as lists for arrays."""
    others = [_WHOLE.get(typing.get_origin(other), other) for other in others]
    if not all(_is_class(other) and other not in (float, int, np.ndarray) for other in others):
        return None
    if any(hasattr(other, "dim_str") or getattr(other, "_is_protocol", False) for other in others):
        return None
    return Check(lambda value, known: of_type(value, name, *others))


def _array(value: Any, name: str, sizes: Sequence[str], known: Sequence[Any], any_rows: bool, finite: bool) -> Array:
    if sizes == ["size"] and (task := next((task for it in known if (task := _task_of(it)) is not None), None)):
        point = task.point(value)
        right = type(value) is np.ndarray and value.dtype == float and np.array_equal(value, point)
        return value if right else point
    shape = tuple(int(size) if size.isdigit() else size_of(size, known) for size in sizes)
    array = as_floats(value, name)
    last = array.shape[max(array.ndim - len(shape), 0) :] if any_rows else array.shape
    if len(last) != len(shape) or any(b is not None and a != b for a, b in zip(last, shape, strict=True)):
        needed = ", ".join(size if there is None else str(there) for size, there in zip(sizes, shape, strict=True))
        meaning = f" ({SIZES[sizes[0]]})" if len(sizes) == 1 and SIZES.get(sizes[0]) else ""
        form = f"{needed} number{'' if needed == '1' else 's'}{meaning}" if len(sizes) == 1 else f"of shape ({needed})"
        raise InputError(f"{name} must be {form}{' or rows of so many' * any_rows}, got shape {array.shape}")
    if finite and not is_finite(array):
        raise InputError(f"{name} must be finite, got {array.tolist()}")
    return array


def _array_mark(value: Any, sizes: Sequence[str], known: Sequence[Any]) -> Any:
    """The mark of an array whose sizes come from the owner alone."""
    owner = known[:1]
    if sizes == ["size"] and any(_task_of(it) is not None for it in known):
        task = _task_of(owner[0])
        return Never if task is None or task.rotations is None else (np.shape(value), task.rotations)
    if any(size_of(size, known) != size_of(size, owner) for size in sizes if not size.isdigit()):
        return Never
    return np.shape(value), ()


def size_of(size: str, known: Sequence[Any]) -> int | None:
    """A size by its name, from the robot, the task or the chart among the arguments, or from their attributes."""
    for holder in known:
        found = getattr(holder, size, None)
        if isinstance(found, int):
            return found
        inner = [getattr(holder, part, None) for part in ("chart", "task", "robot", "point", "clearance")]
        if any(there is not None for there in inner) and not isinstance(holder, type):
            found = size_of(size, [there for there in inner if there is not None])
            if found is not None:
                return found
    if size == "r":
        n, m = size_of("n", known), size_of("m", known)
        return None if n is None or m is None else n - m
    return None


def _task_of(holder: Any) -> Any:
    """The task of a chart or an atlas, or the holder if it is a task itself; None for other things."""
    task = getattr(holder, "task", holder)
    return task if hasattr(task, "point") and hasattr(task, "linearize") else None


def _number(value: Any, name: str, bound: Above, endless: bool) -> float:
    if endless and isinstance(value, float) and value == math.inf:
        return math.inf
    ends = {"at_least": bound.least} if bound.reached else {"above": bound.least}
    return number(value, name, **ends)


def _integer(value: Any, name: str) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise InputError(f"{name} must be a whole number, got {value!r}") from None


def _one_of(value: Any, name: str, choices: Sequence[Any]) -> Any:
    if not any(value is choice or (type(value) is type(choice) and value == choice) for choice in choices):
        raise InputError(f"{name} must be {' or '.join(map(repr, choices))}, got {value!r}")
    return value


def of_type(value: Any, name: str, *kinds: type) -> Any:
    """Accept a value of some classes, and return it unchanged.

    Raises:
        InputError: It is of none of these classes.
    """
    if not isinstance(value, (*kinds, *(other for kind in kinds for other in _ALSO.get(kind, ())))):
        raise InputError(f"{name} must be of type {' or '.join(kind.__name__ for kind in kinds)}, got {value!r}")
    return value


def truth(value: Any, name: str) -> bool:
    """True or False, as a plain bool.

    Raises:
        InputError: It is something else.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def _callable(value: Any, name: str) -> Any:
    if not callable(value):
        raise InputError(f"{name} must be a function or another object that can be called, got {value!r}")
    return value


def _several(value: Any, name: str, kind: Any, choices: Sequence[Any]) -> Any:
    inner = choices[0] if choices and _is_class(choices[0]) and not hasattr(choices[0], "dim_str") else None
    kinds = typing.get_args(choices[0]) if choices and isinstance(choices[0], types.UnionType) else (inner,)
    if choices and typing.get_origin(choices[0]) is Mapping:
        kinds = (Mapping,)
    if kind is Mapping:
        if not isinstance(value, Mapping):
            raise InputError(f"{name} must be a dictionary, got {value!r}")
        return value
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise InputError(f"{name} must be a list, got {value!r}")
    if kind is tuple:
        value = tuple(value.tolist() if isinstance(value, np.ndarray) else value)
    if typing.get_origin(choices[0] if choices else None) is Literal:
        return [_one_of(item, f"each of {name}", typing.get_args(choices[0])) for item in value]
    if any(kind in (None, float, int, np.ndarray) or not _is_class(kind) for kind in kinds):
        return value
    if any(getattr(kind, "_is_protocol", False) or hasattr(kind, "dim_str") for kind in kinds):
        return value
    if isinstance(value, (Sequence, np.ndarray)):
        items = [of_type(item, f"each of {name}", *kinds) for item in value]
        return tuple(items) if isinstance(value, tuple) else items
    return value
