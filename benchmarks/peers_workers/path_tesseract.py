# mypy: disable-error-code="import-not-found,import-untyped"
"""Descartes along a path of a frame of any arm, with KDL's numerical inverse kinematics; JSON in, JSON out.

KDL's search begins with all joints at zero, and so that is made the posture at the start of the path.
"""

from __future__ import annotations

import json
import sys
import tempfile

import numpy as np
from shifted import shifted
from welds_descartes import KDL, solved, world_of


def main() -> None:
    """Joints at the poses, or the reason why there are none."""
    given = json.load(sys.stdin)
    urdf = shifted(given["urdf"], dict(zip(given["joints"], given["q"], strict=True)))
    with tempfile.TemporaryDirectory() as folder:
        world = world_of(urdf, folder, given["base"], given["frame"], KDL)
        poses = [[*np.array(pose)[:3, 3], *np.array(pose)[:3, :3].ravel()] for pose in given["targets"]]
        found = solved(world, poses, None, given["frame"], given["base"])
        if "q" in found:
            found["q"] = (np.array(found["q"]) + np.array(given["q"])).tolist()
        print(json.dumps(found))


if __name__ == "__main__":
    main()
