"""Figures and pages that the build of the site makes, of the code and of the tables on its pages."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
#: Where the pages look for their figures.
FIGURES = HERE / "figures"


def page(name: str) -> str:
    """Text of a page."""
    return (HERE / f"{name}.md").read_text(encoding="utf-8")


def rows(text: str, start: str) -> list[list[str]]:
    """Cells of the first table of a page after some words, its heading first."""
    (table,) = re.findall(r"(?:^\|.*\n)+", text[text.index(start) :], re.MULTILINE)[:1]
    lines = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in table.splitlines()]
    return [lines[0], *lines[2:]]


def controllers(path: Path) -> None:
    """Task errors of laws relative to EOS, of the page's own table."""
    import numpy as np

    from eos_pin.plots.bench import ratios
    from eos_pin.plots.pages import save

    (_, *settings), *laws = rows(page("controllers"), "## Task error, relative to EOS")
    values = np.array([[float(re.sub(r"[^\d.]", "", cell)) for cell in law[1:]] for law in laws])
    best = np.array([["**" in cell for cell in law[1:]] for law in laws])
    save(ratios([law[0] for law in laws], settings, values, best), path)


def convergence(path: Path) -> None:
    """Costs of plans against the number of way points, of the page's own table."""
    (_, _, *counts), *paths = rows(page("planning"), "<!-- convergence -->")
    points = list(map(int, counts))
    _curves(
        path,
        {label: (points, list(map(float, off))) for label, _, *off in paths},
        xlabel="way points",
        ylabel="relative difference of the cost",
    )


def energy(path: Path) -> None:
    """Energy gained in random runs against the control period, of the page's own table."""
    columns, *periods = rows(page("impedance"), "<!-- energy -->")
    h = [float(period[0]) for period in periods]
    drawn = {"most of all runs": "most [J]"} | {
        name.removesuffix(" [J]"): name for name in columns if " than [J]" in name
    }
    _curves(
        path,
        {
            label: (h, [max(float(period[columns.index(name)]), 1e-4) for period in periods])
            for label, name in drawn.items()
        },
        xlabel="control period [ms]",
        ylabel="energy gained [J], at least 0.0001",
    )


def learning(path: Path) -> None:
    """Learning curve of the example in learning.md, with the return of an arm whose self-motion rests."""
    from eos_pin.plots.pages import save, style

    (code,) = re.findall(r"```python\n(.*?)```", page("learning"), re.DOTALL)
    made: dict[str, Any] = {}
    with redirect_stdout(StringIO()):
        exec(compile(code, "learning.md", "exec"), made)
    with style():
        figure, ax = _figure()
        rounds = range(1, 1 + len(made["curve"]))
        ax.plot(rounds, made["curve"], "o-", label="mean of the policies tried")
        ax.axhline(made["before"][0], color="0.6", linestyle="--", label="v held")
        ax.axhline(made["after"][0], color="#009E73", linestyle=":", label="learned, mean policy")
        ax.set(xlabel="round of the cross-entropy method, ten policies each", ylabel="return of an episode")
        ax.set_xticks(list(rounds))
        ax.legend()
        save(figure, path)


def chain(path: Path) -> None:
    """The second round of the paper's ten-joint chain under EOS control."""
    from eos_pin.paper.animation import write_gif
    from eos_pin.paper.examples import chain_eos

    example = chain_eos()
    result = example.experiments["eos"].run()
    write_gif(path, result, example.robot, trace=["tip"], start=result.period, end=2.0 * result.period)


def explorer(folder: Path) -> Path:
    """The explorer of the tutorial, one file."""
    import numpy as np

    from eos_pin import PoseTask, load_robot
    from eos_pin.viewer.explorer import write_explorer

    robot = load_robot("panda", chain_to="panda_hand_tcp")
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    return write_explorer(folder / "explore-panda.html", PoseTask(robot, "panda_hand_tcp"), q)


#: Figures by their file, and the page each is in.
MADE: dict[str, tuple[Callable[[Path], None], str]] = {
    "controllers.png": (controllers, "controllers"),
    "convergence.png": (convergence, "planning"),
    "impedance_energy.png": (energy, "impedance"),
    "learning.png": (learning, "learning"),
    "chain_eos.gif": (chain, "paper"),
}


def figures() -> None:
    """Draw the figures that are missing, or older than their page or the code."""
    code = max(path.stat().st_mtime for path in [Path(__file__), *(HERE.parent / "eos_pin").rglob("*.py")])
    FIGURES.mkdir(exist_ok=True)
    for name, (draw, of) in MADE.items():
        path = FIGURES / name
        if not path.exists() or path.stat().st_mtime < max(code, (HERE / f"{of}.md").stat().st_mtime):
            draw(path)


def _figure() -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure((5.0, 3.0), layout="constrained")
    return figure, figure.add_subplot()


def _curves(path: Path, curves: dict[str, tuple[list[Any], list[float]]], **names: str) -> None:
    """Draw curves on logarithmic axes."""
    from eos_pin.plots.pages import save, style

    with style():
        figure, ax = _figure()
        for label, (x, y) in curves.items():
            ax.loglog(x, y, "o-", label=label)
        ax.set(**names)
        ticks, _ = next(iter(curves.values()))
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.minorticks_off()
        ax.legend()
        save(figure, path)


if __name__ == "__main__":
    sys.exit(figures())
