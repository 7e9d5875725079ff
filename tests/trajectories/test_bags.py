"""Bags of ROS 2: read back by the format's own reader, and by ours."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import numpy as np
import pytest

from eos_pin import InputError
from eos_pin.errors import OutputError
from eos_pin.trajectories.bags import STATES, TRAJECTORY, JointMotion, read_bag, write_bag


@pytest.fixture
def motion() -> JointMotion:
    random = np.random.default_rng(0)
    t = np.arange(50) * 0.004
    return JointMotion(("shoulder", "elbow"), t, *(random.normal(size=(50, 2)) for _ in range(4)))


def test_bag_is_read_back_by_its_own_reader(motion: JointMotion, tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    bag = write_bag(tmp_path / "run", motion)
    assert sorted(file.name for file in bag.iterdir()) == ["metadata.yaml", "run.mcap"]
    with AnyReader([bag]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        assert kinds == {STATES: "sensor_msgs/msg/JointState", TRAJECTORY: "trajectory_msgs/msg/JointTrajectory"}
        found = [(c.topic, at, reader.deserialize(raw, c.msgtype)) for c, at, raw in reader.messages()]
    states = [message for topic, _, message in found if topic == STATES]
    assert [at for topic, at, _ in found if topic == STATES] == [4_000_000 * k for k in range(50)]
    assert np.array_equal([m.position for m in states], motion.q)
    assert np.array_equal([m.velocity for m in states], motion.dq)
    assert np.array_equal([m.effort for m in states], motion.effort)
    (whole,) = (message for topic, _, message in found if topic == TRAJECTORY)
    assert whole.joint_names == ["shoulder", "elbow"]
    assert np.array_equal([p.positions for p in whole.points], motion.q)
    assert np.array_equal([p.accelerations for p in whole.points], motion.ddq)
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in whole.points]
    assert np.abs(np.array(times) - motion.t).max() < 1e-12


def test_bag_is_read_by_joint_and_replaced(motion: JointMotion, tmp_path: Path) -> None:
    write_bag(tmp_path / "run", motion)
    bag = write_bag(tmp_path / "run", motion)
    found = read_bag(bag, joints=["elbow"])
    assert np.array_equal(found.q, motion.q[:, 1:])
    assert np.array_equal(found.dq, motion.dq[:, 1:])
    assert np.abs(found.t - motion.t).max() < 1e-12
    assert [file.name for file in tmp_path.iterdir()] == ["run"]
    # Velocities and efforts that are not known are empty, as ROS has it.
    bare = read_bag(write_bag(tmp_path / "bare", JointMotion(motion.joints, motion.t, motion.q)), topic=STATES)
    assert bare.dq is bare.effort is None
    assert np.array_equal(bare.q, motion.q)


def test_file_that_is_no_bag_is_refused_and_left_alone(motion: JointMotion, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match="no bag"):
        write_bag(tmp_path / "notes", motion)
    assert (tmp_path / "notes" / "mine.txt").read_text() == "keep"
    with pytest.raises(InputError, match="no bag of ROS 2"):
        read_bag(tmp_path / "notes")
    bag = write_bag(tmp_path / "run", motion)
    with pytest.raises(InputError, match="/joint_states, not on '/arm'"):
        read_bag(bag, topic="/arm")
    with pytest.raises(InputError, match="wrist"):
        read_bag(bag, joints=["wrist"])
    (bag / "run.mcap").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="cannot be read as a bag"):
        read_bag(bag)
    (bag / "metadata.yaml").write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="cannot be read as a bag"):
        read_bag(bag)
    (bag / "metadata.yaml").write_text("a: [")
    with pytest.raises(InputError, match="cannot be read as a bag"):
        read_bag(bag)
    with pytest.raises(InputError, match="time 0"):
        write_bag(tmp_path / "early", JointMotion(motion.joints, motion.t - 1.0, motion.q))


def test_damaged_bag_is_read_or_refused(motion: JointMotion, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "run", motion)
    whole, random = (bag / "run.mcap").read_bytes(), np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(whole)
        for place in random.integers(len(whole), size=3):
            damaged[place] = random.integers(256)
        (bag / "run.mcap").write_bytes(damaged[: random.integers(len(whole) // 2, len(whole) + 1)])
        with contextlib.suppress(InputError):
            read_bag(bag)


def test_missing_rosbags_is_named_with_its_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(ImportError, match=r"pip install 'eos-pin\[ros\]'"):
        read_bag(tmp_path)
