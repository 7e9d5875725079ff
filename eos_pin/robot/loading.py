"""`load_robot`: from a file or a name to a `Robot` that can be controlled, or to the reason why it cannot."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from lxml import etree

from eos_pin._arrays import (
    Array,
    VectorLike,
    as_floats,
    by_value,
    checked,
    frozen_copy,
    number,
    vector,
)
from eos_pin.errors import InputError, RobotError, UnknownNameError, refuse_unused
from eos_pin.robot._coordinates import coordinates_of
from eos_pin.robot._parts import default_frame_of, find_frame, leaves_of, locked_at
from eos_pin.robot.coupled import CoupledRobot
from eos_pin.robot.geometry import Shapes, quiet, resolve_shapes
from eos_pin.robot.library import available_robots, find_robot
from eos_pin.robot.model import Robot
from eos_pin.robot.notes import Notes, is_physical, oddities
from eos_pin.robot.reading.mimic import followers_in
from eos_pin.robot.reading.mjcf import NO_SHAPES, is_mjcf, locked_model, read_mjcf
from eos_pin.robot.reading.planar import without_planar
from eos_pin.robot.reading.urdf import Urdf, read_urdf, read_urdf_text

T = TypeVar("T")
#: A robot by name, path or text.
Source: TypeAlias = str | bytes | os.PathLike[str]
#: Joints to hold fixed, in one of the forms that `load_robot` takes.
Lock: TypeAlias = str | Sequence[str] | Mapping[str, float | None]


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Tool:
    """A frame to add, at the place where the tool touches the world.

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


@by_value
@checked
@dataclass(frozen=True, eq=False)
class Payload:
    """A body to add, which the robot carries.

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
        inertia = frozen_copy(
            np.zeros((3, 3)) if self.inertia is None else as_floats(self.inertia, "inertia of a payload")
        )
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


@checked
def load_robot(
    source: Source,
    *,
    lock: Lock = (),
    chain_to: str = "",
    branch_to: str = "",
    package_dirs: Sequence[str | Path] = (),
    tool: Tool | Mapping[str, Any] | None = None,
    payload: Payload | Mapping[str, Any] | None = None,
    gravity: VectorLike | float | None = None,
) -> Robot:
    """Robot from a URDF, which is a file or text, from an MJCF file, or by name.

    `load_robot(robot.source, **robot.options)` gives the same robot again.

    Args:
        source: Path of a URDF or an MJCF file (`.xml`), or a name of `available_robots()`, with or without
            `example-robot-data:`; or the text of a URDF, beside which meshes are looked for in the current folder.
        lock: Joints to hold fixed: names, each held at 0 or the limit nearest to it, or a mapping of names to
            positions [rad or m] or None.
        chain_to: Frame to which the joints from the base are kept. All others are locked, and what they carry
            stays as a rigid part. `"auto"` takes `default_frame`.
        branch_to: Frame to which they are kept as well, such as the other hand of a robot with two arms.
        package_dirs: Folders in which to look for meshes first.
        tool: Frame to add.
        payload: Body to add.
        gravity: Acceleration of gravity [m/s²]: a vector, or g for (0, 0, −g); by default 9.81 downwards.

    Raises:
        RobotError: The file cannot be used, or its model cannot be controlled.
        UnknownNameError: No such robot, joint or frame; names what is near.
        InputError: An argument is no number, or out of its range.
    """
    tool, payload = _made(Tool, tool), _made(Payload, payload)
    folders = [Path(os.path.abspath(folder)) for folder in package_dirs]
    # A chain may end at the tool, which is not there yet.
    end = tool.frame if tool is not None and chain_to == tool.name else ""
    if branch_to and not chain_to:
        raise InputError(f"branch_to={branch_to!r} does not apply: all joints are kept; give chain_to, too")
    read = (_read_mjcf if _is_mjcf(source) else _read_urdf)(source, lock, chain_to, end or chain_to, folders, branch_to)
    if tool is not None:
        _add_frame(read.model, tool.name, tool.frame, pin.SE3(np.asarray(tool.placement)), pin.Inertia.Zero())
    if payload is not None:
        _add_frame(read.model, "payload", payload.frame, pin.SE3.Identity(), payload.spatial)
    options: dict[str, Any] = {
        "lock": {name: x if x is None else float(x) for name, x in lock.items()}
        if isinstance(lock, Mapping)
        else _names(lock),
        "chain_to": read.chain_to,
        "branch_to": branch_to,
        "package_dirs": [str(folder) for folder in folders],
        "tool": tool and tool.as_dict(),
        "payload": payload and payload.as_dict(),
    }
    robot = (CoupledRobot if coordinates_of(read.model).coupled else Robot)(
        read.model,
        name=read.name,
        source=read.source,
        options={key: value for key, value in options.items() if value},
        urdf_sha256=read.sha256,
        notes=read.notes,
        mimics=read.mimics,
        shapes=read.shapes,
    )
    return robot if gravity is None else robot.with_gravity(gravity)


@checked
def leaf_frames(robot: Robot) -> tuple[str, ...]:
    """Frames that carry no other: the ends of all branches."""
    return leaves_of(robot.model)


@checked
def default_frame(robot: Robot) -> str:
    """The frame that is most likely meant: the end of the loaded chain, or of the longest arm."""
    return str(robot.options.get("chain_to") or default_frame_of(robot.model, robot.mimics))


# -- arguments ---------------------------------------------------------------------------------------------------


class _Description(NamedTuple):
    """Description of a robot by a file; `source` is a name by which it is found again."""

    model: pin.Model
    name: str
    source: str
    sha256: str
    chain_to: str
    notes: tuple[str, ...]
    mimics: Mapping[str, str]
    shapes: Shapes | None


def _read_urdf(source: Source, lock: Lock, chain_to: str, end: str, folders: list[Path], branch: str) -> _Description:
    """Description by a URDF, of the joints that are not locked and are on the way to `end` or `branch`."""
    urdf, canonical = _read(source)
    urdf = without_planar(urdf, lock if isinstance(lock, Mapping) else _names(lock))
    mimics = {joint.name: joint.mimics for joint in urdf.joints.values() if joint.mimics}
    if chain_to == "auto":
        chain_to = end = default_frame_of(_build(urdf, urdf.rewritten({})), mimics)
    locked = _locked(urdf, lock, *filter(None, (end, branch)))
    notes = urdf.notes + _check_joints(urdf, locked, is_chain=bool(chain_to))
    # Off a chain, joints that should follow others move on their own.
    followers = followers_in(urdf.joints, [name for name in urdf.moving if name not in locked]) if chain_to else {}
    root = urdf.rewritten(locked, followers)
    model = _build(urdf, root)
    notes += oddities(model, chain_to) + resolve_shapes(root, urdf.path, folders)
    shapes = Shapes(etree.tostring(root, encoding="unicode"))
    return _Description(model, urdf.name, canonical, urdf.sha256, chain_to, notes, mimics, shapes)


def _is_mjcf(source: Source) -> bool:
    return isinstance(source, (str, os.PathLike)) and str(source).endswith(".xml") and is_mjcf(Path(source))


def _read_mjcf(source: Source, lock: Lock, chain_to: str, end: str, folders: list[Path], branch: str) -> _Description:
    """Description by an MJCF file, likewise."""
    refuse_unused(load_robot, "an MJCF file is read to one frame; lock joints by name instead", branch_to=branch)
    path = Path(os.path.abspath(os.path.expanduser(str(source))))
    reason = "meshes of an MJCF file are not read; leave it out"
    refuse_unused(load_robot, reason, package_dirs=tuple(map(str, folders)))
    model, sha256 = read_mjcf(path)
    if chain_to == "auto":
        chain_to = end = default_frame_of(model, {})
    model = locked_model(model, lock if isinstance(lock, Mapping) else dict.fromkeys(_names(lock)), end)
    notes = (NO_SHAPES, *oddities(model, chain_to))
    return _Description(model, model.name, str(path), sha256, chain_to, notes, {}, None)


def _read(source: Source) -> tuple[Urdf, str]:
    """The URDF, and a name by which it is found again: a name, an absolute path, or its text."""
    if isinstance(source, bytes) or (isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")):
        return read_urdf_text(source)
    if not isinstance(source, (str, os.PathLike)):
        raise InputError(
            f"a robot is given by name, path or text of a URDF, got {type(source).__name__}; of a pin.Model make "
            "Robot.from_pinocchio(model), of a module of robot_descriptions load its URDF_PATH or MJCF_PATH"
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
        known = ", ".join(field.name for field in fields(kind))  # type: ignore[arg-type]
        raise InputError(f"no {kind.__name__} can be made from {dict(value)!r}; it has {known}") from error


def _names(lock: str | Sequence[str]) -> list[str]:
    names = [lock] if isinstance(lock, str) else list(lock)
    for name in names:
        if not isinstance(name, str):
            raise InputError(f"joints to lock are given by name, got {name!r}")
    return names


def _locked(urdf: Urdf, lock: Lock, *frames: str) -> dict[str, float]:
    """Position of every joint held fixed: by `lock`, by its limits, or because it is on no way to `frames`."""
    given = dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(_names(lock))
    chain = [name for frame in frames for name in urdf.chain(frame)] if frames else urdf.moving
    kept = {name for name in chain if not urdf.joints[name].stuck}
    followers = followers_in(urdf.joints, kept.difference(given)) if frames else {}
    kept |= {follower.leader for follower in followers.values() if urdf.joints[follower.leader].kind != "fixed"}
    locked = {name: _position(urdf, name, given.get(name)) for name in (*given, *set(urdf.moving).difference(kept))}
    for name, (leader, factor, offset) in followers.items():
        if leader in locked or urdf.joints[leader].kind == "fixed" or factor == 0.0:
            # It follows one that does not move.
            locked[name] = _position(urdf, name, factor * locked.get(leader, 0.0) + offset)
    return locked


def _position(urdf: Urdf, name: str, value: float | None) -> float:
    """Position at which a joint is locked: `value`, or as near to 0 as it can be."""
    if name not in urdf.moving:
        raise UnknownNameError("joint that moves", name, urdf.moving)
    joint = urdf.joints[name]
    if not joint.has_one_degree and value:
        raise InputError(f"joint {name!r} is {joint.kind}; it can be locked at 0 only, got {value!r}")
    lower, upper = (-np.inf, np.inf) if joint.unlimited else (joint.lower, joint.upper)
    return locked_at(name, value, lower, upper)


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
                f"{where} is {joint.kind}; eos_pin controls revolute, continuous, prismatic and planar joints. "
                "Lock it, or load the chain to one frame"
            )
        if joint.mimics and is_chain:
            notes.add(f"follows {joint.mimics!r} and has no torque of its own: @", joint.name)
        elif joint.mimics:
            notes.add(f"should mimic {joint.mimics!r}, and moves on its own here: @", joint.name)
        if joint.kind != "continuous" and joint.unlimited and not any(joint.name in note for note in urdf.notes):
            notes.add("limits of 0 to 0 are taken for none: @", joint.name)
    return notes.sentences()


def _build(urdf: Urdf, root: etree._Element) -> pin.Model:
    """Pinocchio's model of a checked description, without shapes, which could be damaged."""
    bare = copy.deepcopy(root)
    etree.strip_elements(bare, "visual", "collision", "material", with_tail=False)
    with quiet() as said:
        try:
            return pin.buildModelFromXML(etree.tostring(bare, encoding="unicode"), mimic=True)
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
    """A pose as matrix, from any accepted form."""
    if isinstance(value, pin.SE3):
        return frozen_copy(value.homogeneous)
    matrix = as_floats(value, "a placement")
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
