"""Parts of a robot: its joints, the protocol of its geometry, and frames of its model."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from eos_pin._arrays import number
from eos_pin.errors import InputError, UnknownNameError

#: Words in the name of a frame that say it is where the robot works, the best first.
WORKING_FRAMES = (
    "tcp", "tool", "grasp", "grasping", "ee", "eef", "effector", "gripper", "tip", "flange", "palm", "hand"
)  # fmt: skip
#: Words in the name of a joint that say it belongs to a hand, not to the arm that carries it.
HAND_JOINTS = {"gripper", "finger", "thumb", "index", "middle", "ring", "little", "pinky", "hand", "jaw", "claw"}
#: Parts of the names of joints and links that occur in hands only.
FINGERS = ("finger", "thumb", "knuckle", "pinky", "jaw")
#: Words in the name of a frame that say that it measures something there.
SENSORS = {"camera", "sensor", "imu", "optical", "lidar", "laser"}
#: An arm has at least this many joints before its hand, and a finger no more than this.
ARM_JOINTS = 4


@dataclass(frozen=True)
class Joint:
    """One degree of freedom.

    Attributes:
        name: Name in the URDF.
        kind: `"revolute"`, `"continuous"` (revolute without limits) or `"prismatic"`.
        lower: Lower position limit [rad or m], −inf without limit.
        upper: Upper position limit [rad or m], inf without limit.
        velocity: Velocity limit [rad/s or m/s], inf without limit.
        effort: Torque or force limit [N m or N], inf without limit.
    """

    name: str
    kind: str
    lower: float
    upper: float
    velocity: float
    effort: float


class HasShapes(Protocol):
    """Protocol of a robot's geometry, such as `eos_pin.robot.geometry.Shapes`."""

    @property
    def visual(self) -> pin.GeometryModel:
        """Visual geometry."""

    @property
    def collision(self) -> pin.GeometryModel:
        """Collision geometry."""


def reach_of(model: pin.Model, end: str = "") -> float:
    """Length from joint to joint to the last frame [m], or to the frame `end` of a chain."""
    steps = [np.linalg.norm(placement.translation) for placement in list(model.jointPlacements)[2:]]
    # Beyond the end of a chain there may be a whole robot that is locked.
    last = [
        np.linalg.norm(frame.placement.translation)
        for frame in model.frames
        if frame.parentJoint == model.njoints - 1 and end in ("", frame.name)
    ]
    return float(sum(steps) + max(last, default=0.0))


def listed(names: list[str], most: int = 8) -> str:
    """The first names, and the number of the others."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def find_frame(model: pin.Model, name: str) -> int:
    """Index of a frame; a link comes before a joint of the same name.

    Raises:
        UnknownNameError: There is no such frame; Pinocchio itself would silently answer with the frame count.
    """
    found = [i for i, frame in enumerate(model.frames) if frame.name == name]
    if not found:
        raise UnknownNameError("frame", name, dict.fromkeys(frame.name for frame in model.frames))
    links = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
    return next((i for i in found if model.frames[i].type in links), found[0])


def leaves_of(model: pin.Model) -> tuple[str, ...]:
    """Frames that carry no other: the ends of all branches."""
    parents = {frame.parentFrame for frame in model.frames}
    return tuple(frame.name for i, frame in enumerate(model.frames) if i and i not in parents)


def default_frame_of(model: pin.Model, mimics: Mapping[str, str]) -> str:
    """Frame behind the most joints of an arm; among these the one with the best name."""
    is_hand = _hands(model, mimics)
    leaves = set(leaves_of(model))

    def merit(frame: pin.Frame) -> tuple[bool, bool, int, int, bool, bool]:
        joints = list(model.supports[frame.parentJoint])
        words = _words(frame.name)
        rank = next((i for i, word in enumerate(WORKING_FRAMES) if word in words), len(WORKING_FRAMES))
        return (
            not any(model.names[i] in mimics for i in joints),
            not any(is_hand[i] for i in joints),
            len(joints),
            -rank,
            SENSORS.isdisjoint(words),
            frame.name in leaves,
        )

    links = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
    return str(max((frame for frame in model.frames if frame.type in links), key=merit).name)


def _hands(model: pin.Model, mimics: Mapping[str, str]) -> list[bool]:
    """Whether each joint belongs to a hand, not to the arm that carries it; all False for a robot that is a hand."""
    bodies = [""] * model.njoints
    for frame in reversed(list(model.frames)):
        if frame.type == pin.FrameType.BODY:
            # In the end the first one: the link that the joint itself moves.
            bodies[frame.parentJoint] = frame.name
    followed = set(mimics.values()) | set(mimics)
    is_hand = [
        not HAND_JOINTS.isdisjoint(_words(joint))
        or any(word in name.lower() for name in (joint, body) for word in FINGERS)
        or joint in followed
        for joint, body in zip(model.names, bodies, strict=True)
    ]
    # A hand goes on as one to its end; `elbow_ring` with an arm behind it is none.
    depth = [0] * model.njoints
    for i in reversed(range(1, model.njoints)):
        is_hand[i] = is_hand[i] and all(is_hand[child] for child in model.children[i])
        depth[i] = 1 + max((depth[child] for child in model.children[i]), default=0)
    for i in range(1, model.njoints):
        # Where an arm ends in several short branches, these are fingers, whatever they are called.
        branches = list(model.children[i])
        if len(model.supports[i]) > ARM_JOINTS and len(branches) > 1 and max(depth[b] for b in branches) < ARM_JOINTS:
            for joint in (joint for branch in branches for joint in model.subtrees[branch]):
                is_hand[joint] = True
    return is_hand if not all(is_hand[1:]) else [False] * model.njoints


def _words(name: str) -> set[str]:
    """Words of a name such as `LeftHand_link2`, in lower case."""
    return {word.lower() for word in re.findall("[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def locked_at(name: str, value: float | None, lower: float, upper: float) -> float:
    """Position at which a joint is locked: the one that is given, or as near to 0 as its limits allow.

    Raises:
        InputError: It is no number, or beyond the limits.
    """
    position = min(max(0.0, lower), upper) if value is None else number(value, f"position of joint {name!r}")
    if not lower <= position <= upper:
        raise InputError(f"joint {name!r} moves from {lower:g} to {upper:g} and cannot be locked at {position:g}")
    return float(position)
