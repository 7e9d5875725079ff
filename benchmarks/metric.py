"""Charts with the metric of the paper and with the mass matrix: coupling, size, cost, and what motions and pushes do.

    python benchmarks/metric.py [--postures N] [--json FILE] [--write]

Five robots, position and pose. Postures are drawn from within the joint limits, where the task is regular. The same
postures and directions serve both metrics. Times are CPU time of one thread, medians of rounds that take turns.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import count
from pathlib import Path
from statistics import median
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro
from chains import cpu
from marked import HOME, fill, table
from rich.progress import track

from eos_pin import (
    Atlas,
    Chart,
    ControlLoop,
    EosController,
    EosError,
    ExtendedDynamics,
    Hold,
    ImpedanceController,
    PoseTask,
    PositionTask,
    Task,
    TaskForce,
    load_robot,
    simulate,
    simulate_sampled,
)
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.experiments.defaults import fitting_path, rest_posture

DOCUMENT = HOME / "docs" / "metric.md"
METRICS = ("identity", "inertial")
ROBOTS = ("panda", "xarm7", "baxter", "tiago", "pr2")
KINDS = ("position", "pose")
#: Distance from the base at which the coupling is looked at, margin where it is, and where the search for that margin
#: ends, before a continuous joint could end the chart [rad or m].
NEAR, MARGIN, FAR = 0.3, 0.5, 2.5
#: Condition number of G' up to which postures count.
REGULAR = 50.0
#: Push at the tool [N] and its length [s].
PUSH, PUSHED = 10.0, 0.2
ROUNDS = 9


@cache
def task_of(name: str, kind: str) -> Task:
    """Task of a robot's own end effector."""
    robot = load_robot(name, chain_to="auto")
    return (PoseTask if kind == "pose" else PositionTask)(robot, robot.options["chain_to"])


def postures(task: Task, wanted: int) -> list[np.ndarray]:
    """So many joints within limits at which the task is regular."""
    robot, random = task.robot, np.random.default_rng(0)
    found: list[np.ndarray] = []
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    while len(found) < wanted:
        q = random.uniform(lower, upper)
        if np.linalg.cond(task.linearize(q)[1]) < REGULAR:
            found.append(q)
    return found


class Looks(NamedTuple):
    """Coupling on the charts of many postures.

    Attributes:
        base: At the base.
        near: At the distance `NEAR` in a random direction.
        edge: In the same direction where the margin has fallen to `MARGIN`, as far as that is met.
        reach: How far that is [rad or m].
    """

    base: list[float]
    near: list[float]
    edge: list[float]
    reach: list[float]


def coupling(chart: Chart, q: np.ndarray) -> float:
    """Inertial coupling at q."""
    return ExtendedDynamics.from_state(chart.task.robot, chart, q, 0.0 * q).coupling


def reach(chart: Chart, direction: np.ndarray) -> float:
    """Distance at which the margin falls to `MARGIN`; infinite where it does not, up to `FAR`."""

    def margin(s: float) -> float:
        return chart.margin(chart.task.linearize(chart.q_bar + s * direction)[1])

    steps = np.arange(0.0, FAR, 0.05)
    beyond = next((s for s in steps if margin(s) <= MARGIN), None)
    if beyond is None:
        return np.inf
    low, high = beyond - 0.05, beyond
    for _ in range(30):
        low, high = (low, mid) if margin(mid := 0.5 * (low + high)) <= MARGIN else (mid, high)
    return high


def look(task: Task, metric: str, wanted: int) -> Looks:
    """Coupling on `wanted` charts."""
    looks, random = Looks([], [], [], []), np.random.default_rng(1)
    for q in postures(task, wanted):
        chart, direction = Chart.from_base(task, q, metric=metric), random.normal(size=q.size)
        direction /= np.linalg.norm(direction)
        looks.base.append(coupling(chart, q))
        try:
            looks.near.append(coupling(chart, q + NEAR * direction))
            looks.reach.append(way := reach(chart, direction))
            if np.isfinite(way):
                looks.edge.append(coupling(chart, q + way * direction))
        except EosError:  # the way leads through a singularity of the task
            continue
    return looks


def told(values: list[float]) -> str:
    """Median and 90th percentile."""
    return f"{median(values):.2f} ({np.percentile(values, 90):.2f})" if values else "none"


def coupling_rows(wanted: int) -> list[list[str]]:
    """Table of the coupling."""
    rows = []
    cases = [(name, kind, metric) for name in ROBOTS for kind in KINDS for metric in METRICS]
    for name, kind, metric in track(cases, description="coupling", console=stderr, transient=True):
        found = look(task_of(name, kind), metric, wanted)
        base = told(found.base) if max(found.base) > 1e-6 else f"0, to {max(found.base):.0e}"
        way = f"{way:.2f}" if np.isfinite(way := median(found.reach)) else f"beyond {FAR:g}"
        rows.append([name, kind, metric, base, told(found.near), told(found.edge), way])
    return rows


def step(loop: ControlLoop, clock: Iterator[int], q: np.ndarray, dq: np.ndarray) -> None:
    """One step of a loop, at the next time."""
    loop.step(1e-3 * next(clock), q, dq)


def cost_rows() -> list[list[str]]:
    """Table of times, µs."""
    calls: dict[tuple[str, str, str], Callable[[], Any]] = {}
    for kind in KINDS:
        task = task_of("panda", kind)
        q = rest_posture(task)
        near, dq = q + 0.05, np.full(q.size, 0.1)
        for metric in METRICS:
            chart = Chart.from_base(task, q, metric=metric)
            loop = ControlLoop(EosController(task, Hold(task.value(q), task.m), atlas=Atlas(task, metric=metric)))
            loop.step(0.0, q, dq)
            J = task.linearize(near)[1]
            calls |= {
                (kind, metric, "first chart"): partial(Chart.from_base, task, q, metric=metric),
                (kind, metric, "next chart"): partial(Chart.from_base, task, near, previous=chart),
                (kind, metric, "step"): partial(step, loop, count(1), near, dq),
                (kind, metric, "margin"): partial(chart.margin, J, enough=0.5),
            }
    times: dict[tuple[str, str, str], list[float]] = {key: [] for key in calls}
    for _ in track(range(ROUNDS), description="cost", console=stderr, transient=True):
        for key, call in calls.items():
            times[key].append(cpu(call))
    rows = []
    for kind in KINDS:
        for what in ("first chart", "next chart", "step", "margin"):
            one, other = (1e6 * median(times[kind, metric, what]) for metric in METRICS)
            rows.append([kind, what, f"{one:.3g}", f"{other:.3g}", f"{other / one:.2f}"])
    return rows


@dataclass(frozen=True)
class Motion:
    """A figure eight with v held, and a push at the tool while the robot stands, on charts of one metric.

    Attributes:
        charts: Charts used on the figure eight.
        speed: Largest joint speed [rad/s or m/s].
        drift: Joint drift of the second round [rad or m].
        coupling: Median coupling.
        pushed: How far a push moves v under EOS control [rad or m].
        soft: The same under impedance control.
        task_pushed: How far it moves the task under EOS control, the largest entry [m or rad].
    """

    charts: int
    speed: float
    drift: float
    coupling: float
    pushed: float
    soft: float
    task_pushed: float


def motion(name: str, kind: str, metric: str) -> Motion:
    """Two rounds of the path that `eos-pin track` takes, and a push at the tool while the robot stands."""
    task = task_of(name, kind)
    robot, q = task.robot, rest_posture(task)
    path = fitting_path(task, q)
    atlas = Atlas(task, metric=metric)
    found = simulate(robot, EosController(task, path, atlas=atlas), q, duration=2.0 * path.period)
    tool = PositionTask(robot, robot.options["chain_to"])
    push = TaskForce(tool, lambda t: PUSH * (t < PUSHED) * np.array([0.6, -0.64, 0.48]))
    here = Hold(task.value(q), task.m)
    stood, soft = (
        simulate(robot, kind_of(task, here, atlas=atlas), q, duration=1.0, task_force=push)
        for kind_of in (EosController, ImpedanceController)
    )
    summary = found.summary()
    return Motion(
        len(found.switches) + 1,
        float(np.abs(found.dq).max()),
        summary["joint_drift_per_cycle"][-1],
        summary["coupling"]["median"],
        float(np.linalg.norm(stood.v, axis=1).max()),
        float(np.linalg.norm(soft.v, axis=1).max()),
        float(np.abs(stood.error).max()),
    )


class Soft(NamedTuple):
    """A figure eight under impedance control at 1 kHz, with the spring of v anchored at the start, and a push at rest.

    Attributes:
        status: Status of the run.
        charts: Charts used.
        speed: Largest joint speed [rad/s or m/s].
        error: Largest task error, of lengths or angles [m or rad].
        yields: How far a push at the elbow, along the self-motion that moves it most, moves the tool at rest [m].
    """

    status: str
    charts: int
    speed: float
    error: float
    yields: float


def soft(name: str, kind: str, metric: str) -> Soft:
    """A round under impedance control, and K_z⁻¹(Hᵀτ_ext)_z of a push at the elbow, the median of postures."""
    task = task_of(name, kind)
    robot, q = task.robot, rest_posture(task)
    path, atlas = fitting_path(task, q), Atlas(task, metric=metric)
    law = ImpedanceController(task, path, atlas=atlas)
    run = simulate_sampled(robot, law, q, duration=min(path.period, 4.0), control_period=1e-3, torque_limits=False)
    middle = (robot.model.njoints + 1) // 2
    elbow = PositionTask(robot, next(f.name for f in robot.model.frames if f.parentJoint == middle))
    moved = []
    for x in postures(task, 40):
        chart, E = Chart.from_base(task, x, metric=metric), elbow.linearize(x)[1]
        force = PUSH * np.linalg.svd(E @ chart.V)[0][:, 0]
        Q = np.linalg.solve(np.vstack((task.linearize(x)[1], chart.Wt)).T, E.T @ force)
        moved.append(float(np.linalg.norm(np.linalg.solve(law.gains.stiffness, Q[: task.m])[:3])))
    finished = np.isfinite(run.dq).all(axis=1)
    return Soft(
        run.status, len(run.switches) + 1, float(np.abs(run.dq[finished]).max()), float(np.abs(run.error).max()),
        median(moved),
    )  # fmt: skip


def soft_rows() -> tuple[list[list[str]], str]:
    """Table of impedance control by metric, and what it comes to."""
    cases = [(name, kind) for name in ROBOTS for kind in KINDS]
    ran = {
        (*case, metric): soft(*case, metric)
        for case in track(cases, description="impedance", console=stderr, transient=True)
        for metric in METRICS
    }
    rows = [
        [*key, s.status, str(s.charts), f"{s.speed:.2g}", f"{1e3 * s.error:.2g}", f"{1e3 * s.yields:.2g}"]
        for key, s in ran.items()
    ]
    pairs = [(ran[(*case, "identity")], ran[(*case, "inertial")]) for case in cases]
    both = [(a, b) for a, b in pairs if a.status == b.status == "finished"]
    good = [sum(pair[k].status == "finished" for pair in pairs) for k in (0, 1)]
    charts = [sum(pair[k].charts for pair in both) for k in (0, 1)]
    yields, speed = median(a.yields / b.yields for a, b in pairs), median(b.speed / a.speed for a, b in both)
    verdict = (
        f"\n\nUnder impedance control a push at the elbow moves the tool {yields:.2g} times as far on the paper's "
        f"charts as on inertial ones. Of {len(pairs)} figure eights {good[0]} are finished on the paper's charts and "
        f"{good[1]} on inertial ones; where both are, these have {charts[1]} charts instead of {charts[0]}, and the "
        f"fastest joint is {speed:.2g} times as fast.\n"
    )
    return rows, verdict


def metrics(
    *,
    postures_each: Annotated[int, tyro.conf.arg(name="postures")] = 200,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    write: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    soft_only: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> int:
    """Compare charts with the metric of the paper and with the mass matrix.

    Args:
        postures_each: Postures of each robot and task.
        json_file: File for the figures.
        write: Write the tables of docs/metric.md.
        soft_only: Leave out all but impedance control.
    """
    softly, told_softly = soft_rows()
    columns: tuple[str, ...] = (
        "robot",
        "task",
        "metric",
        "run",
        "charts",
        "fastest joint",
        "z error",
        "z, elbow pushed",
    )
    console.print(grid("impedance", columns, softly))
    console.print(told_softly, soft_wrap=True)
    if write:
        fill(DOCUMENT, "impedance", "\n" + table(columns, softly))
        fill(DOCUMENT, "impedance verdict", told_softly)
    if soft_only:
        return 0
    looks, costs = coupling_rows(postures_each), cost_rows()
    cases = [(name, kind) for name in ROBOTS for kind in KINDS]
    ran = {
        (name, kind, metric): motion(name, kind, metric)
        for name, kind in track(cases, description="motions", console=stderr, transient=True)
        for metric in METRICS
    }
    moved = [
        [*key, str(m.charts), f"{m.speed:.2g}", f"{m.drift:.1e}", f"{m.coupling:.2f}", f"{1e3 * m.pushed:.2g}",
         f"{1e3 * m.soft:.2g}", f"{1e3 * m.task_pushed:.2g}"]
        for key, m in ran.items()
    ]  # fmt: skip
    pairs = [(ran[(*case, "identity")], ran[(*case, "inertial")]) for case in cases]
    charts = sum(a.charts for a, _ in pairs), sum(b.charts for _, b in pairs)
    still, soft = [a.pushed / b.pushed for a, b in pairs], [a.soft / b.soft for a, b in pairs]
    verdict = (
        f"\n\nOver these {len(pairs)} figure eights, two rounds each, the paper's charts are {charts[0]} and inertial "
        f"ones {charts[1]}; the fastest joint is {median(b.speed / a.speed for a, b in pairs):.2g} times as fast. "
        f"A push at the tool moves v {median(still):.2g} times as far on the paper's charts as on inertial ones under "
        f"EOS control (least {min(still):.2g}), and {median(soft):.2g} times as far under impedance control (least "
        f"{min(soft):.2g}). Ratios are medians.\n"
    )
    tables = {
        "coupling": (
            ("robot", "task", "metric", "base", f"{NEAR} away", f"at margin {MARGIN}", "that is away"),
            looks,
        ),
        "cost": (("task of Panda", "what", "identity", "inertial", "ratio"), costs),
        "motion": (
            ("robot", "task", "metric", "charts", "fastest joint", "drift of round 2", "coupling", "v pushed, EOS",
             "v pushed, impedance", "z pushed, EOS"),
            moved,
        ),
    }  # fmt: skip
    for title, (columns, rows) in tables.items():
        console.print(grid(title, columns, rows))
    console.print(verdict, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, {"coupling": looks, "cost": costs, "motion": [[*k, asdict(m)] for k, m in ran.items()]})
    if write:
        for title, (columns, rows) in tables.items():
            fill(DOCUMENT, title, "\n" + table(columns, rows))
        fill(DOCUMENT, "verdict", verdict)
    return 0


if __name__ == "__main__":
    sys.exit(run(metrics))
