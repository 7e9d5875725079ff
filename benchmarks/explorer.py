"""Script time of the explorer's page from picture to picture, by Chromium's own record of its main thread.

Run it by `python benchmarks/explorer.py`. It takes minutes where the processor draws the pictures, which is then what
they wait for; a graphics card draws them at the rate of the screen.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from marked import HOME

from eos_pin import load_robot, make_task, rest_posture
from eos_pin.viewer.explorer import write_explorer

sys.path.insert(0, str(HOME / "tests"))

from browser import Chromium, Page, wait_for

CASES = [("panda", "position"), ("panda", "pose"), ("xarm7", "position"), ("xarm7", "pose"), ("kinova", "position")]
#: Work of a page's scripts in the record, and clearing up after them.
SCRIPTS = {"FireAnimationFrame", "TimerFire", "EventDispatch", "FunctionCall", "RunMicrotasks", "MinorGC", "MajorGC"}
#: One step of each motion; k counts them.
MOTIONS = {
    "slider of v": "explorer.go(Array.from(p.z), v0.map((x, i) => i ? x : x + .8 * Math.sin(.05 * k)))",
    "elbow": "elbow.drag([at[0], at[1] + .15 * size * Math.sin(.05 * k), at[2] + .05 * size * Math.sin(.1 * k)])",
    "hand": "hand.drag([to[0], to[1] + .06 * size * Math.sin(.05 * k), to[2] + .06 * size * Math.sin(.1 * k)])",
}
#: A step of a motion in each picture, with a mark in the record.
DRIVER = """(() => {
  const p = explorer.posture, v0 = Array.from(p.v), [hand, elbow] = explorer.handles, size = p.robot.reach;
  const at = Array.from(elbow.at), to = Array.from(hand.at), begun = performance.now();
  let k = 0;
  window.seconds = null;
  const step = () => {
    console.timeStamp("picture");
    if (++k > PICTURES) { window.seconds = (performance.now() - begun) / 1000; return; }
    MOTION;
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
})()"""
COLUMNS = ("robot", "task", "moved", "median", "p90", "worst", "mean by the counter", "pictures a second", "file [MB]")


class Pace(NamedTuple):
    """Pace of a page while something moves.

    Attributes:
        script: CPU time of scripts in each picture [ms].
        counted: Mean of it by the browser's counter of scripts [ms].
        rate: Pictures in a second.
    """

    script: np.ndarray
    counted: float
    rate: float


@contextmanager
def browser() -> Iterator[Chromium]:
    """A headless browser that is closed in the end."""
    with tempfile.TemporaryDirectory() as profile:
        chromium = Chromium(profile)
        try:
            yield chromium
        finally:
            chromium.close()


def per_picture(events: Sequence[dict[str, Any]]) -> np.ndarray:
    """CPU time of scripts between the marks of a record [ms]; a script within another counts once."""
    marks = [each for each in events if each["name"] == "TimeStamp" and each["args"]["data"]["message"] == "picture"]
    thread = marks[0]["pid"], marks[0]["tid"]
    instants = sorted(mark["ts"] for mark in marks)
    spent, end = np.zeros(len(marks) + 1), -np.inf
    scripts = [
        each
        for each in events
        if each["name"] in SCRIPTS and each["ph"] == "X" and (each["pid"], each["tid"]) == thread
    ]
    for event in sorted(scripts, key=lambda each: (each["ts"], -each["dur"])):
        if event["ts"] + event["dur"] <= end:
            continue
        end = event["ts"] + event["dur"]
        # A mark stands within the script that belongs to it.
        spent[np.searchsorted(instants, end)] += event["tdur"] / 1000.0
    return spent[1:-1]


def pace(page: Page, motion: str, pictures: int) -> Pace:
    """Move something by a step in each picture."""

    def counter() -> float:
        return next(
            float(each["value"])
            for each in page.do("Performance.getMetrics")["metrics"]
            if each["name"] == "ScriptDuration"
        )

    page.events.clear()
    before = counter()
    page.do("Tracing.start", categories="devtools.timeline,v8", transferMode="ReportEvents")
    page.js(DRIVER.replace("MOTION", MOTIONS[motion]).replace("PICTURES", str(pictures)))
    wait_for(lambda: page.js("window.seconds"), 600.0)
    counted = counter() - before
    page.do("Tracing.end")
    wait_for(lambda: page.js("0") or any(each["method"] == "Tracing.tracingComplete" for each in page.events), 60.0)
    parts = [each["params"]["value"] for each in page.events if each["method"] == "Tracing.dataCollected"]
    script = per_picture([event for part in parts for event in part])
    return Pace(script, 1000.0 * counted / pictures, pictures / page.js("window.seconds"))


def measured(cases: Sequence[tuple[str, str]], pictures: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table."""
    with browser() as chromium, tempfile.TemporaryDirectory() as folder:
        for name, kind in cases:
            task = make_task(load_robot(name, chain_to="auto"), kind)  # type: ignore[arg-type]
            file = write_explorer(Path(folder, f"{name}.html"), task, rest_posture(task))
            page = chromium.open(file.as_uri())
            page.do("Performance.enable", timeDomain="threadTicks")
            wait_for(lambda page=page: page.js("explorer.idle()"), 60.0)
            for motion in MOTIONS:
                script, counted, rate = pace(page, motion, pictures)
                assert not page.troubles()
                figures = np.median(script), np.percentile(script, 90), script.max(), counted, rate
                size = f"{file.stat().st_size / 1e6:.2f}"
                yield (name, kind, motion, *(f"{figure:.1f}" for figure in figures), size)
            page.close()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", help="this robot alone")
    parser.add_argument("--pictures", type=int, default=100, help="pictures of each motion")
    options = parser.parse_args()
    print("  ".join(COLUMNS))
    for row in measured([case for case in CASES if options.robot in (None, case[0])], options.pictures):
        print("  ".join(row), flush=True)


if __name__ == "__main__":
    main()
