"""Rotations and poses as flat arrays: the rotation matrix row by row (9 numbers), a position followed by it (12)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import ORTHONORMAL, Array, TaskVector, Vector, as_floats, frozen_copy, is_rotation, vector
from eos_pin._kernels.dispatch import use_compiled
from eos_pin.errors import InputError

#: A flat task point, `Task.size` numbers.
Point: TypeAlias = Float[np.ndarray, " size"]
#: What a caller may give for a point: numbers, a rotation or homogeneous matrix, a `pin.SE3`.
PointLike: TypeAlias = Sequence[float] | Sequence[Sequence[float]] | Array | pin.SE3

#: Kinds of parts of a task point: numbers, a rotation matrix row by row (9), an angle that wraps, a unit vector (3).
Kind: TypeAlias = Literal["number", "rotation", "angle", "direction"]


class Channel(NamedTuple):
    """A part of a task point, by which curves through several points are made.

    Attributes:
        part: Which numbers of z.
        kind: What they are.
    """

    part: slice
    kind: Kind


_IDENTITY = frozen_copy(np.eye(3))
#: Where the entries of a flat pose, the position followed by the rotation matrix row by row, are in a flat homogeneous
#: matrix.
FLAT = np.array([3, 7, 11, 0, 1, 2, 4, 5, 6, 8, 9, 10])


@use_compiled
def pose_difference(z1: Point, z0: Point) -> TaskVector:
    """Difference of the positions of two flat poses, and the rotation vector from the second to the first."""
    delta = (z1 - z0)[:6]
    delta[3:] = pin.log3(z1[3:].reshape(3, 3).dot(z0[3:].reshape(3, 3).T))
    return delta


@use_compiled
def flat_pose(array: Array, tolerance: float) -> Point | None:
    """Flat pose from one or from a homogeneous matrix; None if it is not right to rounding.

    Args:
        array: Flat pose, (12,), or homogeneous matrix, (4, 4).
        tolerance: How far RᵀR may be from 1.
    """
    if array.shape == (4, 4) and array[3].tolist() == [0.0, 0.0, 0.0, 1.0]:
        array = array.ravel()[FLAT]
    if array.shape != (12,) or not math.isfinite(array.dot(array)):
        return None
    return array.copy() if is_rotation(array[3:].reshape(3, 3), tolerance) else None


def flat_rotation(value: PointLike, name: str) -> Vector:
    """Flat rotation matrix from a rotation in any accepted form.

    Raises:
        InputError: Not 9 numbers, or no rotation.
    """
    return _straight(vector(as_floats(value, f"the rotation of {name}").ravel(), 9, f"the rotation of {name}"), name)


def _straight(flat: Vector, name: str) -> Vector:
    """Flat rotation matrix whose digits were rounded, made orthonormal again.

    Raises:
        InputError: It is not orthonormal to 1e-6.
    """
    R = flat.reshape(3, 3)
    E = R.T.dot(R) - _IDENTITY
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    largest = max(map(abs, E.ravel().tolist()))
    if largest > 1e-6 or determinant < 0.0:
        raise InputError(
            f"the rotation of {name} must be a 3 × 3 matrix with orthonormal columns and determinant 1, "
            f"got {R.tolist()}"
        )
    if largest > ORTHONORMAL:
        # R (RᵀR)^(−1/2), the nearest rotation, by its series to order E².
        R = R - R.dot(0.5 * E - 0.375 * E.dot(E))
    return R.ravel()


def checked_pose(value: PointLike, name: str) -> Point:
    """Flat pose from a `pin.SE3`, a 4 × 4 matrix or a flat pose; a rounded rotation is made orthonormal again.

    Raises:
        InputError: No pose.
    """
    array = as_floats(value.homogeneous if isinstance(value, pin.SE3) else value, name)
    z = flat_pose(array, ORTHONORMAL)
    if z is not None:
        return z
    if array.shape == (4, 4):
        if array[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            raise InputError(f"the last row of {name} must be 0, 0, 0, 1, got {array[3].tolist()}")
        array = array.ravel()[FLAT]
    z = vector(array, 12, f"{name}, a pin.SE3, a 4 × 4 matrix or a flat point,")
    return np.concatenate((z[:3], _straight(z[3:], name)))


def flat_point(value: PointLike, name: str) -> tuple[Point, int | None]:
    """Flat point of an unknown task, and the task's dimension if the form of the point implies it.

    Args:
        value: A `pin.SE3` or 4 × 4 matrix (a pose), a 3 × 3 matrix (a rotation), or a flat point of any task.
        name: Name of the point, for the error message.

    Raises:
        InputError: Not finite, or neither a flat point nor a rotation nor a pose.
    """
    if isinstance(value, pin.SE3):
        return checked_pose(value, name), 6
    array = as_floats(value, name)
    if array.shape == (4, 4):
        return checked_pose(array, name), 6
    if array.shape == (3, 3):
        return flat_rotation(array, name), 3
    return vector(array, None, name), None
