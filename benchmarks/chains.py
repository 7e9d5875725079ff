"""Planar chains of 10 to 1,000 joints: how the time for a control step, a chart and inverse kinematics grows with n.

    python benchmarks/chains.py [--joints N ...] [--rounds N] [--json FILE]

Every chain is 2 m long, weighs 2 kg and lies along the same arc, so that the task is the same one for all n; the task
is the position of its tip. Before anything is timed, the torque is checked by forward dynamics, and joints found by
their task point. Times are CPU time of one thread, medians of rounds that take turns over the chains.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
import tyro
from rich.progress import track

from eos_pin import Chart, ControlLoop, EosController, Hold, PositionTask, Robot
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.control._regularize import AccelerationMap
from eos_pin.control.state import EosState

#: Length [m] and mass [kg] of each chain, and the angle its arc turns through [rad].
LENGTH, MASS, ARC = 2.0, 2.0, 1.5 * math.pi
#: What is timed: name → what one repetition is.
MEASURED = {
    "step": "`ControlLoop.step` of an `EosController`, on its first chart",
    "step later": "the same after 100 charts",
    "chart": "`Chart.from_base`",
    "next chart": "`Chart.from_base(previous=)`, mean of 100 charts along two rounds of a figure eight",
    "IK 0.1 m": "`Chart.inverse` from 0.1 m away to 1e-10 m",
    "IK 1 mm": "the same from 1 mm away, B kept",
}
#: The fit is over these; the fixed cost of a call outweighs the rest below.
LARGE = 100
#: Largest exponent of n that is called linear.
LINEAR = 1.1


def chain(n: int) -> Robot:
    """Planar chain of n equal rods, in the plane of gravity."""
    model, joint, link = pin.Model(), 0, LENGTH / n
    model.name, model.gravity = f"chain_{n}", pin.Motion(np.array([0.0, -9.81, 0.0]), np.zeros(3))
    rod = pin.Inertia.FromBox(MASS / n, link, 0.02, 0.02)
    for i in range(n):
        placement = pin.SE3(np.eye(3), np.array([link if i else 0.0, 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRZ(), placement, f"joint_{i + 1}")
        model.appendBodyToJoint(joint, rod, pin.SE3(np.eye(3), np.array([link / 2.0, 0.0, 0.0])))
    tip = pin.SE3(np.eye(3), np.array([link, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(n, -np.inf), np.full(n, np.inf)
    return Robot(model)


class Bench:
    """A chain with everything that is timed on it."""

    def __init__(self, n: int) -> None:
        random = np.random.default_rng(n)
        self.robot = chain(n)
        self.task = task = PositionTask(self.robot, "tip", "xy")
        self.q = np.full(n, ARC / n)
        self.chart = Chart.from_base(task, self.q)
        self.dq = random.normal(size=n) / n
        self.state = self.q + 0.01 * random.normal(size=n) / math.sqrt(n), self.dq
        self.controller = EosController(task, Hold(self.chart.z_bar), smooth=False)
        turn = np.linspace(0.0, 4.0 * math.pi, 101)[1:]
        eight = self.chart.z_bar + np.column_stack((0.3 * np.sin(turn), 0.15 * np.sin(2.0 * turn)))
        self.path = [self.chart.inverse(z, self.chart.v_bar).q for z in eight]
        self.later = self.along(self.path)
        self.check()

    def along(self, path: list[np.ndarray]) -> Chart:
        """Chart after chart, each at the next configuration."""
        chart = self.chart
        for q in path:
            chart = Chart.from_base(self.task, q, previous=chart)
        return chart

    def loop(self, before: Chart | None = None) -> Callable[[], Any]:
        """A control loop on its first chart, or on the one that follows `before`."""
        loop = ControlLoop(self.controller)
        loop.step(0.0, *self.state)
        if before is not None:
            loop.state = self.controller.update(0.0, *self.state, EosState(AccelerationMap(before)))
        return lambda: loop.step(0.0, *self.state)

    def inverse(self, distance: float, *, refresh: bool) -> Callable[[], Any]:
        """Inverse kinematics from a distance away, at the same self-motion coordinates."""
        z = self.chart.z_bar + distance * np.array([0.6, 0.8])
        return lambda: self.chart.inverse(z, self.chart.v_bar, refresh=refresh)

    def timed(self) -> dict[str, tuple[Callable[[], Any], int]]:
        """What is timed, and how many of it one call does."""
        return {
            "step": (self.loop(), 1),
            "step later": (self.loop(self.later), 1),
            "chart": (lambda: Chart.from_base(self.task, self.q), 1),
            "next chart": (lambda: self.along(self.path), len(self.path)),
            "IK 0.1 m": (self.inverse(0.1, refresh=True), 1),
            "IK 1 mm": (self.inverse(1e-3, refresh=False), 1),
        }

    def check(self) -> None:
        """Task and self-motion accelerate as the law says, by forward dynamics; the joints found have (z, v)."""
        q, dq = self.state
        point, first = self.task.at(q, dq), Chart.from_base(self.task, q)
        for before, chart in ((None, first), (self.later, Chart.from_base(self.task, q, previous=self.later))):
            ddq = self.robot.forward_dynamics(q, dq, self.loop(before)())
            pull = 100.0 * (self.chart.z_bar - point.z) - 20.0 * point.dz
            np.testing.assert_allclose(point.J @ ddq + point.drift, pull, atol=1e-7)
            np.testing.assert_allclose(chart.dv(ddq), -100.0 * chart.v(q) - 20.0 * chart.dv(dq), atol=1e-7)
        for distance, refresh in ((0.1, True), (1e-3, False)):
            found = self.inverse(distance, refresh=refresh)()
            there = self.chart.z_bar + distance * np.array([0.6, 0.8])
            np.testing.assert_allclose(self.task.value(found.q), there, atol=1e-10)
            np.testing.assert_allclose(self.chart.v(found.q), 0.0, atol=1e-12)


def cpu(call: Callable[[], Any], at_least: float = 0.01) -> float:
    """CPU time of one call [s], from as many as take `at_least` seconds."""
    count, spent = 1, 0.0
    while True:
        start = time.process_time()
        for _ in range(count):
            call()
        spent = time.process_time() - start
        if spent >= at_least:
            return spent / count
        count *= 4


def exponent(joints: list[int], microseconds: list[float]) -> float:
    """Slope of log time over log n, from `LARGE` joints on."""
    large = [(math.log(n), math.log(t)) for n, t in zip(joints, microseconds, strict=True) if n >= LARGE]
    if len(large) < 2:
        return math.nan
    x, y = np.transpose(large)
    return float(np.polyfit(x, y, 1)[0])


def chains(
    *,
    joints: tuple[int, ...] = (10, 30, 100, 300, 1000),
    rounds: int = 15,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> int:
    """Time control steps, charts and inverse kinematics of planar chains.

    Args:
        joints: How many joints the chains have.
        rounds: Rounds over all chains; the median counts.
        json_file: File for all figures, machine-readable.
    """
    benches = {n: Bench(n).timed() for n in joints}
    times: dict[int, dict[str, list[float]]] = {n: {name: [] for name in MEASURED} for n in joints}
    for _ in track(range(rounds), description="chains", console=stderr, transient=True):
        for n, timed in benches.items():
            for name, (call, repetitions) in timed.items():
                times[n][name].append(cpu(call) / repetitions)
    medians = {n: {name: 1e6 * median(values) for name, values in row.items()} for n, row in times.items()}
    exponents = {name: exponent(list(joints), [medians[n][name] for n in joints]) for name in MEASURED}
    rows: list[tuple[Any, ...]] = [(n, *row.values()) for n, row in medians.items()]
    rows.append((f"exponent from {LARGE} on", *exponents.values()))
    console.print(grid("Planar chains, µs", ("n", *MEASURED), rows))
    for name, what in MEASURED.items():
        console.print(f"{name}: {what}", soft_wrap=True, markup=False)
    if json_file is not None:
        write_json(json_file, {"microseconds": medians, "exponents": exponents, "rounds": rounds})
    return int(any(value > LINEAR for value in exponents.values()))


if __name__ == "__main__":
    sys.exit(run(chains))
