"""Extension modules of the package, where they were compiled."""

from __future__ import annotations

import os
from contextlib import suppress
from importlib import import_module
from typing import Any


def extension(name: str) -> Any:
    """A compiled module; None without one, and with EOS_PIN_COMPILED=0 in the environment.

    Args:
        name: Name of the module in the package, with dots.
    """
    if os.environ.get("EOS_PIN_COMPILED") != "0":
        with suppress(ImportError):
            return import_module(f"eos_pin.{name}")
    return None
