"""Plans under torque control: `python benchmarks/following.py [repeat|joining|disturbed] …`; each has `--help`.

* `repeat`: closed paths through a random posture within limits, by v that is held, posture control, and planned joints,
  in continuous time and by torques that are held for 1 ms each, all from the same joints and velocities on the path,
  and by Pink with a posture task, where it is set up (kinematics alone): how many repeat within limits from the first
  round, and how many stay within limits at all. On half of the paths v that is held changes charts.
* `joining`: from random postures at the first task point of a plan: joined and then following, or refused with a
  reason; each refusal is judged by something else, a walk along the manifold or a roadmap of it.
* `disturbed`: pushes, pauses and changes of speed: how far from the plan the joints are in the end.

Results are kept in the file of `--json` after each case; a run that was stopped goes on from there. With `--count 0`
what is there is shown, or written.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import marked
import numpy as np
import pinocchio as pin
from lxml import etree
from peers import PEERS, WORKERS, installed
from rich.console import Console
from rich.table import Table
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from setting import FAR
from solvable import judged as judged_solvable

from eos_pin import (
    Atlas,
    EosController,
    FollowPlan,
    Plan,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Posture,
    Robot,
    Task,
    TaskForce,
    circle,
    journey,
    load_robot,
    plan,
    simulate,
    simulate_sampled,
)
from eos_pin.errors import EosError
from eos_pin.planning.report import switches
from eos_pin.robot.geometry import Shapes
from eos_pin.tasks.batch import Manifold, ranges
from eos_pin.trajectories.pace import Clock
from eos_pin.trajectories.through import waypoint_path

#: Robots and the frame that does the task; of some the tip that the package finds.
ARMS = {"panda": "panda_hand_tcp", "xarm7": "auto", "kinova": "auto", "talos_full_v2": "gripper_left_base_link"}
SHAPES = ("circle", "eight", "polygon")
#: A round repeats where no joint comes back further off than this, and limits are kept up to it [rad]; way points.
REPEATS, POINTS = 1e-6, 96
#: Number of paths that the table is meant for.
PATHS = 200
ROUNDS, THRESHOLD = 2, 0.5
#: A path is followed to this [m, rad]; and steps of Pink in a round.
FOLLOWS, STEPS = 1e-3, 2000


def curve(shape: str, random: np.random.Generator) -> np.ndarray:
    """A closed curve of size 1 that begins at the origin, in a random plane, (POINTS + 1, 3)."""
    s = 2.0 * np.pi * np.arange(POINTS + 1) / POINTS
    if shape == "circle":
        flat = np.column_stack((np.cos(s) - 1.0, np.sin(s)))
    elif shape == "eight":
        flat = np.column_stack((np.sin(s), 0.5 * np.sin(2.0 * s)))
    else:
        # Corners are rounded by leaving the high harmonics of a regular polygon away.
        sides = int(random.integers(3, 7))
        z = np.exp(1j * s) + np.exp(1j * (1 - sides) * s) / (sides - 1) ** 2
        flat = np.column_stack((z.real, z.imag))
        flat = flat - flat[0]
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return np.asarray(flat @ axes[:, :2].T)


def made(number: int, seed: int, *, quick: bool = False) -> tuple[Task, Plan | EosError, dict[str, Any]]:
    """A path of random shape, as large as joints can follow from one way point to the next, and its plan.

    In every second round of robots and tasks v, held from the start of the plan, changes charts on each path. Quick
    refusals are neither confirmed nor judged.
    """
    name = list(ARMS)[number % len(ARMS)]
    robot = load_robot(name, chain_to=ARMS[name])
    frame = str(robot.options["chain_to"])
    pose = (number // len(ARMS)) % 2 == 1 and robot.n > 6
    task: Task = PoseTask(robot, frame) if pose else PositionTask(robot, frame)
    random = np.random.default_rng([seed, number])
    shape = SHAPES[number % 3]
    lower, upper = ranges(robot)
    size, q = 0.6, random.uniform(lower, upper)
    line = curve(shape, random)
    manifold, changes = Manifold(task), (number // (2 * len(ARMS))) % 2 == 1
    while True:
        z = task.value(q)
        points = np.repeat(z[None], POINTS + 1, axis=0)
        points[:, :3] += size * line
        found: Plan | EosError | None = None
        if reachable(manifold, points, q, lower, upper) and not (changes and not held_switches(task, points, q)):
            path = waypoint_path(task, points, closed=True)
            began = time.perf_counter()
            try:
                found = plan(task, path, closed=True, keep_time=False, seed=seed, effort=1 if quick else 3)
            except EosError as error:
                found = error
            seconds = time.perf_counter() - began
            if isinstance(found, EosError) or not changes or held_switches(task, points, found(found.start).q):
                break
            found = None
        size *= 0.8
        if size < 0.05 or found is not None:
            size, q = 0.6, random.uniform(lower, upper)
    row = {"number": number, "robot": name, "task": "pose" if pose else "position", "shape": shape, "size": size}
    if isinstance(found, EosError) and not quick:
        row["solvable"] = judged_solvable(task, path)
    return task, found, row | {"seconds": seconds, "changes_asked": changes}


def held_switches(task: Task, points: np.ndarray, q: np.ndarray) -> int:
    """How many times v that is held from joints on changes charts on a path, as far as it is followed."""
    try:
        return len(Atlas(task, threshold=THRESHOLD).follow(q, points).charts) - 1
    except EosError:
        return 0


def reachable(manifold: Manifold, points: np.ndarray, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Whether each point has joints within limits that are found from those of the point before."""
    at = q[:, None]
    for z in points:
        at, good = manifold.project(at, z[:, None])
        if not good[0]:
            return False
        if ((at[:, 0] < lower) | (at[:, 0] > upper)).any():
            starts = np.random.default_rng(0).uniform(lower, upper, (60, len(q))).T
            other, fine = manifold.search(starts, np.repeat(z[:, None], 60, axis=1), (lower, upper))
            if not fine.any():
                return False
            at = other[:, fine][:, :1]
    return True


def judged(q: np.ndarray, drift: np.ndarray, error: float, robot: Robot) -> dict[str, Any]:
    """Whether joints stay within limits, follow the path, and repeat from the first round on."""
    beyond = float(np.maximum(robot.lower - q, q - robot.upper).max())
    inside = beyond <= REPEATS
    whole = len(drift) == ROUNDS and error < FOLLOWS
    repeats = bool(inside and whole and drift.max() <= REPEATS)
    return {
        "inside": inside, "repeats": repeats, "drift": [float(d) for d in drift], "task_error": error, "beyond": beyond
    }  # fmt: skip


def pink(found: Plan) -> dict[str, Any]:
    """Joints of Pink with a posture task on the path of a plan, from its start."""
    task, robot = found.task, found.robot
    times = np.linspace(0.0, ROUNDS * found.period, ROUNDS * STEPS + 1)
    points = [found.task_target(float(t)).z for t in times]
    targets = np.repeat(np.eye(4)[None], len(times), axis=0)
    for target, z in zip(targets, points, strict=True):
        target[:3, 3] = z[:3]
        if task.m == 6:
            target[:3, :3] = z[3:].reshape(3, 3)
    assert isinstance(robot.shapes, Shapes)
    root = etree.fromstring(robot.shapes.urdf)
    for limit in root.iter("limit"):
        for key, value in limit.items():
            if abs(float(value)) > FAR and key in ("lower", "upper"):
                limit.set(key, str(np.copysign(FAR, float(value))))
    with tempfile.NamedTemporaryFile(suffix=".urdf") as file:
        file.write(etree.tostring(root))
        file.flush()
        start = found(found.start).q
        given = {
            "urdf": file.name, "frame": robot.options["chain_to"], "whole": task.m == 6, "q": start.tolist(),
            "targets": targets.tolist(), "period": float(times[1]),
        }  # fmt: skip
        done = subprocess.run(
            [str(PEERS["pink"].python), str(WORKERS / "path_pink.py")],
            input=json.dumps(given), check=True, capture_output=True, text=True,
        )  # fmt: skip
    reply = json.loads(done.stdout)
    q = np.array(reply["q"])
    error = max(float(np.abs(task.minus(z, task.value(row))).max()) for z, row in zip(points, q, strict=False))
    drift = np.abs(np.diff(q[::STEPS], axis=0)).max(axis=1)
    return judged(q, drift, error, robot) | {"message": reply["message"]}


def repeat(number: int, seed: int) -> dict[str, Any]:
    """One path by every method."""
    task, found, row = made(number, seed)
    if isinstance(found, EosError):
        failed = {"inside": False, "repeats": False, "message": str(found)}
        return row | {"planned": failed, "sampled": failed}
    start = found(0.0)
    row["plan_switches"] = switches(task, found.joints(np.linspace(found.start, found.end, 200)), THRESHOLD)
    laws = {"hold": None, "posture": Posture(start.q), "planned": FollowPlan(found), "sampled": FollowPlan(found)}
    for name, law in laws.items():
        controller = EosController(task, found.path, law, atlas=Atlas(task, threshold=THRESHOLD))
        options: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-9}
        run_of: Callable[..., Any] = simulate
        if name == "sampled":
            options, run_of = {"centred": True, "torque_limits": False}, simulate_sampled
        run = run_of(found.robot, controller, start.q, dq=start.dq, duration=ROUNDS * found.period, **options)
        row[name] = judged(run.q, run.joint_drift_per_cycle, float(np.abs(run.error).max()), found.robot)
        row[name] |= {"message": run.message, "switches": len(run.switches)}
    assert row["hold"]["switches"] > 0 or not row["changes_asked"], "v that is held was to change charts on this path"
    if not isinstance(installed(PEERS["pink"]), str):
        row["pink"] = pink(found)
    return row


def example(pose: bool = False) -> Plan:
    """A circle of Panda on which v that is held changes charts, with the hand's heading held or free."""
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    task: Task = PoseTask(robot, "panda_hand_tcp") if pose else PositionTask(robot, "panda_hand_tcp")
    if not pose:
        return plan(task, circle([0.7, 0.0, 0.4], 0.3, period=4.0))
    z = task.value(np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8]))
    return plan(task, PoseTrajectory(circle(z[:3], 0.15, period=4.0), pose=z))


def joining(number: int, seed: int, plans: tuple[Plan, Plan]) -> dict[str, Any]:
    """From a random posture within limits at the first task point; every second plan is of a pose."""
    found = plans[number % 2]
    task, robot = found.task, found.robot
    random = np.random.default_rng([seed, number])
    lower, upper = ranges(robot)
    manifold = Manifold(task)
    z = np.repeat(found.path(found.start).z[:, None], 200, axis=1)
    Q, good = manifold.search(random.uniform(lower, upper, (200, robot.n)).T, z, (lower, upper))
    q = Q[:, good][:, 0]
    row: dict[str, Any] = {"number": number, "task": "pose" if number % 2 else "position"}
    row["apart"] = float(np.abs(q - found(found.start).q).max())
    began = time.perf_counter()
    try:
        way = journey(found, q)
    except EosError as error:
        row["judged"] = (walked if number % 2 else mapped)(found, q)
        return row | {"outcome": "refused", "message": str(error), "seconds": time.perf_counter() - began}
    row["seconds"] = time.perf_counter() - began
    # The motion that joins, by Pinocchio alone.
    times = np.linspace(0.0, way.seconds, 400)
    inside = all(((lower <= x) & (x <= upper)).all() for x in (way.joints(float(t)).q for t in times))
    controller = EosController(task, way.path, way.law())
    run = simulate(robot, controller, q, duration=way.seconds + 0.5 + found.period, rtol=1e-8, atol=1e-10)
    met = run.info["joint_distance"]
    outcome = "joined" if met["max"] < REPEATS and inside else "away"
    return row | {"outcome": outcome, "message": run.message, "inside": inside, **met}


def walked(found: Plan, q: np.ndarray) -> str:
    """Whether walking along the self-motion of a pose, within limits, leads from joints to the start of a plan.

    Pinocchio alone: steps along the null space of the frame's Jacobian, each corrected by Newton's method.
    """
    model, data = found.robot.model, found.robot.model.createData()
    frame = model.getFrameId(str(found.robot.options["chain_to"]))
    goal = found(found.start).q
    pin.framesForwardKinematics(model, data, q)
    place = data.oMf[frame].copy()
    for sense in (1.0, -1.0):
        x, last, away = q.copy(), None, False
        for _ in range(20000):
            J = pin.computeFrameJacobian(model, data, x, frame, pin.LOCAL)
            along = np.linalg.svd(J)[2][-1]
            along *= sense if last is None else np.sign(along @ last)
            last, x = along, x + 0.005 * along
            for _ in range(3):
                pin.framesForwardKinematics(model, data, x)
                error = pin.log6(data.oMf[frame].actInv(place)).vector
                x = x + np.linalg.pinv(pin.computeFrameJacobian(model, data, x, frame, pin.LOCAL)) @ error
            if np.abs(x - goal).max() < 0.01:
                return "connected"
            away = away or float(np.linalg.norm(x - q)) > 0.05
            outside = ((x < model.lowerPositionLimit) | (x > model.upperPositionLimit)).any()
            if outside or (away and np.linalg.norm(x - q) < 0.004):
                break
    return "apart"


@cache
def roadmap(found: Plan, count: int = 20000, pieces: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Postures of a manifold within limits at the start of a plan, (K, n), its own first, and the part each is in.

    Neighbours are connected where all postures on the straight line between them, put on the manifold, are within
    limits and close to each other.
    """
    manifold, (lower, upper) = Manifold(found.task), ranges(found.robot)
    z = found.path(found.start).z[:, None]
    starts = np.random.default_rng(5).uniform(lower, upper, (3 * count, len(lower))).T
    Q, good = manifold.search(starts, np.repeat(z, starts.shape[1], axis=1), (lower, upper))
    Q = np.hstack((found(found.start).q[:, None], Q[:, good][:, :count]))
    near = cKDTree(Q.T).query(Q.T, k=20)[1]
    i, j = np.repeat(np.arange(Q.shape[1]), 19), near[:, 1:].ravel()
    good = lined(manifold, z, Q[:, i], Q[:, j], lower, upper, pieces)
    graph = coo_matrix((np.ones(good.sum()), (i[good], j[good])), shape=(Q.shape[1],) * 2)
    return Q.T, connected_components(graph, directed=False)[1]


def lined(
    manifold: Manifold, z: np.ndarray, A: np.ndarray, B: np.ndarray, lower: np.ndarray, upper: np.ndarray, pieces: int
) -> np.ndarray:
    """Whether straight lines between postures, put on the manifold, stay within limits and are continuous."""
    good, before = np.ones(A.shape[1], bool), A
    longest = 0.02 + 2.5 * np.abs(B - A).max(axis=0) / pieces
    for part in np.linspace(0.0, 1.0, pieces + 1)[1:]:
        on, found = manifold.project(A + part * (B - A), z, iterations=8)
        within = ((on >= lower[:, None] - 1e-9) & (on <= upper[:, None] + 1e-9)).all(axis=0)
        good &= found & within & (np.abs(on - before).max(axis=0) < longest)
        before = on
    return good


def mapped(found: Plan, q: np.ndarray) -> str:
    """Whether a roadmap of the manifold connects joints with the start of a plan."""
    Q, part = roadmap(found)
    manifold, (lower, upper) = Manifold(found.task), ranges(found.robot)
    near = Q[cKDTree(Q).query(q, k=20)[1]].T
    z = found.path(found.start).z[:, None]
    good = lined(manifold, z, np.repeat(q[:, None], 20, axis=1), near, lower, upper, 8)
    own = part[cKDTree(Q).query(q, k=20)[1]][good]
    return "not on the map" if not len(own) else "connected" if part[0] in own else "apart"


def disturbed(number: int, seed: int, plans: tuple[Plan, Plan]) -> dict[str, Any]:
    """A push at a random time, and a pause and two changes of speed; the run ends three seconds after the last."""
    random = np.random.default_rng([seed, number])
    found = plans[number % 2]
    task, clock = found.task, Clock()
    at, force = random.uniform(0.2, 1.0), random.normal(size=task.m) * 20.0
    # Moments as of a push 5 cm beside the origin of the frame.
    force[3:] *= 0.05
    pause, rest = random.uniform(1.0, 1.5), random.uniform(0.6, 1.0)
    clock.pause(pause)
    clock.resume(pause + rest, float(random.uniform(0.3, 1.2)))
    clock.set_speed(pause + rest + 0.6, float(random.uniform(0.3, 1.2)))
    push = TaskForce(task, lambda t: force * np.exp(-(((t - at) / 0.05) ** 2)))
    law = FollowPlan(found, clock=clock)
    run = simulate(
        found.robot, EosController(task, law.path, law), found(0.0).q, dq=found(0.0).dq, duration=4.5,
        task_force=push, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    met = run.info["joint_distance"]
    outcome = "back" if met["end"] < REPEATS else "away"
    return {"number": number, "outcome": outcome, "message": run.message, **met}


#: Methods of `repeat` in words.
METHODS = {
    "hold": "v held", "posture": "posture control", "pink": "Pink, posture task (kinematics)",
    "planned": "planned, continuous time", "sampled": "planned, torques held for 1 ms",
}  # fmt: skip


def told(command: str, rows: list[dict[str, Any]]) -> tuple[str, list[str], list[list[str]]]:
    """Title, columns and rows of what was found."""
    if command == "repeat":
        changing = [row for row in rows if row.get("hold", {}).get("switches", 0)]
        cells = []
        for name, words in METHODS.items():
            met = [row for row in rows if name in row]
            if not met:
                continue
            of = [row[name] for row in met]
            those = [row[name]["repeats"] for row in met if row in changing]
            worst = max((max(m["drift"]) for m in of if m["repeats"]), default=0.0)
            cells.append([
                words, f"{sum(m['repeats'] for m in of)} of {len(of)}", f"{sum(those)} of {len(those)}",
                f"{sum(m['inside'] for m in of)} of {len(of)}", f"{worst:.1e}",
            ])  # fmt: skip
        columns = ["method", "repeats within limits", "of these where v held changes charts", "stays within limits"]
        title = f"{len(rows)} of {PATHS} closed paths; on {len(changing)} of them v that is held changes charts"
        return title, [*columns, "largest drift of those that repeat, rad a round"], cells
    cells = []
    for outcome, judged_as in sorted({(row["outcome"], row.get("judged", "")) for row in rows}):
        met = [row for row in rows if (row["outcome"], row.get("judged", "")) == (outcome, judged_as)]
        ends = [row["end"] for row in met if "end" in row]
        cells.append([outcome, judged_as or "-", str(len(met)), f"{max(ends):.1e}" if ends else "-"])
    columns = ["outcome", "judged by something else", "cases", "furthest from the plan at the end, rad"]
    return f"{command}: {len(rows)} cases", columns, cells


def others(rows: list[dict[str, Any]]) -> list[list[str]]:
    """The paths that were not planned, or whose joints do not repeat under torque control: reason and place."""
    cells = []
    for row in rows:
        planned, sampled = row["planned"], row["sampled"]
        name = [str(row["number"]), row["robot"], row["task"], row["shape"]]
        if "solvable" in row:
            reason = planned["message"].split(". ")[0]
            cells.append([*name, f"refused: {reason}", row["solvable"]])
        elif not (planned["repeats"] and sampled["repeats"]):
            met = planned if not planned["repeats"] else sampled
            reason = met["message"] or "the joints come back further off than 1e-6 rad"
            kind = "continuous time" if met is planned else "held torques"
            drift = f", {met['drift'][0]:.1e} rad in the first round" if met["drift"] else ""
            cells.append([*name, f"{kind}: {reason}{drift}", "planned"])
    return cells


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("repeat", "joining", "disturbed"))
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true", help="write the table into docs/planning.md")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.json is not None and options.json.exists():
        rows = json.loads(options.json.read_text())
    if options.command == "repeat":
        case: Callable[[int, int], dict[str, Any]] = repeat
    else:
        both = example(), example(pose=True)
        one = joining if options.command == "joining" else disturbed
        case = lambda number, seed: one(number, seed, both)  # noqa: E731
    done = {row["number"] for row in rows}
    for number in range(options.count):
        if number in done:
            continue
        rows.append(case(number, options.seed))
        if options.json is not None:
            options.json.write_text(json.dumps(rows, indent=1) + "\n")
        print(json.dumps(rows[-1])[:400], flush=True)
    console, (title, columns, cells) = Console(), told(options.command, rows)
    table = Table(*columns, title=title)
    for cell in cells:
        table.add_row(*cell)
    console.print(table)
    if options.write:
        text = f"\n\n{title}:\n{marked.table(columns, cells)}"
        if options.command == "repeat" and (rest := others(rows)):
            heads = ["number", "robot", "task", "shape", "reason", "motions by a random search of all joints"]
            text += f"\nThe paths that were not planned, or do not repeat:\n{marked.table(heads, rest)}"
        marked.fill(marked.PLANNING, options.command, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
