"""Runs of arms with payloads and joints too weak for gravity, and linear programs of their own that judge lost joints.

A joint that passes its limits is judged in every period from where it first left its bounds of acceleration:

hopeless: no torques within limits keep the joint within its bounds. Hopeless joints brake with all they have.
not alone: torques keep it, but none with which hopeless joints brake.
excluded: torques keep it alone, but none that keep the joints before it, in the order of `keeping_order`, as well.
help ends: torques keep it, but for the help that joints before it, which were lost just now, still get.
could be kept: none of these; if that is so in all these periods, the controller is wrong.

The first of these that excuses the joint in any of these periods is its verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

from eos_pin import (
    EosError,
    Geodesic,
    JointLimits,
    LimitedEosController,
    PositionTask,
    Result,
    Robot,
    load_robot,
    simulate_sampled,
)

#: Control period, whose multiples are exact [s].
PERIOD = 2.0**-10
#: Control periods at which the steepest stretch of a run is repeated [s], and its half width in periods of 1/1024 s.
WEAK_PERIODS = tuple(PERIOD / 2**k for k in range(7))
AROUND = 8
#: When the target is back, and when a run ends [s].
BACK, END = 1.5, 2.0
#: Robots that get payloads and weak joints, and what they are rated for [kg].
RATED = {"panda": 3.0, "ur5": 5.0, "kinova": 2.6}
#: A joint passes its limits beyond this, of position [rad] and of velocity, relative.
POSITION, VELOCITY = 1e-5, 1e-3
#: Lost joints lack no more than this, and one, times the least that torques can make them lack.
FADE = 1.0
#: Periods of a run in which the number of lost joints is compared with the smallest possible.
COMPARED = 12
#: Verdicts that excuse a joint, and the one that does not.
HOPELESS, NOT_ALONE, EXCLUDED, ENDING = "hopeless", "not alone", "excluded", "help ends"
WRONG = "could be kept"
VERDICTS = HOPELESS, NOT_ALONE, EXCLUDED, ENDING, WRONG
#: Into how many parts the way from one sample to the next is divided where the torque changes most.
PARTS = (1, 4, 16, 64)
#: Part of such a way in which a torque is looked for that jumps.
NARROW = 1e-9


class Asked(LimitedEosController):
    """The same controller; what is asked twice in a row, for the torque and for the record, is found once.

    Attributes:
        states: All that was asked, (q, dq, ddq, J), in turn.
        torques: The answers.
    """

    @cached_property
    def _within(self) -> Any:
        within = super()._within
        self.states: list[tuple[np.ndarray, ...]] = []
        self.torques: list[np.ndarray] = []
        last: Any = None

        def found(*state: np.ndarray) -> Any:
            nonlocal last
            if not self.states or any((x != y).any() for x, y in zip(state, self.states[-1], strict=True)):
                last = within(*state)
                self.states.append(tuple(map(np.copy, state)))
                self.torques.append(last[0])
            return last

        return found


def loaded(seed: int) -> tuple[Robot, str, np.random.Generator]:
    """Robot with a payload and weak joints, its frame, and where its random numbers go on."""
    random = np.random.default_rng((1, seed))
    name = list(RATED)[seed % len(RATED)]
    robot = load_robot(name, chain_to="auto")
    frame = str(robot.options["chain_to"])
    model = robot.model.copy()
    placed = model.frames[robot.frame_id(frame)].placement
    ball = pin.Inertia.FromSphere(RATED[name] * random.uniform(0.0, 3.0), 0.05)
    model.inertias[model.njoints - 1] += placed.act(ball)
    robot = replace(robot, model=model, source="", urdf_sha256="")
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    gravity = np.abs([robot.gravity(random.uniform(lower, upper)) for _ in range(200)]).max(axis=0)
    weak = random.random(robot.n) < random.choice([0.0, 0.2, 0.5])
    effort = np.where(weak, np.maximum(random.uniform(0.2, 1.2, robot.n) * gravity, 1.0), robot.effort)
    model.effortLimit = np.minimum(effort, robot.effort)
    return replace(robot, model=model), frame, random


def weak_run(seed: int) -> tuple[Result, Asked]:
    """Run of a robot with a payload and weak joints, every control period of it."""
    robot, frame, random = loaded(seed)
    task = PositionTask(robot, frame)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    q = lower + (upper - lower) * (0.02 + 0.96 * random.beta(0.8, 0.8, robot.n))
    z = task.value(q)
    step = random.normal(size=3)
    step *= random.uniform(0.0, 0.7) / np.linalg.norm(step)
    path = Geodesic(task, np.array([z, z + step, z]), np.array([0.0, 0.5 * BACK, BACK]))
    controller = Asked(task, path, control_period=PERIOD)
    run = simulate_sampled(robot, controller, q, duration=END, control_period=PERIOD, record_rate=1.0 / PERIOD)
    return run, controller


class Judge:
    """Linear programs that tell which joints torques can keep within their bounds in one state.

    Args:
        robot: The robot.
        limits: Its limits.
        order: Order in which joints are kept.
        q: Joints.
        dq: Joint velocities.
        ddq: Accelerations over the period, on average, with the torques that were held.
        tau: These torques.
    """

    def __init__(
        self,
        robot: Robot,
        limits: JointLimits,
        order: Sequence[int],
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        tau: np.ndarray,
    ) -> None:
        M, torque = robot.mass(q + 0.5 * PERIOD * dq), limits.torque
        self.n, self.order, self.inverse = robot.n, list(order), np.linalg.inv(M)
        # Bounds of the accelerations that the torques alone give. Where joints spin, the motion that was measured tells
        # far more of a period than the state that it begins in.
        rest = self.inverse @ tau - ddq
        least, most = limits.accelerations(q, dq, PERIOD)
        self.least, self.most = least + rest, most + rest
        reach = np.abs(self.inverse) @ torque
        lack = np.maximum(self.least, -self.most) - reach
        self.hopeless = set(np.flatnonzero(lack > 0.0).tolist())
        self.ranked = [j for j in self.order if j not in self.hopeless]
        # Torques, where hopeless joints brake; and where those that have just become hopeless brake in part.
        self.braking, self.easing = (
            np.where(
                (self.least > reach)[:, None],
                np.column_stack(((2.0 * part - 1.0) * torque, torque)),
                np.column_stack((-torque, (1.0 - 2.0 * part) * torque)),
            )
            for part in (np.where(lack > 0.0, 1.0, 0.0), np.clip(M.diagonal() * lack / torque, 0.0, 1.0))
        )

    def possible(self, joints: Sequence[int], room: float = 0.0) -> bool:
        """Whether torques keep these joints, the last one with room to spare, while hopeless ones brake."""
        chosen, spare = list(joints), np.zeros(len(joints))
        spare[-1] = room
        A = np.vstack((self.inverse[chosen], -self.inverse[chosen]))
        b = np.concatenate((self.most[chosen] - spare, -self.least[chosen] - spare))
        return linprog(np.zeros(self.n), A_ub=A, b_ub=b, bounds=self.braking).status == 0

    @cached_property
    def kept(self) -> list[int]:
        """Joints that are kept, one after the other."""
        kept: list[int] = []
        if self.possible(self.ranked):
            return self.ranked
        for j in self.ranked:
            if self.possible([*kept, j]):
                kept.append(j)
        return kept

    def smallest_loss(self) -> int:
        """The smallest number of joints that are lost besides hopeless ones, whatever the order."""
        n = len(self.ranked)
        return next((lost for lost in range(n) if any(map(self.possible, combinations(self.ranked, n - lost)))), n)

    def verdict(self, joint: int) -> str:
        """Verdict on a joint."""
        if joint in self.hopeless:
            return HOPELESS
        # A period's mean acceleration is bounded, and the torque is held: a hair is left for what lies between.
        room = float(min(0.1, 0.25 * (self.most - self.least)[joint]))
        if not self.possible([joint], room):
            return NOT_ALONE
        if not self.possible([*self.before(joint), joint], room):
            return EXCLUDED
        return WRONG if self._possible_with_help(joint, room) else ENDING

    def before(self, joint: int) -> list[int]:
        """Joints before a joint that are kept."""
        return [j for j in self.kept if self.order.index(j) < self.order.index(joint)]

    def either(self, joint: int) -> bool:
        """Whether one joint before it excludes a joint: torques keep either of them, and none keep both."""
        return any(not self.possible([other, joint]) for other in self.before(joint))

    def _possible_with_help(self, joint: int, room: float) -> bool:
        """Whether torques keep a joint while lost joints before it get the help that the rule still gives them."""
        rows, least, most = np.zeros((0, self.n)), np.zeros(0), np.zeros(0)
        for j in self.order:
            spare = room if j == joint else 0.0
            rows = np.vstack((rows, self.inverse[j]))
            least, most = np.append(least, self.least[j] + spare), np.append(most, self.most[j] - spare)
            # What the last one lacks at least.
            slack = np.zeros((len(rows), 1))
            slack[-1] = -1.0
            found = linprog(
                [*np.zeros(self.n), 1.0],
                A_ub=np.block([[rows, slack], [-rows, slack]]),
                b_ub=np.concatenate((most, -least)) + 1e-6,
                bounds=[*self.easing, (0.0, None)],
            )
            if found.status != 0 or j == joint:
                return found.status == 0 and found.fun < 1e-6
            least[-1] -= (1.0 + FADE) * found.fun
            most[-1] += (1.0 + FADE) * found.fun
        raise ValueError(joint)


@dataclass(frozen=True)
class Outcome:
    """Result of a run about its limits.

    Attributes:
        torque: Largest torque, as a part of its limit; infinite where one is not finite.
        verdicts: Verdict on each joint that passed its limits, the worst where it did more than once.
        either: Joints that one joint before them excluded, though torques keep either.
        lost: How many joints the order loses besides hopeless ones in some periods, and how few can be lost.
    """

    torque: float = 0.0
    verdicts: dict[int, str] = field(default_factory=dict)
    either: frozenset[int] = frozenset()
    lost: tuple[tuple[int, int], ...] = ()


def weak_one(seed: int) -> Outcome:
    """What the run with a seed did about its limits."""
    try:
        run, controller = weak_run(seed)
    except EosError:
        return Outcome()
    limits, robot, order = controller.limits, controller.robot, controller.keeping_order
    # A sample is taken at the end of a period.
    q, dq, ddq = run.q[:-1], run.dq[:-1], np.diff(run.dq, axis=0) / PERIOD
    bounds = [limits.accelerations(*row, PERIOD) for row in zip(q, dq, strict=True)]
    least, most = (np.array(side) for side in zip(*bounds, strict=True))
    left = np.maximum(least - ddq, ddq - most) > 1e-3 * (1.0 + np.abs(ddq))
    out = (q < limits.lower - POSITION) | (q > limits.upper + POSITION)
    out |= np.abs(dq) > limits.velocity * (1.0 + VELOCITY)
    # A joint that moves towards a limit faster than it may is on its way out.
    way = np.where(dq > 0.0, limits.upper - q, q - limits.lower)
    b, rate = limits.braking, 100.0
    with np.errstate(invalid="ignore"):
        fast = np.abs(dq) > np.sqrt(2.0 * b * np.maximum(way, 0.0) + (b / rate) ** 2) - b / rate + 1e-4
    # A sample has the torque that was held until then.
    judge = cache(lambda row: Judge(robot, limits, order, q[row], dq[row], ddq[row], run.tau[row + 1]))
    verdicts: dict[int, str] = {}
    either = set()
    for begin, joint in zip(*np.nonzero(out & ~np.vstack((np.zeros(robot.n, dtype=bool), out[:-1]))), strict=True):
        first = begin
        while first > 0 and (left[first - 1, joint] or fast[first - 1, joint]):
            first -= 1
        told: dict[str, int] = {}
        for row in range(first, begin + 1):
            told.setdefault(judge(row).verdict(joint), row)
            if told.keys() & {HOPELESS, EXCLUDED}:
                break
        verdict = next(one for one in VERDICTS if one in told)
        if verdict == EXCLUDED and judge(told[EXCLUDED]).either(joint):
            either.add(int(joint))
        verdicts[int(joint)] = max(verdict, verdicts.get(int(joint), HOPELESS), key=VERDICTS.index)
    rows = np.flatnonzero(left.any(axis=1))
    some = rows[np.linspace(0, len(rows) - 1, min(COMPARED, len(rows))).astype(int)] if verdicts else []
    judges = [judge(row) for row in some]
    return Outcome(
        torque=float((np.abs(run.tau) / limits.torque).max()) if np.isfinite(run.tau).all() else np.inf,
        verdicts=verdicts,
        either=frozenset(either),
        lost=tuple((len(one.ranked) - len(one.kept), one.smallest_loss()) for one in judges),
    )


def weak_figures(runs: Sequence[Outcome]) -> dict[str, float]:
    """Figures of runs with payloads and weak joints."""
    verdicts = [one for row in runs for one in row.verdicts.values()]
    lost = np.array([pair for row in runs for pair in row.lost]).reshape(-1, 2)
    return {
        "with payloads and weak joints: runs": len(runs),
        "torques not finite or beyond a limit then": sum(row.torque > 1.0 + 1e-12 for row in runs),
        "runs in which limits were passed": sum(bool(row.verdicts) for row in runs),
        "joints that passed their limits": len(verdicts),
        "of these, hopeless": verdicts.count(HOPELESS),
        "of these, not to be kept while hopeless ones brake": verdicts.count(NOT_ALONE),
        "of these, excluded by joints before them": verdicts.count(EXCLUDED),
        "of those, by one alone, where torques keep either": sum(len(row.either) for row in runs),
        "of these, excluded by help that still ended": verdicts.count(ENDING),
        "of these, that could keep them": verdicts.count(WRONG),
        "periods in which a joint leaves its bounds, some of each such run": len(lost),
        "of these, in which no torques keep all joints that are not hopeless": int((lost[:, 1] > 0).sum()),
        "joints lost in them besides hopeless ones, mean": float(lost[:, 0].mean()) if len(lost) else 0.0,
        "the smallest number possible, mean": float(lost[:, 1].mean()) if len(lost) else 0.0,
        "of these, in which more are lost than must be": int((lost[:, 0] > lost[:, 1]).sum()),
    }


def weak_steps(seed: int) -> list[float]:
    """The most a torque changes from one period to the next, for each of `WEAK_PERIODS`, where a run does so most.

    All begin in one state shortly before, and pass no change of charts.
    """
    run, asked = weak_run(seed)
    task, path = asked.task, asked.reference
    assert isinstance(path, Geodesic)
    steps = np.where(np.diff(run.chart) == 0, np.abs(np.diff(run.tau, axis=0)).max(axis=1), 0.0)
    first = max(int(steps.argmax()) - AROUND, 0)
    largest = []
    for period in WEAK_PERIODS:
        moved = Geodesic(task, path.points, path.times - run.t[first])
        controller = LimitedEosController(task, moved, control_period=period)
        part = simulate_sampled(
            task.robot,
            controller,
            run.q[first],
            run.dq[first],
            duration=2 * AROUND * PERIOD,
            control_period=period,
            record_rate=1.0 / period,
        )
        # The first periods have no measured acceleration to begin from.
        same = (np.diff(part.chart) == 0) & (part.t[1:] > AROUND // 4 * PERIOD)
        largest.append(float(np.abs(np.diff(part.tau, axis=0))[same].max()))
    return largest


def divided_steps(seed: int) -> list[float]:
    """The most a torque changes where ways between samples are divided into `PARTS`, and within `NARROW` of a way."""
    _, controller = weak_run(seed)
    states, torques = controller.states, np.array(controller.torques)
    largest = np.zeros(len(PARTS) + 1)
    # Where it changes most.
    for k in np.argsort(-np.abs(np.diff(torques, axis=0)).max(axis=1))[:20]:

        def torque(part: float, one: Any = states[k], other: Any = states[k + 1]) -> np.ndarray:
            return controller._within(*(x + part * (y - x) for x, y in zip(one, other, strict=True)))[0]

        marks = np.linspace(0.0, 1.0, PARTS[-1] + 1)
        way = np.array([torque(part) for part in marks])
        steps = [np.abs(np.diff(way[:: PARTS[-1] // parts], axis=0)).max() for parts in PARTS]
        # A jump is still there where the steepest part is divided on and on.
        while marks[1] - marks[0] > NARROW:
            steepest = int(np.abs(np.diff(way, axis=0)).max(axis=1).argmax())
            marks = np.linspace(float(marks[steepest]), float(marks[steepest + 1]), 9)
            way = np.array([torque(part) for part in marks])
        largest = np.maximum(largest, [*steps, np.abs(np.diff(way, axis=0)).max()])
    return largest.tolist()
