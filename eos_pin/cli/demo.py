"""`eos-pin demo`: redundancy in a minute."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import tyro

from eos_pin._files import check_writable
from eos_pin.cli.output import console, format_number, print_files, say_notes, stderr
from eos_pin.experiments.options import RobotOptions

#: Where the page is written if nobody says where.
FOLDER = Path("runs")


def demo(robot: tyro.conf.Positional[str] = "panda", html: Path | None = None) -> int:
    """See redundancy in a minute: one hand rests while its elbow moves, beside an elbow without a command.

    On the left the hand holds a point while the elbow sweeps its loop, under EOS control. On the right a circle is
    followed under traditional control: the hand comes back, the elbow does not. The page is one file that works
    offline; it opens in the browser.

    Args:
        robot: Name or URDF file of a robot with one joint more than its hand's pose or position has coordinates.
        html: File to write instead of opening the browser.

    For example:

      eos-pin demo
      eos-pin demo xarm7 --html lesson.html
    """
    from eos_pin.experiments.lesson import lesson
    from eos_pin.viewer.lesson import write_lesson

    check_writable(html or FOLDER)
    machine = RobotOptions(robot).load()
    say_notes(machine)
    found = lesson(machine)
    unit = "rad or m" if found.task.robot.coordinates.slides.any() else "rad"
    console.print(
        f"EOS control: the elbow sweeps {format_number(found.swept)} m, the hand stays within "
        f"{format_number(found.strayed)} m, all joints come back to within {format_number(found.returned)} {unit}.",
        f"Traditional control: after {found.rounds} rounds of the same circle the joints are "
        f"{format_number(found.drifted)} {unit} off.",
        sep="\n",
    )
    path = write_lesson(html or FOLDER / f"demo-{Path(robot).stem}.html", found)
    print_files([path])
    return opened(path) if html is None else 0


def opened(path: Path) -> int:
    """Show a page in the browser."""
    if not webbrowser.open(path.resolve().as_uri()):
        stderr.print(f"No browser opened; open {path} by hand.", soft_wrap=True, markup=False)
    return 0
