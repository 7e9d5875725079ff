"""A Pinocchio model as flat arrays, in which every joint moves along or about the z axis of its own frame."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from eos_pin._arrays import Array, frozen_copy

PartKind: TypeAlias = Literal["position", "orientation", "pose", "heading", "axis"]
#: Number of each kind of part in the compiled kernels.
KINDS: dict[str, int] = {"position": 0, "orientation": 1, "pose": 2, "heading": 3, "axis": 4}
#: Axes of the frame of the pole, the third, from which the bases of all directions are carried along great circles.
POLE = frozen_copy(pin.exp3(np.array([0.9, -0.5, 0.3])))


class Part(NamedTuple):
    """A part of a task that is read off the pose of one frame.

    Attributes:
        kind: Kind of function of the pose.
        frame: Number of the frame in the Pinocchio model.
        axes: For a position, the coordinates that count, some of 0, 1, 2.
        direction: For an axis, its unit vector in the frame.
    """

    kind: PartKind
    frame: int
    axes: tuple[int, ...] = (0, 1, 2)
    direction: tuple[float, ...] = (0.0, 0.0, 1.0)


class FlatModel(NamedTuple):
    """Joints of a model.

    Attributes:
        parents: Number of each joint's parent, −1 for the base, (n,).
        prismatic: Whether each joint slides, (n,).
        fixed: Placement of each joint in its parent's frame where it is at zero, (n, 12): the rotation row by row, then
            the position.
        turns: Rotation of each joint's frame here in Pinocchio's, (n, 3, 3).
    """

    parents: Int[Array, " n"]
    prismatic: Int[Array, " n"]
    fixed: Float[Array, "n 12"]
    turns: Float[Array, "n 3 3"]

    def carried(self, model: pin.Model, frame: int) -> tuple[int, Float[Array, "12"]]:
        """Joint that carries a frame, −1 for the base, and the frame's placement in that joint's frame."""
        joint, placement = model.frames[frame].parentJoint - 1, model.frames[frame].placement
        turn = np.eye(3) if joint < 0 else self.turns[joint]
        return joint, _flat(turn.T @ placement.rotation, turn.T @ placement.translation)

    def tip(self, model: pin.Model, part: Part) -> tuple[int, Float[Array, "12"]]:
        """Joint that carries the frame of a part, and its placement there; an axis is the third of the frame's axes."""
        joint, tip = self.carried(model, part.frame)
        if part.kind == "axis":
            tip[:9] = (tip[:9].reshape(3, 3) @ _turn_to(np.array(part.direction))).ravel()
        return joint, tip


def flat_model(model: pin.Model) -> FlatModel | None:
    """The joints of a model whose joints each have one degree of freedom; None if one of them is of another kind."""
    n = model.nv
    if n < model.njoints - 1:
        return None
    parents, prismatic = np.array(list(model.parents)[1:], dtype=np.int32) - 1, np.zeros(n, dtype=np.int32)
    fixed, turns = np.empty((n, 12)), np.empty((n, 3, 3))
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(n))
    for i in range(n):
        motion = pin.getJointJacobian(model, data, i + 1, pin.ReferenceFrame.LOCAL).reshape(6, n)[:, i]
        linear, angular = motion[:3], motion[3:]
        if {np.linalg.norm(part).round(12) for part in (linear, angular)} != {0.0, 1.0}:
            return None
        prismatic[i] = linear.any()
        turns[i] = _turn_to(linear if prismatic[i] else angular)
        parent = np.eye(3) if parents[i] < 0 else turns[parents[i]]
        placement = model.jointPlacements[i + 1]
        fixed[i] = _flat(parent.T @ placement.rotation @ turns[i], parent.T @ placement.translation)
    return FlatModel(parents, prismatic, fixed, turns)


def chain_arguments(model: pin.Model, parts: tuple[Part, ...]) -> tuple[Any, ...] | None:
    """Arguments of the compiled `Chain`; None if a joint is of a kind that it does not have."""
    flat = flat_model(model)
    if flat is None:
        return None
    carried = [flat.tip(model, part) for part in parts]
    axes = [[*part.axes, -1, -1, -1][:3] for part in parts]
    joints, tips = [joint for joint, _ in carried], [tip for _, tip in carried]
    return (*flat[:3], joints, [KINDS[part.kind] for part in parts], axes, tips)


def _turn_to(axis: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation that takes the z axis to a unit vector; for an axis of the frame its entries are whole numbers."""
    beside = np.eye(3)[(int(np.argmax(np.abs(axis))) + 1) % 3]
    first = beside - axis * (axis @ beside)
    first /= np.linalg.norm(first)
    return np.column_stack((first, np.cross(axis, first), axis))


def _flat(rotation: Float[Array, "3 3"], position: Float[Array, "3"]) -> Float[Array, "12"]:
    return np.concatenate((rotation.ravel(), position))
