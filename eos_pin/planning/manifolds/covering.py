"""A covering of a self-motion manifold with more than one redundant joint: postures, their charts, their neighbours."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin.charts.chart import Chart
from eos_pin.errors import SingularError
from eos_pin.tasks.base import Task
from eos_pin.tasks.batch import Manifold

#: A posture is new where no other is closer than this, in units of the resolution; neighbours are no further apart.
CLOSEST, FURTHEST = 0.6, 1.5
#: Random directions that are tried from each posture besides those along its chart's axes.
DIRECTIONS = 4
#: Length of steps at which the search for the least value of a criterion ends [rad or m].
FINEST = 1e-7


@dataclass(frozen=True, eq=False)
class Covering:
    """Postures at one task point, within limits and clear of collision, spread evenly.

    Attributes:
        task: The task.
        q: Joints, (K, n).
        neighbours: Pairs of postures that are close, by number, (L, 2).
        complete: Whether all was covered that is connected, within limits, to the postures the search began from;
            otherwise the count of postures ran out.
        resolution: Distance of neighbours that was asked for [rad or m].
    """

    task: Task
    q: Float[Array, "K n"]
    neighbours: Int[Array, "L 2"]
    complete: bool
    resolution: float

    def chart(self, i: int) -> Chart:
        """Chart based at posture i."""
        return Chart.from_base(self.task, self.q[i])

    @property
    def components(self) -> tuple[Int[Array, " k"], ...]:
        """Numbers of the postures of each connected part."""
        parent = list(range(len(self.q)))

        def root(i: int) -> int:
            while parent[i] != i:
                parent[i] = i = parent[parent[i]]
            return i

        for a, b in self.neighbours.tolist():
            parent[root(a)] = root(b)
        roots = np.array([root(i) for i in range(len(self.q))], dtype=np.int64)
        return tuple(np.flatnonzero(roots == each) for each in dict.fromkeys(roots.tolist()))


def covering(
    task: Task,
    z: Vector,
    starts: Float[Array, "S n"],
    limits: tuple[JointVector, JointVector],
    collision: Callable[[JointVector], bool] | None,
    resolution: float,
    most: int,
) -> Covering:
    """Spread postures over the manifold, from each to its surroundings along the axes of its chart.

    Args:
        task: The task.
        z: Task point.
        starts: Postures there, within limits.
        limits: Least and largest value of each joint.
        collision: Whether the robot collides at joints.
        resolution: Distance of neighbouring postures [rad or m].
        most: Most postures.
    """
    kinematics, (lower, upper) = task.kinematics, limits
    whole = np.where(kinematics.revolute & ~np.isfinite(lower) & ~np.isfinite(upper), 2.0 * np.pi, 0.0)
    random = np.random.default_rng(0)
    kept = np.empty((most, task.robot.n))
    count, waiting = 0, deque(starts)
    complete = True
    while waiting:
        q = waiting.popleft()
        if count and _distance(kept[:count] - q, whole).min() < CLOSEST * resolution:
            continue
        if collision is not None and collision(q):
            continue
        if count == most:
            complete = False
            break
        try:
            V = Chart.from_base(task, q).V
        except SingularError:
            continue
        kept[count], count = q, count + 1
        others = random.normal(size=(DIRECTIONS, V.shape[1]))
        others /= np.linalg.norm(others, axis=1)[:, None]
        ways = np.concatenate((np.eye(V.shape[1]), -np.eye(V.shape[1]), others))
        # Steps beyond the limits end at them.
        found = kinematics.project(q + resolution * ways @ V.T, z, lower=lower, upper=upper, most=30)
        near = _distance(found.q - q, np.zeros(len(q))) < FURTHEST * resolution
        waiting.extend(found.q[found.found & near])
    q = kept[:count].copy()
    return Covering(task, q, _neighbours(q, whole, FURTHEST * resolution), complete, resolution)


def scattered(
    cover: Covering,
    z: Vector,
    count: int,
    limits: tuple[JointVector, JointVector],
    collision: Callable[[JointVector], bool] | None,
    random: np.random.Generator,
) -> Float[Array, "count n"]:
    """Random postures about those of a covering, within the limits."""
    q = cover.q[random.integers(len(cover.q), size=count)]
    V = Manifold(cover.task).null(q.T, z[:, None])
    ways = np.einsum("knr,kr->kn", V, cover.resolution * random.uniform(-0.5, 0.5, (count, V.shape[2])))
    found = cover.task.kinematics.project(q + ways, z, lower=limits[0], upper=limits[1], most=30)
    good = found.found & (_distance(found.q - q, np.zeros(q.shape[1])) < FURTHEST * cover.resolution)
    if collision is not None:
        good[good] = [not collision(x) for x in found.q[good]]
    return np.where(good[:, None], found.q, q)


def descended(
    cover: Covering,
    q: JointVector,
    z: Vector,
    criterion: Callable[[JointVector], float],
    limits: tuple[JointVector, JointVector],
    collision: Callable[[JointVector], bool] | None,
) -> tuple[float, JointVector]:
    """Least value of a criterion near a posture of a covering, and where it is.

    Steps go along the axes of the chart where each ends, within the limits, and are halved where none leads down: the
    criterion may have edges.
    """
    kinematics, (lower, upper) = cover.task.kinematics, limits
    least, step = criterion(q), cover.resolution
    while step > FINEST:
        try:
            V = Chart.from_base(cover.task, q).V
        except SingularError:
            break
        ways = step * np.concatenate((V.T, -V.T))
        found = kinematics.project(q + ways, z, lower=lower, upper=upper, most=30)
        near = _distance(found.q - q, np.zeros(len(q))) < FURTHEST * step
        rows = [x for x in found.q[found.found & near] if collision is None or not collision(x)]
        values = [criterion(x) for x in rows]
        if values and min(values) < least:
            i = int(np.argmin(values))
            least, q = values[i], rows[i]
        else:
            step *= 0.5
    return least, q


def _distance(difference: Array, whole: JointVector) -> Vector:
    """Lengths of differences, without whole turns of joints that have no limits."""
    turns = np.round(np.divide(difference, whole, out=np.zeros_like(difference), where=whole > 0.0))
    difference = difference - whole * turns
    return np.sqrt((difference * difference).sum(axis=1))


def _neighbours(q: Float[Array, "K n"], whole: JointVector, furthest: float) -> Int[Array, "L 2"]:
    """Pairs of postures that are no further apart."""
    if len(q) < 2:
        return np.empty((0, 2), dtype=np.int64)
    # The tree knows periods only where all coordinates are in a box that begins at zero.
    box = np.where(whole > 0.0, whole, 1e6)
    inside = np.where(whole > 0.0, np.mod(q, np.where(whole > 0.0, whole, 1.0)), q - q.min(axis=0))
    pairs = cKDTree(np.minimum(inside, np.nextafter(box, 0.0)), boxsize=box).query_pairs(
        furthest, output_type="ndarray"
    )
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].astype(np.int64)
