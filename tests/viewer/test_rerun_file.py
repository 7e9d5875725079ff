"""Files of Rerun, read back by the format's own reader. They need the extra `rerun`, which is not among the tests'."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checks import REST

from eos_pin import EosController, Plan, PositionTask, Robot, circle, simulate
from eos_pin.cli.main import main
from eos_pin.cli.output import curves_of
from eos_pin.viewer.replay import scene_of
from eos_pin.viewer.rerun_file import write_rerun


def read_back(reader: Any, file: Path) -> tuple[dict[str, list[float]], set[str], int]:
    """Curves by place, places that move, and number of shapes, by Rerun's own reader."""
    found: dict[str, list[float]] = {}
    moving, shapes = set(), 0
    for chunk in reader.RrdReader(file).stream().to_chunks():
        batch, place = chunk.to_record_batch(), chunk.entity_path.lstrip("/")
        names = batch.schema.names
        if "Scalars:scalars" in names:
            values = [row[0] for row in batch.column(names.index("Scalars:scalars")).to_pylist()]
            found.setdefault(place, []).extend(values)
        moving |= {place} if "Transform3D:translation" in names else set()
        shapes += "Mesh3D:vertex_positions" in names
    return found, moving, shapes


def test_plan_is_written_for_rerun(tmp_path: Path) -> None:
    reader = pytest.importorskip("rerun.chunk")
    words = ["plan", "ur5", "--task", "point-axis", "--path", "circle", "--size", "0.1", "--closed"]
    assert main([*words, "--plan", str(tmp_path / "a.npz"), "--rerun", str(tmp_path / "a.rrd")]) == 0
    found, moving, _ = read_back(reader, tmp_path / "a.rrd")
    plan = Plan.load(tmp_path / "a.npz")
    times = np.linspace(plan.start, plan.end, len(found["chart"]))
    for t, q, dq in zip(times, found["joints/elbow_joint/q"], found["joints/elbow_joint/dq"], strict=True):
        assert abs(plan(t).q[2] - q) < 1e-12
        assert abs(plan(t).dq[2] - dq) < 1e-12
    assert "robot/elbow_joint" in moving


def test_rerun_file_has_the_robot_and_every_curve(panda: Robot, tmp_path: Path) -> None:
    reader = pytest.importorskip("rerun.chunk")
    task = PositionTask(panda, "panda_hand_tcp")
    path = circle(task.value(REST), 0.05, period=1.0, plane="yz")
    run = simulate(panda, EosController(task, path), REST, duration=1.0)
    curves = curves_of(run, panda)
    assert {"chart", "joints/panda_joint4/q", "joints/panda_joint4/upper", "task/error/1", "self-motion/v/4"} <= set(
        curves
    )
    file = write_rerun(tmp_path / "run.rrd", scene_of(run, panda), run.t, run.q, curves)
    assert [each.name for each in tmp_path.iterdir()] == ["run.rrd"]
    found, moving, shapes = read_back(reader, file)
    assert set(found) == set(curves)
    assert max(np.abs(np.array(found[name]) - curves[name]).max() for name in curves) < 1e-12
    assert {f"robot/panda_joint{i}" for i in range(1, 8)} <= moving
    assert shapes >= 8


def test_missing_rerun_is_named_with_its_command(panda: Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from eos_pin.viewer.scene import Scene

    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match=r"pip install 'eos-pin\[rerun\]'"):
        write_rerun(tmp_path / "run.rrd", Scene(panda), np.array([0.0]), np.zeros((1, 7)))
    assert not list(tmp_path.iterdir())
