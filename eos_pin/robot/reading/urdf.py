"""Read an untrusted URDF: safely, naming file, line and joint, and into the form Pinocchio needs.

What Pinocchio's own parser would refuse with a line on the terminal, or accept and get wrong, is checked or rewritten
here first. Odd forms that other parsers read are read here as well, with a note.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from eos_pin.errors import RobotError, UnknownNameError
from eos_pin.robot.notes import Notes
from eos_pin.robot.reading.checking import UNLIMITED, Checker, UrdfJoint, plain
from eos_pin.robot.reading.markup import parse, text_of, undeclared
from eos_pin.robot.reading.mimic import Follower, limits_with

#: A URDF is text about some hundred parts; more than this is something else [bytes].
LARGEST_FILE = 64 * 2**20
#: How a URDF that is no file is called in messages.
TEXT = "the URDF text"


@dataclass(frozen=True, eq=False)
class Urdf:
    """A URDF whose structure has been checked; made by `read_urdf`.

    Attributes:
        path: The file; `TEXT` if it is none.
        sha256: Hash of its bytes.
        root: Its `<robot>` element; treat it as read-only.
        joints: Its joints by name.
        notes: Notes on parts of the file that were ignored or read as something else.
    """

    path: Path
    sha256: str
    root: etree._Element
    joints: Mapping[str, UrdfJoint]
    notes: tuple[str, ...] = ()

    @cached_property
    def name(self) -> str:
        """Name of the robot."""
        return str(self.root.get("name"))

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """Names of the joints that are not fixed."""
        return tuple(name for name, joint in self.joints.items() if joint.kind != "fixed")

    def chain(self, frame: str) -> tuple[str, ...]:
        """Names of the joints that are not fixed between the base and `frame`, a link or a joint.

        Raises:
            UnknownNameError: The file has no such link or joint.
        """
        above = {joint.child: joint for joint in self.joints.values()}
        links = [str(link.get("name")) for link in self.root.findall("link")]
        if frame not in links and frame not in self.joints:
            raise UnknownNameError("frame", frame, links + list(self.joints))
        joint = above.get(frame) if frame in links else self.joints[frame]
        names = []
        while joint is not None:
            names.append(joint.name)
            joint = above.get(joint.parent)
        return tuple(name for name in reversed(names) if self.joints[name].kind != "fixed")

    def rewritten(self, locked: Mapping[str, float], followers: Mapping[str, Follower] = {}) -> etree._Element:
        """Copy of the `<robot>` in which `locked` joints are fixed at a position and continuous ones revolute.

        Of other joints only `followers` follow.

        Fixing a joint in the description loses nothing: links, shapes, inertia and frames stay what they are.
        A revolute joint without limits keeps q a plain vector; Pinocchio's continuous joint has a sine and a
        cosine in it.
        """
        root = copy.deepcopy(self.root)
        for element in root.findall("joint"):
            joint = self.joints[element.get("name")]
            for tag in ("mimic", "safety_controller", "calibration", "limit"):
                _drop(element, tag)
            if joint.name in locked:
                _fix(element, joint, locked[joint.name])
            elif joint.has_one_degree:
                element.set("type", "prismatic" if joint.kind == "prismatic" else "revolute")
                limit = limits_with(joint, [(self.joints[name], f) for name, f in followers.items()])
                # Its parser knows no infinity.
                finite = {key: plain([np.clip(value, -UNLIMITED, UNLIMITED)]) for key, value in limit.items()}
                etree.SubElement(element, "limit", finite)
                if joint.name in followers:
                    leader, factor, offset = followers[joint.name]
                    numbers = {"multiplier": plain([factor]), "offset": plain([offset])}
                    etree.SubElement(element, "mimic", joint=leader, **numbers)
        return root


def _fix(element: etree._Element, joint: UrdfJoint, position: float) -> None:
    """Turn a `<joint>` into a fixed one that stands where `joint` is at `position`."""
    element.set("type", "fixed")
    for tag in ("axis", "dynamics"):
        _drop(element, tag)
    if position == 0.0:
        return
    origin = element.find("origin")
    if origin is None:
        origin = etree.SubElement(element, "origin")
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    motion = pin.SE3.Identity()
    if joint.kind == "prismatic":
        motion.translation = axis * position
    else:
        motion.rotation = pin.exp3(axis * position)
    placement = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz) * motion
    origin.set("xyz", plain(placement.translation))
    origin.set("rpy", plain(pin.rpy.matrixToRpy(placement.rotation)))


def _drop(element: etree._Element, tag: str) -> None:
    for child in element.findall(tag):
        element.remove(child)


# -- reading -----------------------------------------------------------------------------------------------------


def read_urdf(path: Path) -> Urdf:
    """Read and check a URDF file.

    Raises:
        RobotError: The file cannot be read, is no URDF, or describes no tree of links.
    """
    return _checked(path, _read(path))


def read_urdf_text(text: str | bytes) -> tuple[Urdf, str]:
    """Check a URDF that is no file; also its text, from which it can be read again.

    Raises:
        RobotError: It is no URDF, or describes no tree of links.
    """
    if isinstance(text, bytes):
        text = text_of(TEXT, text)
    text = undeclared(text)
    if len(text) > LARGEST_FILE:
        raise RobotError(f"{TEXT} is longer than {LARGEST_FILE // 2**20} million letters; that is no URDF")
    return _checked(Path(TEXT), text.encode(errors="replace")), text


def _checked(path: Path, content: bytes) -> Urdf:
    notes = Notes()
    root = parse(str(path), content, notes)
    namespace, brace, _ = root.tag.rpartition("}")
    for element in root.iter(f"{namespace}}}*") if brace else ():
        element.tag = element.tag.removeprefix(namespace + brace)
    joints = Checker(path, notes).joints(root)
    return Urdf(path, hashlib.sha256(content).hexdigest(), root, joints, notes.sentences())


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            inside = ", ".join(sorted(file.name for file in path.glob("*.urdf"))[:8])
            raise RobotError(f"{path} is a folder, not a URDF file; it holds {inside or 'no .urdf itself'}")
        if not path.exists():
            raise RobotError(f"there is no file {path}")
        if not path.is_file():
            raise RobotError(f"{path} is not a regular file")
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise RobotError(f"{path} cannot be read: {error}") from error
    if len(content) > LARGEST_FILE:
        raise RobotError(f"{path} is larger than {LARGEST_FILE // 2**20} MB; that is no URDF")
    if not content.strip():
        raise RobotError(f"{path} is empty")
    return content
