"""What the tables of `run.py` come to: a few ratios, each with what it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sections import Section


@dataclass(frozen=True)
class Ratio:
    """Two figures of one run, divided; or one figure on its own.

    Attributes:
        what: What is compared.
        task: For which task.
        measured: What came out.
        aim: The most it should be.
    """

    what: str
    task: str
    measured: float
    aim: float

    @property
    def met(self) -> bool:
        """Whether it is as it should be."""
        return self.measured <= self.aim

    @property
    def row(self) -> tuple[Any, ...]:
        """Its line in a table."""
        return self.what, self.task, self.measured, f"≤ {self.aim:.3g}", "yes" if self.met else "no"


#: What is compared, the figure above the line, the figure below it ("" for none), and the most the ratio should be.
AIMS = (
    ("EOS step / TSID's", "eos_pin torque:", "TSID torque:", 1.3),
    ("EOS step / PlaCo's", "eos_pin torque:", "PlaCo torque:", 1.3),
    ("EOS step / Pink's velocity step", "eos_pin torque:", "Pink velocity:", 1 / 6),
    ("EOS step / the Pinocchio calls in it", "eos_pin torque:", "Pinocchio bare:", 2.2),
    ("step with inactive limits / without", "eos_pin torque:within limits", "eos_pin torque:", 2.0),
    ("step with an active limit / TSID's", "eos_pin torque:at limits", "TSID torque:at limits", 2.0),
    ("IK from 0.1 m / PlaCo's", "eos_pin inverse:chart", "PlaCo inverse:", 1.0),
    ("IK from 0.1 m / Pink's", "eos_pin inverse:chart", "Pink inverse:", 1 / 7),
    (
        "IK from 1 mm / Pinocchio's example, damped",
        "eos_pin inverse:chart, constant B, 1 mm",
        "Pinocchio inverse:damped, 1 mm",
        1 / 3,
    ),
    (
        "IK from 1 mm / Pinocchio's example, pseudoinverse",
        "eos_pin inverse:chart, constant B, 1 mm",
        "Pinocchio inverse:pseudoinverse, 1 mm",
        1 / 3,
    ),
    ("p99.9 / p50 of a step, the least of three", "eos_pin along: p99.9", "", 5.0),
    ("objects kept by all steps of the second half", "eos_pin along: kept", "", 10.0),
    ("CPU ms for a simulated second at 1e-9", "run 1e-09", "", 5.0),
)


def ratios(sections: Sequence[Section]) -> list[Ratio]:
    """All ratios whose figures were measured."""
    found = []
    for what, above, below, aim in AIMS:
        for task in ("position", "pose"):
            figures: dict[str, float] = {}
            for section in sections:
                if task in section.title and "random" not in section.title:
                    figures |= section.figures
            if above in figures and (not below or below in figures):
                found.append(Ratio(what, task, figures[above] / (figures[below] if below else 1.0), aim))
    return found
