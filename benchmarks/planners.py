"""Planners of other libraries on the paths of `following.py repeat`: `python benchmarks/planners.py [--json FILE]`.

Closed paths of poses of arms with seven joints, on which a plan was found. roboplan's Cartesian planner begins at the
same joints, and so does the search of KDL for Descartes (tesseract-robotics) at each way point: with one posture each,
because there is no closed form of these arms. All joints are judged alike, by Pinocchio alone: they pass within 5 mm
and 0.01 rad of every way point in their order (roboplan's own tolerances), keep limits, and no joint goes further than
0.5 rad from one to the next. `peers.py setup roboplan tesseract` makes their environments.

With `--problems FOLDER` the problems of Panda in a folder of `cartesian_paths.py` instead, open paths among boxes. The
others are not told of the boxes; what their joints keep clear of is looked at afterwards, at the way points.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import marked
import numpy as np
import pinocchio as pin
from cartesian_paths import Check, robot_of, rotation, solve
from following import made
from lxml import etree
from peers import OTHERS, WORKERS, installed
from setting import FAR

from eos_pin import Robot
from eos_pin.errors import EosError
from eos_pin.robot.geometry import Shapes

#: What counts as on the path [m, rad], a step that is a jump [rad], and joints that come back [rad].
PLACE, TURN, JUMP, CLOSES = 5e-3, 1e-2, 0.5, 1e-3
PLANNERS = {"plan": "`plan`", "roboplan": "roboplan, Cartesian planner", "tesseract": "Descartes, KDL"}


def judged(model: pin.Model, frame: str, targets: np.ndarray, q: np.ndarray) -> dict[str, Any]:
    """Whether joints pass all way points in order, in which rows, and jumps, motion and limits on the way."""
    data, number = model.createData(), model.getFrameId(frame)
    poses, rows = [], []
    for row in q:
        pin.framesForwardKinematics(model, data, row)
        poses.append(data.oMf[number].homogeneous)
    at, passed = 0, 0
    for target in targets:
        while at < len(poses):
            place = np.linalg.norm(poses[at][:3, 3] - target[:3, 3])
            if place <= PLACE and np.linalg.norm(pin.log3(poses[at][:3, :3].T @ target[:3, :3])) <= TURN:
                passed += 1
                rows.append(at)
                break
            at += 1
    step = np.diff(q, axis=0)
    jumps = int((np.abs(step).max(axis=1, initial=0.0) > JUMP).sum())
    inside = bool(((q >= model.lowerPositionLimit - 1e-6) & (q <= model.upperPositionLimit + 1e-6)).all())
    return {
        "follows": passed == len(targets), "passed": passed, "rows": rows, "inside": inside, "jumps": jumps,
        "motion": float(np.linalg.norm(step, axis=1).sum()), "closes": float(np.abs(q[-1] - q[0]).max()),
    }  # fmt: skip


def asked(robot: Robot, points: np.ndarray, q: np.ndarray) -> tuple[dict[str, Any], np.ndarray]:
    """What other planners are given: the robot without shapes, the path's poses, and the joints at its start."""
    assert isinstance(robot.shapes, Shapes)
    root = etree.fromstring(
        re.sub(r"<(visual|collision|transmission|gazebo)\b.*?</\1>", "", robot.shapes.urdf, flags=re.S)
    )
    for limit in root.iter("limit"):
        for key, value in limit.items():
            if abs(float(value)) > FAR and key in ("lower", "upper"):
                limit.set(key, str(np.copysign(FAR, float(value))))
    children = {child.get("link") for child in root.iter("child")}
    base = next(link.get("name") for link in root.iter("link") if link.get("name") not in children)
    targets = np.repeat(np.eye(4)[None], len(points), axis=0)
    targets[:, :3, 3], targets[:, :3, :3] = points[:, :3], points[:, 3:].reshape(-1, 3, 3)
    given = {
        "urdf": etree.tostring(root).decode(), "name": root.get("name"), "base": base,
        "frame": robot.options["chain_to"], "joints": [joint.name for joint in robot.joints],
        "q": q.tolist(), "targets": targets.tolist(),
    }  # fmt: skip
    return given, targets


def answers(given: dict[str, Any], names: list[str]) -> dict[str, dict[str, Any]]:
    """Joints and time of each other planner, or its reason."""
    replies = {}
    for name in names:
        done = subprocess.run(
            [str(OTHERS[name].python), str(WORKERS / f"path_{name}.py")],
            input=json.dumps(given), capture_output=True, text=True, timeout=300.0,
        )  # fmt: skip
        if done.returncode:
            replies[name] = {"message": (done.stderr.strip().splitlines() or ["no answer"])[-1]}
        else:
            replies[name] = json.loads(done.stdout.splitlines()[-1])
    return replies


def compared(number: int, seed: int, names: list[str]) -> dict[str, Any]:
    """One path by all planners."""
    _, found, row = made(number, seed, quick=True)
    if isinstance(found, EosError):
        return row | {"message": str(found)}
    robot, points = found.robot, np.asarray(found.path.points)  # type: ignore[attr-defined]
    given, targets = asked(robot, points, found(found.start).q)
    frame = str(robot.options["chain_to"])
    row["plan"] = judged(robot.model, frame, targets, found.at_waypoints()) | {"seconds": row["seconds"]}
    for name, reply in answers(given, names).items():
        q = np.array(reply.pop("q", []))
        row[name] = reply | (judged(robot.model, frame, targets, q) if len(q) else {})
    return row


def problem(file: Path, seed: int, names: list[str]) -> dict[str, Any]:
    """One problem of `cartesian_paths.py` by all planners."""
    folder, told = file.parent, json.loads(file.read_text())
    robots = json.loads((folder / "robots.json").read_text())
    spec = robots[told["robot"]]
    robot, check = robot_of(folder, spec), Check(folder, spec)
    joints, q, seconds = solve(folder, told, robots, seed)
    assert joints, f"no plan of {file}: {q}"
    points = np.array([[*row[:3], *rotation(row[3:]).ravel()] for row in told["waypoints"]])
    given, targets = asked(robot, points, q[0])
    row: dict[str, Any] = {"problem": file.stem}
    for name, reply in {"plan": {"q": q, "seconds": seconds}, **answers(given, names)}.items():
        q = np.array(reply.pop("q", []))
        row[name] = reply | (judged(robot.model, spec["frame"], targets, q) if len(q) else {})
        if row[name].get("follows"):
            row[name]["clear"] = check(told, joints, q[row[name]["rows"]])["clearance_min"]
    return row


def problem_lines(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A row of the table for each problem and planner."""
    cells = []
    for row in rows:
        for name, words in PLANNERS.items():
            met = row.get(name)
            if met is None:
                continue
            passed = f"{met.get('passed', 0)} of {len(row['plan']['rows'])}"
            motion = f"{met['motion']:.2f}" if met.get("follows") else "-"
            clear = f"{100.0 * met['clear']:.1f}" if "clear" in met else "-"
            jumps, seconds = str(met.get("jumps", "-")), f"{met['seconds']:.2f}" if "seconds" in met else "-"
            inside = "yes" if met.get("inside") else "no"
            cells.append([row["problem"], words, passed, inside, jumps, motion, clear, seconds])
    return cells


def lines(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A row of the table for each planner; motion beside that of `plan` on the paths it follows."""
    cells = []
    for name, words in PLANNERS.items():
        met = [row[name] for row in rows if name in row]
        if not met:
            continue
        good = [m for m in met if m.get("follows") and m["inside"] and not m["jumps"]]
        seconds = [m["seconds"] for m in met if "seconds" in m]
        parts = [row[name]["motion"] / row["plan"]["motion"] for row in rows if row.get(name) in good]
        cells.append([
            words, f"{len(good)} of {len(met)}", f"{sum(m['closes'] <= CLOSES for m in good)}",
            str(sum(m.get("jumps", 0) for m in met)),
            f"{np.median(parts):.3f}" if parts else "-",
            f"{np.median(seconds):.2f}" if seconds else "-",
        ])  # fmt: skip
    return cells


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20, help="paths on which a plan was found")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true", help="write the table into docs/planning.md")
    parser.add_argument("--problems", type=Path, help="folder of problems; those of Panda are solved instead")
    options = parser.parse_args()
    names = []
    for name in ("roboplan", "tesseract"):
        there = installed(OTHERS[name])
        print(f"{name}: {there}")
        if not isinstance(there, str):
            names.append(name)
    rows: list[dict[str, Any]] = []
    if options.problems is not None:
        rows = [problem(file, options.seed, names) for file in sorted(options.problems.glob("panda__*.json"))]
        heads = ["problem", "planner", "passes way points", "within limits", "jumps", "motion [rad]", "clear [cm]"]
        table = marked.table([*heads, "time [s]"], problem_lines(rows))
        if options.json is not None:
            options.json.write_text(json.dumps(rows, indent=1) + "\n")
        print(table, [[row[name].get("message") for name in names] for row in rows])
        if options.write:
            marked.fill(marked.PLANNING, "problems", f"\n\n{table}")
        return 0
    if options.json is not None and options.json.exists():
        rows = json.loads(options.json.read_text())
    number, done = 0, {row["number"] for row in rows}
    while sum("plan" in row for row in rows) < options.count:
        # Of four robots in turn the first two have seven joints and no more; every second round of them has poses.
        if number % 4 < 2 and (number // 4) % 2 == 1 and number not in done:
            rows.append(compared(number, options.seed, names))
            print(json.dumps(rows[-1])[:600], flush=True)
            if options.json is not None:
                options.json.write_text(json.dumps(rows, indent=1) + "\n")
        number += 1
    columns = ["planner", "follows within limits, no jump", "of these closed", "jumps", "motion of joints", "time [s]"]
    table = marked.table(columns, lines(rows))
    print(table)
    if options.write:
        marked.fill(marked.PLANNING, "planners", f"\n\n{table}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
