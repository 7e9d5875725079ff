# mypy: disable-error-code="import-not-found,import-untyped"
"""mink: differential inverse kinematics as a quadratic program, on MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping

import mink
import mujoco
import numpy as np
from serve import Call, Problem, iterate, serve


def build(problem: Problem) -> Mapping[str, Call]:
    return {
        "velocity:": _step(problem, limited=False),
        "velocity:within limits": _step(problem, limited=True),
        "inverse:": _inverse(problem),
    }


def _configuration(problem: Problem) -> mink.Configuration:
    """The same file; MuJoCo would merge fixed links, and with them the frame, unless it is told not to."""
    with open(problem.urdf, encoding="utf-8") as file:
        text = file.read()
    head, tag, rest = text.partition("<link")
    model = mujoco.MjModel.from_xml_string(head + '<mujoco><compiler fusestatic="false"/></mujoco>' + tag + rest)
    return mink.Configuration(model, problem.posture)


def _task(problem: Problem, gain: float) -> mink.FrameTask:
    return mink.FrameTask(
        problem.frame, "body", position_cost=1.0, orientation_cost=float(problem.whole), gain=gain, lm_damping=0.0
    )


def _step(problem: Problem, limited: bool) -> Call:
    """One step of frame and posture task, as in mink's examples."""
    configuration = _configuration(problem)
    task, posture = _task(problem, problem.rate * problem.period), mink.PostureTask(configuration.model, cost=1e-3)
    task.set_target(mink.SE3.from_matrix(problem.target))
    posture.set_target(problem.posture)
    tasks, n = (task, posture), configuration.model.nv
    limits: list[mink.Limit] = []
    if limited:
        speeds = dict(zip(problem.joints, problem.velocity.tolist(), strict=True))
        limits = [mink.ConfigurationLimit(configuration.model), mink.VelocityLimit(configuration.model, speeds)]

    def step(state: np.ndarray) -> np.ndarray:
        configuration.update(state[:n])
        return mink.solve_ik(configuration, tasks, problem.period, solver="daqp", damping=1e-12, limits=limits)

    return step


def _inverse(problem: Problem) -> Call:
    """Steps of gain one, without limits and posture, until the target is reached."""
    configuration, task = _configuration(problem), _task(problem, 1.0)

    def solve(given: np.ndarray) -> np.ndarray:
        q, target = problem.split(given)
        configuration.update(q)
        task.set_target(mink.SE3.from_matrix(target))

        def error() -> np.ndarray:
            return task.compute_error(configuration)[: problem.m]

        def improve() -> None:
            dq = mink.solve_ik(configuration, (task,), 1.0, solver="daqp", damping=1e-12, limits=[])
            configuration.integrate_inplace(dq, 1.0)

        iterate(error, improve, problem)
        return configuration.q.copy()

    return solve


if __name__ == "__main__":
    serve(build)
