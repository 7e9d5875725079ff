"""Reproduce the paper: run every example, check every claim, write every figure, replay and animation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from claim_tables import PLAN, beside_table, claims_table, study_table, update_block

from eos_pin._files import write_atomically
from eos_pin.cli.main import run
from eos_pin.cli.output import console, stderr, write_json
from eos_pin.paper.claims import APPLICATIONS, measure, obstacles_cleared
from eos_pin.paper.run_example import claim_rows, figures
from eos_pin.simulation.result import Result

ROOT = Path(__file__).parent.parent
#: Tolerances at which every claim is measured, to tell physics from errors of integration.
TOLERANCES = (1e-6, 1e-9, 1e-12)
#: The animations of the paper's supplement: section and run of each.
ANIMATIONS = {
    "s1_task_space": ("5.1", "task-space"),
    "s2_eos": ("5.2", "eos"),
    "s3_energy_eos": ("5.3", "eos"),
    "s3_energy_task_space": ("5.3", "task-space-energy"),
    "s4_obstacle": ("5.4", "eos"),
    "s5_chain_task_space": ("6.1", "task-space"),
    "s6_chain_eos": ("6.2", "eos"),
}

#: Runs by section and controller.
Results = dict[str, dict[str, Result]]


def main(
    out: Path = Path("runs/paper"),
    json: Path | None = None,
    table: Path | None = None,
    jobs: int = 2,
    study: bool = True,
    pictures: bool = True,
    update_docs: bool = False,
) -> int:
    """Reproduce the paper: run every example, check every claim, write every figure, replay and animation.

    The exit code is 1 if a claim fails.

    For example:

      python scripts/reproduce.py
      python scripts/reproduce.py --no-study --no-pictures --table claims.md
      python scripts/reproduce.py --update-docs

    Args:
        out: Folder for everything.
        json: File for all figures, machine-readable; by default claims.json in the folder.
        table: File for the table of claims, in Markdown; by default claims.md in the folder.
        jobs: Processes to use.
        study: Measure every claim at rtol 1e-6, 1e-9 and 1e-12 as well.
        pictures: Write figures (PNG and PDF), replays (HTML) and animations (GIF).
        update_docs: Write the tables of claims and of other laws into docs/paper.md, with a study that of tolerances.
    """
    tolerances = (None, *TOLERANCES) if study else (None,)
    work = [(label, name, rtol) for label in PLAN for name in PLAN[label]().experiments for rtol in tolerances]
    results: dict[float | None, Results] = {rtol: {label: {} for label in PLAN} for rtol in tolerances}
    for (label, name, rtol), result in zip(work, _shared_out("running", simulate, work, jobs), strict=True):
        results[rtol][label][name] = result
    runs = results[None]
    cited = _shared_out("avoiding", avoid, [(name, out if pictures else None) for name in APPLICATIONS], jobs)
    claims = measure(runs)
    for name, found in zip(APPLICATIONS, cited, strict=True):
        claims += obstacles_cleared(name, found)
    if pictures:
        _shared_out("drawing", draw, list(_pictures(runs, out)), jobs)
    console.print(claim_rows(claims))
    named = {f"{label}, {name}": result for label, example in runs.items() for name, result in example.items()}
    write_json(json or out / "claims.json", figures(named, claims))
    _write(table or out / "claims.md", claims_table(claims))
    if update_docs:
        update_block(ROOT / "docs" / "paper.md", "claims", claims_table(claims), "The claims")
        update_block(ROOT / "docs" / "paper.md", "beside", beside_table(runs), "What people use beside it")
    if study:
        tolerance_table = study_table({rtol: measure(results[rtol]) for rtol in TOLERANCES})
        _write(out / "tolerances.md", tolerance_table)
        if update_docs:
            update_block(ROOT / "docs" / "paper.md", "tolerances", tolerance_table, "Physics or integration error")
    holding = sum(claim.holds for claim in claims)
    console.print(f"{holding} of {len(claims)} claims hold. Everything is in {out}.")
    return 0 if holding == len(claims) else 1


def simulate(label: str, name: str, rtol: float | None) -> Result:
    """Run one experiment of the plan."""
    example = PLAN[label](**({} if rtol is None else {"rtol": rtol}))
    return example.experiments[name].run()


def avoid(name: str, out: Path | None) -> dict[str, Any]:
    """Run a cited application with and without making way, and draw it into a folder; its figures."""
    from eos_pin.paper.run_obstacle_example import draw
    from eos_pin.plots import pages as plots
    from eos_pin.viewer.replay import write_replay

    application = APPLICATIONS[name]()
    result = application.run()
    if out is not None:
        file = out / "cited" / application.task.robot.name
        page = draw(application, {"v constant": application.run(avoiding=False), "v makes way": result})
        for suffix in (".png", ".pdf"):
            plots.save(page, file.with_name(file.name + suffix))
        solids = application.clearance.obstacles
        write_replay(file.with_name(file.name + ".html"), result, application.task.robot, obstacles=solids, title=name)
    return application.figures(result)


def draw(kind: str, path: Path, label: str, data: Any) -> None:
    """Write one replay or animation of the run `data`, or all figures of the runs `data`."""
    from eos_pin.paper import examples as paper
    from eos_pin.paper.animation import write_gif
    from eos_pin.paper.figures import paper_figures
    from eos_pin.plots import pages as plots
    from eos_pin.viewer.replay import write_replay

    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "figures":
        planar, chain = (setting.task.robot for setting in (paper.planar_robot(), paper.planar_chain()))
        for name, figure in paper_figures(data, planar, chain).items():
            for suffix in (".png", ".pdf"):
                plots.save(figure, path.with_name(name + suffix))
        return
    robot = PLAN[label]().robot
    if kind == "html":
        write_replay(path, data, robot, title=f"Sec. {label}")
    else:
        write_gif(path, data, robot, trace=["tip", "rail_tip"] if label == "5.4" else ["tip"], end=2.0 * data.period)


def _pictures(runs: Results, out: Path) -> Iterator[tuple[str, Path, str, Any]]:
    for name, (label, run_name) in ANIMATIONS.items():
        yield "gif", out / f"{name}.gif", label, runs[label][run_name]
        yield "html", out / f"{name}.html", label, runs[label][run_name]
    yield "figures", out / "figures", "", runs


def _shared_out(what: str, function: Callable[..., Any], work: Sequence[tuple[Any, ...]], jobs: int) -> list[Any]:
    """Results of a function for each tuple of arguments, in order, over processes and under a progress bar."""
    from joblib import Parallel, delayed
    from rich.progress import track

    parallel = Parallel(n_jobs=jobs, return_as="generator")
    found = parallel(delayed(function)(*arguments) for arguments in work)
    return list(track(found, description=what, total=len(work), console=stderr, transient=True))


def _write(path: Path, text: str) -> None:
    write_atomically(path, lambda file: file.write(f"{text}\n".encode()))


if __name__ == "__main__":
    sys.exit(run(main))
