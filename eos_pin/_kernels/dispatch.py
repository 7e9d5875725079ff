"""Compiled twins of the package's own formulas, where it was installed with a C compiler.

A formula stands where it belongs, written to be read. Where it runs in every control step and NumPy's price for a call
counts, it may have a twin in `law.pyx` or `parts.pyx`, which gives the same to rounding in a fraction
of the time (`benchmarks/compiled.py`). Without a compiler, and with EOS_PIN_COMPILED=0 in the environment, the
originals do everything.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace
from typing import Any, TypeVar, cast

#: The compiled functions and classes; None without.
kernels: Any = None
if os.environ.get("EOS_PIN_COMPILED") != "0":
    with suppress(ImportError):
        modules = [
            import_module(f"eos_pin._kernels.{name}") for name in ("law", "parts", "_chain", "_solids", "_trace")
        ]
        kernels = SimpleNamespace(
            **{name: use_compiled for module in modules for name, use_compiled in vars(module).items()}
        )

Formula = TypeVar("Formula", bound=Callable[..., Any])

#: The functions and classes that have a twin, by name.
REFERENCES: dict[str, Callable[..., Any]] = {}


def use_compiled(original: Formula) -> Formula:
    """Put what is compiled under the same name in the place of a function or class, where there is that."""
    REFERENCES[original.__name__] = original
    return cast(Formula, getattr(kernels, original.__name__, original))
