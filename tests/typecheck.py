"""The run-time type checker of the tests; a module of its own, because it is at work while eos_pin is imported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, beartype

# An int is welcome wherever a float is meant.
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))


def typecheck(function: Callable[..., Any]) -> Callable[..., Any]:
    """Check the arguments and the result of every call of `function`.

    Constructors are left alone: the annotations of a dataclass are those of its attributes, and what it is given to
    make them from may be a list.
    """
    return function if function.__name__ == "__init__" else _check(function)
