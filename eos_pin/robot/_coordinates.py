"""Coordinates of a model: which of them moves which joint, where some joints follow others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Int

from eos_pin._arrays import Array, Vector, frozen_copy


class Coordinates(NamedTuple):
    """Positions of all joints as functions of the coordinates q: of joint i it is factor q[column] + offset.

    The first entry of those that have one for each joint is that of the world, which nothing moves.

    Attributes:
        joints: Joint that has each coordinate of its own, (n,).
        column: Coordinate that moves each joint, −1 for none, (joints,).
        factor: How many times as far it moves, (joints,).
        offset: Its position where the coordinate is 0 [rad or m], (joints,).
        slides: Whether it slides instead of turning, (joints,).
    """

    joints: Int[Array, " n"]
    column: Int[Array, " joints"]
    factor: Vector
    offset: Vector
    slides: Bool[Array, " joints"]

    @property
    def coupled(self) -> bool:
        """Whether any joint follows another one."""
        return len(self.joints) < len(self.column) - 1

    def moving(self, model: pin.Model, joint: int) -> list[int]:
        """Coordinates that move a joint, from the base on."""
        return list(dict.fromkeys(int(self.column[i]) for i in model.supports[joint] if i))


def coordinates_of(model: pin.Model) -> Coordinates:
    """Coordinates of a model whose joints have one of their own or follow another one."""
    count = model.njoints
    column, factor, offset = np.full(count, -1), np.ones(count), np.zeros(count)
    slides = np.zeros(count, dtype=bool)
    own = []
    for i in range(1, count):
        joint = model.joints[i]
        column[i] = joint.idx_v
        if joint.nv:
            own.append(i)
            slides[i] = joint.shortname().startswith("JointModelP")
        else:
            follower = joint.extract()
            factor[i], offset[i] = follower.scaling, follower.offset
            slides[i] = not screw(model, i)[3:].any()
    joints = np.array(sorted(own, key=column.__getitem__), dtype=int)
    return Coordinates(
        frozen_copy(joints, int), frozen_copy(column, int), frozen_copy(factor), frozen_copy(offset),
        frozen_copy(slides, bool),
    )  # fmt: skip


def screw(model: pin.Model, joint: int) -> Vector:
    """Velocity of a joint's frame in itself, linear and angular, for a unit velocity of its coordinate, (6,)."""
    kind = model.joints[joint]
    data = kind.createData()
    kind.calc(data, np.zeros(model.nq))
    return np.ravel(data.S)
