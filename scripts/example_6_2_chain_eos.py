"""Sec. 6.2: EOS control of the chain with ten joints repeats from the first cycle on (Fig. 17)."""

from __future__ import annotations

import sys

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper import claims, figures
from eos_pin.paper import examples as paper
from eos_pin.paper.run_example import run_example


def main(
    cycles: int = 3,
    rtol: float = 1e-9,
    output: Output = Output(),
) -> int:
    """Sec. 6.2: EOS control of the chain with ten joints repeats from the first cycle on (Fig. 17).

    With v held at 0 and with v left alone, each without gravity and with it: all four give the same joints.

    For example:

      python scripts/example_6_2_chain_eos.py
      python scripts/example_6_2_chain_eos.py --cycles 10
      python scripts/example_6_2_chain_eos.py --out runs/6.2

    Args:
        cycles: Rounds of the figure eight.
        rtol: Tolerance of the integrator.
        output: What to keep, and what to see.
    """
    example = paper.chain_eos(cycles=cycles, rtol=rtol)
    return run_example(
        example,
        output,
        claims=claims.chain_repeats,
        rows=lambda runs: [figures.motion(runs["eos"]), figures.energies(runs)],
    )


if __name__ == "__main__":
    sys.exit(run(main))
