"""Some chains of the table that benchmarks/every_robot.py makes of all, and that the table is there."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from eos_pin import available_robots

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import every_robot
from every_robot import Row, attempt

PATHS = {robot.name: robot.path for robot in available_robots()}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("row", "task"),
    [
        (Row("iris", "iris__rotor_0", 1, "position"), "stays where it is"),
        (Row("a1", "FR_thigh_shoulder", 1, "position"), "position z"),
        (Row("pr2", "imu_link", 1, "position"), "position z"),
        (Row("solo", "FL_LOWER_LEG", 2, "position"), ""),
        (Row("alex_nub_hands", "Head", 5, "position"), "position"),
        (Row("romeo", "l_sole", 6, "pose"), "pose x,y,z,rx,ry,rz"),
        (Row("baxter", "l_gripper_l_finger_tip", 8, "pose"), "pose x,y,z,rx,ry,rz"),
        (Row("ppr", "tip", 3, "position"), "position x,y"),
        (Row("panda", "panda_rightfinger", 8, "position"), "position"),
        (Row("romeo_laas_small", "l_gripper", 9, "position"), "move no mass"),
        (Row("icub", "l_upper_arm_dh_frame", 6, "pose"), "singularities"),
    ],
    ids=lambda value: f"{value.robot}-{value.frame}" if isinstance(value, Row) else "",
)
def test_chain_runs_or_gives_the_reason(row: Row, task: str) -> None:
    leaves = {other.frame for other in every_robot.rows_of(next(r for r in available_robots() if r.name == row.robot))}
    row = row if row.frame in leaves else replace(row, frame=min(leaves))
    done = attempt(row, PATHS[row.robot], 0.5, 60.0)
    assert done.said == ""
    if done.result == "refused":
        assert task in done.reason
    else:
        assert (done.result, done.reason) == ("ran", "")
        assert done.task.startswith(task)
        assert done.error < every_robot.ACCURATE


@pytest.mark.parametrize(
    ("misbehave", "result"),
    [(lambda row, duration: 1 / 0, "crashed"), (lambda row, duration: time.sleep(9.0), "hung")],
)
def test_misbehaviour_is_noticed(misbehave, result, monkeypatch) -> None:
    monkeypatch.setattr(every_robot, "_ran", misbehave)
    assert attempt(Row("ppr", "tip", 3, "position"), PATHS["ppr"], 1.0, 0.05).result == result


def test_attempt_records_terminal_output(monkeypatch) -> None:
    monkeypatch.setattr(every_robot, "_ran", lambda row, duration: (os.write(2, b"Warning: link"), row)[1])
    assert attempt(Row("ppr", "tip", 3, "position"), PATHS["ppr"], 1.0, 5.0).said == "Warning: link"


def test_page_has_every_robot() -> None:
    page = every_robot.DOCUMENT.read_text(encoding="utf-8")
    assert [name for name in PATHS if f"| {name} |" not in page] == []
    assert "crashed" not in page
    assert "hung" not in page
