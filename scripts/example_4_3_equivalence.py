"""Sec. 4.3: the equations of motion in joints and those in task and self-motion coordinates have one solution."""

from __future__ import annotations

import sys

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper import claims, figures
from eos_pin.paper import examples as paper
from eos_pin.paper.run_example import run_example


def main(
    duration: float = 10.0,
    threshold: float = 0.8,
    rtol: float = 1e-13,
    output: Output = Output(),
) -> int:
    """Sec. 4.3: the equations of motion in joints and those in task and self-motion coordinates have one solution.

    The planar robot moves under given torques and a force on its tip. The joints found from the second form are
    compared with those of the first.

    For example:

      python scripts/example_4_3_equivalence.py
      python scripts/example_4_3_equivalence.py --duration 2 --threshold 0.5
      python scripts/example_4_3_equivalence.py --rtol 1e-9

    Args:
        duration: Length of the run [s]; one chart suffices to 2 s.
        threshold: A chart is left where its margin falls to this, between 0 and 1.
        rtol: Tolerance of the integrator; the absolute one is a tenth of it.
        output: What to keep, and what to see.
    """
    example = paper.equivalence(duration=duration, threshold=threshold, rtol=rtol)
    return run_example(example, output, claims=claims.equations_agree, rows=lambda runs: [figures.agreement(runs)])


if __name__ == "__main__":
    sys.exit(run(main))
