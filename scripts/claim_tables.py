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
from eos_pin.simulation.result import Result

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


def beside_table(runs: Mapping[str, Mapping[str, Result]]) -> str:
    """Table in Markdown of drift and kinetic energy under the paper's control and under what people use beside it."""
    laws = {
        "traditional (paper)": "task-space",
        "with posture control": "null-space-posture",
        "with damping": "null-space-damping",
        "with the gradient": "task-space-energy",
    }
    lines = ["| | drift, planar robot | kinetic energy | drift, chain | kinetic energy |", "|---|---|---|---|---|"]
    for title, law in laws.items():
        planar = runs["5.1" if law in runs["5.1"] else "5.3"][law]
        # The chain is chaotic under traditional control, so its figures differ from machine to machine.
        chain = ["chaotic", "> 100"] if law == "task-space" else _beside(runs["6.1"].get(law))
        lines.append(_row(title, *_beside(planar), *chain))
    lines.append(_row("EOS, v_d = 0", *_beside(runs["5.2"]["eos"]), *_beside(runs["6.2"]["eos"])))
    lines.append(_row("EOS, with the gradient", *_beside(runs["5.3"]["eos"]), *_beside(None)))
    assert runs["6.1"]["task-space"].summary()["kinetic_energy_mean"] > 100.0
    return "\n".join(lines)


def _beside(result: Result | None) -> list[str]:
    """Drift and kinetic energy, in figures that come out the same on every machine."""
    if result is None:
        return ["", ""]
    summary = result.summary()
    # Below this lies the error of integration.
    drift = (f"{value:.2g}" if value > 1e-6 else "≤ 1e-6" for value in summary["joint_drift_per_cycle"])
    return [", ".join(drift), f"{summary['kinetic_energy_mean']:.3g}"]


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


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
