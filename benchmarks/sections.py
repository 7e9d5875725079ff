"""The tables of `run.py`: control steps, inverse kinematics, random targets, one long loop, whole runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from crew import Crew, Worker, WorkerError
from setting import RIGHT, Setting

from eos_pin import EosController, simulate

#: What the parts of a case's name mean in tables.
WORDS = {
    "": "",
    "bare:": "the Pinocchio calls alone",
    "torque:": "torque",
    "torque:traditional": "torque, traditional control with posture",
    "torque:at limits": "torque, a limit active",
    "torque:within limits": "torque, limits inactive",
    "velocity:": "velocity",
    "velocity:within limits": "velocity, limits inactive",
    "along:": "EOS control",
    "along:within limits": "EOS control with limits",
    "along:busy": "no step, one dot product as long",
    "along:traditional": "traditional control with posture",
    "inverse:": "steps of one",
    "inverse:atlas": "chart after chart",
    "inverse:solve": "its default, search first",
    "inverse:search": "search",
    "inverse:chart": "one chart",
    "inverse:chart, constant B": "one chart, constant B",
    "inverse:damped": "its example, damped",
    "inverse:pseudoinverse": "its example, pseudoinverse",
    "inverse:1 start": "Levenberg–Marquardt, one start",
    "inverse:default": "its defaults, 100 starts",
    "inverse:100 starts": "Levenberg–Marquardt, 100 starts",
    "inverse:100 starts, within limits": "Levenberg–Marquardt, 100 starts, its limits on",
    "inverse:nonlinear program": "nonlinear program",
}
#: Largest error of what a step does, torque [m/s², rad/s²] and velocity [part of what was asked]. Limits are kept on
#: average over a period, so where one is active the task is off at its beginning.
TORQUE_RIGHT, VELOCITY_RIGHT = 1e-4, 0.05
#: Torques that count as the same [N m].
SAME = 0.01
#: Error of a whole run that counts as accurate [rad].
ACCURATE = 1e-8


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        rounds: Rounds of steps and single solves.
        repeats: Calls in one round.
        targets: Random targets for each robot and task.
        robots: Robots for them.
        steps: Steps of the long loop.
        duration: Length of a whole run [s].
        runs: How often it is run.
    """

    rounds: int = 25
    repeats: int = 400
    targets: int = 1000
    robots: tuple[str, ...] = ("panda", "xarm7", "kinova")
    steps: int = 100_000
    duration: float = 10.0
    runs: int = 3


QUICK = Effort(rounds=3, repeats=50, targets=20, robots=("panda",), steps=2000, duration=1.0, runs=1)


@dataclass(frozen=True)
class Section:
    """A table.

    Attributes:
        title: What it shows.
        columns: Heads of its columns.
        rows: Its rows.
        note: What to know about it.
        figures: What ratios are made of, by name.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    note: str = ""
    figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        assert all(len(row) == len(self.columns) for row in self.rows), self.title


def steps(team: Crew, setting: Setting, effort: Effort) -> Section:
    """Control steps: checked, then timed in turn."""
    inputs = [setting.state]
    cases = team.cases("bare", "torque", "velocity")
    answers = {key: np.array(found[0]) for key, (_, found) in team.rounds(cases, inputs, repeats=0, rounds=1).items()}
    apart = {}
    for (name, case), answer in answers.items():
        other = answers.get(("eos_pin", case)) if name != "eos_pin" and case.startswith("torque") else None
        apart[name, case] = np.nan if other is None else float(np.abs(answer - other).max())
        wrong = _wrong(setting, case, answer) or (
            "" if other is None or apart[name, case] <= SAME else "another torque"
        )
        if wrong:
            team.missing[f"{name}, {case}"] = f"does something else: {wrong}"
            del apart[name, case]
    cases = [(worker, case) for worker, case in cases if (worker.name, case) in apart]
    taken = team.rounds(cases, inputs, repeats=effort.repeats, rounds=effort.rounds)
    medians = {key: float(np.median(times)) for key, (times, _) in taken.items()}
    own, bare = medians["eos_pin", "torque:"], medians["Pinocchio", "bare:"]
    rows = [
        (key[0], WORDS[key[1]], t, _spread(taken[key][0]), t / own, t / bare, apart[key])
        for key, t in sorted(medians.items(), key=lambda item: item[1])
    ]
    return Section(
        f"Control step, {setting.kind}",
        ("library", "computes", "median, µs", "middle half", "× eos_pin", "× bare", "apart, N m"),
        rows,
        "The last column says by how much a torque differs from what eos_pin computes for the same.",
        _named(medians),
    )


def _wrong(setting: Setting, case: str, answer: np.ndarray) -> str:
    """What is wrong with what a step computes; empty if nothing is."""
    if case.startswith("bare"):
        return ""
    is_torque = case.startswith("torque")
    off = (setting.torque_off if is_torque else setting.velocity_off)(answer)
    return "" if off <= (TORQUE_RIGHT if is_torque else VELOCITY_RIGHT) else f"the task is off by {off:.2g}"


def inverse(team: Crew, setting: Setting, effort: Effort) -> Section:
    """Inverse kinematics from the rest posture, 0.1 m and 1 mm away."""
    targets = [setting.moved(0.1), setting.moved(0.001)]
    inputs = [setting.search(target) for target in targets]
    cases = team.cases("inverse")
    right = {}
    for key, (_, answers) in team.rounds(cases, inputs, repeats=0, rounds=1).items():
        off = [setting.off(q, target) for q, target in zip(answers, targets, strict=True)]
        right[key] = max(off) <= RIGHT
        if not right[key]:
            team.missing[", ".join(key)] = f"does not reach the {setting.kind}: off by {max(off):.2g}"
    cases = [(worker, case) for worker, case in cases if right.get((worker.name, case))]
    taken = team.rounds(cases, inputs, repeats=max(1, effort.repeats // 8), rounds=effort.rounds)
    medians = {key: np.median(times, axis=0) for key, (times, _) in taken.items()}
    far = medians["eos_pin", "inverse:chart"][0]
    near = min(t[1] for key, t in medians.items() if key[0] == "eos_pin")
    rows = [
        (key[0], WORDS[key[1]], *_pair(taken[key][0], 0, far), *_pair(taken[key][0], 1, near))
        for key, _ in sorted(medians.items(), key=lambda item: item[1][0])
    ]
    heads = [(f"{away}, µs", "middle half", "× eos_pin") for away in ("0.1 m", "1 mm")]
    return Section(
        f"Inverse kinematics to 1e-10, {setting.kind}",
        ("library", "method", *heads[0], *heads[1]),
        rows,
        "Each solve starts from the rest posture; times are compared with the best way that eos_pin has.",
        _named({key: t[0] for key, t in medians.items()})
        | {f"{name}, 1 mm": t for name, t in _named({key: t[1] for key, t in medians.items()}).items()},
    )


def random_targets(team: Crew, settings: Sequence[Setting], effort: Effort) -> Section:
    """Inverse kinematics to targets anywhere in the workspace: how many are reached, and how fast."""
    rows: list[tuple[Any, ...]] = []
    figures = {}
    for setting in settings:
        team.take(setting.problem())
        targets = setting.reachable(effort.targets)
        cases = [
            (worker, case)
            for worker, case in team.cases("inverse")
            # One chart does not cover the workspace.
            if not case.startswith("inverse:chart")
        ]
        taken = team.rounds(cases, [setting.search(target) for target in targets], repeats=1, rounds=1)
        found = []
        for key, (times, answers) in taken.items():
            reached = [q for q, target in zip(answers, targets, strict=True) if setting.off(q, target) <= RIGHT]
            within = sum(map(setting.within, reached))
            share = 100.0 * len(reached) / len(targets)
            inside = 100.0 * within / max(len(reached), 1)
            figures[f"{setting.name} {key[0]} {key[1]}"] = share
            # What a user pays for one solution that the robot can take up.
            each = float(np.sum(times)) / within if within else float("inf")
            found.append((key, share, inside, float(np.median(times)), float(np.mean(times)), each))
        own = next(row[-1] for row in found if row[0] == ("eos_pin", "inverse:search"))
        found.sort(key=lambda row: row[-1])
        rows += [(setting.name, key[0], WORDS[key[1]], *values, values[-1] / own) for key, *values in found]
    return Section(
        f"{effort.targets} random targets, {settings[0].kind}",
        (
            "robot",
            "library",
            "method",
            "reached, %",
            "in limits, %",
            "median, µs",
            "mean, µs",
            "µs a solution in limits",
            "× eos_pin",
        ),
        rows,
        "In limits: of the solutions found; eos_pin's solve and search and the rows that say so were asked to keep "
        "them. A solution in limits costs the time of all targets, failures included, divided by the number of "
        "solutions in limits; it is compared with that of the search.",
        figures,
    )


def long_loop(team: Crew, setting: Setting, effort: Effort) -> Section:
    """Every single step of one loop: the slow ones, and what memory they keep."""
    motion = setting.motion()
    rows, figures = [], {}
    for worker, case in [*team.cases("along", "bare"), *_plain(team)]:
        try:
            reply = worker.ask({"each": case, "inputs": motion, "count": effort.steps})
        except WorkerError as error:
            team.missing[f"{worker.name}, {case}"] = str(error)
            continue
        p50, p99, p999, most = reply["percentiles"]
        figures[f"{worker.name} {case} p99.9"] = reply["own"] / p50
        figures[f"{worker.name} {case} kept"] = reply["blocks"]
        kept = reply["blocks"], reply["bytes"] / 1024
        rows.append((worker.name, WORDS[case], p50, p99, p999, most, p999 / p50, reply["own"] / p50, *kept))
    return Section(
        f"{effort.steps} steps along a figure eight, {setting.kind}, garbage collector on",
        (
            "library",
            "computes",
            "p50, µs",
            "p99",
            "p99.9",
            "most",
            "p99.9 / p50",
            "its own",
            "objects kept",
            "KiB kept",
        ),
        rows,
        "CPU time of every single step, without what reading the clock takes; interrupts count. One of several hundred "
        "stretches of a few µs is interrupted for about 30 µs, whatever computes there, as the dot product shows. So "
        "all is done three times, and the ratio is given for the least of three times, too, as the code's own: what "
        "it takes long for itself comes again at the same step. What is kept is counted over the second half of the "
        "steps.",
        figures,
    )


def whole_runs(setting: Setting, effort: Effort) -> Section:
    """Continuous runs: CPU time and error, integrator by integrator."""

    def run(method: Any, tolerance: float) -> Any:
        controller = EosController(setting.task, setting.path)
        settings: dict[str, Any] = {"duration": effort.duration, "method": method, "rtol": tolerance}
        return simulate(setting.robot, controller, setting.posture, **settings)

    default = run(None, 1e-9).info["arguments"]["method"]
    truth = run("DOP853", 1e-12)
    rows = []
    for method, tolerance in product(("DOP853", "LSODA", "RK45"), (1e-6, 1e-9)):
        results = [run(method, tolerance) for _ in range(effort.runs)]
        seconds = float(np.median([result.info["cpu_seconds"] for result in results]))
        whole = results[0].ok and results[0].q.shape == truth.q.shape
        error = float(np.abs(results[0].q - truth.q).max()) if whole else np.inf
        rows.append((method, f"{tolerance:g}", 1e3 * seconds / effort.duration, error))
    accurate = min((row for row in rows if row[3] <= ACCURATE), key=lambda row: row[2], default=("none", "", 0.0, 0.0))
    return Section(
        f"Continuous run of {effort.duration:g} s, {setting.kind}",
        ("integrator", "tolerance", "CPU ms per simulated second", "largest joint error against 1e-12"),
        rows,
        f"The default is {default} at 1e-9. With an error below {ACCURATE:g} the cheapest here is {accurate[0]}.",
        {f"run {tolerance}": t for method, tolerance, t, _ in rows if method == default},
    )


def _plain(team: Crew) -> list[tuple[Worker, str]]:
    """Plain torque steps of the peers."""
    return [(worker, case) for worker, case in team.cases("torque") if worker.name != "eos_pin" and case == "torque:"]


def _pair(times: np.ndarray, i: int, own: float) -> tuple[float, str, float]:
    median = float(np.median(times[:, i]))
    return median, _spread(times[:, i]), median / own


def _spread(times: np.ndarray) -> str:
    """The middle half of some times."""
    low, high = np.percentile(times, [25.0, 75.0])
    return f"{low:.1f}–{high:.1f}"


def _named(medians: dict[tuple[str, str], Any]) -> dict[str, float]:
    return {" ".join(key): float(t) for key, t in medians.items()}
