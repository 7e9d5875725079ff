"""Numbers on the pages: what a benchmark wrote agrees with the words beside it, and constants are those of the code."""

from __future__ import annotations

import inspect
import re
import shlex
import statistics
import sys
from pathlib import Path

import numpy as np
import pytest
import tyro

from eos_pin.cli.arguments import STYLE, Registry
from eos_pin.cli.rehearse import RealTime
from eos_pin.control import _regularize, limited, tolerance
from eos_pin.control.hardware import log
from eos_pin.control.hardware.runner import Runner
from eos_pin.experiments.bench.laws import LAWS
from eos_pin.experiments.options import TaskOptions
from eos_pin.planning import self_motion_manifold
from eos_pin.planning.plans import Plan
from eos_pin.robot.model import Robot

ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT / "benchmarks"))

import solvable  # noqa: E402
import welds  # noqa: E402

METRICS = ("identity", "inertial")
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
MARK = re.compile(r"<!-- ([\w. ]+?) -->")


def place(page: str, name: str) -> str:
    """What a command wrote into a page."""
    return PAGES[page].partition(f"<!-- {name} -->")[2].partition("<!--")[0]


def rows(text: str) -> list[list[str]]:
    """Cells of the first table of a text, without its head."""
    (table, *_) = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    return [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in table.splitlines()[2:]]


def counts(text: str) -> tuple[int, ...]:
    """Whole numbers of a text, such as those of "9 of 10"."""
    return tuple(int(number.replace(",", "")) for number in re.findall(r"\d[\d,]*", text))


def sums(cells: list[str]) -> tuple[int, int]:
    """Sums of cells such as "9 of 10"."""
    good, all_ = zip(*(counts(cell) for cell in cells if cell != "-"), strict=True)
    return sum(good), sum(all_)


@pytest.mark.parametrize("page", [page for page, text in PAGES.items() if MARK.search(text)])
def test_figures_between_marks_have_the_command_that_writes_them(page: str) -> None:
    text = PAGES[page]
    commands = set(re.findall(r"\b((?:benchmarks|scripts)/\w+)\.py", text))
    sources = "".join(file.read_text() for name in commands for file in ROOT.glob(f"{name}*.py"))
    sources += (ROOT / "scripts" / "claim_tables.py").read_text() * ("scripts/reproduce" in commands)
    sources += (ROOT / "scripts" / "reproduce.py").read_text() * ("scripts/reproduce" in commands)
    for name in {name for name in MARK.findall(text) if name != "end"}:
        assert any(f"{quote}{word}{quote}" in sources for quote in "\"'" for word in (name, name.split()[-1])), name


def test_words_about_plans_agree_with_the_tables() -> None:
    loops = place("planning", "loops")
    assert counts(loops)[:3] == (*sums([row[2] for row in rows(loops)]), sum(float(r[4]) > 1 for r in rows(loops)))
    repeat = place("planning", "repeat")
    of, changing = counts(repeat)[1:3]
    methods = {row[0]: row for row in rows(repeat)}
    planned, held = (methods[name] for name in ("planned, continuous time", "planned, torques held for 1 ms"))
    assert counts(planned[1])[1] == of
    assert {counts(row[2])[1] for row in methods.values()} == {changing}
    refused = rows(repeat.partition("do not repeat:")[2])
    assert sum(row[4].startswith("refused") for row in refused) == of - counts(planned[1])[0]
    assert sum(row[4].startswith("held torques") for row in refused) == counts(planned[1])[0] - counts(held[1])[0]
    (jumps,) = counts(place("planning", "iklink").partition(" jumps")[0])
    assert jumps == 2
    assert "one jump cannot do" in place("planning", "evidence")
    for name in ("joining", "disturbed"):
        assert counts(place("planning", name))[0] == sum(int(row[2]) for row in rows(place("planning", name)))
    # The cost goes to its limit with the fourth power of the number of way points on two paths.
    slopes = [np.log(float(row[2]) / float(row[-1])) / np.log(8.0) for row in rows(place("planning", "convergence"))]
    assert len(slopes) == 4
    assert sum(3.8 < slope < 4.5 for slope in slopes) == 2


def test_words_about_laws_agree_with_the_table() -> None:
    text = PAGES["controllers"]
    head, *laws = re.findall(r"^\| law \|.*|^\| \S.*", text.partition("## Task error")[2].partition("![")[0], re.M)
    settings = [cell.strip() for cell in head.strip("|").split("|")][1:]
    table = {
        name: dict(zip(settings, cells, strict=True))
        for name, *cells in ([cell.strip() for cell in law.strip("|").split("|")] for law in laws)
    }
    said = re.search(
        r"^(\d+) laws on (.*): ([\d,]+) runs, (\d+) pairs .* in each of (\d+) settings", text, re.MULTILINE
    )
    assert said is not None
    number, of, pairs, among = (counts(said[i])[0] for i in (1, 3, 4, 5))
    assert (number, among) == (len(table), len(settings)) == (len(LAWS), 17)
    assert of == number * pairs * among

    def best(setting: str) -> set[str]:
        return {law for law, row in table.items() if "**" in row[setting]}

    short = text.partition("## In short")[2].partition("##")[0]
    for winner, where in re.findall(r"\* \*\*(.*?)\*\* is better than every other law with (.*)\.", short):
        named = [setting for setting in settings if setting in where]
        assert named
        assert all(best(setting) == {winner} for setting in named)
    where = text.partition("## Where EOS is not the best")[2].partition("##")[0]
    worse = re.findall(r"\* (.*): (.*?) has ([\d.]+) times its error \(EOS ([\d.]+) times", where)
    assert {setting for setting, *_ in worse} == {setting for setting in settings if "EOS" not in best(setting)}
    for setting, law, part, times in worse:
        assert law in best(setting)
        assert f"**{part}**" == table[law][setting]
        assert float(part) * float(times) == pytest.approx(1.0, abs=0.02)
    lost = {row[0]: counts(row[-1]) for row in rows(text.partition("## Other figures")[2])}
    (shares,) = re.findall(r"(\d+)% of the runs without damping are lost, (\d+)% with", text)
    for law, share in zip(("least torque", "least torque, damped"), shares, strict=True):
        assert round(100.0 * lost[law][0] / lost[law][1]) == int(share)


def test_words_about_metrics_agree_with_the_tables() -> None:
    motion, soft = rows(place("metric", "motion")), rows(place("metric", "impedance"))

    def columns(table: list[list[str]], i: int) -> tuple[np.ndarray, np.ndarray]:
        own, inertial = (np.array([float(row[i]) for row in table if row[2] == metric]) for metric in METRICS)
        return own, inertial

    def median(table: list[list[str]], i: int, *, inverse: bool = False) -> float:
        own, inertial = columns(table, i)
        return statistics.median(own / inertial if inverse else inertial / own)

    words = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", place("metric", "verdict"))]
    assert words[:3] == [len(motion) / 2, *(each.sum() for each in columns(motion, 3))]
    # Cells have two digits.
    found = [median(motion, 4), median(motion, 7, inverse=True), median(motion, 8, inverse=True)]
    assert [words[3], words[4], words[6]] == pytest.approx(found, rel=0.06)
    words = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", place("metric", "impedance verdict"))]
    finished = [sum(row[2] == metric and row[3] == "finished" for row in soft) for metric in METRICS]
    inertial, own = words[4:6]
    assert [len(soft) / 2, *finished, own, inertial] == [*words[1:4], *(each.sum() for each in columns(soft, 4))]
    assert [words[0], words[6]] == pytest.approx([median(soft, 7, inverse=True), median(soft, 5)], rel=0.06)


def test_words_about_other_runs_agree_with_the_tables() -> None:
    table = rows(PAGES["robots"])
    ran, tried = np.sum([sums([row[i] for row in table]) for i in (2, 3)], axis=0)
    # A file that cannot be read has no chains to try, and counts as one.
    tried += sum(row[1] == "0" for row in table)
    assert f"\n{ran} of {tried} ran, " in PAGES["robots"]
    runs, passed, *kinds = counts(place("limits", "lost"))
    assert runs >= 1000
    assert passed == sum(kinds)
    for row in rows(place("explore", "equilibria.py")):
        assert max(float(row[i].rstrip("%")) for i in (3, 5)) <= 1.0, row
        assert row[6] == "yes"
    for what, task, measured, aim, met in rows(PAGES["performance"].partition("## Ratios")[2]):
        assert (float(measured) <= float(aim.lstrip("≤ "))) == (met == "yes"), f"{what}, {task}"
    # Words of the paper's page that measure what its tables do.
    study = {row[1]: set(row[2:]) for row in rows(place("paper", "tolerances"))}
    assert study["beside it: with ∇T = ∂T/∂y the run ends early, at"] == {"10.3"}
    assert study["v is nearly constant: its range"] == {"0.125"}
    assert "runs away at 10.3 s" in PAGES["paper"]
    assert "(measured −0.125)" in PAGES["paper"]


def default(function: object, name: str) -> float:
    """Default of an argument."""
    value = inspect.signature(function).parameters[name].default  # type: ignore[arg-type]
    return float(value)


#: A page, words on it with a number, and what the code has.
CONSTANTS = (
    ("command_line", r"(\d+) laws", len(LAWS)),
    ("which", r"these and (\d+) more laws", len(LAWS) - 4),
    ("hardware", r"written for ([\d.]+) s", default(Runner, "watchdog")),
    ("hardware", r"written for ([\d.]+) s", RealTime.watchdog),
    ("hardware", r"loses ([\d.]+) s", log.FLUSH),
    ("limits", r"ρ = (\d+)/s", limited.RATE),
    ("limits", r"([\de-]+) rad off their ends", 1e-6 * limited.ROOM),
    ("limits", r"speeds ([\d.]+) % off", 1e-4 * limited.SPEED_ROOM),
    ("scope", r"positions ([\de-]+) rad off", 1e-6 * limited.ROOM),
    ("scope", r"speeds ([\d.]+) %", 1e-4 * limited.SPEED_ROOM),
    ("scope", r"faster than (\d+) rad/s", _regularize.OVERSPEED),
    ("planning", r"ρ = (\d+)/s", tolerance.RATE),
    ("planning", r"(\d+) rows a second", default(Plan.to_csv, "rate")),
    ("planning", r"until (\d+) random starts", default(self_motion_manifold, "seeds")),
    ("planning", r"graph of (\d+) random postures", solvable.POSTURES),
    ("planning", r"at each of (\d+) points", solvable.POINTS),
    ("planning", r"axis within (\d+)° of the normal", np.degrees(welds.CONE)),
)


def test_constants_on_pages_are_those_of_the_code() -> None:
    for page, words, value in CONSTANTS:
        found = re.findall(words, PAGES[page])
        assert found, (page, words)
        assert all(float(number) == pytest.approx(value) for number in found), (page, words, found)


def test_numbers_of_coordinates_are_those_of_the_tasks(panda: Robot) -> None:
    tried = 0
    for _, name, m, words in rows(PAGES["which"].partition("## Which task?")[2]):
        # Hands relative to each other are those of another robot.
        for option in [] if "--path" in words or "--seen-from" in words else re.findall(r"`(--.*?)`", words):
            given = option.replace("elbow", "panda_joint4").replace("wrist", "panda_joint6")
            given += " --task pose" * ("--tolerance" in option)
            with Registry():
                options = tyro.cli(TaskOptions, args=shlex.split(given), config=STYLE)
            least, *most = counts(m.replace("–", " ").replace("n", "7").replace("fewer", "5"))
            assert least <= options.make(panda, kept=True)[0].m <= (most or [least])[0], name
            tried += 1
    assert tried > 10
