"""Solids at rest among which a robot moves: boxes, spheres, capsules, meshes, and the files that list them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from eos_pin._arrays import (
    Array,
    VectorLike,
    as_floats,
    by_value,
    checked,
    frozen_copy,
    number,
    vector,
)
from eos_pin.errors import InputError

#: An example of a scene file, for messages and the documentation.
FORMAT = """boxes:
  - {name: table, centre: [0.5, 0, 0.2], size: [0.6, 1, 0.4], rotation: [1, 0, 0, 0]}
spheres:
  - {centre: [0.4, 0.3, 0.6], radius: 0.1}
capsules:
  - {from: [0, 0.5, 0], to: [0, 0.5, 1], radius: 0.05}
meshes:
  - {file: part.stl, centre: [0.5, 0, 0.4], rotation: [1, 0, 0, 0], scale: 0.001}"""


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Box:
    """A box.

    Attributes:
        centre: Its centre in the world [m].
        size: Full lengths of its edges [m].
        rotation: Its axes in the world, as a quaternion w, x, y, z.
        name: Its name.
    """

    centre: VectorLike
    size: VectorLike
    rotation: VectorLike = (1.0, 0.0, 0.0, 0.0)
    name: str = "box"

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", frozen_copy(vector(self.centre, 3, f"the centre of {self.name!r}")))
        object.__setattr__(self, "size", _positive(self.size, f"the size of {self.name!r}"))
        object.__setattr__(self, "rotation", _quaternion(self.rotation, self.name))


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Capsule:
    """All points up to a distance from a line segment; a sphere where its ends are the same.

    Attributes:
        start: One end of the segment [m].
        end: The other end [m].
        radius: Distance [m].
        name: Its name.
    """

    start: VectorLike
    end: VectorLike
    radius: float
    name: str = "capsule"

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen_copy(vector(self.start, 3, f"an end of {self.name!r}")))
        object.__setattr__(self, "end", frozen_copy(vector(self.end, 3, f"an end of {self.name!r}")))
        object.__setattr__(self, "radius", number(self.radius, f"the radius of {self.name!r}", at_least=0.0))


@checked
def sphere(centre: VectorLike, radius: float, name: str = "sphere") -> Capsule:
    """A ball."""
    return Capsule(centre, centre, radius, name)


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh, which counts as its convex hull.

    Attributes:
        vertices: Its corners in the world [m], (k, 3).
        name: Its name.
        file: The file it was read from, if any.
    """

    vertices: Array | Sequence[Sequence[float]]
    name: str = "mesh"
    file: str = ""

    def __post_init__(self) -> None:
        vertices = as_floats(self.vertices, f"the corners of the mesh {self.name!r}")
        if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) < 4 or not np.isfinite(vertices).all():
            raise InputError(
                f"the mesh {self.name!r} must have four corners or more, as rows x, y, z of finite numbers"
            )
        object.__setattr__(self, "vertices", frozen_copy(vertices))


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Scene:
    """Solids at rest.

    Attributes:
        boxes: Boxes.
        capsules: Capsules and spheres.
        meshes: Meshes.
    """

    boxes: Sequence[Box] = ()
    capsules: Sequence[Capsule] = ()
    meshes: Sequence[Mesh] = field(default_factory=tuple)

    def __post_init__(self) -> None:
        for name in ("boxes", "capsules", "meshes"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.boxes) + len(self.capsules) + len(self.meshes)

    @property
    def names(self) -> list[str]:
        """Names of all solids: boxes, capsules, meshes."""
        solids: list[Box | Capsule | Mesh] = [*self.boxes, *self.capsules, *self.meshes]
        return [solid.name for solid in solids]


@checked
def read_scene(path: str | Path) -> Scene:
    """Scene from a YAML or JSON file with lists `boxes`, `spheres`, `capsules`, `meshes`; see `FORMAT`.

    Raises:
        InputError: The file cannot be read, a solid is not described in full, or there is none.
    """
    import yaml

    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        data = json.loads(text) if path.suffix.lower() == ".json" else yaml.safe_load(text)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the scene {path}: {error}") from error
    except (json.JSONDecodeError, yaml.YAMLError) as error:
        raise InputError(
            f"{path} is not a scene: {' '.join(str(error).split())}. A scene is, for example:\n{FORMAT}"
        ) from error
    return scene_from(data, str(path), path.parent)


def scene_from(data: Any, name: str = "the scene", folder: Path = Path()) -> Scene:
    """Scene from lists of plain values.

    Args:
        data: Contents of a scene file.
        name: Name for messages.
        folder: Folder in which the files of meshes are looked for.

    Raises:
        InputError: A solid is not described in full, or there is none.
    """
    kinds = ("boxes", "spheres", "capsules", "meshes")
    if not isinstance(data, Mapping) or not any(data.get(kind) for kind in kinds):
        raise InputError(
            f"{name} has no solids: it needs at least one of the lists {', '.join(kinds)}. Leave the scene out where "
            f"nothing is in the way. A scene is, for example:\n{FORMAT}"
        )
    unknown = sorted(set(data) - set(kinds))
    if unknown:
        raise InputError(f"{name} has the unknown entries {', '.join(map(str, unknown))}; known are {', '.join(kinds)}")
    made: dict[str, list[Any]] = {kind: [] for kind in kinds}
    for kind in kinds:
        for i, words in enumerate(data.get(kind) or (), 1):
            where = f"{name}, {kind} {i}"
            try:
                made[kind].append(_solid(kind, dict(words), f"{kind.removesuffix('s').removesuffix('e')} {i}", folder))
            except InputError as error:
                raise InputError(f"{where}: {error}") from error
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(f"{where} is not described in full ({error}); for example:\n{FORMAT}") from error
    return Scene(made["boxes"], made["spheres"] + made["capsules"], made["meshes"])


def _solid(kind: str, words: dict[str, Any], default: str, folder: Path) -> Box | Capsule | Mesh:
    name = str(words.pop("name", default))
    if kind == "boxes":
        return Box(name=name, **words)
    if kind == "spheres":
        return sphere(words.pop("centre"), words.pop("radius"), name)
    if kind == "capsules":
        return Capsule(words.pop("from"), words.pop("to"), words.pop("radius"), name)
    import trimesh

    file = folder / str(words.pop("file"))
    try:
        loaded = trimesh.load(file, force="mesh")
    except Exception as error:
        raise InputError(f"the mesh {file} cannot be read: {error}") from error
    place = pin.SE3(_matrix(_quaternion(words.pop("rotation", (1.0, 0.0, 0.0, 0.0)), name)), np.zeros(3))
    place.translation = vector(words.pop("centre", (0.0, 0.0, 0.0)), 3, f"the centre of {name!r}")
    scale = number(words.pop("scale", 1.0), f"the scale of {name!r}", above=0.0)
    vertices = scale * np.asarray(loaded.vertices) @ place.rotation.T + place.translation
    return Mesh(vertices, name, str(file))


def rotation(box: Box) -> Array:
    """Axes of a box as the columns of a rotation matrix."""
    return _matrix(np.asarray(box.rotation))


def _matrix(quaternion: Array) -> Array:
    w, x, y, z = quaternion
    return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())


def _positive(values: VectorLike, name: str) -> Array:
    array = vector(values, 3, name)
    if not (array > 0.0).all():
        raise InputError(f"{name} must be positive lengths, got {array.tolist()}")
    return frozen_copy(array)


def _quaternion(values: VectorLike, name: str) -> Array:
    array = vector(values, 4, f"the rotation w, x, y, z of {name!r}")
    length = float(np.linalg.norm(array))
    if abs(length - 1.0) > 1e-3:
        raise InputError(f"the rotation w, x, y, z of {name!r} must have the length 1, it has {length:.6g}")
    return frozen_copy(array / length)
