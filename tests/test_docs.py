"""Pages of the documentation: their Python runs, their commands parse, and the site builds without a warning."""

from __future__ import annotations

import html
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

from eos_pin.cli.main import main

ROOT = Path(__file__).parent.parent
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


@pytest.mark.usefixtures("unchecked")
# The page on planning is run by its own test, which looks at what it finds.
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
    texts = {page: page.read_text(encoding="utf-8") for page in (tmp_path / "site").rglob("*.html")}
    anchors = {page: set(re.findall(r"\b(?:id|name)=\"([^\"]+)\"", text)) for page, text in texts.items()}
    for page, text in texts.items():
        assert not re.findall(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"https?:", text), page
        # Each link within the site leads somewhere.
        for link in re.findall(r"<(?:a|script|link|img|iframe)\b[^>]*\b(?:src|href)=\"([^\"]+)\"", text):
            file, _, anchor = unquote(html.unescape(link)).partition("#")
            if not re.match(r"https?:|data:|mailto:", file):
                target = (page.parent / file.partition("?")[0]).resolve() if file else page
                assert target.exists(), f"{page}: {link}"
                assert not anchor or anchor in anchors.get(target, {anchor}), f"{page}: {link}"
