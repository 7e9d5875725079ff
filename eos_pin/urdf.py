"""Read a URDF that nobody vouches for: safely, with line numbers in every complaint, and into the form Pinocchio needs.

The parser resolves no entity, opens no other file and no connection. What Pinocchio's own parser would refuse with a
line on the terminal, or accept and get wrong, is checked or rewritten here first: joints that are locked, continuous
joints, missing limits, meshes that are not there.
"""

from __future__ import annotations

import copy
import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from eos_pin.errors import RobotError, UnknownNameError, suggest

#: A URDF is text about some hundred parts; more than this is something else [bytes].
LARGEST_FILE = 64 * 2**20
#: Links in a row. The parser behind Pinocchio calls itself for each, and overflows the stack between 3000 and 5000.
DEEPEST_TREE = 2000
#: Position limit that stands for none; `Robot.lower` and `Robot.upper` show it as infinite.
UNLIMITED = 1e30

MOVING = ("revolute", "continuous", "prismatic")
OTHER = ("fixed", "floating", "planar")


@dataclass(frozen=True)
class UrdfJoint:
    """One `<joint>` of a URDF: what connects which links, and how far it moves [rad or m]."""

    name: str
    kind: str
    parent: str
    child: str
    axis: tuple[float, ...]
    lower: float
    upper: float
    velocity: float
    effort: float
    mimics: str
    line: int

    @property
    def moves(self) -> bool:
        """Whether a lock can hold it at another value than zero."""
        return self.kind in MOVING

    @property
    def unlimited(self) -> bool:
        """Without limits: continuous, or limits that leave no room because nobody filled them in."""
        return self.kind == "continuous" or self.lower == self.upper == 0.0


@dataclass(frozen=True, eq=False)
class Urdf:
    """A URDF whose structure has been checked; made by `read_urdf`.

    Attributes:
        path: The file.
        sha256: Hash of its bytes.
        root: Its `<robot>` element; treat it as read-only.
        joints: Its joints by name.
    """

    path: Path
    sha256: str
    root: etree._Element
    joints: Mapping[str, UrdfJoint]

    @cached_property
    def name(self) -> str:
        """Name of the robot."""
        return str(self.root.get("name"))

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """Names of all joints that are not fixed."""
        return tuple(name for name, joint in self.joints.items() if joint.kind != "fixed")

    def chain(self, frame: str) -> tuple[str, ...]:
        """Names of the joints that are not fixed between the base and `frame`, a link or a joint.

        Raises:
            UnknownNameError: The file has no such link or joint.
        """
        to_parent = {joint.child: joint for joint in self.joints.values()}
        links = [str(link.get("name")) for link in self.root.findall("link")]
        if frame in links:
            joint = to_parent.get(frame)
        elif frame in self.joints:
            joint = self.joints[frame]
        else:
            raise UnknownNameError("frame", frame, links + list(self.joints))
        found = []
        while joint is not None:
            if joint.kind != "fixed":
                found.append(joint.name)
            joint = to_parent.get(joint.parent)
        return tuple(reversed(found))

    def rewritten(self, locked: Mapping[str, float]) -> etree._Element:
        """Copy of the `<robot>` element in which `locked` joints are fixed at a value and continuous ones revolute.

        A fixed joint loses nothing: link, shapes, inertia and frames stay where they are. A revolute joint without
        limits is what makes q a plain vector; Pinocchio's own continuous joint has a sine and a cosine in it.
        """
        root = copy.deepcopy(self.root)
        for element in root.findall("joint"):
            joint = self.joints[element.get("name")]
            for tag in ("mimic", "safety_controller", "calibration", "limit"):
                _drop(element, tag)
            if joint.name in locked:
                _lock(element, joint, locked[joint.name])
            elif joint.moves:
                element.set("type", "prismatic" if joint.kind == "prismatic" else "revolute")
                lower, upper = (-UNLIMITED, UNLIMITED) if joint.unlimited else (joint.lower, joint.upper)
                limit = {"lower": lower, "upper": upper, "effort": joint.effort, "velocity": joint.velocity}
                clipped = {
                    key: repr(float(np.clip(value, -UNLIMITED, UNLIMITED))) for key, value in limit.items()
                }
                etree.SubElement(element, "limit", clipped)
        return root


def _lock(element: etree._Element, joint: UrdfJoint, value: float) -> None:
    """Turn a joint into a fixed one at position `value`."""
    element.set("type", "fixed")
    for tag in ("axis", "dynamics"):
        _drop(element, tag)
    if value == 0.0:
        return
    origin = element.find("origin")
    if origin is None:
        origin = etree.SubElement(element, "origin")
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    motion = pin.SE3.Identity()
    if joint.kind == "prismatic":
        motion.translation = axis * value
    else:
        motion.rotation = pin.exp3(axis * value)
    placement = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz) * motion
    origin.set("xyz", _text(placement.translation))
    origin.set("rpy", _text(pin.rpy.matrixToRpy(placement.rotation)))


def _drop(element: etree._Element, tag: str) -> None:
    for child in element.findall(tag):
        element.remove(child)


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


# -- reading -----------------------------------------------------------------------------------------------------


def read_urdf(path: Path) -> Urdf:
    """Read and check a URDF file.

    Raises:
        RobotError: The file cannot be read, is not a URDF, or describes no tree of links; with the line where known.
    """
    content = _read(path)
    root = _parse(path, content)
    checker = Checker(path)
    joints = checker.robot(root)
    return Urdf(path, hashlib.sha256(content).hexdigest(), root, joints)


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            inside = ", ".join(sorted(file.name for file in path.glob("*.urdf"))[:8])
            hint = f"it holds {inside}" if inside else "it holds no .urdf itself"
            raise RobotError(f"{path} is a folder, not a URDF file; {hint}")
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


def _parse(path: Path, content: bytes) -> etree._Element:
    """Root element, parsed so that the file can neither reach other files nor grow."""
    safe = {"resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False}
    tidy = {"remove_comments": True, "remove_pis": True}
    try:
        root = etree.fromstring(content, etree.XMLParser(**safe, **tidy))
    except etree.XMLSyntaxError as error:
        problems = error.error_log
        # Plugins of simulators use prefixes they do not declare; those parts are of no interest here.
        if not problems or any(problem.type_name != "NS_ERR_UNDEFINED_NAMESPACE" for problem in problems):
            raise RobotError(f"{path} line {error.lineno}: not well-formed XML: {error.msg}") from error
        root = etree.fromstring(content, etree.XMLParser(**safe, **tidy, recover=True))
    if root.getroottree().docinfo.doctype:
        raise RobotError(
            f"{path} has a <!DOCTYPE>, which can define entities and pull in other files; eos_pin refuses it. "
            "A URDF needs none: remove it"
        )
    namespace = etree.QName(root).namespace
    for element in root.iter(f"{{{namespace}}}*" if namespace else ()):
        element.tag = etree.QName(element).localname
    return root


class Checker:
    """The structural checks of one file; every complaint names file and line."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fail(self, element: etree._Element, problem: str) -> RobotError:
        return RobotError(f"{self.path} line {element.sourceline}: {problem}")

    def robot(self, root: etree._Element) -> dict[str, UrdfJoint]:
        if root.tag != "robot":
            raise self.fail(root, f"the root element is <{root.tag}>; that of a URDF is <robot>")
        self.no_xacro(root)
        if not root.get("name"):
            raise self.fail(root, 'the <robot> has no name; write <robot name="...">')
        links = self.named(root, "link")
        if not links:
            raise self.fail(root, "the robot has no <link>")
        for link in links.values():
            self.link(link)
        joints = {name: self.joint(element, links) for name, element in self.named(root, "joint").items()}
        self.tree(root, list(links), joints)
        return joints

    def no_xacro(self, root: etree._Element) -> None:
        for element in root.iter(etree.Element):
            macro = "xacro" in (etree.QName(element).namespace or "")
            if macro or any("${" in value or "$(" in value for value in element.values()):
                raise self.fail(
                    element, "this is a xacro file; run `xacro FILE > robot.urdf` first and load the result"
                )

    def named(self, root: etree._Element, tag: str) -> dict[str, etree._Element]:
        found: dict[str, etree._Element] = {}
        for element in root.findall(tag):
            name = element.get("name")
            if not name:
                raise self.fail(element, f"a <{tag}> has no name")
            if name in found:
                raise self.fail(
                    element, f"{tag} {name!r} is defined twice, first in line {found[name].sourceline}"
                )
            found[name] = element
        return found

    def link(self, link: etree._Element) -> None:
        inertial = link.find("inertial")
        if inertial is None:
            return
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        if mass is None or inertia is None:
            missing = "mass" if mass is None else "inertia"
            raise self.fail(inertial, f"the <inertial> of link {link.get('name')!r} has no <{missing}>")
        self.origin(inertial)
        if self.number(mass, "value") < 0.0:
            raise self.fail(mass, f"link {link.get('name')!r} has a negative mass")
        for key in ("ixx", "iyy", "izz"):
            self.number(inertia, key)
        for key in ("ixy", "ixz", "iyz"):
            inertia.set(key, repr(self.number(inertia, key, 0.0)))

    def joint(self, element: etree._Element, links: Mapping[str, etree._Element]) -> UrdfJoint:
        name, kind = element.get("name"), element.get("type")
        if kind not in MOVING + OTHER:
            raise self.fail(
                element, f"joint {name!r} has type {kind!r}; a URDF knows {', '.join(MOVING + OTHER)}"
            )
        ends = {}
        for tag in ("parent", "child"):
            end = element.find(tag)
            if end is None:
                raise self.fail(element, f"joint {name!r} has no <{tag}>")
            ends[tag] = end.get("link", "")
            if ends[tag] not in links:
                near = suggest(ends[tag], tuple(links), most=10)
                raise self.fail(
                    end, f"the {tag} of joint {name!r} is link {ends[tag]!r}, which does not exist. {near}"
                )
        self.origin(element)
        axis = element.find("axis")
        direction = (1.0, 0.0, 0.0) if axis is None else self.numbers(axis, "xyz", 3)
        if kind in MOVING and not any(direction):
            raise self.fail(element, f"the axis of joint {name!r} is zero")
        dynamics = element.find("dynamics")
        for key in ("damping", "friction") if dynamics is not None else ():
            self.number(dynamics, key, 0.0)
        limit = element.find("limit")
        if limit is None and kind in ("revolute", "prismatic"):
            raise self.fail(
                element,
                f"joint {name!r} is {kind} but has no <limit>; give it one, or type continuous if it turns freely",
            )
        lower, upper, velocity, effort = (
            0.0 if limit is None else self.number(limit, key, 0.0, infinite=True)
            for key in ("lower", "upper", "velocity", "effort")
        )
        if lower > upper:
            raise self.fail(
                element, f"joint {name!r} has a lower limit, {lower:g}, above its upper limit, {upper:g}"
            )
        mimic = element.find("mimic")
        mimics = "" if mimic is None else mimic.get("joint", "")
        return UrdfJoint(
            name, kind, ends["parent"], ends["child"], direction, lower, upper, velocity, effort, mimics,
            element.sourceline or 0,
        )  # fmt: skip

    def origin(self, element: etree._Element) -> None:
        origin = element.find("origin")
        for key in ("xyz", "rpy") if origin is not None else ():
            if key in origin.attrib:
                self.numbers(origin, key, 3)

    def number(
        self, element: etree._Element, key: str, default: float | None = None, *, infinite: bool = False
    ) -> float:
        if default is not None and key not in element.attrib:
            return default
        return self.numbers(element, key, 1, infinite=infinite)[0]

    def numbers(
        self, element: etree._Element, key: str, count: int, *, infinite: bool = False
    ) -> tuple[float, ...]:
        """Numbers of an attribute, which is also written back in the plain form every parser reads."""
        text = element.get(key)
        if text is None:
            raise self.fail(element, f"<{element.tag}> has no {key}")
        try:
            values = tuple(float(part) for part in text.split())
        except ValueError:
            values = ()
        if len(values) != count or any(math.isnan(x) or (math.isinf(x) and not infinite) for x in values):
            wanted = "a number" if count == 1 else f"{count} numbers"
            raise self.fail(element, f'{key}="{text}" of <{element.tag}> is not {wanted}')
        element.set(key, _text(values))
        return values

    def tree(self, root: etree._Element, links: Sequence[str], joints: Mapping[str, UrdfJoint]) -> None:
        """Every link hangs on one parent, and all hang on one root."""
        children = Counter(joint.child for joint in joints.values())
        for link, count in children.items():
            if count > 1:
                names = ", ".join(joint.name for joint in joints.values() if joint.child == link)
                raise self.fail(
                    root, f"link {link!r} is the child of {count} joints ({names}); it may have one parent"
                )
        roots = [link for link in links if link not in children]
        if len(roots) > 1:
            raise self.fail(
                root, f"the links have {len(roots)} roots, {', '.join(roots[:8])}; join them by fixed joints"
            )
        below: dict[str, list[str]] = {}
        for joint in joints.values():
            below.setdefault(joint.parent, []).append(joint.child)
        depth = dict.fromkeys(roots, 0)
        open_ends = list(roots)
        while open_ends:
            link = open_ends.pop()
            for child in below.get(link, ()):
                depth[child] = depth[link] + 1
                open_ends.append(child)
        cyclic = [link for link in links if link not in depth]
        if cyclic:
            raise self.fail(root, f"links {', '.join(cyclic[:8])} form a closed loop; a URDF is a tree")
        if max(depth.values()) > DEEPEST_TREE:
            raise self.fail(
                root,
                f"{max(depth.values())} joints in a row are more than {DEEPEST_TREE}, the most that can be read",
            )
