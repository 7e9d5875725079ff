"""Plans on problems with known answers: `python benchmarks/planning.py [loops|fourr|iklink] …`; each has `--help`.

* `loops`: paths made by forward kinematics from random closed joint loops within limits, so that each has a solution. A
  plan must be found, keep the limits, and not cost more than the loop it was made from. What is checked is the table of
  joints, by Pinocchio alone. Results are kept in the file of `--json` after each loop; a run that was stopped goes on.
* `fourr`: Kazerounian and Wang's planar arm (1987), whose least ∫‖dq/ds‖² ds is known, from 20 seeds.
* `iklink`: a path of 767 way points on which joints must jump; how few times.
* `evidence`: on that path, whether fewer jumps than that could do.
* `convergence`: the cost of plans of the same paths at more and more points.
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

import marked
import numpy as np
import pinocchio as pin
from scipy.spatial import cKDTree

from eos_pin import HeadingTask, PoseTask, PositionTask, load_robot
from eos_pin.errors import EosError
from eos_pin.experiments.defaults import rest_posture
from eos_pin.planning.manifolds.manifold import self_motion_manifold
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
    columns = ["robot", "task", "planned and accepted", "cost / loop's own, median", "largest", "charts of held v", "s"]
    cells = []
    for name, task_name in sorted({(row["robot"], row["task"]) for row in rows}):
        met = [row for row in rows if (row["robot"], row["task"]) == (name, task_name)]
        fine = [row for row in met if row in good]
        ratios = [row["cost"] / row["own_cost"] for row in fine] or [np.nan]
        cells.append([
            name, task_name, f"{len(fine)} of {len(met)}", f"{np.median(ratios):.2f}", f"{max(ratios):.2f}",
            f"{np.median([row['own_switches'] for row in met]) + 1:g}",
            f"{np.median([row['seconds'] for row in met]):.1f}",
        ])  # fmt: skip
    words = (
        f"{len(good)} of {len(rows)} planned and accepted, {sum(row['worse'] for row in good)} cost more than the "
        f"loop they were made from; the loops change charts a median of "
        f"{np.median([row['own_switches'] for row in rows]):g} times; median "
        f"{np.median([row['seconds'] for row in rows]):.2f} s, longest {max(row['seconds'] for row in rows):.1f} s"
    )
    print(words)
    if options.write:
        marked.fill(marked.PLANNING, "loops", f"\n\n{words}:\n{marked.table(columns, cells)}")
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
    times: dict[str, list[float]] = {}
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
            times.setdefault(name, []).append(seconds)
        ends = f"{min(values[name]):.6f} to {max(values[name]):.6f}"
        print(f"{name:24} {options.seeds} seeds: {ends}, median {np.median(times[name]):.2f} s", flush=True)
    if options.json:
        options.json.write_text(json.dumps(values, indent=1) + "\n")
    if options.write:
        columns = ["variant", "least ∫‖dq/ds‖² ds", f"largest of {options.seeds} seeds", "s"]
        cells = [[k, f"{min(v):.6f}", f"{max(v):.6f}", f"{np.median(times[k]):.2f}"] for k, v in values.items()]
        marked.fill(marked.PLANNING, "fourr", "\n" + marked.table(columns, cells))
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


def recorded(options: argparse.Namespace) -> tuple[Robot, np.ndarray, list[pin.SE3]]:
    """Robot, times and poses of IKLink's example."""
    robot = load_robot(options.urdf, chain_to="panda_hand")
    with options.path.open() as file:
        rows = np.array([[float(cell) for cell in row] for row in list(csv.reader(file))[1:]])
    points = [
        pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), row[1:4])
        for row in rows
        for x, y, z, w in [row[4:8]]
    ]
    return robot, rows[:, 0], points


def without_jumps(options: argparse.Namespace) -> dict[str, float]:
    """How far joints can follow a path without a jump from its start, and from where on to its end.

    At each way point all arcs of the self-motion manifold within limits are nodes at even distances. A step leads from
    node to node where each joint keeps its velocity limit, widened by the distance of nodes, so that whatever the robot
    can do is among what is found.
    """
    robot, times, points = recorded(options)
    task = PoseTask(robot, "panda_hand")
    nodes: list[np.ndarray] = []
    for k, pose in enumerate(points):
        # Postures of the way point before lead to the same components here.
        starts: np.ndarray | list[np.ndarray] = nodes[-1][:: max(1, len(nodes[-1]) // 12)] if k else []
        manifold = self_motion_manifold(task, pose, starts=starts, seeds=options.starts, seed=options.seed + k)
        nodes.append(np.concatenate([np.empty((0, robot.n)), *manifold.sampled(options.spacing)]))
        if k % 50 == 0:
            print(f"way point {k}: {len(nodes[-1])} nodes in {len(manifold.arcs)} arcs", flush=True)
    longest = robot.velocity * np.diff(times)[:, None] + options.spacing

    def end(layers: list[np.ndarray], bounds: np.ndarray) -> int:
        """Last layer that a way without a jump from the first one reaches."""
        alive = np.ones(len(layers[0]), bool)
        for k, bound in enumerate(bounds):
            if not alive.any():
                return k - 1
            near = cKDTree(layers[k][alive] / bound).query(layers[k + 1] / bound, p=np.inf)[0]
            alive = near <= 1.0
        return len(bounds) if alive.any() else len(bounds) - 1

    last = end(nodes, longest)
    first = len(points) - 1 - end(nodes[::-1], longest[::-1])
    return {"last": last, "first": first, "spacing": options.spacing, "nodes": max(map(len, nodes))}


def evidence(options: argparse.Namespace) -> int:
    """Whether one jump can do: the way from the start then reaches where the way to the end begins."""
    kept: Path | None = options.json
    met = json.loads(kept.read_text()) if kept is not None and kept.exists() else without_jumps(options)
    verdict = "one jump may do" if met["last"] + 1 >= met["first"] else "one jump cannot do"
    words = (
        f"from the start joints go without a jump to way point {met['last']} at most, to the end from way point "
        f"{met['first']} at the earliest: {verdict} (nodes {met['spacing']:g} rad apart)"
    )
    print(words)
    if kept is not None:
        kept.write_text(json.dumps(met) + "\n")
    if options.write:
        marked.fill(marked.PLANNING, "evidence", words)
    return 0


def iklink(options: argparse.Namespace) -> int:
    """A path on which joints must jump."""
    robot, clock, points = recorded(options)
    began = time.perf_counter()
    found = plan(PoseTask(robot, "panda_hand"), points, times=clock, reconfigurations=True, margin=0.0)
    seconds = time.perf_counter() - began
    joints = found.at_waypoints()
    longest = robot.velocity * np.diff(clock)[:, None]
    step = np.abs(np.diff(joints, axis=0))
    jumps = np.flatnonzero((step > longest * (1.0 + 1e-9)).any(axis=1))
    motion = np.linalg.norm(np.diff(joints, axis=0), axis=1)
    motion[jumps] = 0.0
    inside = bool(((joints >= robot.lower) & (joints <= robot.upper)).all())
    print(
        f"{len(jumps)} reconfigurations at {jumps.tolist()}, motion {motion.sum():.2f} rad, within limits: {inside}, "
        f"task error {found.info['task_error_max']:.1e}, {seconds:.2f} s"
    )
    if options.write:
        marked.fill(marked.PLANNING, "iklink", f"{len(jumps)} jumps, {motion.sum():.2f} rad of motion beside them")
    return 0 if len(jumps) <= 2 and inside else 1


def convergence(options: argparse.Namespace) -> int:
    """Cost of plans of circles against the number of their way points."""
    worst, lines = 0.0, []
    counts = [20 * 2**k for k in range(options.levels)]
    for name, pose, radius in (("panda", 0, 0.3), ("panda", 1, 0.15), ("xarm7", 1, 0.1), ("baxter", 1, 0.1)):
        robot = load_robot(name, chain_to=ARMS[name] or "auto")
        frame = robot.options["chain_to"]
        task: Task = PoseTask(robot, frame) if pose else PositionTask(robot, frame)
        z = task.value(rest_posture(PoseTask(robot, frame)))
        costs = []
        for count in counts:
            s = np.linspace(0.0, 2.0 * np.pi, count + 1)
            points = np.repeat(z[None], count + 1, axis=0)
            points[:, :2] += radius * np.column_stack((np.cos(s) - 1.0, np.sin(s)))
            found = plan(task, points, times=s / (2.0 * np.pi), closed=True, keep_time=False)
            costs.append(integral(found, found.end - found.start))
        off = np.abs(np.array(costs[:-1]) / costs[-1] - 1.0)
        worst = max(worst, float(off[-1]))
        label = f"{name}, {'pose' if pose else 'position'}"
        lines.append([label, f"{costs[-1]:.5g}", *(f"{each:.2g}" for each in off)])
        print(" ".join(lines[-1]), flush=True)
    if options.write:
        columns = ["path", f"cost of {counts[-1]} points", *(f"{count}" for count in counts[:-1])]
        marked.fill(marked.PLANNING, "convergence", "\n" + marked.table(columns, lines))
    return 0 if worst < 0.01 else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("loops")
    one.add_argument("--count", type=int, default=200)
    one.add_argument("--numbers", type=int, nargs="*", help="these loops alone")
    one.add_argument("--points", type=int, default=160)
    one.add_argument("--robots", default=",".join(ARMS))
    one.add_argument("--write", action="store_true", help="write the table into docs/planning.md")
    two = commands.add_parser("fourr")
    two.add_argument("urdf", type=Path)
    two.add_argument("--points", type=int, default=360)
    two.add_argument("--seeds", type=int, default=20)
    two.add_argument("--write", action="store_true", help="write the table into docs/planning.md")
    three = commands.add_parser("iklink")
    three.add_argument("path", type=Path)
    three.add_argument("urdf", type=Path)
    three.add_argument("--write", action="store_true", help="write the figures into docs/planning.md")
    four = commands.add_parser("convergence")
    four.add_argument("--levels", type=int, default=5)
    four.add_argument("--write", action="store_true", help="write the table into docs/planning.md")
    five = commands.add_parser("evidence")
    five.add_argument("path", type=Path)
    five.add_argument("urdf", type=Path)
    five.add_argument("--spacing", type=float, default=0.01)
    five.add_argument("--starts", type=int, default=40)
    five.add_argument("--write", action="store_true", help="write the verdict into docs/planning.md")
    for command, function in ((one, loops), (two, fourr), (three, iklink), (four, convergence), (five, evidence)):
        command.add_argument("--seed", type=int, default=0)
        command.add_argument("--json", type=Path)
        command.set_defaults(run=function)
    options = parser.parse_args()
    run: Callable[[argparse.Namespace], int] = options.run
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
