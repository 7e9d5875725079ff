"""Arguments in `--help`: names for those that have a place, and a word instead of an empty default."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

#: What an option without a value has for a default.
UNSET = "unset"
#: Markers that not every tyro has.
NEWER = "DisallowNone", "PositionalMetavarFromFieldName"


class Registry(ConstructorRegistry):
    """Rules of tyro in which None, an empty word and an empty list have the name `unset`."""

    def __init__(self) -> None:
        super().__init__()
        self._asking = False
        self.primitive_rule(self._rule)

    def _rule(self, info: PrimitiveTypeInfo) -> Any:
        if self._asking:
            # Tyro's own rules come after this one.
            return None
        self._asking = True
        try:
            spec = self.get_primitive_spec(info)
        finally:
            self._asking = False
        if not isinstance(spec, PrimitiveConstructorSpec):
            return spec
        return replace(spec, str_from_instance=_told(spec.str_from_instance))


def _told(written: Callable[[Any], list[str]]) -> Callable[[Any], list[str]]:
    return lambda value: [UNSET] if value is None or value in ("", ()) else written(value)


#: Options are called as they are, nothing is given as `None`, and positional arguments have names instead of types; an
#: older tyro shows both as it does by default.
STYLE = (
    tyro.conf.OmitArgPrefixes,
    *(getattr(tyro.conf, name) for name in NEWER if hasattr(tyro.conf, name)),
)
