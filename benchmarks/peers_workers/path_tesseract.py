# mypy: disable-error-code="import-not-found,import-untyped"
"""Descartes along a path of a frame of any arm, with KDL's numerical inverse kinematics; JSON in, JSON out.

KDL's search begins with all joints at zero, and so that is made the posture at the start of the path.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from tesseract_robotics import tesseract_common as common
from tesseract_robotics import tesseract_environment as environment
from welds_descartes import PLUGINS, SRDF, libraries, solved


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


def main() -> None:
    """Joints at the poses, or the reason why there are none."""
    given = json.load(sys.stdin)
    ends = {"base": given["base"], "tip": given["frame"]}
    with tempfile.TemporaryDirectory() as folder:
        plugins = PLUGINS.format(
            **libraries("kinematics_kdl_factories"), **ends, inverse="KDLInvKinChainLMAFactory", more=""
        )
        (Path(folder) / "kinematics.yaml").write_text(plugins)
        world, locator = environment.Environment(), common.GeneralResourceLocator()
        urdf = shifted(given["urdf"], dict(zip(given["joints"], given["q"], strict=True)))
        assert world.init(urdf, SRDF.format(name=given["name"], folder=folder, **ends), locator)
        poses = [[*np.array(pose)[:3, 3], *np.array(pose)[:3, :3].ravel()] for pose in given["targets"]]
        found = solved(world, poses, None, given["frame"], given["base"])
        if "q" in found:
            found["q"] = (np.array(found["q"]) + np.array(given["q"])).tolist()
        print(json.dumps(found))


if __name__ == "__main__":
    main()
