"""That benchmarks/run.py works without any peer, reports what is missing, and notices wrong answers."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from checks import compiled_only

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))

import bands
import compiled
import peers
import run
from crew import Crew, Worker, WorkerError, crew
from performance_page import page
from sections import Effort, Section, steps
from setting import RIGHT, Setting, both
from sliding_mode import sliding_mode

from eos_pin import load_robot
from eos_pin._kernels.dispatch import REFERENCES

TINY = Effort(rounds=1, repeats=1, targets=2, robots=("panda",), steps=50, duration=0.1, runs=1)

LIAR = f"""
import sys
sys.path.append({str(peers.WORKERS)!r})
from serve import serve
serve(lambda problem: {{"torque:": lambda state: 0.0 * state[:7], "velocity:": lambda state: 1 / 0}})
"""


@pytest.fixture
def no_peers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No environment of any peer."""
    monkeypatch.setattr(peers, "FOLDER", tmp_path / "peers")


@pytest.fixture
def team() -> Iterator[Crew]:
    """eos_pin and Pinocchio alone."""
    with crew(()) as workers:
        yield workers


def hired(team: Crew, folder: Path, script: str) -> Worker:
    """One more worker, who runs a script."""
    path = folder / "worker.py"
    path.write_text(script)
    team.workers.append(Worker("another", sys.executable, path))
    return team.workers[-1]


@pytest.mark.usefixtures("unchecked", "no_peers")
def test_run_reports_missing_peers(monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.setattr(run, "QUICK", TINY)
    monkeypatch.setattr(run, "DOCUMENT", tmp_path / "performance.md")
    assert run.benchmark(quick=True, json_file=tmp_path / "figures.json", write=True) == 0
    found = json.loads((tmp_path / "figures.json").read_text())
    assert found["missing"] == {peer.name: "not set up" for peer in peers.PEERS.values()}
    for section in found["sections"]:
        assert section["rows"]
        assert {len(row) for row in section["rows"]} == {len(section["columns"])}
    assert {ratio["task"] for ratio in found["ratios"]} == {"position", "pose"}
    assert all(np.isfinite(ratio["measured"]) for ratio in found["ratios"])
    assert "not set up" in capsys.readouterr().out
    text = (tmp_path / "performance.md").read_text()
    assert all(f"\n## {section['title']}\n" in text for section in found["sections"])
    assert "not set up" in text


@pytest.mark.usefixtures("unchecked")
def test_wrong_answers_and_errors_are_reported_not_timed(team, tmp_path) -> None:
    hired(team, tmp_path, LIAR)
    setting = Setting.make("panda", False, tmp_path)
    team.take(setting.problem())
    section = steps(team, setting, TINY)
    assert {row[0] for row in section.rows} == {"eos_pin", "Pinocchio"}
    assert "the task is off by" in team.missing["another, torque:"]
    assert "ZeroDivisionError" in team.missing["another, velocity:"]


@pytest.mark.parametrize(
    ("script", "reason"),
    [("raise SystemExit('no such library')", "no such library"), ("", "without a word")],
)
def test_worker_that_dies_is_sent_home(script, reason, tmp_path) -> None:
    team = Crew()
    worker = hired(team, tmp_path, script)
    team.take({})
    assert team.workers == []
    assert reason in team.missing[worker.name]


def test_worker_that_does_not_answer_is_stopped(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr("crew.PATIENCE", 0.2)
    worker = hired(Crew(), tmp_path, "import sys\nfor line in sys.stdin: pass")
    with pytest.raises(WorkerError, match="no answer after"):
        worker.take({})


@pytest.mark.usefixtures("no_peers")
def test_peer_that_does_not_install_is_reported(monkeypatch) -> None:
    peer = peers.PEERS["pink"]

    def fail(command: list[str], seconds: float) -> str:
        raise subprocess.CalledProcessError(1, command, stderr="lots of text\nERROR: no wheel for this machine\n")

    monkeypatch.setattr(peers, "_said", fail)
    monkeypatch.setattr(peers.venv, "create", lambda folder, with_pip: folder.mkdir())
    assert peers.install(peer) == "ERROR: no wheel for this machine"
    assert peers.installed(peer) == "ERROR: no wheel for this machine"
    assert not peer.folder.exists()


def test_answers_are_judged(tmp_path) -> None:
    for setting in both("panda", tmp_path):
        q, target = setting.posture, setting.placement(setting.posture)
        assert setting.off(q, target) < 1e-15
        assert setting.off(q + 1e-9, target) > RIGHT
        assert setting.off([], target) == setting.off(np.nan * q, target) == np.inf
        assert setting.within(q)
        assert setting.within(q + 2.0 * np.pi * np.arange(-3, 4))
        assert not setting.within(setting.robot.upper + 1e-3)
        # Rotation counts where the task is a pose.
        turned = q + np.eye(7)[6]
        assert (setting.off(turned, target) > RIGHT) == setting.whole


def test_page_that_is_kept_has_every_peer() -> None:
    text = run.DOCUMENT.read_text(encoding="utf-8")
    assert [peer.name for peer in peers.PEERS.values() if f"| {peer.name} |" not in text] == []


def test_peers_have_workers() -> None:
    scripts = {path.name for path in peers.WORKERS.glob("with_*.py")}
    timed = {"with_eos_pin.py", "with_pinocchio.py", *(peer.worker.name for peer in peers.PEERS.values())}
    # Planners have workers of another kind.
    assert timed <= scripts <= timed | {peer.worker.name for peer in peers.OTHERS.values()}


def test_page_is_honest_about_who_is_faster() -> None:
    columns = ("library", "computes", "median, µs", "middle half", "× eos_pin")
    rows = [("eos_pin", "torque", 10.0, "", 1.0), ("TSID", "torque", 5.0, "", 0.5), ("Pink", "velocity", 50.0, "", 5.0)]
    text = page({}, [Section("Control step, pose", columns, rows)], [], {})
    assert "- control step, pose: TSID (torque) 0.5" in text
    assert "Pink (velocity)" not in text


@pytest.mark.usefixtures("unchecked")
def test_sliding_mode_has_error_and_chattering_of_eos_with_the_same_gains(tmp_path: Path) -> None:
    assert sliding_mode(quick=True, json_file=tmp_path / "figures.json") == 0
    usual, plain, sliding = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert sliding["|σ|/layer"] < 1.0
    for name in ("error [mm]", "chattering [N m]"):
        assert sliding[name] == pytest.approx(plain[name], rel=0.05)
    assert usual["error [mm]"] > 2.0 * plain["error [mm]"]


@pytest.mark.slow
@compiled_only
def test_compiled_benchmark_times_both_forms(tmp_path: Path) -> None:
    assert compiled.benchmark(rounds=1, json_file=tmp_path / "compiled.json") == 0
    found = json.loads((tmp_path / "compiled.json").read_text())
    for name in REFERENCES:
        assert any(row.startswith(name) for row in found["Kernels"])
    assert {"step, position", "continuous run of 1 s, pose"} <= set(found["Whole"])


@pytest.mark.usefixtures("unchecked")
def test_judge_of_bands_finds_a_worse_command(monkeypatch) -> None:
    monkeypatch.setattr(bands, "DURATION", 0.5)
    robot = load_robot("panda", chain_to="auto")
    case = bands.Case.drawn(robot, 5)
    trace, h = bands.Trace.of(case), case.period
    k = int(np.flatnonzero(trace.used.max(axis=1) > 1.0 + bands.PASSED)[0])
    assert bands.better(case, trace, k) < bands.BETTER
    assert bands.judged(case, trace, k)["verdict"] in (bands.EXCLUDED, bands.FORESEEN)
    # The farthest command within the limits, on the other side.
    low, high = bands.box(case.limits, trace.q[k - 1], trace.dq[k - 1], h)
    slope = bands.slopes(case.task, trace.q[[k]], case.path(k * h).z)[0, 0, 0]
    target = case.path(k * h).z
    worse = max(
        (trace.q[k - 1] + h * np.where(side * slope > 0.0, high, low) for side in (1.0, -1.0)),
        key=lambda q: bands.parts(case.task, q[None], target).max(),
    )
    trace.q[k], trace.used[k] = worse, bands.parts(case.task, worse[None], target)[0]
    assert bands.better(case, trace, k) > 10.0 * bands.BETTER
    found = {"0": bands.one(robot, 3), "1": {"singular": True}}
    assert next(bands.bands(1, found)) == found
    assert dict(bands.told(found))["runs, commands"].startswith("1, ")
