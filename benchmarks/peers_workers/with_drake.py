# mypy: disable-error-code="import-not-found,import-untyped"
"""Drake: inverse kinematics as a nonlinear program (SNOPT), and differential as a quadratic program, in C++."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsParameters,
    DoDifferentialInverseKinematics,
    InverseKinematics,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.solvers import SnoptSolver, SolverOptions
from serve import Call, Problem, iterate, serve


def build(problem: Problem) -> Mapping[str, Call]:
    cases = {
        "velocity:": _step(problem, limited=False),
        "velocity:within limits": _step(problem, limited=True),
        "inverse:": _inverse(problem),
    }
    # An orientation constraint has a cone for its tolerance, whose tip no solver reaches to 1e-10.
    return cases if problem.whole else cases | {"inverse:nonlinear program": _program(problem)}


def _plant(problem: Problem) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    (robot,) = Parser(plant).AddModels(problem.urdf)
    joints = map(plant.get_joint, plant.GetJointIndices(robot))
    # A file may name its first link "world", which is the world to Drake.
    if not any(joint.parent_body() is plant.world_body() for joint in joints):
        base = plant.get_body(plant.GetBodyIndices(robot)[0])
        plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    return plant


def _parameters(problem: Problem, period: float) -> DifferentialInverseKinematicsParameters:
    """What a step is to keep: by default only the task, orientation where it counts."""
    n = len(problem.joints)
    parameters = DifferentialInverseKinematicsParameters(n, n)
    parameters.set_time_step(period)
    parameters.set_nominal_joint_position(problem.posture)
    parameters.set_end_effector_velocity_flag([problem.whole] * 3 + [True] * 3)
    return parameters


def _error(placement: RigidTransform, target: RigidTransform) -> np.ndarray:
    """Rotation and translation left, in world axes, as Drake orders them."""
    turn = RotationMatrix(target.rotation() @ placement.rotation().inverse()).ToAngleAxis()
    return np.concatenate((turn.angle() * turn.axis(), target.translation() - placement.translation()))


def _step(problem: Problem, limited: bool) -> Call:
    """One step towards the target; the null space draws to the posture."""
    plant, n = _plant(problem), len(problem.joints)
    context, frame = plant.CreateDefaultContext(), plant.GetFrameByName(problem.frame)
    parameters = _parameters(problem, problem.period)
    parameters.set_joint_centering_gain(np.eye(n))
    if limited:
        parameters.set_joint_position_limits((problem.lower, problem.upper))
        parameters.set_joint_velocity_limits((-problem.velocity, problem.velocity))
    target = RigidTransform(problem.target)

    def step(state: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, state[:n])
        wanted = problem.rate * _error(frame.CalcPoseInWorld(context), target)
        return DoDifferentialInverseKinematics(plant, context, wanted, frame, parameters).joint_velocities

    return step


def _inverse(problem: Problem) -> Call:
    """Steps of the whole error, without limits, until the target is reached."""
    plant = _plant(problem)
    context, frame = plant.CreateDefaultContext(), plant.GetFrameByName(problem.frame)
    parameters = _parameters(problem, 1.0)

    def solve(given: np.ndarray) -> np.ndarray:
        q, placement = problem.split(given)
        target = RigidTransform(placement)
        parameters.set_nominal_joint_position(q)
        left = np.zeros(6)

        def error() -> np.ndarray:
            nonlocal left
            plant.SetPositions(context, q)
            left = _error(frame.CalcPoseInWorld(context), target)
            return left if problem.whole else left[3:]

        def improve() -> None:
            nonlocal q
            found = DoDifferentialInverseKinematics(plant, context, left, frame, parameters).joint_velocities
            # Near a singularity it may find nothing; then it stays.
            q = q if found is None else q + found

        iterate(error, improve, problem)
        return q

    return solve


def _program(problem: Problem) -> Call:
    """The joints nearest to the start at which the frame is in its place."""
    plant = _plant(problem)
    frame, world = plant.GetFrameByName(problem.frame), plant.world_frame()
    origin = np.zeros(3)
    solver, options = SnoptSolver(), SolverOptions()
    options.SetOption(solver.id(), "Major feasibility tolerance", 0.1 * problem.tol)

    def solve(given: np.ndarray) -> np.ndarray:
        start, target = problem.split(given)
        kinematics = InverseKinematics(plant, False)
        program, q = kinematics.prog(), kinematics.q()
        program.AddQuadraticErrorCost(np.eye(len(start)), start, q)
        kinematics.AddPositionConstraint(frame, origin, world, target[:3, 3], target[:3, 3])
        return solver.Solve(program, start, options).GetSolution(q)

    return solve


if __name__ == "__main__":
    serve(build)
