"""The rule that a short cut is not used in a subclass that overrides a method it replaces."""

from __future__ import annotations

from typing import Any


def stands_for(cls: type, shortcut: str, *methods: str, off: Any = None) -> None:
    """Switch a short cut off in a subclass that overrides a method which the short cut replaces.

    A short cut is an attribute that gives in one step what the methods of its class give together: a compiled form, or
    numbers from which one is made. It is right for the class that defines it and for subclasses that leave the methods
    alone. To be called from `__init_subclass__`, so that whoever overrides a method need not know of any short cut.

    Args:
        cls: The new class.
        shortcut: Name of the attribute.
        methods: Names of the methods.
        off: Value of the attribute in a class that overrides one of them.
    """
    owner = next(base for base in cls.__mro__ if shortcut in vars(base))
    if any(getattr(cls, method) is not getattr(owner, method) for method in methods):
        setattr(cls, shortcut, off)
