# mypy: disable-error-code="import-not-found,import-untyped"
"""roboplan's Cartesian planner along a path of a frame, with its defaults; JSON in, JSON out."""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from roboplan import cartesian_planning as planning
from roboplan import core


def main() -> None:
    """Joints of the trajectory from given ones on, or the reason why there is none."""
    given = json.load(sys.stdin)
    scene = core.Scene("scene", core.loadUrdfSceneDescriptionFromXml(given["urdf"]))
    scene.addGroup("arm", given["joints"])
    options = planning.CartesianPlannerOptions(group_name="arm")
    poses = [np.asfortranarray(pose) for pose in np.array(given["targets"])]
    path = core.CartesianPath([given["base"]], [given["frame"]], [poses])
    start = core.JointConfiguration(given["joints"], np.array(given["q"]))
    q = scene.toFullJointPositions("arm", np.array(given["q"]))
    scene.setJointPositions(q)
    began = time.perf_counter()
    try:
        found = planning.CartesianPathPlanner(scene, options).plan(path, start)
    except Exception as error:
        print(json.dumps({"message": f"{type(error).__name__}: {error}", "seconds": time.perf_counter() - began}))
        return
    seconds = time.perf_counter() - began
    rows = np.array(found.positions)[:, [list(found.joint_names).index(name) for name in given["joints"]]]
    print(json.dumps({"q": rows.tolist(), "seconds": seconds}))


if __name__ == "__main__":
    main()
