# mypy: disable-error-code="import-not-found,import-untyped"
"""Pink along a path: a frame task and a posture task within limits, as in its examples; JSON in, JSON out."""

from __future__ import annotations

import json
import logging
import sys

import numpy as np
import pink
import pinocchio as pin
from pink.tasks import FrameTask, PostureTask


def main() -> None:
    """Joints after each step towards the placements of the frame."""
    given = json.load(sys.stdin)
    logging.disable(logging.WARNING)
    model = pin.buildModelFromUrdf(given["urdf"])
    configuration = pink.Configuration(model, model.createData(), np.array(given["q"]))
    task = FrameTask(given["frame"], position_cost=1.0, orientation_cost=float(given["whole"]), gain=1.0)
    posture = PostureTask(cost=1e-3)
    posture.set_target(np.array(given["q"]))
    joints, message = [given["q"]], ""
    for target in given["targets"][1:]:
        task.set_target(pin.SE3(np.array(target)))
        try:
            dq = pink.solve_ik(configuration, (task, posture), given["period"], solver="daqp", safety_break=False)
        except Exception as error:
            message = f"{type(error).__name__}: {error}"
            break
        configuration.integrate_inplace(dq, given["period"])
        joints.append(configuration.q.tolist())
    json.dump({"q": joints, "message": message}, sys.stdout)


if __name__ == "__main__":
    main()
