"""The examples of the Python API: they run, they are short, and they use public names only."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))
#: Lines on a screen.
SCREEN = 64


def test_examples_are_numbered_without_gaps():
    assert [path.name[:3] for path in EXAMPLES] == [f"{k:02}_" for k in range(1, 11)]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_finds_its_figures(path, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Each asserts the numbers that it prints.
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    assert not list(tmp_path.iterdir()), "an example leaves no files behind"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_fits_a_screen_and_uses_public_names(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= SCREEN
    assert f"`python examples/{path.name}`" in text
    assert re.search(r"^\s*assert ", text, re.MULTILINE), "an example checks its numbers"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] == "eos_pin":
            assert node.module == "eos_pin", "an example imports from the top level of the package"
