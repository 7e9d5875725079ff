"""Results of inverse kinematics: joints along a path, and joints at one task point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from jaxtyping import Float, Int

from eos_pin._arrays import Array, JointVector, brief, by_value, checked
from eos_pin.charts.chart import Chart
from eos_pin.errors import Renamed

#: Method by which joints are found: continuation along the straight line in (z, v), continuation via the task points of
#: other postures, or a search from many postures.
Strategy: TypeAlias = Literal["continuation", "via", "search"]
STRATEGIES: tuple[Strategy, ...] = ("continuation", "via", "search")


@brief("complete", "residual", "q")
@by_value
@dataclass(frozen=True, eq=False)
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


@brief("found", "strategy", "residual", "within_limits", "q")
@by_value
@dataclass(frozen=True, eq=False)
class IkSolution:
    """Joints at a task point, found by `Atlas.solve`.

    Attributes:
        q: Joints; where none were found, the nearest ones.
        strategy: Method by which they were found. `"continuation"` and `"via"` are continuous motions through charts,
            on which v keeps its meaning; after a `"search"` only the joints are known, and v starts anew with a chart
            based at them.
        path: The motion from the start to q; None after a search, and from a singular start.
        residual: Task error that is left [m, rad].
        within_limits: Whether q is within the joint limits.
        message: Why no joints were found; empty where they were.
    """

    q: JointVector
    strategy: Strategy
    path: JointPath | None
    residual: float
    within_limits: bool
    message: str = ""

    way = Renamed("strategy")
    merit = Renamed("score")

    @property
    def found(self) -> bool:
        """Whether q is at the task point."""
        return not self.message

    @checked
    def score(self, tol: float) -> tuple[bool, bool, float]:
        """Rank among several results, larger is better: found first, then limits, then the error beyond `tol`."""
        return self.found, self.within_limits, -max(self.residual, tol)
