"""`eos-pin selfmotion` and `explore`: what they print, write and refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from eos_pin import PoseTask, load_robot
from eos_pin.cli.main import main

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", lambda url: False)


def test_selfmotion_lists_equilibria_at_a_task_point(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["selfmotion", "panda", "--task", "pose", "--at", "0.4", "0.1", "0.4", "3.14", "0", "0"]
    assert main([*words, "--json", "found.json", "--plot", "potential.png"]) == 0
    found = json.loads(Path("found.json").read_text())
    robot = load_robot("panda", chain_to="auto")
    task = PoseTask(robot, robot.options["chain_to"])
    assert len(found["equilibria"]) >= 2
    for each in found["equilibria"]:
        assert np.allclose(task.value(np.array(each["q"]))[:3], [0.4, 0.1, 0.4], atol=1e-9)
        assert each["stable"] == (each["eigenvalues"][0] > 0.0)
        assert len(each["frequencies"]) + len(each["growth"]) == 1
    for way in found["crossings"]:
        assert way["energy"] > 0.0
    said = capsys.readouterr().out
    assert "equilibria of the self-motion under gravity" in " ".join(said.split())
    assert Path("potential.png").stat().st_size > 10_000


def test_explore_writes_a_page_and_prints_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", "ppr"]) == 0
    said = capsys.readouterr()
    page = Path("runs/explore-ppr-position.html")
    assert str(page) in said.out
    assert "open" in said.err
    assert "class Posture" in page.read_text()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("selfmotion ppr", "gravity does no work on the self-motion"),
        ("selfmotion ur5 --task pose", "it has no self-motion"),
        ("selfmotion panda --at 1 2", "the task point must be 3 numbers"),
        ("explore panda --task distance --point 0.5 0 0.3", "the explorer has formulas for the tasks position"),
        ("explore ur5 --task pose", "it has no self-motion to explore"),
        ("demo ur5", "the lesson is for a robot with one joint more"),
    ],
)
def test_commands_of_the_self_motion_refuse_tasks_without_any(
    words: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not list(Path().iterdir())
