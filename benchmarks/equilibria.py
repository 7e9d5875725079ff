"""Predicted frequencies and growth of the self-motion at equilibria under gravity, against simulated motions.

Run it by `python benchmarks/equilibria.py`; `--write` puts the table into docs/explore.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from marked import HOME, fill, table

sys.path.insert(0, str(HOME / "tests" / "planning"))

from test_equilibria import found_at, frequency, moved

CASES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("panda", "pose", {}),
    ("xarm7", "pose", {}),
    ("planar_chain_10", "position", {"gravity": (0.0, -9.81, 0.0)}),
)
COLUMNS = "robot, task", "stable", "frequencies", "worst error", "unstable", "worst error of the rate", "all leave"


def motions(name: str, kind: str, options: dict[str, Any]) -> Iterator[tuple[bool, float, bool]]:
    """Of each motion: whether it oscillates, the relative error of its rate, and whether the robot leaves.

    At stable equilibria these are all modes, at unstable ones the fastest that grows: it takes over from any other.
    """
    manifold, found = found_at(name, kind, **options)
    for each in found:
        if each.stable:
            for mode, wanted in enumerate(each.frequencies):
                t, x = moved(manifold, each, mode, 1e-3, 3.1 / wanted)
                yield True, abs(frequency(t, x) / wanted - 1.0), False
        else:
            rate = each.growth.max()
            # From rest x = size cosh(rate t), as long as it is small.
            t, x = moved(manifold, each, 0, 1e-5, 6.0 / rate)
            late = t > 3.0 / rate
            seen = np.polyfit(t[late], np.log(np.abs(x[late])), 1)[0]
            yield False, abs(seen / rate - 1.0), bool(np.abs(x[-1]) > 100.0 * np.abs(x[0]))


def row(name: str, kind: str, options: dict[str, Any]) -> tuple[str, ...]:
    """One robot's row of the table."""
    _, found = found_at(name, kind, **options)
    seen = list(motions(name, kind, options))
    swings = [error for oscillates, error, _ in seen if oscillates]
    falls = [(error, leaves) for oscillates, error, leaves in seen if not oscillates]
    return (
        f"{name}, {kind}",
        str(sum(each.stable for each in found)),
        str(len(swings)),
        f"{max(swings):.2%}",
        str(len(falls)),
        f"{max(error for error, _ in falls):.2%}",
        "yes" if all(leaves for _, leaves in falls) else "no",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or write it into the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="put the table into docs/explore.md")
    options = parser.parse_args(arguments)
    rows = []
    for case in CASES:
        rows.append(row(*case))
        print(*rows[-1], sep=" | ", flush=True)
    if options.write:
        fill(HOME / "docs" / "explore.md", "equilibria.py", table(COLUMNS, rows))


if __name__ == "__main__":
    main()
