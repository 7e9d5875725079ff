"""Many states at once: control torques, and inverse kinematics on a chart, from tables and into tables.

States are evaluated one after the other. A compiled step is mostly Pinocchio's passes, which cannot be taken together;
doing the algebra of all states at once was tried, and took longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from eos_pin.arrays import Array, Matrix, VectorLike, numbers
from eos_pin.charts import Chart
from eos_pin.controllers import Controller
from eos_pin.errors import InputError, InverseError

#: A number for each state, and a row of joints for each.
Numbers: TypeAlias = Float[np.ndarray, " K"]
JointTable: TypeAlias = Float[np.ndarray, "K n"]
#: What a caller may hand over where a table is meant.
TableLike: TypeAlias = Array | Sequence[VectorLike]


class Inverses(NamedTuple):
    """Joints for many task points and self-motion coordinates.

    Attributes:
        q: Joints [rad or m]; NaN where none were found, (K, n).
        found: Whether they were, (K,).
        residual: Task error that is left, the largest entry of each [m, rad], (K,).
    """

    q: JointTable
    found: Bool[Array, " K"]
    residual: Numbers


def control_torques(
    controller: Controller, t: float | VectorLike, q: TableLike, dq: TableLike, *, memory: Any = None
) -> JointTable:
    """Joint torques of a controller in many states [N m or N].

    Args:
        controller: The controller.
        t: Time of the states [s], one for all or (K,).
        q: Joints, (K, n).
        dq: Joint velocities, (K, n).
        memory: What the controller remembers: one memory for all states, or a list with one for each. By default each
            state is the start of a run, on the chart based at it.

    Raises:
        InputError: Wrong shapes, or not finite.
        SingularError: The task is singular in a state that is to be the base of a chart.
    """
    robot = getattr(controller, "robot", None)
    q = _table(q, None, None if robot is None else robot.n, "q")
    dq = _table(dq, len(q), q.shape[1], "dq")
    times = np.atleast_1d(numbers(t, "t"))
    if times.shape not in ((1,), (len(q),)) or not np.isfinite(times).all():
        raise InputError(f"t must be one finite time, or one for each of the {len(q)} states; got shape {times.shape}")
    times = np.broadcast_to(times, len(q))
    if memory is None:
        memory = [controller.start(*state) for state in zip(times.tolist(), q, dq, strict=True)]
    memories = memory if isinstance(memory, list) else [memory] * len(q)
    if len(memories) != len(q):
        raise InputError(f"there must be one memory, or one for each of the {len(q)} states; got {len(memories)}")
    states = zip(times.tolist(), q, dq, memories, strict=True)
    return np.array([controller.torque(*state) for state in states]).reshape(q.shape)


def inverse_kinematics(
    chart: Chart, z: TableLike, v: TableLike, *, tol: float = 1e-10, max_iterations: int = 20
) -> Inverses:
    """Joints at many task points and self-motion coordinates of one chart; Eqs. (13), (22).

    Each by `Chart.inverse`; a point that is not found leaves the others as they are.

    Args:
        chart: The chart.
        z: Task points, (K, size).
        v: Self-motion coordinates, (K, r).
        tol: Largest task error that is left [m, rad].
        max_iterations: Newton steps allowed at one point.

    Raises:
        InputError: Wrong shapes, or not finite.
    """
    z = _table(z, None, chart.task.size, "z")
    v = _table(v, len(z), chart.r, "v")
    q, residual = np.full((len(z), chart.n), np.nan), np.empty(len(z))
    for k, point in enumerate(zip(z, v, strict=True)):
        try:
            found = chart.inverse(*point, tol=tol, max_iterations=max_iterations)
            q[k], residual[k] = found.q, found.residual
        except InverseError as error:
            residual[k] = error.residual
    return Inverses(q, residual <= tol, residual)


def _table(values: TableLike, rows: int | None, columns: int | None, name: str) -> Matrix:
    """Finite float array of two dimensions; None for any number of rows or columns."""
    table = numbers(values, name)
    wanted = rows, columns
    if table.ndim != 2 or any(size not in (None, got) for size, got in zip(wanted, table.shape, strict=True)):
        shape = ", ".join(letter if size is None else str(size) for size, letter in zip(wanted, "Kn", strict=True))
        raise InputError(f"{name} must be of shape ({shape}), got {table.shape}")
    if not np.isfinite(table).all():
        raise InputError(f"{name} must be finite; row {np.flatnonzero(~np.isfinite(table).all(axis=1))[0]} is not")
    return table
