# mypy: disable-error-code="import-not-found,import-untyped"
"""PlaCo: inverse kinematics and inverse dynamics as quadratic programs, in C++ on Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import placo
from serve import Call, Problem, iterate, serve

#: Its robots float; here the base is held, and these are its coordinates and velocities.
BASE, BASE_SPEED = 7, 6


def build(problem: Problem) -> Mapping[str, Call]:
    return {
        "torque:": _step(problem, limited=False),
        "torque:within limits": _step(problem, limited=True),
        "inverse:": _inverse(problem),
    }


def _robot(problem: Problem) -> placo.RobotWrapper:
    return placo.RobotWrapper(problem.urdf, placo.Flags.ignore_collisions)


def _step(problem: Problem, limited: bool) -> Call:
    """The task exactly, the posture as well as that allows."""
    robot = _robot(problem)
    solver = placo.DynamicsSolver(robot)
    solver.mask_fbase(True)
    solver.dt = problem.period
    robot.update_kinematics()
    position = solver.add_position_task(problem.frame, problem.target[:3, 3])
    position.configure("position", "hard", 1.0)
    position.kp, position.kd = problem.kp, problem.kd
    position.target_world, position.dtarget_world = problem.target[:3, 3], problem.dz[:3]
    position.ddtarget_world = problem.ddz[:3]
    if problem.whole:
        rotation = solver.add_orientation_task(problem.frame, problem.target[:3, :3])
        rotation.configure("rotation", "hard", 1.0)
        rotation.kp, rotation.kd = problem.kp, problem.kd
    posture = solver.add_joints_task()
    posture.configure("posture", "soft", 1.0)
    posture.kp, posture.kd = problem.kp, problem.kd
    posture.set_joints(dict(zip(problem.joints, problem.posture.tolist(), strict=True)))
    for enable in (solver.enable_joint_limits, solver.enable_velocity_limits, solver.enable_torque_limits):
        enable(limited)
    n = len(problem.joints)
    q, dq = robot.state.q.copy(), robot.state.qd.copy()

    def step(state: np.ndarray) -> np.ndarray:
        q[BASE:], dq[BASE_SPEED:] = state[:n], state[n:]
        robot.state.q, robot.state.qd = q, dq
        robot.update_kinematics()
        return solver.solve(False).tau[BASE_SPEED:].copy()

    return step


def _inverse(problem: Problem) -> Call:
    """Full steps without limits until the target is reached."""
    robot = _robot(problem)
    solver = placo.KinematicsSolver(robot)
    solver.mask_fbase(True)
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)
    if problem.whole:
        task = solver.add_frame_task(problem.frame, problem.target)
        task.configure("task", "soft", 1.0, 1.0)
    else:
        task = solver.add_position_task(problem.frame, problem.target[:3, 3])
        task.configure("task", "soft", 1.0)
    n = len(problem.joints)
    q = robot.state.q.copy()

    def solve(given: np.ndarray) -> np.ndarray:
        start, target = problem.split(given)
        q[BASE:] = start[:n]
        robot.state.q = q
        robot.update_kinematics()
        if problem.whole:
            task.T_world_frame = target
        else:
            task.target_world = target[:3, 3]

        def error() -> np.ndarray:
            placement = robot.get_T_world_frame(problem.frame)
            return _between(placement, target, problem.whole)

        def improve() -> None:
            solver.solve(True)
            robot.update_kinematics()

        iterate(error, improve, problem)
        return robot.state.q[BASE:].copy()

    return solve


def _between(placement: np.ndarray, target: np.ndarray, whole: bool) -> np.ndarray:
    """Task error; for small rotations the off-diagonal entries are the rotation."""
    apart = target[:3, 3] - placement[:3, 3]
    if not whole:
        return apart
    return np.concatenate((apart, (target[:3, :3] - placement[:3, :3]).ravel()))


if __name__ == "__main__":
    serve(build)
