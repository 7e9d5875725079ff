"""Tables that commands print, looked at on terminals of usual widths."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from eos_pin.cli import output
from eos_pin.cli.tables import fitted

WIDTHS = (80, 100, 160)


def look(table: Table, width: int, cells: Iterable[str]) -> None:
    """The table fits, and neither a number nor a short word is cut."""
    file = io.StringIO()
    Console(file=file, width=width, highlight=False, emoji=False).print(table)
    said = file.getvalue()
    assert max(map(cell_len, said.splitlines())) <= width, said
    assert "…" not in said
    for cell in cells:
        for whole in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])|\b[^\W\d_]{1,10}\b", cell):
            assert whole in said, f"{whole!r} is cut in\n{said}"


def watch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at each table of a command as it is printed."""
    printed = output.console.print

    def fit(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], width: int) -> Table:
        kept = [list(row) for row in rows]
        cells = [*columns, *(cell for row in kept for cell in row if isinstance(cell, str))]
        for each in WIDTHS:
            look(fitted(title, columns, kept, each), each, cells)
        return fitted(title, columns, kept, width)

    def look_and_print(*things: Any, **options: Any) -> None:
        for table in (thing for thing in things if isinstance(thing, Table)):
            for each in WIDTHS if not table.show_header else ():
                look(
                    table,
                    each,
                    [Text.from_markup(str(cell)).plain for column in table.columns for cell in column._cells],
                )
        printed(*things, **options)

    monkeypatch.setattr(output, "fitted", fit)
    monkeypatch.setattr(output.console, "print", look_and_print)
