"""docs/performance.md, written from what `run.py` measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import compiled_text
from ratios import Ratio
from sections import Section

from eos_pin.cli.output import format_number

DOCUMENT = Path(__file__).parent.parent / "docs" / "performance.md"

_HEAD = """# How fast it is, beside other libraries

<!-- written by `python benchmarks/run.py --write`; do not edit -->

Every figure here comes from one run of `python benchmarks/run.py --write`, after `python benchmarks/peers.py setup`
had installed the peers, each in an environment of its own. Everybody gets the same file of the same robot (gripper
locked, meshes left out), the same state, the same target; answers are checked by Pinocchio's forward kinematics and
dynamics before anything is timed. One thread each, CPU time; rounds take turns, so that whatever disturbs the machine
disturbs all alike. Times are medians. **What counts are the ratios**: microseconds are those of one machine.
"""

_LIMITS = """## What the figures do not say

- *Peers solve other problems.* TSID and PlaCo solve a quadratic program with inequalities in every step: contacts,
  several tasks in order of priority, floating bases, limits of everything. `EosController` solves one linear system
  and knows no limits; `LimitedEosController` keeps limits of position, velocity, acceleration and torque, but has one
  task and no contacts. Pink, mink and Drake's differential inverse kinematics compute velocities, not torques, with
  limits and, in part, barriers against collisions; a torque controller comes after them.
- *What the others do not do.* None has coordinates for the self-motion. A posture task pulls the joints towards one
  posture; it sets no self-motion to follow, and none of its errors decays at a rate one has designed.
- *Languages.* TSID, PlaCo, Drake and the Robotics Toolbox compute in C++ and are called from Python, as most of their
  users do; eos_pin is Python around C++ with its everyday sums compiled, Pink and mink are Python around C++. Called
  from C++ the first are faster than here. Without a C compiler at installation eos_pin's step takes
  <!-- compiled.py --><!-- end --> as long (`benchmarks/compiled.py`).
- *What is the same.* In the state that is timed TSID's torque is that of EOS control, also with an active limit. PlaCo
  adds a small regularization. Traditional control has another law for the null space, so its torque differs where the
  motion of the task does not. eos_pin evaluates its path in every step; the peers are handed the target.
- *Inverse kinematics.* Peers take full steps from the rest posture, without limits and posture task: their fastest
  way. eos_pin holds the self-motion coordinates too, so that the solution is determined. To random targets
  `Atlas.follow` walks along the straight line of the task, so that the solution is connected to the start; that takes
  longer, and the line can end at a singularity. `Atlas.solve` then goes via other points and searches, for joints
  within their limits. So were the rows that say so; some of the other peers could be asked, too.
- *Versions.* TSID is the last one that comes as a whole from PyPI, with the Pinocchio it was built with. The newer
  ones there are bindings whose library has to be built from source, against another Pinocchio than theirs.
- *What is measured elsewhere.* `benchmarks/chains.py` (up to 1,000 joints), `benchmarks/sweep.py` (many runs on one
  core and on two), `benchmarks/startup.py` (from process start to the first step), `benchmarks/compiled.py` (each
  compiled kernel beside its plain form).
- *Memory and pauses.* The long loop runs in an ordinary Python process, and Python gives no guarantee of real time.
"""


def page(
    machine: Mapping[str, str], sections: Sequence[Section], ratios: Sequence[Ratio], missing: Mapping[str, str]
) -> str:
    """The page.

    Args:
        machine: What was measured on and with.
        sections: The tables.
        ratios: What they come to.
        missing: What could not be measured, and why.
    """
    parts = [_HEAD, "Measured with: " + "; ".join(f"{name} {what}" for name, what in machine.items()) + "."]
    rows = [ratio.row for ratio in ratios]
    parts += ["## Ratios", _table(("what", "task", "measured", "aim", "met"), rows), _slower(sections)]
    for section in sections:
        parts += [f"## {section.title}", _table(section.columns, section.rows), section.note]
    parts.append(compiled_text.filled(_LIMITS))
    if missing:
        parts += ["## Not measured", _table(("what", "why"), list(missing.items()))]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _slower(sections: Sequence[Section]) -> str:
    """Who is faster than eos_pin at what, said plainly."""
    found = []
    for section in sections:
        for i, head in enumerate(section.columns):
            if head != "× eos_pin" or "reached, %" in section.columns:
                continue
            away = section.columns[i - 2].partition(",")[0]
            ahead = [f"{row[0]} ({row[1]}) {row[i]:.2g}" for row in section.rows if row[i] < 1.0 and _rival(row)]
            if ahead:
                where = section.title.lower() + (f" from {away}" if away != "median" else "")
                found.append(f"- {where}: {', '.join(ahead)}")
        found += _fewer(section)
    if not found:
        return "In no table below is a peer faster than eos_pin."
    return "Where peers are faster, as part of eos_pin's time, or reach more:\n\n" + "\n".join(found)


def _fewer(section: Section) -> list[str]:
    """Robots on which a peer reaches more of the random targets, or needs less time for a solution in limits."""
    if "reached, %" not in section.columns:
        return []
    share, mean = section.columns.index("reached, %"), section.columns.index("× eos_pin")
    found = []
    for robot in dict.fromkeys(row[0] for row in section.rows):
        rows = [row for row in section.rows if row[0] == robot]
        own = max(row[share] for row in rows if row[1] == "eos_pin")
        best = max((row for row in rows if row[1] != "eos_pin"), key=lambda row: (row[share], -row[mean]), default=None)
        if best is not None and (best[share] > own or best[mean] < 1.0):
            other = f"{best[1]} ({best[2]}) {best[share]:.3g} % in {best[mean]:.2g} of the time"
            found.append(f"- {section.title.lower()}, {robot}: eos_pin reaches {own:.3g} %, {other}")
    return found


def _rival(row: Sequence[Any]) -> bool:
    """Whether a row is another library that does the job."""
    return row[0] != "eos_pin" and "calls alone" not in row[1]


def shown(cell: Any) -> str:
    """A cell: three digits, but no powers of ten for what is merely large."""
    if not isinstance(cell, float):
        return str(cell)
    return f"{cell:.0f}" if 1000.0 <= abs(cell) < 1e7 else format_number(cell)


def _table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = [columns, ["---"] * len(columns), *([shown(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)
