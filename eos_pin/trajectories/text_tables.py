"""Text tables: the cells of every row, with any of the usual separators, and their numbers."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from eos_pin.errors import InputError

#: Longest file that is read [bytes], and the most rows.
MOST_BYTES, MOST_ROWS = 200_000_000, 1_000_000


def cells_of(path: Path) -> list[tuple[int, list[str]]]:
    """Cells of every row that has any, with its line; comments and empty cells at the end are left out.

    Raises:
        InputError: The file cannot be read, is no text, or too long.
    """
    separator, rows = "", []
    for line, text in enumerate(_text(path).splitlines(), 1):
        text = text.split("#", 1)[0].strip(" \r\ufeff")
        if line == 1 and text.lower().startswith("sep="):
            # Excel's way to say it.
            separator = text[4:5]
            continue
        if not text.strip(" \t,;"):
            continue
        separator = separator or next((mark for mark in (";", "\t", ",") if mark in text), " ")
        try:
            cells = text.split() if separator == " " else next(csv.reader([text], delimiter=separator))
        except csv.Error as error:
            raise InputError(f"{path}, line {line}: {error}") from error
        cells = [cell.strip().strip("'\"") for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        # Where commas do not separate columns they are decimal points.
        rows.append((line, [cell.replace(",", ".") for cell in cells] if separator != "," else cells))
        if len(rows) > MOST_ROWS:
            raise InputError(f"{path} has more than {MOST_ROWS:,} rows; keep every second or tenth of them")
    return rows


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot read the path {path}: {error}") from error
    if len(data) > MOST_BYTES:
        raise InputError(f"{path} is longer than {MOST_BYTES // 1_000_000} MB; keep every second or tenth of its rows")
    wide = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"cannot read the path {path}: it is not text in UTF-8 ({error.reason})") from error


def decimal(cell: str) -> Decimal | None:
    """The number that a cell has, without rounding; None for other text."""
    try:
        return Decimal(cell)
    except InvalidOperation:
        return None


def numbers_of(path: Path, line: int, cells: list[str], names: Sequence[str]) -> list[Decimal]:
    """The numbers of one row.

    Args:
        path: The file, for error messages.
        line: The row's line in it.
        cells: The row.
        names: Names of its columns.

    Raises:
        InputError: A cell is no finite number, or there are more or fewer cells than names.
    """
    where = f"{path}, line {line}"
    if len(cells) != len(names):
        raise InputError(f"{where}: expected {len(names)} columns ({', '.join(names)}), got {len(cells)}: {cells}")
    numbers = []
    for name, cell in zip(names, cells, strict=True):
        value = decimal(cell)
        if value is None:
            raise InputError(f"{where}: every entry must be a number, got {cell!r} in column {name}")
        if not value.is_finite() or not np.isfinite(float(value)):
            raise InputError(f"{where}: every entry must be finite, got {cell!r} in column {name}")
        numbers.append(value)
    return numbers
