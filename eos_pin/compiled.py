"""Compiled twins of the package's own formulas, where it was installed with a C compiler.

A formula stands where it belongs, written to be read. Where it runs in every control step and NumPy's price for a call
counts, it may have a twin in `_kernels.pyx`, which gives the same to rounding in a fraction of the time. Without a
compiler, and with EOS_PIN_COMPILED=0 in the environment, the originals do everything.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any, TypeVar, cast

kernels: Any = None
if os.environ.get("EOS_PIN_COMPILED") != "0":
    with suppress(ImportError):
        kernels = import_module("eos_pin._kernels")

Formula = TypeVar("Formula", bound=Callable[..., Any])

#: The functions that have a twin, by name.
ORIGINALS: dict[str, Callable[..., Any]] = {}


def twin(original: Formula) -> Formula:
    """Put the compiled function of the same name in the place of this one, where there is one."""
    ORIGINALS[original.__name__] = original
    return cast(Formula, getattr(kernels, original.__name__, original))
