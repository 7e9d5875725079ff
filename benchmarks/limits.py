"""Random runs through and near singularities and joint limits, under `LimitedEosController`.

    python benchmarks/limits.py [--count N] [--json FILE]

Each run starts in a random posture, often near a limit, and is sent to and fro along a random line that often leads
out of reach. Counted are torques that are not finite or beyond their limits, joints beyond theirs, and how many tasks
were given up in part, for how long and why, and how many were not resumed although the target came back to where it
was at the start. A few runs are repeated at shorter control periods: where the torque is
continuous, the most it changes from one period to the next shrinks with the period.

As many runs are made with a payload of up to three times what the arm is rated for, and with joints too weak for
gravity somewhere. There limits are passed, and linear programs of their own judge each time a joint passes its limits,
in every period from where it first left its bounds of acceleration:

hopeless: no torques within limits keep the joint within its bounds. Hopeless joints brake with all they have.
excluded: torques keep it, but none that keep all joints before it, in the order of `keeping_order`, that are kept.
could be kept: neither; if that is so in all these periods, the controller is wrong.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from joblib import Parallel, delayed
from rich.progress import track
from scipy.optimize import linprog

from eos_pin import (
    EosError,
    Geodesic,
    JointLimits,
    LimitedEosController,
    PoseTask,
    PositionTask,
    Result,
    Robot,
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
#: Control period of runs with payloads and weak joints, whose multiples are exact [s].
EXACT = 2.0**-10
#: Robots that get payloads and weak joints, and what they are rated for [kg].
RATED = {"panda": 3.0, "ur5": 5.0, "kinova": 2.6}
#: A joint passes its limits beyond this, of position [rad] and of velocity, relative.
POSITION, VELOCITY = 1e-5, 1e-3
#: Verdict on a joint that passes limits that it could keep.
WRONG = "could be kept"


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


def loaded(seed: int) -> tuple[Robot, str, np.random.Generator]:
    """Robot with a payload and weak joints, its frame, and where its random numbers go on."""
    random = np.random.default_rng((1, seed))
    name = list(RATED)[seed % len(RATED)]
    robot = load_robot(name, chain_to="auto")
    frame = str(robot.options["chain_to"])
    model = robot.model.copy()
    placed = model.frames[robot.frame_id(frame)].placement
    ball = pin.Inertia.FromSphere(RATED[name] * random.uniform(0.0, 3.0), 0.05)
    model.inertias[model.njoints - 1] += placed.act(ball)
    robot = replace(robot, model=model, source="", urdf_sha256="")
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    gravity = np.abs([robot.gravity(random.uniform(lower, upper)) for _ in range(200)]).max(axis=0)
    weak = random.random(robot.n) < random.choice([0.0, 0.2, 0.5])
    effort = np.where(weak, np.maximum(random.uniform(0.2, 1.2, robot.n) * gravity, 1.0), robot.effort)
    model.effortLimit = np.minimum(effort, robot.effort)
    return replace(robot, model=model), frame, random


def weak_run(seed: int, period: float = EXACT) -> tuple[Result, LimitedEosController]:
    """Run of a robot with a payload and weak joints, every control period of it."""
    robot, frame, random = loaded(seed)
    task = PositionTask(robot, frame)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    q = lower + (upper - lower) * (0.02 + 0.96 * random.beta(0.8, 0.8, robot.n))
    z = task.value(q)
    step = random.normal(size=3)
    step *= random.uniform(0.0, 0.7) / np.linalg.norm(step)
    path = Geodesic(task, np.array([z, z + step, z]), np.array([0.0, 0.5 * BACK, BACK]))
    controller = LimitedEosController(task, path, control_period=period)
    run = simulate_sampled(robot, controller, q, duration=2.0, control_period=period, record_rate=1.0 / period)
    return run, controller


def verdict(robot: Robot, limits: JointLimits, order: Sequence[int], q: np.ndarray, dq: np.ndarray, joint: int) -> str:
    """Whether a joint is hopeless, excluded or could be kept.

    Args:
        robot: The robot.
        limits: Its limits.
        order: Order in which joints are kept.
        q: Joints.
        dq: Joint velocities.
        joint: The joint.
    """
    least, most = limits.accelerations(q, dq, EXACT)
    inverse, bias = np.linalg.inv(robot.mass(q)), robot.bias(q, dq)
    rest = inverse @ bias

    def found(joints: list[int], torques: np.ndarray, room: np.ndarray) -> bool:
        A = np.vstack((inverse[joints], -inverse[joints]))
        b = np.concatenate(((most - room + rest)[joints], (-least - room - rest)[joints]))
        return linprog(np.zeros(robot.n), A_ub=A, b_ub=b, bounds=torques).status == 0

    torques, hopeless, none = np.column_stack((-limits.torque, limits.torque)), set(), np.zeros(robot.n)
    reach = np.abs(inverse) @ limits.torque
    for j in range(robot.n):
        if least[j] > reach[j] - rest[j] or most[j] < -reach[j] - rest[j]:
            hopeless.add(j)
            torques[j] = limits.torque[j] * (1.0 if least[j] > reach[j] - rest[j] else -1.0)
    if joint in hopeless:
        return "hopeless"
    kept: list[int] = []
    for j in order:
        if j == joint:
            break
        if j not in hopeless and found([*kept, j], torques, none):
            kept.append(j)
    # A period's mean acceleration is bounded, and the torque is held: a hair is left for what lies between.
    room = np.where(np.arange(robot.n) == joint, np.minimum(0.1, 0.25 * (most - least)), 0.0)
    return WRONG if found([*kept, joint], torques, room) else "excluded"


def passed(result: Result, limits: JointLimits, robot: Robot, order: Sequence[int]) -> list[tuple[int, str, int]]:
    """Joints that pass their limits, each time they do, with the first verdict that excuses it, and the row."""
    found = []
    # A sample is taken at the end of a period, with the torque held until then.
    q, dq = result.q[:-1], result.dq[:-1]
    ddq = np.array([robot.forward_dynamics(*row) for row in zip(q, dq, result.tau[1:], strict=True)])
    bounds = [limits.accelerations(*row, EXACT) for row in zip(q, dq, strict=True)]
    least, most = (np.array(side) for side in zip(*bounds, strict=True))
    left = (ddq < least - 1e-3 * (1.0 + np.abs(ddq))) | (ddq > most + 1e-3 * (1.0 + np.abs(ddq)))
    out = (q < limits.lower - POSITION) | (q > limits.upper + POSITION)
    out |= np.abs(dq) > limits.velocity * (1.0 + VELOCITY)
    # A joint that moves towards a limit faster than it may is on its way out.
    way = np.where(dq > 0.0, limits.upper - q, q - limits.lower)
    b, rate = limits.braking, 100.0
    with np.errstate(invalid="ignore"):
        fast = np.abs(dq) > np.sqrt(2.0 * b * np.maximum(way, 0.0) + (b / rate) ** 2) - b / rate + 1e-4
    for j in range(robot.n):
        begins = np.flatnonzero(np.diff(np.concatenate(([False], out[:, j]))).astype(bool) & out[:, j])
        for k in begins:
            first = k
            while first > 0 and (left[first - 1, j] or fast[first - 1, j]):
                first -= 1
            told = (verdict(robot, limits, order, q[i], dq[i], j) for i in range(first, k + 1))
            found.append((j, next((one for one in told if one != WRONG), WRONG), int(k)))
    return found


def weak_one(seed: int) -> dict[str, float | str]:
    """What the run with a payload and weak joints did about its limits."""
    try:
        run, controller = weak_run(seed)
    except EosError as error:
        return dict.fromkeys(("torque", "passed", "hopeless", "excluded", "wrong"), 0.0) | {
            "status": f"refused: {type(error).__name__}"
        }
    limits = controller.limits
    found = passed(run, limits, controller.robot, controller.keeping_order)
    verdicts = {j: {one for i, one, _ in found if i == j} for j, _, _ in found}
    return {
        "status": run.status,
        "torque": float((np.abs(run.tau) / limits.torque).max()) if np.isfinite(run.tau).all() else np.inf,
        "passed": len(verdicts),
        "hopeless": sum("hopeless" in told for told in verdicts.values()),
        "excluded": sum("excluded" in told for told in verdicts.values()),
        "wrong": sum(WRONG in told for told in verdicts.values()),
    }


def largest_step(seed: int, period: float) -> float:
    """The most a torque changes from one period to the next, but where a chart is left [N m]."""
    found = example(seed, period, rate=1.0 / period)
    return float(np.abs(np.diff(found.tau, axis=0))[np.diff(found.chart) == 0].max())


def main(*, count: int = 1000, repeated: int = 10, json: Path | None = None, jobs: int = 2) -> int:
    """Run Panda at random through and near singularities and limits, and count what went wrong.

    Args:
        count: Number of runs.
        repeated: How many of them are repeated at shorter periods.
        json: File for the figures.
        jobs: Processes to use.
    """
    parallel = Parallel(n_jobs=jobs, return_as="generator")
    found = list(track(parallel(delayed(one)(seed) for seed in range(count)), total=count, console=stderr))
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
    weak = list(track(parallel(delayed(weak_one)(seed) for seed in range(count)), total=count, console=stderr))
    figures |= {
        "with payloads and weak joints: runs": count,
        "torques not finite or beyond a limit then": sum(float(row["torque"]) > 1.0 + 1e-12 for row in weak),
        "joints that passed their limits": sum(int(row["passed"]) for row in weak),
        "of these, hopeless": sum(int(row["hopeless"]) for row in weak),
        "of these, excluded by joints before them": sum(int(row["excluded"]) for row in weak),
        "of these, that could keep them": sum(int(row["wrong"]) for row in weak),
        "runs with any of these": sum(bool(row["wrong"]) for row in weak),
    }
    for status in sorted({str(row["status"]) for row in found}):
        figures[f"ended {status!r}"] = sum(row["status"] == status for row in found)
    for period in PERIODS:
        steps = parallel(delayed(largest_step)(seed, period) for seed in range(min(repeated, count)))
        figures[f"largest step of the torque at {1e3 * period:g} ms, median, N m"] = float(np.median(list(steps)))
    console.print(grid("Panda at its limits", ("what", "figure"), list(figures.items())))
    if json is not None:
        write_json(json, figures)
    wrong = (torque > 1.0 + 1e-12).any() or (over > OVER).any() or any(row["wrong"] for row in weak)
    return 1 if wrong or any(float(row["torque"]) > 1.0 + 1e-12 for row in weak) else 0


if __name__ == "__main__":
    sys.exit(run(main))
