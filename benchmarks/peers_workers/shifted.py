"""A robot whose joints are zero in another posture: numerical inverse kinematics of KDL begin at zero."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np


def shifted(urdf: str, zero: dict[str, float]) -> str:
    """A robot whose joints are zero where those of the given one are at `zero`."""
    root = ElementTree.fromstring(urdf)
    for joint in root.iter("joint"):
        q = zero.get(joint.get("name", ""))
        if q is None:
            continue
        origin, axis = joint.find("origin"), joint.find("axis")
        if origin is None:
            origin = ElementTree.SubElement(joint, "origin")
        along = np.array([float(x) for x in (axis.get("xyz", "1 0 0") if axis is not None else "1 0 0").split()])
        turn = rotation(origin.get("rpy", "0 0 0")) @ about(along / np.linalg.norm(along), q)
        origin.set("rpy", " ".join(map(repr, angles(turn))))
        limit = joint.find("limit")
        for end in ("lower", "upper"):
            if limit is not None and limit.get(end) is not None:
                limit.set(end, repr(float(limit.get(end, "0")) - q))
    return ElementTree.tostring(root, encoding="unicode")


def about(axis: np.ndarray, q: float) -> np.ndarray:
    """Rotation about an axis."""
    K = np.cross(np.eye(3), axis)
    return np.asarray(np.eye(3) + np.sin(q) * K + (1.0 - np.cos(q)) * K @ K)


def rotation(rpy: str) -> np.ndarray:
    """Rotation of angles as a URDF has them."""
    x, y, z = (about(axis, float(angle)) for axis, angle in zip(np.eye(3), rpy.split(), strict=True))
    return z @ y @ x


def angles(R: np.ndarray) -> list[float]:
    """Angles of a rotation as a URDF has them."""
    y = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return [float(np.arctan2(-R[1, 2], R[1, 1])), float(y), 0.0]
    return [float(np.arctan2(R[2, 1], R[2, 2])), float(y), float(np.arctan2(R[1, 0], R[0, 0]))]
