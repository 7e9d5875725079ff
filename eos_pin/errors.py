"""Every exception that eos_pin raises.

All derive from `EosError`, so one `except` catches what the package itself refuses. Each message has the value
given, the values allowed and a remedy; the data a program needs to react is kept in attributes.
"""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NoReturn, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


class EosError(Exception):
    """Root of every exception raised by eos_pin."""


class InputError(EosError, ValueError):
    """Argument of the wrong shape, not finite, or outside the allowed range."""


class StateError(InputError):
    """Robot state that a controller cannot use: of the wrong shape, or not finite."""


class FunctionError(InputError):
    """Fault in a function or class of the caller: an exception, kept as the cause, or a result that does not fit."""


class RobotError(EosError):
    """Robot description that cannot be loaded, or whose model cannot be controlled."""


class UnknownNameError(InputError, KeyError):
    """Unknown name of a robot, frame, joint or setting.

    Attributes:
        kind: Kind of thing that the name stands for, such as `"frame"`.
        name: The name that was given.
        available: All names that would have been accepted.
    """

    def __init__(self, kind: str, name: str, available: Iterable[str], advice: str = "") -> None:
        self.kind, self.name, self.available = kind, name, tuple(available)
        super().__init__(f"no {kind} is named {name!r}. {suggest(name, self.available)}{advice}")

    def __str__(self) -> str:
        # KeyError would show the repr of the message.
        return str(self.args[0])

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


def refuse_unused(of: Callable[..., Any], reason: str, **given: Any) -> None:
    """Refuse arguments that would change nothing.

    Args:
        of: Function or class whose arguments they are.
        reason: Why they would not, and what to do.
        given: Their values by name.

    Raises:
        InputError: One is not at its default.
    """
    defaults = _defaults(of)
    for name, value in given.items():
        default = defaults[name]
        if value is not default and (default is None or value != default):
            raise InputError(f"{name}={value!r} does not apply: {reason}")


@functools.cache
def _defaults(of: Callable[..., Any]) -> dict[str, Any]:
    """Values of arguments by name where they are not given."""
    return {name: parameter.default for name, parameter in inspect.signature(of).parameters.items()}


class MissingDependencyError(EosError, ImportError):
    """Missing package, one that is not installed with eos_pin.

    Attributes:
        package: Name of the package.
        command: Command that installs it.
    """

    def __init__(self, purpose: str, package: str, command: str, advice: str = "") -> None:
        self.package, self.command = package, command
        super().__init__(f"{purpose} needs {package}, which is not installed; run: {command}{advice}")

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


class ChartError(EosError):
    """Chart that cannot be made, or use of a chart outside its neighbourhood."""


class InverseError(ChartError):
    """Failure to find the inverse kinematic map u = h(z, v) on a chart.

    Attributes:
        residual: Task error that was left, in the task's own units.
        iterations: Newton steps that were taken.
    """

    def __init__(self, message: str, residual: float, iterations: int) -> None:
        self.residual, self.iterations = residual, iterations
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


class SingularError(ChartError):
    """Loss of rank of the task Jacobian G': the task itself is singular, and no chart can help.

    Attributes:
        rank: Rank that is left, at most m; None where it was not computed.
        singular_values: Singular values of G'; None where they were not computed.
    """

    def __init__(self, message: str, rank: int | None = None, singular_values: Sequence[float] | None = None) -> None:
        self.rank = rank
        self.singular_values = None if singular_values is None else tuple(singular_values)
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


class PlanError(EosError):
    """Failure to find a motion along a path, or use of a plan that does not fit.

    Attributes:
        waypoint: Number of the last way point that was reached; None where that has no meaning.
        reached: Part of the path that was reached, from 0 to 1.
        stopped: Whether a person stopped the search.
        info: Further facts, in plain values.
    """

    info: Mapping[str, object] = {}

    def __init__(self, message: str, waypoint: int | None = None, reached: float = 0.0, stopped: bool = False) -> None:
        self.waypoint, self.reached, self.stopped = waypoint, reached, stopped
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


class HardwareError(EosError):
    """Error that a robot reports, or command that it does not follow."""


class ResultError(EosError):
    """Result file that is damaged, foreign, or of a version that cannot be read."""


class OutputError(EosError):
    """File that cannot be written."""


class ViewerError(EosError):
    """Failure of the viewer to show a scene."""


class OldNameError(InputError, AttributeError):
    """Use of a name of an earlier version; the message has the new one."""


class Renamed:
    """Class attribute in the place of an old name: using it raises an error that has the new name.

    Args:
        new: The new name.
    """

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = f"{owner.__name__}.{name}"

    def __get__(self, instance: object, owner: type | None = None) -> NoReturn:
        raise OldNameError(f"{self.old} was renamed: use {self.new}")

    def __set__(self, instance: object, value: object) -> NoReturn:
        raise OldNameError(f"{self.old} was renamed: use {self.new}")


def renamed(**names: str) -> Callable[[F], F]:
    """Decorator that refuses old names of keyword arguments, and gives the new ones.

    Args:
        names: The new name of each old one.
    """

    def decorate(target: F) -> F:
        thing: Any = target
        is_class = isinstance(thing, type)
        function: Callable[..., Any] = thing.__init__ if is_class else thing

        name = thing.__qualname__.removesuffix(".__init__")

        @functools.wraps(function)
        def checked(*args: Any, **kwargs: Any) -> Any:
            for old in names.keys() & kwargs.keys():
                raise OldNameError(f"the argument {old!r} of {name} was renamed: use {names[old]!r}")
            return function(*args, **kwargs)

        if not is_class:
            return cast("F", checked)
        thing.__init__ = checked
        return target

    return decorate


def take(interrupt: KeyboardInterrupt) -> None:
    """Mark an interrupt as handled; the command line repeats one that is lost."""
    interrupt.__dict__["taken"] = True


def is_taken(interrupt: KeyboardInterrupt) -> bool:
    """Whether an interrupt was handled."""
    return "taken" in interrupt.__dict__


def suggest(name: str, available: Sequence[str], most: int = 40) -> str:
    """Sentence that names close matches of `name`, or all available names if nothing is close."""
    if not available:
        return "There are none. "
    close = difflib.get_close_matches(name, available, n=6, cutoff=0.5)
    close += [a for a in available if name.lower() in a.lower() and a not in close][:6]
    if close:
        return f"Did you mean {', '.join(close)}? "
    listed = ", ".join(available[:most])
    more = f" and {len(available) - most} more" if len(available) > most else ""
    return f"Available: {listed}{more}. "


def _rebuild(cls: type[EosError], args: tuple[object, ...], state: dict[str, object]) -> EosError:
    """Unpickle an exception whose constructor takes more than its message."""
    error = cls.__new__(cls)
    error.args = args
    error.__dict__.update(state)
    return error
