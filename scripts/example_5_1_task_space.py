"""Sec. 5.1: traditional task-space control follows the path, but the joints do not come back (Figs. 5 and 6)."""

from __future__ import annotations

import sys

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper import claims, figures
from eos_pin.paper import examples as paper
from eos_pin.paper.run_example import run_example


def main(
    cycles: int = 3,
    gravity: bool = True,
    rtol: float = 1e-9,
    output: Output = Output(),
) -> int:
    """Sec. 5.1: traditional task-space control follows the path, but the joints do not come back (Figs. 5 and 6).

    Beside the paper's control, which does nothing in the null space, runs what is used in practice, a posture control
    there: its joints do repeat after the first cycle, and nobody commands v.

    For example:

      python scripts/example_5_1_task_space.py
      python scripts/example_5_1_task_space.py --no-gravity --cycles 10
      python scripts/example_5_1_task_space.py --out runs/5.1

    Args:
        cycles: Rounds of the figure eight.
        gravity: Let the robot stand upright; the paper leaves open whether it does.
        rtol: Tolerance of the integrator.
        output: What to keep, and what to see.
    """
    example = paper.task_space(cycles=cycles, gravity=gravity, rtol=rtol)
    return run_example(
        example,
        output,
        claims=claims.traditional_drifts,
        rows=lambda runs: [
            figures.paths(runs["task-space"]),
            figures.motion(runs["task-space"]),
            figures.energies(runs),
        ],
    )


if __name__ == "__main__":
    sys.exit(run(main))
