"""The page of the lesson: both runs side by side."""

from __future__ import annotations

import os
from pathlib import Path

import coal
import numpy as np

from eos_pin._files import write_atomically
from eos_pin.experiments.lesson import Lesson
from eos_pin.planning.obstacles.clearance import Obstacle
from eos_pin.viewer.replay import ACROSS, APART, FPS
from eos_pin.viewer.scene import Placed, Scene, packed, sampled
from eos_pin.viewer.viewer import page

#: Radius of the mark on the point that is held, as a part of the reach.
MARK = 0.035
RED = (0.84, 0.37, 0.0, 1.0)


def write_lesson(path: str | os.PathLike[str], found: Lesson) -> Path:
    """Write both runs as one HTML file that plays offline.

    Args:
        path: File to write; an existing one is replaced when the new one is complete.
        found: The runs.

    Raises:
        OutputError: The file cannot be written.
    """
    robot, path = found.task.robot, Path(path)
    frame = robot.options["chain_to"]
    hand = robot.placement(found.held.q[0], frame).translation
    circle = np.array([robot.placement(q, frame).translation for q in found.free.q[: found.free.cycle_rows[1] + 1]])
    mark = Obstacle(coal.Sphere(MARK * robot.reach), hand, "point that is held", RED)
    held = Scene(robot, traces={"elbow that is commanded": found.elbow}, obstacles=(mark,))
    free = Scene(robot, {"circle of the hand": circle}, {"elbow that nobody commands": found.elbow})
    t, q_held = sampled(robot, found.held.t, found.held.q, rate=FPS)
    _, q_free = sampled(robot, found.free.t, found.free.q, rate=FPS)
    side = APART * robot.reach * ACROSS
    shown = [
        Placed(held, q_held, -side, "The elbow goes where it is told"),
        Placed(free, q_free, side, "The elbow drifts"),
    ]
    caption = (
        f"EOS control: the hand holds a point, the elbow sweeps {found.swept:.1f} m and comes back.\n"
        f"Traditional control: after {found.rounds} rounds the hand is back, the joints {found.drifted:.1f} rad off."
    )
    text = page(packed(t, shown, title="A robot with a joint to spare", caption=caption))
    write_atomically(path, lambda file: file.write(text.encode()))
    return path
