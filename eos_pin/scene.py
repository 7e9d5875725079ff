"""What the viewer draws: a robot, paths and obstacles, packed as triangles and as bodies that move.

The packed form is one compressed block: a JSON header, then arrays. Vertices are 16-bit fractions of their mesh's
bounding box (a tenth of a millimetre on a link of several metres), equal meshes are stored once, and motion is one
pose per body and frame; that is what keeps a replay small enough to send by mail.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin.arrays import Array, JointVector, Vector, VectorLike, readonly, vector
from eos_pin.errors import InputError, ViewerError
from eos_pin.robot import Robot

#: Red, green, blue, opacity; each from 0 to 1.
Color: TypeAlias = tuple[float, float, float, float]
Triangles: TypeAlias = tuple[Float[np.ndarray, "vertices 3"], Array, Color | None]

#: Neighbouring faces that meet at less than this angle [rad] are shaded as one smooth surface.
SMOOTH = 0.6
#: Points that a drawn path keeps at most.
PATH_POINTS = 2000


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A solid in the robot's way, at rest or moving.

    Attributes:
        shape: Coal geometry in metres: `coal.Sphere(radius)`, `coal.Box(x, y, z)`, `coal.Cylinder(radius, height)`
            about z, `coal.Capsule`, `coal.Ellipsoid`, `coal.Cone`, or a mesh. A disc is a flat cylinder.
        placement: Where it is in the world: a point [m], a `pin.SE3`, or a function of time [s] that returns either.
        name: Name in the legend.
        color: Red, green, blue, opacity; each from 0 to 1.
    """

    shape: coal.CollisionGeometry
    placement: VectorLike | pin.SE3 | Callable[[float], VectorLike | pin.SE3]
    name: str = "obstacle"
    color: Color = (0.80, 0.47, 0.65, 0.9)

    def at(self, t: float) -> pin.SE3:
        """Pose in the world at time `t` [s]."""
        placement = self.placement(t) if callable(self.placement) else self.placement
        if isinstance(placement, pin.SE3):
            return placement
        return pin.SE3(np.eye(3), vector(placement, 3, f"position of {self.name!r}"))


@dataclass(frozen=True, eq=False)
class Scene:
    """What there is to see, apart from how it moves.

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

    def poses(self, t: float, q: JointVector) -> Float[np.ndarray, "bodies 7"]:
        """Position [m] and quaternion (x, y, z, w) of each body: joints in the order of q, then obstacles."""
        model = self.robot.model
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        placements = [data.oMi[i] for i in range(1, model.njoints)] + [o.at(t) for o in self.obstacles]
        return np.array([pin.SE3ToXYZQUAT(placement) for placement in placements])

    def pack(self, t: Vector, q: Float[np.ndarray, "k n"]) -> bytes:
        """The scene and its motion as one compressed block, made for the page in `player.html`.

        Args:
            t: Times of the frames [s], increasing.
            q: Joints at these times [rad or m].
        """
        blocks: list[bytes] = []
        parts = list(self._parts(blocks))
        header = {
            "title": self.title or self.robot.name,
            "caption": self.caption,
            "parts": parts,
            "bodies": self.robot.n + len(self.obstacles),
            "joints": self.robot.n,
            "paths": [{"name": name, "points": _store(blocks, points, "f4")} for name, points in self.paths.items()],
            "traces": [self._trace(name, frame) for name, frame in self.traces.items()],
            "obstacles": [{"name": o.name, "color": o.color[:3]} for o in self.obstacles],
            "times": _store(blocks, t, "f8"),
            "poses": _store(blocks, np.array([self.poses(*frame) for frame in zip(t, q, strict=True)]), "f4"),
        }
        text = json.dumps(header).encode()
        text += b" " * (-(4 + len(text)) % 8)
        return gzip.compress(len(text).to_bytes(4, "little") + text + b"".join(blocks), 9, mtime=0)

    def _trace(self, name: str, frame_name: str) -> dict[str, Any]:
        frame = self.robot.model.frames[self.robot.frame_id(frame_name)]
        return {"name": name, "body": int(frame.parentJoint) - 1, "point": frame.placement.translation.tolist()}

    def _parts(self, blocks: list[bytes]) -> Iterator[dict[str, Any]]:
        """Coloured meshes with the body that carries each; body −1 is the world."""
        stored: dict[object, list[dict[str, Any]]] = {}
        visual = self.robot.visual
        objects = list(visual.geometryObjects) if visual is not None else []
        for item in objects or skeleton(self.robot):
            known = (item.meshPath, tuple(item.meshScale)) if Path(item.meshPath).is_file() else item.name
            if known not in stored:
                stored[known] = [_store_mesh(blocks, piece) for piece in triangles(item)]
            for mesh in stored[known]:
                own = None if item.overrideMaterial else mesh["color"]
                color = own or [float(c) for c in item.meshColor]
                matrix = item.placement.homogeneous.T.ravel().tolist()
                yield {**mesh, "color": color, "body": int(item.parentJoint) - 1, "matrix": matrix}
        for i, obstacle in enumerate(self.obstacles):
            mesh = _store_mesh(blocks, shape_triangles(obstacle.shape))
            yield {**mesh, "color": obstacle.color, "body": self.robot.n + i, "matrix": np.eye(4).ravel().tolist()}


def sampled(
    robot: Robot, t: VectorLike, q: Float[np.ndarray, "k n"], *, rate: float
) -> tuple[Vector, Float[np.ndarray, "frames n"]]:
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


def triangles(item: pin.GeometryObject) -> list[Triangles]:
    """Triangles of one piece of a robot, with the colours of its mesh file where that has any."""
    import trimesh

    if not Path(item.meshPath).is_file():
        return [shape_triangles(item.geometry)]
    try:
        pieces = trimesh.load_scene(item.meshPath, process=False).dump()
    except Exception:  # whatever the file does to its reader, Pinocchio has read it before
        return [shape_triangles(item.geometry)]
    by_color: dict[Color | None, list[Any]] = {}
    for piece in pieces:
        if isinstance(piece, trimesh.Trimesh) and len(piece.faces):
            by_color.setdefault(_own_color(piece), []).append(piece)
    scale = np.asarray(item.meshScale)
    result: list[Triangles] = []
    for color, group in by_color.items():
        offsets = np.cumsum([0] + [len(piece.vertices) for piece in group])
        vertices = np.vstack([piece.vertices for piece in group]) * scale
        faces = np.vstack([piece.faces + offset for piece, offset in zip(group, offsets, strict=False)])
        result.append((*smooth(vertices, faces), color))
    # Readers differ about units and axes of a file; what Pinocchio computes with is what must be seen.
    item.geometry.computeLocalAABB()
    box = item.geometry.aabb_local
    corners = np.vstack([vertices for vertices, _, _ in result]) if result else np.zeros((1, 3))
    if np.abs([corners.min(0) - box.min_, corners.max(0) - box.max_]).max() > 0.05 * np.linalg.norm(box.max_ - box.min_):
        return [shape_triangles(item.geometry)]
    return result


def shape_triangles(shape: coal.CollisionGeometry) -> Triangles:
    """Triangles of a Coal geometry.

    Raises:
        ViewerError: A shape without bounds, such as a half space.
    """
    from trimesh import creation

    if isinstance(shape, coal.Sphere):
        mesh = creation.icosphere(4, shape.radius)
    elif isinstance(shape, coal.Ellipsoid):
        mesh = creation.icosphere(4, 1.0).apply_scale(shape.radii)
    elif isinstance(shape, coal.Box):
        mesh = creation.box(2.0 * shape.halfSide)
    elif isinstance(shape, coal.Cylinder):
        mesh = creation.cylinder(shape.radius, 2.0 * shape.halfLength, sections=64)
    elif isinstance(shape, coal.Capsule):
        mesh = creation.capsule(2.0 * shape.halfLength, shape.radius, count=(32, 32))
    elif isinstance(shape, coal.Cone):
        mesh = creation.cone(shape.radius, 2.0 * shape.halfLength, sections=64)
        mesh.apply_translation([0.0, 0.0, -shape.halfLength])
    elif isinstance(shape, coal.BVHModelBase):
        faces = [list(shape.tri_indices(k)) for k in range(shape.num_tris)]
        return *smooth(shape.vertices(), np.array(faces)), None
    elif isinstance(shape, coal.Convex):
        faces = [list(shape.polygons(k)) for k in range(shape.num_polygons)]
        return *smooth(shape.points(), np.array(faces)), None
    else:
        raise ViewerError(f"a {type(shape).__name__} cannot be drawn; use a sphere, box, cylinder, capsule, cone or mesh")
    return *smooth(mesh.vertices, mesh.faces), None


def smooth(vertices: Array, faces: Array) -> tuple[Array, Array]:
    """Mesh whose vertices are shared across smooth edges only, so that normals by averaging look right."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    shaded = trimesh.graph.smooth_shade(mesh, angle=SMOOTH)
    return np.asarray(shaded.vertices), np.asarray(shaded.faces)


def skeleton(robot: Robot) -> list[pin.GeometryObject]:
    """Bones and joints as simple solids, for a robot whose description has no visual geometry."""
    model = robot.model
    tips = [(f.parentJoint, f.placement.translation) for f in model.frames if f.type == pin.FrameType.BODY]
    bones = [(model.parents[i], model.jointPlacements[i].translation) for i in range(1, model.njoints)] + tips
    thickness = 0.03 * max([float(np.linalg.norm(point)) for _, point in bones] + [1e-3])
    data = model.createData()
    items = []
    for k, (joint, point) in enumerate(bones):
        length = float(np.linalg.norm(point))
        if length > thickness:
            bone = coal.Capsule(thickness, length)
            items.append(_solid(f"bone {k}", joint, bone, along=point, center=0.5 * point, color=(0.55, 0.6, 0.66, 1.0)))
    for i, joint in enumerate(robot.joints, start=1):
        S = data.joints[i].S
        if joint.kind == "prismatic":
            shape, axis = coal.Box(3 * thickness, 3 * thickness, 6 * thickness), S[:3]
        else:
            shape, axis = coal.Cylinder(2 * thickness, 5 * thickness), S[3:]
        items.append(_solid(joint.name, i, shape, along=axis, center=np.zeros(3), color=(0.0, 0.45, 0.7, 1.0)))
    return items


def _solid(
    name: str, joint: int, shape: coal.ShapeBase, *, along: Array, center: Array, color: Color
) -> pin.GeometryObject:
    """Solid whose z axis points along a direction."""
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    return pin.GeometryObject(name, joint, pin.SE3(turn, center), shape, "", np.ones(3), True, np.array(color))


def _own_color(mesh: Any) -> Color | None:
    """Colour that a mesh file gives to a piece, averaged over a texture; None if the file says nothing."""
    if not mesh.visual.defined:
        return None
    if mesh.visual.kind == "texture":
        rgba = mesh.visual.material.main_color
        if (image := getattr(mesh.visual.material, "image", None)) is not None:
            rgba = np.asarray(image.convert("RGBA").resize((1, 1)))[0, 0]
    else:
        rgba = mesh.visual.main_color
    red, green, blue, opacity = (round(float(c) / 255.0, 3) for c in rgba)
    return red, green, blue, opacity


def _path(name: str, points: Array) -> Array:
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
        raise InputError(f"path {name!r} must be finite points of shape (k, 3), got shape {points.shape}")
    return readonly(points[:: -(-len(points) // PATH_POINTS)])


def _store(blocks: list[bytes], values: Array, kind: str) -> dict[str, Any]:
    """Append an array to the binary part; says where it is, in bytes from the end of the header."""
    array = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    start = sum(map(len, blocks))
    data = array.tobytes()
    blocks.append(data + b"\0" * (-len(data) % 8))
    return {"kind": kind, "start": start, "count": array.size}


def _store_mesh(blocks: list[bytes], mesh: Triangles) -> dict[str, Any]:
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
