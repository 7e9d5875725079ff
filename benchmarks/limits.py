"""Random Panda runs through and near singularities and joint limits, under `LimitedEosController`.

    python benchmarks/limits.py [--count N] [--json FILE]

Each run starts in a random posture, often near a limit, and is sent to and fro along a random line that often leads
out of reach. Counted are torques that are not finite or beyond their limits, joints beyond theirs, and how many tasks
were given up in part, for how long.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from rich.progress import track

from eos_pin import (
    EosError,
    Geodesic,
    JointLimits,
    LimitedEosController,
    PoseTask,
    PositionTask,
    load_robot,
    simulate_sampled,
)
from eos_pin.cli import run
from eos_pin.report import console, grid, stderr, write_json

#: Farther than this no joint may be beyond its limit [rad].
OVER = 1e-6


def one(seed: int) -> dict[str, float | str]:
    """Run with a seed, and what it did about its limits."""
    random = np.random.default_rng(seed)
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    task = (PositionTask, PoseTask)[seed % 2](robot, "panda_hand_tcp")
    limits = JointLimits.of(robot)
    span = robot.upper - robot.lower
    # A beta distribution that favours the ends of the range.
    q = robot.lower + span * (0.02 + 0.96 * random.beta(0.6, 0.6, robot.n))
    z = task.value(q)
    step = np.zeros(task.m)
    step[:3] = random.normal(size=3)
    step *= random.uniform(0.1, 1.0) / np.linalg.norm(step)
    path = Geodesic(task, np.array([z, task.plus(z, step), z]), np.array([0.0, 0.75, 1.5]))
    try:
        found = simulate_sampled(robot, LimitedEosController(task, path, limits=limits), q, duration=2.0, rate=200.0)
    except EosError as error:
        return {"status": f"refused: {type(error).__name__}", "over": 0.0, "torque": 0.0, "given_up": 0.0}
    return {
        "status": found.status,
        "over": float(np.maximum(found.q - robot.upper, robot.lower - found.q).max()),
        "torque": float((np.abs(found.tau) / robot.effort).max()) if np.isfinite(found.tau).all() else np.inf,
        "given_up": found.given_up_seconds,
    }


def main(*, count: int = 1000, json: Path | None = None, jobs: int = 2) -> int:
    """Run Panda at random through and near singularities and limits, and count what went wrong.

    Args:
        count: Number of runs.
        json: File for the figures.
        jobs: Processes to use.
    """
    parallel = Parallel(n_jobs=jobs, return_as="generator")
    found = list(track(parallel(delayed(one)(seed) for seed in range(count)), total=count, console=stderr))
    over, torque, lost = (np.array([row[key] for row in found], dtype=float) for key in ("over", "torque", "given_up"))
    figures: dict[str, float] = {
        "runs": count,
        "torques not finite or beyond a limit": int((torque > 1.0 + 1e-12).sum()),
        f"joints more than {OVER:g} rad beyond a limit": int((over > OVER).sum()),
        "farthest beyond a limit, rad": float(over.max()),
        "tasks given up in part": int((lost > 0.0).sum()),
        "seconds given up, mean of these": float(lost[lost > 0.0].mean()) if (lost > 0.0).any() else 0.0,
    }
    for status in sorted({str(row["status"]) for row in found}):
        figures[f"ended {status!r}"] = sum(row["status"] == status for row in found)
    console.print(grid("Panda at its limits", ("what", "figure"), list(figures.items())))
    if json is not None:
        write_json(json, figures)
    return 1 if (torque > 1.0 + 1e-12).any() or (over > OVER).any() else 0


if __name__ == "__main__":
    sys.exit(run(main))
