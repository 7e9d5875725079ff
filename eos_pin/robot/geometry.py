"""The shapes of a robot: where its meshes are, and its geometry, read at the first use.

Reading the meshes of an arm takes a hundred times longer than building its model, so it waits until a viewer or a
distance needs them. Whether they exist is checked at once: missing parts are left out, with a note.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from eos_pin.errors import RobotError
from eos_pin.robot.library import example_robots
from eos_pin.robot.reading.checking import Checker

#: The shapes a URDF can have, and how many numbers each of their attributes holds.
SHAPES: dict[str, dict[str, int]] = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {},
}

_stderr = threading.Lock()


@contextmanager
def quiet() -> Iterator[list[str]]:
    """Catch output of C++ libraries on the error stream; `sys.stderr` never sees it. The list holds it after."""
    said: list[str] = []
    with _stderr, tempfile.TemporaryFile() as file:
        if sys.stderr is not None:
            sys.stderr.flush()
        before = os.dup(2)
        try:
            os.dup2(file.fileno(), 2)
            yield said
        finally:
            os.dup2(before, 2)
            os.close(before)
            file.seek(0)
            said.append(file.read().decode(errors="replace").strip())


@dataclass(frozen=True, eq=False)
class Shapes:
    """Visual and collision geometry of a robot; all its copies share it.

    Attributes:
        urdf: Text of a URDF in which each mesh has an absolute path, as `resolve_shapes` makes it.
    """

    urdf: str = field(repr=False)

    @cached_property
    def visual(self) -> pin.GeometryModel:
        """Visual geometry."""
        return self._read(pin.GeometryType.VISUAL)

    @cached_property
    def collision(self) -> pin.GeometryModel:
        """Collision geometry."""
        return self._read(pin.GeometryType.COLLISION)

    def _read(self, kind: pin.GeometryType) -> pin.GeometryModel:
        with quiet():
            model = pin.buildModelFromXML(self.urdf)
            try:
                return pin.buildGeomFromUrdfString(model, self.urdf, kind, package_dirs=[])
            except ValueError:
                # One damaged mesh makes Pinocchio give up on all, so find out which it is.
                urdf, damaged = _without_damaged(self.urdf)
                geometry = pin.buildGeomFromUrdfString(model, urdf, kind, package_dirs=[])
        warnings.warn(f"left out meshes that cannot be read: {', '.join(damaged)}", stacklevel=4)
        return geometry

    def __getstate__(self) -> dict[str, Any]:
        # Where the robot is unpickled, meshes are read anew when they are needed.
        return {"urdf": self.urdf}


def _without_damaged(urdf: str) -> tuple[str, list[str]]:
    """The URDF without the shapes whose mesh file cannot be read, and these files."""
    root = etree.fromstring(urdf)
    _reference: dict[str, bool] = {}
    for mesh in list(root.iter("mesh")):
        file = str(mesh.get("filename"))
        if file not in _reference:
            try:
                coal.MeshLoader().load(file, np.ones(3))
                _reference[file] = True
            except (ValueError, RuntimeError):
                _reference[file] = False
        if not _reference[file]:
            shape = mesh.getparent().getparent()
            shape.getparent().remove(shape)
    return etree.tostring(root, encoding="unicode"), [file for file, good in _reference.items() if not good]


def resolve_shapes(root: etree._Element, path: Path, package_dirs: Sequence[Path]) -> tuple[str, ...]:
    """Give every mesh under `root` its absolute path, and drop each shape that cannot be used.

    Args:
        root: A `<robot>` element, changed in place.
        path: The URDF file, beside which relative names are looked up.
        package_dirs: Folders that hold packages, or are packages, looked at before all others.

    Returns:
        What was dropped and why, in sentences.
    """
    _tidy_materials(root)
    checker = Checker(path)
    notes: list[str] = []
    files: dict[str, Path | None] = {}
    for link in root.findall("link"):
        for shape in link.findall("visual") + link.findall("collision"):
            try:
                mesh = _mesh_of(shape, checker)
            except RobotError as error:
                notes.append(f"a {shape.tag} of link {link.get('name')!r} is left out: {error}")
                link.remove(shape)
                continue
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            if name not in files:
                files[name] = find_mesh(name, path, package_dirs)
            if files[name] is None:
                link.remove(shape)
            else:
                mesh.set("filename", os.path.abspath(str(files[name])))
    missing = [name for name, file in files.items() if file is None]
    if missing:
        first = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        given = ", ".join(map(str, package_dirs)) or "none given"
        notes.append(
            f"{len(missing)} mesh files were not found and are left out ({first}); looked in package_dirs ({given}), "
            f"the folders above {path}, ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and example-robot-data"
        )
    return tuple(notes)


def _tidy_materials(root: etree._Element) -> None:
    """Drop elements that make the parser refuse a link or file: nameless or repeated materials, textures."""
    names: set[str] = set()
    for material in list(root.iter("material")):
        name, parent = material.get("name"), material.getparent()
        if not name or (parent is root and name in names):
            parent.remove(material)
        elif parent is root:
            names.add(name)
    etree.strip_elements(root, "texture", with_tail=False)


def _mesh_of(shape: etree._Element, checker: Checker) -> etree._Element | None:
    """The mesh of a `<visual>` or `<collision>`; None if it is another shape, `RobotError` if it is none."""
    geometry = shape.find("geometry")
    body = geometry[0] if geometry is not None and len(geometry) else shape
    if body.tag not in SHAPES:
        raise checker.fail(body, f"its geometry is none of {', '.join(SHAPES)}")
    checker.origin(shape)
    for key, count in SHAPES[body.tag].items():
        if min(checker.numbers(body, key, count)) <= 0.0:
            raise checker.fail(body, f"its {key} is not positive")
    if "scale" in body.attrib:
        checker.numbers(body, "scale", 3)
    for color in shape.iter("color"):
        checker.numbers(color, "rgba", 4)
    return body if body.tag == "mesh" else None


def find_mesh(name: str, urdf: Path, package_dirs: Sequence[Path]) -> Path | None:
    """File that the name of a mesh means, or None.

    Args:
        name: `package://package/file`, `file://...`, or an absolute or relative path.
        urdf: The URDF file it stands in.
        package_dirs: Folders to look in first.
    """
    scheme, _, rest = name.rpartition("://")
    # Unlike Path.is_file, os.path.isfile takes a folder that may not be read, or an impossible name, for a no.
    found = (path for path in _candidates(scheme, rest, urdf, package_dirs) if os.path.isfile(path))
    return next(found, None) or _guess(name, urdf)


def _candidates(scheme: str, rest: str, urdf: Path, package_dirs: Sequence[Path]) -> Iterator[Path]:
    if scheme not in ("package", "model"):
        # Joined to a folder, an absolute path stays itself.
        yield from (folder / rest for folder in (urdf.parent, *package_dirs))
        return
    package, _, inside = rest.partition("/")
    for folder in (*package_dirs, *urdf.parents, *_installed()):
        yield folder / rest
        if folder.name == package:
            yield folder / inside


def _installed() -> Iterator[Path]:
    """Folders that hold installed packages: of ROS 1, of ROS 2, of example-robot-data."""
    for variable, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for folder in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(folder, below)
    if (examples := example_robots()) is not None:
        yield from (examples.parent, examples / "robots")


def _guess(name: str, urdf: Path) -> Path | None:
    """Result of the search of yourdfpy: it tries all folders above the URDF without the package's name, too."""
    # Imported here only: it takes 0.4 s, far more than all the rest of loading, and few robots need it.
    from yourdfpy.urdf import filename_handler_magic

    log = logging.getLogger("yourdfpy.urdf")
    was_disabled, log.disabled = log.disabled, True
    try:
        file = filename_handler_magic(name, str(urdf.parent))
        return Path(file) if os.path.isfile(file) else None
    except (OSError, ValueError, TypeError):
        return None
    finally:
        log.disabled = was_disabled
