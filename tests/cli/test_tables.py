"""Tables on narrow terminals: nothing is cut, whatever the names and the numbers of columns."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from eos_pin.cli import output as report
from eos_pin.cli.main import main
from eos_pin.cli.tables import fitted, folded, speed_at_ends

URDF = Path(__file__).parents[2] / "robots" / "planar_chain_10.urdf"


def printed(table, width=80):
    file = io.StringIO()
    Console(file=file, width=width, highlight=False).print(table)
    return file.getvalue()


LONG = "left_arm_shoulder_flexion_extension_joint_of_the_second_robot"
CASES = {
    "narrow": (["joint", "value"], [["elbow", 0.5], ["wrist", -1.25]]),
    "long names": (
        ["joint", "kind", "lower", "upper"],
        [[LONG, "revolute", -3.14, 3.14], ["b", "prismatic", 0.0, 1.0]],
    ),
    "a name without joints": (["joint", "value"], [["x" * 130, 0.5]]),
    "two columns of long names": (["a", "b", "value"], [[LONG, LONG, 0.5]]),
    "long headings": (
        [f"largest self-motion error of robot {i}" for i in range(7)],
        [[float(i)] * 7 for i in range(3)],
    ),
    "many columns": ([f"quantity {i}" for i in range(30)], [[0.123 * i for i in range(30)], [1e-7] * 30]),
    "brackets": (["joint"], [["[bold]arm[/bold]_" * 8]]),
    "no rows": (["joint", "value"], []),
}


@pytest.mark.parametrize("width", [40, 80, 200])
@pytest.mark.parametrize("case", CASES)
def test_table_fits_without_cut_words(case, width):
    columns, rows = CASES[case]
    said = printed(fitted("title", columns, rows, width), width)
    assert max(map(cell_len, said.splitlines())) <= width
    assert "…" not in said
    cells = [c if isinstance(c, str) else f"{c:.3g}" for row in rows for c in row]
    for number in (c for row in rows for c in row if isinstance(c, float)):
        assert re.search(rf"(?<![\d.]){re.escape(f'{number:.3g}')}(?![\d.])", said)
    # Letters of one cell may stand in several lines, with those of others between.
    for letter in set("".join([*columns, *cells])) - {" "}:
        assert said.count(letter) >= "".join(cells).count(letter)


def test_table_breaks_names_at_their_joints():
    assert folded(LONG, 20).split("\n") == ["left_arm_shoulder_", "flexion_extension_", "joint_of_the_second_", "robot"]
    assert folded("two words", 5) == "two\nwords"
    assert folded("abcdefgh", 3) == "abc\ndef\ngh"
    assert folded("", 3) == ""
    assert folded("short", 10) == "short"


@pytest.fixture
def long_named(tmp_path, monkeypatch):
    """A robot whose joints and file have long names."""
    monkeypatch.chdir(tmp_path)
    text = re.sub(r'(joint name="|joint joint=")', rf"\g<1>{LONG}_", URDF.read_text())
    path = tmp_path / f"{LONG}.urdf"
    path.write_text(text)


QUICK = ["--duration", "0.1", "--period", "4", "--size", "0.3"]
POSTURE = ["--q0", *["0.2"] * 10]
COMMANDS = {
    "info": ["info", f"{LONG}.urdf", *POSTURE],
    "ik": ["ik", f"{LONG}.urdf", *POSTURE, "--v", *["0.1"] * 8],
    "robots": ["robots"],
    "track": ["track", f"{LONG}.urdf", *POSTURE, *QUICK, "--plane", "xy", "--out", "run"],
    "compare": ["compare", f"{LONG}.urdf", *POSTURE, *QUICK, "--plane", "xy", "--controllers", "eos", "--out", "both"],
    "sweep": ["sweep", f"{LONG}.urdf", *QUICK, "--kp", "50,100", "--jobs", "1"],
}


@pytest.mark.usefixtures("unchecked", "long_named", "quick_pictures")
@pytest.mark.parametrize(
    "command", [name if name != "sweep" else pytest.param(name, marks=pytest.mark.slow) for name in COMMANDS]
)
def test_commands_fit_80_columns(command, monkeypatch, capsys):
    monkeypatch.setattr(report.console, "_width", 80)
    assert main(COMMANDS[command]) in (0, 1)
    said = capsys.readouterr().out
    # The list of files is one line, to be copied.
    lines = [line for line in said.splitlines() if not line.startswith("Wrote")]
    assert max(map(cell_len, lines)) <= 80
    assert "…" not in said


def test_command_fits_80_columns_in_a_pipe():
    environment = {**os.environ, "COLUMNS": "80"}
    words = [sys.executable, "-m", "eos_pin", "robots"]
    said = subprocess.run(words, capture_output=True, encoding="utf-8", env=environment, check=True).stdout
    assert max(map(cell_len, said.splitlines())) <= 80
    assert "…" not in said


def test_speed_at_ends_comes_with_advice_unless_the_plan_rests():
    rest, fast = np.zeros(2), np.array([0.1, -0.25])
    assert speed_at_ends(rest, 1e-9 * fast) == "at rest"
    assert speed_at_ends(fast, rest) == "0.25 and 0 rad/s or m/s; --timing fastest begins and ends at rest"
