"""What people see on a terminal: help, tables at common widths, short descriptions, and refusals before a run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import tyro

from eos_pin import Atlas, Chart, PointAxisTask, PositionTask, Robot, plan
from eos_pin.cli.info import command_words
from eos_pin.cli.main import main
from eos_pin.cli.main import run as cli_run
from eos_pin.cli.output import console, print_runs, task_words
from eos_pin.cli.tables import drift_of_cycles, run_table
from eos_pin.experiments.options import RobotOptions, TaskOptions
from eos_pin.simulation.result import Result

COMMANDS = (
    *("demo", "explore", "track", "plan", "compare", "sweep", "bench", "rehearse", "analyze", "info"),
    *("ik", "selfmotion", "replay", "robots"),
)
WIDTHS = (80, 100, 160)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_arguments_and_has_no_empty_default(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    said = capsys.readouterr().out
    words = " ".join(re.sub("[│╭╮╰╯─]", " ", said).split())
    assert not re.search(r"\bNone\b|\bunset\b|\bFalse\b", words)
    assert not re.search(r"\(default: *(''|\"\")?\)", words)
    # What a command has no use for is not offered.
    assert ("--seed " in words) == (command in {"track", "plan", "compare", "selfmotion", "rehearse"})
    if hasattr(tyro.conf, "PositionalMetavarFromFieldName"):
        # Words of meaning for all but plain numbers.
        assert not re.search(r"\bSTR\b|[\[{](FLOAT|INT|PATH)", words)


def test_help_of_any_command_has_words_for_values(capsys: pytest.CaptureFixture[str]) -> None:
    def measure(robot: str, what: Literal["a", "b"] = "a", *, rounds: int = 3, write: bool = False) -> int:
        """Measure.

        Args:
            robot: Name.
            what: Choice.
            rounds: Number.
            write: Whether.
        """
        assert (robot, what, rounds, write) == ("panda", "b", 4, True)
        return 0

    assert cli_run(measure, ["--robot", "panda", "--what", "b", "--rounds", "4", "--write"]) == 0
    with pytest.raises(SystemExit):
        cli_run(measure, ["--help"])
    said = capsys.readouterr().out
    assert all(word in said for word in ("--robot ROBOT", "{a,b}", "--rounds INT", "(default: 3)", "--write "))
    assert not re.search("False|--no-write", said)


@pytest.fixture(scope="module")
def run(panda: Robot) -> Result:
    rows, n = 41, panda.n
    t = np.linspace(0.0, 40.0, rows)
    q = np.zeros((rows, n))
    q[1:, 0] = 1e-3 * np.arange(1, rows) ** 2
    zeros = np.zeros((rows, n))
    point, empty = np.zeros((rows, 3)), np.zeros((rows, 0))
    return Result(
        *(t, q, zeros, zeros, zeros, point, point, point, point, empty, point, point, zeros[:, :4], zeros[:, :4]),
        *(zeros[:, :4], np.zeros(rows, dtype=int), np.zeros(rows), np.zeros(rows), np.zeros(0)),
        period=1.0,
        frame="panda_hand_tcp",
        labels=("x", "y", "z"),
        units=("m", "m", "m"),
    )


def test_drift_of_many_cycles_is_first_worst_and_last() -> None:
    assert drift_of_cycles([]) == "-"
    assert drift_of_cycles([0.5, 0.25]) == "0.5, 0.25"
    assert drift_of_cycles([0.5, 2.0, *[0.25] * 398]) == "first 0.5, worst 2, last 0.25, of 400"


@pytest.mark.parametrize("width", WIDTHS)
def test_tables_of_runs_fit_and_cut_no_word(
    width: int, run: Result, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "width", width)
    summary = run.summary()
    console.print(run_table(summary))
    print_runs("panda: pose", "controller", dict.fromkeys(("eos", "null-space-damping", "task-space-energy"), summary))
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= width
    assert "…" not in said
    assert {"damping", "first", "worst", "last", "margin"} <= set(re.findall(r"\w+", said))


def test_long_results_describe_themselves_in_a_line(panda: Robot, run: Result) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    z = task.value(q)
    found, path = Atlas(task).solve(q, z + 0.01), Atlas(task).follow(q, [z])
    made = plan(task, [z, z + 0.02], start=q, effort=1)
    for thing in (run, found, path, Chart.from_base(task, q), made):
        said = repr(thing)
        assert len(said) < 250, said
        assert said.startswith(f"{type(thing).__name__}(")
    assert "found=True" in repr(found)


def test_titles_are_words_and_no_representations(panda: Robot) -> None:
    for task, words in (
        (PositionTask(panda, "panda_hand_tcp", "xy"), "position of panda_hand_tcp, xy"),
        (PointAxisTask(panda, "panda_hand_tcp"), "point and axis of panda_hand_tcp"),
    ):
        assert task_words(task) == words


def test_advice_is_a_whole_command_that_a_shell_reads_back() -> None:
    robot = RobotOptions("my robots/arm one.urdf", lock=("elbow=0.2",), payload=1.5)
    task = TaskOptions("point-axis", q0=(0.1, -2.0), tool_axis="-x")
    words = shlex.split(command_words(robot, task))
    assert words[0] == "my robots/arm one.urdf"
    assert words[1:] == (
        ["--lock", "elbow=0.2", "--payload", "1.5", "--task", "point-axis", "--q0", "0.1", "-2.0", "--tool-axis", "-x"]
    )


#: Words of each command, and its option for a place to write to.
WRITERS = {
    **dict.fromkeys(("track", "compare", "plan", "sweep", "selfmotion", "info"), (["ppr"], "--out")),
    **dict.fromkeys(("explore", "demo", "ik"), (["ppr"], "--html")),
    "rehearse": (["ppr"], "--log"),
    "bench": (["ppr"], "--page"),
    "robots": ([], "--out"),
    "replay": (["run.npz"], "--out"),
    "analyze": (["log.csv", "--robot", "ppr"], "--out"),
}


def test_every_command_is_looked_at() -> None:
    assert set(WRITERS) == set(COMMANDS)


@pytest.mark.parametrize("command", WRITERS)
def test_output_that_cannot_be_written_is_refused_before_the_run(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words, option = WRITERS[command]

    def load(*options: object, **more: object) -> None:
        raise AssertionError("the robot was loaded before the folder was looked at")

    monkeypatch.setattr("eos_pin.robot.loading.load_robot", load)
    (tmp_path / "file").write_text("")
    assert main([command, *words, option, str(tmp_path / "file" / "place")]) == 2
    assert "is a file, not a folder" in capsys.readouterr().err
