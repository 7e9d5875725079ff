"""The explorer: one page on which the self-motion of a robot is seen and steered, with kinematics of its own."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from eos_pin._arrays import JointVector, checked
from eos_pin._files import write_atomically
from eos_pin._kernels.flat import KINDS, POLE, FlatModel, flat_model
from eos_pin.charts.chart import Chart
from eos_pin.errors import InputError, RobotError
from eos_pin.planning.manifolds.manifold import SelfMotionManifold, self_motion_manifold
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.viewer.scene import Placed, Scene, packed
from eos_pin.viewer.viewer import page, script

#: Postures per component that show how far the elbow moves.
SAMPLES = 40
#: Distance of the mark beside a tool that turns about its axis, in parts of the robot's reach.
BESIDE = 0.12
#: Colours of Matplotlib's scale cividis at equal steps, which paint the loop; between them they are mixed.
COLOURS = "#00224e #1a386f #434e6c #61656f #7d7c78 #9b9476 #bcae6c #dec958 #fee838"
NO_CAPSULES: dict[str, Any] = {"carriers": [], "ends": [], "radii": [], "pairs": []}


@checked
def write_explorer(path: str | os.PathLike[str], task: Task, q: JointVector, *, self_collision: bool = True) -> Path:
    """Write a page on which task and self-motion of a robot are moved by hand: one HTML file that works offline.

    The page computes joints y(z, v), charts and manifolds itself, by the formulas of this package in JavaScript.

    Args:
        path: File to write; an existing one is replaced when the new one is complete.
        task: Task made of positions, orientations, poses, headings and axes of frames, with fewer coordinates than the
            robot has joints.
        q: Posture at the start.
        self_collision: Whether the distance of the robot's links from each other is shown.

    Raises:
        InputError: Another kind of task, a robot of another kind of joints, or one without self-motion for this task.
        SingularError: The task is singular at q.
        OutputError: The file cannot be written.
    """
    robot, path = task.robot, Path(path)
    data, elbow = described(task, q, self_collision=self_collision)
    scene, spare = Scene(robot), robot.n - task.m
    text = page(
        packed(
            np.zeros(1),
            [Placed(scene, q[None])],
            title=f"{robot.name}: {task.kind.replace('_', '-')}, {spare} joint{'s' if spare > 1 else ''} to spare",
            caption=f"Drag the hand: the self-motion rests. Drag {elbow}: the task rests.",
            more={"explorer": data},
        ),
        scripts=(script("kinematics.js"), script("explorer.js")),
    )
    write_atomically(path, lambda file: file.write(text.encode()))
    return path


def described(task: Task, q: JointVector, *, self_collision: bool = True) -> tuple[dict[str, Any], str]:
    """Robot and task in plain values for the page, and the name of the handle that moves v."""
    robot = task.robot
    if task.m >= robot.n:
        raise InputError(
            f"{robot.name!r} has {robot.n} joints and {task!r} {task.m} coordinates: it has no self-motion to explore; "
            "choose a smaller task"
        )
    parts, flat = task.frame_parts(), flat_model(robot.model)
    if parts is None:
        raise InputError(
            f"the explorer has formulas for the tasks position, orientation, pose, heading, axis and point-axis, "
            f"not for {task!r}; choose one of them"
        )
    if flat is None:
        following = [f"{name} follows {leader}" for name, leader in robot.mimics.items() if name in robot.model.names]
        raise InputError(
            "the explorer is for joints that turn or slide by themselves; "
            f"of {robot.name!r} {', '.join(following) or 'some do neither'}: choose a frame before them"
        )
    tips = [flat.tip(robot.model, part) for part in parts]
    chart = Chart.from_base(task, q)
    data = {
        "parents": flat.parents.tolist(),
        "prismatic": flat.prismatic.tolist(),
        "fixed": flat.fixed.tolist(),
        "turns": flat.turns.reshape(-1, 9).tolist(),
        "parts": [
            {"joint": joint, "kind": KINDS[part.kind], "axes": list(part.axes), "tip": tip.tolist()}
            for (joint, tip), part in zip(tips, parts, strict=True)
        ],
        "colours": COLOURS.split(),
        "pole": POLE.ravel().tolist(),
        "joints": list(robot.joint_names),
        "labels": list(task.labels),
        "units": list(task.units),
        "unit": "m" if flat.prismatic.all() else "rad or m" if flat.prismatic.any() else "rad",
        "q": q.tolist(),
        "V": chart.V.ravel().tolist(),
        "reach": robot.reach,
        **_finite("lower", robot.lower),
        **_finite("upper", robot.upper),
        **_finite("effort", robot.effort),
        **_masses(robot, flat),
        "capsules": _capsules(robot, flat, q) if self_collision else NO_CAPSULES,
    }
    others, moved = _elsewhere(task, q, chart)
    elbow, distance = _furthest(robot, moved)
    frame = robot.frame_id(robot.joint_names[elbow])
    joint, place = flat.carried(robot.model, frame)
    room = [robot.placement(each, robot.model.frames[frame].name).translation.tolist() for each in moved]
    name = "elbow"
    if distance < 1e-3 * robot.reach:
        # The tool turns about its axis, and no joint's origin moves: a point beside it shows the turn.
        (joint, tip), name = tips[0], "mark"
        place = tip.copy()
        place[9:] += BESIDE * robot.reach * tip[:9].reshape(3, 3)[:, 0]
    data |= {"components": others, "elbow": {"joint": joint, "place": place.tolist(), "name": name}, "room": room}
    return data, "the mark beside the tool" if name == "mark" else f"the elbow, {robot.joint_names[elbow]}"


def _finite(name: str, values: JointVector) -> dict[str, list[float | None]]:
    """Limits without infinities, which JSON does not have."""
    return {name: [float(value) if np.isfinite(value) else None for value in values]}


def _masses(robot: Robot, flat: FlatModel) -> dict[str, Any]:
    inertias = list(robot.model.inertias)[1:]
    return {
        "masses": [float(inertia.mass) for inertia in inertias],
        "centres": [(turn.T @ inertia.lever).tolist() for turn, inertia in zip(flat.turns, inertias, strict=True)],
        "inertias": [
            (turn.T @ inertia.inertia @ turn).ravel().tolist()
            for turn, inertia in zip(flat.turns, inertias, strict=True)
        ],
        "armature": robot.model.armature.tolist(),
        "gravity": robot.model.gravity.linear.tolist(),
        "weighs": not robot.lacks_dynamics,
    }


def _capsules(robot: Robot, flat: FlatModel, q: JointVector) -> dict[str, Any]:
    """Capsules around the links, and the pairs of them that may touch.

    There are none where the robot has no collision shapes, and where capsules are so thick that they
    touch at the start.
    """
    carriers, ends, radii = [], [], []
    try:
        bodies = Bodies.fitted(robot)
    except RobotError:
        return NO_CAPSULES
    if not bodies.pairs or Clearances(bodies).pairs(q[:, None]).min() < 0.0:
        return NO_CAPSULES
    for link, capsule in bodies.capsules:
        joint, place = flat.carried(robot.model, robot.frame_id(link))
        R, p = place[:9].reshape(3, 3), place[9:]
        carriers.append(joint)
        ends.append([(R @ np.asarray(end) + p).tolist() for end in (capsule.start, capsule.end)])
        radii.append(float(capsule.radius))
    return {"carriers": carriers, "ends": ends, "radii": radii, "pairs": [list(pair) for pair in bodies.pairs]}


def _elsewhere(task: Task, q: JointVector, chart: Chart) -> tuple[list[list[float]], Any]:
    """A posture of each other component of the manifold at the start, and motions that leave the task where it is."""
    if chart.r > 1:
        steps = 0.3 * chart.V.T
        found = task.kinematics.project(np.concatenate((q + steps, q - steps)), chart.z_bar, tol=1e-9)
        return [], np.concatenate((q[None], found.q[found.found]))
    manifold: SelfMotionManifold = self_motion_manifold(task, chart.z_bar, starts=[q])
    others, own = [], q[None]
    for i, component in enumerate(manifold.components):
        S = component.length * np.arange(SAMPLES) / SAMPLES
        if component.locate(q).distance < 1e-6:
            own = component.at(S)
            continue
        # The middle of its longest arc within limits, or anywhere.
        arcs = [arc for arc in manifold.arcs if arc.component == i]
        arc = max(arcs, key=lambda arc: arc.length, default=None)
        others.append(
            (component.at(0.0) if arc is None else manifold.joints(arc, [0.5 * (arc.start + arc.end)])[0]).tolist()
        )
    return others, own


def _furthest(robot: Robot, moved: Any) -> tuple[int, float]:
    """Number of the joint whose origin moves furthest, and that distance [m]."""
    places = np.array([[robot.placement(q, name).translation for name in robot.joint_names] for q in moved])
    far = np.linalg.norm(np.ptp(places, axis=0), axis=1)
    return int(np.argmax(far)), float(far.max())
