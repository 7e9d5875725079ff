"""Whether a closed task path has closed joints within limits, judged without the planner.

Postures at many points of the path are found from random ones alone. Two of neighbouring points are connected where the
posture halfway between them, put on the manifold halfway, is near and within limits. A path is solvable where a posture
leads back to itself through all points. Nothing is traced, carried over, thinned or refined as in the planner; both use
Newton's method for the task and limits of joints.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from eos_pin import Task
from eos_pin.tasks.batch import Manifold, ranges
from eos_pin.trajectories.base import Trajectory
from eos_pin.trajectories.through import sampled

TAU = 2.0 * np.pi
#: Points of the path, postures at each, rounds of random starts, and neighbours that are looked at.
POINTS, POSTURES, ROUNDS, NEIGHBOURS = 192, 500, 6, 60
#: Longest step of a joint from point to point [rad], and room that is kept from limits as in a plan.
LONGEST, MARGIN = 0.5, 0.01


def judged(task: Task, path: Trajectory, *, turns: bool = True, seed: int = 1, count: int = POSTURES) -> str:
    """Whether a path is solvable, in words, and how far postures lead where it is not.

    Args:
        task: The task.
        path: Closed path, from 0 to its period.
        turns: Whether postures that are whole turns of joints apart count as one, as far as limits have room.
        seed: Seed of the random postures.
        count: Postures at each point.
    """
    random, manifold = np.random.default_rng(seed), Manifold(task)
    lower, upper = (end + sign * MARGIN for end, sign in zip(ranges(task.robot), (1.0, -1.0), strict=True))
    revolute = np.array([joint.kind != "prismatic" for joint in task.robot.joints])
    free = revolute & (upper - lower >= TAU - 4.0 * MARGIN) & turns
    least, most = np.where(free, -np.pi, lower), np.where(free, np.pi, upper)
    box = np.where(free, TAU, 1e6)

    def home(Q: np.ndarray) -> np.ndarray:
        return Q - TAU * np.round(Q / TAU) * free[:, None]

    def rows(Q: np.ndarray) -> np.ndarray:
        return np.where(free[:, None], np.minimum(np.mod(Q, TAU), TAU - 1e-12), Q + 5e5).T

    def within(Q: np.ndarray) -> np.ndarray:
        return np.asarray(((lower[:, None] <= Q) & (upper[:, None] >= Q)).all(axis=0))

    step = path.period / POINTS
    clock = np.arange(POINTS) * step
    points, halves = sampled(path, clock), sampled(path, clock + 0.5 * step)
    layers = []
    for z in points:
        found = np.empty((len(lower), 0))
        for _ in range(ROUNDS):
            starts = random.uniform(least, most, (count, len(lower))).T
            Q, good = manifold.search(starts, np.repeat(z[:, None], count, axis=1), (lower, upper))
            found = np.hstack((found, home(Q[:, good])))
            if found.shape[1] >= count:
                break
        layers.append(found[:, within(found)][:, :count])
    if not all(Q.shape[1] for Q in layers):
        return f"no postures at {sum(not Q.shape[1] for Q in layers)} of {POINTS} points"
    first = int(np.argmin([Q.shape[1] for Q in layers]))
    reached = np.eye(layers[first].shape[1], dtype=bool)
    for k in range(POINTS):
        i = (first + k) % POINTS
        here, there = layers[i], layers[(i + 1) % POINTS]
        near = min(NEIGHBOURS, there.shape[1])
        distance, end = cKDTree(rows(there), boxsize=box).query(
            rows(here), k=near, p=np.inf, distance_upper_bound=LONGEST
        )
        start, end = np.repeat(np.arange(here.shape[1]), near), end.ravel()
        good = np.isfinite(distance.ravel())
        start, end = start[good], end[good]
        motion = there[:, end] - here[:, start]
        motion -= TAU * np.round(motion / TAU) * free[:, None]
        middle = here[:, start] + 0.5 * motion
        on, found = manifold.project(middle, np.repeat(halves[i][:, None], len(start), axis=1), iterations=10)
        good = found & within(home(on))
        good &= np.abs(on - middle).max(axis=0) <= 0.3 * np.abs(motion).max(axis=0) + 0.02
        shape = (here.shape[1], there.shape[1])
        edges = csr_matrix((np.ones(good.sum(), np.float32), (start[good], end[good])), shape=shape)
        reached = (edges.T @ reached.astype(np.float32)) > 0.0
        if not reached.any():
            return f"none: from point {first} postures lead through {k} of {POINTS} points"
    back = int(np.diag(reached).sum())
    if not back:
        return f"none: of {len(reached)} postures none leads back to itself"
    return (
        "whole turns only" if free.any() and judged(task, path, turns=False, count=4 * count)[:4] == "none" else "one"
    )
