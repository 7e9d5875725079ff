"""The run-time type checks of the tests; a module of its own, because it is at work while eos_pin is imported.

Every function of the package is checked by its annotations, shapes included, at its first call in each test and at
some of the later ones. A fault of types shows there as surely as in a thousand calls more, at a fraction of the time.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

#: Of the calls of a function that follow its first one in a test, one in so many is checked.
EACH = 100

# An int is welcome wherever a float is meant.
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))
_jaxtyped = jaxtyping.jaxtyped
_counts: list[list[int]] = []


def install() -> None:
    """Check the functions of eos_pin, which must not be imported yet."""
    jaxtyping.jaxtyped = _sampled
    jaxtyping.install_import_hook("eos_pin", "typecheck.typecheck")


def begin() -> None:
    """Count the calls of a test from its start."""
    for count in _counts:
        count[0] = 0


@contextmanager
def off() -> Iterator[None]:
    """Check nothing meanwhile: for arguments of a wrong type, and for long runs."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


def typecheck(function: Callable[..., Any]) -> Callable[..., Any]:
    """The type checker that shapes are added to."""
    return _check(function)


def _sampled(function: Any = None, *, typechecker: Any) -> Any:
    """Check some of the calls of a function.

    Constructors are left alone: the annotations of a dataclass are those of its attributes, and what it is given to
    make them from may be a list.
    """
    if function is None:
        return functools.partial(_sampled, typechecker=typechecker)
    if isinstance(function, type) or function.__name__ == "__init__":
        return function
    count = [0]
    _counts.append(count)

    @functools.cache
    def checked() -> Any:
        return _jaxtyped(function, typechecker=typechecker)

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        count[0] += 1
        if (count[0] > 1 and count[0] % EACH) or jaxtyping.config.jaxtyping_disable:
            return function(*args, **kwargs)
        return checked()(*args, **kwargs)

    return wrapper
