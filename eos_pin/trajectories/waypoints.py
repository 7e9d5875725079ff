"""Tables of way points in text files: times, positions and orientations by the names of their columns.

Columns are separated by commas, semicolons, tabs or spaces, and stand in any order; what follows a `#` is a comment. A
first row names them: t [s]; x, y, z [m]; qw, qx, qy, qz, or roll, pitch, yaw [rad]; ax, ay, az, the direction of the
tool's axis; heading [rad]; or z1, …, zm for the coordinates of any task. Without names they are t, z1, …, zm.

A text such as `"0.4 0 0.5; 0.4 0.2 0.5"` has the way points themselves, without times.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from eos_pin._arrays import Array, Vector, by_value, checked, frozen_copy
from eos_pin.errors import InputError
from eos_pin.trajectories.text_tables import cells_of, decimal, numbers_of

#: How far the length of a quaternion may be from 1 to be taken as rounded.
ROUNDED = 1e-3
#: An angle beyond two turns [rad] is one in degrees.
MOST_ANGLE = 4.0 * np.pi
POSITION, QUATERNION, ANGLES = ("x", "y", "z"), ("qw", "qx", "qy", "qz"), ("roll", "pitch", "yaw")
DIRECTION = ("ax", "ay", "az")
KNOWN = "t; x, y, z; qw, qx, qy, qz; roll, pitch, yaw; ax, ay, az; heading; or z1, …, zm"

_ALIASES = (
    dict.fromkeys(("t", "time", "timestamp", "stamp", "sec", "secs", "seconds"), "t")
    | {f"{prefix}{axis}": axis for prefix in ("", "p", "t", "pos") for axis in "xyz"}
    | {f"{prefix}{axis}": f"q{axis}" for prefix in ("q", "o", "quat") for axis in "wxyz"}
    | {"w": "qw", "heading": "heading"}
    | {name: name for name in (*ANGLES, *DIRECTION)}
)  # fmt: skip
#: Words before a dot or an underline, as logs write `pose.position.x` or `orientation_w`.
_GROUPS = (
    dict.fromkeys(("field", "header", "pose"))
    | dict.fromkeys(("position", "pos", "translation", "p"), "")
    | dict.fromkeys(("orientation", "rotation", "quaternion", "quat", "q"), "q")
)
_UNITS = {"t": "s", "x": "m", "y": "m", "z": "m", "roll": "rad", "pitch": "rad", "yaw": "rad", "heading": "rad"}
_UNIT = re.compile(r"\s*(?:[\[(]\s*(?P<bracket>[^\])]*?)\s*[\])]|_(?P<suffix>s|ms|us|ns|m|mm|cm|rad|deg))$")


@by_value
@dataclass(frozen=True, eq=False)
class Waypoints:
    """A table of way points; parts without columns are None.

    Attributes:
        source: The file.
        lines: Line of each row in the file, (K,), from 1.
        columns: Names of the columns in the order of the file, as `KNOWN` has them.
        t: Increasing times [s], (K,), counted from the first.
        start: The first time as the file has it [s].
        position: Positions along `axes` [m], (K, number of axes).
        axes: Which coordinates `position` has, such as `"xyz"`.
        rotation: Rotation matrices, (K, 3, 3).
        direction: Directions of the tool's axis, unit vectors, (K, 3).
        heading: Angles about the world's z axis, for planar robots [rad], (K,).
        values: Task points of columns that are not named, or named z1, …, zm, (K, m).
    """

    source: Path
    lines: Sequence[int] = field(repr=False)
    columns: tuple[str, ...]
    t: Vector | None = None
    start: float = 0.0
    position: Float[Array, "K k"] | None = None
    axes: str = ""
    rotation: Float[Array, "K 3 3"] | None = None
    direction: Float[Array, "K 3"] | None = None
    heading: Vector | None = None
    values: Float[Array, "K m"] | None = None

    def __len__(self) -> int:
        return len(self.lines)


def is_table(path: str | Path) -> bool:
    """Whether a path is a table of way points, by the ending of a file or as a text of numbers."""
    return Path(path).suffix.lower() in (".csv", ".tsv", ".txt") or _is_text(path)


def _is_text(path: str | Path) -> bool:
    """Whether the rows stand in the text itself."""
    return ";" in str(path) and all(
        decimal(cell) is not None for cell in re.split(r"[\s,;]+", str(path).strip(" ;,")) if cell
    )


@checked
def read_waypoints(path: str | Path) -> Waypoints:
    """Read a table of way points.

    Args:
        path: Text file, whose columns are described at the head of this module, or a text of way points separated by
            semicolons.

    Raises:
        InputError: The file cannot be read, a column is not known or not there, a cell is no finite number, the times
            do not increase, or a quaternion is not of length 1 to 1e-3. It names file, line and cause.
    """
    if _is_text(path):
        return _written(str(path))
    path = Path(path)
    rows = cells_of(path)
    if not rows:
        raise InputError(f"{path} has no rows of numbers; its columns are {KNOWN}")
    first, names = rows[0], None
    if any(decimal(cell) is None for cell in first[1]):
        names = tuple(_name(cell, f"{path}, line {first[0]}") for cell in first[1])
        _check_names(names, f"{path}, line {first[0]}")
        rows = rows[1:]
    if not rows:
        raise InputError(f"{path}, line {first[0]}: no row follows the names of the columns; add the way points")
    width = len(names or rows[0][1])
    if names is None:
        names = ("t", *(f"z{i}" for i in range(1, width)))
        if width < 2:
            raise InputError(
                f"{path}, line {first[0]}: one column only; without names the columns are t, z1, …, zm. Name them in "
                f"the first row: {KNOWN}"
            )
    table = [numbers_of(path, line, cells, names) for line, cells in rows]
    return _named(path, [line for line, _ in rows], names, table)


def pose_numbers(
    values: Float[Array, "K k"], name: str, lines: Sequence[int] = ()
) -> tuple[Float[Array, "K 3"], Float[Array, "K 3 3"] | None]:
    """Positions and rotation matrices from 3, 6, 7 or 12 numbers in each row; of 3 numbers the rotation is None.

    These are x y z [m]; x y z roll pitch yaw [rad]; x y z qx qy qz qw; or x y z and the rotation matrix row by row.

    Args:
        values: The numbers.
        name: Their name in the error message.
        lines: Lines of the rows in the file `name`, for the error message.

    Raises:
        InputError: Another count, or no rotation.
    """
    count = values.shape[1]
    if count not in (3, 6, 7, 12):
        raise InputError(
            f"{name} has {count} numbers; a pose is 3 (x y z), 6 (x y z roll pitch yaw), 7 (x y z qx qy qz qw) or 12 "
            "(x y z and the rotation matrix row by row)"
        )
    position, rest = values[:, :3], values[:, 3:]
    if count == 3:
        return position, None
    if count == 6:
        return position, _from_angles(rest, name, lines)
    if count == 7:
        return position, _from_quaternions(rest[:, [3, 0, 1, 2]], name, lines)
    rotation = rest.reshape(-1, 3, 3)
    off = np.abs(rotation.transpose(0, 2, 1) @ rotation - np.eye(3)).max(axis=(1, 2))
    _refuse((off > 1e-6) | (np.linalg.det(rotation) < 0.0), name, lines, "the last nine numbers are no rotation matrix")
    return position, rotation


def from_quaternions(quaternions: Float[Array, "K 4"]) -> Float[Array, "K 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z), which are normalized."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def from_angles(angles: Float[Array, "K 3"]) -> Float[Array, "K 3 3"]:
    """Rotation matrices Rz(yaw) Ry(pitch) Rx(roll) of (roll, pitch, yaw) [rad], the angles of a URDF."""
    roll, pitch, yaw = 0.5 * angles.T
    a, b, c, d, e, f = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return from_quaternions(
        np.stack((a * c * e + b * d * f, b * c * e - a * d * f, a * d * e + b * c * f, a * c * f - b * d * e), axis=1)
    )


def posed(table: Waypoints) -> Waypoints:
    """The same with positions and rotations in the place of 3, 6, 7 or 12 unnamed numbers."""
    assert table.values is not None
    position, rotation = pose_numbers(table.values, str(table.source), table.lines)
    return replace(table, values=None, position=position, axes="".join(POSITION), rotation=rotation)


def _written(text: str) -> Waypoints:
    """Way points that stand in a text."""
    source = Path("the path")
    rows = [row.replace(",", " ").split() for row in text.strip(" ;").split(";")]
    names = tuple(f"z{i + 1}" for i in range(len(rows[0])))
    table = [numbers_of(source, k, cells, names) for k, cells in enumerate(rows, 1)]
    return _named(source, list(range(1, len(rows) + 1)), names, table)


# -- columns ---------------------------------------------------------------------------------------------------------


def _name(cell: str, where: str) -> str:
    """Name of a column as `KNOWN` has it, from any of its spellings."""
    text = cell.strip().lower()
    unit = _UNIT.search(text)
    words = re.split(r"[._/\s]+", text[: unit.start()] if unit else text)
    name = words[-1]
    if len(name) == 1:
        name = next((group for word in words[-2::-1] if (group := _GROUPS.get(word)) is not None), "") + name
    name = _ALIASES.get(name, name)
    known = name in _ALIASES.values() or re.fullmatch(r"z[1-9]\d*", name)
    if not known or not set(words[:-1]) <= _GROUPS.keys():
        raise InputError(f"{where}: no column is named {cell!r}; the columns are {KNOWN}")
    given = unit and (unit["bracket"] or unit["suffix"])
    if given and name in _UNITS and given != _UNITS[name]:
        raise InputError(f"{where}: column {cell!r} must be in {_UNITS[name]}, not in {given}: convert it first")
    return name


def _check_names(names: Sequence[str], where: str) -> None:
    """Refuse columns that do not belong together."""
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise InputError(f"{where}: column {', '.join(twice)} is there more than once")
    for group in (QUATERNION, ANGLES, DIRECTION):
        missing = [name for name in group if name not in names]
        if 0 < len(missing) < len(group):
            have = ", ".join(name for name in group if name in names)
            raise InputError(f"{where}: {have} without {', '.join(missing)}; the columns are {KNOWN}")
    kinds = [group for group in (QUATERNION, ANGLES, DIRECTION, ("heading",)) if group[0] in names]
    if len(kinds) > 1:
        raise InputError(f"{where}: the orientation is given twice, as {' and '.join(', '.join(g) for g in kinds)}")
    coordinates = [name for name in names if re.fullmatch(r"z\d+", name)]
    if coordinates and sorted(coordinates, key=lambda name: int(name[1:])) != [
        f"z{i}" for i in range(1, len(coordinates) + 1)
    ]:
        raise InputError(f"{where}: coordinates of a task are z1 to zm without gaps, got {', '.join(coordinates)}")
    if coordinates and set(names) - {*coordinates, "t"}:
        raise InputError(f"{where}: coordinates z1, …, zm stand alone or beside t; the columns are {KNOWN}")
    if set(names) <= {"t"}:
        raise InputError(f"{where}: a table of way points needs more than the time; the columns are {KNOWN}")


def _named(path: Path, lines: list[int], names: tuple[str, ...], table: list[list[Decimal]]) -> Waypoints:
    """The table by the kind of its columns."""
    columns = dict(zip(names, zip(*table, strict=True), strict=True))

    def block(some: Sequence[str]) -> Array:
        return np.array([[float(value) for value in columns[name]] for name in some]).T

    found: dict[str, Array] = {}
    start = 0.0
    if "t" in columns:
        # Subtracted before they are rounded: the time since 1970 leaves too few digits for an acceleration.
        times, start = columns["t"], float(columns["t"][0])
        found["t"] = np.array([float(time - times[0]) for time in times])
        for k in np.flatnonzero(~(np.diff(found["t"]) > 0.0))[:1]:
            raise InputError(
                f"{path}, line {lines[k + 1]}: the times must increase, got {times[k + 1]} after {times[k]}"
                + (". Without names the first column is the time" if "z1" in names else "")
            )
    axes = "".join(axis for axis in POSITION if axis in columns)
    if axes:
        found["position"] = block(axes)
    if "qw" in columns:
        found["rotation"] = _from_quaternions(block(QUATERNION), str(path), lines)
    if "roll" in columns:
        found["rotation"] = _from_angles(block(ANGLES), str(path), lines)
    if "ax" in columns:
        vectors = block(DIRECTION)
        length = np.linalg.norm(vectors, axis=1)
        _refuse(length < 1e-9, str(path), lines, "the direction ax, ay, az is zero")
        found["direction"] = vectors / length[:, None]
    if "heading" in columns:
        found["heading"] = block(["heading"])[:, 0]
        _check_angles(found["heading"][:, None], str(path), lines)
    coordinates = [f"z{i}" for i in range(1, len(names) + 1) if f"z{i}" in columns]
    if coordinates:
        found["values"] = block(coordinates)
    return Waypoints(
        path, tuple(lines), names, start=start, axes=axes, **{key: frozen_copy(array) for key, array in found.items()}
    )


# -- rotations -------------------------------------------------------------------------------------------------------


def _from_quaternions(quaternions: Float[Array, "K 4"], name: str, lines: Sequence[int]) -> Float[Array, "K 3 3"]:
    norms = np.linalg.norm(quaternions, axis=1)
    wrong = ~(np.abs(norms - 1.0) <= ROUNDED)
    _refuse(wrong, name, lines, f"a quaternion has length 1, to {ROUNDED:g}; this one {norms[wrong.argmax()]:.4g}")
    return from_quaternions(quaternions)


def _from_angles(angles: Float[Array, "K 3"], name: str, lines: Sequence[int]) -> Float[Array, "K 3 3"]:
    _check_angles(angles, name, lines)
    return from_angles(angles)


def _check_angles(angles: Float[Array, "K k"], name: str, lines: Sequence[int]) -> None:
    largest = np.abs(angles).max(axis=1)
    wrong = largest > MOST_ANGLE
    reason = f"an angle of {largest[wrong.argmax()]:g} rad is beyond two turns; if it is in degrees, divide by 57.29578"
    _refuse(wrong, name, lines, reason)


def _refuse(wrong: Bool[Array, " K"], name: str, lines: Sequence[int], reason: str) -> None:
    """Raise an error that names the first wrong row, if there is one."""
    for k in np.flatnonzero(wrong)[:1]:
        raise InputError(f"{name}, line {lines[k]}: {reason}" if lines else f"{name}: {reason}")
