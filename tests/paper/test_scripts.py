"""The scripts: what they print, write and return."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from eos_pin import Result
from eos_pin.cli.main import run

SCRIPTS = Path(__file__).parents[2] / "scripts"
# A script finds its neighbours, as it does when it is run.
sys.path.append(str(SCRIPTS))

#: A quick way to run each script, and its first run.
QUICK = {
    "example_2_2_noncyclic": (["--cycles", "2"], "velocity control"),
    "example_4_3_equivalence": (["--duration", "1"], "joints"),
    "example_5_1_task_space": (["--cycles", "1"], "task-space"),
    "example_5_2_self_motion_tracking": (["--cycles", "1", "--no-gravity"], "eos"),
    "example_5_3_kinetic_energy": (["--cycles", "1"], "eos"),
    "example_5_4_obstacle": (["--cycles", "1", "--l", "-5", "--damping", "2"], "eos"),
    "example_6_1_chain_task_space": (["--cycles", "1", "--rtol", "1e-6"], "task-space"),
    "example_6_2_chain_eos": (["--cycles", "1"], "eos"),
}


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch, unchecked):
    monkeypatch.chdir(tmp_path)


def load(name):
    """The script as a module."""
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", QUICK)
def test_script_runs_and_writes_the_files_it_names(name, capsys):
    words, first = QUICK[name]
    assert run(load(name).main, [*words, "--json", "figures.json"]) == 0
    printed = capsys.readouterr().out
    assert f"Sec. {name[8:11].replace('_', '.')}" in printed
    figures = json.loads(Path("figures.json").read_text())
    assert next(iter(figures["runs"])) == first
    assert all(run["status"] == "finished" for run in figures["runs"].values())
    assert all(claim["holds"] for claim in figures["claims"])


def test_out_collects_run_replay_figure_and_numbers(capsys):
    words = ["--cycles", "1", "--out", "files", "--csv", "samples.csv"]
    assert run(load("example_5_2_self_motion_tracking").main, words) == 0
    names = {"run.npz", "summary.json", "replay.html", "figure.png"}
    assert {path.name for path in Path("files").iterdir()} == names
    assert all(f"files/{name}" in capsys.readouterr().out.replace("\n", "") for name in ["run.npz"])
    assert Result.load("files/run.npz").ok
    assert Path("samples.csv").read_text().startswith("t,q_")
    assert Path("files/figure.png").read_bytes()[:4] == b"\x89PNG"


def test_run_that_ends_early_reports_it_and_returns_1(capsys):
    words = ["--cycles", "2", "--l", "2", "--plot", "figure.pdf"]
    assert run(load("example_5_4_obstacle").main, words) == 1
    assert "ran away" in capsys.readouterr().out
    assert Path("figure.pdf").exists()


@pytest.mark.parametrize(
    ("name", "words", "reason"),
    [
        ("example_5_4_obstacle", ["--l", "0"], "l must not be 0"),
        ("example_5_1_task_space", ["--cycles", "0"], "at least one cycle"),
        ("example_5_2_self_motion_tracking", ["--rtol", "-1"], "rtol"),
        ("example_2_2_noncyclic", ["--robot", "nope"], "nope"),
        ("example_2_2_noncyclic", ["--cycles", "0"], "at least one cycle"),
        ("example_4_3_equivalence", ["--threshold", "1.5"], "threshold"),
    ],
)
def test_bad_input_is_one_paragraph_and_2(name, words, reason, capsys):
    assert run(load(name).main, words) == 2
    found = capsys.readouterr()
    assert reason in " ".join(found.err.split())
    assert "Traceback" not in found.err
    assert "\n\n" not in found.err.strip()


@pytest.mark.parametrize("name", [*QUICK, "reproduce"])
def test_help_gives_an_example(name, capsys):
    with pytest.raises(SystemExit) as ending:
        run(load(name).main, ["--help"])
    assert ending.value.code == 0
    text = capsys.readouterr().out
    assert "For example" in text
    assert f"python scripts/{name}.py" in text


def test_examples_are_commands():
    words = [sys.executable, str(SCRIPTS / "example_5_2_self_motion_tracking.py"), "--cycles", "1"]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert "y2 = y3 throughout" in found.stdout
