"""Pushes at the elbow and at the tool of an arm under impedance control, in MuJoCo at 1 kHz, beside projector laws.

Run it by `python benchmarks/impedance.py`; it prints one table for each question.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, TypeAlias, get_args

import numpy as np
from chains import cpu
from marked import HOME, fill, table

from eos_pin import (
    Atlas,
    ControlLoop,
    EosController,
    ImpedanceController,
    MujocoPlant,
    PoseTask,
    PositionTask,
    Robot,
    TaskForce,
    load_robot,
)
from eos_pin.charts.chart import Chart
from eos_pin.control.rivals.parts import Consistency
from eos_pin.control.rivals.projected import ProjectedImpedance

Impedance: TypeAlias = ImpedanceController | ProjectedImpedance
TOOL, ELBOW = "panda_hand_tcp", "panda_link4"
#: Stiffness of the tool [N/m, N m/rad] and of the elbow [N m/rad], and the push [N].
STIFFNESS, ELBOW_STIFFNESS, PUSH = {"m": 1000.0, "rad": 50.0}, 20.0, 20.0
#: Control period [s].
PERIOD = 1e-3
#: Time after which the arm is at rest [s].
SETTLED = 6.0
REST = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])


def postures(robot: Robot, task: PoseTask, count: int) -> Iterator[np.ndarray]:
    """Random postures well within the joint limits, and away from singularities."""
    random = np.random.default_rng(0)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.35 * (robot.upper - robot.lower)
    while count:
        q = middle + random.uniform(-1.0, 1.0, robot.n) * half
        if np.linalg.svd(task.linearize(q)[1], compute_uv=False)[-1] > 0.1:
            count -= 1
            yield q


def held(force: np.ndarray) -> Callable[[float], np.ndarray]:
    """A force that does not change."""
    return lambda t: force


def elbow_push(task: PoseTask, q: np.ndarray, push: float = PUSH) -> TaskForce:
    """Force on the elbow along its self-motion at q."""
    elbow = PositionTask(task.robot, ELBOW)
    chart = Chart.from_base(task, q)
    way = elbow.linearize(q)[1] @ chart.V[:, 0]
    force = push * way / np.linalg.norm(way)
    return TaskForce(elbow, held(force))


class Settled(NamedTuple):
    """An arm at rest under a push.

    Attributes:
        moved: Deviation of the tool, (m,) [m, rad].
        foreseen: K_z⁻¹(Hᵀτ_ext)_z there.
        v: Self-motion.
        force: (Hᵀτ_ext)_v.
        speed: Largest joint speed that is left.
    """

    moved: np.ndarray
    foreseen: np.ndarray
    v: np.ndarray
    force: np.ndarray
    speed: float


def settled(controller: Impedance, q: np.ndarray, force: TaskForce, duration: float = SETTLED) -> Settled:
    """The arm at rest under a force, in MuJoCo at 1 kHz."""
    task, plant, loop = controller.task, MujocoPlant.from_robot(controller.robot), ControlLoop(controller)
    begin, x, dx = q, q, np.zeros(q.size)
    for k in range(round(duration / PERIOD)):
        t = k * PERIOD
        x, dx = plant.advance(x, dx, loop.step(t, x, dx) + force.torque(t, x), PERIOD)
    # The chart that the law is on, where it has one.
    chart = controller.chart(loop.state) or Chart.from_base(task, begin)
    z, J = task.linearize(x)
    Q = np.linalg.solve(np.vstack((J, chart.Wt)).T, force.torque(duration, x))
    m, K = task.m, controller.gains.stiffness
    moved = task.minus(z, task.value(begin))
    return Settled(moved, np.linalg.solve(K, Q[:m]), chart.v(x), Q[m:], float(abs(dx).max()))


class ElbowForce(TaskForce):
    """Torques W f on the joints: a force on v alone."""

    def torque(self, t: float, q: np.ndarray) -> np.ndarray:
        return self.task.linearize(q)[1].T @ np.zeros(self.task.m) + self.force(t)


def elbow_stiffness(controller: Impedance, q: np.ndarray, push: float = 0.5) -> float:
    """Stiffness d(Wᵀτ)/dv of the elbow: twice a small force on v alone, over the way between both."""
    chart = controller.chart(controller.start(0.0, q, 0.0 * q)) or Chart.from_base(controller.task, q)
    W = chart.W[:, 0]
    ends = [settled(controller, q, ElbowForce(controller.task, held(s * push * W))) for s in (1.0, -1.0)]
    return 2.0 * push / float(ends[0].v[0] - ends[1].v[0])


def laws(task: PoseTask, q: np.ndarray) -> dict[str, Impedance]:
    """The laws with the same stiffness of the tool; at q all have the same stiffness along the self-motion."""
    hold = task.hold(q)
    found: dict[str, Impedance] = {
        "impedance in (z, v)": ImpedanceController(
            task, hold, stiffness=STIFFNESS, self_motion_stiffness=ELBOW_STIFFNESS, damping_ratio=0.7
        )
    }
    found["the same, inertial charts"] = ImpedanceController(
        task, hold, stiffness=STIFFNESS, self_motion_stiffness=ELBOW_STIFFNESS, atlas=Atlas(task, metric="inertial")
    )
    # Stiffer near the base, as arms are; scaled to the stiffness of the elbow along the self-motion at q.
    shape = np.array([1.5, 1.5, 1.5, 1.5, 0.5, 0.5, 0.5])
    way = Chart.from_base(task, q).V[:, 0]
    K_q = shape * ELBOW_STIFFNESS / (way @ (shape * way))
    for name in get_args(Consistency):
        found[f"{name} projector"] = ProjectedImpedance(
            task, hold, q, consistency=name, stiffness=STIFFNESS, joint_stiffness=K_q
        )
    return found


def steps(robot: Robot, rounds: int) -> list[list[str]]:
    """Time of a step of a loop in slow motion, beside that of `EosController`; rounds in which both take turns."""
    random = np.random.default_rng(0)
    way = np.cumsum(2e-4 * random.normal(size=(200, robot.n)), axis=0)
    rows = []
    for task in (PositionTask(robot, TOOL), PoseTask(robot, TOOL)):
        hold = task.hold(REST)
        loops = ControlLoop(EosController(task, hold)), ControlLoop(ImpedanceController(task, hold))

        def walk(loop: ControlLoop) -> None:
            for away in way:
                loop.step(0.0, REST + away, away)

        found = np.array([[cpu(partial(walk, loop), 0.02) / len(way) for loop in loops] for _ in range(rounds)])
        ratios = found[:, 1] / found[:, 0]
        eos, soft = 1e6 * np.median(found, axis=0)
        print(
            f"{type(task).__name__:14} EOS {eos:6.2f} µs, impedance {soft:6.2f} µs, ratio {np.median(ratios):.2f} "
            f"(90 % below {np.quantile(ratios, 0.9):.2f})"
        )
        kind = type(task).__name__.removesuffix("Task").lower()
        rows.append([kind, f"{eos:.3g}", f"{soft:.3g}", f"{np.median(ratios):.2f}"])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--postures", type=int, default=5)
    parser.add_argument("--steps", type=int, default=0, help="only time steps, in so many rounds")
    parser.add_argument("--write", action="store_true", help="write the times into docs/impedance.md")
    arguments = parser.parse_args()
    robot = load_robot("panda", chain_to=TOOL)
    if arguments.steps:
        rows = steps(robot, arguments.steps)
        if arguments.write:
            columns = ("task of Panda", "EOS [µs]", "impedance [µs]", "ratio")
            fill(HOME / "docs" / "impedance.md", "steps", "\n" + table(columns, rows))
        return
    task = PoseTask(robot, TOOL)
    chosen = [REST, *postures(robot, task, arguments.postures - 1)]
    print(f"A push of {PUSH:g} N at {ELBOW} along its self-motion, the tool held by {STIFFNESS}, MuJoCo at 1 kHz")
    print(f"{'posture':8}{'law':26}{'tool [mm]':>11}{'[mrad]':>9}{'off K⁻¹Q':>10}{'elbow [N m/rad]':>17}{'set':>7}")
    for k, q in enumerate(chosen):
        for name, law in laws(task, q).items():
            at = settled(law, q, elbow_push(task, q))
            off = np.abs(at.moved - at.foreseen).max() / np.abs(at.moved).max()
            stiffness = elbow_stiffness(law, q)
            print(
                f"{k:<8}{name:26}{1e3 * np.linalg.norm(at.moved[:3]):11.3f}{1e3 * np.linalg.norm(at.moved[3:]):9.2f}"
                f"{off:10.2%}{stiffness:17.4f}{ELBOW_STIFFNESS:7g}"
            )
    print(f"\nA push of {PUSH:g} N at the tool along x, y, z: stiffness of the task [N/m] (set: {STIFFNESS['m']:g})")
    for k, q in enumerate(chosen):
        for name, law in laws(task, q).items():
            found = []
            for force in PUSH * np.eye(6)[:3]:
                at = settled(law, q, TaskForce(task, held(force)))
                found.append(PUSH / float(at.moved @ force / PUSH))
            print(f"{k:<8}{name:26}" + "".join(f"{value:11.2f}" for value in found))


if __name__ == "__main__":
    main()
