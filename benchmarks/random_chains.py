"""Random robots and tasks by the thousand: identities, both equations of motion, tracking and holding on each.

    python benchmarks/random_chains.py [--count N] [--first SEED] [--json FILE]

Needs the `test` extra. A robot has 5 to 12 joints, prismatic and revolute, with random axes, offsets and inertias; its
task is one of all kinds that it can do, in a posture clear of singularities; in one more run nothing is. Everything is
made from the seed alone, so a figure is repeated by `--first SEED --count 1`.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import importlib
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from joblib import Parallel, delayed
from rich.progress import Progress

from eos_pin import (
    Atlas,
    Chart,
    EosController,
    ExtendedDynamics,
    Geodesic,
    Harmonic,
    Hold,
    JointLimits,
    LimitedEosController,
    OpenLoop,
    Result,
    Task,
    TaskForce,
    Track,
    simulate,
    simulate_extended,
    simulate_sampled,
)
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.control._regularize import SINGULAR_VALUE_FLOOR
from eos_pin.experiments.defaults import PASSABLE, regularity

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

#: Rounding error of a number of size one.
ROUNDING = float(np.finfo(float).eps)
#: How far from singular tasks must be: control fades out below `SINGULAR_VALUE_FLOOR`, earlier where the joints are
#: fast.
REGULAR = 2.4 * SINGULAR_VALUE_FLOOR
#: The largest figures that are right; what each is stands in `Figures`.
BOUNDS = {
    "identity": 10.0,
    "null_space": 10.0,
    "acceleration": 10.0,
    "equivalence": 1e-8,
    "tracking": 1e-8,
    "self_motion": 1e-8,
    "hold": 1e-7,
    "fastest": 2.0,
}
#: Speed limit of every joint where nothing keeps clear of singularities [rad/s or m/s].
SPEED = 5.0


@dataclass(frozen=True)
class Figures:
    """What was measured on one robot.

    Attributes:
        seed: Seed that made it.
        n: Joints.
        task: Its task.
        skipped: Tasks drawn before and passed over, because no posture is clear of their singularities.
        regularity: How far the task is from singular at the start, 0 at a singularity.
        condition: Condition number of [G'; Vᵀ] where the identities are checked.
        identity: H [G'; Vᵀ] − I, in units of rounding × condition number.
        null_space: G'D, in units of rounding × condition number.
        acceleration: ddq − (H ddw + E), in the same units times the size of ddq.
        equivalence: Difference of joints and velocities after integrating in q and in w [rad, m, per s].
        tracking: Largest task error along a path, from rest to rest [m, rad].
        self_motion: Largest self-motion error meanwhile, while v follows a sine, on the first chart; where the chart is
            changed v continues, but dv jumps.
        hold: Task and self-motion error 2 s after a displacement and a push.
        anywhere: How a run ended that goes through whatever singularities there are: any task, from any posture, to and
            fro along a line that may lead out of reach, sampled, with a limit of speed.
        unlimited: How the same run ended without limits.
        fastest: Largest speed of a joint in that run, in units of its limit; infinite if a torque was not finite.
        charts: Charts that tracking and integration went through.
        endings: How runs ended that did not finish; empty if all did.
        seconds: Wall time.
    """

    seed: int
    n: int
    task: str
    skipped: int
    regularity: float
    condition: float
    identity: float
    null_space: float
    acceleration: float
    equivalence: float
    tracking: float
    self_motion: float
    hold: float
    anywhere: str
    unlimited: str
    fastest: float
    charts: int
    endings: str
    seconds: float

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of the figures that are not within their bounds."""
        exceeded = tuple(name for name, bound in BOUNDS.items() if not getattr(self, name) <= bound)
        lost = (n for n in ("anywhere", "unlimited") if getattr(self, n) not in ("finished", "degraded"))
        return exceeded + (("endings",) if self.endings else ()) + tuple(lost)


def examine(seed: int) -> Figures:
    """Make a robot and a task, and measure everything."""
    start = time.perf_counter()
    checks = importlib.import_module("checks")
    random = np.random.default_rng(seed)
    tasks = checks.every_task(checks.random_chain(seed))
    # A task that is nearly singular in all postures cannot be tracked to the last digit, and another one is drawn.
    kinds = random.permutation(sorted(tasks)).tolist()
    drawn = ((kind, _regular(tasks[kind], random)) for kind in kinds)
    kind, q = next((kind, q) for kind, q in drawn if regularity(tasks[kind], q) > REGULAR)
    task: Task = tasks[kind]
    identities = _identities(task, q, random)
    equivalence, one, other = _equivalence(task, q, random)
    tracked = _track(task, q, random)
    held = _hold(task, q, random)
    free, unlimited = _anywhere(tasks[random.choice(kinds)], random)
    runs = {"joint": one, "extended": other, "track": tracked, "hold": held}
    return Figures(
        seed=seed,
        n=task.robot.n,
        task=kind,
        skipped=kinds.index(kind),
        regularity=regularity(task, q),
        **identities,
        equivalence=equivalence,
        tracking=float(np.abs(tracked.error).max()),
        self_motion=float(np.abs(tracked.self_motion_error[tracked.chart == 0]).max(initial=0.0)),
        hold=float(max(np.abs(held.error[-1]).max(), np.abs(held.self_motion_error[-1]).max(initial=0.0))),
        anywhere=free.status,
        unlimited=unlimited.status if np.isfinite(unlimited.tau).all() else "not finite",
        fastest=float(np.abs(free.dq).max()) / SPEED if np.isfinite(free.tau).all() else np.inf,
        charts=2 + len(other.switches) + len(tracked.switches),
        endings="; ".join(
            f"{name} {result.status}: {result.message}"
            for name, result in runs.items()
            if not (result.ok or _beyond_bands(result))
        ),
        seconds=time.perf_counter() - start,
    )


def _beyond_bands(result: Result) -> bool:
    """Whether nothing but bands was passed: v that is given may lead out of them, as `EosController` keeps none."""
    return result.message.startswith("bands of the task were passed") and ". Also, " not in result.message


def _postures(task: Task, random: np.random.Generator, count: int) -> np.ndarray:
    """Random postures, (count, n)."""
    postures = random.uniform(-np.pi, np.pi, (count, task.robot.n))
    # A slider moves by lengths, not by turns.
    postures[:, [joint.kind == "prismatic" for joint in task.robot.joints]] *= 0.1
    return postures


def _regular(task: Task, random: np.random.Generator) -> np.ndarray:
    """The first of some random postures that is clear of singularities, or the one that is most so."""
    postures = _postures(task, random, 200)
    clear = (q for q in postures if regularity(task, q) > 1.25 * REGULAR)
    return next(clear, max(postures, key=lambda q: regularity(task, q)))


def _identities(task: Task, q: np.ndarray, random: np.random.Generator) -> dict[str, float]:
    """Eqs. (15)–(20) and (30) at a state away from the base of the chart, in units of rounding."""
    chart, robot = Chart.from_base(task, q), task.robot
    for size in (0.3, 0.1, 0.03, 0.01):
        near = q + size * random.normal(size=robot.n)
        if chart.margin(task.linearize(near)[1]) > 0.3 and regularity(task, near) > PASSABLE:
            break
    dq, tau, force = random.normal(size=robot.n), random.normal(size=robot.n), random.normal(size=task.m)
    dynamics = ExtendedDynamics.from_state(robot, chart, near, dq)
    point = dynamics.point
    H, J = point.H, point.task.J
    condition = float(np.linalg.cond(point.H_inverse))
    unit = ROUNDING * condition
    ddq = robot.forward_dynamics(near, dq, tau + J.T @ force)
    ddw = dynamics.acceleration(tau, force)
    return {
        "condition": condition,
        "identity": float(np.abs(H @ point.H_inverse - np.eye(robot.n)).max()) / unit,
        "null_space": float(np.abs(J @ point.D).max(initial=0.0)) / unit,
        "acceleration": float(np.abs(ddq - H @ ddw - point.E).max() / (unit * (np.abs(ddq).max() + np.abs(ddw).max()))),
    }


def _equivalence(task: Task, q: np.ndarray, random: np.random.Generator) -> tuple[float, Result, Result]:
    """The same torques and task force, integrated in joints and in w = (z, v)."""
    robot = task.robot
    dq = 0.3 * random.normal(size=robot.n)
    gravity, push = robot.gravity(q), 0.1 * random.normal(size=task.m)
    # Forces that bring accelerations of about one, whatever the inertia.
    effort = robot.mass(q) @ random.normal(size=robot.n)
    torque = OpenLoop(lambda t: gravity + np.cos(3.0 * t) * effort)
    force = TaskForce(task, lambda t: np.sin(5.0 * t) * push)
    options: dict[str, Any] = {"duration": 0.5, "rtol": 1e-11, "task_force": force, "record_rate": 20.0}
    one = simulate(robot, torque, q, dq, **options)
    other = simulate_extended(robot, torque, q, dq, atlas=Atlas(task), **options)
    rows = min(len(one.t), len(other.t))
    parts = ((one.q, other.q), (one.dq, other.dq))
    # Relative to the size of what is compared, where that is large.
    difference = max(float((np.abs(a[:rows] - b[:rows]) / np.maximum(1.0, np.abs(a[:rows]))).max()) for a, b in parts)
    return difference, one, other


def _track(task: Task, q: np.ndarray, random: np.random.Generator) -> Result:
    """From rest to rest along a straight line of the task's group, while v follows a sine."""
    z, r = task.value(q), task.robot.n - task.m
    scale = np.array([task.robot.reach if unit == "m" else 1.0 for unit in task.units])
    delta = 0.3 * scale * random.normal(size=task.m) / np.sqrt(task.m)
    swing, times = 0.1 * random.normal(size=(1, r)), np.linspace(0.0, 2.0, 21)
    for _ in range(8):
        path = Geodesic(task, np.array([z, task.plus(z, delta)]), times[[0, -1]])
        # At rest at the start: 1 − cos.
        v = Harmonic(swing[0], np.zeros((1, r)), -swing, 2.0)
        found = Atlas(task).follow(q, [path(t).z for t in times], v=np.array([v(t).z for t in times]))
        if found.complete and min(regularity(task, row) for row in found.q) > REGULAR:
            break
        delta, swing = 0.5 * delta, 0.5 * swing
    return simulate(task.robot, EosController(task, path, Track(v)), q, duration=2.0, rtol=1e-10)


def _hold(task: Task, q: np.ndarray, random: np.random.Generator) -> Result:
    """Hold a point and v from a displaced and moving start."""
    robot = task.robot
    controller = EosController(task, Hold(task.value(q), task.m), Track(np.zeros(robot.n - task.m)))
    displaced = q + 0.02 * random.normal(size=robot.n)
    return simulate(robot, controller, displaced, 0.1 * random.normal(size=robot.n), duration=2.0)


def _anywhere(task: Task, random: np.random.Generator) -> list[Result]:
    """To and fro along a line of the task's group that may lead through singularities and out of reach, twice.

    Returns:
        The run with a limit of speed, and the run without.
    """
    q, robot = _postures(task, random, 1)[0], task.robot
    z, scale = task.value(q), np.array([robot.reach if unit == "m" else 1.0 for unit in task.units])
    far = task.plus(z, scale * random.normal(size=task.m) / np.sqrt(task.m))
    path = Geodesic(task, np.array([z, far, z]), np.array([0.0, 0.75, 1.5]))
    limits = JointLimits.from_robot(robot, velocity=SPEED)
    # Without limits joints get so fast that they would go a tenth of a radian in a millisecond.
    controllers = (LimitedEosController(task, path, limits=limits), 1e-3), (EosController(task, path), 5e-4)
    return [
        simulate_sampled(robot, controller, q, duration=2.0, control_period=period)
        for controller, period in controllers
    ]


def random_chains(
    *,
    count: int = 1000,
    first: int = 0,
    jobs: int = 2,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> int:
    """Measure random robots and print the worst of each figure.

    Args:
        count: Number of robots.
        first: Seed of the first.
        jobs: Processes.
        json_file: File for all figures, machine-readable.
    """
    found: list[Figures] = []
    with Progress(console=stderr, transient=True) as progress:
        bar = progress.add_task("random chains", total=count)
        pool = Parallel(n_jobs=jobs, return_as="generator_unordered")
        for figures in pool(delayed(examine)(seed) for seed in range(first, first + count)):
            found.append(figures)
            progress.update(bar, advance=1)
    found.sort(key=lambda figures: figures.seed)
    rows = []
    for name, bound in BOUNDS.items():
        worst = max(found, key=lambda figures: getattr(figures, name))
        values = np.array([getattr(figures, name) for figures in found])
        percentile = float(np.percentile(values, 99))
        beyond = int((~(values <= bound)).sum())
        rows.append(
            (name, float(np.median(values)), percentile, float(getattr(worst, name)), bound, beyond, worst.seed)
        )
    columns = ("figure", "median", "99 %", "worst", "bound", "beyond", "worst seed")
    console.print(grid(f"{len(found)} random chains", columns, rows))
    for name in ("anywhere", "unlimited"):
        ends = Counter(getattr(figures, name) for figures in found)
        console.print(f"{name}: " + ", ".join(f"{number} {status}" for status, number in ends.most_common()))
    tasks = Counter(figures.task for figures in found)
    console.print("tasks: " + ", ".join(f"{number} {task}" for task, number in tasks.most_common()), soft_wrap=True)
    console.print(
        f"joints {min(f.n for f in found)} to {max(f.n for f in found)}, "
        f"condition numbers up to {max(f.condition for f in found):.3g}, up to {max(f.charts for f in found)} charts"
    )
    console.print(f"{sum(f.skipped for f in found)} tasks passed over: no posture is clear of their singularities")
    wrong = [figures for figures in found if figures.wrong]
    for figures in wrong:
        console.print(
            f"seed {figures.seed}, n = {figures.n}, {figures.task}: {', '.join(figures.wrong)}; regularity "
            f"{figures.regularity:.3g}, condition {figures.condition:.3g} {figures.endings}",
            markup=False,
            soft_wrap=True,
        )
    console.print(f"{len(wrong)} of {len(found)} beyond their bounds")
    if json_file is not None:
        write_json(json_file, {"bounds": BOUNDS, "robots": [asdict(figures) for figures in found]})
    return int(bool(wrong))


if __name__ == "__main__":
    assert set(BOUNDS) <= {field.name for field in fields(Figures)}
    sys.exit(run(random_chains))
