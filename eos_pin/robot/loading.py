"""`load_robot`: from a file or a name to a `Robot` that can be controlled, or to the reason why it cannot."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from lxml import etree

from eos_pin._arrays import (
    Array,
    VectorLike,
    frozen_copy,
    number,
    vector,
)
from eos_pin.errors import InputError, RobotError, UnknownNameError
from eos_pin.robot.geometry import Shapes, quiet, resolve_shapes
from eos_pin.robot.library import available_robots, find_robot
from eos_pin.robot.model import Robot, find_frame
from eos_pin.robot.notes import Notes, is_physical, oddities
from eos_pin.robot.urdf import Urdf, read_urdf, read_urdf_text

T = TypeVar("T")

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


@dataclass(frozen=True, eq=False)
class Tool:
    """A frame to add: where the tool touches the world.

    Attributes:
        frame: Frame of the robot that carries it.
        placement: Its pose in that frame, given as a `pin.SE3`, a 4 × 4 matrix or a position (x, y, z) [m], and
            kept as a matrix.
        name: Name of the new frame.
    """

    frame: str
    placement: pin.SE3 | VectorLike | Sequence[Sequence[float]] = (0.0, 0.0, 0.0)
    name: str = "tool"

    def __post_init__(self) -> None:
        object.__setattr__(self, "placement", _pose(self.placement))

    def as_dict(self) -> dict[str, Any]:
        """The same in numbers, strings and lists."""
        return {"frame": self.frame, "placement": np.asarray(self.placement).tolist(), "name": self.name}


@dataclass(frozen=True, eq=False)
class Payload:
    """A body to add: what the robot carries.

    Attributes:
        mass: Mass [kg].
        frame: Frame it is fixed to, possibly that of the tool.
        com: Centre of mass in that frame [m].
        inertia: Rotational inertia about the centre of mass, along the axes of that frame [kg m²]; without it
            the body is a point mass.
    """

    mass: float
    frame: str
    com: VectorLike = (0.0, 0.0, 0.0)
    inertia: Float[Array, "3 3"] | Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        inertia = frozen_copy(np.zeros((3, 3)) if self.inertia is None else np.asarray(self.inertia))
        if inertia.shape != (3, 3) or not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T):
            raise InputError(f"inertia of a payload must be a symmetric 3 × 3 matrix, got {inertia.tolist()}")
        object.__setattr__(self, "inertia", inertia)
        object.__setattr__(self, "mass", number(self.mass, "mass of a payload", at_least=0.0))
        object.__setattr__(self, "com", frozen_copy(vector(self.com, 3, "centre of mass of a payload")))
        if not is_physical(self.spatial):
            raise InputError(
                f"no body has the inertia {inertia.tolist()}: a principal moment exceeds the sum of the others"
            )

    @property
    def spatial(self) -> pin.Inertia:
        """Spatial inertia in the frame it is fixed to."""
        return pin.Inertia(self.mass, np.asarray(self.com), np.asarray(self.inertia))

    def as_dict(self) -> dict[str, Any]:
        """The same in numbers, strings and lists."""
        com, inertia = np.asarray(self.com).tolist(), np.asarray(self.inertia).tolist()
        return {"mass": self.mass, "frame": self.frame, "com": com, "inertia": inertia}


def load_robot(
    source: str | bytes | Path,
    *,
    lock: str | Sequence[str] | Mapping[str, float | None] = (),
    chain_to: str = "",
    package_dirs: Sequence[str | Path] = (),
    tool: Tool | Mapping[str, Any] | None = None,
    payload: Payload | Mapping[str, Any] | None = None,
    gravity: VectorLike | float | None = None,
) -> Robot:
    """Robot from a URDF, which is a file or text, or by name.

    `load_robot(robot.source, **robot.options)` gives the same robot again.

    Args:
        source: Path of a URDF, or a name of `available_robots()`, with or without `example-robot-data:`; or the text of
            a URDF, beside which meshes are looked for in the current folder.
        lock: Joints to hold fixed: names, each held at 0 or the limit nearest to it, or a mapping of names to
            positions [rad or m] or None.
        chain_to: Frame to which the joints from the base are kept. All others are locked, and what they carry
            stays as a rigid part. `"auto"` takes `default_frame`.
        package_dirs: Folders in which to look for meshes first.
        tool: Frame to add.
        payload: Body to add.
        gravity: Acceleration of gravity [m/s²]: a vector, or g for (0, 0, −g); by default 9.81 downwards.

    Raises:
        RobotError: The file cannot be used, or its model cannot be controlled; says why.
        UnknownNameError: No such robot, joint or frame; names what is near.
        InputError: An argument is no number, or out of its range.
    """
    tool, payload = _made(Tool, tool), _made(Payload, payload)
    folders = [Path(os.path.abspath(folder)) for folder in package_dirs]
    urdf, canonical = _read(source)
    mimics = {joint.name: joint.mimics for joint in urdf.joints.values() if joint.mimics}
    if chain_to == "auto":
        chain_to = _default_frame(_build(urdf, urdf.rewritten({})), mimics)
    locked = _locked(urdf, lock, tool.frame if tool is not None and chain_to == tool.name else chain_to)
    notes = urdf.notes + _check_joints(urdf, locked, is_chain=bool(chain_to))
    root = urdf.rewritten(locked)
    model = _build(urdf, root)
    notes += oddities(model, chain_to) + resolve_shapes(root, urdf.path, folders)
    if tool is not None:
        _add_frame(model, tool.name, tool.frame, pin.SE3(np.asarray(tool.placement)), pin.Inertia.Zero())
    if payload is not None:
        _add_frame(model, "payload", payload.frame, pin.SE3.Identity(), payload.spatial)
    options: dict[str, Any] = {
        "lock": {name: x if x is None else float(x) for name, x in lock.items()}
        if isinstance(lock, Mapping)
        else _names(lock),
        "chain_to": chain_to,
        "package_dirs": [str(folder) for folder in folders],
        "tool": tool and tool.as_dict(),
        "payload": payload and payload.as_dict(),
    }
    robot = Robot(
        model,
        name=urdf.name,
        source=canonical,
        options={key: value for key, value in options.items() if value},
        urdf_sha256=urdf.sha256,
        notes=notes,
        mimics=mimics,
        shapes=Shapes(etree.tostring(root, encoding="unicode")),
    )
    return robot if gravity is None else robot.with_gravity(gravity)


def leaf_frames(robot: Robot) -> tuple[str, ...]:
    """Frames that carry no other: the ends of all branches."""
    return _leaves(robot.model)


def default_frame(robot: Robot) -> str:
    """The frame a person most likely means: what the chain was loaded to, or where the longest arm ends."""
    return str(robot.options.get("chain_to") or _default_frame(robot.model, robot.mimics))


# -- arguments ---------------------------------------------------------------------------------------------------


def _read(source: str | bytes | Path) -> tuple[Urdf, str]:
    """The URDF, and a name by which it is found again: a name, an absolute path, or its text."""
    if isinstance(source, bytes) or (isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")):
        return read_urdf_text(source)
    if not isinstance(source, (str, os.PathLike)):
        raise InputError(
            f"a robot is given by name, path or text of a URDF, got {type(source).__name__}; of a pin.Model make "
            "Robot(model)"
        )
    path, canonical = _find(source)
    return read_urdf(path), canonical


def _find(source: str | os.PathLike[str]) -> tuple[Path, str]:
    """The URDF file, and a name by which it is found again."""
    if isinstance(source, str):
        if (named := find_robot(source)) is not None:
            return named.path, named.name
        looks_like_path = source.endswith((".urdf", ".xml", ".xacro")) or os.path.isabs(source)
        if not looks_like_path and not os.path.exists(source):
            names = [robot.name for robot in available_robots()]
            raise UnknownNameError("robot", source, names, "The path of a URDF file works as well.")
    path = Path(os.path.abspath(os.path.expanduser(source)))
    return path, str(path)


def _made(kind: type[T], value: T | Mapping[str, Any] | None) -> T | None:
    """The value itself, or one made from its `as_dict`."""
    if not isinstance(value, Mapping):
        return value
    try:
        return kind(**value)
    except TypeError as error:
        raise InputError(f"no {kind.__name__} can be made from {dict(value)!r}: {error}") from error


def _names(lock: str | Sequence[str]) -> list[str]:
    return [lock] if isinstance(lock, str) else list(lock)


def _locked(urdf: Urdf, lock: str | Sequence[str] | Mapping[str, float | None], frame: str) -> dict[str, float]:
    """Position of every joint held fixed: by `lock`, by its limits, or because it is not on the way to `frame`."""
    given = dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(_names(lock))
    chain = urdf.chain(frame) if frame else urdf.moving
    kept = [name for name in chain if not urdf.joints[name].stuck]
    return {name: _position(urdf, name, given.get(name)) for name in (*given, *set(urdf.moving).difference(kept))}


def _position(urdf: Urdf, name: str, value: float | None) -> float:
    """Where a joint is locked: at `value`, or as near to 0 as it can be."""
    if name not in urdf.moving:
        raise UnknownNameError("joint that moves", name, urdf.moving)
    joint = urdf.joints[name]
    if not joint.has_one_degree and value:
        raise InputError(f"joint {name!r} is {joint.kind}; it can be locked at 0 only, got {value!r}")
    lower, upper = (-np.inf, np.inf) if joint.unlimited else (joint.lower, joint.upper)
    position = float(np.clip(0.0, lower, upper)) if value is None else number(value, f"position of joint {name!r}")
    if not lower <= position <= upper:
        raise InputError(f"joint {name!r} moves from {lower:g} to {upper:g} and cannot be locked at {position:g}")
    return position


# -- building ----------------------------------------------------------------------------------------------------


def _check_joints(urdf: Urdf, locked: Mapping[str, float], *, is_chain: bool) -> tuple[str, ...]:
    """Refuse joints that stay and cannot be controlled; notes about those taken for something else."""
    notes = Notes()
    for joint in urdf.joints.values():
        if joint.stuck:
            notes.add(f"locked, because its limits are both {joint.lower:g}: @", joint.name)
    for joint in (urdf.joints[name] for name in urdf.moving if name not in locked):
        where = f"{urdf.path} line {joint.line}: joint {joint.name!r}"
        if not joint.has_one_degree:
            raise RobotError(
                f"{where} is {joint.kind}; eos_pin controls revolute, continuous and prismatic joints. Lock it, or "
                "load the chain to one frame"
            )
        if joint.mimics and is_chain:
            raise RobotError(
                f"{where} mimics {joint.mimics!r} and has no torque of its own, but lies inside the chain. Lock it, "
                "or load the chain to a frame before it"
            )
        if joint.mimics:
            notes.add(f"should mimic {joint.mimics!r}, and moves on its own here: @", joint.name)
        if joint.kind != "continuous" and joint.unlimited and not any(joint.name in note for note in urdf.notes):
            notes.add("limits of 0 to 0 are taken for none: @", joint.name)
    return notes.sentences()


def _build(urdf: Urdf, root: etree._Element) -> pin.Model:
    """Pinocchio's model of a checked description; what could spoil it and concerns only shapes is not part of it."""
    bare = copy.deepcopy(root)
    etree.strip_elements(bare, "visual", "collision", "material", with_tail=False)
    with quiet() as said:
        try:
            return pin.buildModelFromXML(etree.tostring(bare, encoding="unicode"))
        except (ValueError, RuntimeError) as error:
            reason = error
    raise RobotError(f"{urdf.path}: Pinocchio cannot build a model of it: {reason} {said[0]}") from reason


def _add_frame(model: pin.Model, name: str, parent: str, placement: pin.SE3, inertia: pin.Inertia) -> None:
    """Add a frame, and a body in it, to a model that is still being built."""
    if model.existFrame(name):
        raise InputError(f"the robot already has a frame named {name!r}")
    i = find_frame(model, parent)
    joint, pose = model.frames[i].parentJoint, model.frames[i].placement * placement
    model.addFrame(pin.Frame(name, joint, i, pose, pin.FrameType.OP_FRAME, inertia))


def _pose(value: pin.SE3 | VectorLike | Sequence[Sequence[float]]) -> Float[Array, "4 4"]:
    """A pose as matrix, from any of the forms people have it in."""
    if isinstance(value, pin.SE3):
        return frozen_copy(value.homogeneous)
    matrix = np.asarray(value, dtype=float)
    if matrix.shape == (3,):
        matrix = pin.SE3(np.eye(3), matrix).homogeneous
    if (
        matrix.shape != (4, 4)
        or not np.isfinite(matrix).all()
        or not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
        or not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-6)
        or np.linalg.det(matrix[:3, :3]) < 0.0
    ):
        raise InputError(f"a placement is a pin.SE3, a 4 × 4 pose or a position (x, y, z), got {value!r}")
    return frozen_copy(matrix)


# -- frames ------------------------------------------------------------------------------------------------------


def _leaves(model: pin.Model) -> tuple[str, ...]:
    parents = {frame.parentFrame for frame in model.frames}
    return tuple(frame.name for i, frame in enumerate(model.frames) if i and i not in parents)


def _default_frame(model: pin.Model, mimics: Mapping[str, str]) -> str:
    """Frame behind the most joints of an arm; among these the one with the best name."""
    is_hand = _hands(model, mimics)
    leaves = set(_leaves(model))

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
