"""Tables that fit the width of a terminal: no number is cut, and names go on in the next line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.markup import escape
from rich.table import Table

from eos_pin._arrays import JointVector

#: A plan rests at its ends up to this speed [rad/s or m/s].
RESTING = 1e-6
#: Least width to which a column of words is narrowed.
NARROW = 10


def format_number(value: float | None) -> str:
    """Number with three digits; a dash if there is none."""
    return "-" if value is None or math.isnan(value) else f"{value:.3g}"


def speed_at_ends(start: JointVector, end: JointVector) -> str:
    """Largest speeds of joints where an open plan begins and ends, from which a robot at rest would be jerked."""
    fast = [max(map(abs, dq.tolist())) for dq in (start, end)]
    if max(fast) < RESTING:
        return "at rest"
    return f"{' and '.join(map(format_number, fast))} rad/s or m/s; --timing fastest begins and ends at rest"


def drift_of_cycles(cycles: Sequence[float]) -> str:
    """Drift of the first cycle, the largest of all, and that of the last."""
    if len(cycles) < 3:
        return ", ".join(map(format_number, cycles)) or "-"
    first, worst, last = (format_number(cycles[i]) for i in (0, cycles.index(max(cycles)), -1))
    return f"first {first}, worst {worst}, last {last}, of {len(cycles)}"


def fitted(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], width: int) -> Table:
    """Table whose numbers stand right and whose words stand left; cells are shown as they stand, brackets and all.

    Where it is too wide, headings take several lines, then words do, and last each row becomes a block of lines.

    Args:
        title: Its heading.
        columns: Names of the columns.
        rows: Its cells; numbers are shown by three digits.
        width: Width that it must fit, in letters.
    """
    filled = [[format_number(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    numeric = [all(row[i][:1] in "-0123456789in" for row in filled) for i in range(len(columns))]
    cells = [max((cell_len(row[i]) for row in filled), default=0) for i in range(len(columns))]
    # An edge on either side, a blank after each column, and one between two.
    room = width - 2 * len(columns) - 1
    widths = [max(size, cell_len(name)) for size, name in zip(cells, columns, strict=True)]
    if sum(widths) > room:
        words = [max(map(cell_len, name.split()), default=0) for name in columns]
        widths = [max(pair) for pair in zip(cells, words, strict=True)]
    while sum(widths) > room:
        wide = [i for i, is_number in enumerate(numeric) if not is_number and widths[i] > NARROW]
        if not wide:
            return _blocks(title, columns, filled, width)
        widths[max(wide, key=lambda i: widths[i])] -= 1
    table = Table(title=escape(title), box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name, is_number, size in zip(columns, numeric, widths, strict=True):
        justify = "right" if is_number else "left"
        table.add_column(escape(folded(name, size)), justify=justify, vertical="bottom", no_wrap=True)  # type: ignore[arg-type]
    for row in filled:
        table.add_row(*(escape(folded(cell, size)) for cell, size in zip(row, widths, strict=True)))
    return table


def folded(text: str, width: int) -> str:
    """Text in lines of a width, broken after blanks and signs such as `_`, elsewhere only if there is no other way."""
    lines, line = [], ""
    # Points and signs within a number are no place to break it.
    for piece in re.split(r"(?<=[\s_/])|(?<=[.:-])(?!\d)", text):
        if cell_len((line + piece).rstrip()) > width and line:
            lines.append(line.rstrip())
            line = ""
        line += piece
        while cell_len(line.rstrip()) > width:
            lines.append(line[:width])
            line = line[width:]
    return "\n".join([*lines, line.rstrip()] if line.strip() or not lines else lines)


def _blocks(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> Table:
    """Table of two columns, in which each row is a block of names and cells."""
    left = min(max(map(cell_len, columns)), width // 2)
    table = Table(title=escape(title), box=box.SIMPLE, show_header=False, padding=(0, 1, 0, 0))
    for row in rows:
        for name, cell in zip(columns, row, strict=True):
            table.add_row(escape(folded(name, left)), escape(folded(cell, width - left - 5)))
        table.add_section()
    return table
