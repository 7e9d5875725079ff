"""The bench: laws, gains found alike, runs that are kept, and verdicts on numbers whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from eos_pin import InputError, MujocoPlant, UnknownNameError
from eos_pin.cli.main import main
from eos_pin.experiments.bench import harness
from eos_pin.experiments.bench.laws import LAWS, Setup
from eos_pin.experiments.bench.page import page
from eos_pin.experiments.bench.settings import SETTINGS, USUAL
from eos_pin.experiments.bench.surface import cut_off, with_surface
from eos_pin.experiments.bench.trial import LOST, PERIOD, BenchTrial, scene
from eos_pin.experiments.bench.verdict import _holm, _signed_rank, enough, verdict


def rows(errors, setting="exact", robots=("panda",)):
    """A table of results with these errors, by law."""
    return [
        {"robot": robot, "law": law, "setting": setting, "seed": seed, "task_rate": 8.0, "free_rate": 2.0,
         "status": "finished", "error": error, "error_max": 2.0 * error, "drift": 0.0, "torque": 1.0, "roughness": 0.1,
         "seconds": 0.2}
        for robot in robots for law, own in errors.items() for seed, error in enumerate(own)
    ]  # fmt: skip


def test_laws_and_settings_are_as_many_as_promised():
    assert len(LAWS) >= 14
    assert len(USUAL) >= 8


@pytest.mark.parametrize("law", LAWS)
def test_law_has_a_torque_on_the_bench(law):
    found = scene("panda")
    controller = LAWS[law].make(Setup(*found, 2e-3, 16.0, 8.0))
    q = np.array(found.posture)
    tau, _ = controller.step(0.0, q, 0.1 + 0.0 * q, controller.start(0.0, q, 0.0 * q))
    assert np.isfinite(tau).all()
    assert controller.task is found.task


@pytest.mark.parametrize("setting", [name for name in SETTINGS if not name.startswith(("exact", "rate"))])
@pytest.mark.usefixtures("unchecked")
def test_setting_disturbs(setting, monkeypatch):
    monkeypatch.setattr(
        "eos_pin.experiments.bench.trial.DURATION", 1.6 if setting.startswith(("push", "contact")) else 0.2
    )
    trials = [BenchTrial.from_settings("panda", setting=name, seed=3, task_rate=16.0) for name in ("exact", setting)]
    plain, disturbed = (trial.run() for trial in trials)
    assert plain.ok
    assert disturbed.ok
    assert np.abs(disturbed.q[-1] - plain.q[-1]).max() > 1e-6


def test_surface_pushes_the_tool_out_and_nothing_else():
    task, path, q, _ = scene("panda")
    robot, rest = task.robot, np.zeros(task.robot.n)
    frame, z, normal = robot.options["chain_to"], task.value(q), np.array([0.0, 0.6, 0.8])
    free = MujocoPlant.from_robot(robot, integrator="implicitfast").advance(q, rest, robot.gravity(q), 1e-3)[1]
    for depth in (-0.001, 0.001):
        plant = with_surface(robot, frame, z + depth * normal, normal)
        moved = task.linearize(q)[1] @ (plant.advance(q, rest, robot.gravity(q), 1e-3)[1] - free)
        assert (np.linalg.norm(moved) > 1e-6) == (depth > 0.0)
        assert moved @ normal >= 0.0
    # The plane cuts off the end of the path, with the normal towards the rest of it.
    point, out = cut_off(path, PERIOD)
    heights = np.array([out @ (path(t).z - point) for t in np.linspace(0.0, PERIOD, 400)])
    assert 0.1 < -heights.min() / np.ptp(heights) < 0.2


def test_verdict_finds_the_law_that_is_better():
    random = np.random.default_rng(0)
    base = np.exp(random.normal(size=20))
    table = {"eos": base, "acceleration": 1.3 * base * np.exp(0.05 * random.normal(size=20)), "gauss": 2.0 * base}
    found = verdict(rows(table), "exact")
    assert (found.winner, found.pairs) == ("eos", 20)
    assert [s.law for s in found.standings] == ["eos", "acceleration", "gauss"]
    assert found.standings[2].ratio == pytest.approx(2.0)
    low, high = found.standings[1].low, found.standings[1].high
    assert 1.2 < low < found.standings[1].ratio < high < 1.4
    assert found.standings[1].p < 0.05


def test_verdict_has_no_winner_where_there_is_none():
    random = np.random.default_rng(1)
    base = np.exp(random.normal(size=20))
    noisy = {name: base * np.exp(0.3 * random.normal(size=20)) for name in ("eos", "acceleration", "gauss")}
    assert verdict(rows(noisy), "exact").winner == ""
    # A difference that is certain and small counts for nothing, nor does a large one in two runs.
    assert len(verdict(rows({"eos": base, "gauss": 1.02 * base}), "exact").best) == 2
    assert verdict(rows({"eos": base[:2], "gauss": 3.0 * base[:2]}), "exact").winner == ""


def test_verdict_counts_lost_runs_as_worst():
    base = np.linspace(0.001, 0.002, 12)
    found = verdict(rows({"eos": base, "least-torque": np.full(12, LOST)}), "exact")
    assert found.winner == "eos"
    assert found.standings[1].lost == 12


def test_pairs_are_enough_where_the_test_can_reject():
    for laws in (2, 3, 20):
        # All pairs agree, and by different amounts.
        clear = [_signed_rank(np.linspace(1.0, 2.0, enough(laws) - less)) for less in (0, 1)]
        shown = [_holm(np.full(laws - 1, p))[0] < 0.05 for p in clear]
        assert shown == [True, False], laws


def test_holm_adjusts_as_the_textbook_does():
    # Holm 1979: 0.01, 0.02, 0.03 and 0.005 become 0.03, 0.04, 0.04 and 0.02.
    np.testing.assert_allclose(_holm(np.array([0.01, 0.02, 0.03, 0.005])), [0.03, 0.04, 0.04, 0.02])


def test_gains_are_those_with_the_least_error_among_smooth_torques(monkeypatch, tmp_path):
    def fake(trials, **_):
        # Of gauss the torques are rough from 64 on, of eos all are smooth.
        return [
            {
                "error": 1.0
                + abs(np.log(trial.task_rate / (32.0 if trial.law == "eos" else 96.0)))
                + (0.1 if trial.law == "eos" else -0.1) * trial.free_rate,
                "torque": 10.0,
                "roughness": 0.01 * (trial.task_rate if trial.law == "gauss" else 1.0),
            }
            for trial in trials
        ]

    monkeypatch.setattr(harness, "sweep", fake)
    found = harness.find_gains(("panda",), ("eos", "gauss"), 1, {}, lambda *_: None)
    assert found == {("panda", "eos"): (32.0, 2.0), ("panda", "gauss"): (45.0, 8.0)}


def test_gains_with_about_equal_errors_are_those_with_the_least_drift(monkeypatch):
    def fake(trials, **_):
        return [
            {
                "error": 1.0 - 0.01 * trial.free_rate + (trial.task_rate > 16.0),
                "drift": trial.free_rate,
                "torque": 1.0,
                "roughness": 0.0,
            }
            for trial in trials
        ]

    monkeypatch.setattr(harness, "sweep", fake)
    found = harness.find_gains(("panda",), ("eos",), 1, {}, lambda *_: None)
    assert found == {("panda", "eos"): (16.0, 2.0)}


def test_page_lists_settings_where_eos_is_not_the_best():
    base = np.linspace(0.001, 0.002, 12)
    table = rows({"eos": base, "acceleration": 0.5 * base}) + rows({"eos": base, "acceleration": base}, "noise")
    text = page(table, "the command", "figure.png")
    assert "simplified acceleration 1** is better than every other law with exact model" in text
    assert "No winner with noise" in text
    assert "has 0.50 times its error" in text
    assert "48 runs" in text


def test_bench_refuses_unknown_names(tmp_path):
    with pytest.raises(UnknownNameError, match="gauss"):
        harness.bench(["panda"], laws=["gaus"], folder=tmp_path)
    with pytest.raises(UnknownNameError, match="friction"):
        harness.bench(["panda"], settings=["frictoin"], folder=tmp_path)
    with pytest.raises(InputError, match="seeds"):
        harness.bench(["panda"], seeds=0, folder=tmp_path)
    with pytest.raises(InputError, match="eos-pin bench"):
        harness.read_results(tmp_path / "nothing.csv")
    assert main(["bench", "panda", "--results", str(tmp_path / "nothing.csv")]) == 2


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked", "tables_fit")
def test_hundredth_of_the_bench_is_kept_and_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(harness, "TASK_RATES", (16.0,))
    words = ["bench", "panda", "--laws", "eos,acceleration", "--settings", "model-20,noise", "--seeds", "2"]
    words += ["--out", str(tmp_path), "--page", str(tmp_path / "page.md")]
    assert main(words) == 0
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "finished").iterdir()}
    assert len(kept) == 2 * 2 + 2 * 2 * 2
    first = (tmp_path / "page.md").read_text()
    assert main(words) == 0
    assert kept == {path: path.stat().st_mtime_ns for path in (tmp_path / "finished").iterdir()}
    assert (tmp_path / "figures" / "page.png").stat().st_size > 10_000
    found = harness.read_results(tmp_path / "results.csv")
    assert len(found) == 8
    assert all(row["status"] in ("finished", "degraded") for row in found)
    assert main(["bench", "--results", str(tmp_path / "results.csv"), "--page", str(tmp_path / "again.md")]) == 0
    assert (tmp_path / "again.md").read_text().replace("again.png", "page.png") == first
