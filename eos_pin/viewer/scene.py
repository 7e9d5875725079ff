"""Scenes that the viewer draws: a robot, paths and obstacles, packed as triangles and as bodies that move.

The packed form is one compressed block: a JSON header, then arrays. Vertices are 16-bit fractions of their mesh's
bounding box (a tenth of a millimetre on a link of several metres), equal meshes are stored once, and motion is one
pose per body and frame; that is what keeps a replay small enough to send by mail.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    Vector,
    VectorLike,
    by_value,
    checked,
    frozen_copy,
    vector,
)
from eos_pin.errors import InputError
from eos_pin.planning.obstacles.clearance import Obstacle
from eos_pin.robot._data import workspace
from eos_pin.robot.model import Robot
from eos_pin.viewer._meshes import (
    Mesh,
    link_meshes,
    mesh_file,
    skeleton,
    solid_mesh,
)

#: Points that a drawn path keeps at most.
PATH_POINTS = 2000


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Scene:
    """Robot, paths and obstacles in view, without their motion.

    Attributes:
        robot: The robot, drawn by its visual geometry, or as a skeleton of its joints if it has none.
        paths: Curves in the world [m] by name, drawn as they are; such as the task's reference.
        traces: Frames of the robot whose origin leaves a line as it moves, by the line's name; such as the actual path.
        obstacles: Solids.
        title: Heading.
        caption: A sentence or two below it.

    Raises:
        InputError: A path is not a finite (k, 3) array.
        UnknownNameError: The robot has no frame of a name in `traces`.
    """

    robot: Robot
    paths: Mapping[str, Float[np.ndarray, "k 3"]] = field(default_factory=dict)
    traces: Mapping[str, str] = field(default_factory=dict)
    obstacles: tuple[Obstacle, ...] = ()
    title: str = ""
    caption: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "paths", {name: _path(name, points) for name, points in self.paths.items()})
        for frame in self.traces.values():
            self.robot.frame_id(frame)

    @checked
    def poses(self, t: float, q: JointVector) -> Float[np.ndarray, "bodies 7"]:
        """Position [m] and quaternion (x, y, z, w) of each body: those that joints move, then obstacles."""
        model = self.robot.model
        data = workspace(model)
        pin.forwardKinematics(model, data, q)
        placements = [data.oMi[i] for i in range(1, model.njoints)] + [o.at(t) for o in self.obstacles]
        return np.array([pin.SE3ToXYZQUAT(placement) for placement in placements])

    @property
    def _links(self) -> int:
        """Number of bodies that joints move, with those of joints that follow others."""
        return int(self.robot.model.njoints) - 1

    @checked
    def pack(self, t: Vector, q: Float[np.ndarray, "k n"]) -> bytes:
        """The scene and its motion as one compressed block, made for the page in `player.html`.

        Args:
            t: Times of the frames [s], increasing.
            q: Joints at these times [rad or m].
        """
        return packed(t, [Placed(self, q)], title=self.title or self.robot.name, caption=self.caption)

    def _parts(self, blocks: list[bytes], stored: dict[object, list[dict[str, Any]]]) -> Iterator[_Part]:
        """Coloured meshes with the body that carries each; those of mesh files are stored once."""
        visual = self.robot.visual
        objects = list(visual.geometryObjects) if visual is not None else []
        for item in objects or skeleton(self.robot):
            file = mesh_file(item)
            known = (file, tuple(item.meshScale)) if file else (id(self), item.name)
            if known not in stored:
                stored[known] = [_store_mesh(blocks, piece) for piece in link_meshes(item)]
            for mesh in stored[known]:
                own = None if item.overrideMaterial else mesh["color"]
                color = own or [float(c) for c in item.meshColor]
                yield _Part({**mesh, "color": color}, int(item.parentJoint) - 1, item.placement.homogeneous)
        for i, obstacle in enumerate(self.obstacles):
            mesh = _store_mesh(blocks, solid_mesh(obstacle.shape))
            yield _Part({**mesh, "color": obstacle.color}, self._links + i, np.eye(4))


class _Part(NamedTuple):
    """A coloured mesh, the number of the body that carries it, −1 for the world, and its placement on that."""

    mesh: dict[str, Any]
    body: int
    placement: Float[Array, "4 4"]


class Placed(NamedTuple):
    """A scene and its motion, somewhere in a picture.

    Attributes:
        scene: The scene.
        q: Joints at the times of the picture [rad or m], (K, n).
        offset: Where its origin stands when the robots stand beside each other [m].
        label: A word or two that stand below it then.
        color: Colour of its curves as #rrggbb, where there are several runs; a ghost is tinted with it.
        ghost: Whether it is drawn so that others are seen through it.
    """

    scene: Scene
    q: Float[np.ndarray, "K n"]
    offset: Vector = np.zeros(3)
    label: str = ""
    color: str = ""
    ghost: bool = False


def packed(
    t: Vector, shown: Sequence[Placed], *, title: str, caption: str, more: Mapping[str, Any] | None = None
) -> bytes:
    """Scenes and their motions in one picture as one compressed block, made for the page in `player.html`.

    Args:
        t: Times of the frames [s], increasing.
        shown: Scenes.
        title: Heading.
        caption: Sentences below it.
        more: Values that scripts of the page ask for, plain ones and arrays.
    """
    joints = sum(each.scene._links for each in shown)
    blocks: list[bytes] = []
    stored: dict[object, list[dict[str, Any]]] = {}
    names = ("robots", "parts", "paths", "traces", "obstacles")
    head: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    links: list[Array] = []
    solids: list[Array] = []
    for k, (scene, q, offset, label, color, ghost) in enumerate(shown):
        if len(t) != len(q):
            raise InputError(f"joints are needed for each of {len(t)} times, got {len(q)} rows")
        # The page counts the links of all robots first, then all obstacles.
        own, first, later = scene._links, sum(x.shape[1] for x in links), joints + len(head["obstacles"])

        def number(body: int, own: int = own, first: int = first, later: int = later) -> int:
            return body if body < 0 else first + body if body < own else later + body - own

        head["robots"].append({"label": label, "offset": list(offset), "color": color, "ghost": ghost})
        head["robots"][-1] |= {"links": [first, own], "solids": [later, len(scene.obstacles)]}
        for mesh, body, placement in scene._parts(blocks, stored):
            place = {"robot": k, "body": number(body), "matrix": placement.T.ravel().tolist()}
            head["parts"].append({**mesh, **place})
        for name, points in scene.paths.items():
            head["paths"].append({"robot": k, "name": name, "points": _store(blocks, points, "f4")})
        for name, frame_name in scene.traces.items():
            frame = scene.robot.model.frames[scene.robot.frame_id(frame_name)]
            point = {"body": number(int(frame.parentJoint) - 1), "point": frame.placement.translation.tolist()}
            head["traces"].append({"robot": k, "name": name, **point})
        head["obstacles"] += [{"name": o.name, "color": o.color[:3]} for o in scene.obstacles]
        poses = np.array([scene.poses(*frame) for frame in zip(t, q, strict=True)])
        links.append(poses[:, :own])
        solids.append(poses[:, own:])
    header = {
        "title": title,
        "caption": caption,
        "bodies": joints + len(head["obstacles"]),
        "joints": joints,
        **head,
        **(more or {}),
        "times": _store(blocks, t, "f8"),
        "poses": _store(blocks, np.concatenate((*links, *solids), axis=1), "f4"),
    }
    text = json.dumps(header, default=lambda array: _store(blocks, array, array.dtype.str[1:])).encode()
    text += b" " * (-(4 + len(text)) % 8)
    return gzip.compress(len(text).to_bytes(4, "little") + text + b"".join(blocks), 9, mtime=0)


def sampled(
    robot: Robot, t: VectorLike, q: Float[np.ndarray, "k n"], *, rate: float
) -> tuple[Float[np.ndarray, " frames"], Float[np.ndarray, "frames n"]]:
    """Motion at evenly spaced times, at least `rate` a second, first and last instant included.

    Raises:
        InputError: Times do not increase, or shapes do not fit.
    """
    t = vector(t, None, "t")
    q = np.asarray(q, dtype=float)
    if q.shape != (t.size, robot.n) or t.size == 0 or not np.isfinite(q).all():
        raise InputError(
            f"q must hold {robot.n} finite joint values for each of the {t.size} times in t; got shape {q.shape}"
        )
    if (np.diff(t) < 0.0).any():
        raise InputError("t must not decrease")
    frames = np.linspace(t[0], t[-1], int(np.ceil((t[-1] - t[0]) * rate)) + 1)
    return frames, np.column_stack([np.interp(frames, t, column) for column in q.T])


def _path(name: str, points: Array) -> Array:
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
        raise InputError(f"path {name!r} must be finite points of shape (k, 3), got shape {points.shape}")
    kept = np.linspace(0, len(points) - 1, min(len(points), PATH_POINTS)).astype(int)
    return frozen_copy(points[kept])


def _store(blocks: list[bytes], values: Array, kind: str) -> dict[str, Any]:
    """Append an array to the binary part; its place is returned in bytes from the end of the header."""
    array = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    start = sum(map(len, blocks))
    data = array.tobytes()
    blocks.append(data + b"\0" * (-len(data) % 8))
    return {"kind": kind, "start": start, "count": array.size}


def _store_mesh(blocks: list[bytes], mesh: Mesh) -> dict[str, Any]:
    vertices, faces, color = mesh
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    return {
        "low": low.tolist(),
        "size": size.tolist(),
        "vertices": _store(blocks, np.round((vertices - low) / size * 65535.0), "u2"),
        "faces": _store(blocks, faces, "u2" if len(vertices) < 65536 else "u4"),
        "color": color,
    }
