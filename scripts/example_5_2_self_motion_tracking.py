"""Sec. 5.2: EOS control holds the self-motion at v = 0, and the joints repeat (Figs. 8 and 9)."""

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
    """Sec. 5.2: EOS control holds the self-motion at v = 0, and the joints repeat (Figs. 8 and 9).

    The robot starts one metre from the path, so the first cycle brings it there; from then on every cycle is the same.

    For example:

      python scripts/example_5_2_self_motion_tracking.py
      python scripts/example_5_2_self_motion_tracking.py --no-gravity
      python scripts/example_5_2_self_motion_tracking.py --html replay.html --plot figure.pdf

    Args:
        cycles: Rounds of the figure eight.
        gravity: Let the robot stand upright; the paper leaves open whether it does.
        rtol: Tolerance of the integrator.
        output: What to keep, and what to see.
    """
    example = paper.self_motion_tracking(cycles=cycles, gravity=gravity, rtol=rtol)
    return run_example(
        example,
        output,
        claims=claims.eos_repeats,
        rows=lambda runs: [figures.paths(runs["eos"]), figures.motion(runs["eos"])],
    )


if __name__ == "__main__":
    sys.exit(run(main))
