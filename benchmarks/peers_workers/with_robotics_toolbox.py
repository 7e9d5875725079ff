# mypy: disable-error-code="import-not-found,import-untyped"
"""Robotics Toolbox for Python: numerical inverse kinematics, in C++."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import roboticstoolbox as rtb
from serve import Call, Problem, serve


def build(problem: Problem) -> Mapping[str, Call]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        chain = rtb.Robot.URDF(problem.urdf).ets(end=problem.frame)
    # Its default damping fades with the error, so that far below its default tolerance a redundant arm's equations are
    # singular; a little that stays is better there.
    kept = {"method": "sugihara", "k": 1e-4}
    return {
        "inverse:default": _search(problem, chain, slimit=100),
        "inverse:1 start": _search(problem, chain, slimit=1, **kept),
        "inverse:100 starts": _search(problem, chain, slimit=100, **kept),
        "inverse:100 starts, within limits": _search(problem, chain, slimit=100, joint_limits=True, **kept),
    }


def _search(problem: Problem, chain: rtb.ETS, **chosen: Any) -> Call:
    """Levenberg–Marquardt from the start that is given, and perhaps from random ones after it."""
    mask = np.array([1.0, 1.0, 1.0] + 3 * [float(problem.whole)])
    # What it calls tolerance is half the square of the error.
    settings = {
        "ilimit": problem.max_iterations,
        "tol": 0.5 * problem.tol**2,
        "mask": mask,
        "joint_limits": False,
        **chosen,
    }

    def solve(given: np.ndarray) -> np.ndarray:
        start, target = problem.split(given)
        return chain.ik_LM(target, q0=start, **settings).q

    return solve


if __name__ == "__main__":
    serve(build)
