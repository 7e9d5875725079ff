"""`Result`: the samples, the outcome and the origin of a run.

A result is arrays over time and plain provenance, nothing that has to be unpickled. It saves to one `.npz`, and
re-checks itself from its raw arrays, whoever produced them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from eos_pin._arrays import Array, Vector, brief, by_value, checked, frozen_copy, largest_magnitude, nearest, unchecked
from eos_pin._files import write_csv
from eos_pin.errors import InputError, Renamed, ResultError
from eos_pin.robot.loading import load_robot
from eos_pin.robot.model import Robot
from eos_pin.simulation._residuals import residuals_of
from eos_pin.simulation._storage import read, write
from eos_pin.simulation.limit_use import use_of_limits
from eos_pin.tasks.base import Task
from eos_pin.trajectories.bags import JointMotion, write_bag

#: Task acceleration beyond rounding [m/s², rad/s²].
TASK_DEFICIT = 1e-6


@brief("status", "frame", "cycles", "period", "q")
@by_value
@dataclass(frozen=True, eq=False)
class Result:
    """A run: its samples over time, its end, and its origin.

    Where a controller has no task or no charts, the columns that would describe them are empty (size 0) or NaN.

    Attributes:
        t: Times [s], (T,); they contain every exact multiple of the reference's period.
        q: Joints [rad or m], (T, n).
        dq: Joint velocities, (T, n).
        ddq: Joint accelerations, (T, n).
        tau: Joint torques F^y [N m or N], (T, n).
        z: Task points, (T, size).
        dz: Task velocities, (T, m).
        z_ref: Task points that were asked for, (T, size).
        error: Task error `minus(z_ref, z)` [m, rad], (T, m).
        task_force: Force of the environment on the task, or on that of the `TaskForce` [N, N m], (T, k).
        task_deficit: Task acceleration that the control law asked for and the controller gave up, (T, m).
        deficit_from_limits: The part of it that joint limits took; a singularity of the task took the rest, (T, m).
        v: Self-motion coordinates, (T, r).
        dv: Self-motion velocities, (T, r).
        v_ref: Self-motion that was asked for, NaN where none was, (T, r).
        chart: Number of the chart, (T,).
        kinetic_energy: Kinetic energy [J], (T,).
        work: Work done on the robot since the start by torques and task force [J], (T,).
        switches: Times at which a chart was left [s].
        further_error: Error of a further task that the self-motion tracks [m, rad]; empty where there is none.
        period: Period of the reference [s]; infinite if it does not repeat.
        status: `"finished"`, or why the run ended early, in one word.
        message: The same in a sentence, with advice.
        info: Provenance: versions, robot and its limits, task, controller, arguments, seed, time spent.
        labels: Name of each coordinate of the task, (m,), as `Task.labels`; empty without a task.
        units: Unit of each coordinate of the task, (m,), as `Task.units`.
        frame: Frame whose path is drawn; empty where there is none.
        axes: Axes of space along which the first coordinates of z are a place; empty where they are none.
        seen_from: Frame in whose axes that place is; empty for the world.
    """

    t: Float[Array, " T"]
    q: Float[Array, "T n"]
    dq: Float[Array, "T n"]
    ddq: Float[Array, "T n"]
    tau: Float[Array, "T n"]
    z: Float[Array, "T size"]
    dz: Float[Array, "T m"]
    z_ref: Float[Array, "T size"]
    error: Float[Array, "T m"]
    task_force: Float[Array, "T k"]
    task_deficit: Float[Array, "T m"]
    deficit_from_limits: Float[Array, "T m"]
    v: Float[Array, "T r"]
    dv: Float[Array, "T r"]
    v_ref: Float[Array, "T r"]
    chart: Int[Array, " T"]
    kinetic_energy: Float[Array, " T"]
    work: Float[Array, " T"]
    switches: Float[Array, " S"]
    further_error: Float[Array, "F k"] = field(default_factory=lambda: np.zeros((0, 0)))
    period: float = math.inf
    status: str = "finished"
    message: str = ""
    info: Mapping[str, Any] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    frame: str = ""
    axes: str = ""
    seen_from: str = ""

    given_up = Renamed("task_deficit")
    given_up_to_limits = Renamed("deficit_from_limits")
    given_up_rows = Renamed("deficit_rows")
    given_up_seconds = Renamed("deficit_seconds")

    def __post_init__(self) -> None:
        rows = len(self.t)
        if not len(self.further_error):
            object.__setattr__(self, "further_error", np.zeros((rows, 0)))
        for name in _ARRAYS:
            array = frozen_copy(getattr(self, name), int if name == "chart" else float)
            if array.ndim != (1 if name in _VECTORS else 2):
                raise InputError(f"{name} of a result must be a {'vector' if name in _VECTORS else 'table'}")
            if name != "switches" and len(array) != rows:
                raise InputError(f"a result needs as many rows of {name} as times, {rows}; got {len(array)}")
            object.__setattr__(self, name, array)
        for name in ("labels", "units"):
            words = tuple(map(str, getattr(self, name)))
            if len(words) not in (0, self.error.shape[1]):
                raise InputError(f"a result needs {name} for its {self.error.shape[1]} task coordinates, got {words}")
            object.__setattr__(self, name, words)

    @property
    def ok(self) -> bool:
        """Whether the run reached its end."""
        return self.status == "finished"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints in the order of q; their numbers from 1 where the run does not have them."""
        names = self.info.get("robot", {}).get("joints", ())
        return tuple(names) if len(names) == self.q.shape[1] else tuple(str(i + 1) for i in range(self.q.shape[1]))

    # -- figures -----------------------------------------------------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Complete periods of the reference within the run."""
        if not (math.isfinite(self.period) and len(self.t)):
            return 0
        return int((self.t[-1] - self.t[0]) / self.period + 1e-9)

    @property
    def cycle_rows(self) -> Int[Array, " C"]:
        """Rows at the exact multiples of the period, from 0 to `cycles`."""
        times = self.t[0] + self.period * np.arange(self.cycles + 1) if self.cycles else self.t[:1]
        return nearest(self.t, times)

    @property
    def settled_row(self) -> int:
        """First row after transients: that of the end of the first cycle, or of half the run if there is only one."""
        if self.cycles > 1:
            return int(self.cycle_rows[1])
        return int(np.searchsorted(self.t, 0.5 * (self.t[0] + self.t[-1]))) if len(self.t) else 0

    @property
    def joint_drift_per_cycle(self) -> Vector:
        """Largest change of a joint from each exact multiple of the period to the next [rad or m].

        Whole turns of a continuous joint lead to where it was, and do not count; `turns_per_cycle` has them.
        """
        change = np.diff(self.q[self.cycle_rows], axis=0)
        return np.abs(change - math.tau * self.turns_per_cycle).max(axis=1, initial=0.0)

    @property
    def turns_per_cycle(self) -> Int[Array, "C n"]:
        """Whole turns of each joint in each cycle, forward positive; 0 for joints that are not continuous."""
        change = np.diff(self.q[self.cycle_rows], axis=0)
        turns, continuous = np.zeros(change.shape, dtype=np.int64), self.info.get("robot", {}).get("continuous", [])
        turns[:, continuous] = np.round(change[:, continuous] / math.tau)
        return turns

    @property
    def self_motion_error(self) -> Float[Array, "T r"]:
        """v_ref − v; NaN where no self-motion was asked for."""
        return self.v_ref - self.v

    @property
    def limits(self) -> dict[str, Any]:
        """Largest ratios to the limits of position, velocity and torque; see `margins.use_of_limits`."""
        limits = self.info.get("limits") or {}
        known = self.q.shape == self.dq.shape == self.tau.shape and len(limits.get("joints", ())) == self.q.shape[1]
        return use_of_limits(limits, self.q, self.dq, self.tau) if known else use_of_limits({}, *3 * [self.q])

    @property
    def deficit_rows(self) -> Bool[Array, " T"]:
        """Rows in which part of the task was given up, to keep limits or because it was singular."""
        return (np.abs(self.task_deficit) > TASK_DEFICIT).any(axis=1)

    @property
    def deficit_seconds(self) -> float:
        """Time during which part of the task was given up [s]."""
        return self._seconds(self.deficit_rows)

    @property
    def singularities(self) -> dict[str, dict[str, Any]]:
        """Singularities by kind: of the task, of a limit, and of a chart; the first time and the duration of each.

        In the first two part of the task was given up. A chart is left before it becomes singular, at no cost.
        """
        taken = {"task": self.task_deficit - self.deficit_from_limits, "limit": self.deficit_from_limits}
        found: dict[str, dict[str, Any]] = {}
        for kind, values in taken.items():
            rows = (np.abs(values) > TASK_DEFICIT).any(axis=1)
            if rows.any():
                found[kind] = {"first": float(self.t[rows][0]), "seconds": self._seconds(rows)}
        if len(self.switches):
            found["chart"] = {"first": float(self.switches[0]), "times": len(self.switches)}
        return found

    def _seconds(self, rows: Bool[Array, " T"]) -> float:
        return float((np.diff(self.t) * rows[1:]).sum())

    @checked
    def mean(self, values: Float[Array, " T"]) -> float:
        """Time average over the complete cycles after transients, or over all that comes after them."""
        first, last = self.settled_row, int(self.cycle_rows[-1]) if self.cycles > 1 else len(self.t) - 1
        if last <= first:
            return float(values[first:].mean()) if len(values) else math.nan
        span = slice(first, last + 1)
        return float(np.trapezoid(values[span], self.t[span]) / (self.t[last] - self.t[first]))

    _mean = unchecked(mean)

    def summary(self) -> dict[str, Any]:
        """Figures of the run as plain values, for a table or JSON.

        Errors are maxima after transients, that is from the row `settled_row` on (`settled_from` in seconds).
        """
        late = slice(self.settled_row, None)
        limits = self.limits
        return {
            "status": self.status,
            "message": self.message,
            "robot": self.info.get("robot", {}).get("name", ""),
            "task": self.info.get("task") or {},
            "frame": self.frame,
            "labels": list(self.labels),
            "units": list(self.units),
            "controller": self.info.get("controller", {}),
            "n": self.q.shape[1],
            "m": self.error.shape[1],
            "r": self.q.shape[1] - self.error.shape[1] if self.error.shape[1] else 0,
            "duration": float(self.t[-1]) if len(self.t) else 0.0,
            "period": self.period if math.isfinite(self.period) else None,
            "cycles": self.cycles,
            "settled_from": float(self.t[late][0]) if len(self.t[late]) else 0.0,
            "task_error_max": largest_magnitude(self.error[late]),
            "self_motion_error_max": largest_magnitude(self.self_motion_error[late]),
            "joint_drift_per_cycle": [float(d) for d in self.joint_drift_per_cycle],
            **{name: self.info.get(name) for name in ("joint_distance", "further_task", "tolerance_used", "coupling")},
            "joint_turns_per_cycle": [int(d) for d in np.abs(self.turns_per_cycle).max(axis=1, initial=0)],
            "given_up_seconds": self.deficit_seconds,
            "singularities": self.singularities,
            "chart_switches": len(self.switches),
            "kinetic_energy_mean": self._mean(self.kinetic_energy),
            "torque_max": largest_magnitude(self.tau),
            "limit_ratio_max": limits["worst"],
            "limits": limits,
            "cpu_seconds": float(self.info.get("cpu_seconds", math.nan)),
        }

    @checked
    def residuals(self, robot: Robot | None = None) -> dict[str, float]:
        """Re-check the run from its raw arrays; all figures are near rounding, or within the integrator's tolerance.

        Args:
            robot: The plant; by default it is loaded again from the provenance.

        Returns:
            `task` z − G(q) [m, rad]; `torque` M ddq − R − tau − G'ᵀF^z, relative to the largest torque or bias −R;
            `power` change of energy minus work, relative to the largest energy exchanged. The last two are NaN where
            nothing is known of torques: they were not recorded, or the robot has no inertia.

        Raises:
            ResultError: The plant cannot be loaded again (it was made in memory): hand it over.
        """
        return residuals_of(self, robot or self.load_plant())

    @checked
    def load_plant(self, source: str | Path = "") -> Robot:
        """The robot that ran, loaded again from where it came.

        Args:
            source: Where its URDF is now, if it has moved; a changed one will do if its joints are the same.

        Raises:
            ResultError: It was made in memory, or its URDF has changed since.
            RobotError: Its URDF cannot be used, or is not there.
        """
        record = self.info.get("robot", {})
        if source:
            robot = load_robot(source, **record.get("options", {}))
            joints = tuple(joint.name for joint in robot.joints)
            if len(joints) != self.q.shape[1] or (record.get("joints") and joints != self.joints):
                raise ResultError(
                    f"{str(source)!r} is not the robot of this run: its joints are {', '.join(joints)}, those of the "
                    f"run {', '.join(self.joints)}"
                )
            return robot
        if not record.get("source"):
            raise ResultError(
                f"the plant of this run ({record.get('name', 'unnamed')!r}) was made in memory and is not in the file; "
                "pass the robot"
            )
        robot = load_robot(record["source"], **record.get("options", {}))
        if record.get("urdf_sha256") not in ("", None, robot.urdf_sha256):
            raise ResultError(f"the URDF of {record['source']!r} has changed since this run; pass the robot it ran on")
        return robot

    # -- files -------------------------------------------------------------------------------------------------------

    @checked
    def save(self, path: str | Path) -> Path:
        """Write everything to one `.npz`; a file that was there is replaced at once or not at all.

        Raises:
            OutputError: The file cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            path = path.with_name(path.name + ".npz")
        header = {
            "period": self.period if math.isfinite(self.period) else None,
            "status": self.status,
            "message": self.message,
            "names": {name: getattr(self, name) for name in _NAMES},
            "info": dict(self.info),
        }
        write(path, header, {name: getattr(self, name) for name in _ARRAYS})
        return path

    @classmethod
    @checked
    def load(cls, path: str | Path) -> Result:
        """Read a file that `save` wrote, in this version or an earlier one; nothing in it is executed.

        Raises:
            ResultError: The file is missing, damaged, or not such a file.
        """
        path = Path(path)
        try:
            header, arrays = read(path, _ARRAYS)
            period = header["period"] if header["period"] is not None else math.inf
            words: dict[str, Any] = {name: header[name] for name in ("status", "message", "info")} | header["names"]
            columns: dict[str, Any] = arrays
            return cls(**columns, period=period, **words)
        except ResultError:
            raise
        except Exception as error:  # NumPy, zipfile, zlib and json raise a dozen kinds on damaged bytes
            raise ResultError(
                f"{path} cannot be read as a result of eos_pin: {str(error) or type(error).__name__}. Results are the "
                ".npz files that `eos-pin track` and Result.save write"
            ) from error

    @checked
    def to_csv(self, path: str | Path) -> Path:
        """Write the samples as a table, a row per time and a named column per number, such as `q_elbow`."""
        path = Path(path)
        columns = {name: getattr(self, name) for name in _ARRAYS if name != "switches" and np.size(getattr(self, name))}
        names: list[str] = []
        for name, array in columns.items():
            if name in ("q", "dq", "ddq", "tau"):
                names += [f"{name}_{joint}" for joint in self.joints]
            else:
                names += [name] if array.ndim == 1 else [f"{name}{i + 1}" for i in range(array.shape[1])]
        write_csv(path, names, np.column_stack(list(columns.values())).tolist())
        return path

    @checked
    def to_bag(self, path: str | Path) -> Path:
        """Write the joints over time as a bag of ROS 2, with torques where they are known; see `write_bag`."""
        effort = self.tau if np.isfinite(self.tau).all() else None
        return write_bag(path, JointMotion(self.joints, self.t, self.q, self.dq, self.ddq, effort))


_VECTORS = ("t", "chart", "kinetic_energy", "work", "switches")
#: What the task says of itself: see `Task`.
_NAMES = ("labels", "units", "frame", "axes", "seen_from")
_ARRAYS = tuple(f.name for f in fields(Result) if f.name not in ("period", "status", "message", "info", *_NAMES))


def names_of(task: Task | None) -> dict[str, Any]:
    """Labels, units and frame of a task as a `Result` keeps them; nothing without a task."""
    if task is None:
        return {}
    words = task.labels, task.units, task.frame, task.axes, task.seen_from
    return dict(zip(_NAMES, words, strict=True))
