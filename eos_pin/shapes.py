"""The shapes of a robot: where its meshes are, and its geometry, read when somebody first looks at it.

Reading the meshes of an arm takes a hundred times longer than building its model, so it waits until a viewer or a
distance needs them. That they exist is checked at once: what is missing is left out, and said.
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
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from eos_pin.errors import RobotError
from eos_pin.library import example_robots
from eos_pin.urdf import Checker

#: The shapes a URDF can have, and how many numbers each of their attributes holds.
SHAPES = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {},
}

_stderr = threading.Lock()


@contextmanager
def quiet() -> Iterator[list[str]]:
    """Catch what C++ libraries write on the error stream, which `sys.stderr` never sees; the list holds it afterwards."""
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
    """Visual and collision geometry of a robot; shared by all its copies.

    Attributes:
        urdf: Text of a URDF in which each mesh has an absolute path, as `resolve_shapes` makes it.
    """

    urdf: str

    @cached_property
    def visual(self) -> pin.GeometryModel:
        """What a person sees."""
        return self._read(pin.GeometryType.VISUAL)

    @cached_property
    def collision(self) -> pin.GeometryModel:
        """What distances are computed from."""
        return self._read(pin.GeometryType.COLLISION)

    def _read(self, kind: pin.GeometryType) -> pin.GeometryModel:
        with quiet():
            model = pin.buildModelFromXML(self.urdf)
            try:
                return pin.buildGeomFromUrdfString(model, self.urdf, kind, package_dirs=[])
            except ValueError:
                # A mesh file is damaged; Pinocchio gives up on all of them, so find out which.
                root, damaged = _without_damaged(self.urdf)
                geometry = pin.buildGeomFromUrdfString(model, root, kind, package_dirs=[])
        warnings.warn(f"meshes that cannot be read are left out: {', '.join(damaged)}", stacklevel=3)
        return geometry

    def __getstate__(self) -> dict[str, Any]:
        # Meshes are read anew where the robot is unpickled, if they are needed there.
        return {"urdf": self.urdf}


def _without_damaged(urdf: str) -> tuple[str, list[str]]:
    """The URDF without the shapes whose mesh cannot be read, and the names of these files."""
    root = etree.fromstring(urdf)
    readable: dict[str, bool] = {}
    for mesh in list(root.iter("mesh")):
        name = mesh.get("filename", "")
        if name not in readable:
            try:
                coal.MeshLoader().load(name, np.ones(3))
                readable[name] = True
            except (ValueError, RuntimeError):
                readable[name] = False
        if not readable[name]:
            shape = mesh.getparent().getparent()
            shape.getparent().remove(shape)
    return etree.tostring(root, encoding="unicode"), [name for name, good in readable.items() if not good]


def resolve_shapes(root: etree._Element, path: Path, package_dirs: Sequence[Path]) -> tuple[str, ...]:
    """Give every mesh under `root` its absolute path, and drop each shape that cannot be used.

    Args:
        root: A `<robot>` element, changed in place.
        path: The URDF file, beside which relative names are looked up.
        package_dirs: Folders that hold packages, or are packages, looked at before all others.

    Returns:
        What was dropped and why, in sentences.
    """
    checker = Checker(path)
    missing: dict[str, int] = {}
    notes: list[str] = []
    materials: set[str] = set()
    for material in root.findall("material"):
        if material.get("name") in materials or not material.get("name"):
            root.remove(material)
        materials.add(material.get("name", ""))
    for texture in list(root.iter("texture")):
        texture.getparent().remove(texture)
    found: dict[str, Path | None] = {}
    for link in root.findall("link"):
        for shape in link.findall("visual") + link.findall("collision"):
            for material in shape.findall("material"):
                if not material.get("name"):
                    shape.remove(material)
            try:
                mesh = _check_shape(checker, shape)
            except RobotError as error:
                notes.append(f"a {shape.tag} shape of link {link.get('name')!r} is left out: {error}")
                link.remove(shape)
                continue
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            if name not in found:
                found[name] = find_mesh(name, path, package_dirs)
            if (file := found[name]) is not None:
                mesh.set("filename", str(file))
            else:
                missing[name] = missing.get(name, 0) + 1
                link.remove(shape)
    if missing:
        looked = ", ".join(str(folder) for folder in package_dirs) or "no package_dirs given"
        notes.append(
            f"{len(missing)} mesh files were not found and are left out ({', '.join(list(missing)[:3])}"
            f"{', ...' if len(missing) > 3 else ''}); looked in package_dirs ({looked}), the folders above {path}, "
            "ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and example-robot-data"
        )
    return tuple(notes)


def _check_shape(checker: Checker, shape: etree._Element) -> etree._Element | None:
    """The mesh of a shape, None if it is another kind, or a `RobotError` if it cannot be read."""
    geometry = shape.find("geometry")
    body = None if geometry is None or not len(geometry) else geometry[0]
    if body is None or body.tag not in SHAPES:
        kind = "no geometry" if body is None else f"a <{body.tag}>"
        raise checker.fail(shape, f"it has {kind}; known are {', '.join(SHAPES)}")
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
    """File that the mesh name of a URDF means, or None.

    Args:
        name: `package://package/file`, `file://...`, an absolute or a relative path.
        urdf: The URDF file it stands in.
        package_dirs: Folders to look in first.
    """
    scheme, _, rest = name.rpartition("://")
    for candidate in _candidates(scheme, rest, urdf, package_dirs):
        try:
            if candidate.is_file():
                return candidate
        except (OSError, ValueError):
            continue
    return _guess(name, urdf)


def _candidates(scheme: str, rest: str, urdf: Path, package_dirs: Sequence[Path]) -> Iterator[Path]:
    if scheme not in ("package", "model"):
        # An absolute name replaces the folder before the slash operator.
        yield from (folder / rest for folder in (urdf.parent, *package_dirs))
        return
    package, _, inside = rest.partition("/")
    for folder in (*package_dirs, *urdf.parents, *_environment()):
        yield folder / rest
        if folder.name == package:
            yield folder / inside


def _environment() -> Iterator[Path]:
    """Folders of packages that are installed, in the order ROS looks at them."""
    for folder in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
        yield Path(folder)
    for folder in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(folder) / "share"
    if (share := example_robots()) is not None:
        yield from (share.parent, share / "robots")


def _guess(name: str, urdf: Path) -> Path | None:
    """What yourdfpy's search finds: it also tries every folder above the URDF without the name of the package."""
    # Imported only here: it takes longer than all of the loading (0.4 s), and most robots never need it.
    from yourdfpy.urdf import filename_handler_magic

    log = logging.getLogger("yourdfpy.urdf")
    before, log.disabled = log.disabled, True
    try:
        file = Path(filename_handler_magic(name, str(urdf.parent)))
        return file if file.is_file() else None
    except (OSError, ValueError, TypeError):
        return None
    finally:
        log.disabled = before
