"""Sec. 2.2: velocity control by G'† drifts over a periodic task, inverse kinematics through charts does not."""

from __future__ import annotations

import sys
from typing import Literal

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper import claims, figures
from eos_pin.paper import examples as paper
from eos_pin.paper.run_example import run_example


def main(
    robot: str = "ppr",
    path: Literal["eight", "circle"] = "eight",
    cycles: int = 20,
    rtol: float = 1e-9,
    output: Output = Output(),
) -> int:
    """Sec. 2.2: velocity control by G'† drifts over a periodic task, inverse kinematics through charts does not.

    Both move the same robot along the same path. The first integrates dq = G'†(q) dz_d, the second finds the joints
    y(z_d(t), v) with v held, chart after chart where one does not suffice.

    For example:

      python scripts/example_2_2_noncyclic.py
      python scripts/example_2_2_noncyclic.py --robot planar_chain_10
      python scripts/example_2_2_noncyclic.py --robot panda --html panda.html

    Args:
        robot: Name or file of a robot: the paper's (ppr, planar_chain_10), panda, or your own.
        path: Path through where the tip is at the start.
        cycles: Rounds.
        rtol: Tolerance of the integrator.
        output: What to keep, and what to see.
    """
    example = paper.noncyclic(robot=robot, path=path, cycles=cycles, rtol=rtol)
    return run_example(example, output, claims=claims.rates_drift, rows=lambda runs: [figures.drifts(runs)])


if __name__ == "__main__":
    sys.exit(run(main))
