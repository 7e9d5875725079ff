"""Cited application: a planar robot of 23 joints follows a path and keeps every body clear of three discs."""

import sys

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper.obstacle_examples import planar_chain
from eos_pin.paper.run_obstacle_example import run_obstacle_example


def main(output: Output = Output(), margin: float = 0.3, cycles: int = 2) -> int:
    """Weave a planar robot of 23 joints between three discs, one of which moves, while x, y and heading follow a path.

    Kinematic: q = y(z, v) on charts, and v(t), 20 coordinates, makes way for the discs. Shown beside a constant v.

    Args:
        output: What to keep.
        margin: Distance below which a disc repels [m].
        cycles: Rounds of the path.

    For example:

      python scripts/example_23dof_obstacles.py --html discs.html --plot discs.pdf
    """
    title = "23 joints, 20 degrees of redundancy, 3 discs"
    return run_obstacle_example(planar_chain(margin=margin, cycles=cycles), output, title)


if __name__ == "__main__":
    sys.exit(run(main))
