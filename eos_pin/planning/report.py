"""Figures of a plan: measured on the plan itself, at its way points and ten times as densely between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array
from eos_pin.planning.grid import Grid
from eos_pin.planning.plans import Plan
from eos_pin.planning.problem import BANDS, Problem
from eos_pin.tasks.base import Task
from eos_pin.trajectories.through import sampled

#: How many times as densely as its knots a plan is measured.
DENSELY = 10


def figures(
    plan: Plan, grid: Grid, problem: Problem, seconds: float, *, jumps: Sequence[int] = (), seed: int = 0
) -> dict[str, Any]:
    """Measures of a plan, in plain values.

    Args:
        plan: The plan.
        grid: The points it was planned at.
        problem: The problem that was solved.
        seconds: Time that planning took.
        jumps: Points after which the joints jump.
        seed: Seed of the search.
    """
    robot, task = plan.robot, plan.task
    at_marks = grid.at_marks(plan.q[: len(grid.Z)])
    steps = np.diff(np.concatenate((at_marks, plan.q[-1:])) if plan.closed else at_marks, axis=0)
    counted = np.abs(steps).max(axis=1)
    if jumps:
        counted[[grid.waypoint(k) for k in jumps]] = 0.0
    dense, times = plan.q, plan.times
    if not jumps:
        parts = np.linspace(0.0, 1.0, DENSELY, endpoint=False)
        times = (plan.times[:-1, None] + parts * np.diff(plan.times)[:, None]).ravel()
        times = np.append(times, plan.times[-1])
        dense = plan.joints(times)
    z = sampled(plan.path, times)
    error = float(np.abs(problem.manifold.linearize(dense.T, z.T)[0]).max())
    motion = np.linalg.norm(np.diff(dense, axis=0), axis=1)
    if jumps:
        motion[list(jumps)] = 0.0
    room = np.minimum(dense - robot.lower, robot.upper - dense).min()
    info: dict[str, Any] = {
        "status": plan.status,
        "message": "",
        "closed": plan.closed,
        "waypoints": grid.count,
        "points": len(grid.Z),
        "reconfigurations": len(jumps),
        "winding": {joint.name: int(k) for joint, k in zip(robot.joints, plan.winding, strict=True) if k},
        "jumps": [grid.waypoint(k) for k in jumps],
        "task_error_max": error,
        "joint_step_max": float(counted.max()),
        "joint_motion": float(motion.sum()),
        "cost": float((problem.weights * np.diff(plan.q, axis=0) ** 2 / np.diff(plan.times)[:, None]).sum()),
        "limit_distance_min": float(room) if np.isfinite(room) else None,
        "clearance_min": None,
        "clearance_between_min": None,
        "switches": switches(task, plan.q),
        "duration": plan.end - plan.start,
        "velocity_part_max": _velocity(plan),
        "seed": seed,
        "seconds": seconds,
    }
    if problem.bands is not None:
        used = BANDS * np.sqrt(np.square(problem.used(dense.T, z.T)).sum(axis=2)).max(axis=0)
        info["tolerance_used"] = dict(zip(problem.bands.bands, used.tolist(), strict=True))
        if used.max() > 1.0:
            info["message"] = f"between way points {used.max():.4g} times a tolerance is used"
    if problem.clearances is not None and len(problem.clearances):
        info["clearance_min"] = float(problem.clearances(at_marks.T).min())
        between = problem.clearances(dense.T)
        row = int(between.argmin())
        info["clearance_between_min"] = float(between[row])
        if between[row] < problem.gap:
            info["message"] = f"between way points, at {times[row]:.4g} s, the clearance falls to {between[row]:.3g} m"
    return info


def _velocity(plan: Plan) -> float | None:
    """Largest part of a velocity limit that is used; None without limits."""
    rate = np.abs(np.diff(plan.q, axis=0)) / np.diff(plan.times)[:, None]
    part = float((rate / plan.robot.velocity).max())
    return part if part > 0.0 and np.isfinite(part) else None


def switches(task: Task, q: Float[Array, "K n"], threshold: float = 0.5) -> int:
    """Number of chart changes of a controller on this path at a threshold of the margin."""
    _, J = task.kinematics.linearize(q)
    Q = np.linalg.qr(J.transpose(0, 2, 1))[0]
    base, count = 0, 0
    for k in range(len(q)):
        if np.linalg.svd(Q[k].T @ Q[base], compute_uv=False)[-1] <= threshold:
            base, count = k, count + 1
    return count
