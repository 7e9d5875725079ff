"""The ratio of a plain step to a compiled one, in README.md and docs/performance.md, as `compiled.py` measures it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from marked import HOME, fill, place

DOCUMENTS = HOME / "README.md", HOME / "docs" / "performance.md"
#: Name of the places for it.
NAME = "compiled.py"


def phrase(ratios: Sequence[float]) -> str:
    """The range of ratios in words."""
    least, most = (f"{end(ratios):.2g}" for end in (min, max))
    return f"{least} times" if least == most else f"{least} to {most} times"


def read(document: Path = DOCUMENTS[0]) -> str:
    """The ratio that a document has."""
    found = place(NAME).search(document.read_text(encoding="utf-8"))
    assert found, f"{document.name} has no place for the ratio: <!-- {NAME} -->"
    return found[2]


def write(document: Path, ratio: str) -> None:
    """Write the ratio wherever a document has a place for it."""
    fill(document, NAME, ratio)


def filled(text: str) -> str:
    """A text with the ratio of README.md in its places."""
    return place(NAME).sub(rf"\g<1>{read()}\g<3>", text)
