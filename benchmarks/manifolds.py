"""Self-motion manifolds: all components, closure, small arcs, and how long they take.

    python benchmarks/manifolds.py [--poses 200] [--arms NAME ...] [--json FILE] [--write]

Arms that ssik knows in closed form are compared with it, where `benchmarks/peers.py setup ssik` has installed it: the
components are as many and the points are the same. On arms that it refuses, three seeds must find the same components,
and each must be closed. Small arcs: limits that leave a robot little room about a posture.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import marked
import numpy as np
import pinocchio as pin
import tyro
from crew import Worker, WorkerError
from lxml import etree
from peers import OTHERS, installed
from rich.console import Console
from rich.progress import track

from eos_pin import PoseTask, Robot, load_robot
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.errors import InputError
from eos_pin.planning.manifolds.manifold import SelfMotionManifold, self_motion_manifold
from eos_pin.robot.geometry import Shapes

#: An arm with three joints in one point at the shoulder, one at the elbow and three in one point at the wrist.
SRS = "spherical shoulder and wrist"
#: Robots by name, and the frame that is placed.
ARMS = {
    "panda": "panda_link8",
    SRS: "tool",
    "xarm7": "link_eef",
    "talos_reduced, left": "arm_left_7_link",
    "talos_reduced, right": "arm_right_7_link",
    "baxter, left": "left_gripper",
    "baxter, right": "right_gripper",
    "tiago": "arm_tool_link",
    "tiago_dual": "arm_left_tool_link",
    "tiago_pro": "arm_left_tool_link",
    "g1_29dof_rev_1_0": "left_rubber_hand",
    "alex_nub_hands": "LeftGripperYawLink",
    "pr2": "l_gripper_palm_link",
}
#: Seeds that must find the same.
SEEDS = 3
#: Random postures of the check by Pinocchio alone.
STARTS = 5000
#: Half of the room that small limits leave each joint [rad].
ROOM = (0.1, 0.01, 0.001)


@dataclass
class Arm:
    """What was measured on one arm.

    Attributes:
        name: The robot.
        components: Number of components, the least and the most.
        loop_ms: Milliseconds to trace one component, the least of five times, median and most.
        all_ms: Milliseconds for the whole manifold with its arcs, median.
        closure: Largest gap of a loop, whole turns left aside, or task error of a node [rad, m].
        same: Poses at which all seeds found the same components.
        arcs: Poses, of those with small limits, at which a posture within them was found.
        agreed: Poses at which ssik lists the same components; None where it refuses the arm.
        confirmed: Poses at which it lists fewer, but confirms the points of all, and a search from random postures by
            Pinocchio alone leads to each component and nowhere else.
        apart: Largest distance of its points from ours [rad].
        ssik_ms: Its milliseconds for all charts of one pose, median.
        refused: Why it refuses the arm.
        poses: Poses that were looked at.
    """

    name: str
    components: list[int] = field(default_factory=list)
    loop_ms: list[float] = field(default_factory=list)
    all_ms: list[float] = field(default_factory=list)
    closure: float = 0.0
    same: int = 0
    arcs: int = 0
    agreed: int = 0
    confirmed: int = 0
    apart: float = 0.0
    ssik_ms: float | None = None
    refused: str = ""
    poses: int = 0

    @property
    def row(self) -> tuple[Any, ...]:
        """Its line in a table."""
        compared = self.refused or f"{self.agreed} + {self.confirmed}, {self.apart:.0e}, {self.ssik_ms:.2g} ms"
        return (
            self.name,
            f"{min(self.components)}–{max(self.components)}",
            f"{np.median(self.loop_ms):.2f}, {max(self.loop_ms):.2f}",
            f"{np.median(self.all_ms):.1f}",
            f"{self.closure:.0e}",
            f"{self.same} of {self.poses}",
            f"{self.arcs} of {self.poses}",
            compared,
        )


def robot_of(name: str) -> Robot:
    """The arm, its other joints held."""
    if name == SRS:
        return load_robot(_srs())
    source, frame = name.partition(",")[0], ARMS[name]
    robot = load_robot(source, chain_to=frame)
    others = [str(joint) for joint in list(robot.model.names)[1:-7]]
    return load_robot(source, chain_to=frame, lock=others) if others else robot


def _srs() -> str:
    """URDF of an arm with the lengths of a common one."""
    heights, axes = (0.1575, 0.2025, 0.2045, 0.2155, 0.1845, 0.2155, 0.081), "zyz-yzyz"
    limits = (2.97, 2.09, 2.97, 2.09, 2.97, 2.09, 3.05)
    text, parent, signs = '<robot name="srs"><link name="base"/>', "base", axes.replace("-y", "Y")
    for i, (height, axis, limit) in enumerate(zip(heights, signs, limits, strict=True)):
        direction = {"z": "0 0 1", "y": "0 1 0", "Y": "0 -1 0"}[axis]
        text += (
            f'<link name="link{i}"><inertial><origin xyz="0 0 0.05"/><mass value="2"/><inertia ixx="0.02" iyy="0.02" '
            f'izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="joint{i}" type="revolute"><parent '
            f'link="{parent}"/><child link="link{i}"/><origin xyz="0 0 {height}"/><axis xyz="{direction}"/><limit '
            f'lower="{-limit}" upper="{limit}" velocity="2" effort="100"/></joint>'
        )
        parent = f"link{i}"
    tool = f'<joint name="tool" type="fixed"><parent link="{parent}"/><child link="tool"/><origin xyz="0 0 0.045"/>'
    return f'{text}<link name="tool"/>{tool}</joint></robot>'


def postures(robot: Robot, count: int) -> np.ndarray:
    """Joints drawn evenly from within their limits."""
    lower, upper = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    return np.random.default_rng(0).uniform(lower, upper, (count, robot.n))


def look(name: str, count: int) -> tuple[Arm, PoseTask, np.ndarray, list[SelfMotionManifold]]:
    """The manifolds of an arm at random poses that it reaches."""
    arm, robot = Arm(name, poses=count), robot_of(name)
    task = PoseTask(robot, ARMS[name])
    kinematics, manifolds = task.kinematics, []
    random = np.random.default_rng(1)
    for q in track(postures(robot, count), name, console=stderr, transient=True):
        z = task.value(q)
        found = []
        for seed in range(SEEDS):
            start = time.thread_time()
            found.append(self_motion_manifold(task, z, seed=seed))
            arm.all_ms.append(1e3 * (time.thread_time() - start))
        lengths = [sorted(component.length for component in manifold.components) for manifold in found]
        arm.same += all(len(x) == len(lengths[0]) and np.allclose(x, lengths[0], rtol=1e-3) for x in lengths)
        arm.components.append(len(lengths[0]))
        for component in found[0].components:
            nodes = component.curve.q
            gap = np.abs(nodes[-1] - nodes[0] - 2.0 * np.pi * component.winding).max() if component.closed else np.inf
            arm.closure = max(arm.closure, float(gap), float(kinematics.residual(nodes, z).max()))
            arm.loop_ms.append(1e3 * min(_seconds(partial(kinematics.trace, nodes[0], z=z)) for _ in range(5)))
        # The room is about q, anywhere within it.
        width = random.choice(ROOM)
        lower = q - width * random.uniform(0.0, 2.0, robot.n)
        small = self_motion_manifold(task, z, limits=(lower, lower + 2.0 * width))
        if not small.empty:
            posture = small.random(1)[0]
            inside = (posture >= lower).all() and (posture <= lower + 2.0 * width).all()
            arm.arcs += bool(inside and kinematics.residual(posture[None], z).max() <= 1e-9)
        manifolds.append(found[0])
    return arm, task, postures(robot, count), manifolds


def _seconds(work: Callable[[], object]) -> float:
    """Time of the processor that work takes."""
    start = time.thread_time()
    work()
    return time.thread_time() - start


def compare(arm: Arm, task: PoseTask, joints: np.ndarray, manifolds: Sequence[SelfMotionManifold]) -> None:
    """Hold what was found against ssik."""
    peer = OTHERS["ssik"]
    versions = installed(peer)
    if isinstance(versions, str):
        arm.refused = versions
        return
    worker = Worker(peer.name, peer.python, peer.worker)
    try:
        with tempfile.TemporaryDirectory() as folder:
            path, base = _written(task.robot, Path(folder))
            worker.take({"urdf": str(path), "base": base, "frame": task.frame})
            poses = [task.robot.placement(q, task.frame).homogeneous.ravel().tolist() for q in joints]
            answers = worker.run("manifold:points", poses, 0)["answers"]
            arm.ssik_ms = 1e-3 * float(np.median(worker.run("manifold:charts", poses, 1)["microseconds"]))
            for pose, answer, manifold in zip(poses, answers, manifolds, strict=True):
                _compare(arm, worker, pose, np.reshape(answer, (-1, 8)), manifold)
    except WorkerError as error:
        arm.refused = f"refused: {error}".replace("NotImplementedError: ", "")
    finally:
        worker.stop()


def _compare(arm: Arm, worker: Worker, pose: list[float], rows: np.ndarray, manifold: SelfMotionManifold) -> None:
    """Compare one pose."""
    pairs: dict[int, set[int]] = {}
    for number, *q in rows:
        located = [component.locate(np.array(q)).distance for component in manifold.components]
        nearest = int(np.argmin(located))
        pairs.setdefault(int(number), set()).add(nearest if located[nearest] <= 1e-6 else -1)
        arm.apart = max(arm.apart, located[nearest])
    found = [part.pop() if len(part) == 1 else -1 for part in pairs.values()]
    if -1 in found or len(set(found)) < len(found):
        return
    if len(found) == len(manifold.components):
        arm.agreed += 1
        return
    others = [c for i, c in enumerate(manifold.components) if i not in found]
    asked = [[*pose, *q] for component in others for q in component.curve.q[::10]]
    known = all(answer == [1.0] for answer in worker.run("manifold:located", asked, 0)["answers"])
    arm.confirmed += known and _found_by_pinocchio(manifold, pin.SE3(np.reshape(pose, (4, 4))))


def _found_by_pinocchio(manifold: SelfMotionManifold, goal: pin.SE3) -> bool:
    """Whether random postures led to a pose by Pinocchio alone meet each component, and nothing else."""
    task, random = manifold.task, np.random.default_rng(7)
    assert isinstance(task, PoseTask)
    hits = np.zeros(len(manifold.components), dtype=int)
    for _ in range(STARTS):
        q = _solved(task.robot.model, task.robot.model.getFrameId(task.frame), goal, random.uniform(-np.pi, np.pi, 7))
        if q is not None:
            distances = [component.locate(q).distance for component in manifold.components]
            if min(distances) > 1e-6:
                return False
            hits[int(np.argmin(distances))] += 1
    return bool(hits.all())


def _solved(model: pin.Model, frame: int, goal: pin.SE3, q: np.ndarray) -> np.ndarray | None:
    """Joints at a pose by damped Gauss-Newton steps; None where they end elsewhere."""
    data, damping, least = model.createData(), 1e-2, np.inf
    here, J = q, np.zeros((6, len(q)))
    for _ in range(100):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(goal)).vector
        size = float(error @ error)
        if size < 1e-22:
            return q
        if size < least:
            least, damping, here, best = size, max(0.3 * damping, 1e-12), q, error
            J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        elif damping > 1e6:
            return None
        else:
            damping = 8.0 * max(damping, 1e-9)
        step = J.T @ np.linalg.solve(J @ J.T + damping * min(1.0, least) * np.eye(6), best)
        q = here + step / max(1.0, np.abs(step).max())
    return None


def _written(robot: Robot, folder: Path) -> tuple[Path, str]:
    """URDF of a robot without what does not count, and its base."""
    assert isinstance(robot.shapes, Shapes)
    root = etree.fromstring(robot.shapes.urdf)
    for element in root.xpath("//visual | //collision | //transmission | //gazebo"):
        element.getparent().remove(element)
    children = {child.get("link") for child in root.iterfind("joint/child")}
    base = next(link.get("name") for link in root.iterfind("link") if link.get("name") not in children)
    path = folder / "robot.urdf"
    path.write_bytes(etree.tostring(root))
    return path, str(base)


def _measured(names: Sequence[str], poses: int) -> Iterator[Arm]:
    for name in names:
        arm, task, joints, manifolds = look(name, poses)
        compare(arm, task, joints, manifolds)
        yield arm


def manifolds(
    *,
    poses: int = 200,
    arms: tuple[str, ...] = tuple(ARMS),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    write: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> int:
    """Find and time the self-motion manifolds of arms at random poses.

    Args:
        poses: Poses of each arm.
        arms: Which arms.
        json_file: File for the figures.
        write: Write the table into docs/planning.md.
    """
    unknown = sorted({*arms} - {*ARMS})
    if unknown or poses < 1:
        raise InputError(f"at least one pose is needed, and arms are some of {'; '.join(ARMS)}; got {poses}, {unknown}")
    found = list(_measured(arms, poses))
    columns = ("arm", "components", "loop, ms", "all, ms", "closure", f"same, {SEEDS} seeds", "small arcs", "ssik")
    wide = Console(highlight=False, width=max(console.width, 160))
    wide.print(grid(f"Self-motion manifolds at {poses} poses", columns, [arm.row for arm in found]))
    if write:
        marked.fill(marked.PLANNING, "manifolds", "\n" + marked.table(columns, [arm.row for arm in found]))
    if json_file is not None:
        write_json(json_file, {"arms": [asdict(arm) for arm in found]})
    return 0


if __name__ == "__main__":
    sys.exit(run(manifolds))
