"""The replay of runs: curves beside the picture, and several runs in one view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from browser import MARKS, Chromium, light

from eos_pin import EosController, OperationalSpaceController, PositionTask, Result, Robot, circle, simulate
from eos_pin.cli.main import main
from eos_pin.errors import InputError
from eos_pin.viewer.curves import SAMPLES, Line, Panel, described, panels_of, short_names
from eos_pin.viewer.replay import write_replay

REST = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])


@pytest.fixture(scope="module")
def runs(panda: Robot) -> dict[str, Result]:
    task = PositionTask(panda, "panda_hand_tcp")
    path = circle(task.value(REST), 0.05, period=1.0, plane="yz")
    laws = {"eos": EosController(task, path), "task space": OperationalSpaceController(task, path)}
    return {name: simulate(panda, law, REST, duration=1.0, rtol=1e-6) for name, law in laws.items()}


def test_curves_are_those_of_the_run(runs: dict[str, Result], panda: Robot) -> None:
    run = runs["eos"]
    panels = {panel.title: panel for panel in panels_of(run, panda)}
    assert list(panels) == ["joints", "errors", "self-motion v", "torque / limit", "energy"]
    for i, line in enumerate(panels["joints"].lines):
        assert line.name == f"joint{i + 1}"
        assert line.limits == (panda.lower[i], panda.upper[i])
        np.testing.assert_array_equal(line.values, run.q[:, i])
    np.testing.assert_allclose(panels["torque / limit"].lines[1].values * panda.effort[1], run.tau[:, 1])
    assert [line.name for line in panels["errors"].lines] == ["position [m]", "self-motion"]


def test_curves_that_are_thinned_out_keep_their_peaks() -> None:
    t, values = np.linspace(0.0, 60.0, 50_001), np.zeros(50_001)
    values[12_345], values[40_001] = 7.0, -3.0
    told = described({"a": (t, [Panel("torque", "N m", (Line("", values),))])})
    kept = told["panels"][0]["lines"][0]["of"][0]["values"]
    assert len(kept) == len(told["runs"][0]["times"]) <= SAMPLES + 2
    assert (kept.max(), kept.min()) == (7.0, -3.0)


def test_short_names_drop_the_words_that_all_have() -> None:
    assert short_names(["panda_joint1", "panda_joint2"]) == ["joint1", "joint2"]
    assert short_names(["shoulder_pan_joint", "wrist_1_joint"]) == ["shoulder_pan", "wrist_1"]
    assert short_names(["a", "a_b"]) == ["a", "a_b"]
    assert short_names(["base_x"]) == ["base_x"]


def test_replay_refuses_runs_without_samples(runs: dict[str, Result], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to show"):
        write_replay(tmp_path / "none.html", {})


@pytest.mark.usefixtures("without_meshes")
def test_command_shows_runs_together(
    runs: dict[str, Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    files = [str(run.save(tmp_path / name.replace(" ", "-") / "run.npz")) for name, run in runs.items()]
    assert main(["replay", *files, "--html", "both.html"]) == 0
    said = capsys.readouterr().out
    assert "eos" in said
    assert "task-space" in said
    assert Path("both.html").stat().st_size > 10_000
    for arguments, fault in (([files[0], files[0]], "each run is shown once"), ([*files, "--csv", "a.csv"], "--csv")):
        assert main(["replay", *arguments]) == 2
        assert fault in capsys.readouterr().err


def _inside(page: object, wide: int) -> None:
    """All controls and panels are within the width."""
    boxes = page.js(  # type: ignore[attr-defined]
        "[...document.querySelectorAll('#bar > *, #curves canvas, #curves h2')].map(e => e.getBoundingClientRect())"
        ".filter(b => b.width).map(b => [b.left, b.right])"
    )
    assert len(boxes) > 10
    assert all(0 <= a < b <= wide for a, b in boxes)


@MARKS[0]
@MARKS[1]
def test_one_clock_moves_picture_and_curves(
    chromium: Chromium, runs: dict[str, Result], panda: Robot, tmp_path: Path
) -> None:
    file = write_replay(tmp_path / "runs.html", runs, light(panda))
    page = chromium.open(f"{file.as_uri()}#paused")
    for wide, tall in ((390, 800), (1000, 640)):
        page.do("Emulation.setDeviceMetricsOverride", width=wide, height=tall, deviceScaleFactor=1, mobile=False)
        _inside(page, wide)
    # A press in the middle of a panel is half the time, for the cursor of every panel and the numbers below.
    left, right, y = page.js(
        "(() => { const b = document.querySelector('#curves canvas').getBoundingClientRect();"
        "return [b.left + 46, b.right - 8, b.top + 40]; })()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.do(
            "Input.dispatchMouseEvent", type=kind, x=(left + right) / 2, y=y, button="left", buttons=1, clickCount=1
        )
    assert page.clock() == pytest.approx(0.5, abs=0.01)
    cursors = page.js("[...document.querySelectorAll('#curves .plot i')].map(i => i.getBoundingClientRect().left)")
    np.testing.assert_allclose(cursors, (left + right) / 2, atol=1.5)
    told = page.js("[...document.querySelectorAll('#curves section:first-child output')].map(o => o.textContent)")
    joint = [np.interp(page.clock(), run.t, run.q[:, 0]) for run in runs.values()]
    np.testing.assert_allclose([float(text) for text in told], joint, atol=2e-3)
    # Ghosts lie at one place until they are asked to stand apart; a run that is hidden has no curve.
    assert page.js("[...document.querySelectorAll('.label')].filter(l => l.offsetParent).length") == 0
    page.js("document.getElementById('apart').click()")
    assert page.js("[...document.querySelectorAll('.label')].filter(l => l.offsetParent).length") == 2
    page.js("[...document.querySelectorAll('#legend button')].find(b => b.textContent === 'task space').click()")
    assert page.js("document.querySelectorAll('#curves section:first-child output').length") == 1
    page.js("document.getElementById('plots').click()")
    assert page.js("document.getElementById('curves').offsetParent") is None
    assert all(url.startswith(("file:", "data:", "blob:")) for url in page.requests())
    assert not page.troubles()
    page.close()
