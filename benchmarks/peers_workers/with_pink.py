# mypy: disable-error-code="import-not-found,import-untyped"
"""Pink: differential inverse kinematics as a quadratic program, on Pinocchio."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np
import pink
import pinocchio as pin
from pink.tasks import FrameTask, PostureTask
from serve import Call, Problem, iterate, serve


def build(problem: Problem) -> Mapping[str, Call]:
    # Outside of the joint limits it would write a line in every step.
    logging.disable(logging.WARNING)
    return {
        "velocity:": _step(problem, limited=False),
        "velocity:within limits": _step(problem, limited=True),
        "inverse:": _inverse(problem),
    }


def _task(problem: Problem, gain: float) -> FrameTask:
    return FrameTask(problem.frame, position_cost=1.0, orientation_cost=float(problem.whole), gain=gain)


def _step(problem: Problem, limited: bool) -> Call:
    """One step of frame and posture task, as in Pink's examples."""
    model = pin.buildModelFromUrdf(problem.urdf)
    configuration = pink.Configuration(model, model.createData(), problem.posture)
    task, posture = _task(problem, problem.rate * problem.period), PostureTask(cost=1e-3)
    task.set_target(pin.SE3(problem.target))
    posture.set_target(problem.posture)
    tasks, n = (task, posture), model.nv
    limits = None if limited else ()

    def step(state: np.ndarray) -> np.ndarray:
        configuration.update(state[:n])
        return pink.solve_ik(configuration, tasks, problem.period, solver="daqp", limits=limits)

    return step


def _inverse(problem: Problem) -> Call:
    """Steps of gain one, without limits and posture, until the target is reached."""
    model = pin.buildModelFromUrdf(problem.urdf)
    configuration = pink.Configuration(model, model.createData(), problem.posture)
    task = _task(problem, 1.0)

    def solve(given: np.ndarray) -> np.ndarray:
        q, target = problem.split(given)
        configuration.update(q)
        task.set_target(pin.SE3(target))

        def error() -> np.ndarray:
            return task.compute_error(configuration)[: problem.m]

        def improve() -> None:
            dq = pink.solve_ik(configuration, (task,), 1.0, solver="daqp", limits=(), safety_break=False)
            configuration.integrate_inplace(dq, 1.0)

        iterate(error, improve, problem)
        return configuration.q

    return solve


if __name__ == "__main__":
    serve(build)
