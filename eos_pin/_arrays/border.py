"""The border: arguments of public functions are checked by their annotations, once.

`checked` reads what a public function takes from its annotations, and what it is given otherwise is refused in the
caller's own words. Inner code calls the same function without the check, as `_name` of a method `name`.

A function remembers the arguments that it accepted: by the same object, with the same shapes and types, the next ones
only have to be finite. This is all that a call in a control step costs.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import math
import operator
import os
import sys
import types
import typing
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np

from eos_pin._arrays.arrays import Above, Array, as_floats, is_finite, is_rotation, number
from eos_pin.errors import InputError

F = TypeVar("F", bound=Callable[..., Any])

#: What stands for each size in messages.
SIZES = {"n": "one per joint", "m": "one per task velocity", "r": "n − m, the degree of redundancy", "size": ""}


class Checked:
    """A class whose public methods check their arguments where they are decorated by `checked`.

    `_name` is the method `name` without the check, also of an override in a subclass: that is checked as the method of
    the base is, and needs no decorator.
    """

    def __init_subclass__(cls, **rest: Any) -> None:
        """Check overridden methods, and keep each of them without its check as well."""
        super().__init_subclass__(**rest)
        for name, method in list(vars(cls).items()):
            if not isinstance(method, types.FunctionType):
                continue
            inner = "_" + name.strip("_")
            if not hasattr(method, "unchecked"):
                contract = next((base for base in cls.__mro__[1:] if hasattr(vars(base).get(name), "unchecked")), None)
                if contract is None:
                    continue
                method = _bordered(method, _Border(method, vars(contract)[name].border))
                setattr(cls, name, method)
            if inner not in vars(cls):
                setattr(cls, inner, method.unchecked)


def checked(function: F) -> F:
    """Check the arguments of a function or a constructor by its annotations.

    Arrays with named sizes, such as `Float[Array, "m n"]` or `JointVector`, are made of lists, and must be finite and
    of these sizes, which are read from `self` and from the other arguments. Numbers must be finite, unless they are
    infinite by default, and in the range of an `Above`. Objects must be of the class that is asked for. Everything
    else, such as what may have many forms, is left to the function.
    """
    if isinstance(function, type):
        constructor = function.__init__  # type: ignore[misc]
        function.__init__ = _bordered(constructor, _Border(constructor))  # type: ignore[misc]
        return function
    return _bordered(function, _Border(function))


def unchecked(function: F) -> F:
    """A function that is decorated by `checked`, without the check."""
    return function.unchecked  # type: ignore[attr-defined]


def _bordered(function: Any, border: _Border) -> Any:
    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if not border.accepted(args, kwargs):
            args, kwargs = border.converted(args, kwargs)
        return function(*args, **kwargs)

    wrapper.unchecked, wrapper.border = function, border  # type: ignore[attr-defined]
    return wrapper


class Never:
    """The class of no argument: the mark of one that is always looked at."""


class Accepted:
    """The arguments that a function accepted of its last few owners; the compiled form is in `parts.pyx`.

    The owner is the first argument, such as `self`, from which the sizes of arrays are read. Marks are by which the
    next argument is recognized: None for any; (shape, rotations) for a finite array of this shape with rotations at
    these places, row by row; a number for a finite float above it; a class for its direct instances.

    Args:
        names: Names of the function's parameters.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._entries: list[tuple[Callable[[], Any], dict[str, Any]]] = []

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._names,)

    def remember(self, owner: Callable[[], Any], marks: dict[str, Any]) -> None:
        """Keep the marks of an owner, of which a weak reference is given, beside those that it has."""
        known = [entry for entry in self._entries if entry[0]() is not None]
        before = next((marks for one, marks in known if one() is owner()), {})
        self._entries = [(owner, before | marks), *(entry for entry in known if entry[0]() is not owner())][:FEW]

    def __call__(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> bool:
        """Whether the function surely accepts arguments as they are."""
        marks = next((marks for owner, marks in self._entries if args and owner() is args[0]), None)
        if marks is None or len(args) > len(self._names):
            return False
        given = (*zip(self._names, args), *kwargs.items())  # noqa: B905
        return all(_recognized(value, marks.get(name, Never)) for name, value in given)


#: So many owners a function remembers.
FEW = 4
#: The form of `Accepted` that is used; `_kernels.dispatch` puts a compiled one here.
accepted_kind: Any = Accepted


def _recognized(value: Any, mark: Any) -> bool:
    if mark is None:
        return True
    if isinstance(mark, float):
        return type(value) is float and mark < value < math.inf
    if isinstance(mark, type):
        return type(value) is mark
    shape, rotations = mark
    if type(value) is not np.ndarray or value.shape != shape or value.dtype != float or not value.flags.forc:
        return False
    flat = value.ravel("K")
    return is_finite(flat) and all(is_rotation(flat[i : i + 9].reshape(3, 3)) for i in rotations)


class _Check(NamedTuple):
    """The check of a parameter: the argument that the function takes, and the mark of an argument that it accepted.

    Both are functions of the argument and of all arguments.
    """

    run: Callable[[Any, Sequence[Any]], Any]
    mark: Callable[[Any, Sequence[Any]], Any] = lambda value, known: type(value)


def _unmarked(value: Any, known: Sequence[Any]) -> type:
    return Never


class _Border:
    """The checks of a function's parameters, read from its annotations when it is first called."""

    def __init__(self, function: Callable[..., Any], base: _Border | None = None) -> None:
        self.function, self.base = function, base

    @functools.cached_property
    def checks(self) -> dict[str, _Check | None]:
        names = inspect.unwrap(self.function).__globals__
        mine = {p.name: _check(p.name, _hint(p.annotation, names), p.default) for p in _parameters(self.function)}
        if self.base is None:
            return mine
        # What an override leaves open is checked as in the method of the base.
        others = dict(zip(mine, self.base.checks.values()))  # noqa: B905
        return {name: check or others.get(name) for name, check in mine.items()}

    @functools.cached_property
    def accepted(self) -> Any:
        """The arguments that need no closer look, an `Accepted`."""
        return accepted_kind(tuple(self.checks))

    def converted(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments in the form the function takes; remembered if they are in this form already."""
        if len(args) > len(self.checks):
            # Python refuses them in its own words.
            return args, kwargs
        known, marks = (*args, *kwargs.values()), {}
        given = [*zip(self.checks, args), *kwargs.items()]  # noqa: B905
        taken = []
        for name, value in given:
            check = self.checks.get(name)
            taken.append(value if check is None else check.run(value, known))
            marks[name] = None if check is None else check.mark(value, known)
        if args and Never not in marks.values() and all(map(operator.is_, taken, known)):
            with contextlib.suppress(TypeError):  # not every object can be referred to weakly
                self.accepted.remember(weakref.ref(args[0]), marks)
        return tuple(taken[: len(args)]), dict(zip(kwargs, taken[len(args) :]))  # noqa: B905


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    return [p for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD]


def _hint(annotation: Any, names: dict[str, Any]) -> Any:
    """The type that an annotation names; None for one that only a type checker can read."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, names)
    except NameError as error:
        # A module that imports a public name for type checkers only.
        public = getattr(sys.modules["eos_pin"], str(error.name), None)
        return None if public is None else _hint(annotation, {**names, str(error.name): public})
    except TypeError:
        return None


def _check(name: str, hint: Any, default: Any) -> _Check | None:
    """The check of one parameter; None for what the function looks at by itself."""
    choices = typing.get_args(hint)
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        others = [choice for choice in choices if choice is not type(None)]
        check = _either(name, others) if len(others) > 1 else _check(name, others[0], default)
        return check if check is None or len(others) == len(choices) else _or_none(check)
    if hint is bool:
        return _Check(lambda value, known: _truth(value, name))
    if (origin := typing.get_origin(hint)) in _SEVERAL:
        return _Check(lambda value, known: _several(value, name, origin, choices), _unmarked)
    if origin is Callable:
        return _Check(lambda value, known: _callable(value, name))
    if hint is float or typing.get_origin(hint) is Annotated:
        bound = next((extra for extra in choices[1:] if isinstance(extra, Above)), Above(-math.inf))
        if choices and choices[0] is not float:
            return None
        endless = bound.endless or (isinstance(default, float) and math.isinf(default))
        return _Check(lambda value, known: _number(value, name, bound, endless), lambda value, known: bound.least)
    if hint is int:
        return _Check(lambda value, known: _integer(value, name))
    if typing.get_origin(hint) is Literal:
        return _Check(lambda value, known: _one_of(value, name, choices), _unmarked)
    if hasattr(hint, "dim_str"):
        more, *rest = hint.dim_str.split()
        sizes, any_rows = (rest, True) if more.startswith("*") else ([more, *rest], False)
        if not (all(size.isidentifier() or size.isdigit() for size in sizes) and "float64" in hint.dtypes):
            return None
        return _Check(
            lambda value, known: _array(value, name, sizes, known, any_rows),
            lambda value, known: _array_mark(value, sizes, known),
        )
    if not _is_class(hint):
        return None
    if getattr(hint, "_is_protocol", False):
        return _Check(lambda value, known: _callable(value, name)) if "__call__" in vars(hint) else None
    return _Check(lambda value, known: _instance(value, name, (hint,)))


def _or_none(check: _Check) -> _Check:
    """The same check where None is allowed as well."""
    return _Check(
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


def _either(name: str, others: Sequence[Any]) -> _Check | None:
    """The check of one of several classes; None where one of them has other forms, such as lists for arrays."""
    others = [_WHOLE.get(typing.get_origin(other), other) for other in others]
    if not all(_is_class(other) and other not in (float, int, np.ndarray) for other in others):
        return None
    if any(hasattr(other, "dim_str") or getattr(other, "_is_protocol", False) for other in others):
        return None
    return _Check(lambda value, known: _instance(value, name, tuple(others)))


def _array(value: Any, name: str, sizes: Sequence[str], known: Sequence[Any], any_rows: bool) -> Array:
    if sizes == ["size"] and (task := next((task for it in known if (task := _task_of(it)) is not None), None)):
        point = task.point(value)
        right = type(value) is np.ndarray and value.dtype == float and np.array_equal(value, point)
        return value if right else point
    shape = tuple(int(size) if size.isdigit() else _size(size, known) for size in sizes)
    array = as_floats(value, name)
    last = array.shape[max(array.ndim - len(shape), 0) :] if any_rows else array.shape
    if len(last) != len(shape) or any(b is not None and a != b for a, b in zip(last, shape, strict=True)):
        needed = ", ".join(size if there is None else str(there) for size, there in zip(sizes, shape, strict=True))
        meaning = f" ({SIZES[sizes[0]]})" if len(sizes) == 1 and SIZES.get(sizes[0]) else ""
        form = f"{needed} number{'' if needed == '1' else 's'}{meaning}" if len(sizes) == 1 else f"of shape ({needed})"
        raise InputError(f"{name} must be {form}{' or rows of so many' * any_rows}, got shape {array.shape}")
    if not is_finite(array):
        raise InputError(f"{name} must be finite, got {array.tolist()}")
    return array


def _array_mark(value: Any, sizes: Sequence[str], known: Sequence[Any]) -> Any:
    """The mark of an array whose sizes come from the owner alone."""
    owner = known[:1]
    if sizes == ["size"] and any(_task_of(it) is not None for it in known):
        task = _task_of(owner[0])
        return Never if task is None or task.rotations is None else (np.shape(value), task.rotations)
    if any(_size(size, known) != _size(size, owner) for size in sizes if not size.isdigit()):
        return Never
    return np.shape(value), ()


def _size(size: str, known: Sequence[Any]) -> int | None:
    """A size by its name: of the robot, the task or the chart among the arguments, or of what they have."""
    for holder in known:
        found = getattr(holder, size, None)
        if isinstance(found, int):
            return found
        inner = [getattr(holder, part, None) for part in ("chart", "task", "robot", "point", "clearance")]
        if any(there is not None for there in inner) and not isinstance(holder, type):
            found = _size(size, [there for there in inner if there is not None])
            if found is not None:
                return found
    if size == "r":
        n, m = _size("n", known), _size("m", known)
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


def _instance(value: Any, name: str, kinds: tuple[type, ...]) -> Any:
    if not isinstance(value, (*kinds, *(other for kind in kinds for other in _ALSO.get(kind, ())))):
        raise InputError(f"{name} must be of type {' or '.join(kind.__name__ for kind in kinds)}, got {value!r}")
    return value


def _truth(value: Any, name: str) -> bool:
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
    if kind is Mapping:
        if not isinstance(value, Mapping):
            raise InputError(f"{name} must be a dictionary, got {value!r}")
        return value
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise InputError(f"{name} must be a list, got {value!r}")
    if typing.get_origin(choices[0] if choices else None) is Literal:
        return [_one_of(item, f"each of {name}", typing.get_args(choices[0])) for item in value]
    if any(kind in (None, float, int, np.ndarray) or not _is_class(kind) for kind in kinds):
        return value
    if any(getattr(kind, "_is_protocol", False) or hasattr(kind, "dim_str") for kind in kinds):
        return value
    if isinstance(value, (Sequence, np.ndarray)):
        items = [_instance(item, f"each of {name}", kinds) for item in value]
        return tuple(items) if isinstance(value, tuple) else items
    return value
