"""Read a URDF that nobody vouches for: safely, naming file and line, and into the form Pinocchio needs.

The parser resolves no entity, and opens no other file and no connection. What Pinocchio's own parser would refuse
with a line on the terminal, or accept and get wrong, is checked or rewritten here first.
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
#: Links in a row: Pinocchio's parser calls itself for each of them, and its stack overflows beyond 3000.
DEEPEST_TREE = 2000
#: Numbers from here on count as infinite, as they do in `Robot.lower` and `Robot.upper`.
UNLIMITED = 1e30

ONE_DEGREE = ("revolute", "continuous", "prismatic")
KINDS = (*ONE_DEGREE, "fixed", "floating", "planar")


@dataclass(frozen=True)
class UrdfJoint:
    """A `<joint>`: which links it connects, and how far it moves [rad or m]."""

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
    def has_one_degree(self) -> bool:
        """Whether one number says where it stands."""
        return self.kind in ONE_DEGREE

    @property
    def unlimited(self) -> bool:
        """Without limits: continuous, or with limits of 0 to 0 because nobody filled them in."""
        return self.kind == "continuous" or self.lower == self.upper == 0.0

    @property
    def stuck(self) -> bool:
        """Whether its limits leave it no room."""
        return self.has_one_degree and not self.unlimited and self.lower == self.upper


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

    def rewritten(self, locked: Mapping[str, float]) -> etree._Element:
        """Copy of the `<robot>` in which `locked` joints are fixed at a position and continuous ones revolute.

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
                lower, upper = (-UNLIMITED, UNLIMITED) if joint.unlimited else (joint.lower, joint.upper)
                limit = {"lower": lower, "upper": upper, "effort": joint.effort, "velocity": joint.velocity}
                # Its parser knows no infinity.
                finite = {key: _text([np.clip(value, -UNLIMITED, UNLIMITED)]) for key, value in limit.items()}
                etree.SubElement(element, "limit", finite)
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
        RobotError: The file cannot be read, is no URDF, or describes no tree of links.
    """
    content = _read(path)
    root = _parse(path, content)
    return Urdf(path, hashlib.sha256(content).hexdigest(), root, Checker(path).joints(root))


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


def _parse(path: Path, content: bytes) -> etree._Element:
    """Root element, parsed so that the file can neither reach other files nor grow."""
    options = {
        "resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False,
        "remove_comments": True, "remove_pis": True,
    }  # fmt: skip
    parser = etree.XMLParser(**options)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        # Plugins of simulators use prefixes nobody declares; those parts are of no interest here.
        if any(problem.type_name != "NS_ERR_UNDEFINED_NAMESPACE" for problem in parser.error_log):
            raise RobotError(f"{path} line {error.lineno}: not well-formed XML: {error.msg}") from error
        root = etree.fromstring(content, etree.XMLParser(**options, recover=True))
    if root.getroottree().docinfo.doctype:
        raise RobotError(
            f"{path} has a <!DOCTYPE>, which can define entities and pull in other files; eos_pin refuses it. "
            "A URDF needs none: remove it"
        )
    namespace, brace, _ = root.tag.rpartition("}")
    for element in root.iter(f"{namespace}}}*") if brace else ():
        element.tag = element.tag.removeprefix(namespace + brace)
    return root


class Checker:
    """The checks of one file; every complaint is a `RobotError` that names file and line.

    Numbers that pass are written back in the plain form every parser reads.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def fail(self, element: etree._Element, problem: str) -> RobotError:
        """What to raise because of `element`."""
        return RobotError(f"{self.path} line {element.sourceline}: {problem}")

    def joints(self, root: etree._Element) -> dict[str, UrdfJoint]:
        """Check all that dynamics needs; the joints by name."""
        if root.tag != "robot":
            raise self.fail(root, f"the root element is <{root.tag}>; that of a URDF is <robot>")
        self._no_xacro(root)
        if not root.get("name"):
            raise self.fail(root, 'the <robot> has no name; write <robot name="...">')
        links = self._by_name(root, "link")
        if not links:
            raise self.fail(root, "the robot has no <link>")
        for link in links.values():
            self._link(link)
        joints = {name: self._joint(element, links) for name, element in self._by_name(root, "joint").items()}
        self._tree(root, list(links), joints)
        return joints

    def origin(self, element: etree._Element) -> None:
        """Check the placement of `element`, if it has one."""
        origin = element.find("origin")
        for key in ("xyz", "rpy") if origin is not None else ():
            if key in origin.attrib:
                self.numbers(origin, key, 3)

    def numbers(self, element: etree._Element, key: str, count: int, *, infinite: bool = False) -> tuple[float, ...]:
        """The `count` numbers of an attribute."""
        text = element.get(key)
        if text is None:
            raise self.fail(element, f"<{element.tag}> has no {key}")
        try:
            values = tuple(float(part) for part in text.split())
        except ValueError:
            values = ()
        if len(values) != count or any(math.isnan(x) or (abs(x) >= UNLIMITED and not infinite) for x in values):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            raise self.fail(element, f'{key}="{text}" of <{element.tag}> is not {wanted}')
        element.set(key, _text(values))
        return values

    def _number(self, element: etree._Element, key: str, default: float, *, infinite: bool = False) -> float:
        return self.numbers(element, key, 1, infinite=infinite)[0] if key in element.attrib else default

    def _no_xacro(self, root: etree._Element) -> None:
        for element in root.iter(etree.Element):
            if "xacro" in element.tag or any("${" in value or "$(" in value for value in element.values()):
                raise self.fail(element, "this is a xacro file; run `xacro FILE > robot.urdf` and load the result")

    def _by_name(self, root: etree._Element, tag: str) -> dict[str, etree._Element]:
        found: dict[str, etree._Element] = {}
        for element in root.findall(tag):
            name = element.get("name")
            if not name:
                raise self.fail(element, f"a <{tag}> has no name")
            if name in found:
                raise self.fail(element, f"{tag} {name!r} is defined twice, first in line {found[name].sourceline}")
            found[name] = element
        return found

    def _link(self, link: etree._Element) -> None:
        inertial = link.find("inertial")
        if inertial is None:
            return
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        if mass is None or inertia is None:
            missing = "mass" if mass is None else "inertia"
            raise self.fail(inertial, f"the <inertial> of link {link.get('name')!r} has no <{missing}>")
        self.origin(inertial)
        if self.numbers(mass, "value", 1)[0] < 0.0:
            raise self.fail(mass, f"link {link.get('name')!r} has a negative mass")
        for key in ("ixx", "iyy", "izz"):
            self.numbers(inertia, key, 1)
        for key in ("ixy", "ixz", "iyz"):
            inertia.set(key, _text([self._number(inertia, key, 0.0)]))

    def _joint(self, element: etree._Element, links: Mapping[str, etree._Element]) -> UrdfJoint:
        name, kind = element.get("name"), element.get("type")
        if kind not in KINDS:
            raise self.fail(element, f"joint {name!r} has type {kind!r}; a URDF knows {', '.join(KINDS)}")
        parent, child = (self._end(element, tag, links) for tag in ("parent", "child"))
        self.origin(element)
        axis = element.find("axis")
        direction = (1.0, 0.0, 0.0) if axis is None else self.numbers(axis, "xyz", 3)
        if kind in ONE_DEGREE and not any(direction):
            raise self.fail(element, f"the axis of joint {name!r} is zero")
        dynamics = element.find("dynamics")
        for key in ("damping", "friction") if dynamics is not None else ():
            self._number(dynamics, key, 0.0)
        limit = element.find("limit")
        if limit is None and kind in ("revolute", "prismatic"):
            raise self.fail(element, f"joint {name!r} is {kind} but has no <limit>; add one, or make it continuous")
        lower, upper, velocity, effort = (
            0.0 if limit is None else self._number(limit, key, 0.0, infinite=True)
            for key in ("lower", "upper", "velocity", "effort")
        )
        if lower > upper:
            raise self.fail(element, f"joint {name!r} has a lower limit, {lower:g}, above its upper, {upper:g}")
        mimic = element.find("mimic")
        mimics = "" if mimic is None else mimic.get("joint", "")
        line = element.sourceline or 0
        return UrdfJoint(name, kind, parent, child, direction, lower, upper, velocity, effort, mimics, line)

    def _end(self, joint: etree._Element, tag: str, links: Mapping[str, etree._Element]) -> str:
        """Link at one end of a joint."""
        name = joint.get("name")
        element = joint.find(tag)
        if element is None:
            raise self.fail(joint, f"joint {name!r} has no <{tag}>")
        link = str(element.get("link", ""))
        if link not in links:
            near = suggest(link, tuple(links), most=10)
            raise self.fail(element, f"the {tag} of joint {name!r}, {link!r}, is no link of this file. {near}")
        return link

    def _tree(self, root: etree._Element, links: Sequence[str], joints: Mapping[str, UrdfJoint]) -> None:
        """Every link hangs on one parent, and all hang on one root."""
        for link, count in Counter(joint.child for joint in joints.values()).items():
            if count > 1:
                names = ", ".join(joint.name for joint in joints.values() if joint.child == link)
                raise self.fail(root, f"link {link!r} is the child of {count} joints ({names}) instead of one")
        children: dict[str, list[str]] = {link: [] for link in links}
        for joint in joints.values():
            children[joint.parent].append(joint.child)
        roots = sorted(set(links).difference(*children.values()), key=links.index)
        if len(roots) > 1:
            raise self.fail(root, f"the links have {len(roots)} roots, {', '.join(roots[:8])}; a tree has one")
        depth = dict.fromkeys(roots, 0)
        ends = list(roots)
        while ends:
            parent = ends.pop()
            depth.update(dict.fromkeys(children[parent], depth[parent] + 1))
            ends += children[parent]
        cyclic = [link for link in links if link not in depth]
        if cyclic:
            raise self.fail(root, f"links {', '.join(cyclic[:8])} form a closed loop; a URDF is a tree")
        deepest = max(depth.values())
        if deepest > DEEPEST_TREE:
            raise self.fail(root, f"{deepest} links hang in a row; at most {DEEPEST_TREE} can be read")
