"""`Atlas`: chart after chart along a motion.

No single chart covers the configurations of a robot. The atlas says when a chart is left, makes the next one so that
v continues, Eq. (27), and carries chart-based inverse kinematics along a path, Sec. 3.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    SelfMotionVector,
    VectorLike,
    as_floats,
    frozen_copy,
    number,
    vector,
)
from eos_pin.charts._newton import Inverse, Postures, walk
from eos_pin.charts.chart import Chart
from eos_pin.errors import InputError, InverseError, SingularError
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks.base import Point, PointLike, Task

#: Self-motion commanded along a path: constant, one row per point, or a function of the point's number.
SelfMotionPath: TypeAlias = "VectorLike | Callable[[int], VectorLike]"

#: How joints are reached: along the straight line in (z, v), by way of another point, or without a way there.
Strategy: TypeAlias = Literal["walk", "detour", "jump"]
STRATEGIES: tuple[Strategy, ...] = ("walk", "detour", "jump")
#: Detours that are tried.
DETOURS = 4


@dataclass(frozen=True)
class JointPath:
    """Joints along a task path, found by `Atlas.follow`.

    Attributes:
        q: Joints of each point, (K, n).
        z: Task points that were asked for, (K, size).
        v: Self-motion coordinates of each point, (K, r).
        chart: Number of the chart that each point was found on, (K,).
        charts: The charts that were used.
        residual: Largest task error over all points [m, rad].
        iterations: Newton steps taken in all.
        message: Why the path ends before its last point; empty where it does not.
    """

    q: Float[Array, "K n"]
    z: Float[Array, "K size"]
    v: Float[Array, "K r"]
    chart: Int[Array, " K"]
    charts: tuple[Chart, ...]
    residual: float
    iterations: int
    message: str = ""

    @property
    def complete(self) -> bool:
        """Whether all points asked for were reached."""
        return not self.message


@dataclass(frozen=True)
class IkSolution:
    """Joints at a task point, found by `Atlas.reach`.

    Attributes:
        q: Joints; where none were found, the nearest ones.
        way: How they are reached: `"walk"` and `"detour"` are continuous motions through charts, on which v keeps its
            meaning; after a `"jump"` only the joints are known, and v starts anew with a chart based at them.
        path: The motion from the start to q; None after a jump, and from a singular start.
        residual: Task error that is left [m, rad].
        within_limits: Whether q is within the joint limits.
        message: Why no joints were found; empty where they were.
    """

    q: JointVector
    way: Strategy
    path: JointPath | None
    residual: float
    within_limits: bool
    message: str = ""

    @property
    def found(self) -> bool:
        """Whether q is at the task point."""
        return not self.message

    def merit(self, tol: float) -> tuple[bool, bool, float]:
        """What makes one result better than another: found first, then limits, then the error left beyond `tol`."""
        return self.found, self.within_limits, -max(self.residual, tol)


@dataclass(frozen=True)
class Atlas:
    """The charts of one task, and the rule by which they follow each other.

    Attributes:
        task: The task.
        threshold: A chart is left where its `margin` falls to this, between 0 and 1. Any value from 0.3 to 0.97 gives
            the same motion.
        max_iterations: In `follow`, a chart is also left where Newton's method needs more steps than this, which is the
            paper's own rule (Sec. 3.1).

    Raises:
        InputError: The threshold is not between 0 and 1.
    """

    task: Task
    threshold: float = 0.5
    max_iterations: int = 8

    def __post_init__(self) -> None:
        number(self.threshold, "the chart threshold", above=0.0)
        if self.threshold >= 1.0:
            raise InputError(f"the chart threshold must be below 1, where charts end at once; got {self.threshold}")

    def start(self, q: JointsLike) -> Chart:
        """First chart, based at q with v = 0."""
        return Chart.from_base(self.task, q)

    def next(self, chart: Chart, q: JointsLike) -> Chart:
        """Chart based at q that continues v from `chart`; Eq. (27)."""
        return Chart.from_base(self.task, q, previous=chart)

    def holds(self, chart: Chart, J: Jacobian, q: JointVector | None = None) -> bool:
        """Whether `chart` still serves where the Jacobian is J and, if they are given, at these joints."""
        return chart.contains(J, self.threshold) and (q is None or chart.room(q) > 0.0)

    def follow(
        self,
        q: JointsLike,
        path: Iterable[VectorLike] | Float[Array, "K size"],
        *,
        v: SelfMotionPath | None = None,
        chart: Chart | None = None,
        tol: float = 1e-10,
    ) -> JointPath:
        """Chart-based inverse kinematics along a task path, chart after chart.

        The joints change continuously: where the path's first point is not that of q, or two points lie far apart,
        the robot walks the straight line between them in (z, v).

        Args:
            q: Joints to start from; need not be on the path.
            path: Task points, (K, size).
            v: Self-motion coordinates along the path: constant, (K, r), or a function of the point's number. By default
                v keeps its value at q. It is zero at the base of the first chart and continues from chart to chart.
            chart: First chart; by default the one based at q.
            tol: Largest task error at each point [m, rad].

        Returns:
            The joints up to the last point that was reached, and a message if that is not the last of the path.

        Raises:
            SingularError: The task is singular at q.
            InputError: Wrong shapes.
        """
        points = np.atleast_2d(as_floats(path if isinstance(path, np.ndarray) else list(path), "a path"))
        if points.ndim != 2 or points.shape[1] != self.task.size or not np.isfinite(points).all():
            raise InputError(
                f"a path of {self.task!r} must be finite and of shape (K, {self.task.size}), got {points.shape}"
            )
        chart = chart or self.start(q)
        traveller = _Traveller(self, chart, chart.task.robot.posture(q), tol)
        v_of = _self_motion(v, traveller.v, len(points))
        q_path, v_path, chart_path, residual, message = [], [], [], 0.0, ""
        for k, z in enumerate(points):
            v_k = v_of(k)
            if not traveller.go(z, v_k):
                message = f"point {k} of {len(points)} was not reached: {traveller.reason}"
                break
            q_path.append(traveller.inverse.q)
            v_path.append(v_k)
            chart_path.append(len(traveller.charts) - 1)
            residual = max(residual, traveller.inverse.residual)
        reached = len(q_path)
        return JointPath(
            q=frozen_copy(np.reshape(q_path, (reached, chart.n))),
            z=frozen_copy(points[:reached]),
            v=frozen_copy(np.reshape(v_path, (reached, chart.r))),
            chart=frozen_copy(np.reshape(chart_path, reached), int),
            charts=tuple(traveller.charts),
            residual=residual,
            iterations=traveller.iterations,
            message=message,
        )

    def reach(
        self,
        q: JointsLike,
        z: PointLike,
        *,
        v: VectorLike | None = None,
        chart: Chart | None = None,
        ways: Sequence[Strategy] | None = None,
        points: int = 1,
        tries: int = 100,
        seed: int = 0,
        tol: float = 1e-10,
    ) -> IkSolution:
        """Joints at one task point, near or far.

        First the straight line in (z, v) is walked, as `follow` does. Where a singularity or the edge of the robot's
        reach is on it, detours lead through the task points of other postures. Where these fail too, or the joints end
        beyond their limits, a search jumps to joints within them, from q and then from other postures. Joints beyond
        their limits are the last resort, those that a motion leads to before others.

        Args:
            q: Joints to start from.
            z: Task point, in any form that `Task.point` takes.
            v: Self-motion coordinates there; by default their value at q. A jump cannot keep them.
            chart: First chart; by default the one based at q, where v is 0.
            ways: What is tried. By default all, but no jump where v is given; `["walk"]` finds only what is connected
                along the straight line, `["jump"]` anything, and is quickest.
            points: Points of the path that is returned, on each of its straight lines.
            tries: Other postures to jump from.
            seed: Which these are, and those that detours lead through; the same seed, the same joints.
            tol: Largest task error that may be left [m, rad].

        Raises:
            InputError: Wrong shapes, or a way there is not.
        """
        q, z = self.task.robot.posture(q), self.task.point(z)
        if ways is None:
            ways = STRATEGIES if v is None else STRATEGIES[:2]
        if not ways or not set(ways) <= set(STRATEGIES):
            raise InputError(f"ways must be some of {', '.join(STRATEGIES)}, got {ways!r}")
        v = None if v is None else vector(v, q.size - self.task.m, "v")
        if points < 1 or tries < 0:
            raise InputError(f"points must be at least 1 and tries at least 0, got {points} and {tries}")
        best: IkSolution | None = None
        for attempt in self._attempts(q, z, ways, tries, seed, tol, v=v, chart=chart, points=points):
            if best is None or attempt.merit(tol) > best.merit(tol):
                best = attempt
            if best.found and best.within_limits:
                break
        assert best is not None
        return best

    def _attempts(
        self, q: JointVector, z: Point, ways: Sequence[Strategy], tries: int, seed: int, tol: float, **motion: Any
    ) -> Iterator[IkSolution]:
        """What `reach` tries, one after the other."""
        robot, moved = self.task.robot, False
        if "walk" in ways:
            yield (attempt := self._walk("walk", q, [z], tol, **motion))
            moved = attempt.found
        if "detour" in ways:
            for posture in Postures(robot, seed, DETOURS)(DETOURS):
                if moved:
                    break
                yield (attempt := self._walk("detour", q, [self.task.value(posture), z], tol, **motion))
                moved = attempt.found
        if "jump" in ways:
            anything = np.full(robot.n, np.inf)
            for bounds in ((robot.lower, robot.upper), (-anything, anything)):
                yield self._jump(q, z, bounds, tries, seed, tol)
                if moved:
                    break

    def _walk(
        self,
        way: Strategy,
        q: JointVector,
        corners: Sequence[Point],
        tol: float,
        *,
        v: SelfMotionVector | None,
        chart: Chart | None,
        points: int,
    ) -> IkSolution:
        """Follow straight lines from q through the corners."""
        task, z0 = self.task, self.task.value(q)
        path = [z0] + [
            task.plus(a, s * task.minus(b, a)) if s < 1.0 else b
            for a, b in pairwise([z0, *corners])
            for s in np.arange(1, points + 1) / points
        ]
        try:
            chart = chart or self.start(q)
            v0 = chart.v(q)
            ways = v0 if v is None else v0 + np.linspace(0.0, 1.0, len(path))[:, None] * (v - v0)
            found = self.follow(q, path, v=ways, chart=chart, tol=tol)
        except SingularError as error:
            return self._reached(q, way, None, corners[-1], str(error))
        return self._reached(found.q[-1] if len(found.q) else q, way, found, corners[-1], found.message)

    def _jump(
        self, q: JointVector, z: Point, bounds: tuple[JointVector, JointVector], tries: int, seed: int, tol: float
    ) -> IkSolution:
        """Search from q, then from one posture after the other."""
        robot = self.task.robot
        found, residual = self.task.kinematics.search(q, z, bounds, Postures(robot, seed, tries), tol=tol)
        message = ""
        if residual > tol:
            message = f"no posture that was tried leads there: it is out of reach, by {residual:.3g} or less"
        reached = self._reached(robot.unwrap(found, q), "jump", None, z, message)
        if not message:
            self.task.kinematics.confirm(reached.residual, tol)
        return reached

    def _reached(self, q: JointVector, way: Strategy, path: JointPath | None, z: Point, message: str) -> IkSolution:
        robot = self.task.robot
        residual = float(np.abs(self.task.minus(self.task.value(q), z)).max())
        within = bool(((q >= robot.lower) & (q <= robot.upper)).all())
        return IkSolution(frozen_copy(q), way, path, residual, within, message)


class _Traveller:
    """Where a walk through the atlas stands: the chart, the joints, and how much work they took."""

    def __init__(self, atlas: Atlas, chart: Chart, q: JointVector, tol: float) -> None:
        self.atlas, self.tol = atlas, tol
        self.charts = [chart]
        self.iterations, q = 0, chart.unwrap(q)
        self.reason, self.residual = "", 0.0
        self.inverse = Inverse(q, chart.u(q), chart.B_bar, 0, 0.0)
        self.z = atlas.task.value(q)
        self.v = chart.v(q)

    def go(self, z: Point, v: SelfMotionVector) -> bool:
        """Walk to (z, v), through as many charts as it takes."""
        reached = walk(self.atlas.task, (self.z, self.v), (z, v), self._visit, first=1.0)
        if reached < 1.0:
            self.reason = (
                f"the straight line to it in (z, v) ends {reached:.1%} of the way, at a singularity of the task or the "
                f"edge of its reach (task error {self.residual:.3g} just beyond)"
            )
        return reached == 1.0

    def _visit(self, z: Point, v: SelfMotionVector) -> bool:
        chart = self.charts[-1]
        try:
            found = chart.inverse(z, v, start=self.inverse, tol=self.tol, walking=False)
        except InverseError as error:
            self.iterations += error.iterations
            self.residual = error.residual
            # A worn chart may be what failed, so the next, shorter step is tried on a fresh one.
            self._renew(chart)
            return False
        self.iterations += found.iterations
        if not np.array_equal(chart.unwrap(found.q), found.q):
            # Further than a continuous joint may turn on one chart.
            self._renew(chart)
            return False
        self.inverse, self.z, self.v = found, z, v
        if found.iterations > self.atlas.max_iterations or not self.atlas.holds(
            chart, self.atlas.task.linearize(found.q)[1], found.q
        ):
            self._renew(chart)
        return True

    def _renew(self, chart: Chart) -> None:
        q = self.inverse.q
        if np.array_equal(q, chart.q_bar):
            return
        self.charts.append(self.atlas.next(chart, q))
        self.inverse = Inverse(q, np.zeros(chart.m), self.charts[-1].B_bar, 0, self.inverse.residual)


def _self_motion(v: SelfMotionPath | None, start: SelfMotionVector, count: int) -> Callable[[int], SelfMotionVector]:
    r = start.size
    if v is None:
        return lambda k: start
    if callable(v):
        return lambda k: vector(v(k), r, f"v({k})")
    values = as_floats(v, "v")
    if values.ndim == 2:
        if values.shape != (count, r) or not np.isfinite(values).all():
            raise InputError(f"v along the path must be finite and of shape ({count}, {r}), got {values.shape}")
        return lambda k: values[k]
    constant = vector(values, r, "v")
    return lambda k: constant
