"""`eos-pin explore`: task and self-motion of a robot, moved by hand."""

from __future__ import annotations

from pathlib import Path

from eos_pin._files import check_writable
from eos_pin.cli.demo import FOLDER, opened
from eos_pin.cli.output import print_files, say_notes
from eos_pin.experiments.options import RobotOptions, TaskOptions


def explore(robot: RobotOptions, task: TaskOptions = TaskOptions(), html: Path | None = None) -> int:
    """Open a page on which the self-motion of a robot is seen and steered.

    Sliders and handles move the task with the self-motion at rest, and the self-motion with the task at rest. With one
    redundant joint the loop of the elbow is drawn, with limits, collisions and singularities. The page is one file that
    works offline, computes by itself, and can be sent to others.

    Args:
        robot: The robot.
        task: Task of the robot: position, pose, orientation, heading, axis or point-axis.
        html: File to write instead of opening the browser.

    For example:

      eos-pin explore panda --task pose
      eos-pin explore path/to/robot.urdf --frame tool0 --html robot.html
    """
    from eos_pin.viewer.explorer import write_explorer

    check_writable(html or FOLDER)
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    say_notes(goal)
    path = write_explorer(html or FOLDER / f"explore-{Path(robot.robot).stem}-{task.task}.html", goal, q)
    print_files([path])
    return opened(path) if html is None else 0
