"""Places in documents that benchmarks write: what stands between `<!-- NAME -->` and `<!-- end -->`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

HOME = Path(__file__).parent.parent
#: The page on planning.
PLANNING = HOME / "docs" / "planning.md"


def place(name: str) -> re.Pattern[str]:
    """Pattern of a place in a document: its beginning, the text there, its end."""
    return re.compile(f"(<!-- {re.escape(name)} -->)(.*?)(<!-- end -->)", re.DOTALL)


def fill(document: Path, name: str, text: str) -> None:
    """Write a text wherever a document has a place of this name; there must be one."""
    before = document.read_text(encoding="utf-8")
    after, count = place(name).subn(lambda found: found[1] + text + found[3], before)
    assert count, f"{document.name} has no place <!-- {name} -->"
    document.write_text(after, encoding="utf-8")


def table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    assert all(len(line) == len(columns) for line in lines), columns
    return "\n" + "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines) + "\n"
