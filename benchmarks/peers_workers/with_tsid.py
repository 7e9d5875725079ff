# mypy: disable-error-code="import-not-found,import-untyped"
"""TSID: inverse dynamics as a hierarchical quadratic program, in C++ on Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
import tsid.tsid_pywrap as tsid
from serve import Call, Problem, serve


def build(problem: Problem) -> Mapping[str, Call]:
    far = np.full(len(problem.joints), 1e3)
    return {
        "torque:": _step(problem, None),
        "torque:within limits": _step(problem, far),
        "torque:at limits": _step(problem, problem.acceleration),
    }


def _step(problem: Problem, acceleration: np.ndarray | None) -> Call:
    """The task exactly, the posture as well as that allows; then perhaps limits of torque, velocity and position."""
    n = len(problem.joints)
    folders = pin.StdVec_StdString()
    robot = tsid.RobotWrapper(problem.urdf, folders, False)
    formulation = tsid.InverseDynamicsFormulationAccForce("control", robot, False)
    formulation.computeProblemData(0.0, problem.posture, 0.0 * problem.posture)
    gains = np.ones(6)
    task = tsid.TaskSE3Equality("task", robot, problem.frame)
    task.setKp(problem.kp * gains)
    task.setKd(problem.kd * gains)
    task.setMask(np.array([1.0, 1.0, 1.0] + 3 * [float(problem.whole)]))
    task.useLocalFrame(False)
    formulation.addMotionTask(task, 1.0, 0, 0.0)
    posture = tsid.TaskJointPosture("posture", robot)
    posture.setKp(problem.kp * np.ones(n))
    posture.setKd(problem.kd * np.ones(n))
    formulation.addMotionTask(posture, 1.0, 1, 0.0)
    parts = [robot, task, posture]
    if acceleration is not None:
        effort = tsid.TaskActuationBounds("torques", robot)
        effort.setBounds(-problem.effort, problem.effort)
        formulation.addActuationTask(effort, 1.0, 0, 0.0)
        joints = tsid.TaskJointPosVelAccBounds("joints", robot, problem.period, False)
        joints.setPositionBounds(problem.lower, problem.upper)
        joints.setVelocityBounds(problem.velocity)
        joints.setAccelerationBounds(acceleration)
        formulation.addMotionTask(joints, 1.0, 0, 0.0)
        parts += [effort, joints]
    solver = tsid.SolverHQuadProgFast("solver")
    solver.resize(formulation.nVar, formulation.nEq, formulation.nIn)
    wanted = tsid.TrajectorySample(12, 6)
    # A placement is handed over as its translation and the columns of its rotation.
    wanted.value(np.concatenate((problem.target[:3, 3], problem.target[:3, :3].T.ravel())))
    wanted.derivative(problem.dz)
    wanted.second_derivative(problem.ddz)
    rest = tsid.TrajectorySample(n)
    rest.value(problem.posture)
    rest.derivative(np.zeros(n))
    rest.second_derivative(np.zeros(n))
    posture.setReference(rest)

    # The formulation refers to its parts, but does not keep them alive.
    def step(state: np.ndarray, kept: object = parts) -> np.ndarray:
        task.setReference(wanted)
        data = formulation.computeProblemData(0.0, state[:n], state[n:])
        solution = solver.solve(data)
        return formulation.getActuatorForces(solution)

    return step


if __name__ == "__main__":
    serve(build)
