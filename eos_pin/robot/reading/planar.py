"""Planar joints of a URDF as three joints each: two prismatic ones along the plane, and the heading."""

from __future__ import annotations

import copy
from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pinocchio as pin
from lxml import etree

from eos_pin.robot.notes import Notes
from eos_pin.robot.reading.checking import UrdfJoint, plain
from eos_pin.robot.reading.urdf import Urdf


def without_planar(urdf: Urdf, kept: Collection[str]) -> Urdf:
    """The same URDF in which each planar joint `base` is `base_x`, `base_y` and `base_heading`.

    Its velocity and effort limits hold for each of the three. The plane is normal to the joint's axis; without an axis
    it is the x-y plane, as for most parsers, although the format's default axis is x.

    Args:
        urdf: The URDF.
        kept: Names of joints that stay as they are, to be locked.
    """
    planar = [joint for joint in urdf.joints.values() if joint.kind == "planar" and joint.name not in kept]
    if not planar:
        return urdf
    root, joints, notes = copy.deepcopy(urdf.root), dict(urdf.joints), Notes()
    elements = {element.get("name"): element for element in root.findall("joint")}
    for joint in planar:
        element = elements[joint.name]
        normal = np.array((0.0, 0.0, 1.0) if element.find("axis") is None else joint.axis)
        axes = _plane(normal / np.linalg.norm(normal))
        links = [joint.parent, *(_fresh(f"{joint.name}_{letter}_link", root) for letter in "xy"), joint.child]
        parts = []
        for i, (end, kind) in enumerate((("x", "prismatic"), ("y", "prismatic"), ("heading", "continuous"))):
            part = replace(
                joint,
                name=_fresh(f"{joint.name}_{end}", root, joints),
                kind=kind,
                parent=links[i],
                child=links[i + 1],
                axis=tuple(axes[:, i].tolist()),
            )
            joints[part.name] = part
            parts.append(part.name)
            _add(root, part, element.find("origin") if i == 0 else None, links[i + 1] != joint.child)
        root.remove(element)
        del joints[joint.name]
        notes.add(f"planar, and controlled as {', '.join(parts)}: @", joint.name)
    return replace(urdf, root=root, joints=joints, notes=urdf.notes + notes.sentences())


def _plane(normal: np.ndarray) -> np.ndarray:
    """Matrix whose columns are two directions of a plane and its normal; the identity where that is z."""
    return pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal).toRotationMatrix()


def _fresh(name: str, root: etree._Element, more: Collection[str] = ()) -> str:
    """A name that no link or joint has yet."""
    taken = {element.get("name") for element in root if element.tag in ("link", "joint")} | set(more)
    while name in taken:
        name += "_"
    return name


def _add(root: etree._Element, joint: UrdfJoint, origin: etree._Element | None, new_link: bool) -> None:
    """Add a joint, and the link without mass that it moves if there is none yet."""
    if new_link:
        etree.SubElement(root, "link", name=joint.child)
    element = etree.SubElement(root, "joint", name=joint.name, type=joint.kind)
    if origin is not None:
        element.append(copy.deepcopy(origin))
    etree.SubElement(element, "parent", link=joint.parent)
    etree.SubElement(element, "child", link=joint.child)
    etree.SubElement(element, "axis", xyz=plain(joint.axis))
