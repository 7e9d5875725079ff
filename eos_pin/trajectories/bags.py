"""Joint motions in bags of ROS 2 (MCAP): written for other tools, and read from a robot's own logs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Vector, checked
from eos_pin.errors import InputError, MissingDependencyError, OutputError

#: Topics of a bag that is written here, and the types of their messages.
STATES, TRAJECTORY = "/joint_states", "/joint_trajectory"
STATE_TYPE, TRAJECTORY_TYPE = "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory"
#: Version of the metadata of a bag.
METADATA = 9


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joints over time, by name.

    Attributes:
        joints: Names of the joints.
        t: Times [s], (T,).
        q: Positions, (T, n) [rad or m].
        dq: Velocities, (T, n) [rad/s or m/s]; None where they are not known.
        ddq: Accelerations, (T, n) [rad/s² or m/s²]; None where they are not known.
        effort: Torques or forces, (T, n) [N m or N]; None where they are not known.
    """

    joints: Sequence[str]
    t: Vector
    q: Float[Array, "T n"]
    dq: Float[Array, "T n"] | None = None
    ddq: Float[Array, "T n"] | None = None
    effort: Float[Array, "T n"] | None = None


@checked
def write_bag(path: str | Path, motion: JointMotion) -> Path:
    """Write a motion as a bag: joint states over time, and the whole of it as one trajectory.

    The bag is a folder with one MCAP file. It is written beside its place and renamed; a bag that is there already is
    replaced. ROS counts time in nanoseconds, so times are rounded to these.

    Args:
        path: The folder.
        motion: The motion, from time 0 on or later.

    Returns:
        The folder.

    Raises:
        MissingDependencyError: rosbags is not installed.
        InputError: A time is negative.
        OutputError: The bag cannot be written, or there is something else in its place.
    """
    ros, path = _ros(), Path(path)
    if len(motion.t) and motion.t[0] < 0.0:
        raise InputError(f"a bag begins at time 0 or later, the motion at {motion.t[0]:g} s; shift its times")
    if path.exists() and not (path / "metadata.yaml").is_file():
        raise OutputError(f"cannot write {path}: it is there already, and no bag")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.", suffix=".part") as beside:
            made = Path(beside) / path.name
            _write(ros, made, motion)
            if path.exists():
                path.replace(Path(beside) / "old")
            made.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    return path


@checked
def read_bag(path: str | Path, *, topic: str = "", joints: Sequence[str] = ()) -> JointMotion:
    """Read the joint states of a bag.

    Args:
        path: Folder of the bag.
        topic: Topic of joint states; by default the only one there is.
        joints: Names of the joints to read, which each message that counts has all; by default those of the first
            message.

    Returns:
        The motion, with times from that of its first message on.

    Raises:
        MissingDependencyError: rosbags is not installed.
        InputError: It is no bag, has no such topic, or no message with these joints.
    """
    ros, path = _ros(), Path(path)
    if not (path / "metadata.yaml").is_file():
        raise InputError(f"{path} is no bag of ROS 2, which is a folder with a metadata.yaml in it")
    try:
        with ros.Reader(path) as reader:
            found = [c for c in reader.connections if c.msgtype == STATE_TYPE]
            names = sorted({c.topic for c in found})
            if (topic not in names) if topic else len(names) != 1:
                raise InputError(
                    f"{path} has joint states on {', '.join(names) or 'no topic'}"
                    + (f", not on {topic!r}" if topic else "; choose one of them" if names else "")
                )
            chosen = [c for c in found if c.topic == (topic or names[0])]
            messages = [ros.types.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages(chosen)]
    except InputError:
        raise
    except Exception as error:
        # A damaged file ends the reader in many ways.
        raise InputError(f"{path} cannot be read as a bag: {str(error) or type(error).__name__}") from error
    joints = tuple(joints) or tuple(messages[0].name if messages else ())
    messages = [message for message in messages if set(joints) <= set(message.name)]
    if not messages or not joints:
        raise InputError(f"{path} has no message with the joints {', '.join(joints) or '(none)'}")
    places = [[message.name.index(joint) for joint in joints] for message in messages]

    def column(field: str) -> Array | None:
        values = [getattr(message, field) for message in messages]
        if not all(len(row) == len(message.name) for row, message in zip(values, messages, strict=True)):
            return None
        return np.array([row[place] for row, place in zip(values, places, strict=True)], dtype=float)

    q = column("position")
    if q is None:
        raise InputError(f"{path} has joint states without positions, which are needed; record them, too")
    stamps = [message.header.stamp for message in messages]
    nanoseconds = np.array([stamp.sec * 10**9 + stamp.nanosec for stamp in stamps], dtype=np.int64)
    # In whole numbers, since an epoch leaves a float no digits below a microsecond.
    t = (nanoseconds - nanoseconds[0]) * 1e-9
    return JointMotion(joints, t, q, column("velocity"), None, column("effort"))


def _write(ros: SimpleNamespace, path: Path, motion: JointMotion) -> None:
    types, kinds = ros.types, ros.types.types
    time, span = kinds["builtin_interfaces/msg/Time"], kinds["builtin_interfaces/msg/Duration"]
    header, point = kinds["std_msgs/msg/Header"], kinds["trajectory_msgs/msg/JointTrajectoryPoint"]
    state, trajectory = kinds[STATE_TYPE], kinds[TRAJECTORY_TYPE]
    stamps = [divmod(round(1e9 * t), 10**9) for t in motion.t.tolist()]
    names = list(motion.joints)
    rows = [
        [np.zeros(0) if values is None else np.ascontiguousarray(values[k]) for k in range(len(stamps))]
        for values in (motion.q, motion.dq, motion.ddq, motion.effort)
    ]
    with ros.Writer(path, version=METADATA, storage_plugin=ros.StoragePlugin.MCAP) as writer:
        states, whole = (
            writer.add_connection(topic, kind, typestore=types)
            for topic, kind in ((STATES, STATE_TYPE), (TRAJECTORY, TRAJECTORY_TYPE))
        )
        points = [point(*four, span(*stamp)) for *four, stamp in zip(*rows, stamps, strict=True)]
        first = stamps[0] if stamps else (0, 0)
        message = trajectory(header(time(*first), ""), names, points)
        writer.write(whole, first[0] * 10**9 + first[1], types.serialize_cdr(message, TRAJECTORY_TYPE))
        for q, dq, _, effort, stamp in zip(*rows, stamps, strict=True):
            message = state(header(time(*stamp), ""), names, q, dq, effort)
            writer.write(states, stamp[0] * 10**9 + stamp[1], types.serialize_cdr(message, STATE_TYPE))


def _ros() -> Any:
    """The parts of rosbags that are used here."""
    try:
        from rosbags.rosbag2 import Reader, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingDependencyError("a bag of ROS 2", "rosbags", "pip install 'eos-pin[ros]'") from error
    types = get_typestore(Stores.ROS2_HUMBLE)
    return SimpleNamespace(Reader=Reader, StoragePlugin=StoragePlugin, Writer=Writer, types=types)
