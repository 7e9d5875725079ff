"""The checks of a URDF: every complaint names file, line, and joint or link; odd but harmless parts leave a note."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from lxml import etree

from eos_pin.errors import RobotError, suggest
from eos_pin.robot.notes import Notes

#: Links in a row: Pinocchio's parser calls itself for each of them, and its stack overflows beyond 3000.
DEEPEST_TREE = 2000
#: Numbers from here on count as infinite, as they do in `Robot.lower` and `Robot.upper`.
UNLIMITED = 1e30

ONE_DEGREE = ("revolute", "continuous", "prismatic")
KINDS = (*ONE_DEGREE, "fixed", "floating", "planar")
#: Note about an axis or position limits of a joint whose kind has none.
MEANINGLESS = "{}, so that its axis or limits in the file mean nothing, and are not used: @"
#: What xacro defines things with; without a use they have no meaning.
XACRO_DEFINITIONS = ("property", "arg", "macro")
#: Parts of links and joints on which no motion depends.
UNUSED = {"visual", "collision", "safety_controller", "calibration"}


@dataclass(frozen=True)
class UrdfJoint:
    """A `<joint>`: the links that it connects, and its range [rad or m]."""

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
    multiplier: float
    offset: float
    line: int

    @property
    def has_one_degree(self) -> bool:
        """Whether the joint has one degree of freedom."""
        return self.kind in ONE_DEGREE

    @property
    def unlimited(self) -> bool:
        """Whether the joint has no limits: it is continuous, or its limits are 0 and 0, which means not given."""
        return self.kind == "continuous" or self.lower == self.upper == 0.0

    @property
    def stuck(self) -> bool:
        """Whether its limits leave it no room."""
        return self.has_one_degree and not self.unlimited and self.lower == self.upper


def _in_order(limits: Sequence[str]) -> bool:
    """Whether limits are numbers, the lower one not above the upper."""
    try:
        values = [float(text) for text in limits]
    except ValueError:
        return False
    return all(low <= high for low, high in pairwise(values))


def plain(values: Sequence[float] | np.ndarray) -> str:
    """Numbers as every parser reads them."""
    return " ".join(repr(float(value)) for value in values)


class Checker:
    """The checks of one file; every complaint is a `RobotError` that names file, line, and the joint or link.

    Numbers that pass are written back in the plain form every parser reads.
    """

    def __init__(self, path: Path, notes: Notes | None = None) -> None:
        self.path, self.notes = path, notes or Notes()

    def fail(self, element: etree._Element, problem: str) -> RobotError:
        """Error about `element`."""
        owner = next((e for e in (element, *element.iterancestors()) if e.tag in ("joint", "link")), None)
        name = None if owner is None else owner.get("name")
        of = f", in {owner.tag} {name!r}" if owner is not None and name and repr(name) not in problem else ""
        return RobotError(f"{self.path} line {element.sourceline}: {problem}{of}")

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
        element.set(key, plain(values))
        return values

    def _number(self, element: etree._Element, key: str, default: float, *, infinite: bool = False) -> float:
        return self.numbers(element, key, 1, infinite=infinite)[0] if key in element.attrib else default

    def _no_xacro(self, root: etree._Element) -> None:
        """Refuse placeholders that xacro would have to fill in; drop the elements that it has left behind."""
        for element in list(root.iter(etree.Element)):
            prefix, _, tag = element.tag.replace("}", ":").rpartition(":")
            parent = element.getparent()
            if "xacro" in prefix and tag in XACRO_DEFINITIONS and parent is not None:
                parent.remove(element)
                self.notes.add("left over from xacro, and not used: @", f"<xacro:{tag}>")
            elif "xacro" in prefix:
                raise self.fail(element, "this is a xacro file; run `xacro FILE > robot.urdf` and load the result")
            for key, value in element.items():
                if "xacro" in key.replace("}", ":").rpartition(":")[0]:
                    del element.attrib[key]
                    self.notes.add("left over from xacro, and not used: @", f"attributes of <{element.tag}>")
                elif "${" in value or "$(" in value:
                    self._unfilled(element, key, value)

    def _unfilled(self, element: etree._Element, key: str, value: str) -> None:
        """Refuse a value that xacro was to fill in, unless nothing depends on it."""
        tags = [element.tag, *(above.tag for above in element.iterancestors())]
        if "robot" not in tags:
            return  # part of a definition that has been removed
        used = len(tags) == 1 or (tags[-2] in ("link", "joint") and not UNUSED.intersection(tags))
        if used:
            problem = f'{key}="{value}" of <{element.tag}> is for xacro to fill in'
            raise self.fail(element, f"{problem}; run `xacro FILE > robot.urdf` and load the result")
        if not {"visual", "collision"}.intersection(tags):
            self.notes.add("left over from xacro, and not used: @", f"values of <{element.tag}>")

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
            inertia.set(key, plain([self._number(inertia, key, 0.0)]))

    def _joint(self, element: etree._Element, links: Mapping[str, etree._Element]) -> UrdfJoint:
        name, kind = element.get("name"), element.get("type")
        if kind not in KINDS:
            raise self.fail(element, f"joint {name!r} has type {kind!r}; a URDF has {', '.join(KINDS)}")
        parent, child = (self._end(element, tag, links) for tag in ("parent", "child"))
        self.origin(element)
        axis = element.find("axis")
        if axis is not None and kind not in (*ONE_DEGREE, "planar"):
            if "xyz" not in axis.attrib:
                self.notes.add(MEANINGLESS.format(kind), str(name))
            element.remove(axis)
            axis = None
        if axis is not None and "xyz" not in axis.attrib:
            raise self.fail(axis, f'the <axis> of joint {name!r} has no xyz; write <axis xyz="..."/>')
        direction = (1.0, 0.0, 0.0) if axis is None else self.numbers(axis, "xyz", 3)
        if kind in ONE_DEGREE and not any(direction):
            raise self.fail(element, f"the axis of joint {name!r} is zero")
        dynamics = element.find("dynamics")
        for key in ("damping", "friction") if dynamics is not None else ():
            self._number(dynamics, key, 0.0)
        lower, upper = self._range(element, str(name), str(kind))
        velocity, effort = (self._bound(element, str(name), str(kind), key) for key in ("velocity", "effort"))
        mimic = element.find("mimic")
        mimics = "" if mimic is None else mimic.get("joint", "")
        multiplier = 1.0 if mimic is None else self._number(mimic, "multiplier", 1.0)
        offset = 0.0 if mimic is None else self._number(mimic, "offset", 0.0)
        line = element.sourceline or 0
        return UrdfJoint(
            name, kind, parent, child, direction, lower, upper, velocity, effort, mimics, multiplier, offset, line
        )

    def _range(self, joint: etree._Element, name: str, kind: str) -> tuple[float, float]:
        """Position limits; 0 to 0 stands for none."""
        limit = joint.find("limit")
        if kind not in ("revolute", "prismatic"):
            # A fixed joint often keeps the limits it had when it was not; only what is odd is worth a word.
            given = [] if limit is None else [limit.get(key, "0") for key in ("lower", "upper")]
            if not _in_order(given) or (kind == "continuous" and set(given) - {"0", "0.0"}):
                self.notes.add(MEANINGLESS.format(kind), name)
            return 0.0, 0.0
        if limit is None:
            raise self.fail(joint, f"joint {name!r} is {kind} but has no <limit>; add one, or make it continuous")
        lower, upper = (self._number(limit, key, 0.0, infinite=True) for key in ("lower", "upper"))
        if (lower, upper) == (1.0, 0.0):
            self.notes.add("limits of 1 to 0 are taken for none: @", name)
            return 0.0, 0.0
        if lower > upper:
            raise self.fail(joint, f"joint {name!r} has a lower limit, {lower:g}, above its upper, {upper:g}")
        return lower, upper

    def _bound(self, joint: etree._Element, name: str, kind: str, key: str) -> float:
        """Limit of velocity or effort; 0 stands for none."""
        limit = joint.find("limit")
        if limit is None or kind not in (*ONE_DEGREE, "planar"):
            return 0.0
        value = self._number(limit, key, 0.0, infinite=True)
        if value < 0.0:
            self.notes.add(f"{key} limits below 0 are taken for none: @", name)
        return max(value, 0.0)

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
            raise self.fail(root, f"its longest row of links has {deepest}; at most {DEEPEST_TREE} can be read")
