"""Joint logs recorded elsewhere: a table with times and a column for each joint by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, Vector, checked, frozen_copy
from eos_pin.errors import InputError
from eos_pin.robot.joint_map import JointMap
from eos_pin.robot.model import Robot
from eos_pin.trajectories.bags import read_bag
from eos_pin.trajectories.text_tables import cells_of, decimal, numbers_of

#: Names of the column of times.
TIMES = ("t", "time", "timestamp", "stamp", "time_s")
#: Joints may leave their limits by this before the file is taken to be in degrees [rad or m].
BEYOND = 0.5
#: Rows this far apart are in another unit of time [s].
APART = 10.0


@checked
@dataclass(frozen=True, eq=False)
class JointLog:
    """Joints over time.

    Attributes:
        t: Times, from the first on [s], (T,).
        q: Joints [rad or m], (T, n).
        dq: Their velocities where the log has them, (T, n).
        notes: Choices and changes.
    """

    t: Vector
    q: Float[Array, "T n"]
    dq: Float[Array, "T n"] | None = None
    notes: tuple[str, ...] = ()


@checked
def read_joint_log(
    path: str | Path, robot: Robot, *, joints: Sequence[str] = (), degrees: bool = False, topic: str = ""
) -> JointLog:
    """Read a joint log: a bag of ROS 2 with joint states, or a text table whose first row names its columns.

    Times [s] are in a column t, time, timestamp or stamp. The position of a joint is in the column of its name, also
    written q_NAME, NAME/position or position/NAME; its velocity, if it is there, in dq_NAME, NAME/velocity or
    velocity/NAME. Other columns do not count. A last row that was not written to its end is left out.

    Args:
        path: Text file, or the folder of a bag.
        robot: The robot.
        joints: Names that the file has for the joints, in the robot's order; by default the robot's own.
        degrees: Whether angles are in degrees.
        topic: Topic of joint states in a bag; by default the only one there is.

    Raises:
        InputError: The file cannot be used; it names file, line and cause. Angles seem to be in degrees.
        UnknownNameError: A joint has no column.
        MissingDependencyError: It is a bag, and rosbags is not installed.
    """
    path, wanted = Path(path), _wanted(robot, joints, str(path))
    if path.is_dir() or path.suffix == ".mcap":
        motion = read_bag(path if path.is_dir() else path.parent, topic=topic, joints=wanted)
        speeds = [] if motion.dq is None else [motion.dq]
        names = [*wanted, *(f"dq_{name}" for name in wanted * len(speeds))]
        return log_of(
            robot, motion.t, names, np.hstack([motion.q, *speeds]), source=str(path), joints=joints, degrees=degrees
        )
    if topic:
        raise InputError(f"topic {topic!r} does not apply: {path} is no bag")
    rows = cells_of(path)
    if not rows or all(decimal(cell) is not None for cell in rows[0][1]):
        raise InputError(f"{path}: the first row must name the columns: t, and each joint by its name")
    (_, names), rows = rows[0], rows[1:]
    if rows and len(rows[-1][1]) < len(names):
        rows = rows[:-1]
    if len(rows) < 2:
        raise InputError(f"{path} has {len(rows)} rows of numbers; a log needs at least 2")
    time = next((name for name in names if name.lower() in TIMES), None)
    if time is None:
        raise InputError(f"{path}: no column has the times; name it t. The columns are {', '.join(names)}")
    # What does not count may be empty or no number.
    used = [k for k, name in enumerate(names) if name == time or any(_spelled(name, what, wanted) for what in _SPELLED)]
    columns = [names[k] for k in used]
    values = np.array([_picked(path, line, cells, names, used) for line, cells in rows])
    lines = [line for line, _ in rows]
    t = values[:, columns.index(time)]
    return log_of(robot, t, columns, values, source=str(path), lines=lines, joints=joints, degrees=degrees)


def _picked(path: Path, line: int, cells: list[str], names: list[str], used: list[int]) -> list[float]:
    """The numbers of a row that count."""
    if len(cells) > len(names) or len(cells) <= max(used):
        raise InputError(f"{path}, line {line}: expected {len(names)} columns ({', '.join(names)}), got {len(cells)}")
    return list(map(float, numbers_of(path, line, [cells[k] for k in used], [names[k] for k in used])))


@checked
def log_of(
    robot: Robot,
    t: Vector,
    names: Sequence[str],
    values: Float[Array, "T k"],
    *,
    source: str,
    lines: Sequence[int] = (),
    joints: Sequence[str] = (),
    degrees: bool = False,
) -> JointLog:
    """Joint log from a table of positions, and velocities, in any order.

    Args:
        robot: The robot.
        t: Times [s].
        names: Name of each column.
        values: The table.
        source: Where it is from, for error messages.
        lines: Lines of its rows.
        joints: As in `read_joint_log`.
        degrees: As in `read_joint_log`.

    Raises:
        InputError: As in `read_joint_log`.
        UnknownNameError: As in `read_joint_log`.
    """
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if len(late):
        row = int(late[0]) + 1
        where = f"line {lines[row]}" if len(lines) else f"message {row + 1}"
        raise InputError(f"{source}, {where}: times must increase, but {t[row]!r} follows {t[row - 1]!r}")
    if np.median(np.diff(t)) > APART:
        raise InputError(
            f"{source}: its rows are {np.median(np.diff(t)):.3g} s apart. If the times are in milliseconds or "
            "nanoseconds, divide them by 1e3 or 1e9"
        )
    wanted = _wanted(robot, joints, source)
    own = dict(zip(wanted, (joint.name for joint in robot.joints), strict=True))
    found = [_spelled(name, "position", wanted) for name in names]
    q = values[:, JointMap(robot, [own.get(word) or name for word, name in zip(found, names, strict=True)]).places]
    speeds = [_spelled(name, "velocity", wanted) for name in names]
    dq = values[:, [speeds.index(name) for name in wanted]] if set(wanted) <= set(speeds) else None
    turning = np.array([joint.kind != "prismatic" for joint in robot.joints])
    notes = () if not t[0] else (f"times are counted from the first, {t[0]:.10g} s",)
    if degrees:
        q = np.where(turning, np.radians(q), q)
        dq = None if dq is None else np.where(turning, np.radians(dq), dq)
    else:
        _refuse_degrees(robot, q, turning, source)
    q[:, robot.continuous] = np.unwrap(q[:, robot.continuous], axis=0)
    return JointLog(frozen_copy(t - t[0]), frozen_copy(q), None if dq is None else frozen_copy(dq), notes)


#: How a column spells position and velocity of a joint.
_SPELLED = {
    "position": re.compile(
        r"^(?:q_)?(?P<joint>[^/]+)$|(?:^|/)(?P<first>[^/]+)/position$|(?:^|/)position/(?P<last>[^/]+)$"
    ),
    "velocity": re.compile(r"^dq_(?P<joint>[^/]+)$|(?:^|/)(?P<first>[^/]+)/velocity$|(?:^|/)velocity/(?P<last>[^/]+)$"),
}


def _wanted(robot: Robot, joints: Sequence[str], source: str) -> tuple[str, ...]:
    """Names that a log has for the joints."""
    wanted = tuple(joints) or tuple(joint.name for joint in robot.joints)
    if len(wanted) != robot.n:
        raise InputError(f"{source}: {robot.n} joint names are needed, in the robot's order, got {len(wanted)}")
    return wanted


def _spelled(column: str, what: str, wanted: Sequence[str]) -> str:
    """Name of the joint whose position or velocity a column has; empty where it has something else."""
    if what == "position" and column in wanted:
        return column
    found = _SPELLED[what].search(column)
    name = next((part for part in found.groups() if part), "") if found else ""
    return name if name in wanted else ""


def _refuse_degrees(robot: Robot, q: Float[Array, "T n"], turning: Array, source: str) -> None:
    """Refuse angles far beyond limits that they would be within in degrees."""

    def beyond(joints: Float[Array, "T n"]) -> JointVector:
        return np.maximum(robot.lower - joints, joints - robot.upper).max(axis=0)

    far = turning & (beyond(q) > BEYOND)
    if far.any() and (beyond(np.radians(q))[turning] <= BEYOND).all():
        joint = int(np.argmax(np.where(far, beyond(q), -np.inf)))
        raise InputError(
            f"{source}: {robot.joints[joint].name!r} goes from {q[:, joint].min():.4g} to {q[:, joint].max():.4g}, its "
            f"limits are {robot.lower[joint]:.3g} and {robot.upper[joint]:.3g} rad. If the angles are in degrees, "
            "give degrees=True (--degrees)"
        )
