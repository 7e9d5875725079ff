"""Trajectories of poses from a position and an orientation, and orientations that turn about an axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, Vector, VectorLike, as_floats, by_value, checked, vector
from eos_pin.errors import InputError
from eos_pin.tasks._flat import PointLike, checked_pose, flat_rotation
from eos_pin.trajectories.base import Hold, Target, Trajectory
from eos_pin.trajectories.stacked import StackedTrajectory


@by_value
class PoseTrajectory(StackedTrajectory):
    """Trajectory of a `PoseTask`: a position and an orientation, each moving or at rest.

    Args:
        position: Trajectory of 3 coordinates, such as `circle(…)`, or a point [m].
        orientation: Trajectory of rotations, such as `rotation_spline(…)`, or a rotation matrix (3, 3).
        pose: Pose that gives the part that is missing: a `pin.SE3`, a 4 × 4 matrix or the task point of a `PoseTask`.

    For example, the hand of a robot on a circle, turned as it is at the joints q:

        PoseTrajectory(position=circle(center, 0.1, period=4.0), pose=task.value(q))

    Raises:
        InputError: A part is missing, of the wrong shape, or no rotation.
    """

    @checked
    def __init__(
        self,
        position: Trajectory | VectorLike | pin.SE3 | None = None,
        orientation: Trajectory | PointLike | None = None,
        pose: PointLike | None = None,
    ) -> None:
        if pose is None:
            missing = [name for name, part in (("position", position), ("orientation", orientation)) if part is None]
            if missing:
                raise InputError(f"a PoseTrajectory needs {' and '.join(missing)}, or a pose to take them from")
        else:
            kept = checked_pose(pose, "the pose")
            position = kept[:3] if position is None else position
            orientation = kept[3:] if orientation is None else orientation
        super().__init__((_position(position), _orientation(orientation)))

    @property
    def position(self) -> Trajectory:
        """Trajectory of the position."""
        return self.parts[0]

    @property
    def orientation(self) -> Trajectory:
        """Trajectory of the orientation."""
        return self.parts[1]


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Turned(Trajectory):
    """Orientations that turn about one axis of the frame, which rests in space, such as the roll of a tool.

    Attributes:
        rotation: Rotation matrix at the angle 0, (3, 3).
        axis: The axis in the frame, a unit vector, (3,).
        angle: Trajectory of the angle [rad].
    """

    rotation: Float[Array, "3 3"]
    axis: Vector
    angle: Trajectory

    def __post_init__(self) -> None:
        self._take_times(self.angle)

    def __call__(self, t: float) -> Target:
        (angle,), rate, bend = self.angle(t)
        in_space = self.rotation.dot(self.axis)
        z: Vector = self.rotation.dot(pin.exp3(angle * self.axis)).ravel()
        return Target(z, rate * in_space, bend * in_space)


def _position(part: Trajectory | VectorLike | pin.SE3 | None) -> Trajectory:
    if not isinstance(part, Trajectory):
        point = part.translation if isinstance(part, pin.SE3) else part
        part = Hold(vector(as_floats(point, "the position"), 3, "the position"))  # type: ignore[arg-type]
    return _checked(part, "position", 3, "3 coordinates x, y, z")


def _orientation(part: Trajectory | PointLike | None) -> Trajectory:
    if not isinstance(part, Trajectory):
        rotation = part.rotation if isinstance(part, pin.SE3) else part
        part = Hold(flat_rotation(rotation, "the pose"), 3)
    elif isinstance(part, Hold) and part.z.size == 9 and part.m is None:
        part = Hold(part.z.reshape(3, 3))
    return _checked(part, "orientation", 9, "rotation matrices row by row, 9 numbers, with 3 velocity components")


def _checked(part: Trajectory, name: str, size: int, wanted: str) -> Trajectory:
    """A part whose points and velocities have the right lengths."""
    target = part(0.0)
    z, dz = np.shape(target.z), np.shape(target.dz)
    if (z, dz) != ((size,), (3,)):
        raise InputError(
            f"the {name} of a PoseTrajectory must be a trajectory of {wanted}; "
            f"its points have shape {z} and its velocities {dz}"
        )
    return part
