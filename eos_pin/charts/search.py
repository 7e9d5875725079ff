"""Inverse kinematics at one task point: continuation, directly or via other points, and search from many postures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, SelfMotionVector, frozen_copy
from eos_pin.charts._newton import Postures
from eos_pin.charts.chart import Chart
from eos_pin.charts.solutions import IkSolution, JointPath, Strategy
from eos_pin.errors import SingularError
from eos_pin.tasks.base import Point, Task

#: Other postures whose task points continuation goes through.
VIA_POINTS = 4


class Follower(Protocol):
    """Continuation along task points, chart after chart; `Atlas.follow`."""

    def __call__(
        self, q: JointVector, path: Float[Array, "K size"], *, v: Array, chart: Chart, tol: float
    ) -> JointPath:
        """Joints along the path."""


@dataclass(frozen=True, eq=False)
class Search:
    """One problem of inverse kinematics: joints at a task point, and the ways to find them.

    Attributes:
        task: The task.
        follow: Continuation along a path.
        start: Chart based at joints.
        q: Joints to start from.
        z: Task point.
        v: Self-motion coordinates there; None for their value at q.
        chart: First chart; None for the one based at q.
        points: Points of a motion on each of its straight lines.
        tries: Postures that a search starts from, besides q.
        seed: Seed of these postures.
        tol: Largest task error that may be left [m, rad].
    """

    task: Task
    follow: Follower
    start: Callable[[JointVector], Chart]
    q: JointVector
    z: Point
    v: SelfMotionVector | None
    chart: Chart | None
    points: int
    tries: int
    seed: int
    tol: float

    def best(self, strategies: Sequence[Strategy]) -> IkSolution:
        """The first solution within joint limits, or the best of all that were tried."""
        best: IkSolution | None = None
        for attempt in self._attempts(strategies):
            if best is None or attempt.score(self.tol) > best.score(self.tol):
                best = attempt
            if best.found and best.within_limits:
                break
        assert best is not None
        return best

    def _attempts(self, strategies: Sequence[Strategy]) -> Iterator[IkSolution]:
        """Solutions by one strategy after the other."""
        robot, connected = self.task.robot, False
        within, anything = (robot.lower, robot.upper), (np.full(robot.n, -np.inf), np.full(robot.n, np.inf))
        searched = strategies[0] == "search"
        if searched:
            yield self._search(within)
        if "continuation" in strategies:
            yield (attempt := self._continue("continuation", [self.z]))
            connected = attempt.found
        if "via" in strategies:
            for posture in Postures(robot, self.seed, VIA_POINTS)(VIA_POINTS):
                if connected:
                    break
                yield (attempt := self._continue("via", [self.task._value(posture), self.z]))
                connected = attempt.found
        if "search" in strategies:
            if not searched:
                yield self._search(within)
            if not connected:
                yield self._search(anything)

    def _continue(self, strategy: Strategy, corners: Sequence[Point]) -> IkSolution:
        """Follow straight lines from q through the corners."""
        task, q, v, z0 = self.task, self.q, self.v, self.task._value(self.q)
        path = [z0] + [
            task._plus(a, s * task._minus(b, a)) if s < 1.0 else b
            for a, b in pairwise([z0, *corners])
            for s in np.arange(1, self.points + 1) / self.points
        ]
        try:
            chart = self.chart or self.start(q)
            v0 = chart._v(q)
            v_path = v0 if v is None else v0 + np.linspace(0.0, 1.0, len(path))[:, None] * (v - v0)
            found = self.follow(q, np.array(path), v=v_path, chart=chart, tol=self.tol)
        except SingularError as error:
            return self._solution(q, strategy, None, str(error))
        return self._solution(found.q[-1] if len(found.q) else q, strategy, found, found.message)

    def _search(self, bounds: tuple[JointVector, JointVector]) -> IkSolution:
        """Search from q, then from one posture after the other."""
        robot = self.task.robot
        postures = Postures(robot, self.seed, self.tries)
        found, residual = self.task.kinematics.search(self.q, self.z, bounds, postures, tol=self.tol)
        message = ""
        if residual > self.tol:
            message = (
                f"no joints found: the best of {self.tries + 1} starts misses the task point by {residual:.3g}. It may "
                "be out of reach; increase `tries`, or start elsewhere"
            )
        solution = self._solution(robot._unwrap(found, self.q), "search", None, message)
        if not message:
            self.task.kinematics.confirm(solution.residual, self.tol)
        return solution

    def _solution(self, q: JointVector, strategy: Strategy, path: JointPath | None, message: str) -> IkSolution:
        robot = self.task.robot
        residual = float(np.abs(self.task._minus(self.task._value(q), self.z)).max())
        within = bool(((q >= robot.lower) & (q <= robot.upper)).all())
        return IkSolution(frozen_copy(q), strategy, path, residual, within, message)
