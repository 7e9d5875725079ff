"""Joints that were recorded elsewhere, as a `Result`: task path, self-motion, drift of each round, use of limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from eos_pin._arrays import Array, Vector, checked, nearest, number
from eos_pin.charts.atlas import Atlas
from eos_pin.errors import InputError, SingularError
from eos_pin.simulation._recorder import check_run, joint_run
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task

#: Points at which a path is compared with itself.
POINTS = 4096
#: Mean square by which a path may miss itself a round later, relative to that of points that have nothing in common;
#: and that by which it must have done so in between.
SAME, OTHER = 0.01, 0.2
#: Part of a sampling step within which two times are the same.
SAME_TIME = 1e-3


@checked
def analyze(
    task: Task,
    t: Float[Array, " T"],
    q: Float[Array, "T n"],
    *,
    dq: Float[Array, "T n"] | None = None,
    period: float | None = None,
    source: str = "",
) -> Result:
    """Result of joints recorded elsewhere: their task path, v along it, drift in each round, and use of limits.

    Joints at exact multiples of the period are interpolated, so that drift is not that of the sampling. No error and
    no torque is known; both are NaN.

    Args:
        task: The task.
        t: Times, increasing [s].
        q: Joints [rad or m]; angles of continuous joints must not jump.
        dq: Joint velocities; by default differences of the joints.
        period: Time of one round [s]; by default it is found, where the task path repeats at least once.
        source: Where the joints are from, for the provenance.

    Raises:
        InputError: Wrong shapes, or times that do not increase.
        SingularError: The task is singular in the first posture.
    """
    if len(t) < 2 or q.shape != (len(t), task.robot.n) or not (np.diff(t) > 0.0).all():
        raise InputError(
            f"at least two rows of {task.robot.n} joints with increasing times are needed, got {q.shape} for {len(t)} "
            "times"
        )
    t, robot = t - t[0], task.robot
    check_run(robot.n, len(t), float(t[-1]), None)
    joints, step = CubicSpline(t, q), float(np.median(np.diff(t)))
    if period is None:
        period = round_of(task, t, q)
        rounds = "found" if math.isfinite(period) else "none found"
    else:
        period, rounds = number(period, "the period", above=0.0), "given"
    speeds = joints(t, 1) if dq is None else dq
    if math.isfinite(period):
        exact = period * np.arange(1, int(t[-1] / period + 1e-9) + 1)
        exact = exact[(np.abs(t[nearest(t, exact)] - exact) > SAME_TIME * step) & (exact < t[-1])]
        where = np.searchsorted(t, exact)
        speeds = np.insert(speeds, where, CubicSpline(t, speeds)(exact), axis=0)
        q, t = np.insert(q, where, joints(exact), axis=0), np.insert(t, where, exact)
    info = {
        "controller": {"kind": "Log"}, "arguments": {"kind": "log", "source": source, "rounds": rounds},
        "cpu_seconds": math.nan,
    }  # fmt: skip
    z = np.full((len(t), task.size), math.nan)
    return joint_run(
        task,
        t,
        q,
        z,
        dq=speeds,
        period=period,
        info=info,
        ddq=joints(t, 2),
        **_charted(task, q, speeds),
    )


def round_of(task: Task, t: Vector, q: Float[Array, "T n"]) -> float:
    """Time in which the task path repeats [s]; infinite where it does not do so within half of the time.

    Args:
        task: The task.
        t: Times [s].
        q: Joints.
    """
    path = CubicSpline(t, task.kinematics.value(np.ascontiguousarray(q)))
    count = min(POINTS, 4 * len(t))
    grid = np.linspace(t[0], t[-1], count)
    z = path(grid)
    z -= z.mean(axis=0)
    spread = 2.0 * float((z**2).sum(axis=1).mean())
    if not spread > 1e-12:
        return math.inf
    # Mean squares of z(t + lag) − z(t) over all that overlaps, from the autocorrelation.
    squares = (z**2).sum(axis=1)
    spectrum = np.fft.rfft(z, 2 * count, axis=0)
    products = np.fft.irfft((spectrum * spectrum.conj()).sum(axis=1), 2 * count)[:count]
    overlap = np.arange(count, 0, -1)
    ends = np.cumsum(squares)[::-1], np.cumsum(squares[::-1])[::-1]
    missed = (ends[0] + ends[1] - 2.0 * products) / overlap / spread
    lags = missed[: count // 2 + 2]
    apart = int(np.argmax(lags > OTHER))
    near = [k for k in range(max(apart, 1), len(lags) - 1) if lags[k] <= SAME and lags[k - 1] >= lags[k] <= lags[k + 1]]
    if not apart or not near:
        return math.inf
    step = float(grid[1] - grid[0])

    def miss(lag: float) -> float:
        times = np.linspace(t[0], t[-1] - lag, count)
        missed = ((path(times + lag) - path(times)) ** 2).sum(axis=1)
        # The better half: a start from rest, or a stop, is no part of a round.
        return float(np.partition(missed, count // 2)[: count // 2].mean())

    bounds = ((near[0] - 1) * step, min((near[0] + 1) * step, float(t[-1] - t[0])))
    return float(minimize_scalar(miss, bounds=bounds, method="bounded", options={"xatol": 1e-10}).x)


def _charted(task: Task, q: Float[Array, "T n"], dq: Float[Array, "T n"]) -> dict[str, Any]:
    """Number of the chart and self-motion of each posture, chart after chart."""
    atlas = Atlas(task)
    chart = atlas.start(q[0])
    _, jacobians = task.kinematics.linearize(np.ascontiguousarray(q))
    number, numbers = 0, np.zeros(len(q), dtype=np.int64)
    v, dv = np.zeros((2, len(q), chart.r))
    for k, (row, J) in enumerate(zip(q, jacobians, strict=True)):
        try:
            if not atlas._holds(chart, J, row):
                chart, number = atlas.next(chart, row), number + 1
        except SingularError:
            # The one there is serves until the task has full rank again.
            pass
        numbers[k], v[k], dv[k] = number, chart._v(row), chart._dv(dq[k])
    return {"chart": numbers, "v": v, "dv": dv}
