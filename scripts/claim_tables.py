"""The runs that the paper's claims need, and the tables of claims in the docs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from eos_pin._files import write_atomically
from eos_pin.errors import OutputError
from eos_pin.paper import examples as paper
from eos_pin.paper.claims import FOOTNOTE, Claim
from eos_pin.paper.examples import Example

#: Every example that a claim needs, by a name of its own; the arguments left are those of a tolerance study.
PLAN: Mapping[str, Callable[..., Example]] = {
    "6.1": paper.chain_task_space,
    "6.2": paper.chain_eos,
    "5.3": paper.kinetic_energy,
    "5.3 without gravity": partial(paper.kinetic_energy, gravity=False),
    "5.3 other gradient": lambda **o: paper.kinetic_energy(gradient="configuration", **o).only("eos"),
    "5.1": paper.task_space,
    "5.2": paper.self_motion_tracking,
    "5.4": paper.obstacle,
    "4.3 one chart": partial(paper.equivalence, duration=2.0, threshold=0.5),
    "4.3": paper.equivalence,
    "2.2": paper.noncyclic,
}


def claims_table(claims: Iterable[Claim]) -> str:
    """Table in Markdown, in figures that come out the same on every machine."""
    rows = [f"| {c.section} | {c.statement} | {c.measured} | {'yes' if c.holds else '**no**'} |" for c in claims]
    lines = ["| section | claim | measured | holds |", "|---|---|---|---|", *rows, "", FOOTNOTE]
    return "\n".join(lines)


def study_table(claims: Mapping[float, Sequence[Claim]]) -> str:
    """Table in Markdown of what each claim measures at several tolerances."""
    head = ["section", "claim", *(f"rtol {rtol:g}" for rtol in claims)]
    rows = [
        [rows[0].section, rows[0].statement, *(f"{c.value:.3g}" if c.digits else f"{c.value:.0e}" for c in rows)]
        for rows in zip(*claims.values(), strict=True)
    ]
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])


def update_block(path: Path, name: str, text: str, heading: str) -> None:
    """Replace what stands between `<!-- name -->` and `<!-- /name -->` in a file, or append a section with it."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    old = path.read_text(encoding="utf-8") if path.exists() else ""
    if begin not in old:
        old += f"\n## {heading}\n\n{begin}\n{end}\n"
    head, _, rest = old.partition(begin)
    if end not in rest:
        raise OutputError(f"{path} has {begin} but no {end} after it")
    tail = rest.partition(end)[2]
    write_atomically(path, lambda file: file.write(f"{head}{begin}\n{text}\n{end}{tail}".encode()))
