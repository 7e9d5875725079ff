"""Random runs through and near singularities and joint limits, under `LimitedEosController`.

    python benchmarks/limits.py [--count N] [--json FILE] [--write]

Each run starts in a random posture, often near a limit, and is sent to and fro along a random line that often leads
out of reach. Counted are torques that are not finite or beyond their limits, joints beyond theirs, and how many tasks
were given up in part, for how long and why, and how many were not resumed although the target came back to where it
was at the start. A few runs are repeated at shorter control periods: where the torque is
continuous, the most it changes from one period to the next shrinks with the period.

As many runs are made with payloads and joints too weak for gravity, where limits are passed: `weak_joints.py` judges
each time they are, and compares how many joints are lost with how many must be. Where torques change most there, the
run is repeated at shorter and shorter periods, and the way from one sample to the next is divided: a continuous torque
has smaller steps then, and where it is steepest no step is left in the end. With --write the counts go into
docs/limits.md.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from marked import HOME, fill
from rich.progress import track
from weak_joints import (
    ENDING,
    EXCLUDED,
    HOPELESS,
    NARROW,
    NOT_ALONE,
    PARTS,
    WEAK_PERIODS,
    WRONG,
    Outcome,
    divided_steps,
    weak_figures,
    weak_one,
    weak_steps,
)

from eos_pin import (
    EosError,
    Geodesic,
    LimitedEosController,
    PoseTask,
    PositionTask,
    Result,
    load_robot,
    simulate_sampled,
)
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json

#: Farther than this no joint may be beyond its limit [rad].
OVER = 1e-6
#: Time at which the target is back, and for which a run goes on [s]; farther off than this a task is not resumed
#: [m, rad].
BACK, DURATION, OFF = 1.5, 3.0, 1e-2
#: Control periods of runs that are repeated [s].
PERIODS = (1e-3, 5e-4, 2.5e-4)
#: Ratio of steps at two periods, one twice the other, from which the step counts as halved.
HALVES = 1.8
#: Document that --write fills.
DOCUMENT = HOME / "docs" / "limits.md"
#: Verdicts in the words of the document.
TOLD = {
    HOPELESS: "were hopeless",
    NOT_ALONE: "could not be kept while hopeless ones brake",
    EXCLUDED: "were excluded by joints before them",
    ENDING: "by help that had not ended yet",
    WRONG: "could have been kept",
}


def example(seed: int, period: float = 1e-3, *, rate: float = 200.0) -> Result:
    """Run with a seed."""
    random = np.random.default_rng(seed)
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    task = (PositionTask, PoseTask)[seed % 2](robot, "panda_hand_tcp")
    span = robot.upper - robot.lower
    # A beta distribution that favours the ends of the range.
    q = robot.lower + span * (0.02 + 0.96 * random.beta(0.6, 0.6, robot.n))
    z = task.value(q)
    step = np.zeros(task.m)
    step[:3] = random.normal(size=3)
    step *= random.uniform(0.1, 1.0) / np.linalg.norm(step)
    path = Geodesic(task, np.array([z, task.plus(z, step), z]), np.array([0.0, 0.5 * BACK, BACK]))
    controller = LimitedEosController(task, path, control_period=period)
    return simulate_sampled(robot, controller, q, duration=DURATION, control_period=period, record_rate=rate)


def one(seed: int) -> dict[str, float | str]:
    """What the run with a seed did about its limits."""
    try:
        found = example(seed)
    except EosError as error:
        return dict.fromkeys(("over", "torque", "speed", "given_up", "task", "limit", "off"), 0.0) | {
            "status": f"refused: {type(error).__name__}"
        }
    robot, met = found.load_plant(), found.singularities
    return {
        "status": found.status,
        "over": float(np.maximum(found.q - robot.upper, robot.lower - found.q).max()),
        "torque": float((np.abs(found.tau) / robot.effort).max()) if np.isfinite(found.tau).all() else np.inf,
        "speed": float((np.abs(found.dq) / robot.velocity).max()) - 1.0,
        "given_up": found.deficit_seconds,
        "task": met.get("task", {}).get("seconds", 0.0),
        "limit": met.get("limit", {}).get("seconds", 0.0),
        "off": float(np.abs(found.error[-1]).max()),
    }


def largest_step(seed: int, period: float) -> float:
    """The most a torque changes from one period to the next, but where a chart is left [N m]."""
    found = example(seed, period, rate=1.0 / period)
    return float(np.abs(np.diff(found.tau, axis=0))[np.diff(found.chart) == 0].max())


def told(runs: Sequence[Outcome]) -> str:
    """Counts of lost joints in a sentence."""
    verdicts = [one for row in runs for one in row.verdicts.values()]
    counts = sorted(((verdicts.count(one), words) for one, words in TOLD.items()), reverse=True)
    parts = ", ".join(f"{count} {words}" for count, words in counts)
    return f" In {len(runs):,} runs {len(verdicts)} joints passed a limit: {parts}. "


def main(
    *,
    count: int = 1000,
    weak: int | None = None,
    first: int = 0,
    repeated: int = 10,
    json: Path | None = None,
    write: bool = False,
    jobs: int = 2,
) -> int:
    """Run arms at random through and near singularities and limits, and count what went wrong.

    Args:
        count: Number of runs of Panda.
        weak: Number of runs with payloads and weak joints; by default as many.
        first: Seed of the first run.
        repeated: How many of both are repeated at shorter periods.
        json: File for the figures.
        write: Write the counts into docs/limits.md.
        jobs: Processes to use.
    """
    parallel = Parallel(n_jobs=jobs, return_as="generator")
    found = list(
        track(parallel(delayed(one)(seed) for seed in range(first, first + count)), total=count, console=stderr)
    )
    keys = ("over", "torque", "speed", "given_up", "task", "limit", "off")
    over, torque, speed, lost, singular, limited, off = (
        np.array([row[key] for row in found], dtype=float) for key in keys
    )
    figures: dict[str, float] = {
        "runs": count,
        "torques not finite or beyond a limit": int((torque > 1.0 + 1e-12).sum()),
        f"joints more than {OVER:g} rad beyond a limit": int((over > OVER).sum()),
        "farthest beyond a limit, rad": float(over.max()),
        "fastest beyond a limit, part of it": float(speed.max()),
        "tasks given up in part": int((lost > 0.0).sum()),
        "of these near a singularity of the task": int((singular > 0.0).sum()),
        "of these to keep limits": int((limited > 0.0).sum()),
        "seconds given up, mean of these": float(lost[lost > 0.0].mean()) if (lost > 0.0).any() else 0.0,
        f"tasks more than {OFF:g} off {DURATION - BACK:g} s after the target is back": int((off > OFF).sum()),
        "farthest off then, m or rad": float(off.max()),
    }
    weak = count if weak is None else weak
    seeds = range(first, first + weak)
    runs = list(track(parallel(delayed(weak_one)(seed) for seed in seeds), total=weak, console=stderr))
    figures |= weak_figures(runs)
    for status in sorted({str(row["status"]) for row in found}):
        figures[f"ended {status!r}"] = sum(row["status"] == status for row in found)
    wild = [seed for seed, row in zip(seeds, runs, strict=True) if row.verdicts][:repeated]
    for period in PERIODS:
        ms = f"at {1e3 * period:g} ms, median, N m"
        if count and repeated:
            steps = parallel(delayed(largest_step)(seed, period) for seed in range(first, first + min(repeated, count)))
            figures[f"largest step of the torque {ms}"] = float(np.median(list(steps)))
    if wild:
        halved = np.array(list(parallel(delayed(weak_steps)(seed) for seed in wild)))
        for period, steps in zip(WEAK_PERIODS, halved.T, strict=True):
            figures[f"with weak joints, where limits were passed, at 1/{1.0 / period:.0f} s"] = float(np.median(steps))
        ratio = halved[:, -2] / halved[:, -1]
        figures["of the last two of these, ratio, median"] = float(np.median(ratio))
        figures[f"runs in which it is {HALVES:g} or more"] = int((ratio >= HALVES).sum())
        divided = np.array(list(parallel(delayed(divided_steps)(seed) for seed in wild)))
        for parts, steps in zip((*PARTS, f"{1.0 / NARROW:g}"), divided.T, strict=True):
            figures[f"the same, the way between samples in {parts} parts"] = float(np.median(steps))
        figures["the same, the largest of all runs"] = float(divided[:, -1].max())
        figures["such runs"] = len(wild)
    console.print(grid("Panda at its limits", ("what", "figure"), list(figures.items())))
    if json is not None:
        write_json(json, figures)
    if write:
        fill(DOCUMENT, "lost", told(runs))
        if wild:
            chain = ", ".join(f"{step:.3g}" for step in np.median(halved, axis=0))
            first, last = (round(1.0 / period) for period in (WEAK_PERIODS[0], WEAK_PERIODS[-1]))
            fill(
                DOCUMENT,
                "halved",
                f" {chain} N m at 1/{first}, … 1/{last} s in the median of {len(wild)} runs, and the last is at most "
                f"{1.0 / HALVES:.2g} of the one before in {(ratio >= HALVES).sum()} of them ",
            )
            median, most = np.median(divided[:, -1]), divided[:, -1].max()
            text = f" {median:.1g} N m in the median of these runs, and {most:.1g} N m at most "
            fill(DOCUMENT, "steepest", text)
    wrong = (torque > 1.0 + 1e-12).any() or (over > OVER).any()
    return 1 if wrong or any(row.torque > 1.0 + 1e-12 or WRONG in row.verdicts.values() for row in runs) else 0


if __name__ == "__main__":
    sys.exit(run(main))
