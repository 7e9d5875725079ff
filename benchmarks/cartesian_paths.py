"""Plan every Cartesian-path problem of a folder: `python benchmarks/cartesian_paths.py FOLDER [--json FILE]`.

A folder holds `robots.json` and one NAME.json for each problem. A problem names its robot, boxes (centre and full size,
along the axes of the world) and way points (x, y, z, qw, qx, qy, qz of the robot's frame in the world). `robots.json`
has for each robot its URDF, its frame, the joints that move (all others stay at zero), a capsule for each link and the
pairs of links that need no check; neighbours among the links that have capsules are not checked either.

Accepted is a plan that is within 0.1 mm and 0.1° of every way point, whose joints go at most 7° (a slide 2 cm) from one
to the next, within limits (a joint without limits within half a turn), and free of collisions at way points. The check
knows the joints and Pinocchio, nothing of this package.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from eos_pin import PoseTask, Robot, load_robot
from eos_pin.errors import EosError
from eos_pin.planning.obstacles.bodies import Bodies
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.planning.planner import plan

#: Longest step of a joint that turns, and of one that slides.
TURN, SLIDE = np.radians(7.0), 0.02


def solve(folder: Path, problem: dict[str, Any], robots: dict[str, Any], seed: int) -> tuple[list[str], Any, float]:
    """Names of the joints, joints at the way points or the message of a refusal, and seconds."""
    spec = robots[problem["robot"]]
    robot = robot_of(folder, spec)
    capsules = {link: Capsule(c["from"], c["to"], c["radius"], link) for link, c in spec["capsules"].items()}
    bodies = Bodies.of(robot, capsules, spec["pairs_not_checked"])
    boxes = [Box(box["centre"], box["size"], name=f"box {i}") for i, box in enumerate(problem["boxes"], 1)]
    points = [pin.SE3(rotation(row[3:]), np.array(row[:3])) for row in problem["waypoints"]]
    turning = np.array([joint.kind != "prismatic" for joint in robot.joints])
    began = time.perf_counter()
    try:
        found = plan(
            PoseTask(robot, spec["frame"]),
            points,
            scene=Scene(boxes) if boxes else None,
            bodies=bodies,
            self_collision=True,
            limits=(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)),
            joint_step=0.995 * np.where(turning, TURN, SLIDE),
            margin=1e-3,
            seed=seed,
        )
    except EosError as error:
        return [], str(error), time.perf_counter() - began
    seconds = time.perf_counter() - began
    return [joint.name for joint in robot.joints], found.at_waypoints(len(points)), seconds


def robot_of(folder: Path, spec: dict[str, Any]) -> Robot:
    """The robot of an entry of robots.json, with the joints that move."""
    path = folder / spec["urdf"]
    chain = load_robot(path, chain_to=spec["frame"])
    still = [joint.name for joint in chain.joints if joint.name not in spec["joints"]]
    return load_robot(path, chain_to=spec["frame"], lock=dict.fromkeys(still, 0.0)) if still else chain


def rotation(wxyz: list[float]) -> np.ndarray:
    """Rotation matrix of a quaternion whose digits were rounded."""
    w, x, y, z = wxyz
    quaternion = pin.Quaternion(w, x, y, z)
    quaternion.normalize()
    return np.asarray(quaternion.toRotationMatrix())


class Check:
    """An independent check of joints at way points.

    Args:
        folder: Where the URDF is.
        spec: The robot's entry of robots.json.
    """

    def __init__(self, folder: Path, spec: dict[str, Any]) -> None:
        self.spec, self.model = spec, pin.buildModelFromUrdf(str(folder / spec["urdf"]))
        self.data = self.model.createData()
        links = list(spec["capsules"])
        parents = {link: self._above(link, set(links)) for link in links}
        free = {frozenset(pair) for pair in spec["pairs_not_checked"]}
        self.pairs = [
            (a, b)
            for i, a in enumerate(links)
            for b in links[:i]
            if frozenset((a, b)) not in free and parents[a] != b and parents[b] != a
        ]

    def _above(self, link: str, links: set[str]) -> str:
        """The nearest link above that has a capsule."""
        frame = self.model.frames[self.model.getFrameId(link, pin.BODY)]
        while frame.parentFrame:
            frame = self.model.frames[frame.parentFrame]
            if frame.name in links:
                break
        return str(frame.name)

    def configuration(self, names: list[str], q: np.ndarray) -> np.ndarray:
        """All joints of the URDF, those that are not planned at zero; a continuous one is a cosine and a sine."""
        full = pin.neutral(self.model)
        for name, value in zip(names, q, strict=True):
            joint = self.model.joints[self.model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        return full

    def __call__(self, problem: dict[str, Any], names: list[str], joints: np.ndarray) -> dict[str, Any]:
        """Figures of a solution, and why it is not accepted, if it is not."""
        model, data = self.model, self.data
        frame = model.getFrameId(self.spec["frame"], pin.BODY)
        place, turn, clear = 0.0, 0.0, np.inf
        turning = np.array([model.joints[model.getJointId(name)].shortname()[:11] != "JointModelP" for name in names])
        for row, q in zip(problem["waypoints"], joints, strict=True):
            pin.forwardKinematics(model, data, self.configuration(names, q))
            pin.updateFramePlacements(model, data)
            pose = data.oMf[frame]
            place = max(place, float(np.linalg.norm(pose.translation - row[:3])))
            turn = max(turn, float(np.linalg.norm(pin.log3(pose.rotation @ rotation(row[3:]).T))))
            clear = min(clear, self._clearance(problem["boxes"]))
        steps = np.abs(np.diff(joints, axis=0))
        lower, upper = self._limits(names)
        room = float(np.minimum(joints - lower, upper - joints).min())
        wrong = []
        if place > 1e-4 or turn > np.radians(0.1):
            wrong.append("off its way points")
        if steps[:, turning].max() > TURN or steps[:, ~turning].max(initial=0.0) > SLIDE:
            wrong.append("a joint goes too far")
        if room < 0.0:
            wrong.append("beyond a limit")
        if clear < 0.0:
            wrong.append("a collision")
        return {
            "accepted": not wrong,
            "wrong": ", ".join(wrong),
            "task_error_max": max(place, turn),
            "joint_step_max_degrees": float(np.degrees(steps[:, turning].max())),
            "slide_step_max": float(steps[:, ~turning].max(initial=0.0)),
            "path_length": float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()),
            "clearance_min": clear,
            "limit_distance_min": room,
        }

    def _limits(self, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
        rows = []
        for name in names:
            joint = self.model.joints[self.model.getJointId(name)]
            endless = joint.nq == 2
            lower, upper = self.model.lowerPositionLimit[joint.idx_q], self.model.upperPositionLimit[joint.idx_q]
            rows.append((-np.pi, np.pi) if endless else (float(lower), float(upper)))
        table = np.array(rows)
        return table[:, 0], table[:, 1]

    def _clearance(self, boxes: list[dict[str, Any]]) -> float:
        """Least distance of capsules from boxes and each other, from points sampled on their segments."""
        ends = {}
        for link, capsule in self.spec["capsules"].items():
            pose = self.data.oMf[self.model.getFrameId(link, pin.BODY)]
            ends[link] = pose.act(np.array(capsule["from"])), pose.act(np.array(capsule["to"])), capsule["radius"]
        clear = np.inf
        for box in boxes:
            for a, b, radius in ends.values():
                clear = min(clear, _to_box(a, b, np.array(box["centre"]), 0.5 * np.array(box["size"])) - radius)
        for first, second in self.pairs:
            a, b, r = ends[first]
            c, d, s = ends[second]
            clear = min(clear, _to_segment(a, b, c, d) - r - s)
        return float(clear)


def _to_box(a: np.ndarray, b: np.ndarray, centre: np.ndarray, half: np.ndarray) -> float:
    """Distance of a segment from a box: that of a point is convex along it, so a search by thirds finds the least."""

    def distance(t: float) -> float:
        return float(np.linalg.norm(np.maximum(np.abs(a + t * (b - a) - centre) - half, 0.0)))

    low, high = 0.0, 1.0
    for _ in range(50):
        one, two = low + (high - low) / 3.0, high - (high - low) / 3.0
        low, high = (low, two) if distance(one) < distance(two) else (one, high)
    return distance(0.5 * (low + high))


def _to_segment(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """Distance of two segments: the least of those from their ends to the other, or across where they pass."""

    def from_point(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> float:
        along = y - x
        t = float(np.clip((p - x) @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
        return float(np.linalg.norm(p - x - t * along))

    least = min(from_point(a, c, d), from_point(b, c, d), from_point(c, a, b), from_point(d, a, b))
    normal = np.cross(b - a, d - c)
    if normal @ normal > 1e-18:
        s, t, _ = np.linalg.solve(np.column_stack((b - a, c - d, normal)), c - a)
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            least = min(least, float(abs((c - a) @ normal) / np.linalg.norm(normal)))
    return least


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", default="", help="part of the names of the problems to run")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    robots = json.loads((options.folder / "robots.json").read_text())
    results = {}
    columns = (
        f"{'problem':24} {'accepted':9} {'s':>6} {'step [°]':>9} {'length [rad]':>12} {'clear [m]':>10} {'error':>9}"
    )
    print(columns)
    for file in sorted(options.folder.glob("*.json")):
        if file.name == "robots.json" or options.only not in file.stem:
            continue
        problem = json.loads(file.read_text())
        if not isinstance(problem, dict) or "waypoints" not in problem:
            continue
        names, joints, seconds = solve(options.folder, problem, robots, options.seed)
        if not names:
            results[file.stem] = {"accepted": False, "wrong": joints, "seconds": seconds}
            print(f"{file.stem:24} {'no':9} {seconds:6.1f} {joints}", flush=True)
            continue
        figures = Check(options.folder, robots[problem["robot"]])(problem, names, joints)
        results[file.stem] = figures | {"seconds": seconds}
        accepted = "yes" if figures["accepted"] else "no: " + figures["wrong"]
        print(
            f"{file.stem:24} {accepted:9} {seconds:6.1f} {figures['joint_step_max_degrees']:9.2f} "
            f"{figures['path_length']:12.2f} {figures['clearance_min']:10.4f} {figures['task_error_max']:9.1e}",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")
    good = sum(result["accepted"] for result in results.values())
    print(f"{good} of {len(results)} planned")
    return 0 if good == len(results) else 1


if __name__ == "__main__":
    sys.exit(main())
