"""Weld-like curves: `python benchmarks/welds.py plans|roll|descartes [--write] …`; each has `--help`.

Ten seeded closed curves of 600 points on curved surfaces, the tool along the normal, on arms of six and seven joints.

* `plans`: planned with the roll of the tool free and with the roll fixed: how many were planned, how often the joints
  jump, how far they move, how long it takes. Where no continuous motion is found, jumps are allowed. What is checked is
  the joints at the way points, by Pinocchio alone.
* `roll`: the plans with the roll free under EOS torque control, from the plan and from 0.05 rad beside it along the
  self-motion: whether the task is followed, the roll obeys the law that it was given, and the joints repeat.
* `descartes`: the same curves by Descartes, a ladder graph of sampled rolls, with an interpreter that has
  tesseract-robotics: by closed forms of all postures on the UR arms, elsewhere by a numerical search, which has one
  posture for each roll and begins where the plan does.

`--write` puts the tables into docs/planning.md.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import marked
import numpy as np
import pinocchio as pin

from eos_pin import (
    Chart,
    EosController,
    OrientationTask,
    Plan,
    PointAxisTask,
    PoseTask,
    Target,
    ToleranceTask,
    Tool,
    TrackTask,
    Trajectory,
    load_robot,
    plan,
    simulate,
)
from eos_pin.errors import EosError
from eos_pin.robot.library import find_robot
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task

#: Arms and the frame that holds the torch.
ARMS = {"ur5": "tool0", "panda": "panda_hand", "kinova": "j2s6s200_end_effector", "ur10": "tool0"}
#: Those that are planned; the others are for Descartes, which has closed forms for them.
PLANNED = ("ur5", "panda", "kinova")
#: Where the chain begins, and the names of arms for which Descartes has a closed form; a search for the others.
BASES = {"ur5": "base_link", "ur10": "base_link", "panda": "panda_link0", "kinova": "base"}
CLOSED = {"ur5": "UR5", "ur10": "UR10"}
SOLVERS = {True: "closed form", False: "numerical search"}
#: Tip of the torch in that frame [m], and the angle by which it is bent, so that no joint turns it about its own axis.
TIP, BENT = (0.08, 0.0, 0.15), np.radians(35.0)
#: Part of a robot's reach that the curves are made for.
REACH = 0.7
#: Ways to plan: in words.
MODES = {"free": "free", "cone": "free, axis within 15°", "fixed": "fixed"}
CONE = float(np.radians(15.0))
#: Random postures from which joints of a refused curve are searched for.
STARTS = 40
#: Largest errors at way points that are accepted [m, rad], and those of KDL's search.
ACCEPTED, SEARCHED = 1e-8, 1e-3
#: Start beside the plan [rad], rounds, and gains of the roll's law.
BESIDE, ROUNDS, KP, KD = 0.05, 2, 100.0, 20.0
#: Part of a round that is driven from beside the plan.
PART = 0.5
#: A step of a joint beyond this is a jump [rad].
JUMP = 0.5


def weld(seed: int, reach: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a closed curve on a curved surface, and the surface's normals there, (count, 3) each."""
    random = np.random.default_rng(seed)
    centre = reach * np.array([random.uniform(0.45, 0.55), random.uniform(-0.2, 0.2), random.uniform(0.05, 0.25)])
    s = 2.0 * np.pi * np.arange(count) / count
    waves = [(k, random.normal(scale=0.2 / k), random.uniform(0.0, 2.0 * np.pi)) for k in (2, 3, 4)]
    radius = reach * random.uniform(0.15, 0.22) * (1.0 + sum(a * np.cos(k * s + p) for k, a, p in waves))
    xy = np.column_stack((radius * np.cos(s), radius * np.sin(s)))
    height, slope = np.zeros(count), np.zeros((count, 2))
    for _ in range(3):
        w, phase = random.normal(size=2) * 4.0 / reach, random.uniform(0.0, 2.0 * np.pi)
        size = reach * random.uniform(0.02, 0.06)
        height += size * np.sin(xy @ w + phase)
        slope += size * np.cos(xy @ w + phase)[:, None] * w
    normals = np.column_stack((-slope, np.ones(count)))
    return centre + np.column_stack((xy, height)), normals / np.linalg.norm(normals, axis=1)[:, None]


def way_points(mode: str, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Task points of a curve, its first once more at the end; with the roll fixed, x is near the world's."""
    z = -normals
    if mode != "fixed":
        rows = np.hstack((points, z))
    else:
        x = np.array([1.0, 0.0, 0.0]) - z[:, :1] * z
        x /= np.linalg.norm(x, axis=1)[:, None]
        rotations = np.stack((x, np.cross(z, x), z), axis=2)
        rows = np.hstack((points, rotations.reshape(-1, 9)))
    return np.concatenate((rows, rows[:1]))


def arm(name: str) -> Robot:
    """An arm with its torch, a frame whose z axis is the torch's."""
    placement = pin.SE3(pin.exp3(np.array([0.0, BENT, 0.0])), np.array(TIP))
    return load_robot(name, chain_to="torch", tool=Tool(ARMS[name], placement, "torch"))


def task_of(mode: str, robot: Robot) -> Task:
    """The task of a way to plan."""
    if mode == "fixed":
        return PoseTask(robot, "torch")
    free = PointAxisTask(robot, "torch")
    return ToleranceTask(free, {"cone": CONE}) if mode == "cone" else free


def planned(mode: str, robot: Robot, seed: int, count: int) -> dict[str, Any]:
    """One curve, planned and checked."""
    points, normals = weld(seed, REACH * robot.reach, count)
    rows, task = way_points(mode, points, normals), task_of(mode, robot)
    began = time.process_time()
    found: Plan | None = None
    message = ""
    for jumps in (False, True):
        try:
            found = plan(task, rows, closed=not jumps, reconfigurations=jumps)
            break
        except EosError as error:
            message = str(error)
    row: dict[str, Any] = {"robot": robot.name, "mode": mode, "seed": seed, "seconds": time.process_time() - began}
    if found is None:
        return row | {"planned": False, "message": message, "out_of_reach": out_of_reach(robot, rows)}
    q = found.at_waypoints()
    motion = np.linalg.norm(np.diff(q, axis=0), axis=1)
    motion[[int(np.searchsorted(found.path.times, t)) - 1 for t in found.jump_times]] = 0.0  # type: ignore[attr-defined]
    return (
        row
        | {"planned": True, "jumps": len(found.jumps), "motion": float(motion.sum()), "start": q[0].tolist()}
        | checked(mode, robot, rows, q)
    )


def out_of_reach(robot: Robot, rows: np.ndarray) -> int:
    """At how many of every fourth way point no joints are found, by Pinocchio alone and without limits."""
    model, data = robot.model, robot.model.createData()
    number, random, count = model.getFrameId("torch"), np.random.default_rng(0), 0
    for z in rows[::4]:
        goal = pin.SE3(z[3:].reshape(3, 3), z[:3])
        for _ in range(STARTS):
            q = random.uniform(-np.pi, np.pi, robot.n)
            for _ in range(100):
                pin.framesForwardKinematics(model, data, q)
                J = pin.computeFrameJacobian(model, data, q, number, pin.LOCAL)
                error = pin.log6(data.oMf[number].actInv(goal)).vector
                if (size := np.linalg.norm(error)) < ACCEPTED:
                    break
                step = J.T @ np.linalg.solve(J @ J.T + 1e-3 * size * np.eye(6), error)
                q = q + step * min(1.0, 0.5 / np.abs(step).max())
            else:
                continue
            break
        else:
            count += 1
    return count


def checked(mode: str, robot: Robot, rows: np.ndarray, q: np.ndarray, most: float = ACCEPTED) -> dict[str, Any]:
    """Check of joints by Pinocchio alone: errors of place and direction, limits, and whether the joints repeat."""
    data, number = robot.model.createData(), robot.model.getFrameId("torch")
    place, turn, tilt = 0.0, 0.0, 0.0
    for z, joints in zip(rows, q, strict=True):
        pin.framesForwardKinematics(robot.model, data, joints)
        pose = data.oMf[number]
        place = max(place, float(np.abs(pose.translation - z[:3]).max()))
        if mode == "cone":
            tilt = max(tilt, float(np.arccos(min(1.0, pose.rotation[:, 2] @ z[3:]))))
        elif mode == "free":
            turn = max(turn, float(np.linalg.norm(pose.rotation[:, 2] - z[3:])))
        else:
            turn = max(turn, float(np.linalg.norm(pin.log3(pose.rotation.T @ z[3:].reshape(3, 3)))))
    inside = bool(((q >= robot.lower) & (q <= robot.upper)).all())
    accepted = inside and max(place, turn) <= most and tilt <= CONE
    return {"error": max(place, turn), "tilt": tilt, "inside": inside, "accepted": accepted}


def rows_of(options: argparse.Namespace, measure: Callable[[Robot, int], Iterable[dict[str, Any]]]) -> list[Any]:
    """What is measured for each arm and curve, printed and kept as it comes."""
    rows: list[dict[str, Any]] = []
    for name in options.robots.split(","):
        robot = arm(name)
        for seed in range(options.count):
            for row in measure(robot, seed):
                rows.append(row)
                print(json.dumps(row), flush=True)
                if options.json:
                    options.json.write_text(json.dumps(rows, indent=1) + "\n")
    return rows


def plans(options: argparse.Namespace) -> int:
    """Plans of all curves on all arms."""
    modes = options.modes.split(",")
    rows = rows_of(options, lambda robot, seed: (planned(mode, robot, seed, options.points) for mode in modes))
    lines = [
        "| arm | roll | planned | jumps | joint motion [rad] | CPU time [s] | longest [s] |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, mode in dict.fromkeys((row["robot"], row["mode"]) for row in rows):
        mine = [row for row in rows if (row["robot"], row["mode"]) == (name, mode)]
        lines.append(f"| {name} | {MODES[mode]} | {summed(mine)}")
    shown("plans", lines, options.write)
    return 0 if all(row.get("accepted", True) for row in rows) else 1


class Turn(Trajectory):
    """Orientation of the torch along a plan."""

    def __init__(self, task: OrientationTask, found: Plan) -> None:
        self.task, self.found = task, found

    def __call__(self, t: float) -> Target:
        q, dq, ddq = self.found(t)
        z, J, dz, drift = self.task.at(q, dq)
        return Target(z, dz, J @ ddq + drift)


def driven(robot: Robot, seed: int, count: int) -> dict[str, Any]:
    """One curve under torque control: two rounds from the plan, and a part of one from beside it."""
    task, turn = task_of("free", robot), OrientationTask(robot, "torch")
    found = plan(task, way_points("free", *weld(seed, REACH * robot.reach, count)), closed=True)
    path = Turn(turn, found)
    law = TrackTask(turn, path, kp=KP, kd=KD)
    controller = EosController(task, found.path, law)
    start, target = found(found.start), found.path(found.start)
    on = simulate(robot, controller, start.q, dq=start.dq, duration=ROUNDS * found.period, rtol=1e-7, atol=1e-9)
    # Beside it, the task goes on as it should and v has the plan's rate.
    chart = Chart.from_base(task, start.q)
    aside = task.kinematics.project((start.q + BESIDE * chart.V[:, 0])[None], target.z).q[0]
    chart = Chart.from_base(task, aside)
    dq = chart.acceleration(task.linearize(aside)[1], target.dz, chart.dv(start.dq))
    off = simulate(
        robot, controller, aside, dq=dq, duration=PART * found.period, record_rate=50.0, rtol=1e-9, atol=1e-11
    )
    # The axis is where it should be, so the rotation that lacks is a roll about it.
    error = np.array(
        [turn.minus(path(t).z, turn.value(q)) @ z[3:] for t, q, z in zip(off.t, off.q, off.z, strict=True)]
    )
    rate = float((path(found.start).dz - turn.at(aside, dq).dz) @ off.z[0][3:])
    # Solution of the law, critically damped, from the roll and its rate at the start.
    w = np.sqrt(KP)
    wrong = np.abs(error - (error[0] + (rate + w * error[0]) * off.t) * np.exp(-w * off.t))
    return {
        "robot": robot.name, "seed": seed, "task_error": float(max(np.abs(on.error).max(), np.abs(off.error).max())),
        "law_error": float(wrong.max()), "beside": float(abs(error[0])), "changes": len(off.switches),
        "drift": float(np.max(on.joint_drift_per_cycle)), "switches": len(on.switches),
        "rounds": len(on.joint_drift_per_cycle),
    }  # fmt: skip


def roll(options: argparse.Namespace) -> int:
    """Torque control of the roll."""
    rows = rows_of(options, lambda robot, seed: [driven(robot, seed, options.points)])
    lines = [
        "| arm | curves | task error [m, rad] | roll beside its law [rad] | joints after a round [rad] | charts |",
        "|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == name]
        worst = {key: max(row[key] for row in mine) for key in ("task_error", "law_error", "drift")}
        charts = [row["switches"] + 1 for row in mine]
        lines.append(
            f"| {name} | {len(mine)} | {worst['task_error']:.1e} | {worst['law_error']:.1e} "
            f"| {worst['drift']:.1e} | {min(charts)} to {max(charts)} |"
        )
    shown("roll", lines, options.write)
    return 0 if all(row["rounds"] == ROUNDS and max(row["task_error"], row["law_error"]) <= 1e-6 for row in rows) else 1


def peer(options: argparse.Namespace) -> int:
    """The same curves by Descartes and by `plan`."""
    rows: list[dict[str, Any]] = []
    for name in options.robots.split(","):
        robot = arm(name)
        for mode in options.modes.split(","):
            ours = [planned(mode, robot, seed, options.points) for seed in range(options.count)]
            theirs = descartes(options, name, robot, mode, [row.pop("start", None) for row in ours])
            for pair in zip(theirs, ours, strict=True):
                rows += pair
                print(json.dumps(pair), flush=True)
            if options.json:
                options.json.write_text(json.dumps(rows, indent=1) + "\n")
    lines = [
        "| arm | roll | planner | planned | jumps | joint motion [rad] | CPU time [s] | longest [s] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    worse = 0
    for name, mode in dict.fromkeys((row["robot"], row["mode"]) for row in rows):
        both = [row for row in rows if (row["robot"], row["mode"]) == (name, mode)]
        theirs, ours = both[::2], both[1::2]
        worse += sum(a["planned"] and not b["planned"] for a, b in zip(theirs, ours, strict=True))
        worse += sum(b.get("jumps", 0) > a.get("jumps", np.inf) for a, b in zip(theirs, ours, strict=True))
        steps = f", steps of {options.step:g}°" if mode == "free" else ""
        lines.append(f"| {name} | {MODES[mode]} | Descartes, {SOLVERS[name in CLOSED]}{steps} | {summed(theirs)}")
        lines.append(f"| {name} | {MODES[mode]} | `plan` | {summed(ours)}")
    shown("descartes", lines, options.write)
    print(f"curves on which `plan` jumps more often than Descartes, or fails where that does not: {worse}")
    return 1 if worse else 0


def descartes(
    options: argparse.Namespace, name: str, robot: Robot, mode: str, starts: list[list[float] | None]
) -> list[dict[str, Any]]:
    """Rows of all curves of an arm by Descartes; where its search is numerical, it begins at the given postures."""
    rest = np.clip(np.zeros(robot.n), robot.lower, robot.upper).tolist()
    curves = [weld(seed, REACH * robot.reach, options.points) for seed in range(options.count)]
    torch = (
        f'<link name="torch"/><joint name="tip" type="fixed"><parent link="{ARMS[name]}"/><child link="torch"/>'
        f'<origin xyz="{" ".join(map(str, TIP))}" rpy="0 {BENT} 0"/></joint></robot>'
    )
    named = find_robot(name)
    assert named is not None
    given = {
        "urdf": named.path.read_text().replace("</robot>", torch),
        "base": BASES[name], "tip": ARMS[name], "model": CLOSED.get(name, ""), "joints": list(robot.joint_names),
        "step": np.radians(options.step) if mode == "free" else None, "curves": [
            {"poses": way_points("fixed", *curve).tolist(), "zero": start or rest}
            for curve, start in zip(curves, starts, strict=True)
        ],
    }  # fmt: skip
    worker = Path(__file__).parent / "peers_workers" / "welds_descartes.py"
    done = subprocess.run(
        [options.python, str(worker)], input=json.dumps(given), capture_output=True, text=True, check=True
    )
    rows = []
    for seed, line in enumerate(line for line in done.stdout.splitlines() if line.startswith("{")):
        found = json.loads(line)
        row: dict[str, Any] = {
            "robot": robot.name,
            "mode": mode,
            "planner": "Descartes",
            "seed": seed,
        }
        row |= {"seconds": found["seconds"], "planned": "q" in found}
        if row["planned"]:
            q = np.array(found["q"])
            step = np.abs(np.diff(q, axis=0)).max(axis=1)
            motion = np.linalg.norm(np.diff(q, axis=0), axis=1)
            row |= {"jumps": int((step > JUMP).sum()), "motion": float(motion[step <= JUMP].sum())}
            row |= checked(mode, robot, way_points(mode, *curves[seed]), q, SEARCHED)
            row["planned"] = row["accepted"]
        rows.append(row | ({} if row["planned"] else {"message": found["message"]}))
    return rows


def summed(rows: list[dict[str, Any]]) -> str:
    """Cells of a table: how many are planned, how many of the others are out of reach, jumps, motion and time."""
    good = [row for row in rows if row["planned"]]
    motion = f"{np.median([row['motion'] for row in good]):.2f}" if good else ""
    times = [row["seconds"] for row in rows]
    jumps = sum(row["jumps"] for row in good)
    far = sum(row.get("out_of_reach", 0) > 0 for row in rows)
    beyond = f" ({far} out of reach)" if far else ""
    return f"{len(good)} of {len(rows)}{beyond} | {jumps} | {motion} | {np.median(times):.2f} | {max(times):.2f} |"


def shown(name: str, lines: list[str], write: bool) -> None:
    """Print a table, and put it into the page on planning."""
    print("\n".join(lines))
    if write:
        marked.fill(marked.PLANNING, f"welds.py {name}", "\n" + "\n".join(lines) + "\n")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("plans")
    one.add_argument("--robots", default=",".join(PLANNED))
    one.add_argument("--modes", default=",".join(MODES))
    two = commands.add_parser("roll")
    two.add_argument("--robots", default="ur5")
    three = commands.add_parser("descartes")
    three.add_argument("python", help="an interpreter that has tesseract-robotics")
    three.add_argument("--robots", default=",".join(ARMS))
    three.add_argument("--modes", default="free,fixed")
    three.add_argument("--step", type=float, default=10.0, help="steps of the roll [degrees]")
    for command, function in ((one, plans), (two, roll), (three, peer)):
        command.add_argument("--count", type=int, default=10)
        command.add_argument("--points", type=int, default=600)
        command.add_argument("--json", type=Path)
        command.add_argument("--write", action="store_true")
        command.set_defaults(run=function)
    options = parser.parse_args()
    run: Callable[[argparse.Namespace], int] = options.run
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
