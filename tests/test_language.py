"""Plain English: rules for docstrings that a program can check."""

from __future__ import annotations

import ast
import re
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "eos_pin"
#: First sentences are noun phrases or imperatives: no clause in place of a noun, and nothing speaks or wants.
RIDDLES = re.compile(r"\b([Ww]hat|says?|said|tells?|told|wants?|believed?s?|vouch\w*)\b")


def first_sentences(path):
    """First sentences of a module's docstrings, as (line, sentence)."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node) or ""
            yield getattr(node, "lineno", 1), re.split(r"(?<=[.;:])\s", text.strip().replace("\n", " "))[0]


def test_first_sentences_are_noun_phrases_or_imperatives():
    found = [
        f"{path.relative_to(PACKAGE)}:{line}: {sentence}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, sentence in first_sentences(path)
        if RIDDLES.search(sentence)
    ]
    assert not found, "\n".join(found)
