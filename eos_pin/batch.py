"""Many states at once: control torques, and inverse kinematics on a chart.

The algebra is done for all states together; Pinocchio's passes stay one by one, and are most of what is left. Torques
are those of `EosController.torque` to rounding, joints those of `Chart.inverse` to the tolerance asked for, in half to
three quarters of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from eos_pin.arrays import Array, Matrix, VectorLike, numbers
from eos_pin.charts import DENSE_SOLVE, Chart
from eos_pin.controllers import Controller, EosController
from eos_pin.errors import InputError, InverseError
from eos_pin.linear import haste
from eos_pin.objectives import Track
from eos_pin.targets import Trajectory

#: A number for each state, and a row of joints, of the task or of the self-motion for each.
Numbers: TypeAlias = Float[np.ndarray, " K"]
JointTable: TypeAlias = Float[np.ndarray, "K n"]
TaskTable: TypeAlias = Float[np.ndarray, "K size"]
SelfMotionTable: TypeAlias = Float[np.ndarray, "K r"]
#: What a caller may hand over where a table is meant.
TableLike: TypeAlias = Array | Sequence[VectorLike]

#: Fewer states than this are as quick one by one.
FEW = 8


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

    It is quick for an `EosController` and many states on one chart; whatever else is evaluated state by state.

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
    groups: dict[int, list[int]] = {}
    for k, each in enumerate(memories):
        groups.setdefault(id(each), []).append(k)
    tau = np.empty_like(q)
    for rows in groups.values():
        states = times[rows], q[rows], dq[rows]
        if type(controller) is EosController and len(rows) >= FEW and q.shape[1] <= DENSE_SOLVE:
            tau[rows] = _eos_torques(controller, *states, memories[rows[0]])
        else:
            tau[rows] = _one_by_one(controller, *states, memories[rows[0]])
    return tau


def inverse_kinematics(
    chart: Chart, z: TableLike, v: TableLike, *, tol: float = 1e-10, max_iterations: int = 20
) -> Inverses:
    """Joints at many task points and self-motion coordinates of one chart; Eqs. (13), (22).

    Newton's method from the base point for all at once; where it does not converge, `Chart.inverse` walks there.

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
    q, residual = _newton(chart, z, v, tol, max_iterations)
    for k in np.flatnonzero(~(residual <= tol)):
        try:
            one = chart.inverse(z[k], v[k], tol=tol, max_iterations=max_iterations)
            q[k], residual[k] = one.q, one.residual
        except InverseError as error:
            q[k], residual[k] = np.nan, error.residual
    return Inverses(q, residual <= tol, residual)


def _one_by_one(controller: Controller, t: Numbers, q: JointTable, dq: JointTable, memory: Any) -> JointTable:
    return np.array([controller.torque(*state, memory) for state in zip(t.tolist(), q, dq, strict=True)])


def _eos_torques(controller: EosController, t: Numbers, q: JointTable, dq: JointTable, memory: Any) -> JointTable:
    """What `EosController.torque` does, for states on one chart."""
    if memory.carried is not None:
        return _one_by_one(controller, t, q, dq, memory)
    task, chart = controller.task, memory.chart
    z, J, dz, drift = map(np.array, zip(*(task.at(*state) for state in zip(q, dq, strict=True)), strict=True))
    z_d, dz_d, ddz_d = _targets(controller.reference, t)
    error = np.array([task.minus(*pair) for pair in zip(z_d, z, strict=True)])
    F_z = controller.kp * error - controller.kd * dz - drift  # Eqs. (33), (36)
    if controller.feedforward:
        F_z += controller.kd * dz_d + ddz_d
    A = np.empty((len(q), chart.n, chart.n))
    A[:, : chart.m], A[:, chart.m :] = J, chart.Vt
    try:
        H = np.linalg.inv(A)
    except np.linalg.LinAlgError:
        return _one_by_one(controller, t, q, dq, memory)
    F = np.hstack((F_z, _self_motion(controller, t, q, dq, chart)))
    ddq = np.einsum("kij,kj->ki", H, F)
    model = controller._model
    tau = np.array([model.inverse_dynamics(*row) for row in zip(q, dq, ddq, strict=True)])
    # Wherever a direction might fade out of the law the controller itself decides.
    hastes = np.array([haste(row) for row in dq])
    fading = np.einsum("kij,kij->k", H, H) * hastes >= memory.drive.most
    if fading.any():
        tau[fading] = _one_by_one(controller, t[fading], q[fading], dq[fading], memory)
    return tau


def _self_motion(controller: EosController, t: Numbers, q: JointTable, dq: JointTable, chart: Chart) -> SelfMotionTable:
    """Self-motion part of F*, (K, r)."""
    law = controller.self_motion
    if type(law) is not Track:
        return np.array([law.acceleration(*state, chart) for state in zip(t.tolist(), q, dq, strict=True)])
    kp, kd, reference = law.law(chart.r)
    v_d, dv_d, ddv_d = _targets(reference, t)
    v, dv = chart.v_bar + (q - chart.q_bar) @ chart.V, dq @ chart.V
    return ddv_d + kd * (dv_d - dv) + kp * (v_d - v)  # Eqs. (36), (45)


def _targets(reference: Trajectory, t: Numbers) -> tuple[Matrix, ...]:
    """Targets at many times; each time that occurs is asked for once."""
    times, rows = np.unique(t, return_inverse=True)
    return tuple(np.array(part)[rows] for part in zip(*map(reference, times.tolist()), strict=True))


def _newton(
    chart: Chart, z: TaskTable, v: SelfMotionTable, tol: float, max_iterations: int
) -> tuple[JointTable, Numbers]:
    """What `newton` does, for many points: joints and residuals; NaN or large where it ends early."""
    task, U = chart.task, chart.U
    base = chart.q_bar + chart.basis.apply((v - chart.v_bar).T).T
    q, u = base.copy(), np.zeros((len(z), chart.m))
    residual = np.full(len(z), np.inf)
    left = np.arange(len(z))
    for _ in range(max_iterations + 1):
        if not left.size:
            break
        points, J = map(np.array, zip(*map(task.linearize, q[left]), strict=True))
        error = np.array([task.minus(*pair) for pair in zip(points, z[left], strict=True)])
        last, now = residual[left], np.abs(error).max(axis=1)
        residual[left] = now
        GU = J @ U
        # det G'U > 0 at the base point, so it is positive on all of the chart.
        on = (now > tol) & (now < last) & (np.linalg.det(GU) > 0.0)
        left = left[on]
        u[left] += np.linalg.solve(GU[on], error[on][:, :, None])[:, :, 0]
        q[left] = base[left] - u[left] @ U.T
    return q, residual


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
