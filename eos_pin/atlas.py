"""`Atlas`: chart after chart along a motion.

No single chart covers the configurations of a robot. The atlas says when a chart is left, makes the next one so that
v continues, Eq. (27), and carries chart-based inverse kinematics along a path, Sec. 3.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from eos_pin.arrays import (
    Array,
    Jacobian,
    JointVector,
    SelfMotionVector,
    VectorLike,
    number,
    numbers,
    readonly,
    vector,
)
from eos_pin.charts import Chart
from eos_pin.errors import InputError, InverseError
from eos_pin.newton import Inverse, walk
from eos_pin.tasks import Point, Task

#: Self-motion commanded along a path: constant, one row per point, or a function of the point's number.
SelfMotionPath: TypeAlias = "VectorLike | Callable[[int], VectorLike]"


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

    def start(self, q: VectorLike) -> Chart:
        """First chart, based at q with v = 0."""
        return Chart.at(self.task, q)

    def next(self, chart: Chart, q: VectorLike) -> Chart:
        """Chart based at q that continues v from `chart`; Eq. (27)."""
        return Chart.at(self.task, q, previous=chart)

    def holds(self, chart: Chart, J: Jacobian) -> bool:
        """Whether `chart` still serves where the Jacobian is J."""
        return chart.contains(J, self.threshold)

    def follow(
        self,
        q: VectorLike,
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
        points = np.atleast_2d(numbers(path if isinstance(path, np.ndarray) else list(path), "a path"))
        if points.ndim != 2 or points.shape[1] != self.task.size or not np.isfinite(points).all():
            raise InputError(
                f"a path of {self.task!r} must be finite and of shape (K, {self.task.size}), got {points.shape}"
            )
        chart = chart or self.start(q)
        traveller = _Traveller(self, chart, vector(q, chart.n, "q"), tol)
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
            q=readonly(np.reshape(q_path, (reached, chart.n))),
            z=readonly(points[:reached]),
            v=readonly(np.reshape(v_path, (reached, chart.r))),
            chart=readonly(np.reshape(chart_path, reached), int),
            charts=tuple(traveller.charts),
            residual=residual,
            iterations=traveller.iterations,
            message=message,
        )


class _Traveller:
    """Where a walk through the atlas stands: the chart, the joints, and how much work they took."""

    def __init__(self, atlas: Atlas, chart: Chart, q: JointVector, tol: float) -> None:
        self.atlas, self.tol = atlas, tol
        self.charts = [chart]
        self.iterations = 0
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
        self.inverse, self.z, self.v = found, z, v
        if found.iterations > self.atlas.max_iterations or not self.atlas.holds(
            chart, self.atlas.task.linearize(found.q)[1]
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
    values = numbers(v, "v")
    if values.ndim == 2:
        if values.shape != (count, r) or not np.isfinite(values).all():
            raise InputError(f"v along the path must be finite and of shape ({count}, {r}), got {values.shape}")
        return lambda k: values[k]
    constant = vector(values, r, "v")
    return lambda k: constant
