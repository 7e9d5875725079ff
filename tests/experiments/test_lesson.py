"""The lesson: a hand that rests while the elbow moves, and an elbow that drifts."""

from __future__ import annotations

import gzip
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from eos_pin import InputError, load_robot
from eos_pin.cli.main import main
from eos_pin.experiments.lesson import Lesson, elbow_of, lesson
from eos_pin.viewer.lesson import write_lesson

pytestmark = pytest.mark.usefixtures("unchecked")


@cache
def once() -> Lesson:
    return lesson(load_robot("panda", chain_to="auto"))


@pytest.fixture
def taught(unchecked: None) -> Lesson:
    """Made by the first test that asks, since checks are switched off for the time of a test."""
    return once()


@pytest.mark.slow
def test_lesson_shows_a_hand_at_rest_and_an_elbow_that_moves(taught: Lesson) -> None:
    robot, frame = taught.task.robot, taught.task.robot.options["chain_to"]
    hands = np.array([robot.placement(q, frame).translation for q in taught.held.q])
    elbows = np.array([robot.placement(q, taught.elbow).translation for q in taught.held.q])
    assert np.abs(hands - hands[0]).max() < 1e-7
    assert np.linalg.norm(np.diff(elbows, axis=0), axis=1).sum() == pytest.approx(taught.swept)
    assert taught.swept > 1.0
    assert np.abs(taught.held.q[-1] - taught.held.q[0]).max() == pytest.approx(taught.returned)
    assert taught.returned < 1e-6
    # From limit to limit, none is passed.
    assert (taught.held.q >= robot.lower).all()
    assert (taught.held.q <= robot.upper).all()
    assert np.ptp(taught.held.q, axis=0).max() > 2.0
    assert taught.elbow in ("panda_joint3", "panda_joint4")


@pytest.mark.slow
def test_lesson_shows_joints_that_drift_while_the_hand_comes_back(taught: Lesson) -> None:
    robot, frame = taught.task.robot, taught.task.robot.options["chain_to"]
    first, last = (robot.placement(taught.free.q[row], frame) for row in taught.free.cycle_rows[[0, -1]])
    assert np.abs(first.homogeneous - last.homogeneous).max() < 1e-5
    assert taught.drifted > 0.5
    assert taught.rounds >= 4
    assert taught.held.t[-1] == pytest.approx(taught.free.t[-1])


@pytest.mark.slow
def test_lesson_page_has_both_robots(taught: Lesson, tmp_path: Path) -> None:
    import base64
    import re

    text = write_lesson(tmp_path / "lesson.html", taught).read_text()
    assert len(text) < 4e6
    block = gzip.decompress(base64.b64decode(re.findall(r'<script id="scene" type="text/plain">(.*?)<', text)[0]))
    size = int.from_bytes(block[:4], "little")
    header = json.loads(block[4 : 4 + size])
    assert (header["joints"], header["bodies"]) == (14, 15)
    assert [robot["links"] for robot in header["robots"]] == [[0, 7], [7, 7]]
    assert [trace["body"] for trace in header["traces"]] == [2, 9]
    poses = np.frombuffer(block, "<f4", header["poses"]["count"], 4 + size + header["poses"]["start"])
    poses = poses.reshape(-1, 15, 7)
    # Both start in the same posture, side by side.
    assert np.abs(poses[0, 7:14] - poses[0, :7]).max() < 1e-6
    apart = np.subtract(*(robot["offset"] for robot in header["robots"]))
    assert np.linalg.norm(apart) > 0.5 * taught.task.robot.reach


@pytest.mark.slow
def test_demo_prints_the_figures_of_its_page(taught: Lesson, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("eos_pin.experiments.lesson.lesson", lambda robot: taught)
    assert main(["demo", "--html", str(tmp_path / "lesson.html")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"EOS control: the elbow sweeps {taught.swept:.2f} m" in said
    assert f"Traditional control: after {taught.rounds} rounds" in said
    assert (tmp_path / "lesson.html").stat().st_size > 1e6


def test_lesson_refuses_a_robot_without_one_joint_to_spare() -> None:
    with pytest.raises(InputError, match=r"one joint more.*such as panda"):
        lesson(load_robot("planar_chain_10"))


def test_elbow_is_the_joint_that_moves_furthest() -> None:
    robot = load_robot("panda", chain_to="auto")
    Q = np.array([[0.0, 0.5, 0.0, -1.8, 0.0, 1.5, 0.0]] * 2)
    Q[1, 0] = 0.3
    # About a vertical axis, that which is furthest from it.
    away = [np.hypot(*robot.placement(Q[0], name).translation[:2]) for name in robot.joint_names]
    assert elbow_of(robot, Q) == robot.joint_names[int(np.argmax(away))]
