"""A robot as capsules, and its clearance from solids at rest and from itself, for many postures at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, as_floats, by_value, checked, listed, of_type, pair
from eos_pin._kernels.dispatch import kernels
from eos_pin._kernels.distances import segment_to_box, segment_to_segment
from eos_pin._kernels.flat import flat_model
from eos_pin.errors import InputError, RobotError, UnknownNameError
from eos_pin.planning.obstacles.scene import Capsule, Scene, rotation
from eos_pin.robot.model import Robot
from eos_pin.tasks.batch import Placements, ranges

#: Random postures in which pairs of links are tried. A pair that overlaps in more than this part of them is left out,
#: and one of links that are two joints apart where it overlaps in more than the second: capsules are thicker than
#: links.
TRIED, OFTEN, SOMETIMES = 400, 0.8, 0.2
#: Postures that are computed together.
CHUNK = 128


@by_value
@checked
@checked
@dataclass(frozen=True, eq=False)
class Bodies:
    """Capsules that enclose the links of a robot.

    Attributes:
        robot: The robot.
        capsules: Link, and capsule in the link's frame.
        pairs: Pairs of numbers of capsules that may touch each other.
    """

    robot: Robot
    capsules: Sequence[tuple[str, Capsule]]
    pairs: Sequence[tuple[int, int]] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "capsules", tuple(map(_carried, self.capsules)))
        pairs = as_floats(self.pairs, "pairs")
        pairs = pairs if pairs.size else pairs.reshape(0, 2)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or not np.isin(pairs, np.arange(len(self.capsules))).all():
            raise InputError(f"pairs must be numbers of two of {len(self.capsules)} capsules, got {self.pairs!r}")
        object.__setattr__(self, "pairs", tuple(map(tuple, pairs.astype(int).tolist())))
        for link, _ in self.capsules:
            if link not in self.robot.frames:
                raise UnknownNameError("link", link, self.robot.frames)

    @classmethod
    @checked
    def fitted(cls, robot: Robot) -> Bodies:
        """Capsules fitted around the robot's collision shapes, one for each shape.

        Pairs on one link, on links that a joint connects, and those that overlap nearly always are not checked.

        Raises:
            RobotError: The robot has no collision shapes.
        """
        collision = robot.collision
        shapes = list(collision.geometryObjects) if collision is not None else []
        if not shapes:
            raise RobotError(
                f"robot {robot.name!r} has no collision shapes, so its distances are not known. Name the folder of its "
                "meshes, or plan without a scene and without self-collision"
            )
        capsules = []
        for shape in shapes:
            link = robot.model.frames[shape.parentFrame]
            place = link.placement.inverse() * shape.placement
            capsules.append((str(link.name), _around(shape, place)))
        return cls(robot, capsules)._with_pairs(())

    @classmethod
    @checked
    def of(cls, robot: Robot, capsules: Mapping[str, Capsule], unchecked: Iterable[Sequence[str]] = ()) -> Bodies:
        """Capsules given by link.

        Args:
            robot: The robot.
            capsules: Capsule in the frame of each link.
            unchecked: Pairs of links that need no check, with capsules or without. Neighbours among the links named are
                not checked either.
        """
        frames = {name: robot.model.frames[robot.frame_id(name)] for name in capsules}
        names = list(capsules)
        parents = {}
        for name in names:
            i = robot.frame_id(name)
            while True:
                i = robot.model.frames[i].parentFrame
                above = str(robot.model.frames[i].name)
                if i == 0 or above in frames:
                    break
            parents[name] = above
        skipped = {frozenset(map(str, listed(pair, "each of unchecked"))) for pair in unchecked}
        # Lists of such pairs name links without capsules as well.
        for name in sorted(frozenset().union(*skipped) - frames.keys()):
            robot.frame_id(name)
        pairs = [
            (i, j)
            for i, a in enumerate(names)
            for j, b in enumerate(names[:i])
            if frozenset((a, b)) not in skipped and parents[a] != b and parents[b] != a
        ]
        return cls(robot, [(name, capsules[name]) for name in names], pairs)

    def _with_pairs(self, unchecked: Iterable[Sequence[str]]) -> Bodies:
        joints = [int(self.robot.model.frames[self.robot.frame_id(link)].parentJoint) for link, _ in self.capsules]
        parents = self.robot.model.parents
        pairs = [
            (i, j)
            for i in range(len(joints))
            for j in range(i)
            if joints[i] != joints[j] and parents[joints[i]] != joints[j] and parents[joints[j]] != joints[i]
        ]
        if not pairs:
            return self
        lower, upper = ranges(self.robot)
        Q = np.random.default_rng(0).uniform(lower, upper, (TRIED, self.robot.n)).T
        touching = (Clearances(Bodies(self.robot, self.capsules, pairs)).pairs(Q) < 0.0).mean(axis=1)
        kept = []
        for (i, j), often in zip(pairs, touching.tolist(), strict=True):
            shared = set(self.robot.model.supports[joints[i]]) ^ set(self.robot.model.supports[joints[j]])
            if often < (SOMETIMES if len(shared) <= 2 else OFTEN):
                kept.append((i, j))
        return Bodies(self.robot, self.capsules, kept)


class Clearances:
    """Distances of a robot's capsules from solids and from each other.

    Args:
        bodies: The robot's capsules, and which pairs of them count.
        scene: The solids.

    Raises:
        InputError: A link that no joint moves touches a solid.
    """

    def __init__(self, bodies: Bodies, scene: Scene = Scene()) -> None:
        self.bodies, self.scene, robot = bodies, scene, bodies.robot
        self._placements = Placements(robot)
        self._joints, ends, radii = [], [], []
        for link, capsule in bodies.capsules:
            frame = robot.model.frames[robot.frame_id(link)]
            R, p = self._placements.local(frame.parentJoint, frame.placement)
            self._joints.append(int(frame.parentJoint))
            ends.append((R @ np.asarray(capsule.start) + p, R @ np.asarray(capsule.end) + p))
            radii.append(capsule.radius)
        self._ends, self._radii = np.array(ends), np.array(radii)
        moving = [i for i, joint in enumerate(self._joints) if joint]
        self._self = np.array(bodies.pairs, dtype=int).reshape(-1, 2)
        self._boxed = np.array([(i, k) for k in range(len(scene.boxes)) for i in moving], dtype=int).reshape(-1, 2)
        self._capped = np.array([(i, k) for k in range(len(scene.capsules)) for i in moving], dtype=int).reshape(-1, 2)
        self._meshed = [(i, k) for k in range(len(scene.meshes)) for i in moving]
        self._prepare()
        self._check_base()

    def _prepare(self) -> None:
        """Arrays for the compiled kernel, where there is one."""
        boxes, still, model = self.scene.boxes, self.scene.capsules, self.bodies.robot.model
        self._turned = np.array([rotation(box).T for box in boxes]).reshape(-1, 3, 3)
        self._centres = np.array([box.centre for box in boxes]).reshape(-1, 3)
        self._halves = 0.5 * np.array([box.size for box in boxes]).reshape(-1, 3)
        self._still = np.array([(c.start, c.end) for c in still]).reshape(-1, 2, 3)
        self._still_radii = np.array([c.radius for c in still], dtype=float)
        self._chain: Any = None
        flat = flat_model(model)
        if kernels is None or flat is None or model.nv > kernels.LARGEST[0]:
            return
        self._chain = kernels.Chain(*flat[:3], [], [], [], [])
        carried = [flat.carried(model, self.bodies.robot.frame_id(link)) for link, _ in self.bodies.capsules]
        tips = []
        for (_, tip), (_, capsule) in zip(carried, self.bodies.capsules, strict=True):
            R, p = tip[:9].reshape(3, 3), tip[9:]
            tips += [
                np.concatenate((np.eye(3).ravel(), R @ np.asarray(end) + p)) for end in (capsule.start, capsule.end)
            ]
        self._tips = np.array(tips).reshape(-1, 12)
        self._carriers = np.repeat(np.array([joint for joint, _ in carried], dtype=np.int32), 2)

    def __len__(self) -> int:
        return len(self._self) + len(self._boxed) + len(self._capped) + len(self._meshed)

    @cached_property
    def names(self) -> list[tuple[str, str]]:
        """Names of the pair that each row of `pairs` measures."""
        links = [link for link, _ in self.bodies.capsules]
        names = [(links[i], links[j]) for i, j in self._self.tolist()]
        for pairs, solids in ((self._boxed.tolist(), self.scene.boxes), (self._capped.tolist(), self.scene.capsules)):
            names += [(links[i], solids[k].name) for i, k in pairs]
        return names + [(links[i], self.scene.meshes[k].name) for i, k in self._meshed]

    def __call__(self, Q: Float[Array, "n K"]) -> Float[Array, " K"]:
        """Least distance of all in each posture [m]; minus the depth where something overlaps."""
        return self.pairs(Q).min(axis=0, initial=np.inf)

    def pairs(self, Q: Float[Array, "n K"]) -> Float[Array, "pairs K"]:
        """Distance of each pair in each posture [m]."""
        if self._chain is not None:
            return self._compiled(Q)
        # A hundred postures at once stay in the processor's fast memory.
        parts = [Q[:, k : k + CHUNK] for k in range(0, max(Q.shape[1], 1), CHUNK)]
        return np.concatenate([self._distances(*self._segments(part)) for part in parts], axis=1)

    def _compiled(self, Q: Array) -> Array:
        flat = self._chain.links(np.ascontiguousarray(Q.T), self._carriers, self._tips)
        ends = np.ascontiguousarray(flat[:, :, :3])
        pairs = [np.ascontiguousarray(p, dtype=np.int32) for p in (self._self, self._boxed, self._capped)]
        boxes = self._centres, self._turned, self._halves
        rows = kernels.distances(
            ends, self._radii, pairs[0], pairs[1], *boxes, pairs[2], self._still, self._still_radii
        )
        if not self._meshed:
            return rows
        a, b = ends[:, ::2].transpose(2, 1, 0), ends[:, 1::2].transpose(2, 1, 0)
        return np.concatenate((rows, self._from_meshes(a, b)))

    def _segments(self, Q: Array) -> tuple[Array, Array]:
        """Ends of the capsules in the world, (3, capsules, K)."""
        placed = self._placements(Q)
        a, b = np.empty((2, 3, len(self._joints), Q.shape[1]))
        for i, joint in enumerate(self._joints):
            R, p = placed[joint]
            a[:, i], b[:, i] = p + np.matmul(self._ends[i, 0], R), p + np.matmul(self._ends[i, 1], R)
        return a, b

    def _distances(self, a: Array, b: Array) -> Array:
        rows, r = [], self._radii
        if len(self._self):
            i, j = self._self.T
            rows.append(segment_to_segment(a[:, i], b[:, i], a[:, j], b[:, j]) - (r[i] + r[j])[:, None])
        if len(self._boxed):
            i, k = self._boxed.T
            centres, half = self._centres[k].T[:, :, None], self._halves[k].T[:, :, None]
            ends = [np.einsum("pij,jpk->ipk", self._turned[k], x[:, i] - centres) for x in (a, b)]
            rows.append(segment_to_box(ends[0], ends[1], half) - r[i][:, None])
        if len(self._capped):
            i, k = self._capped.T
            still = self._still[k].transpose(1, 2, 0)[:, :, :, None]
            rows.append(segment_to_segment(a[:, i], b[:, i], *still) - (r[i] + self._still_radii[k])[:, None])
        if self._meshed:
            rows.append(self._from_meshes(a, b))
        return np.concatenate(rows) if rows else np.empty((0, a.shape[2]))

    @cached_property
    def _hulls(self) -> list[coal.CollisionGeometry]:
        return [hull(np.asarray(mesh.vertices)) for mesh in self.scene.meshes]

    def _from_meshes(self, a: Array, b: Array) -> Array:
        out = np.empty((len(self._meshed), a.shape[2]))
        request, still = coal.DistanceRequest(), coal.Transform3s()
        for row, (i, k) in enumerate(self._meshed):
            length = float(np.linalg.norm(self._ends[i, 1] - self._ends[i, 0]))
            shape = coal.Capsule(self._radii[i], length)
            for column in range(a.shape[2]):
                start, end = a[:, i, column], b[:, i, column]
                axis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start) if length > 0.0 else None
                turned = np.eye(3) if axis is None else axis.toRotationMatrix()
                place, result = coal.Transform3s(turned, 0.5 * (start + end)), coal.DistanceResult()
                out[row, column] = coal.distance(shape, place, self._hulls[k], still, request, result)
        return out

    def _check_base(self) -> None:
        """Refuse solids that touch bodies at rest."""
        still = [i for i, joint in enumerate(self._joints) if not joint]
        if not still or not len(self.scene):
            return
        fixed = Clearances.__new__(Clearances)
        fixed.__dict__ |= self.__dict__
        fixed._self = np.empty((0, 2), dtype=int)
        for name, count in (("_boxed", self.scene.boxes), ("_capped", self.scene.capsules)):
            setattr(fixed, name, np.array([(i, k) for k in range(len(count)) for i in still], dtype=int).reshape(-1, 2))
        fixed._meshed = [(i, k) for k in range(len(self.scene.meshes)) for i in still]
        rest = np.clip(np.zeros(self.bodies.robot.n), self.bodies.robot.lower, self.bodies.robot.upper)
        distances = fixed.pairs(rest[:, None])[:, 0]
        worst = int(distances.argmin())
        if distances[worst] < 0.0:
            link, solid = fixed.names[worst]
            raise InputError(
                f"{solid!r} of the scene overlaps the link {link!r}, which never moves, by {-distances[worst]:.3g} m: "
                "no motion avoids that. Move or shrink the solid"
            )


def _carried(entry: Any) -> tuple[str, Capsule]:
    """A link and its capsule."""
    link, capsule = pair(entry, "each of capsules")
    return str(link), of_type(capsule, "the capsule of a link", Capsule)


def _around(shape: pin.GeometryObject, place: pin.SE3) -> Capsule:
    """Capsule around a collision shape, in the frame of its link."""
    geometry, name = shape.geometry, str(shape.name)
    if isinstance(geometry, coal.Sphere):
        return Capsule(place.translation, place.translation, geometry.radius, name)
    if isinstance(geometry, (coal.Capsule, coal.Cylinder)):
        half = np.array([0.0, 0.0, geometry.halfLength])
        return Capsule(place.act(-half), place.act(half), geometry.radius, name)
    if isinstance(geometry, coal.Box):
        half = np.asarray(geometry.halfSide)
        points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    elif isinstance(geometry, coal.BVHModelBase):
        points = np.asarray(geometry.vertices()) * 1.0
    elif isinstance(geometry, coal.ConvexBase):
        points = np.asarray(geometry.points()) * 1.0
    else:
        copy = shape.copy()
        copy.geometry.computeLocalAABB()
        box = copy.geometry.aabb_local
        low, high = np.asarray(box.min_), np.asarray(box.max_)
        points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (high - low) + low
    return _fitted(np.array([place.act(p) for p in points]), name)


def _fitted(points: Float[Array, "k 3"], name: str) -> Capsule:
    """A capsule that holds all points, about their longest axis."""
    centre = 0.5 * (points.max(axis=0) + points.min(axis=0))
    best: Capsule | None = None
    for axis in (*np.eye(3), np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]):
        along = (points - centre) @ axis
        across = points - centre - along[:, None] * axis
        shift = 0.5 * (across.max(axis=0) + across.min(axis=0))
        shift = shift - (shift @ axis) * axis
        radius = float(np.linalg.norm(across - shift, axis=1).max())
        # How far each point reaches beyond the ends of the segment inside the round caps.
        cap = np.sqrt(np.maximum(radius**2 - ((across - shift) ** 2).sum(axis=1), 0.0))
        low, high = float((along + cap).min()), float((along - cap).max())
        low, high = (low, high) if low <= high else (0.5 * (low + high),) * 2
        made = Capsule(centre + shift + low * axis, centre + shift + high * axis, radius * (1.0 + 1e-9) + 1e-9, name)
        if best is None or _volume(made) < _volume(best):
            best = made
    assert best is not None
    return best


def _volume(capsule: Capsule) -> float:
    length = float(np.linalg.norm(np.asarray(capsule.end) - np.asarray(capsule.start)))
    return float(np.pi * capsule.radius**2 * (length + 4.0 / 3.0 * capsule.radius))


def hull(points: Array) -> coal.CollisionGeometry:
    """Convex hull of points, (k, 3)."""
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(points), len(points))
    for i in range(len(points)):
        mesh.addTriangle(*(points[(i + k) % len(points)] for k in range(3)))
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex
