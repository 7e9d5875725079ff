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
import types
import weakref
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from eos_pin._arrays.annotations import FEW, Check, Never, check_of, hint_of, size_of
from eos_pin._arrays.answers import answering
from eos_pin._arrays.arrays import is_finite, is_rotation
from eos_pin._arrays.extensions import extension

F = TypeVar("F", bound=Callable[..., Any])


class Checked:
    """A class whose public methods check their arguments where they are decorated by `checked`.

    `_name` is the method `name` without the check, also of an override in a subclass: that is checked as the method of
    the base is, and needs no decorator. Of classes outside of this package results are checked as well, in both forms.
    """

    def __init_subclass__(cls, **rest: Any) -> None:
        """Check overridden methods, and keep each of them without its check as well."""
        super().__init_subclass__(**rest)
        own = [base for base in cls.__mro__ if base is cls or not issubclass(base, Checked)]
        for name, method in [item for base in own for item in vars(base).items()]:
            # A method of another base counts where it comes before that of the contract.
            if not isinstance(method, FUNCTIONS) or inspect.getattr_static(cls, name) is not method:
                continue
            inner = "_" + name.strip("_")
            if not hasattr(method, "unchecked"):
                contract = next((base for base in cls.__mro__[1:] if hasattr(vars(base).get(name), "unchecked")), None)
                if contract is None:
                    continue
                border = vars(contract)[name].border
                setattr(cls, name, method)
                check_answers(cls, name, border.function)
                method = _bordered(vars(cls)[name], _Border(method, border))
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


def check_answers(cls: type, name: str, contract: Callable[..., Any]) -> None:
    """Check the results of a method, in a class from outside of this package.

    Args:
        cls: The class.
        name: Name of the method.
        contract: The method of a base class whose annotation says what it returns.
    """
    if name in vars(cls) and cls.__module__.partition(".")[0] != __name__.partition(".")[0]:
        label = f"{cls.__name__}.{name}".removesuffix(".__call__")
        setattr(cls, name, answering(vars(cls)[name], label, _Border(contract).answer(label)))


def unchecked(function: F) -> F:
    """A function that is decorated by `checked`, without the check."""
    return function.unchecked  # type: ignore[attr-defined]


def bordered(function: Any, border: _Border) -> Any:
    """The function behind its border; the compiled form is in `_border.pyx`."""

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if not border.accepted(args, kwargs):
            args, kwargs = border.converted(args, kwargs)
        return function(*args, **kwargs)

    wrapper.unchecked, wrapper.border = function, border  # type: ignore[attr-defined]
    return wrapper


class Accepted:
    """The arguments that a function accepted of its last few owners; the compiled form is in `_border.pyx`.

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
        """Add marks to those of an owner, which is given as a weak reference."""
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


#: The compiled forms of `Accepted` and `bordered`; None without.
compiled = extension("_arrays._border")
_accepted, _bordered = (Accepted, bordered) if compiled is None else (compiled.Accepted, compiled.bordered)
#: What counts as a function: of Python, and of the compiled border.
FUNCTIONS = (types.FunctionType, type(_bordered))


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


class _Border:
    """The checks of a function's parameters, read from its annotations when it is first called."""

    def __init__(self, function: Callable[..., Any], base: _Border | None = None) -> None:
        self.function, self.base = function, base

    @functools.cached_property
    def checks(self) -> dict[str, Check | None]:
        names = inspect.unwrap(self.function).__globals__
        mine = {p.name: check_of(p.name, hint_of(p.annotation, names), p.default) for p in _parameters(self.function)}
        if self.base is None:
            return mine
        # What an override leaves open is checked as in the method of the base.
        others = dict(zip(mine, self.base.checks.values()))  # noqa: B905
        return {name: check or others.get(name) for name, check in mine.items()}

    def answer(self, name: str) -> Callable[[Any, Sequence[Any]], Any]:
        """Check of the results of an override, by the sizes of its arguments; NaN and infinity are left to the user."""

        @functools.cache
        def check() -> Check:
            hint = inspect.signature(self.function).return_annotation
            names = inspect.unwrap(self.function).__globals__
            found = check_of(f"the result of {name}", hint_of(hint, names), math.inf, result=True)
            return found or Check(lambda value, known: value)

        vectors = [str(p.annotation) == "JointVector" for p in _parameters(self.function)]

        def answered(value: Any, known: Sequence[Any]) -> Any:
            sizes = {size: size_of(size, known) for size in ("size", "n", "m", "r")}
            joints = [len(given) for given, is_vector in zip(known, vectors, strict=False) if is_vector]
            sizes["n"] = sizes["n"] or next(iter(joints), None)
            return check().run(value, [types.SimpleNamespace(**sizes)])

        return answered

    @functools.cached_property
    def accepted(self) -> Any:
        """The arguments that need no closer look, an `Accepted`."""
        return _accepted(tuple(self.checks))

    def converted(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments in the form the function takes; remembered if they are in this form already."""
        if len(args) > len(self.checks):
            # Python refuses them in its own words.
            return args, kwargs
        # Parts of larger arrays, such as a column of a pose, cost one copy, not a closer look.
        whole = tuple([_contiguous(value) for value in args])
        if not all(map(operator.is_, whole, args)) and self.accepted(whole, kwargs):
            return whole, kwargs
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


def _contiguous(value: Any) -> Any:
    return value.copy() if type(value) is np.ndarray and not value.flags.forc else value


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    return [p for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD]
