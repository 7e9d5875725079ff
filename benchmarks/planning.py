"""Plans on problems with known answers: `python benchmarks/planning.py [loops|fourr|iklink] …`; each has `--help`.

* `loops`: paths made by forward kinematics from random closed joint loops within limits, so that each has a solution. A
  plan must be found, keep the limits, and not cost more than the loop it was made from. What is checked is the table of
  joints, by Pinocchio alone. Results are kept in the file of `--json` after each loop; a run that was stopped goes on.
* `fourr`: Kazerounian and Wang's planar arm (1987), whose least ∫|dq/ds|² ds is known, from 20 seeds.
* `iklink`: a path of 767 way points on which joints must jump; how few times.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from eos_pin import HeadingTask, PoseTask, PositionTask, load_robot
from eos_pin.errors import EosError
from eos_pin.planning.planner import plan
from eos_pin.planning.report import switches
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.tasks.stacked import StackedTask
from eos_pin.trajectories.through import WaypointPath

#: Robots of the loops and the frame that does the task.
ARMS = {
    "panda": "panda_hand_tcp",
    "xarm7": "",
    "baxter": "left_gripper",
    "pr2": "r_gripper_tool_frame",
    "talos_full_v2": "gripper_left_base_link",
}


def random_loop(robot: Robot, random: np.random.Generator, count: int) -> np.ndarray:
    """Joints of a smooth closed loop within the limits, (count, n), large enough to leave charts."""
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    phase = 2.0 * np.pi * np.arange(count) / count
    waves = np.array([f(k * phase) for k in (1, 2) for f in (np.sin, np.cos)])
    sizes = random.normal(size=(4, robot.n)) * np.array([1.0, 1.0, 0.4, 0.4])[:, None]
    loop = waves.T @ sizes
    half = 0.5 * (loop.max(axis=0) - loop.min(axis=0))
    # Each joint uses between three and seven tenths of its range.
    part = random.uniform(0.3, 0.7, robot.n)
    loop = loop / half * part * 0.5 * (upper - lower)
    room = 0.03 * (upper - lower)
    least, most = lower + room - loop.min(axis=0), upper - room - loop.max(axis=0)
    return loop + random.uniform(least, most)


def loops(options: argparse.Namespace) -> int:
    """Plans for paths of random joint loops."""
    kept: Path | None = options.json
    rows: list[dict[str, Any]] = json.loads(kept.read_text()) if kept is not None and kept.exists() else []
    done = {row["number"] for row in rows}
    arms = [name for name in ARMS if name in options.robots.split(",")]
    for i in sorted(set(options.numbers or range(options.count)) - done):
        name = arms[i % len(arms)]
        robot = load_robot(name, chain_to=ARMS[name] or "auto")
        frame = robot.options["chain_to"]
        random = np.random.default_rng(options.seed + i)
        pose = (i // len(arms)) % 2 == 1
        task: Task = PoseTask(robot, frame) if pose else PositionTask(robot, frame)
        own = random_loop(robot, random, options.points)
        own = np.concatenate((own, own[:1]))
        points = np.array([task.value(q) for q in own])
        row: dict[str, Any] = {
            "robot": name,
            "task": "pose" if pose else "position",
            "number": i,
            "own_switches": switches(task, own),
        }
        began = time.perf_counter()
        try:
            found = plan(task, points, closed=True, seed=options.seed)
        except EosError as error:
            row |= {"planned": False, "message": str(error), "seconds": time.perf_counter() - began}
        else:
            row |= {"planned": True, "seconds": time.perf_counter() - began, "message": ""}
            assert isinstance(found.path, WaypointPath)
            joints = found.at_waypoints()
            row |= checked(robot, frame, pose, points, joints)
            dt = np.diff(found.path.times)[:, None]
            at_own = float((np.diff(own, axis=0) ** 2 / dt).sum())
            row["cost"], row["own_cost"] = float((np.diff(joints, axis=0) ** 2 / dt).sum()), at_own
            row["worse"] = row["cost"] > at_own * (1.0 + 1e-9)
        rows.append(row)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1, default=float) + "\n")
        print(
            f"{i:4} {name:16} {row['task']:9} switches {row['own_switches']:3} {row['seconds']:6.2f} s "
            + (f"cost {row['cost']:9.3f} of {row['own_cost']:9.3f}" if row["planned"] else row["message"])
            + (" NOT ACCEPTED" if row["planned"] and not row["accepted"] else ""),
            flush=True,
        )
    good = [row for row in rows if row["planned"] and row["accepted"]]
    print(
        f"{len(good)} of {len(rows)} planned and accepted, {sum(row['worse'] for row in good)} cost more than the "
        f"loop they were made from; the loops change charts a median of "
        f"{np.median([row['own_switches'] for row in rows]):g} times; median "
        f"{np.median([row['seconds'] for row in rows]):.2f} s, longest {max(row['seconds'] for row in rows):.1f} s"
    )
    return 0 if len(good) >= 0.99 * len(rows) and not any(row["worse"] for row in good) else 1


def checked(robot: Robot, frame: str, pose: bool, points: np.ndarray, joints: np.ndarray) -> dict[str, Any]:
    """Check of joints by Pinocchio alone: errors at way points, limits, and whether they close and are continuous."""
    model = robot.model
    data = model.createData()
    number, error = model.getFrameId(frame), 0.0
    for z, q in zip(points, joints, strict=True):
        pin.framesForwardKinematics(model, data, q)
        place = data.oMf[number]
        error = max(error, float(np.abs(place.translation - z[:3]).max()))
        if pose:
            error = max(error, float(np.abs(pin.log3(place.rotation @ z[3:].reshape(3, 3).T)).max()))
    step = np.abs(np.diff(joints, axis=0))
    inside = bool(((joints >= model.lowerPositionLimit) & (joints <= model.upperPositionLimit)).all())
    closes = float(np.abs(joints[-1] - joints[0]).max())
    accepted = error <= 1e-9 and inside and closes <= 1e-9 and step.max() < 0.5
    return {"accepted": accepted, "task_error_max": error, "joint_step_max": float(step.max()), "closes": closes}


def fourr(options: argparse.Namespace) -> int:
    """The planar arm of Kazerounian and Wang."""
    robot = load_robot(options.urdf, chain_to="link5")
    position = PositionTask(robot, "link5", "xy")
    values: dict[str, list[float]] = {}
    variants: list[tuple[str, Task, bool]] = [
        ("heading fixed, open", StackedTask([position, HeadingTask(robot, "link5")]), False),
        ("heading fixed, closed", StackedTask([position, HeadingTask(robot, "link5")]), True),
        ("heading free, open", position, False),
        ("heading free, closed", position, True),
    ]
    s = np.linspace(0.0, 2.0 * np.pi, options.points + 1)
    circle = np.column_stack((6.0 + 4.0 * np.cos(s), 4.0 + 4.0 * np.sin(s)))
    for name, task, closed in variants:
        points = circle if task.m == 2 else np.column_stack((circle, np.full(len(s), np.radians(-60.0))))
        for seed in range(options.seeds):
            began = time.perf_counter()
            found = plan(task, points, times=s, closed=closed, keep_time=False, seed=seed)
            seconds = time.perf_counter() - began
            assert isinstance(found.path, WaypointPath)
            # The pace that was asked for, whatever the plan is slowed down to.
            factor = (found.end - found.start) / (2.0 * np.pi)
            values.setdefault(name, []).append(integral(found, factor))
            if seed == 0:
                print(f"{name:24} seed 0: {values[name][0]:.6f}, {seconds:.2f} s", flush=True)
        print(f"{name:24} {options.seeds} seeds: from {min(values[name]):.6f} to {max(values[name]):.6f}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(values, indent=1) + "\n")
    return 0 if max(values["heading fixed, open"]) <= 2.7505 * 1.001 else 1


def integral(found: Any, factor: float) -> float:
    """∫|dq/ds|² ds of a plan, by Gauss's rule between its knots."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for a, b in zip(found.times, found.times[1:], strict=False):
        for node, weight in zip(nodes, weights, strict=True):
            dq = found(0.5 * (a + b) + 0.5 * (b - a) * node).dq
            total += 0.5 * (b - a) * weight * float(dq @ dq)
    return total * factor


def iklink(options: argparse.Namespace) -> int:
    """A path on which joints must jump."""
    robot = load_robot(options.urdf, chain_to="panda_hand")
    with options.path.open() as file:
        rows = np.array([[float(cell) for cell in row] for row in list(csv.reader(file))[1:]])
    points = [
        pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), row[1:4])
        for row in rows
        for x, y, z, w in [row[4:8]]
    ]
    began = time.perf_counter()
    found = plan(PoseTask(robot, "panda_hand"), points, times=rows[:, 0], reconfigurations=True, margin=0.0)
    seconds = time.perf_counter() - began
    joints = found.at_waypoints()
    longest = robot.velocity * np.diff(rows[:, 0])[:, None]
    step = np.abs(np.diff(joints, axis=0))
    jumps = np.flatnonzero((step > longest * (1.0 + 1e-9)).any(axis=1))
    motion = np.linalg.norm(np.diff(joints, axis=0), axis=1)
    motion[jumps] = 0.0
    inside = bool(((joints >= robot.lower) & (joints <= robot.upper)).all())
    print(
        f"{len(jumps)} reconfigurations at {jumps.tolist()}, motion {motion.sum():.2f} rad, within limits: {inside}, "
        f"task error {found.info['task_error_max']:.1e}, {seconds:.2f} s"
    )
    return 0 if len(jumps) <= 2 and inside else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("loops")
    one.add_argument("--count", type=int, default=200)
    one.add_argument("--numbers", type=int, nargs="*", help="these loops alone")
    one.add_argument("--points", type=int, default=160)
    one.add_argument("--robots", default=",".join(ARMS))
    two = commands.add_parser("fourr")
    two.add_argument("urdf", type=Path)
    two.add_argument("--points", type=int, default=360)
    two.add_argument("--seeds", type=int, default=20)
    three = commands.add_parser("iklink")
    three.add_argument("path", type=Path)
    three.add_argument("urdf", type=Path)
    for command, function in ((one, loops), (two, fourr), (three, iklink)):
        command.add_argument("--seed", type=int, default=0)
        command.add_argument("--json", type=Path)
        command.set_defaults(run=function)
    options = parser.parse_args()
    run: Callable[[argparse.Namespace], int] = options.run
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
