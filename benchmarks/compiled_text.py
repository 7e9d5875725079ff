"""The ratio of a plain step to a compiled one, in README.md and docs/performance.md, as `compiled.py` measures it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

HOME = Path(__file__).parent.parent
DOCUMENTS = HOME / "README.md", HOME / "docs" / "performance.md"
#: What stands around the ratio in a document.
BEGIN, END = "<!-- compiled.py -->", "<!-- end -->"
_MARKED = re.compile(f"({BEGIN})([^<]*)({END})")


def phrase(ratios: Sequence[float]) -> str:
    """The range of ratios in words."""
    least, most = (f"{end(ratios):.2g}" for end in (min, max))
    return f"{least} times" if least == most else f"{least} to {most} times"


def read(document: Path = DOCUMENTS[0]) -> str:
    """The ratio that a document has."""
    found = _MARKED.search(document.read_text(encoding="utf-8"))
    assert found, f"{document.name} has no place for the ratio: {BEGIN} and {END}"
    return found[2]


def write(document: Path, ratio: str) -> None:
    """Write the ratio wherever a document has a place for it."""
    text = document.read_text(encoding="utf-8")
    document.write_text(_MARKED.sub(rf"\g<1>{ratio}\g<3>", text), encoding="utf-8")


def filled(text: str) -> str:
    """A text with the ratio of README.md in its places."""
    return _MARKED.sub(rf"\g<1>{read()}\g<3>", text)
