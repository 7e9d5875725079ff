"""The command `eos-pin bench`: laws beside each other, with disturbances; a table, a figure, a page, and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import tyro
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from eos_pin._files import check_writable
from eos_pin.cli.many.sweep import commas
from eos_pin.cli.output import console, grid, print_files, stderr, write_json
from eos_pin.errors import InputError

if TYPE_CHECKING:
    from eos_pin.experiments.bench.verdict import Verdict
    from eos_pin.experiments.trial import Row

Names: TypeAlias = Annotated[tuple[str, ...], commas(str, "NAME", none="all")]


@dataclass(frozen=True)
class BenchOutput:
    """Files to keep.

    Attributes:
        out: Folder of all files. Finished runs are in its folder `finished`, and are not computed again.
        page: File for the page in Markdown; its figure is written into the folder `figures` beside it.
        json: File for the verdicts as JSON.
    """

    out: Path = Path("runs/bench")
    page: Path | None = None
    json: Path | None = None


def bench(
    robot: tyro.conf.Positional[tuple[str, ...]] = (),
    laws: Names = (),
    settings: Names = (),
    kept: BenchOutput = BenchOutput(),
    results: Path | None = None,
    seeds: int = 20,
    tuning_seeds: int = 1,
    jobs: int = 1,
) -> int:
    """Run laws of this package and of others on robots under disturbances, with a verdict for each setting.

    Each law gets its gains by the same small search. What is finished is kept: the same command after an interrupt goes
    on where it was. The table of results is whole after each seed.

    Args:
        robot: Names or paths of URDF files; by default three arms.
        laws: Names of laws, with commas between; a wrong one lists all.
        settings: Names of settings, likewise.
        kept: Files to keep.
        results: Table of an earlier bench, to write figure and page of without any run.
        seeds: Runs of each combination.
        tuning_seeds: Runs for each pair of gains in the search.
        jobs: Runs at the same time; -1 for one on each core.

    For example:

      eos-pin bench panda --laws eos,acceleration,sliding-mode --settings exact,model-20 --seeds 6
      eos-pin bench --jobs 2 --page docs/controllers.md
      eos-pin bench --results runs/bench/results.csv --page docs/controllers.md
    """
    from eos_pin.experiments.bench.harness import read_results

    check_writable(*filter(None, (kept.out, kept.page, kept.json)))
    if results is not None:
        if robot or laws or settings:
            raise InputError("robots, laws and settings are those of the table of --results; leave them out")
        rows = read_results(results)
        written: list[Path] = []
    else:
        rows = _watched(robot, laws, settings, kept.out, seeds, tuning_seeds, jobs)
        written = [kept.out / "results.csv"]
    return _report(rows, kept, written)


def _watched(
    robots: Sequence[str],
    laws: Sequence[str],
    settings: Sequence[str],
    out: Path,
    seeds: int,
    tuning_seeds: int,
    jobs: int,
) -> list[Row]:
    """Rows of all runs, with a progress bar meanwhile.

    Raises:
        KeyboardInterrupt: The bench was interrupted; its message has the runs that are done.
    """
    from eos_pin.experiments.bench import harness

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    now = ("gains", 0, 0)
    with Progress(*columns, console=stderr, transient=True) as progress:
        bar = progress.add_task("gains", total=None)

        def tell(what: str, done: int, of: int) -> None:
            nonlocal now
            now = what, done, of
            progress.update(bar, description=what, completed=done, total=of)

        try:
            return harness.bench(
                robots,
                laws=laws,
                settings=settings,
                seeds=seeds,
                tuning_seeds=tuning_seeds,
                folder=out,
                jobs=jobs,
                observer=tell,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"{now[1]} of {now[2]} runs of {now[0]} done; run the same command again to go on"
            ) from None


def _report(rows: Sequence[Row], kept: BenchOutput, written: list[Path]) -> int:
    """Print the verdicts, and write figure, page and JSON."""
    import numpy as np

    from eos_pin._files import write_atomically
    from eos_pin.experiments.bench.laws import LAWS
    from eos_pin.experiments.bench.page import page
    from eos_pin.experiments.bench.settings import SETTINGS
    from eos_pin.experiments.bench.verdict import verdict
    from eos_pin.plots.bench import ratios
    from eos_pin.plots.pages import save

    laws, settings = (list(dict.fromkeys(row[name] for row in rows)) for name in ("law", "setting"))
    verdicts = [verdict(rows, setting) for setting in settings]
    lines = [_line(each, SETTINGS[each.setting].title) for each in verdicts]
    columns = ("setting", "pairs", "winner", "best, or not shown to be worse", "EOS")
    console.print(grid(f"{len(rows)} runs of {len(laws)} laws", columns, lines))
    by_law = [{s.law: s for s in each.standings} for each in verdicts]
    places = [[found[law] for found in by_law] for law in laws]
    values, best = (np.array([[getattr(s, name) for s in row] for row in places]) for name in ("to_eos", "best"))
    # With too few pairs nothing is marked.
    best &= np.array([each.decided for each in verdicts])
    place = kept.page or kept.out / "controllers.md"
    if np.isfinite(values).all():
        titles = [LAWS[law].title for law in laws]
        figure = ratios(titles, [SETTINGS[setting].title for setting in settings], values, best)
        drawn = Path("figures") / f"{place.stem}.png"
        written.append(save(figure, place.parent / drawn))
        text = page(rows, "eos-pin bench --page docs/controllers.md", drawn.as_posix())
        write_atomically(place, lambda file: file.write(text.encode()))
        written.append(place)
    else:
        console.print("Neither figure nor page: they compare with the law eos, which is not among these.")
    if kept.json is not None:
        plain = [{"setting": v.setting, "pairs": v.pairs, "winner": v.winner, "laws": [vars(s) for s in v.standings]}
                 for v in verdicts]  # fmt: skip
        written.append(write_json(kept.json, {"verdicts": plain}))
    print_files(written)
    return 0


def _line(found: Verdict, title: str) -> tuple[object, ...]:
    """A setting's row of the table on the terminal."""
    own = next((f"{s.ratio:.2f} × the best" for s in found.standings if s.law == "eos"), "")
    return title, found.pairs, found.winner or "none", ", ".join(found.best), own
