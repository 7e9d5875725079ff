"""`Plan`: joints over time along a whole task path, exact at every time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lapack

from eos_pin._arrays import Array, brief, by_value, checked, frozen_copy, number
from eos_pin._files import write_atomically
from eos_pin.errors import InputError, PlanError, ResultError
from eos_pin.planning.curves import spline
from eos_pin.planning.identity import identity
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.tasks.batch import Manifold
from eos_pin.tasks.stacked import task_from_description
from eos_pin.trajectories.bags import JointMotion, write_bag
from eos_pin.trajectories.base import JointTarget, Target, Trajectory
from eos_pin.trajectories.spline import cubic_at, cubics_at
from eos_pin.trajectories.storage import described, path_from
from eos_pin.trajectories.through import WaypointPath, sampled
from eos_pin.trajectories.timed import Pace, TimedPath

TAU = 2.0 * np.pi
#: Largest task error of the joints [m, rad], and the most Newton steps.
EXACT, MOST_STEPS = 1e-12, 12
FORMAT = 1


@brief("task", "status", "closed", "start", "end", "q")
@by_value
@dataclass(frozen=True, eq=False)
class Plan:
    """Joints q(t) along a task path, with G(q(t)) = z(t) at every time and continuous accelerations.

    Between its knots q = S(t) + C(t) λ, where S is the cubic spline of the joints at the knots, C that of the
    transposed Jacobians there, and λ solves G(q) = z(t): close to the shortest correction, on no particular chart, so
    that q, dq and ddq are continuous wherever those of the path are. At a reconfiguration they jump, in the middle
    between two knots: each side goes on along the path up to there. No controller follows such a plan as a whole.

    Attributes:
        task: The task.
        path: Path that it follows.
        times: Times of the knots [s], (K,); of a closed plan the last knot is the first again.
        q: Joints there, (K, n).
        closed: Whether it repeats.
        status: `"planned"`, or `"interrupted"` where better joints may have been found later.
        info: Facts about the plan, in plain values.
        jumps: Numbers of the knots after which the joints jump.
    """

    task: Task
    path: Trajectory
    times: Float[Array, " K"]
    q: Float[Array, "K n"]
    closed: bool
    status: str = "planned"
    info: Mapping[str, Any] = field(default_factory=dict)
    jumps: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", frozen_copy(self.times))
        object.__setattr__(self, "q", frozen_copy(self.q))
        wanted = len(self.times), self.task.robot.n
        if self.q.shape != wanted:
            raise InputError(f"a plan of {wanted[0]} times needs joints of shape {wanted}, got {self.q.shape}")

    @property
    def robot(self) -> Robot:
        """The robot it is for."""
        return self.task.robot

    @property
    def start(self) -> float:
        """Time of its first knot [s]."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Time of its last knot [s]."""
        return float(self.times[-1])

    @property
    def period(self) -> float:
        """Time after which it repeats [s]; infinite if it does not."""
        return self.end - self.start if self.closed else float("inf")

    @cached_property
    def winding(self) -> Int[Array, " n"]:
        """Whole turns of each joint in a round of a closed plan; zeros unless it may wind."""
        return np.round((self.q[-1] - self.q[0]) * (self.closed / TAU)).astype(np.int64)

    @property
    def jump_times(self) -> tuple[float, ...]:
        """Times at which the joints jump [s]."""
        return tuple(float(0.5 * (self.times[k] + self.times[k + 1])) for k in self.jumps)

    def check_continuous(self) -> None:
        """Refuse joints that jump.

        Raises:
            PlanError: The plan has reconfigurations.
        """
        if self.jumps:
            times = ", ".join(f"{t:.4g}" for t in self.jump_times)
            raise PlanError(
                f"the joints of this plan jump {len(self.jumps)} times, at {times} s, which no controller can follow. "
                "Stop there, move the robot to the joints after the jump, and follow each part by itself; or plan "
                "without reconfigurations"
            )

    @property
    def pace(self) -> Pace | None:
        """Place on the path it was planned on over time; None in the time it was planned in."""
        return self.path.pace if isinstance(self.path, TimedPath) else None

    @property
    def untimed(self) -> Trajectory:
        """The path in the time it was planned in."""
        return self.path.path if isinstance(self.path, TimedPath) else self.path

    # -- joints at any time --------------------------------------------------------------------------------------------

    @cached_property
    def _knots(self) -> Array:
        """Times of the knots in the time it was planned in."""
        return np.array(self.times if self.pace is None else self.pace.place(self.times))

    @cached_property
    def _curve(self) -> tuple[Array, Array]:
        """Knots, and coefficients of the splines of joints and transposed Jacobians, (K − 1, 4, n + n m)."""
        knots = self._knots
        J = Manifold(self.task).jacobians(self.q.T, sampled(self.untimed, knots).T).transpose(2, 1, 0)
        values = np.hstack((self.q, J.reshape(len(self.q), -1)))
        if self.closed:
            values[-1] = values[0]
        return spline(knots, values, self.closed, self.jumps, TAU * self.winding)

    def _at(self, t: float) -> tuple[Array, Array, Array, Array, Array, Array]:
        """S, C, and their first and second derivatives."""
        knots, coefficients = self._curve
        rows = cubic_at(knots, coefficients, t)
        n, m = self.q.shape[1], self.task.m
        S, C = rows[:, :n], rows[:, n:].reshape(3, n, m)
        return S[0], C[0], S[1], C[1], S[2], C[2]

    def _wrapped(self, t: float) -> float:
        if self.closed:
            return self.start + (t - self.start) % self.period
        return min(max(t, self.start), self.end)

    def _turned(self, t: Any, inner: Any) -> Any:
        """Whole turns of the rounds before time t, which is `inner` within its round."""
        return np.multiply.outer(np.round((t - inner) / self.period), TAU * self.winding) if self.winding.any() else 0.0

    def __call__(self, t: float) -> JointTarget:
        """Joints, velocities and accelerations at time t [s]; an open plan rests before its start and after its end.

        Raises:
            PlanError: The joints are not on the path between two knots; the plan was made with too few.
        """
        inner = self._wrapped(t if type(t) is float else number(t, "t"))
        s, ds, dds = (inner, 1.0, 0.0) if self.pace is None else self.pace(inner)
        q, dq, ddq = self._own(s, t)
        q, dq, ddq = q + self._turned(t, inner), ds * dq, ds * ds * ddq + dds * dq
        if not self.closed and not self.start <= t <= self.end:
            return JointTarget(q, 0.0 * dq, 0.0 * ddq)
        return JointTarget(q, dq, ddq)

    def _own(self, s: float, t: float) -> tuple[Array, Array, Array]:
        """Joints and their derivatives by the path's own time s; t is for messages."""
        S, C, dS, dC, ddS, ddC = self._at(s)
        # At the end, too, where a path that rests afterwards still moves.
        z, dz, ddz = self.untimed(s)
        q, bend, lu, J = self._on_path(S, C, z, t)
        ahead = dS + dC @ bend
        rate = _solved(lu, dz - J @ ahead)
        dq = ahead + C @ rate
        drift = self.task._at(q, dq).drift
        ahead = dds_plus(ddS, ddC, dC, bend, rate)
        return q, dq, ahead + C @ _solved(lu, ddz - drift - J @ ahead)

    def _on_path(self, S: Array, C: Array, z: Array, t: float) -> tuple[Array, Array, Any, Array]:
        q, bend, last = S, np.zeros(self.task.m), np.inf
        for _ in range(MOST_STEPS):
            z_q, J = self.task._linearize(q)
            error = self.task._minus(z, z_q)
            size = float(np.abs(error).max())
            lu = lapack.dgetrf(J @ C)
            if size <= EXACT or (size < 1e-9 and size > 0.3 * last):
                return q, bend, lu, J
            if not size < 4.0 * last or lu[2]:
                break
            last = size
            bend = bend + _solved(lu, error)
            q = S + C @ bend
        raise PlanError(
            f"the plan leaves its path at {t:.6g} s: between two of its {len(self.times)} knots no joints near them "
            "have the task point. Plan it again with more points"
        )

    @checked
    def joints(self, times: Float[Array, " T"]) -> Float[Array, "T n"]:
        """Joints at many times."""
        inner = np.array([self._wrapped(float(t)) for t in times])
        t = inner if self.pace is None else self.pace.place(inner)
        z = sampled(self.untimed, t).T
        knots, coefficients = self._curve
        rows = cubics_at(knots, coefficients, t)[0]
        n = self.q.shape[1]
        S, C = rows[:, :n], rows[:, n:].reshape(len(t), n, self.task.m)
        manifold = Manifold(self.task)
        q, last = S, np.full(len(t), np.inf)
        for _ in range(MOST_STEPS):
            error, J = manifold.linearize(q.T, z)
            size = np.abs(error).max(axis=0)
            if (size <= EXACT).all() or (size.max() < 1e-9 and (size > 0.3 * last).any()):
                return q + self._turned(times, inner)
            bad = ~np.isfinite(size) | (size > 10.0)
            if bad.any():
                break
            last = size
            step = np.linalg.solve(J.transpose(2, 0, 1) @ C, error.T[:, :, None])
            q = q + (C @ step)[:, :, 0]
        where = float(t[int(np.nan_to_num(size, nan=np.inf).argmax())])
        raise PlanError(f"the plan leaves its path at {where:.6g} s: plan it again with more points")

    @checked
    def at_waypoints(self, count: int | None = None) -> Float[Array, "K n"]:
        """Joints at the way points of its path, a closed path's first once more at its end if `count` has room for it.

        Args:
            count: Number of way points; by default those of the path.
        """
        path = self.untimed
        if not isinstance(path, WaypointPath):
            return self.q
        knots = self._knots
        rows = np.searchsorted(knots, path.times - 1e-9 * knots[-1])
        return self.q[np.minimum(rows, len(self.q) - 1)][:count]

    @checked
    def task_target(self, t: float) -> Target:
        """Target of the task at time t."""
        return self.path(self._wrapped(t))

    # -- identity ------------------------------------------------------------------------------------------------------

    @checked
    def check(self, robot: Robot) -> None:
        """Refuse another robot, tool or payload than those it was planned for.

        Raises:
            PlanError: They differ.
        """
        mine, other = identity(self.robot), identity(robot)
        for what in mine:
            if mine[what] != other[what]:
                raise PlanError(
                    f"the plan was made for {self.robot.name!r} with other {what} than {robot.name!r} has here. Plan "
                    "anew for this robot, tool and payload"
                )

    # -- files -------------------------------------------------------------------------------------------------------

    @checked
    def save(self, path: str | Path) -> Path:
        """Write the plan as .npz.

        Raises:
            InputError: Its path is a function that cannot be stored.
            OutputError: The file cannot be written.
        """
        robot = self.robot
        header = {
            "format": FORMAT,
            "task": self.task.describe(),
            "path": described(self.path),
            "closed": self.closed,
            "status": self.status,
            "info": dict(self.info),
            "jumps": list(self.jumps),
            "robot": {"name": robot.name, "source": robot.source, "options": dict(robot.options)},
            "identity": identity(robot),
        }
        text = json.dumps(header, default=_plain)
        write_atomically(
            path, lambda file: np.savez_compressed(file, header=np.array(text), times=self.times, q=self.q)
        )
        return Path(path)

    @classmethod
    @checked
    def load(cls, path: str | Path, robot: Robot | None = None) -> Plan:
        """Read a plan.

        Args:
            path: The file.
            robot: The robot it is to move; by default the one it was made for is loaded again.

        Raises:
            ResultError: The file is damaged, or no plan.
            PlanError: The plan is for another robot, tool or payload.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                times, q = file["times"], file["q"]
            if header["format"] != FORMAT:
                raise ResultError(f"{path} has version {header['format']} of plans; this version reads {FORMAT}")
            source = header["robot"]
        except ResultError:
            raise
        except Exception as error:
            raise ResultError(f"{path} is no plan, or damaged: {' '.join(str(error).split())}") from error
        if robot is None:
            from eos_pin.robot.loading import load_robot

            if not source["source"]:
                raise ResultError(f"{path} is for a robot that was built in memory; hand it over as `robot`")
            robot = load_robot(source["source"], **source["options"])
        now = identity(robot)
        for what, value in header["identity"].items():
            if now.get(what) != value:
                raise PlanError(
                    f"{path} was planned for {source['name']!r} with other {what} than {robot.name!r} has here. Plan "
                    "anew for this robot, tool and payload"
                )
        task = task_from_description(robot, header["task"])
        trajectory = path_from(task, header["path"])
        jumps = tuple(header.get("jumps", ()))
        return cls(task, trajectory, times, q, header["closed"], header["status"], header["info"], jumps)

    @checked
    def table(self, rate: float = 100.0) -> tuple[Array, Array, Array, Array]:
        """Times, joints, velocities and accelerations at `rate` times a second and both ends."""
        count = max(2, int(np.ceil((self.end - self.start) * rate)) + 1)
        times = np.linspace(self.start, self.end, count)
        # The end of a closed plan is its start; of an open one it is where it still moves.
        rows = [self(float(t)) for t in times]
        q, dq, ddq = (np.array(column) for column in zip(*rows, strict=True))
        return times, q, dq, ddq

    @checked
    def to_csv(self, path: str | Path, *, rate: float = 100.0, derivatives: bool = True) -> Path:
        """Write time, joints, velocities and accelerations by name.

        Args:
            path: The file. Columns are t, a joint's name for its position, and the name with d_ and dd_ before it for
                velocity and acceleration.
            rate: Rows a second [Hz].
            derivatives: Whether velocities and accelerations are written.
        """
        times, q, dq, ddq = self.table(rate)
        names = [joint.name for joint in self.robot.joints]
        columns, header = [times[:, None], q], ["t", *names]
        if derivatives:
            columns += [dq, ddq]
            header += [f"d_{name}" for name in names] + [f"dd_{name}" for name in names]
        table, title = np.hstack(columns), ",".join(header)
        form: dict[str, Any] = {"delimiter": ",", "header": title, "comments": "", "fmt": "%.17g"}
        write_atomically(path, lambda file: np.savetxt(file, table, **form))
        return Path(path)

    @checked
    def to_bag(self, path: str | Path) -> Path:
        """Write the joints over time as a bag of ROS 2; see `write_bag`."""
        return write_bag(path, JointMotion([joint.name for joint in self.robot.joints], *self.table()))


def dds_plus(ddS: Array, ddC: Array, dC: Array, bend: Array, rate: Array) -> Array:
    """Acceleration of S + C λ without the part of λ̈."""
    return ddS + ddC @ bend + 2.0 * dC @ rate


def _solved(lu: Any, right: Array) -> Array:
    return lapack.dgetrs(lu[0], lu[1], right)[0]


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "as_dict"):
        return value.as_dict()
    return str(value)
