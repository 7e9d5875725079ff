"""Kinematic obstacle avoidance: along a task path, v(t) makes way while z stays on the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    SelfMotionVector,
    Vector,
    VectorLike,
    checked,
    frozen_copy,
    number,
    vector,
)
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.charts.solutions import JointPath
from eos_pin.errors import InputError, Renamed, SingularError, refuse_unused, renamed
from eos_pin.planning.obstacles.clearance import Clearance
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks.base import Point
from eos_pin.trajectories.base import Trajectory

#: A step of v this small, as a fraction of the longest one, is the last one at its point.
SETTLED = 1e-2


@checked
@renamed(margin="influence_distance")
@dataclass(frozen=True, eq=False)
class Avoidance:
    """A law for v: every body clear of obstacles, every joint off its limits, as near to a posture as that allows.

    Each step of v is one of damped least squares (Gauss-Newton) on Σ (1 − distance/margin)² over the approaches closer
    than `influence_distance`, plus Σ (1 − way/room)² over the joints closer than `room` to a limit, plus pull² |q −
    posture|². It looks at obstacles where they are at that instant only, so they may move in any way.

    Attributes:
        clearance: Bodies and obstacles.
        influence_distance: Distance below which an obstacle repels [m].
        room: Way to its limit below which a joint is repelled [rad or m].
        posture: Joints to be near to, (n,); by default there are none.
        pull: Weight of the posture.
        damping: Weight of the step itself.
        longest: Most that a joint turns in one step [rad or m].
    """

    clearance: Clearance
    influence_distance: float = 0.1
    room: float = 0.1
    posture: JointsLike | None = None
    pull: float = 0.4
    damping: float = 3.0
    longest: float = 0.02

    margin = Renamed("influence_distance")

    def __post_init__(self) -> None:
        for name in ("influence_distance", "room", "damping", "longest"):
            number(getattr(self, name), name, above=0.0)
        number(self.pull, "pull", at_least=0.0)
        if self.posture is None:
            refuse_unused(Avoidance, "there is no posture to pull to; add posture", pull=self.pull)
        else:
            object.__setattr__(self, "posture", frozen_copy(self.clearance.robot.posture(self.posture, "the posture")))

    @checked
    def step(self, t: float, q: JointVector, chart: Chart) -> SelfMotionVector:
        """Change of v that makes way at time t [s], (r,)."""
        rows, missing = self._repulsion(t, q)
        pull = 0.0 if self.posture is None else self.pull**2
        away = 0.0 * q if self.posture is None else self.clearance.robot.way(q, np.asarray(self.posture))
        # dq = D dv is the self-motion: the task does not feel it.
        D = chart.point(q, 0.0 * q).D
        A = rows @ D
        dv = np.linalg.solve(A.T @ A + (pull + self.damping**2) * (D.T @ D), A.T @ missing + pull * (D.T @ away))
        return dv / max(1.0, float(np.abs(D @ dv).max(initial=0.0)) / self.longest)

    def _repulsion(self, t: float, q: JointVector) -> tuple[Float[Array, "k n"], Vector]:
        """Bodies and joints that are too close: gradient of each distance, and its relative deficit."""
        robot = self.clearance.robot
        near = self.clearance.closest_pairs(t, q, within=self.influence_distance)
        below, above = 1.0 - (q - robot.lower) / self.room, 1.0 - (robot.upper - q) / self.room
        away = np.eye(robot.n) / self.room
        rows = [*(a.gradient / self.influence_distance for a in near), *away[below > 0.0], *-away[above > 0.0]]
        lacking = (1.0 - a.distance / self.influence_distance for a in near)
        missing = [*lacking, *below[below > 0.0], *above[above > 0.0]]
        return np.reshape(rows, (-1, robot.n)), np.array(missing, dtype=float)

    @checked
    def follow(
        self, atlas: Atlas, q: JointsLike, path: Trajectory, times: VectorLike, *, steps: int = 4, tol: float = 1e-10
    ) -> JointPath:
        """Chart-based inverse kinematics along a task path on which v makes way; `Clearance.along` checks the outcome.

        Args:
            atlas: Charts of the task.
            q: Joints to start from.
            path: The task's path.
            times: Times at which its points are visited [s].
            steps: Steps of v at each point, at most.
            tol: Largest task error at each point [m, rad].

        Returns:
            The joints up to the last point that was reached, and a message if that is not the last of the path.

        Raises:
            SingularError: The task is singular at q.
            InputError: Wrong shapes.
        """
        times = vector(times, None, "the times")
        if steps < 1:
            raise InputError(f"there must be at least one step at each point, got {steps}")
        walker = _Walker(atlas, atlas.start(q), tol)
        points, rows, message = [], [], ""
        for k, t in enumerate(times.tolist()):
            z = path(t).z
            if message := walker.go(z, np.zeros(walker.chart.r)):
                message = f"point {k} of {len(times)}, at {t:g} s, was not reached: {message}"
                break
            for _ in range(steps):
                dv = self.step(t, walker.q, walker.chart)
                # Where the self-motion comes to an end, the point itself is reached all the same.
                if np.abs(dv).max(initial=0.0) < SETTLED * self.longest or walker.go(z, dv):
                    break
            points.append(z)
            rows.append((walker.q, walker.chart.v(walker.q), len(walker.charts) - 1))
        q_path, v_path, numbers = zip(*rows, strict=True) if rows else ((), (), ())
        reached = len(rows)
        return JointPath(
            q=frozen_copy(np.reshape(q_path, (reached, walker.chart.n))),
            z=frozen_copy(np.reshape(points, (reached, atlas.task.size))),
            v=frozen_copy(np.reshape(v_path, (reached, walker.chart.r))),
            chart=np.array(numbers, dtype=np.int64),
            charts=tuple(walker.charts),
            residual=walker.residual,
            iterations=walker.iterations,
            message=message,
        )


class _Walker:
    """Position of the robot on its path, and the effort to get there."""

    def __init__(self, atlas: Atlas, chart: Chart, tol: float) -> None:
        self.atlas, self.tol = atlas, tol
        self.charts, self.q = [chart], chart.q_bar
        self.residual, self.iterations = 0.0, 0

    @property
    def chart(self) -> Chart:
        return self.charts[-1]

    def go(self, z: Point, dv: SelfMotionVector) -> str:
        """Walk to z and by dv, or stay where that is not possible; the reason is returned."""
        try:
            way = self.atlas.follow(self.q, z[None], v=self.chart.v(self.q) + dv, chart=self.chart, tol=self.tol)
        except SingularError as error:
            return str(error)
        self.iterations += way.iterations
        if way.complete:
            self.q = way.q[0]
            self.charts += way.charts[1:]
            self.residual = max(self.residual, way.residual)
        return way.message
