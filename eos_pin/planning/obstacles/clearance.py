"""Distances between the bodies of a robot and obstacles, at rest or moving, and their derivatives by the joints.

Bodies have the collision shapes of their links. A mesh counts as its convex hull, so that distances are never too
large, have a slope almost everywhere, and go on to negative values where shapes overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    VectorLike,
    by_value,
    called,
    checked,
    number,
    vector,
)
from eos_pin.errors import InputError, Renamed, RobotError, UnknownNameError, renamed
from eos_pin.robot._data import workspace
from eos_pin.robot.model import Robot
from eos_pin.tasks._flat import checked_pose

#: Where an obstacle is: a point of the world [m], a pose, or either as a function of time [s].
Placement: TypeAlias = "VectorLike | pin.SE3 | Callable[[float], VectorLike | pin.SE3]"

#: Accuracy of distances between curved shapes that do not overlap; Coal's own 1e-6 m is too coarse for their slopes.
ACCURACY = 1e-9

#: A mesh whose thickness is a smaller part of its length counts as flat.
FLAT = 1e-6


@checked
@dataclass(frozen=True, eq=False)
class Obstacle:
    """A solid in the robot's way, at rest or moving.

    Attributes:
        shape: Coal geometry in metres: `coal.Sphere(radius)`, `coal.Box(x, y, z)`, `coal.Cylinder(radius, height)`
            about z, `coal.Capsule`, `coal.Ellipsoid`, `coal.Cone`, or a mesh. A disc is a flat cylinder.
        placement: Where it is in the world: a point [m], a `pin.SE3`, a 4 × 4 matrix, or a function of time [s] that
            returns one of them.
        name: Name in the legend.
        color: Red, green, blue, opacity; each from 0 to 1.
    """

    shape: coal.CollisionGeometry
    placement: Placement
    name: str = "obstacle"
    color: tuple[float, float, float, float] = (0.80, 0.47, 0.65, 0.9)

    @checked
    def at(self, t: float) -> pin.SE3:
        """Pose in the world at time `t` [s]."""
        placement = self.placement
        if callable(placement):
            placement = called(f"the placement of {self.name!r}", placement, t)
        if isinstance(placement, pin.SE3):
            return placement
        if np.shape(placement) == (4, 4):
            z = checked_pose(placement, f"the placement of {self.name!r}")
            return pin.SE3(z[3:].reshape(3, 3), z[:3])
        return pin.SE3(np.eye(3), vector(placement, 3, f"position of {self.name!r}"))


@by_value
class ClosestPair(NamedTuple):
    """The shortest way between one body and one obstacle.

    Attributes:
        distance: Its length [m]; where they overlap, minus the depth.
        body: Name of the body's link.
        obstacle: Name of the obstacle.
        on_body: Its end on the body, in the world [m].
        on_obstacle: Its end on the obstacle, in the world [m].
        gradient: Slope of the distance with the joints, (n,).
    """

    distance: float
    body: str
    obstacle: str
    on_body: Float[Array, "3"]
    on_obstacle: Float[Array, "3"]
    gradient: JointVector


@checked
@dataclass(frozen=True, eq=False)
class Clearance:
    """Distances of a robot's bodies from obstacles.

    Attributes:
        robot: The robot.
        obstacles: The obstacles.
        bodies: Names of the links that count; by default all that a joint moves.

    Raises:
        RobotError: The robot has no collision shapes.
        UnknownNameError: A body is no link with a collision shape.
        InputError: There are no obstacles.
    """

    robot: Robot
    obstacles: Sequence[Obstacle]
    bodies: Sequence[str] = ()

    approaches = Renamed("closest_pairs")

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        if not self.obstacles:
            raise InputError("Clearance needs at least one obstacle, such as Obstacle('ball', coal.Sphere(0.1), pose)")
        moving = dict.fromkeys(self._link(shape) for shape in self._shapes if shape.parentJoint)
        every = dict.fromkeys(self._link(shape) for shape in self._shapes)
        if not moving:
            raise RobotError(f"robot {self.robot.name!r} has no collision shapes on its moving links")
        for body in self.bodies:
            if body not in every:
                raise UnknownNameError("link with a collision shape", body, every)
        object.__setattr__(self, "bodies", tuple(self.bodies or moving))

    @property
    def _shapes(self) -> list[pin.GeometryObject]:
        collision = self.robot.collision
        return list(collision.geometryObjects) if collision is not None else []

    def _link(self, shape: pin.GeometryObject) -> str:
        return str(self.robot.model.frames[shape.parentFrame].name)

    # -- distances ---------------------------------------------------------------------------------------------------

    @checked
    def nearest(self, t: float, q: JointVector) -> ClosestPair:
        """The closest pair of a body and an obstacle at time t [s]."""
        distances = self._distances(t, q)
        return self._closest_pairs(q, [int(distances.argmin())])[0]

    @checked
    def along(self, t: VectorLike, q: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " k"]:
        """Distance of the nearest obstacle at each of several times [m]."""
        times = vector(t, len(q), "the times")
        return np.array([self._distances(*state).min() for state in zip(times.tolist(), q, strict=True)])

    @checked
    def closest_pairs(self, t: float, q: JointVector, *, within: float = np.inf) -> list[ClosestPair]:
        """The closest pair of each body and each obstacle, the nearest first.

        Args:
            t: Time [s], at which moving obstacles are where they are.
            q: Joints.
            within: Approaches longer than this are left out [m].
        """
        distances = self._distances(t, q)
        chosen: dict[tuple[str, int], int] = {}
        # A link may have several shapes; the closest one, which comes first, speaks for it.
        for pair in np.argsort(distances).tolist():
            if distances[pair] > within:
                break
            chosen.setdefault(self._pairs[pair][:2], pair)
        return self._closest_pairs(q, list(chosen.values()))

    @renamed(margin="influence_distance")
    @checked
    def potential(self, q: JointVector, *, influence_distance: float, t: float = 0.0) -> float:
        """Repulsion ½ Σ (influence_distance − distance)² of all approaches closer than `influence_distance` [m²]."""
        near = self.closest_pairs(t, q, within=influence_distance)
        return 0.5 * sum((influence_distance - a.distance) ** 2 for a in near)

    @renamed(margin="influence_distance")
    @checked
    def potential_gradient(self, q: JointVector, *, influence_distance: float, t: float = 0.0) -> JointVector:
        """Slope of `potential` with the joints, such as `DescendPotential` descends, (n,)."""
        near = self.closest_pairs(t, q, within=number(influence_distance, "the influence distance", above=0.0))
        return sum(((a.distance - influence_distance) * a.gradient for a in near), np.zeros(self.robot.n))

    # -- geometry ----------------------------------------------------------------------------------------------------

    @cached_property
    def _geometry(self) -> tuple[pin.GeometryModel, list[int]]:
        """The bodies that count and the obstacles, with every pair of one and the other; numbers of the obstacles."""
        geometry = pin.GeometryModel()
        for shape in self._shapes:
            if self._link(shape) in self.bodies:
                geometry.addGeometryObject(_convex(shape))
        count = geometry.ngeoms
        numbers = []
        for i, obstacle in enumerate(self.obstacles):
            shape = pin.GeometryObject(f"obstacle {i}", 0, 0, obstacle.at(0.0), obstacle.shape)
            numbers.append(geometry.addGeometryObject(_convex(shape)))
        for obstacle in numbers:
            for body in range(count):
                geometry.addCollisionPair(pin.CollisionPair(body, obstacle))
        return geometry, numbers

    @cached_property
    def _pairs(self) -> list[tuple[str, int, int]]:
        """Link, obstacle and joint of each pair."""
        geometry, numbers = self._geometry
        bodies = geometry.geometryObjects[: numbers[0]]
        return [(self._link(body), i, int(body.parentJoint)) for i in range(len(numbers)) for body in bodies]

    @cached_property
    def _workspace(self) -> tuple[pin.Data, pin.GeometryData]:
        data = self._geometry[0].createData()
        for request in data.distanceRequests:
            request.gjk_tolerance = ACCURACY
        return workspace(self.robot.model), data

    def _distances(self, t: float, q: JointVector) -> Float[Array, " pairs"]:
        geometry, numbers = self._geometry
        for i, obstacle in zip(numbers, self.obstacles, strict=True):
            if callable(obstacle.placement):
                geometry.geometryObjects[i].placement = obstacle.at(t)
        data, geometry_data = self._workspace
        pin.computeDistances(self.robot.model, data, geometry, geometry_data, q)
        return np.array([result.min_distance for result in geometry_data.distanceResults])

    def _closest_pairs(self, q: JointVector, pairs: list[int]) -> list[ClosestPair]:
        """Ends and slopes of the pairs last computed."""
        data, geometry_data = self._workspace
        pin.computeJointJacobians(self.robot.model, data, q)
        closest_pairs = []
        for pair in pairs:
            link, obstacle, joint = self._pairs[pair]
            result = geometry_data.distanceResults[pair]
            start, end = result.getNearestPoint1(), result.getNearestPoint2()
            # The normal points from body to obstacle, also where they overlap; J is for the origin of the world.
            n = result.normal
            J = pin.getJointJacobian(self.robot.model, data, joint, pin.ReferenceFrame.WORLD).reshape(6, -1)
            gradient = -(n @ J[:3] + np.cross(start, n) @ J[3:])
            name = self.obstacles[obstacle].name
            closest_pairs.append(ClosestPair(float(result.min_distance), link, name, start, end, gradient))
        return closest_pairs

    def __getstate__(self) -> dict[str, Any]:
        # The workspace is made anew where it is unpickled.
        return {key: value for key, value in self.__dict__.items() if not key.startswith("_")}


def _convex(shape: pin.GeometryObject) -> pin.GeometryObject:
    """The shape, its mesh replaced by the convex hull; a flat mesh has none and stays."""
    copy = shape.copy()
    if isinstance(shape.geometry, coal.BVHModelBase):
        # Built on a copy: the robot's own geometry stays as it is.
        mesh = shape.geometry.clone()
        points = np.asarray(mesh.vertices())
        extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        # The library that makes hulls crashes on a flat one.
        if len(extents) == 3 and extents[2] > FLAT * extents[0]:
            mesh.buildConvexHull(True, "Qt")
            copy.geometry = mesh.convex
    return copy
