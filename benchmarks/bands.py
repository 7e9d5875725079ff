"""Bands of tasks with tolerances in random runs with tight limits of joints, judged by linear programs of their own.

Used by `kinematic_loop.py bands`. Each run has a random task, path, law and limits; in half of the runs the reference
jumps. Of every command beyond a band it is asked whether another one within the limits would have kept the condition of
the band better (`Instant`), and of every time that a band is left whether any commands from 0.6 s before on, or from
the jump on, would have kept all bands, had the path been known beforehand (`foresight`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse
from scipy.optimize import linprog

from eos_pin import (
    Damp,
    JointLimits,
    KinematicLoop,
    Objective,
    PointAxisTask,
    PoseTask,
    PositionTask,
    Posture,
    SingularError,
    ToleranceTask,
    Track,
    load_robot,
)
from eos_pin._arrays import Array, JointVector, Vector
from eos_pin.experiments.defaults import rest_posture
from eos_pin.robot.loading import default_frame
from eos_pin.robot.model import Robot
from eos_pin.trajectories.base import Trajectory
from eos_pin.trajectories.through import waypoint_path

ROBOTS = ("ur5", "panda", "kinova", "xarm7")
#: Length of a run, time of the judged commands before a band is left, and after it [s]; period of these commands [s].
DURATION, BEFORE, AFTER, COARSE = 2.0, 0.6, 0.3, 0.016
#: As documented: rate at which the edge of a band is approached [1/s], its part that is left alone, and part of the
#: deceleration that counts.
RATE, ROOM, BRAKING = 20.0, 1e-3, 0.5
#: Part of a band by which it counts as passed, and by which another command counts as better.
PASSED, BETTER = 1e-6, 1e-3
#: Corrections of the linear programs for curved bands, and how far joints move in the first one [rad or m].
STEPS, FAR = 6, 0.3
#: Step of differences [rad or m].
SMALL = 1e-6
#: Verdicts of times that a band was left.
JUMP, EXCLUDED, FORESEEN = "jump", "excluded", "foreseen"


@dataclass(frozen=True, eq=False)
class Case:
    """A random setting; `jumped` is the reference from the time `jump` on."""

    task: ToleranceTask
    start: JointVector
    path: Trajectory
    jumped: Trajectory
    jump: float
    law: Objective
    limits: JointLimits
    period: float

    @classmethod
    def drawn(cls, robot: Robot, seed: int) -> Case:
        """The setting of a seed."""
        random, frame = np.random.default_rng(seed), default_frame(robot)
        whole = (PoseTask, PointAxisTask, PositionTask)[random.choice(3, p=(0.6, 0.25, 0.15))](robot, frame)
        task = ToleranceTask(whole, drawn_bands(random, type(whole), whole.m))
        rest = rest_posture(whole)
        start = np.clip(rest + random.uniform(-0.4, 0.4, robot.n), robot.lower + 0.05, robot.upper - 0.05)
        z, size = task.value(start), np.array([0.1] * 3 + [0.4] * (whole.m - 3))
        gaps = random.uniform(0.2, 1.0) * random.normal(size=(5, whole.m)) * size
        # The path begins slowly, and in a third of the runs it rests.
        gaps[:2] = 0.0
        gaps *= random.random() < 2.0 / 3.0
        shift = random.uniform(0.0, 0.35) * random.normal(size=whole.m) * size
        times = np.linspace(0.0, DURATION + 0.1, len(gaps))
        path, jumped = (
            waypoint_path(task, [whole.plus(z, gap + more) for gap in gaps], times) for more in (0.0 * shift, shift)
        )
        tight = np.where(np.isfinite(robot.velocity), robot.velocity, 1.0) * random.uniform(0.2, 1.0)
        limits = JointLimits.without_torques(
            robot, velocity=tight, acceleration=random.uniform(2.0, 20.0) * random.uniform(0.5, 1.0, robot.n)
        )
        if random.random() < 0.5:
            lower, upper = (start + side * random.uniform(0.1, 0.8, robot.n) for side in (-1.0, 1.0))
            limits = replace(limits, lower=np.maximum(robot.lower, lower), upper=np.minimum(robot.upper, upper))
        law = (Track(), Posture(start + random.uniform(-0.5, 0.5, robot.n)), Damp())[random.integers(3)]
        jump = float(random.uniform(0.3, 1.2)) if random.random() < 0.5 else math.inf
        return cls(task, start, path, jumped, jump, law, limits, float(random.choice((0.002, 0.004, 0.008))))

    def reference(self, t: float) -> Trajectory:
        """The reference that counts from time t on."""
        return self.path if t < self.jump else self.jumped


def drawn_bands(random: np.random.Generator, kind: type, m: int) -> dict[str, float]:
    """Random bands that leave something to be tracked."""
    while True:
        widths = {name: float(random.uniform(0.005, 0.05)) for name in "xyz" if random.random() < 0.4}
        turn = ("rx", "ry", "rz", "")[random.integers(4)]
        if kind is PoseTask and turn:
            widths[turn] = float(random.uniform(0.03, 0.4))
        if (kind is PointAxisTask or turn in widths) and random.random() < 0.4:
            widths["cone"] = float(random.uniform(0.03, 0.4))
        if widths and len(widths) < m - 1:
            return widths


@dataclass(frozen=True, eq=False)
class Trace:
    """Joints, velocities and parts of the bands after each command; the first row is the start."""

    q: Float[Array, "K n"]
    dq: Float[Array, "K n"]
    used: Float[Array, "K B"]
    limited: Bool[Array, " K"]

    @classmethod
    def of(cls, case: Case) -> Trace:
        """Run of a `KinematicLoop`."""
        loop = KinematicLoop(case.task, case.path, case.law, control_period=case.period, limits=case.limits)
        rows = [(case.start, 0.0 * case.start, parts(case.task, case.start[None], case.path(0.0).z)[0], False)]
        for k in range(round(DURATION / case.period)):
            t = k * case.period
            if case.reference(t) is not loop.reference:
                loop.reference = case.reference(t)
            q, dq = loop.step(t, rows[-1][0])
            used = parts(case.task, q[None], loop.reference(t + case.period).z)[0]
            rows.append((q, dq, used, loop.limited))
        return cls(*map(np.array, zip(*rows, strict=True)))


def parts(task: ToleranceTask, q: Float[Array, "K n"], targets: Array) -> Float[Array, "K B"]:
    """Part of each band that joints use."""
    used: Float[Array, "K B"] = np.linalg.norm(vectors(task, q, targets), axis=2)
    return used


def vectors(task: ToleranceTask, q: Float[Array, "K n"], targets: Array) -> Float[Array, "K B 2"]:
    return task.used(task.whole.kinematics.value(q), np.atleast_2d(targets))


def slopes(task: ToleranceTask, q: Float[Array, "K n"], targets: Array) -> Float[Array, "K B 2 n"]:
    """Derivatives of `vectors` by the joints."""
    sides = SMALL * np.eye(q.shape[1])
    return np.stack([vectors(task, q + x, targets) - vectors(task, q - x, targets) for x in sides], axis=3) / (
        2.0 * SMALL
    )


# -- single commands -------------------------------------------------------------------------------------------------


def box(limits: JointLimits, q: JointVector, u: JointVector, h: float) -> tuple[JointVector, JointVector]:
    """Least and largest velocity of the next period, from which joints can still brake before their ends."""

    def most(q: JointVector, u: JointVector, ends: JointVector) -> JointVector:
        low, high = u - h * limits.acceleration, np.minimum(u + h * limits.acceleration, limits.velocity)
        for _ in range(60):
            middle = 0.5 * (low + high)
            speed = np.maximum(middle, 0.0)
            k = np.floor(speed / (h * limits.braking))
            way = h * (k + 1.0) * speed - 0.5 * h * h * limits.braking * k * (k + 1.0)
            fits = q + way <= ends
            low, high = np.where(fits, middle, low), np.where(fits, high, middle)
        return low

    return -most(-q, -u, -limits.lower), most(q, u, limits.upper)


def condition(case: Case, trace: Trace, k: int, low: JointVector, high: JointVector) -> Vector:
    """Largest part of each band that command k may use, as documented."""
    h, t = case.period, (k - 1) * case.period
    path, q, u = case.reference(t), trace.q[k - 1], trace.dq[k - 1]
    now = parts(case.task, q[None], path(t).z)[0] / (1.0 - ROOM)
    ahead = (q + h * u)[None]
    x, X = vectors(case.task, ahead, path(t + h).z)[0], slopes(case.task, ahead, path(t + h).z)[0]
    S = np.einsum("bi,bin->bn", x / np.maximum(np.linalg.norm(x, axis=1), 1e-9)[:, None], X) / (1.0 - ROOM)
    b = BRAKING * np.maximum(np.maximum(S * (u - low), S * (u - high)).sum(axis=1) / h, 1e-9)
    d, c = 1.0 - now, b / RATE
    growth = h * np.sign(d) * (np.sqrt(2.0 * b * np.abs(d) + c * c) - c)
    return (now + np.where(d > 0.0, np.minimum(growth, d), growth)) * (1.0 - ROOM)


def better(case: Case, trace: Trace, k: int) -> float:
    """By how much another command would lack less of the condition in one band, and no more in another one."""
    h, t, q = case.period, (k - 1) * case.period, trace.q[k]
    low, high = box(case.limits, trace.q[k - 1], trace.dq[k - 1], h)
    most, target = condition(case, trace, k, low, high), case.reference(t)(t + h).z
    lack = best = np.maximum(trace.used[k] - most, 0.0)
    if lack.max() <= BETTER:
        return 0.0
    for _ in range(STEPS):
        x, X = vectors(case.task, q[None], target)[0], slopes(case.task, q[None], target)[0]
        r = np.linalg.norm(x, axis=1)
        S, count = np.einsum("bi,bin->bn", x / np.maximum(r, 1e-9)[:, None], X), len(r)
        found = linprog(
            np.concatenate((0.0 * q, np.ones(count))),
            A_ub=np.hstack((S, -np.eye(count))), b_ub=most - r + S @ q,
            bounds=[*zip(trace.q[k - 1] + h * low, trace.q[k - 1] + h * high, strict=True), *((0.0, x) for x in lack)],
        )  # fmt: skip
        if found.x is None:
            break
        q = found.x[: q.size]
        now = np.maximum(parts(case.task, q[None], target)[0] - most, 0.0)
        if (now <= lack + 1e-9).all() and now.sum() < best.sum():
            best = now
    return float((lack - best).sum())


# -- all commands of a while -----------------------------------------------------------------------------------------


def foresight(case: Case, q: JointVector, u: JointVector, targets: Float[Array, "N size"], guess: Array) -> float:
    """Least part that bands must use at the worst instant, whatever commands are given from a state on.

    Linear programs about the motion found before, so that the least found may not be the least of all.

    Args:
        case: The setting.
        q: Joints.
        u: Their velocities.
        targets: Targets at the ends of N equal periods.
        guess: Joints there that are possible, (N, n).
    """
    task, limits, (N, n) = case.task, case.limits, guess.shape
    h = round(COARSE / case.period) * case.period
    ways = sparse.kron(sparse.csr_matrix(h * np.tri(N)), sparse.eye(n), format="csr")
    changes = sparse.eye(N * n) - sparse.kron(sparse.eye(N, k=-1), sparse.eye(n))
    first, most = np.concatenate((u, np.zeros((N - 1) * n))), np.tile(h * limits.acceleration, N)
    ends = [np.tile(np.clip(x - q, -1e3, 1e3), N) for x in (limits.upper, limits.lower)]
    speed, trust, Q = np.tile(limits.velocity, N), FAR, guess
    least = float(parts(task, Q, targets).max())
    kept, plain = sparse.vstack((changes, -changes, ways, -ways)), np.zeros((N * n, 1))
    for _ in range(STEPS):
        x, X = vectors(task, Q, targets), slopes(task, Q, targets)
        # A cone is a polygon here, with a corner where the motion is.
        sides = [np.broadcast_to(side, x.shape) for side in np.vstack((np.eye(2), -np.eye(2)))]
        rows, bounds = [], []
        for side in (*sides, x / np.maximum(np.linalg.norm(x, axis=2), 1e-9)[:, :, None]):
            S = np.einsum("kbi,kbin->kbn", side, X)
            rows.append(sparse.block_diag(list(S), format="csr"))
            bounds.append((np.einsum("kbn,kn->kb", S, Q - q) - (side * x).sum(axis=2)).ravel())
        G, moved = sparse.vstack(rows) @ ways, (Q - q).ravel()
        A = sparse.vstack((
            sparse.hstack((kept, np.zeros((kept.shape[0], 1)))), sparse.hstack((G, -np.ones((G.shape[0], 1)))),
            sparse.hstack((ways, plain)), sparse.hstack((-ways, plain)),
        )).tocsr()  # fmt: skip
        b = np.concatenate((most + first, most - first, ends[0], -ends[1], *bounds, moved + trust, trust - moved))
        found = linprog(
            np.append(np.zeros(N * n), 1.0), A_ub=A, b_ub=b, method="highs-ipm",
            bounds=[*zip(-speed, speed, strict=True), (0.0, None)],
        )  # fmt: skip
        joints = Q if found.x is None else q + (ways @ found.x[:-1]).reshape(N, n)
        now = float(parts(task, joints, targets).max())
        if now >= least - BETTER:
            trust *= 0.3
        if now < least:
            least, Q = now, joints
        if least <= 1.0:
            break
    return least


def judged(case: Case, trace: Trace, k: int) -> dict[str, Any]:
    """Why a band was left with command k."""
    h, beyond = case.period, trace.used.max(axis=1) > 1.0 + PASSED
    end = next((j for j in range(k, len(beyond)) if not beyond[j]), len(beyond))
    found: dict[str, Any] = {"command": k, "worst": float(trace.used[k:end].max())}
    jump = math.ceil(case.jump / h - 1e-9) if case.jump < DURATION else -1
    begin = max(0, k - round(BEFORE / h), jump if k > jump else 0)
    if k - 1 == jump and parts(case.task, trace.q[[jump]], case.jumped(jump * h).z).max() > 1.0:
        return found | {"verdict": JUMP, "least": None}
    # From after the time before that a band was left.
    begin = max((j + 1 for j in range(begin, k) if beyond[j]), default=begin)
    stride = round(COARSE / h)
    rows = np.arange(begin + stride, min(len(beyond) - 1, k + round(AFTER / h)) + 1, stride)
    if not (rows >= k).any():
        rows = np.append(rows, begin + stride * (len(rows) + 1))
        rows = rows[rows < len(beyond)]
    targets = np.array([case.reference((row - 1) * h)(row * h).z for row in rows])
    least = foresight(case, trace.q[begin], trace.dq[begin], targets, trace.q[rows]) if len(rows) else math.inf
    rests = not len(targets) or bool(np.ptp(targets, axis=0).max() < PASSED)
    return found | {"verdict": FORESEEN if least <= 1.0 else EXCLUDED, "least": least, "rests": rests}


# -- many runs -------------------------------------------------------------------------------------------------------


def one(robot: Robot, seed: int) -> dict[str, Any]:
    """Commands beyond bands in the run with a seed, and why bands were left."""
    case = Case.drawn(robot, seed)
    try:
        trace = Trace.of(case)
    except SingularError:
        return {"robot": robot.name, "singular": True}
    worst = trace.used.max(axis=1)
    beyond = np.flatnonzero(worst > 1.0 + PASSED)
    left = [int(k) for k in beyond if k and worst[k - 1] <= 1.0 + PASSED]
    return {
        "robot": robot.name,
        "singular": False,
        "commands": len(worst) - 1,
        "limited": int(trace.limited.sum()),
        "beyond": len(beyond),
        "worst": float(worst.max()),
        "better": max((better(case, trace, int(k)) for k in beyond if k), default=0.0),
        "left": [judged(case, trace, k) for k in left],
    }


def bands(runs: int, known: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Results of random runs by seed, after each of them.

    Args:
        runs: Number of runs.
        known: Results of seeds that were run before.
    """
    robots = {name: load_robot(name, chain_to="auto") for name in ROBOTS}
    found = dict(known)
    for seed in range(runs):
        if str(seed) not in found:
            found[str(seed)] = one(robots[ROBOTS[seed % len(ROBOTS)]], seed)
            yield found
    yield found


def told(found: Mapping[str, Any]) -> Sequence[tuple[str, str]]:
    """Lines of the table."""
    ran = [run for run in found.values() if not run["singular"]]
    left = [time for run in ran for time in run["left"]]
    commands = sum(run["commands"] for run in ran)

    def share(name: str) -> str:
        return f"{100.0 * sum(run[name] for run in ran) / commands:.3g} %"

    def times(verdict: str) -> str:
        some = [time["worst"] for time in left if time["verdict"] == verdict]
        return (
            f"{len(some)}, to {np.median(some):.3g} times the band in the median, {max(some):.3g} at most"
            if some
            else "0"
        )

    resting = sum(time.get("rests", False) for time in left if time["verdict"] == FORESEEN)
    lacking = sum(run["better"] > 2.0 * BETTER for run in ran)
    return (
        ("runs, commands", f"{len(ran)}, {commands:,}"),
        ("commands that limits of joints changed", share("limited")),
        ("commands beyond a band", share("beyond")),
        ("runs in which a command was beyond a band", str(sum(run["beyond"] > 0 for run in ran))),
        ("of these, runs in which another command at some instant would have kept a band better", str(lacking)),
        ("times that a jump of the target led beyond a band at once", times(JUMP)),
        ("times that a band was left as limits excluded it, whatever the commands before", times(EXCLUDED)),
        (
            "times that commands chosen up to 0.6 s before for the path that follows would have kept all",
            times(FORESEEN),
        ),
        ("of these, where the path rested meanwhile", str(resting)),
    )
