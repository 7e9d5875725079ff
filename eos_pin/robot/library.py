"""The robots that can be loaded by name: those eos_pin brings, and all of the installed example-robot-data."""

from __future__ import annotations

import importlib.metadata
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from eos_pin.errors import RobotError, UnknownNameError

#: May stand before a name of example-robot-data, to say which library is meant.
PREFIX = "example-robot-data:"

BUNDLED = {
    "ppr": "planar, Sec. 4.3: two sliders and a link; one degree of redundancy",
    "planar_chain_10": "planar, Sec. 6: two sliders and eight links; eight degrees of redundancy",
    "planar_chain_23": "planar: 23 links; twenty degrees of redundancy for position and heading",
}


@dataclass(frozen=True)
class NamedRobot:
    """A robot that `load_robot` finds by name.

    Attributes:
        name: The name to load it by.
        path: Its URDF file.
        description: Kind of robot, or the package it comes from.
    """

    name: str
    path: Path
    description: str


@cache
def available_robots() -> tuple[NamedRobot, ...]:
    """All robots that can be loaded by name; no name occurs twice."""
    return tuple(NamedRobot(name, _bundled(name), text) for name, text in BUNDLED.items()) + _examples()


def example_robots() -> Path | None:
    """Folder of the installed example-robot-data, or None without it."""
    folders = (folder for robot in _examples()[:1] for folder in robot.path.parents)
    return next((folder for folder in folders if folder.name == "example-robot-data"), None)


def find_robot(name: str) -> NamedRobot | None:
    """The robot that goes by `name`, with or without prefix; None if there is none.

    A name may leave out a `_robot` at the end: `ur5` is `ur5_robot`.

    Raises:
        RobotError: Several robots share the name.
        UnknownNameError: The prefix says that it must be there, and it is not.
    """
    short = name.removeprefix(PREFIX)
    known = {robot.name: robot for robot in available_robots() if short == name or robot.name not in BUNDLED}
    for candidate in (short, f"{short}_robot"):
        if candidate in known:
            return known[candidate]
    alike = [robot for robot in known if robot.endswith(f"/{short}")]
    if alike:
        raise RobotError(f"several robots are named {short!r}: {', '.join(alike)}. Write one of these")
    if short != name:
        raise UnknownNameError("robot of example-robot-data", short, known)
    return None


def _bundled(name: str) -> Path:
    """A wheel holds the robots inside the package, a source tree beside it."""
    here = Path(__file__).parent.parent
    inside = here / "robots" / f"{name}.urdf"
    return inside if inside.exists() else here.parent / "robots" / f"{name}.urdf"


@cache
def _examples() -> tuple[NamedRobot, ...]:
    # The wheel has no Python module to ask; its own list of files says what it installed, and where.
    try:
        files = importlib.metadata.distribution("example-robot-data").files or ()
    except importlib.metadata.PackageNotFoundError:
        return ()
    urdfs = [file for file in files if file.suffix == ".urdf" and "robots" in file.parts]
    stems = Counter(file.stem for file in urdfs)
    found = []
    for file in sorted(urdfs, key=lambda file: (file.stem.lower(), file.as_posix())):
        package = file.parts[file.parts.index("robots") + 1]
        shared = stems[file.stem] > 1 or file.stem in BUNDLED
        name = f"{package.removesuffix('_description')}/{file.stem}" if shared else file.stem
        found.append(NamedRobot(name, Path(str(file.locate())), f"example-robot-data, {package}"))
    return tuple(found)
