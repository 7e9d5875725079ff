"""Common part of the scripts of the paper's examples: run it, print it, check the claims, write the files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eos_pin.cli.output import (
    Output,
    console,
    format_number,
    grid,
    progress,
    write_outputs,
)
from eos_pin.paper.claims import FOOTNOTE, Claim, Runs
from eos_pin.paper.examples import Example
from eos_pin.simulation.result import Result

if TYPE_CHECKING:
    from eos_pin.paper.figures import Row


def run_example(
    example: Example,
    output: Output,
    *,
    claims: Callable[[Runs], list[Claim]] = lambda runs: [],
    rows: Callable[[Runs], Sequence[Row]],
) -> int:
    """Run an example, print a table of its runs and one of its claims, and write the files that are asked for.

    Args:
        example: The example; its first run is the one that replay, samples and live view show.
        output: Results to keep.
        claims: Claims of the paper about these runs; one that they do not decide is left out.
        rows: Quantities of the runs that the figure shows.

    Returns:
        0; 1 if the first run ended early or a claim fails.
    """
    results: dict[str, Result] = {}
    for k, (name, experiment) in enumerate(example.experiments.items()):
        # Only the first run is watched live, the others are computed as fast as can be.
        seen = output if k == 0 else replace(output, view=False)
        with progress(
            seen, experiment.robot, experiment.q, experiment.duration, f"{example.section} {name}"
        ) as observer:
            results[name] = experiment.run(observer)
    console.print(run_rows(f"Sec. {example.section}: {example.title}", results))
    for name, result in results.items():
        if result.message:
            console.print(f"{name}: {result.message}", markup=False)
        if len(result.switches):
            times = ", ".join(format_number(t) for t in result.switches[:9])
            console.print(f"{name}: charts left at {times}{' ...' if len(result.switches) > 9 else ''} s")
    first = next(iter(results.values()))
    found = [claim for claim in claims(results) if np.isfinite(claim.value)]
    if found:
        console.print(claim_rows(found))
    files = output.within(None, names={"json": "summary.json", "html": "replay.html", "plot": "figure.png"})
    drawn = None
    if files.plot:
        from eos_pin.paper.figures import page

        drawn = page(rows(results), example.robot)
    written = write_outputs(files, first, example.robot, figures=figures(results, found), plot=drawn)
    if written:
        console.print("Wrote " + ", ".join(str(path) for path in written), soft_wrap=True)
    return 0 if first.ok and all(claim.holds for claim in found) else 1


def figures(results: Runs, claims: Sequence[Claim]) -> dict[str, Any]:
    """The runs and claims as plain values, for JSON."""
    return {
        "runs": {name: result.summary() for name, result in results.items()},
        "claims": [{**vars(claim), "holds": claim.holds} for claim in claims],
    }


def run_rows(title: str, results: Mapping[str, Result]) -> Any:
    """Table with a row for each run."""
    columns = ("run", "status", "task\nerror", "first\ndrift", "last\ndrift", "mean\nT [J]", "peak\nT [J]", "charts")
    rows = []
    for name, result in results.items():
        summary = result.summary()
        drift = summary["joint_drift_per_cycle"] or [np.nan]
        peak = float(result.kinetic_energy.max(initial=0.0))
        energies = (summary["kinetic_energy_mean"], peak) if peak else (np.nan, np.nan)
        charts = 1 + summary["chart_switches"]
        rows.append((name, summary["status"], summary["task_error_max"], drift[0], drift[-1], *energies, charts))
    # A column that says nothing of any run is left out, to fit a narrow terminal.
    shown = [k for k in range(len(columns)) if any(row[k] == row[k] and row[k] != "finished" for row in rows)]
    return grid(title, [columns[k] for k in shown], [[row[k] for k in shown] for row in rows])


def claim_rows(claims: Sequence[Claim]) -> Any:
    """Table of claims with their measurements, in full."""
    from rich import box
    from rich.table import Table

    table = Table("section", "claim", "measured", "bound", "holds", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.caption = FOOTNOTE if any("¹" in claim.statement for claim in claims) else None
    for claim in claims:
        bound = f"{'≥' if claim.at_least else '≤'} {claim.bound:g} {claim.unit}"
        holds = "yes" if claim.holds else "[bold red]no[/]"
        table.add_row(claim.section, claim.statement, format_number(claim.value), bound, holds)
    return table
