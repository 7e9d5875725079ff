"""Cited application: a spatial arm of seven joints follows a path and keeps its real shape clear of a ball."""

import sys
from typing import Literal

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper.obstacle_examples import panda
from eos_pin.paper.run_obstacle_example import run_obstacle_example


def main(
    output: Output = Output(), task: Literal["pose", "position"] = "pose", margin: float = 0.15, cycles: int = 2
) -> int:
    """Swing the elbow of a Panda round a ball while its hand follows a path.

    Kinematic: q = y(z, v) on charts, and v(t) makes way. Distances are those of the arm's collision meshes, and joint
    limits are kept. Shown beside a constant v, with which the arm hits the ball.

    Args:
        output: What to keep.
        task: What the hand must keep: its pose (leaves one degree of redundancy) or its position (leaves four).
        margin: Distance below which the ball repels [m].
        cycles: Rounds of the path.

    For example:

      python scripts/example_7dof_obstacle.py --html ball.html --plot ball.pdf
    """
    title = f"Panda, {task} task, {1 if task == 'pose' else 4} degrees of redundancy, a ball beside the elbow"
    return run_obstacle_example(panda(task=task, margin=margin, cycles=cycles), output, title)


if __name__ == "__main__":
    sys.exit(run(main))
