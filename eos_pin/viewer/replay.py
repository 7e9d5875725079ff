"""The replay of runs: robot, paths and curves over time on one page, under one clock."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from eos_pin._arrays import Array, JointVector, checked
from eos_pin._files import write_atomically
from eos_pin.errors import InputError
from eos_pin.planning.obstacles.clearance import Obstacle
from eos_pin.robot.model import Robot
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory
from eos_pin.viewer.curves import COLORS, described, panels_of
from eos_pin.viewer.scene import Placed, Scene, packed, sampled
from eos_pin.viewer.viewer import page

#: Half the distance of robots that stand beside each other, as a part of the reach of the largest.
APART = 0.62
#: Direction from left to right as the page looks at it.
ACROSS = np.array([1.0, 0.62, 0.0]) / np.hypot(1.0, 0.62)
FPS = 30.0


@checked
def write_replay(
    path: str | Path,
    runs: Result | Mapping[str, Result],
    robot: Robot | None = None,
    *,
    obstacles: Sequence[Obstacle] = (),
    title: str = "",
) -> Path:
    """Write the replay of a run, or of several by name, as one HTML file that plays offline.

    Curves of joints, errors, self-motion, torques and energies stand beside the picture and are scrubbed with it. The
    first of several runs is solid and the others are ghosts at its place, or all stand side by side.

    Args:
        path: File to write; an existing one is replaced when the new one is complete.
        runs: The runs.
        robot: The robot that moved in all of them; by default each is loaded again from where it came.
        obstacles: Solids around it.
        title: Heading; by default robot and task.

    Raises:
        InputError: There is no run, or one without samples.
        ResultError: A robot was made in memory, or its URDF has changed since: hand it over.
        OutputError: The file cannot be written.
    """
    named = {"": runs} if isinstance(runs, Result) else dict(runs)
    scenes = {
        name: scene_of(run, robot or run.load_plant(), obstacles if k == 0 else (), title=title)
        for k, (name, run) in enumerate(named.items())
    }
    path, text = Path(path), replay_page(named, scenes)
    write_atomically(path, lambda file: file.write(text.encode()))
    return path


def replay_page(runs: Mapping[str, Result], scenes: Mapping[str, Scene], *, connect: str = "'none'") -> str:
    """The page of runs and their scenes by name.

    Args:
        runs: The runs.
        scenes: Scene of each; title and caption are those of the first.
        connect: Connections that the page may make; a file needs none.

    Raises:
        InputError: There is no run, or one without samples.
    """
    if not runs or not all(len(run.t) for run in runs.values()):
        raise InputError("a replay needs runs with samples: there is nothing to show")
    first, many = next(iter(scenes.values())), len(runs) > 1
    start, end = (pick(pick(run.t) for run in runs.values()) for pick in (min, max))
    frames = np.linspace(start, end, int(np.ceil((end - start) * FPS)) + 1)
    side = APART * max(scene.robot.reach for scene in scenes.values()) * ACROSS
    shown, curves = [], {}
    for k, (name, run) in enumerate(runs.items()):
        robot = scenes[name].robot
        # A run that ends before the others rests at its end.
        t, q = sampled(robot, run.t, run.q, rate=2.0 * FPS)
        q = np.column_stack([np.interp(frames, t, column) for column in q.T])
        offset = (2 * k - len(runs) + 1) * side
        color = COLORS[k % len(COLORS)] if many else ""
        shown.append(Placed(scenes[name], q, offset, name if many else "", color, ghost=k > 0))
        curves[name] = run.t, panels_of(run, robot)
    caption = f"Solid: {next(iter(runs))}; as ghosts: {', '.join(list(runs)[1:])}." if many else first.caption
    # A robot at rest has no curves.
    more = {"curves": described(curves)} if end > start else {}
    title = first.title or first.robot.name
    return page(packed(frames, shown, title=title, caption=caption, more=more), connect=connect)


def scene_of(result: Result, robot: Robot, obstacles: Sequence[Obstacle] = (), *, title: str = "") -> Scene:
    """Scene of a run: the robot, its reference path, and the trace of the frame that follows it."""
    frame, kind = result.frame, (result.info.get("task") or {}).get("kind", "motion")
    paths = {}
    if frame and result.axes and not result.seen_from and len(result.t) and np.isfinite(result.z_ref).all():
        tip = np.array([robot.placement(q, frame).translation for q in result.q])
        paths["reference"] = placed(tip, result.z_ref, result.axes)
    summary = result.summary()
    law = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", result.info.get("controller", {}).get("kind", "")).lower()
    caption = f"{law.replace('eos', 'EOS')}: task error {summary['task_error_max']:.3g}".removeprefix(": ")
    drift = summary["joint_drift_per_cycle"]
    caption += f", joint drift per cycle {drift[-1]:.3g}" if drift else ""
    used = summary["limits"]
    caption += f"; limits {used['message']}" if math.isfinite(used["worst"]) else ""
    traces = {"actual": frame} if frame else {}
    return Scene(robot, paths, traces, tuple(obstacles), title or f"{robot.name}: {kind}", caption)


def live_scene(
    robot: Robot, q: JointVector, duration: float, follows: tuple[Task, Trajectory] | None, *, title: str
) -> Scene:
    """Scene of a run that goes on: the robot, the path it is asked to follow, and the trace of its frame."""
    if follows is None or not follows[0].frame:
        return Scene(robot, title=title)
    task, reference = follows
    paths = {}
    if task.axes and not task.seen_from:
        z = np.array([reference(t).z for t in np.linspace(0.0, duration, 400)])
        tip = robot.placement(q, task.frame).translation
        paths["reference"] = placed(np.tile(tip, (len(z), 1)), z, task.axes)
    return Scene(robot, paths, {"actual": task.frame}, title=title)


def placed(tip: Array, z: Array, axes: str) -> Array:
    """Places of task points (k, 3); along axes that do not count they lie where the frame is."""
    points = tip.copy()
    points[:, ["xyz".index(axis) for axis in axes]] = z[:, : len(axes)]
    return points
