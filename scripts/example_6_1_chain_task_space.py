"""Sec. 6.1: traditional control of the chain with ten joints whirls it about (Fig. 16)."""

from __future__ import annotations

import sys
from functools import partial

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper import claims, figures
from eos_pin.paper import examples as paper
from eos_pin.paper.run_example import run_example


def main(
    cycles: int = 3,
    gravity: bool = False,
    rtol: float = 1e-9,
    output: Output = Output(),
) -> int:
    """Sec. 6.1: traditional control of the chain with ten joints whirls it about (Fig. 16).

    Beside the paper's control runs a posture control in the null space: its joints repeat but for a full turn of one
    joint in each cycle.

    For example:

      python scripts/example_6_1_chain_task_space.py
      python scripts/example_6_1_chain_task_space.py --gravity
      python scripts/example_6_1_chain_task_space.py --out runs/6.1

    Args:
        cycles: Rounds of the figure eight.
        gravity: Let the chain hang upright; the paper lays it flat.
        rtol: Tolerance of the integrator.
        output: What to keep, and what to see.
    """
    example = paper.chain_task_space(cycles=cycles, gravity=gravity, rtol=rtol)
    return run_example(
        example,
        output,
        claims=partial(claims.traditional_drifts, section="6.1"),
        rows=lambda runs: [figures.motion(runs["task-space"]), figures.energies(runs)],
    )


if __name__ == "__main__":
    sys.exit(run(main))
