"""Plain English: rules for docstrings and names of tests that a program can check."""

from __future__ import annotations

import ast
import re
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "eos_pin"
#: First sentences are noun phrases or imperatives: no clause in place of a noun, and nothing speaks, wants or knows.
RIDDLES = re.compile(
    r"^(How|Who|Why|When|Where|Which)\b|\b(how|who|[Ww]hoever|[Ww]hat(ever)?|"
    r"say|says|said|tells?|told|wants?|believed?s?|vouch\w*|knows?|feels?|worth|nobody)\b"
)
RIDDLES_OF_NAMES = re.compile(r"_(what(ever)?|says?|said|tells?|told|wants?|knows?|nobody)(_|$)")


def first_sentences(path):
    """First sentences of a module's docstrings, as (line, sentence)."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node) or ""
            yield getattr(node, "lineno", 1), re.split(r"(?<=[.])\s", " ".join(text.split()))[0]


def test_first_sentences_are_noun_phrases_or_imperatives():
    found = [
        f"{path.relative_to(PACKAGE)}:{line}: {sentence}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, sentence in first_sentences(path)
        if RIDDLES.search(sentence)
    ]
    assert not found, "\n".join(found)


def test_names_of_tests_have_no_clause_in_place_of_a_noun():
    names = [
        name
        for path in Path(__file__).parent.rglob("test_*.py")
        for name in re.findall(r"def (test_\w+)", path.read_text())
    ]
    assert len(names) > 1000
    assert not [name for name in names if RIDDLES_OF_NAMES.search(name)]
