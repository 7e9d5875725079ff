"""Energy of random runs under impedance control: pushes, a wall, changes of charts and modes, in MuJoCo.

    python benchmarks/passivity.py [--runs N] [--limits] [--write]

A run is passive where the work of external torques is at least the change of kinetic, spring and tank energy. A torque
that is held for a period is late by half of it, so that a run may gain c h; the table has c for several periods. With
--limits the runs have observer, filter, friction, joint limits, designed inertias, singular starts, and limits of
torques and their rates instead, and all that is counted is whether everything stays finite and within them. With
--write the table goes into docs/impedance.md, of which the site draws the energy against the period.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from marked import HOME, fill, table

from eos_pin import ControlLoop, Friction, ImpedanceController, MujocoPlant, PoseTask, PositionTask, Robot, load_robot
from eos_pin.control.compliant.safety import Safety

TOOL = "panda_hand_tcp"
#: Length of a run [s], stiffness of the wall [N/m], largest change of a torque [N m/s].
DURATION, WALL, RATE = 0.5, 3000.0, 2000.0
PERIODS = (2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3)
#: Document that --write writes a table into.
DOCUMENT = HOME / "docs" / "impedance.md"
#: Least energy that counts as gained: the error of the plant's integrator is below it [J].
GAINED = 1e-4
#: Parts of the runs that gain less than the energies of the table.
PARTS = (0.95, 0.99)
#: Every so many steps the energy is looked at.
LOOK = 5


class Outcome(NamedTuple):
    """A run.

    Attributes:
        gained: Largest rise, from any time to any later one, of the energy less the work of external torques [J].
        tank: Least energy in the tank [J].
        touched: Whether the wall was touched.
        charts: Number of changes of charts.
        within: Whether all was finite, and torques within their limits and rates.
        moved: Work of external torques, in magnitude [J].
    """

    gained: float
    tank: float
    touched: bool
    charts: int
    within: bool
    moved: float

    @property
    def stable(self) -> bool:
        """Whether everything stayed finite."""
        return bool(np.isfinite(self.gained))


def modes(first: ImpedanceController, random: np.random.Generator) -> ImpedanceController:
    """A mode at random."""
    m, r = first.task.m, first.robot.n - first.task.m
    kind = random.integers(4)
    if kind == 0:
        return first.led("elbow")
    if kind == 1:
        return first.led("tool")
    scale = 10.0 ** random.uniform(-1.0, 0.5)
    units = np.array([1000.0 if unit == "m" else 50.0 for unit in first.task.units])
    X = random.normal(size=(m, m))
    K = scale * np.sqrt(units)[:, None] * (np.eye(m) + 0.1 * (X @ X.T)) * np.sqrt(units)
    return first.with_mode(
        stiffness=K,
        self_motion_stiffness=10.0 ** random.uniform(0.3, 2.0, r),
        damping_ratio=10.0 ** random.uniform(-2.0, 0.1),
        posture=None if kind == 2 else "here",
        reference=first.reference if kind == 2 else "here",
    )


def posture(robot: Robot, random: np.random.Generator, singular: bool) -> np.ndarray:
    """Joints at random; stretched out where they are to be singular."""
    middle, half = 0.5 * (robot.lower + robot.upper), 0.4 * (robot.upper - robot.lower)
    q = middle + random.uniform(-1.0, 1.0, robot.n) * half
    if singular:
        q[3], q[5] = -0.08, 0.02 + 0.01 * random.random()
    return q


def run(robot: Robot, seed: int, period: float, limits: bool) -> Outcome:
    """One run; everything about it but the period comes from the seed."""
    random = np.random.default_rng(seed)
    task = (PositionTask if seed % 2 else PoseTask)(robot, TOOL)
    q = posture(robot, random, limits and seed % 3 == 0)
    dq = 0.3 * random.normal(size=robot.n)
    additions: dict[str, Any] = {}
    if limits:
        friction = Friction(viscous=0.5, coulomb=0.3)
        safety = Safety(velocity_cutoff=60.0, friction=friction, limit_stiffness=50.0, yielding=True)
        additions = {"safety": safety, "observer": 30.0, "compensate_external": seed % 4 == 0}
        if seed % 4 and seed % 5 == 1:
            scale = 10.0 ** random.uniform(-0.5, 1.0)
            additions["inertia"] = {unit: scale * (4.0 if unit == "m" else 0.1) for unit in task.units}
    first = ImpedanceController(task, task.hold(q), tank=0.2, blend=0.1, **additions)
    plant = MujocoPlant.from_robot(robot)
    loop = ControlLoop(first, torque_limits=limits, torque_rate=RATE if limits else None, jump=1.0)
    point = PositionTask(robot, TOOL)
    # A wall through a point near the tool, and three pushes.
    normal = random.normal(size=3)
    normal /= np.linalg.norm(normal)
    edge = normal @ point.value(q) - 0.05 * random.random()
    pushes = [(random.uniform(0.0, 0.4), 0.15 * robot.effort * random.normal(size=robot.n)) for _ in range(3)]
    changes = sorted(random.uniform(0.05, 0.4, 3))
    least, work, moved, gained, tank = np.inf, 0.0, 0.0, 0.0, np.inf
    last, touched, within = None, False, True
    for k in range(round(DURATION / period)):
        t = k * period
        if changes and t >= changes[0]:
            changes.pop(0)
            loop.controller = modes(first, random)
        tau = loop.step(t, q, dq)
        z, J = point.linearize(q)
        depth = edge - normal @ z
        touched |= depth > 0.0
        external = J.T @ (WALL * max(depth, 0.0) * normal)
        for when, push in pushes:
            external = external + push * (when <= t < when + 0.05)
        if limits:
            within &= bool(np.isfinite(tau).all() and (np.abs(tau) <= robot.effort * (1.0 + 1e-9)).all())
            within &= last is None or bool(np.abs(tau - last).max() <= RATE * period * (1.0 + 1e-9))
        elif k % LOOK == 0:
            mode: Any = loop.controller
            found = mode.energies(t, q, dq, loop.state)
            energy = found.kinetic + found.springs + found.tank
            # From any earlier time on.
            least = min(least, energy - work)
            gained = max(gained, energy - work - least)
        tank = min(tank, loop.state.tank)
        before, last = q, tau
        q, dq = plant.advance(q, dq, tau + external, period)
        if not (np.isfinite(q).all() and np.isfinite(dq).all()):
            return Outcome(np.inf, tank, touched, loop.state.number, False, moved)
        work += external @ (q - before)
        moved += abs(external @ (q - before))
    return Outcome(gained, tank, touched, loop.state.number, within, moved)


def line(period: float, found: Sequence[Outcome]) -> list[str]:
    """Row of the table for a period."""
    stable = [one for one in found if one.stable]
    gained = np.array([one.gained for one in stable])
    most = float(gained.max())
    numbers = [str(len(found)), str(sum(one.touched for one in found)), str(sum(one.charts for one in found))]
    part = most / stable[int(gained.argmax())].moved
    numbers += [
        str(len(found) - len(stable)),
        str(int((gained > GAINED).sum())),
        *(f"{np.quantile(gained, part):.3g}" for part in PARTS),
        f"{most:.3g}",
        f"{part:.1%}",
        f"{most / period:.0f}",
    ]
    return [f"{1e3 * period:g}", *numbers, f"{min(one.tank for one in found):.3g}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--others", type=int, default=200, help="runs with each of the other periods")
    parser.add_argument("--limits", action="store_true")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    robot = load_robot("panda", chain_to=TOOL)
    if arguments.limits:
        outcomes = [run(robot, seed, 1e-3, True) for seed in range(arguments.runs)]
        good, least = sum(one.within for one in outcomes), min(one.tank for one in outcomes)
        told = (
            f"{good:,} of {len(outcomes):,} runs were finite and within the limits, the tank never below {least:.3g} J"
        )
        print(told)
        if arguments.write:
            fill(DOCUMENT, "limits", f" {told}. ")
        return
    counts = "runs", "with contact", "chart changes", "unstable", f"gain > {GAINED:g} J"
    parts = (f"{part:.0%} gain less than [J]" for part in PARTS)
    columns = ("h [ms]", *counts, *parts, "most [J]", "of work", "c [W]", "least tank [J]")
    print(" | ".join(columns))
    found: dict[float, Sequence[Outcome]] = {}
    for period in PERIODS:
        count = arguments.runs if period == 1e-3 else min(arguments.others, arguments.runs)
        found[period] = [run(robot, seed, period, False) for seed in range(count)]
        print(" | ".join(line(period, found[period])), flush=True)
    if arguments.write:
        fill(DOCUMENT, "energy", "\n" + table(columns, [line(*item) for item in found.items()]))


if __name__ == "__main__":
    main()
