"""Pages of the documentation: their Python runs, their commands parse, and the site builds without a warning."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from eos_pin.cli.main import main

ROOT = Path(__file__).parent.parent
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


@pytest.mark.usefixtures("unchecked")
# The parts of the page on planning go on from plans that take long; its test picks some.
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python") and page != "planning"])
def test_examples_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(blocks(page, "python")), f"{page}.md", "exec"), {})


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_a_page_have_only_options_that_exist(page, capsys):
    for line in re.findall(r"^(?:\.venv/bin/)?eos-pin .*$", "\n".join(blocks(page, "sh")), re.MULTILINE):
        words = shlex.split(line, comments=True)[1:]
        with pytest.raises(SystemExit):
            main([words[0], "--help"])
        told = capsys.readouterr().out
        for option in (word for word in words if re.match(r"--[a-z]", word)):
            assert re.search(rf"{option}\b", told), f"{page}.md: {words[0]} has no {option}"


@pytest.mark.slow
def test_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("sphinx")
    for module in ("myst_parser", "furo"):
        pytest.importorskip(module)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", ROOT / "docs", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Nothing is fetched when a page is opened from disk.
    for page in (tmp_path / "site").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"https?:", text), page
