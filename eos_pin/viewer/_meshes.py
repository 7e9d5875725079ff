"""Triangles to draw: of a robot's mesh files, of Coal's solids, and of a skeleton where a robot has neither.

trimesh reads the files, since Pinocchio keeps their triangles but not their colours. It is imported where it is used:
that takes longer than a whole run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from eos_pin._arrays import Array
from eos_pin.errors import ViewerError
from eos_pin.robot._coordinates import screw
from eos_pin.robot.model import Robot

#: Red, green, blue, opacity; each from 0 to 1.
Color: TypeAlias = tuple[float, float, float, float]

#: Neighbouring faces that meet at less than this angle [rad] are shaded as one smooth surface.
SMOOTH = 0.6
#: Two readers of one mesh file agree if their bounding boxes do, up to this part of its diagonal.
SAME_BOX = 0.05
BONE: Color = (0.55, 0.6, 0.66, 1.0)
JOINT: Color = (0.0, 0.45, 0.7, 1.0)


class Mesh(NamedTuple):
    """Triangles of one colour.

    Attributes:
        vertices: Corners [m]; one that lies on a sharp edge is there once for each side.
        faces: Three indices of vertices each.
        color: Colour, or None if the source states none.
    """

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    color: Color | None


def link_meshes(item: pin.GeometryObject) -> list[Mesh]:
    """Meshes of one piece of a robot, in the colours of its mesh file where that has any."""
    if file := mesh_file(item):
        meshes = _file_meshes(file, np.asarray(item.meshScale))
        # Readers differ about units and axes; what Pinocchio computes with is what must be seen.
        item.geometry.computeLocalAABB()
        box = np.array([item.geometry.aabb_local.min_, item.geometry.aabb_local.max_])
        if meshes:
            corners = np.vstack([mesh.vertices for mesh in meshes])
            difference = np.abs(box - [corners.min(axis=0), corners.max(axis=0)]).max()
            if difference < SAME_BOX * np.linalg.norm(box[1] - box[0]):
                return meshes
    return [solid_mesh(item.geometry)]


def mesh_file(item: pin.GeometryObject) -> str:
    """Path of its mesh file; empty for a solid, which Pinocchio gives a path such as `BOX`."""
    is_mesh = not isinstance(item.geometry, coal.ShapeBase) and Path(item.meshPath).is_file()
    return str(item.meshPath) if is_mesh else ""


def _file_meshes(path: str, scale: Array) -> list[Mesh]:
    """One mesh for each colour in a file; none if the file cannot be read."""
    import trimesh

    try:
        pieces = trimesh.load_scene(path, process=False).dump()
    except Exception:  # many readers, each with errors of its own; Pinocchio has read the file, too
        return []
    by_color: dict[Color | None, list[Any]] = {}
    for piece in pieces:
        if isinstance(piece, trimesh.Trimesh) and len(piece.faces):
            by_color.setdefault(_own_color(piece), []).append(piece)
    meshes = []
    for color, group in by_color.items():
        offsets = np.cumsum([0] + [len(piece.vertices) for piece in group[:-1]])
        vertices = np.vstack([piece.vertices for piece in group]) * scale
        faces = np.vstack([piece.faces + offset for piece, offset in zip(group, offsets, strict=True)])
        meshes.append(_smooth(vertices, faces, color))
    return meshes


def solid_mesh(shape: coal.CollisionGeometry) -> Mesh:
    """Mesh of a Coal geometry.

    Raises:
        ViewerError: A shape without bounds, such as a half space.
    """
    from trimesh import creation

    if isinstance(shape, coal.Sphere):
        mesh = creation.icosphere(3, shape.radius)
    elif isinstance(shape, coal.Ellipsoid):
        mesh = creation.icosphere(3, 1.0).apply_scale(shape.radii)
    elif isinstance(shape, coal.Box):
        mesh = creation.box(2.0 * shape.halfSide)
    elif isinstance(shape, coal.Cylinder):
        mesh = creation.cylinder(shape.radius, 2.0 * shape.halfLength, sections=48)
    elif isinstance(shape, coal.Capsule):
        mesh = creation.capsule(2.0 * shape.halfLength, shape.radius, count=(24, 24))
    elif isinstance(shape, coal.Cone):
        mesh = creation.cone(shape.radius, 2.0 * shape.halfLength, sections=48)
        mesh.apply_translation([0.0, 0.0, -shape.halfLength])
    elif isinstance(shape, coal.BVHModelBase):
        return _smooth(shape.vertices(), _corners(shape.tri_indices, shape.num_tris))
    elif isinstance(shape, coal.Convex):
        return _smooth(shape.points(), _corners(shape.polygons, shape.num_polygons))
    else:
        kind = type(shape).__name__
        raise ViewerError(f"a {kind} cannot be drawn; use a sphere, ellipsoid, box, cylinder, capsule, cone or mesh")
    return _smooth(mesh.vertices, mesh.faces)


def _corners(triangle: Callable[[int], Any], count: int) -> Array:
    # Coal's triangles have no length, so NumPy cannot read them.
    return np.array([[corner[0], corner[1], corner[2]] for corner in map(triangle, range(count))])


def _smooth(vertices: Array, faces: Array, color: Color | None = None) -> Mesh:
    """Mesh whose faces share vertices across smooth edges only, so that averaged normals look right."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    shaded = trimesh.graph.smooth_shade(mesh, angle=SMOOTH)
    return Mesh(np.asarray(shaded.vertices), np.asarray(shaded.faces), color)


def skeleton(robot: Robot) -> list[pin.GeometryObject]:
    """Bones and joints as simple solids, for a robot whose description has no visual geometry."""
    model = robot.model
    tips = [(f.parentJoint, f.placement.translation) for f in model.frames if f.type == pin.FrameType.BODY]
    bones = [(model.parents[i], model.jointPlacements[i].translation) for i in range(1, model.njoints)] + tips
    thickness = 0.03 * max([float(np.linalg.norm(point)) for _, point in bones] + [1e-3])
    items = []
    for k, (joint, point) in enumerate(bones):
        length = float(np.linalg.norm(point))
        if length > thickness:
            bone = coal.Capsule(thickness, length)
            items.append(_solid(f"bone {k}", joint, bone, along=point, center=0.5 * point, color=BONE))
    for i in range(1, model.njoints):
        S = screw(model, i)
        if robot.coordinates.slides[i]:
            shape, axis = coal.Box(3 * thickness, 3 * thickness, 6 * thickness), S[:3]
        else:
            shape, axis = coal.Cylinder(2 * thickness, 5 * thickness), S[3:]
        items.append(_solid(str(model.names[i]), i, shape, along=axis, center=np.zeros(3), color=JOINT))
    return items


def _solid(
    name: str, joint: int, shape: coal.ShapeBase, *, along: Array, center: Array, color: Color
) -> pin.GeometryObject:
    """Solid whose z axis points along a direction."""
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    return pin.GeometryObject(name, joint, pin.SE3(turn, center), shape, "", np.ones(3), True, np.array(color))


def _own_color(mesh: Any) -> Color | None:
    """Colour that a mesh file gives to a piece, averaged over a texture; None if the file has none."""
    if not mesh.visual.defined:
        return None
    if mesh.visual.kind == "texture":
        rgba = mesh.visual.material.main_color
        if (image := getattr(mesh.visual.material, "image", None)) is not None:
            rgba = np.asarray(image.convert("RGBA").resize((1, 1)))[0, 0]
    else:
        rgba = mesh.visual.main_color
    red, green, blue, opacity = (round(float(c) / 255.0, 3) for c in rgba)
    # COLLADA has two opposite conventions for opacity; nobody draws a link that cannot be seen.
    return red, green, blue, opacity or 1.0
