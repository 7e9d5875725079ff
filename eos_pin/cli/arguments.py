"""Arguments in `--help`: words of meaning instead of types, and no default where there is none."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import is_dataclass, replace
from functools import update_wrapper
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructTypeInfo,
)

#: What an option without a value has for a default; help leaves it out.
UNSET = "unset"
#: Markers that not every tyro has.
NEWER = "DisallowNone", "PositionalMetavarFromFieldName"
#: Words for the values of options, where neither name nor type has a good one.
WORDS = {
    "bag": "FOLDER",
    "centre": "X Y Z",
    "cost": "NAME=WEIGHT ...",
    "friction": "VISCOUS COULOMB",
    "gravity": "X Y Z",
    "keep": "FOLDER",
    "lock": "JOINT ...",
    "out": "FOLDER",
    "package_dirs": "FOLDER ...",
    "path": "PATH",
    "push": "X Y Z",
    "push_time": "START END",
    "q0": "VALUE ...",
    "runs": "RUN ...",
    "tolerance": "NAME=WIDTH ...",
    "tool": "X Y Z",
}


class Registry(ConstructorRegistry):
    """Rules of tyro in which None, an empty word and an empty list have no default to show, and values have words."""

    def __init__(self) -> None:
        super().__init__()
        self._asking = False
        self.primitive_rule(self._rule)
        self.struct_rule(self._fields)

    def _rule(self, info: PrimitiveTypeInfo) -> Any:
        spec = self._others(self.get_primitive_spec, info)
        if not isinstance(spec, PrimitiveConstructorSpec):
            return spec
        return replace(spec, str_from_instance=_told(spec.str_from_instance))

    def _fields(self, info: StructTypeInfo) -> Any:
        spec = self._others(self.get_struct_spec, info)
        if not isinstance(spec, StructConstructorSpec):
            return spec
        return replace(
            spec, fields=tuple(replace(each, type=_worded(each.name, each.type, each.default)) for each in spec.fields)
        )

    def _others(self, ask: Callable[[Any], Any], info: Any) -> Any:
        """Answer of tyro's own rules, which come after these."""
        if self._asking:
            return None
        self._asking = True
        try:
            return ask(info)
        finally:
            self._asking = False


def worded(command: Callable[..., int]) -> Callable[..., int]:
    """The same command, with words for its arguments in help."""
    made: Any = update_wrapper(lambda *args, **kwargs: command(*args, **kwargs), command)
    # The arguments are not those of the function it wraps.
    del made.__wrapped__
    made.__signature__ = signature = inspect.signature(command)
    hints = get_type_hints(command, include_extras=True)
    made.__annotations__ = {
        name: _worded(name, hints[name], each.default) for name, each in signature.parameters.items()
    }
    return cast("Callable[..., int]", made)


def _worded(name: str, kind: Any, default: Any) -> Any:
    """Type of an argument, with a word for its values and no default where there is no value."""
    if is_dataclass(default) or is_dataclass(kind):
        return kind
    word = _word(name, kind)
    if word and tyro.conf.Positional in get_args(kind) and default is not inspect.Parameter.empty:
        word = f"[{word}]"
    return Annotated[kind, tyro.conf.arg(metavar=word, help_behavior_hint=_hint)]


def _word(name: str, kind: Any) -> str | None:
    """Word for the values of an argument in help; None for tyro's own, such as the list of all choices."""
    if get_origin(kind) is Annotated:
        kind, *more = get_args(kind)
        if any(isinstance(each, PrimitiveConstructorSpec) or getattr(each, "metavar", None) for each in more):
            return None
    if get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind):
        kind = Union[tuple(each for each in get_args(kind) if each is not NoneType)]  # noqa: UP007
    several = get_origin(kind) is tuple and get_args(kind)[-1] is ...
    one = get_args(kind)[0] if several else kind
    if name in WORDS and (get_origin(kind) is tuple or one in (str, Path)):
        return WORDS[name]
    own = name.rpartition("_")[-1].upper()
    word = {str: own.removesuffix("S") if several else own, Path: "FILE"}.get(one)
    if get_origin(one) is Literal:
        word = f"{{{','.join(map(str, get_args(one)))}}}"
    return f"{word or 'NUMBER'} ..." if several else word


def _hint(default: str) -> str:
    return "" if default in (UNSET, "False") else f"(default: {default})"


def _told(written: Callable[[Any], list[str]]) -> Callable[[Any], list[str]]:
    return lambda value: [UNSET] if value is None or value in ("", ()) else written(value)


#: Options are called as they are, nothing is given as `None`, flags have no twin that takes them back, and positional
#: arguments have names instead of types; an older tyro shows the last as it does by default.
STYLE = (
    tyro.conf.OmitArgPrefixes,
    tyro.conf.FlagCreatePairsOff,
    *(getattr(tyro.conf, name) for name in NEWER if hasattr(tyro.conf, name)),
)
