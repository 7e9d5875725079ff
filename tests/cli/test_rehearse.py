"""`eos-pin rehearse`: the loop of a robot, in real time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from eos_pin.cli.main import main

# In real time.
pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.mark.parametrize("command", ["torque", "position"])
def test_rehearsal_reports_deadlines_and_keeps_a_log(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    files = ["--log", str(tmp_path / "log.csv"), "--json", str(tmp_path / "figures.json")]
    # Slow enough for a busy machine.
    assert main(["rehearse", "panda", "--command", command, "--control-rate", "50", "--duration", "0.5", *files]) == 0
    assert "deadlines missed" in capsys.readouterr().out
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["status"] == "finished"
    table = np.loadtxt(tmp_path / "log.csv", delimiter=",", skiprows=1)
    assert table.shape == (figures["samples"], 23)
    assert figures["latency_median"] < 0.02


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--control-rate", "0"], "the rate"),
        (["--command", "position", "--soft-start", "1"], "no torques"),
        (["--seed", "3"], "nothing is random"),
        (["--watchdog", "0"], "watchdog"),
    ],
)
def test_bad_options_of_a_rehearsal_are_refused(words: list[str], told: str, capsys: pytest.CaptureFixture) -> None:
    assert main(["rehearse", "panda", "--duration", "0.1", *words]) == 2
    assert told in capsys.readouterr().err


def test_interrupt_is_a_graceful_stop_with_a_report(tmp_path: Path) -> None:
    words = ["rehearse", "panda", "--control-rate", "50", "--duration", "60", "--log", str(tmp_path / "log.csv")]
    process = subprocess.Popen(
        [sys.executable, "-m", "eos_pin", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    while "Ctrl-C stops it" not in process.stderr.readline():
        assert process.poll() is None
    while not (tmp_path / "log.csv").is_file() or (tmp_path / "log.csv").read_text().count("\n") < 10:
        assert process.poll() is None
    os.kill(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "stopped: interrupted" in " ".join(out.split())
    table = np.loadtxt(tmp_path / "log.csv", delimiter=",", skiprows=1)
    # At rest at its end.
    assert np.abs(table[-1, 8:15]).max() < 5e-3
