"""Files of results: arrays and a header in JSON in one `.npz`; files of earlier versions are read as well."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import IO, Any

import numpy as np

from eos_pin._arrays import Array
from eos_pin._files import write_atomically
from eos_pin.errors import ResultError

#: Written into every file; a file with another one than these two is refused.
FORMAT, BEFORE = "eos_pin result 3", "eos_pin result 2"
#: Names that arrays had in files of 0.1.
_OLD_NAMES = {"given_up": "task_deficit", "given_up_to_limits": "deficit_from_limits"}


def write(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write a file; one that was there is replaced at once or not at all.

    Raises:
        OutputError: The file cannot be written.
    """
    text = json.dumps({"format": FORMAT, **header})

    def fill(file: IO[bytes]) -> None:
        np.savez_compressed(file, allow_pickle=False, header=np.array(text), **arrays)

    write_atomically(path, fill)


def read(path: Path, names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Header and arrays of a file, in the form of this version; nothing in it is executed.

    Args:
        path: The file.
        names: Names of the arrays.

    Raises:
        ResultError: The file is of no version that can be read.
    """
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        found = header.get("format")
        if found not in (FORMAT, BEFORE):
            raise ResultError(f"{path} has format {found!r}, this version reads {BEFORE!r} and {FORMAT!r}")
        old = {new: name for name, new in _OLD_NAMES.items() if found == BEFORE and name in file}
        # Files of before have no errors of a further task.
        arrays = {name: file[old.get(name, name)] for name in names if name != "further_error" or name in file}
    if found == BEFORE:
        header["names"] = _names(header.get("info", {}).get("task") or {})
    return header, arrays


def _names(task: Mapping[str, Any]) -> dict[str, Any]:
    """Labels, units and frame of a task from its description, for files that do not have them.

    A task of a kind that 0.1 did not have keeps no units.
    """
    if task.get("kind") == "stacked":
        parts = [_names(part) for part in task["tasks"]]
        labels = [label for part in parts for label in part["labels"]]
        if len(set(labels)) < len(labels):
            labels = [f"{label}{i}" for i, part in enumerate(parts, 1) for label in part["labels"]]
        return parts[0] | {"labels": labels, "units": [unit for part in parts for unit in part["units"]]}
    axes = "xyz" if task.get("kind") == "pose" else task.get("axes", "")
    turns = {"orientation": ["rx", "ry", "rz"], "pose": ["rx", "ry", "rz"], "heading": ["heading"]}
    turning = turns.get(task.get("kind", ""), [])
    return {
        "labels": [*axes, *turning],
        "units": ["m"] * len(axes) + ["rad"] * len(turning),
        "frame": task.get("frame", ""),
        "axes": axes,
        "seen_from": task.get("reference", ""),
    }


def provenance() -> dict[str, Any]:
    """Versions that a run depends on."""
    return {"versions": dict(_versions()), "python": platform.python_version(), "platform": sys.platform}


@cache
def _versions() -> dict[str, str]:
    versions = {}
    for name in ("eos-pin", "pin", "numpy", "scipy"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "unknown"
    return versions
