"""Sec. 5.4: EOS control whose self-motion is repelled from an obstacle (Figs. 13 and 14)."""

from __future__ import annotations

import sys
from functools import partial
from typing import Annotated

import tyro

from eos_pin.cli.main import run
from eos_pin.cli.output import Output
from eos_pin.paper import claims, figures
from eos_pin.paper import examples as paper
from eos_pin.paper.run_example import run_example


def main(
    cycles: int = 3,
    gravity: bool = True,
    offset: Annotated[float, tyro.conf.arg(name="l")] = 10.0,
    damping: float = 0.0,
    rtol: float = 1e-9,
    output: Output = Output(),
) -> int:
    """Sec. 5.4: EOS control whose self-motion is repelled from an obstacle (Figs. 13 and 14).

    The potential of Eqs. (40), (41) acts on the rail. Without damping v only accelerates: slowly for a large l.

    For example:

      python scripts/example_5_4_obstacle.py
      python scripts/example_5_4_obstacle.py --l 2 --damping 20
      python scripts/example_5_4_obstacle.py --l -3 --damping 20

    Args:
        cycles: Rounds of the figure eight.
        gravity: Let the robot stand upright; the paper leaves open whether it does.
        offset: Offset in the distance d = l + y2 [m]; an obstacle below has a positive l, one above a negative.
        damping: Damping of the self-motion [1/s]; the paper has none, and without it v runs away for small l.
        rtol: Tolerance of the integrator.
        output: What to keep, and what to see.
    """
    example = paper.obstacle(cycles=cycles, gravity=gravity, offset=offset, damping=damping, rtol=rtol)
    return run_example(
        example,
        output,
        claims=partial(claims.obstacle_is_avoided, offset=offset),
        rows=lambda runs: [figures.paths(runs["eos"]), figures.motion(runs["eos"], trace=["tip", "rail_tip"])],
    )


if __name__ == "__main__":
    sys.exit(run(main))
