"""eos_pin itself, through its public functions, as every peer is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from serve import Call, Problem, serve

from eos_pin import (
    Atlas,
    Chart,
    Controller,
    ControlLoop,
    EosController,
    EosError,
    JointLimits,
    LimitedEosController,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Trajectory,
    figure_eight,
    load_robot,
)
from eos_pin.charts.solutions import Strategy
from eos_pin.control.operational import BASELINES


def build(problem: Problem) -> Mapping[str, Call]:
    robot = load_robot(problem.urdf)
    task = (PoseTask if problem.whole else PositionTask)(robot, problem.frame)
    n, rest = len(problem.joints), problem.posture
    z = task.value(rest)
    path: Trajectory = figure_eight(z[:3], problem.size, period=problem.round, plane="yz")
    if problem.whole:
        path = PoseTrajectory(path, pose=z)
    gains = {"kp": problem.kp, "kd": problem.kd}
    tight = JointLimits.from_robot(robot, acceleration=problem.acceleration)
    controllers: dict[str, Controller] = {
        "": EosController(task, path, **gains),
        "within limits": LimitedEosController(task, path, control_period=problem.period, **gains),
        "at limits": LimitedEosController(task, path, control_period=problem.period, limits=tight, **gains),
        "traditional": BASELINES["null-space-posture"](task, path, rest),
    }

    def step(controller: Controller) -> Call:
        loop = ControlLoop(controller)
        loop.step(0.0, rest, 0.0 * rest)
        t = problem.t
        return lambda state: loop.step(t, state[:n], state[n:])

    def along(controller: Controller) -> Call:
        """Steps of one loop, one period after the other."""
        loop, count = ControlLoop(controller), -1

        def next_step(state: np.ndarray) -> np.ndarray:
            nonlocal count
            count += 1
            return loop.step(count * problem.period, state[:n], state[n:])

        return next_step

    chart, atlas = Chart.from_base(task, rest), Atlas(task)

    def point(target: np.ndarray) -> np.ndarray:
        return task.point(target) if problem.whole else target[:3, 3]

    def inverse(refresh: bool) -> Call:
        def solve(given: np.ndarray) -> np.ndarray:
            _, target = problem.split(given)
            return chart.inverse(point(target), chart.v_bar, refresh=refresh, tol=problem.tol).q

        return solve

    def follow(given: np.ndarray) -> np.ndarray:
        start, target = problem.split(given)
        try:
            found = atlas.follow(start, point(target)[None], chart=chart, tol=problem.tol)
        except EosError:
            return start
        return found.q[-1] if found.complete else start

    def solver(strategies: Sequence[Strategy] | None = None) -> Call:
        def solve(given: np.ndarray) -> np.ndarray:
            start, target = problem.split(given)
            z = target if problem.whole else target[:3, 3]
            return atlas.solve(start, z, strategies=strategies, tol=problem.tol).q

        return solve

    return {
        **{f"torque:{name}": step(controller) for name, controller in controllers.items()},
        **{f"along:{name}": along(controllers[name]) for name in ("", "within limits", "traditional")},
        "inverse:chart": inverse(True),
        "inverse:chart, constant B": inverse(False),
        "inverse:atlas": follow,
        "inverse:solve": solver(),
        "inverse:search": solver(["search"]),
    }


if __name__ == "__main__":
    serve(build)
