"""`Atlas`: chart after chart along a motion.

No single chart covers the configurations of a robot. The atlas decides when a chart is left, makes the next one so that
v continues, Eq. (27), and carries chart-based inverse kinematics along a path, Sec. 3.3, and to single points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Checked,
    Jacobian,
    JointVector,
    SelfMotionVector,
    VectorLike,
    as_floats,
    checked,
    frozen_copy,
    number,
    unchecked,
    vector,
    vector_of,
)
from eos_pin.charts._newton import Inverse, walk
from eos_pin.charts.chart import Chart
from eos_pin.charts.metric import MetricLike, checked_metric, metric_name
from eos_pin.charts.search import Search
from eos_pin.charts.solutions import STRATEGIES, IkSolution, JointPath, Strategy
from eos_pin.errors import InputError, InverseError, Renamed, SingularError, refuse_unused
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks.base import Point, PointLike, Task

#: Self-motion commanded along a path: constant, one row per point, or a function of the point's number.
SelfMotionPath: TypeAlias = "VectorLike | Callable[[int], VectorLike]"


@checked
@dataclass(frozen=True, eq=False)
class Atlas(Checked):
    """The charts of one task, and the rule by which they follow each other.

    Attributes:
        task: The task.
        threshold: A chart is left where its `margin` falls to this, between 0 and 1. Any value from 0.3 to 0.97 gives
            the same motion.
        max_iterations: In `follow`, a chart is also left where Newton's method needs more steps than this, which is the
            paper's own rule (Sec. 3.1).
        metric: Metric of every chart: `"identity"`, as in the paper; `"inertial"`, the mass matrix at its base; a
            symmetric positive (n, n) matrix, or a function of the base joints that returns one. See `Chart.from_base`.

    Raises:
        InputError: The threshold is not between 0 and 1, or the metric is not one for the task's robot.
        RobotError: The metric is `"inertial"`, and the robot has no valid inertia.
    """

    task: Task
    threshold: float = 0.5
    max_iterations: int = 8
    metric: MetricLike = "identity"

    def __post_init__(self) -> None:
        object.__setattr__(self, "metric", checked_metric(self.metric, self.task.robot))
        number(self.threshold, "threshold", above=0.0)
        if self.threshold >= 1.0:
            raise InputError(f"threshold must be above 0 and below 1, got {self.threshold}")

    def describe(self) -> dict[str, Any]:
        """Description in plain values, for records of runs."""
        return {"threshold": self.threshold, "metric": metric_name(self.metric)}

    @checked
    def start(self, q: JointsLike) -> Chart:
        """First chart, based at q with v = 0."""
        return Chart.from_base(self.task, q, metric=self.metric)

    @checked
    def next(self, chart: Chart, q: JointsLike) -> Chart:
        """Chart based at q that continues v from `chart`, whose metric may be another; Eq. (27)."""
        return Chart.from_base(self.task, q, metric=self.metric, previous=chart)

    @checked
    def holds(self, chart: Chart, J: Jacobian, q: JointVector | None = None) -> bool:
        """Whether `chart` still serves where the Jacobian is J and, if they are given, at these joints."""
        return chart._contains(J, self.threshold) and (q is None or chart._room(q) > 0.0)

    @checked
    def serves(self, chart: Chart, J: Jacobian) -> bool:
        """Whether `chart` holds where the Jacobian is J, or none can be made there to take its place."""
        try:
            return self._holds(chart, J)
        except SingularError:
            return True

    @checked
    def follow(
        self,
        q: JointsLike,
        path: Iterable[PointLike] | Float[Array, "K size"],
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
            path: Task points, (K, size), or each in any form that `Task.point` takes, such as a `pin.SE3` for a pose.
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
        points = self._points(path)
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

    def _points(self, path: Iterable[PointLike] | Float[Array, "K size"]) -> Float[Array, "K size"]:
        """Task points of a path as rows."""
        size = self.task.size
        # An array of rows is how inner code has them; other forms are looked at one by one.
        if isinstance(path, np.ndarray) and path.ndim < 3:
            points = np.atleast_2d(as_floats(path, "a path"))
        else:
            try:
                points = np.array([self.task.point(z) for z in path]).reshape(-1, size)
            except TypeError as error:
                raise InputError(f"a path is a sequence of task points, got {path!r}; for one use solve") from error
        if points.shape[1] != size or not np.isfinite(points).all():
            raise InputError(f"a path of {self.task!r} must be finite and of shape (K, {size}), got {points.shape}")
        return points

    @checked
    def solve(
        self,
        q: JointsLike,
        z: PointLike,
        *,
        v: VectorLike | None = None,
        chart: Chart | None = None,
        strategies: Sequence[Strategy] | None = None,
        points: int = 1,
        tries: int = 500,
        seed: int = 0,
        tol: float = 1e-10,
    ) -> IkSolution:
        """Joints at one task point, near or far.

        A search looks for joints within their limits, from q and then from other postures; that is quickest. Where it
        finds none, or a motion is asked for by `v`, `chart` or more than one of `points`, continuation follows the
        straight line in (z, v), as `follow` does it, and goes via the task points of other postures where a singularity
        or the edge of the robot's reach is on that line. Joints beyond their limits are the last resort, those that a
        motion leads to before others.

        Args:
            q: Joints to start from.
            z: Task point, in any form that `Task.point` takes, such as a `pin.SE3` for a pose.
            v: Self-motion coordinates there; by default their value at q. A search cannot keep them.
            chart: First chart; by default the one based at q, where v is 0.
            strategies: Methods to try; a search comes first where it is named first. By default all, but no search
                where v is given; `["continuation"]` finds only joints that are connected along the straight line.
            points: Points of the path that is returned, on each of its straight lines.
            tries: Other postures to search from.
            seed: Seed of these postures, and of those that continuation goes via; the same seed gives the same joints.
            tol: Largest task error that may be left [m, rad].

        Raises:
            InputError: Wrong shapes, an unknown strategy, or an argument that none of the strategies uses.
        """
        q, z = self.task.robot.posture(q), self.task.point(z)
        if strategies is None:
            # A search is many times as quick, but tells no motion.
            motion = chart is not None or points > 1
            strategies = STRATEGIES[:2] if v is not None else STRATEGIES if motion else ("search", *STRATEGIES[:2])
        if not strategies or not set(strategies) <= set(STRATEGIES):
            raise InputError(f"strategies must be some of {', '.join(STRATEGIES)}, got {strategies!r}")
        v = None if v is None else vector(v, q.size - self.task.m, "v")
        if set(strategies) == {"search"}:
            reason = "a search tells no motion and keeps no v; name another strategy as well"
            refuse_unused(Atlas.solve, reason, v=v, chart=chart, points=points)
        if "search" not in strategies:
            refuse_unused(Atlas.solve, "nothing is searched for; name the strategy 'search'", tries=tries)
            if "via" not in strategies:
                reason = "continuation alone takes no other postures; name another strategy as well"
                refuse_unused(Atlas.solve, reason, seed=seed)
        if points < 1 or tries < 0:
            raise InputError(f"points must be at least 1 and tries at least 0, got {points} and {tries}")
        return Search(self.task, self.follow, self.start, q, z, v, chart, points, tries, seed, tol).best(strategies)

    _holds, _serves = unchecked(holds), unchecked(serves)
    reach = Renamed("solve")


@checked
def inverse_kinematics(task: Task, z: PointLike, q0: JointsLike, **options: Any) -> IkSolution:
    """Joints at one task point; `Atlas(task).solve(q0, z)` under the name that it has elsewhere.

    Args:
        task: The task, such as `PoseTask(robot, "hand")`.
        z: Task point; for a pose a `pin.SE3`, a 4 × 4 matrix or a flat point.
        q0: Joints to start from.
        options: As in `Atlas.solve`.

    Raises:
        InputError: Wrong shapes, or an unknown strategy.
    """
    return Atlas(task).solve(q0, z, **options)


class _Traveller:
    """State of a walk through the atlas: the chart, the joints, and the work so far."""

    def __init__(self, atlas: Atlas, chart: Chart, q: JointVector, tol: float) -> None:
        self.atlas, self.tol = atlas, tol
        self.charts = [chart]
        self.iterations, q = 0, chart._unwrap(q)
        self.reason, self.residual = "", 0.0
        self.inverse = Inverse(q, chart._u(q), chart.B_bar, 0, 0.0)
        self.z = atlas.task._value(q)
        self.v = chart._v(q)

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
            found = chart._inverse(z, v, start=self.inverse, tol=self.tol, walking=False)
        except InverseError as error:
            self.iterations += error.iterations
            self.residual = error.residual
            # A worn chart may be what failed, so the next, shorter step is tried on a fresh one.
            self._renew(chart)
            return False
        self.iterations += found.iterations
        if not np.array_equal(chart._unwrap(found.q), found.q):
            # Further than a continuous joint may turn on one chart.
            self._renew(chart)
            return False
        self.inverse, self.z, self.v = found, z, v
        if found.iterations > self.atlas.max_iterations or not self.atlas._holds(
            chart, self.atlas.task._linearize(found.q)[1], found.q
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
        return lambda k: vector_of(f"v({k})", r, v, k)
    values = as_floats(v, "v")
    if values.ndim == 2:
        if values.shape != (count, r) or not np.isfinite(values).all():
            raise InputError(f"v along the path must be finite and of shape ({count}, {r}), got {values.shape}")
        return lambda k: values[k]
    constant = vector(values, r, "v")
    return lambda k: constant
