"""Joint values by name: `{"elbow": 0.5}` in Python, `elbow=0.5` on the command line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from eos_pin._arrays import JointVector, VectorLike, number, vector
from eos_pin.errors import InputError, UnknownNameError

#: What a caller may hand over where joint values are meant: all in order, or some by name.
JointsLike: TypeAlias = VectorLike | Mapping[str, float]


def in_order(values: JointsLike, names: Iterable[str], rest: JointVector, name: str) -> JointVector:
    """Joint values in the order of q.

    Args:
        values: All of them in order, or some by the name of the joint.
        names: Names of the joints.
        rest: Values of the joints that are not named, (n,).
        name: Name of the values in the error message.

    Raises:
        InputError: Not numbers, another count, or not finite.
        UnknownNameError: There is no such joint.
    """
    if not isinstance(values, Mapping):
        return vector(values, rest.size, name)
    q, names = rest.copy(), list(names)
    for joint, value in values.items():
        if joint not in names:
            raise UnknownNameError("joint of the chain", str(joint), names)
        q[names.index(joint)] = number(value, f"{name} of joint {joint!r}")
    return q


def by_name(words: Sequence[str], name: str) -> dict[str, float | None]:
    """Values by name from words `joint=value`; None for a word without a value.

    Args:
        words: The words, as the command line has them.
        name: Their name in the error message.

    Raises:
        InputError: A value is no number, or a joint is there twice.
    """
    found: dict[str, float | None] = {}
    for word in words:
        joint, equals, value = word.rpartition("=") if "=" in word else (word, "", "")
        if joint in found:
            raise InputError(f"{name} has joint {joint!r} twice; give one value for it")
        found[joint] = number(value, f"{name} of joint {joint!r}") if equals else None  # type: ignore[arg-type]
    return found
