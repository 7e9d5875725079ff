"""Tables that fit the width of a terminal: no number is cut, and names go on in the next line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.markup import escape
from rich.table import Table

from eos_pin._arrays import JointVector

#: A plan rests at its ends up to this speed [rad/s or m/s].
RESTING = 1e-6
#: Words for the letters in tables of runs.
KEY = (
    "n joints follow a task of m coordinates, so that r = n - m are to spare: their motion is v. A chart is a range "
    "of joints on which task and v are coordinates; its margin is 1 in the middle and 0 at the edge."
)
#: Units of joints, self-motion and drift.
UNITS = "rad or m"
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


def subject(kind: str, frame: str | None) -> str:
    """Kind of a task and its frame in words, such as "point and axis of tool0"."""
    words = {"com": "centre of mass", "point_axis": "point and axis"}.get(kind, kind.replace("_", " "))
    return " of ".join(filter(None, (words, frame)))


def _measured(value: float) -> str:
    """Number with the units of joints and their differences; a dash if there is none."""
    found = format_number(value)
    return found if found == "-" else f"{found} {UNITS}"


def run_table(summary: Mapping[str, Any]) -> Table:
    """Table of one run."""
    title = f"{summary['robot']}: {subject(summary['task'].get('kind', ''), summary['frame'])}"
    table = Table(title=escape(title), show_header=False)
    for _ in range(2):
        # A path or a name in a message may be longer than a line.
        table.add_column(overflow="fold")
    table.add_row("status", escape(summary["status"] + (f": {summary['message']}" if summary["message"] else "")))
    table.add_row("joints n, task m, redundancy r", f"{summary['n']}, {summary['m']}, {summary['r']}")
    period = f" of {summary['period']:g} s" if summary["period"] else ""
    table.add_row("duration", f"{summary['duration']:g} s, {summary['cycles']} cycles{period}")
    units = " or ".join(dict.fromkeys(summary["units"])) or "m or rad"
    settled = f"after {summary['settled_from']:g} s"
    error = "tool path error" if summary["frame"] else "task error"
    table.add_row(f"{error}, {settled}", f"{format_number(summary['task_error_max'])} {units}")
    nothing = "none: the task takes all joints (r = 0)" if summary["m"] and not summary["r"] else ""
    table.add_row(f"self-motion error, {settled}", nothing or _measured(summary["self_motion_error_max"]))
    drift = drift_of_cycles(summary["joint_drift_per_cycle"])
    table.add_row("joints come back to within", drift if drift == "-" else f"{drift}; {UNITS}")
    if any(summary["joint_turns_per_cycle"]):
        table.add_row("whole turns of a joint in a cycle, at most", str(max(summary["joint_turns_per_cycle"])))
    if summary["joint_distance"]:
        apart = summary["joint_distance"]
        text = f"{_measured(apart['max'])}, at the end {format_number(apart['end'])}"
        table.add_row("joints off the plan, at most", text)
    if summary["further_task"]:
        beside = summary["further_task"]
        what = f"further task, {beside['kind']} of {beside['frame']}: error, {settled}"
        table.add_row(what, _measured(beside["error_max"]))
    for name, part in (summary["tolerance_used"] or {}).items():
        text = f"{part:.4g}"
        table.add_row(f"largest part of the tolerance {name}", f"[bold red]{text}[/]" if part > 1.001 else text)
    table.add_row("chart switches", str(summary["chart_switches"]))
    if summary["coupling"]:
        text = f"median {summary['coupling']['median']:.2f}, at most {summary['coupling']['max']:.2f}"
        table.add_row("inertial coupling of task and self-motion", text)
    if summary["given_up_seconds"]:
        table.add_row("part of the task given up", f"{format_number(summary['given_up_seconds'])} s")
    for what, key, unit in (
        ("kinetic energy, mean", "kinetic_energy_mean", "J"),
        ("largest torque or force", "torque_max", "N m or N"),
        ("computing time", "cpu_seconds", "s"),
    ):
        # Not every run has inertias, torques, or a computer.
        if not math.isnan(summary[key]):
            table.add_row(what, f"{format_number(summary[key])} {unit}")
    if summary["limits"]["message"]:
        text = escape(summary["limits"]["message"])
        table.add_row("limits", f"[bold red]{text}[/]" if summary["limits"]["passed"] else text)
    if summary["m"]:
        table.caption, table.caption_justify = KEY, "left"
    return table


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
