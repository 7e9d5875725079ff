"""`KinematicLoop`: accuracy, limits in random runs, and steps and drift beside Pink, mink and PlaCo.

    python benchmarks/kinematic_loop.py tracking            task and self-motion errors of an ideal robot
    python benchmarks/kinematic_loop.py limits --runs 1000  the largest use of every limit in random runs
    python benchmarks/kinematic_loop.py orders --runs 100   a moved reference within its bounds, ten orders a run
    python benchmarks/kinematic_loop.py stops --runs 200    stops on the path at random instants
    python benchmarks/kinematic_loop.py bands --runs 200    bands of tolerances in random runs with tight limits, judged
    python benchmarks/kinematic_loop.py peers               steps and joints after each round, in one run
    python benchmarks/kinematic_loop.py planned             the same on circles, on planned joints

Results are printed and written as JSON (--json). The peers' environments come from `benchmarks/peers.py setup`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from bands import bands, told
from marked import HOME, PLANNING, fill, table
from peers import PEERS, WORKERS, installed
from setting import Setting

from eos_pin import (
    Damp,
    FollowPlan,
    JointLimits,
    KinematicLoop,
    Posture,
    SetPoint,
    SingularError,
    Track,
    Trajectory,
    circle,
    load_robot,
    plan,
)
from eos_pin._arrays import JointVector
from eos_pin.cli.main import run
from eos_pin.cli.output import write_json
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.tasks.base import Point, Task

ROBOTS = ("ur5", "xarm7", "kinova")
#: Time after which an error at the start has decayed to rounding with the usual gains [s].
SETTLED = 4.0
COLUMNS = "robot, library", "step [µs]", "task error [m]", "joint drift, round by round [rad]"


def tracking() -> dict[str, Any]:
    """Largest errors after the start has decayed, for two periods, in two rounds."""
    found = {}
    for name in ROBOTS:
        robot = load_robot(name, chain_to="auto")
        for kind in ("position", "pose"):
            task = make_task(robot, kind)
            q = rest_posture(task)
            path = fitting_path(task, q, period=6.0)
            for h in (0.002, 0.008):
                loop, errors, moved = KinematicLoop(task, path, control_period=h), [0.0], [0.0]
                joints = q
                for k in range(round(12.0 / h)):
                    joints = loop.step(k * h, joints).q
                    if k * h > SETTLED:
                        errors.append(float(np.abs(task.minus(path((k + 1) * h).z, task.value(joints))).max()))
                        assert loop.chart is not None
                        moved.append(float(np.abs(loop.chart.v(joints)).max(initial=0.0)))
                found[f"{name} {kind} {h}"] = {"task": max(errors), "v": max(moved)}
    return found


def limits(runs: int) -> dict[str, Any]:
    """Largest overshoot of a position limit, and ratios to those of velocity and acceleration."""
    robots = {name: load_robot(name, chain_to="auto") for name in ROBOTS}
    worst, held, singular = np.zeros(3), 0, 0
    for seed in range(runs):
        random = np.random.default_rng(seed)
        robot = robots[ROBOTS[seed % len(ROBOTS)]]
        task = make_task(robot, ("position", "pose")[seed // len(ROBOTS) % 2])
        lower, upper = np.maximum(robot.lower, -3.0), np.minimum(robot.upper, 3.0)
        path = fitting_path(task, rest_posture(task), period=float(random.uniform(0.5, 6.0)))
        chosen = (Track(), Posture(random.uniform(lower, upper)), Damp())[random.integers(3)]
        # A task that takes all joints leaves no self-motion.
        law = chosen if task.m < robot.n else None
        kept = JointLimits.without_torques(robot, acceleration=random.uniform(1.0, 20.0, robot.n))
        h = float(random.choice([0.002, 0.004, 0.008]))
        loop = KinematicLoop(task, path, law, control_period=h, limits=kept)
        q, dq = random.uniform(lower, upper), np.zeros(robot.n)
        try:
            for k in range(300):
                command = loop.step(k * h, q)
                held += loop.limited
                use = (
                    max((command.q - kept.upper).max(), (kept.lower - command.q).max()),
                    (np.abs(command.dq) / kept.velocity).max(),
                    (np.abs(command.dq - dq) / h / kept.acceleration).max(),
                )
                worst, (q, dq) = np.maximum(worst, use), command
        except SingularError:
            singular += 1
    names = ("position_overshoot", "velocity_ratio", "acceleration_ratio")
    return {"runs": runs, "limited_steps": held, "singular_starts": singular} | dict(
        zip(names, worst.tolist(), strict=True)
    )


def orders(runs: int) -> dict[str, Any]:
    """Ratios to the bounds of a moved reference, with ten random orders at random times in each run."""
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    start, h, bounds = task.value(rest_posture(task)), 0.004, (0.5, 2.0, 20.0)
    worst = np.zeros(3)
    for seed in range(runs):
        random = np.random.default_rng(seed)
        point = SetPoint(task, start, velocity=bounds[0], acceleration=bounds[1], jerk=bounds[2], stale=0.5)
        due = np.cumsum(random.uniform(0.0, 0.5, 10)).tolist()
        last = point(0.0)
        for k in range(1, round(5.0 / h)):
            while due and due[0] <= k * h:
                order = (point.move_to, point.drive)[random.integers(2)]
                order(
                    start + random.uniform(-0.3, 0.3, 3) if order == point.move_to else random.uniform(-1, 1, 3),
                    due.pop(0),
                )
            now = point(k * h)
            jerk = np.abs(now.ddz - last.ddz).max() / h
            use = np.abs(now.dz).max(), np.abs(now.ddz).max(), jerk
            worst, last = np.maximum(worst, np.divide(use, bounds)), now
    return {"orders": 10 * runs} | dict(zip(("velocity", "acceleration", "jerk"), worst.tolist(), strict=True))


def stops(runs: int) -> dict[str, Any]:
    """Distance from the path, ratio to the acceleration limits and speed left, within a second after a stop."""
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    q, h = rest_posture(task), 0.008
    path = fitting_path(task, q, shape="circle", period=4.0)
    kept = JointLimits.without_torques(robot)
    points = np.array([path(s).z for s in (0.0, 4.0 / 3.0, 8.0 / 3.0)])
    center, radius = points.mean(axis=0), float(np.linalg.norm(points[0] - points.mean(axis=0)))
    worst, slowest = np.zeros(3), 0
    for seed in range(runs):
        loop, joints, dq = KinematicLoop(task, path, control_period=h, limits=kept), q, np.zeros(robot.n)
        at = 400 + int(np.random.default_rng(seed).integers(500))
        for k in range(at + 125):
            if k == at:
                loop.pace = 0.0
            command = loop.step(k * h, joints)
            if k >= at:
                off = abs(float(np.linalg.norm(task.value(command.q) - center)) - radius)
                use = float((np.abs(command.dq - dq) / h / kept.acceleration).max())
                worst = np.maximum(worst, (off, use, 0.0))
                if np.abs(command.dq).max() > 1e-6:
                    slowest = max(slowest, k + 1 - at)
            joints, dq = command
        worst[2] = max(worst[2], float(np.abs(dq).max()))
    return {"stops": runs, "longest_stop_s": slowest * h} | dict(
        zip(("off_path_m", "acceleration_ratio", "speed_left"), worst.tolist(), strict=True)
    )


def planned() -> dict[str, Any]:
    """`peers` on circles; the loop follows closed plans, where all begin."""
    return peers(period=0.004, radius=0.25)


def peers(rounds: int = 3, period: float = 0.002, radius: float | None = None) -> dict[str, Any]:
    """Medians of steps, and drift of the joints in each round, on one path within the same limits."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ROBOTS:
            setting = Setting.make(name, False, Path(folder))
            robot, task, q = setting.robot, setting.task, setting.posture
            path: Trajectory = fitting_path(task, q, period=4.0)
            kept, law = JointLimits.without_torques(robot), None
            if radius is not None:
                reach = radius * robot.reach
                path = circle([1.8 * reach, reach, 1.6 * reach], reach, period=8.0, plane="yz")
                way = plan(task, path, closed=True)
                path, q, law = way.path, way(0.0).q, FollowPlan(way, robot)
            count = round(path.period / period)
            loop = KinematicLoop(task, path, law, control_period=period, limits=kept)
            joints, times, ends = q, [], []
            for k in range(rounds * count):
                start = time.process_time_ns()
                joints = loop.step(k * period, joints).q
                times.append((time.process_time_ns() - start) / 1e3)
                if (k + 1) % count == 0:
                    ends.append(joints.tolist())
            goal = path(path.period).z
            found[f"{name} eos_pin"] = _told(float(np.median(times)), ends, task, q, goal)
            pose = np.array(setting.placement(q))
            placements = []
            for k in range(count):
                pose[:3, 3] = path((k + 1) * period).z
                placements.append(pose.tolist())
            problem = setting.problem()
            given = {
                "urdf": str(setting.urdf), "frame": setting.frame, "whole": False, "q": q.tolist(), "period": period,
                "joints": problem["joints"], "velocity": kept.velocity.tolist(),
                "acceleration": kept.acceleration.tolist(), "placements": placements, "rounds": rounds,
            }  # fmt: skip
            for key in ("pink", "mink", "placo"):
                said = _peer(key, given)
                if "trouble" not in said:
                    said = _told(said["median"], said["joints"], task, q, goal)
                found[f"{name} {key}"] = said
    return found


def _peer(key: str, given: dict[str, Any]) -> dict[str, Any]:
    if isinstance(why := installed(PEERS[key]), str):
        return {"trouble": why}
    done = subprocess.run(
        [str(PEERS[key].python), str(WORKERS / "rounds.py"), key],
        input=json.dumps(given), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        return {"trouble": done.stderr.strip().splitlines()[-1]}
    said: dict[str, Any] = json.loads(done.stdout)
    return said


def _told(median: float, ends: list[list[float]], task: Task, q: JointVector, goal: Point) -> dict[str, Any]:
    """Time of a step, task error at the end of rounds after the first, and drift of every round."""
    error = max(float(np.abs(task.minus(goal, task.value(row))).max()) for row in np.array(ends[1:]))
    drift = np.abs(np.diff([q.tolist(), *ends], axis=0)).max(axis=1)
    return {"step_us": median, "task_error": error, "drift_per_round": drift.tolist()}


def main(
    what: tyro.conf.Positional[Literal["tracking", "limits", "bands", "orders", "stops", "peers", "planned"]],
    runs: int = 100,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    write: bool = False,
) -> int:
    """Measure one thing.

    Args:
        what: What to measure.
        runs: Number of random runs.
        json_file: File for the results; `bands` goes on from those that it has.
        write: Write the table of `peers` or `planned` into docs/positions.md, that of `bands` into docs/planning.md.
    """
    if what == "bands":
        known = json.loads(json_file.read_text()) if json_file is not None and json_file.exists() else {}
        for results in bands(runs, known):
            if json_file is not None:
                write_json(json_file, results)
        lines = told(results)
        for line in lines:
            print(*line, sep=": ")
        if write:
            fill(PLANNING, "kinematic_loop.py bands", table(("of random runs", ""), lines))
        return 0
    if what in ("tracking", "peers", "planned"):
        found = {"tracking": tracking, "peers": peers, "planned": planned}[what]()
    else:
        found = {"limits": limits, "orders": orders, "stops": stops}[what](runs)
    for name, value in found.items():
        print(name, value)
    if json_file is not None:
        json_file.write_text(json.dumps(found, indent=1) + "\n")
    if write and what in ("peers", "planned"):
        fill(HOME / "docs" / "positions.md", f"kinematic_loop.py {what}", table(COLUMNS, map(_row, found.items())))
    return 0


def _row(found: tuple[str, dict[str, Any]]) -> tuple[str, ...]:
    """A line of the table."""
    name, said = found
    if "trouble" in said:
        return name, said["trouble"], "", ""
    drift = ", ".join(f"{value:.2g}" for value in said["drift_per_round"])
    return name, f"{said['step_us']:.3g}", f"{said['task_error']:.1e}", drift


if __name__ == "__main__":
    sys.exit(run(main))
