# mypy: disable-error-code="import-not-found,import-untyped"
"""Rounds of a path by differential inverse kinematics of Pink, mink or PlaCo, within limits; for `kinematic_loop.py`.

Reads a problem as JSON from stdin and writes microseconds of each step and the joints after each round.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np

#: A step: a placement (4, 4) in, joints out.
Step = Callable[[np.ndarray], np.ndarray]


def with_pink(given: dict[str, Any]) -> Step:
    """Frame and posture task, with limits of configuration, velocity and acceleration."""
    import logging

    import pink
    import pinocchio as pin
    from pink.limits import AccelerationLimit, ConfigurationLimit, VelocityLimit
    from pink.tasks import FrameTask, PostureTask

    logging.disable(logging.WARNING)
    model = pin.buildModelFromUrdf(given["urdf"])
    q, period = np.array(given["q"]), given["period"]
    configuration = pink.Configuration(model, model.createData(), q)
    task, posture = FrameTask(given["frame"], position_cost=1.0, orientation_cost=float(given["whole"])), None
    posture = PostureTask(cost=1e-3)
    posture.set_target(q)
    accelerations = AccelerationLimit(model, np.array(given["acceleration"]))
    limits = ConfigurationLimit(model), VelocityLimit(model), accelerations

    def step(placement: np.ndarray) -> np.ndarray:
        task.set_target(pin.SE3(placement))
        dq = pink.solve_ik(configuration, (task, posture), period, solver="daqp", limits=limits, safety_break=False)
        accelerations.set_last_integration(dq, period)
        configuration.integrate_inplace(dq, period)
        return configuration.q

    return step


def with_mink(given: dict[str, Any]) -> Step:
    """Frame and posture task, with limits of configuration and velocity; it has none of acceleration."""
    import mink
    import mujoco

    with open(given["urdf"], encoding="utf-8") as file:
        head, tag, rest = file.read().partition("<link")
    model = mujoco.MjModel.from_xml_string(head + '<mujoco><compiler fusestatic="false"/></mujoco>' + tag + rest)
    configuration, period = mink.Configuration(model, np.array(given["q"])), given["period"]
    task = mink.FrameTask(given["frame"], "body", position_cost=1.0, orientation_cost=float(given["whole"]))
    posture = mink.PostureTask(model, cost=1e-3)
    posture.set_target(np.array(given["q"]))
    speeds = dict(zip(given["joints"], given["velocity"], strict=True))
    limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]

    def step(placement: np.ndarray) -> np.ndarray:
        task.set_target(mink.SE3.from_matrix(placement))
        dq = mink.solve_ik(configuration, (task, posture), period, "daqp", limits=limits)
        configuration.integrate_inplace(dq, period)
        return np.array(configuration.q)

    return step


def with_placo(given: dict[str, Any]) -> Step:
    """Frame and joints task, with limits of configuration and velocity; it has none of acceleration here."""
    import placo

    robot = placo.RobotWrapper(given["urdf"], placo.Flags.ignore_collisions)
    solver = placo.KinematicsSolver(robot)
    solver.mask_fbase(True)
    solver.dt = given["period"]
    solver.enable_joint_limits(True)
    solver.enable_velocity_limits(True)
    robot.state.q = np.concatenate((robot.state.q[:7], given["q"]))
    robot.update_kinematics()
    if given["whole"]:
        task = solver.add_frame_task(given["frame"], robot.get_T_world_frame(given["frame"]))
        task.configure("task", "soft", 1.0, 1.0)
    else:
        task = solver.add_position_task(given["frame"], robot.get_T_world_frame(given["frame"])[:3, 3])
        task.configure("task", "soft", 1.0)
    posture = solver.add_joints_task()
    posture.configure("posture", "soft", 1e-6)
    posture.set_joints(dict(zip(given["joints"], given["q"], strict=True)))

    def step(placement: np.ndarray) -> np.ndarray:
        if given["whole"]:
            task.T_world_frame = placement
        else:
            task.target_world = placement[:3, 3]
        solver.solve(True)
        robot.update_kinematics()
        return robot.state.q[7:].copy()

    return step


def main() -> None:
    """Go round, and write what it took."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    given = json.load(sys.stdin)
    step = globals()[f"with_{sys.argv[1]}"](given)
    path = np.array(given["placements"])
    times, joints = [], []
    for _ in range(given["rounds"]):
        for placement in path:
            start = time.process_time_ns()
            q = step(placement)
            times.append((time.process_time_ns() - start) / 1e3)
        joints.append(np.asarray(q).tolist())
    print(json.dumps({"median": float(np.median(times)), "joints": joints}), file=replies)


if __name__ == "__main__":
    main()
