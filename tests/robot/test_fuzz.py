"""Damaged URDFs: a few of the ten thousand of benchmarks/fuzz_urdf.py, in processes with limited memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.append(str(BENCHMARKS))

import fuzz_urdf  # noqa: E402
from confined import captured, time_limit  # noqa: E402


def test_damaged_files_are_refused_quickly_and_in_silence(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    command = [sys.executable, str(BENCHMARKS / "fuzz_urdf.py"), "--count", "60", "--json", str(report)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    figures = json.loads(report.read_text())
    assert figures["count"] == 60
    assert figures["wrong"] == []
    assert set(figures["outcomes"]) <= {"loaded", "RobotError", "InputError", "UnknownNameError"}
    # Neither all refused at the door, nor all harmless.
    assert 6 < figures["outcomes"]["loaded"] < 40
    assert figures["slowest_seconds"] < fuzz_urdf.TIME_LIMIT
    assert figures["memory_bytes"] < fuzz_urdf.MEMORY_LIMIT


def test_seed_always_makes_the_same_file() -> None:
    files = [fuzz_urdf.mutated(seed) for seed in range(40)]
    assert files == [fuzz_urdf.mutated(seed) for seed in range(40)]
    assert len(set(files)) == 40


@pytest.mark.parametrize(
    ("misbehave", "kind"),
    [
        (lambda path, seed: 1 / 0, "ZeroDivisionError"),
        (lambda path, seed: os.write(2, b"terminate called"), "said something on the terminal"),
        (lambda path, seed: np.float64(1e308) * 10.0, "RuntimeWarning"),
        (lambda path, seed: time.sleep(9.0), "TimeoutError"),
        (lambda path, seed: [None for _ in range(10_000_000)], "too slow"),
    ],
)
def test_misbehaviour_is_noticed(misbehave, kind, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(fuzz_urdf, "use", misbehave)
    monkeypatch.setattr(fuzz_urdf, "TIME_LIMIT", 0.02)
    outcome = fuzz_urdf.attempt(0, tmp_path)
    assert (outcome.kind, outcome.good) == (kind, False)


def test_captured_output_does_not_reach_terminal(capfd) -> None:
    with captured() as said:
        os.write(1, b"out")
        os.write(2, b"err")
    assert said == ["outerr"]
    assert capfd.readouterr() == ("", "")


def test_time_limit_ends_with_its_block() -> None:
    with pytest.raises(TimeoutError, match=r"after 0\.01 s"), time_limit(0.01):
        time.sleep(5.0)
    with time_limit(0.05):
        pass
    time.sleep(0.1)
