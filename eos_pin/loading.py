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

from eos_pin.arrays import Array, VectorLike, number, readonly, vector
from eos_pin.errors import InputError, RobotError, UnknownNameError
from eos_pin.library import available_robots, find_robot
from eos_pin.robot import Robot, find_frame
from eos_pin.shapes import Shapes, quiet, resolve_shapes
from eos_pin.urdf import Urdf, read_urdf

#: Words in the name of a frame that say it is where the robot works, the best first.
WORKING_FRAMES = (
    "tcp",
    "tool",
    "grasp",
    "grasping",
    "ee",
    "eef",
    "effector",
    "gripper",
    "tip",
    "flange",
    "palm",
    "hand",
)
#: Words in the name of a joint that say it belongs to a hand, not to the arm that carries it.
HAND_JOINTS = {"gripper", "finger", "thumb", "index", "middle", "ring", "little", "pinky", "hand", "jaw"}


@dataclass(frozen=True, eq=False)
class Tool:
    """A frame to add: where the tool touches the world.

    Attributes:
        frame: Frame of the robot that carries it.
        placement: Its pose in that frame: a `pin.SE3`, a 4 × 4 matrix, or a position (x, y, z) [m]; kept as a matrix.
        name: Name of the new frame.
    """

    frame: str
    placement: pin.SE3 | VectorLike = (0.0, 0.0, 0.0)
    name: str = "tool"

    def __post_init__(self) -> None:
        object.__setattr__(self, "placement", _placement(self.placement))

    def as_dict(self) -> dict[str, Any]:
        """The same in numbers, strings and lists."""
        return {"frame": self.frame, "placement": np.asarray(self.placement).tolist(), "name": self.name}


@dataclass(frozen=True, eq=False)
class Payload:
    """A body to add: what the robot carries.

    Attributes:
        mass: Mass [kg].
        frame: Frame it is fixed to; that of a tool, too.
        com: Centre of mass in that frame [m].
        inertia: Rotational inertia about the centre of mass, in the axes of that frame [kg m²]; None for a point mass.
    """

    mass: float
    frame: str
    com: VectorLike = (0.0, 0.0, 0.0)
    inertia: Float[Array, "3 3"] | Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        inertia = np.zeros((3, 3)) if self.inertia is None else np.asarray(self.inertia, dtype=float)
        if inertia.shape != (3, 3) or not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T):
            raise InputError(f"inertia of a payload must be a symmetric 3 × 3 matrix, got {self.inertia!r}")
        object.__setattr__(self, "mass", number(self.mass, "mass of the payload", at_least=0.0))
        object.__setattr__(self, "com", readonly(vector(self.com, 3, "centre of mass of the payload")))
        object.__setattr__(self, "inertia", readonly(inertia))
        if not _is_physical(self.spatial):
            raise InputError(
                f"no body has the inertia {inertia.tolist()}: each principal moment is at most the sum of the others"
            )

    @property
    def spatial(self) -> pin.Inertia:
        """Spatial inertia in the frame that carries it."""
        return pin.Inertia(self.mass, np.asarray(self.com), np.asarray(self.inertia))

    def as_dict(self) -> dict[str, Any]:
        """The same in numbers, strings and lists."""
        com, inertia = np.asarray(self.com).tolist(), np.asarray(self.inertia).tolist()
        return {"mass": self.mass, "frame": self.frame, "com": com, "inertia": inertia}


def load_robot(
    source: str | Path,
    *,
    lock: str | Sequence[str] | Mapping[str, float] = (),
    chain_to: str = "",
    package_dirs: Sequence[str | Path] = (),
    tool: Tool | Mapping[str, Any] | None = None,
    payload: Payload | Mapping[str, Any] | None = None,
    gravity: VectorLike | float | None = None,
) -> Robot:
    """Robot from a URDF file, or by name.

    `load_robot(robot.source, **robot.options)` gives the same robot again.

    Args:
        source: Path of a URDF; or a name of `available_robots()`, which may start with `example-robot-data:`.
        lock: Joints to hold fixed: their names, held at 0 or at the limit nearest to it, or a mapping of name to
            position [rad or m].
        chain_to: Frame to which the chain from the base is kept; all other joints are locked, and what they carry
            stays as a rigid part. `"auto"` takes `default_frame`.
        package_dirs: Folders in which to look for meshes first.
        tool: Frame to add.
        payload: Body to add.
        gravity: Acceleration of gravity [m/s²], a vector, or g for (0, 0, −g); None for 9.81 downwards.

    Raises:
        RobotError: The file cannot be used, or its model cannot be controlled; says why.
        UnknownNameError: No such robot, joint or frame; names what is near.
        InputError: An argument is no number, or out of its range.
    """
    tool = _from_mapping(Tool, tool)
    payload = _from_mapping(Payload, payload)
    folders = [Path(os.path.abspath(folder)) for folder in package_dirs]
    path, origin = _find(source)
    urdf = read_urdf(path)
    if chain_to == "auto":
        chain_to = _default_frame(_build(urdf, urdf.rewritten({})))
    locked = _locked(urdf, lock, tool.frame if tool and chain_to == tool.name else chain_to)
    kept = [name for name in urdf.moving if name not in locked]
    notes = _check_kept(urdf, kept, bool(chain_to))
    root = urdf.rewritten(locked)
    model = _build(urdf, root)
    notes += _check_inertias(model) + resolve_shapes(root, path, folders)
    if tool is not None:
        _add_frame(model, tool.name, tool.frame, pin.SE3(np.asarray(tool.placement)), pin.Inertia.Zero())
    if payload is not None:
        _add_frame(model, "payload", payload.frame, pin.SE3.Identity(), payload.spatial)
    options: dict[str, Any] = {
        "lock": {name: float(value) for name, value in lock.items()}
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
        source=origin,
        options={key: value for key, value in options.items() if value not in ("", None, [], {})},
        urdf_sha256=urdf.sha256,
        notes=notes,
        shapes=Shapes(etree.tostring(root, encoding="unicode")),
    )
    return robot if gravity is None else robot.with_gravity(gravity)


def leaf_frames(robot: Robot) -> tuple[str, ...]:
    """Frames that carry no other: the ends of all branches."""
    return _leaves(robot.model)


def default_frame(robot: Robot) -> str:
    """The frame a person most likely means: at the end of a long branch, and named like a place to work with."""
    return _default_frame(robot.model)


T = TypeVar("T")


def _from_mapping(kind: type[T], value: T | Mapping[str, Any] | None) -> T | None:
    """The value itself, or made from what its `as_dict` gave."""
    if not isinstance(value, Mapping):
        return value
    try:
        return kind(**value)
    except TypeError as error:
        raise InputError(f"no {kind.__name__} can be made from {dict(value)!r}: {error}") from error


# -- steps of loading --------------------------------------------------------------------------------------------


def _find(source: str | Path) -> tuple[Path, str]:
    """File and canonical source of what the caller asked for."""
    if isinstance(source, str):
        named = find_robot(source)
        if named is not None:
            return named.path, named.name
        if not (
            source.endswith((".urdf", ".xml", ".xacro")) or os.path.isabs(source) or os.path.exists(source)
        ):
            advice = "A path to a URDF file works as well."
            raise UnknownNameError("robot", source, [robot.name for robot in available_robots()], advice)
    path = Path(os.path.abspath(source))
    return path, str(path)


def _names(lock: str | Sequence[str]) -> list[str]:
    return [lock] if isinstance(lock, str) else list(lock)


def _locked(urdf: Urdf, lock: str | Sequence[str] | Mapping[str, float], frame: str) -> dict[str, float]:
    """Position of every joint that is held fixed."""
    given = lock if isinstance(lock, Mapping) else dict.fromkeys(_names(lock), None)
    locked: dict[str, float] = {}
    outside = set(urdf.moving) - set(urdf.chain(frame)) if frame else set()
    for name in [*given, *(outside - set(given))]:
        if name not in urdf.moving:
            raise UnknownNameError("joint that moves", name, urdf.moving)
        joint, value = urdf.joints[name], given.get(name)
        if value is None:
            locked[name] = 0.0 if joint.unlimited else float(np.clip(0.0, joint.lower, joint.upper))
            continue
        locked[name] = number(value, f"position of locked joint {name!r}")
        if not joint.moves and value != 0.0:
            raise InputError(f"joint {name!r} is {joint.kind}; it can be locked at 0 only, got {value!r}")
        if not (joint.unlimited or joint.lower <= value <= joint.upper):
            raise InputError(
                f"joint {name!r} moves from {joint.lower:g} to {joint.upper:g}; it cannot be locked at {value!r}"
            )
    return locked


def _check_kept(urdf: Urdf, kept: Sequence[str], is_chain: bool) -> tuple[str, ...]:
    """Refuse joints that stay and cannot be controlled; notes about those that are taken for something else."""
    notes = []
    for name in kept:
        joint = urdf.joints[name]
        where = f"{urdf.path} line {joint.line}"
        if not joint.moves:
            raise RobotError(
                f"{where}: joint {name!r} is {joint.kind}; eos_pin controls revolute, continuous and prismatic joints. "
                "Lock it, or load the chain to one frame (chain_to)"
            )
        if joint.mimics and is_chain:
            raise RobotError(
                f"{where}: joint {name!r} mimics {joint.mimics!r} and lies inside the chain, so it has no torque of its "
                "own. Lock it, or choose a frame before it"
            )
        if joint.mimics:
            notes.append(f"joint {name!r} mimics {joint.mimics!r} in the URDF; here it is a joint of its own")
        if joint.kind == "continuous":
            notes.append(f"continuous joint {name!r} is a revolute one without limits")
        elif joint.unlimited:
            notes.append(f"the limits of joint {name!r} leave it no room (0 to 0); it is taken to have none")
    return tuple(notes)


def _build(urdf: Urdf, root: etree._Element) -> pin.Model:
    """Pinocchio's model of a checked description."""
    bare = copy.deepcopy(root)
    etree.strip_elements(bare, "visual", "collision", with_tail=False)
    with quiet() as said:
        try:
            return pin.buildModelFromXML(etree.tostring(bare, encoding="unicode"))
        except (ValueError, RuntimeError) as error:
            reason = error
    raise RobotError(f"{urdf.path}: Pinocchio cannot build a model of it: {reason} {said[0]}") from reason


def _check_inertias(model: pin.Model) -> tuple[str, ...]:
    """Notes about moving bodies whose inertia no real body has; M(q) is checked by `Robot`."""
    odd = [model.names[i] for i in range(1, model.njoints) if not _is_physical(model.inertias[i])]
    if not odd:
        return ()
    return (
        f"the inertia of what joints {', '.join(odd)} move is that of no real body (a principal moment exceeds the sum of "
        "the other two); it is used as it stands",
    )


def _is_physical(inertia: pin.Inertia) -> bool:
    """Whether mass and principal moments are those of some distribution of matter."""
    moments = np.linalg.eigvalsh(inertia.inertia)
    # Half the sum of the moments is the largest each may be; many files state them to three digits.
    return bool(inertia.mass >= 0.0 and 0.5 * moments.sum() - moments[-1] >= -1e-3 * np.abs(moments).max())


def _add_frame(model: pin.Model, name: str, parent: str, placement: pin.SE3, inertia: pin.Inertia) -> None:
    """Add a frame, and a body in it, to a model that is still being built."""
    if name in {frame.name for frame in model.frames}:
        raise InputError(f"the robot already has a frame named {name!r}; choose another name")
    parent_id = find_frame(model, parent)
    carrier = model.frames[parent_id]
    pose = carrier.placement * placement
    model.addFrame(pin.Frame(name, carrier.parentJoint, parent_id, pose, pin.FrameType.OP_FRAME, inertia))


def _placement(value: pin.SE3 | VectorLike) -> Float[Array, "4 4"]:
    """Pose as a matrix, from any of the forms people have it in."""
    if isinstance(value, pin.SE3):
        return readonly(value.homogeneous)
    array = np.asarray(value, dtype=float)
    if array.shape == (3,):
        matrix = np.eye(4)
        matrix[:3, 3] = vector(array, 3, "position of the tool")
        return readonly(matrix)
    is_pose = (
        array.shape == (4, 4) and np.isfinite(array).all() and np.array_equal(array[3], [0.0, 0.0, 0.0, 1.0])
    )
    if not is_pose or not pin.SE3(array).isNormalized(1e-6) or np.linalg.det(array[:3, :3]) < 0.0:
        raise InputError(
            f"placement of a tool must be a pin.SE3, a 4 × 4 pose or a position (x, y, z), got {value!r}"
        )
    return readonly(array)


# -- frames ------------------------------------------------------------------------------------------------------


def _leaves(model: pin.Model) -> tuple[str, ...]:
    parents = {frame.parentFrame for frame in model.frames}
    return tuple(frame.name for i, frame in enumerate(model.frames) if i and i not in parents)


def _default_frame(model: pin.Model) -> str:
    """Frame at the end of the most arm joints; among these by the best name, then the one farthest out."""
    # A hand is where such names go on to the end: an index finger, but not an index of sections before an arm.
    is_hand = [not HAND_JOINTS.isdisjoint(_words(name)) for name in model.names]
    for i in range(model.njoints - 1, 0, -1):
        is_hand[i] &= all(is_hand[j] for j in model.children[i])
    if all(is_hand[1:]):
        is_hand = [False] * model.njoints
    leaves = set(_leaves(model))

    def merit(frame: pin.Frame) -> tuple[bool, int, int, bool]:
        joints = [i for i in model.supports[frame.parentJoint] if i]
        beyond_hand = any(is_hand[i] for i in joints)
        words = _words(frame.name)
        rank = next((i for i, word in enumerate(WORKING_FRAMES) if word in words), len(WORKING_FRAMES))
        return not beyond_hand, len(joints), -rank, frame.name in leaves

    bodies = [frame for frame in model.frames if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME)]
    return max(bodies, key=merit).name


def _words(name: str) -> set[str]:
    """Words of a name like `LeftHand_link2`, in lower case."""
    return {word.lower() for word in re.findall("[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}
