"""The examples of the Python API: they run, they are short, and they use public names only."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from eos_pin import Result
from eos_pin.cli.tables import run_table
from eos_pin.plots.pages import overview, save
from eos_pin.viewer.replay import scene_of, write_replay

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))
#: Lines on a screen.
SCREEN = 64


def test_examples_are_numbered_without_gaps():
    assert [path.name[:3] for path in EXAMPLES] == [f"{k:02}_" for k in range(1, 12)]


#: Tasks of the examples of one's own classes: label and unit of each coordinate, and the axis of their first panel.
OWN = {
    "08_own_task": (("distance",), ("m",), "distance [m]"),
    "09_own_objective": (("x", "y", "z"), ("m",) * 3, "y [m]"),
    "10_own_controller": (("x", "y", "z"), ("m",) * 3, "x [m]"),
}


@pytest.mark.usefixtures("unchecked", "without_meshes")
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_finds_its_figures(path, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Each asserts the numbers that it prints.
    made = runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    assert not list(tmp_path.iterdir()), "an example leaves no files behind"
    if path.stem in OWN:
        check_run(made["result"], made["robot"], OWN[path.stem], tmp_path)


def check_run(result, robot, expected, folder):
    """Save a run of one's own classes, load it, draw it, table it and replay it; the units must be right in each."""
    labels, units, axis = expected
    run = Result.load(result.save(folder / "run.npz"))
    assert (run.labels, run.units, run.frame) == (labels, units, "panda_hand_tcp")
    for name in ("q", "tau", "z", "error", "task_deficit", "v", "v_ref"):
        np.testing.assert_array_equal(getattr(run, name), getattr(result, name))
    assert run.residuals()["task"] < 1e-12
    figure = overview(run, robot)
    axes = [text for ax in figure.axes for text in (ax.get_xlabel(), ax.get_ylabel())]
    assert axis in axes
    assert not [text for text in axes if "m, rad" in text]
    legends = [text.get_text() for ax in figure.axes if ax.get_legend() for text in ax.get_legend().get_texts()]
    assert [text for text in legends if text.endswith("[m]")]
    assert save(figure, folder / "run.png").stat().st_size > 0
    (cell,) = [str(cell) for cell in run_table(run.summary()).columns[1].cells if re.fullmatch(r"\S+ m", str(cell))]
    assert "rad" not in cell
    scene = scene_of(run, robot)
    assert dict(scene.traces) == {"actual": "panda_hand_tcp"}
    assert write_replay(folder / "run.html", run, robot).stat().st_size > 10_000


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_fits_a_screen_and_uses_public_names(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= SCREEN
    assert f"`python examples/{path.name}`" in text
    assert re.search(r"^\s*assert ", text, re.MULTILINE), "an example checks its numbers"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] == "eos_pin":
            assert node.module == "eos_pin", "an example imports from the top level of the package"
