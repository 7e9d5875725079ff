"""Joint values by name, in Python and on the command line, and what a saved run is good for without its URDF."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from checks import tip

import eos_pin
from eos_pin import (
    Atlas,
    Chart,
    EosController,
    Hold,
    InputError,
    OpenLoop,
    PositionTask,
    Result,
    ResultError,
    UnknownNameError,
    load_robot,
    simulate,
    simulate_sampled,
)
from eos_pin.cli.main import main
from eos_pin.robot.postures import by_name

pytestmark = pytest.mark.usefixtures("unchecked")
URDF = Path(__file__).parents[2] / "robots" / "planar_chain_10.urdf"


def test_posture_takes_joints_by_name(panda):
    rest = np.clip(np.zeros(panda.n), panda.lower, panda.upper)
    q = panda.posture({"panda_joint2": 0.3, "panda_joint6": np.float32(1.5)})
    expected = rest.copy()
    expected[[1, 5]] = 0.3, 1.5
    np.testing.assert_array_equal(q, expected)
    np.testing.assert_array_equal(panda.posture({}), rest)
    np.testing.assert_array_equal(panda.posture(expected.tolist()), expected)


@pytest.mark.parametrize(
    ("values", "kind", "told"),
    [
        ({"panda_joint": 0.1}, UnknownNameError, "Did you mean panda_joint"),
        ({"panda_joint1": "a"}, InputError, "q of joint 'panda_joint1' must be a number"),
        ({"panda_joint1": np.nan}, InputError, "must be a finite number"),
        ([0.0] * 6, InputError, "7 numbers"),
    ],
)
def test_posture_refuses_values_that_are_none(panda, values, kind, told):
    with pytest.raises(kind, match=told):
        panda.posture(values)


def test_functions_of_a_posture_take_names(panda):
    named = {"panda_joint2": -0.3, "panda_joint4": -2.0, "panda_joint6": 1.7}
    q = panda.posture(named)
    task = PositionTask(panda, tip(panda))
    atlas, z = Atlas(task), task.value(q)
    np.testing.assert_array_equal(Chart.from_base(task, named).q_bar, q)
    np.testing.assert_array_equal(atlas.start(named).q_bar, q)
    np.testing.assert_array_equal(atlas.follow(named, [z, z + 0.01]).q, atlas.follow(q, [z, z + 0.01]).q)
    np.testing.assert_array_equal(atlas.solve(named, z + 0.01).q, atlas.solve(q, z + 0.01).q)
    for drive in (simulate, simulate_sampled):
        run = drive(panda, EosController(task, Hold(z)), named, {"panda_joint1": 0.1}, duration=0.01)
        np.testing.assert_array_equal(run.q[0], q)
        np.testing.assert_array_equal(run.dq[0], np.eye(7)[0] * 0.1)


def test_command_line_reads_positions_by_name():
    assert by_name(["a=1", "b", "c=d=-2e-1"], "--lock") == {"a": 1.0, "b": None, "c=d": -0.2}
    with pytest.raises(InputError, match="--lock of joint 'a' must be a number, got 'x'"):
        by_name(["a=x"], "--lock")
    with pytest.raises(InputError, match="--lock has joint 'a' twice"):
        by_name(["a=1", "a"], "--lock")


def figures(*words):
    assert main([*words, "--json", "figures.json"]) == 0
    return json.loads(Path("figures.json").read_text())


def test_command_line_takes_joints_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    usual = figures("info", "panda")["start"]
    start = figures("info", "panda", "--q0", "panda_joint4=-2.25", "panda_joint1=0.5")["start"]
    np.testing.assert_array_equal(start, [0.5, *usual[1:3], -2.25, *usual[4:]])
    assert figures("info", "panda", "--q0", *map(repr, usual))["start"] == usual
    assert main(["info", "panda", "--q0", "0.1", "panda_joint1=0.5"]) == 2
    assert "all 7 joints in order, or some as joint=value" in " ".join(capsys.readouterr().err.split())
    assert main(["info", "panda", "--q0", "panda_joint9=0.5"]) == 2
    assert "Did you mean" in capsys.readouterr().err


def test_command_line_locks_joints_at_positions(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    found = figures("info", "panda", "--lock", "panda_joint3=0.2", "panda_joint5")
    assert found["n"] == 5
    locked = load_robot("panda", chain_to="panda_hand_tcp", lock={"panda_joint3": 0.2, "panda_joint5": None})
    whole = load_robot("panda", chain_to="panda_hand_tcp")
    names = [joint.name for joint in locked.joints]
    q = {name: -0.5 for name in names if name != "panda_joint6"} | {"panda_joint6": 1.0}
    placed = whole.placement(whole.posture(q | {"panda_joint3": 0.2, "panda_joint5": 0.0}), "panda_hand_tcp")
    assert locked.placement(locked.posture(q), "panda_hand_tcp").isApprox(placed, 1e-12)
    again = load_robot(locked.source, **json.loads(json.dumps(locked.options)))
    assert again.placement(again.posture(q), "panda_hand_tcp").isApprox(placed, 1e-12)
    assert main(["info", "panda", "--lock", "panda_joint3=9"]) == 2
    assert "cannot be locked at 9" in " ".join(capsys.readouterr().err.split())


# -- a run without its URDF ------------------------------------------------------------------------------------------


@pytest.fixture
def orphan(tmp_path, monkeypatch):
    """A saved run whose URDF has moved from `here.urdf` to `there.urdf`."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(URDF, "here.urdf")
    robot = load_robot("here.urdf", chain_to="auto")
    run = simulate(robot, OpenLoop(lambda t: np.zeros(robot.n)), np.full(robot.n, 0.1), duration=0.05)
    run.save("run.npz")
    Path("here.urdf").rename("there.urdf")
    return [joint.name for joint in robot.joints]


def test_run_without_its_urdf_gives_all_but_the_replay(orphan, capsys):
    assert main(["replay", "run.npz", "--csv", "run.csv", "--json", "run.json", "--plot", "run.png"]) == 0
    with open("run.csv", encoding="utf-8", newline="") as file:
        names = next(csv.reader(file))
    assert [name for name in names if name.startswith("q_")] == [f"q_{joint}" for joint in orphan]
    assert json.loads(Path("run.json").read_text())["status"] == "finished"
    assert Path("run.png").stat().st_size > 10_000
    capsys.readouterr()
    for words in (["--html", "run.html"], ["--view"], []):
        assert main(["replay", "run.npz", *words]) == 2
        said = capsys.readouterr()
        assert "finished" in said.out
        told = " ".join(said.err.split())
        assert "here.urdf" in told
        assert "--robot FILE" in told
        assert not Path("run.html").exists()


def test_run_is_replayed_on_the_robot_that_is_given(orphan, capsys):
    assert main(["replay", "run.npz", "--robot", "there.urdf", "--html", "run.html"]) == 0
    assert Path("run.html").stat().st_size > 10_000
    assert main(["replay", "run.npz", "--robot", "panda", "--html", "run.html"]) == 2
    assert Result.load("run.npz").load_plant("there.urdf").n == len(orphan)
    Path("there.urdf").write_text(Path("there.urdf").read_text().replace(f'"{orphan[3]}"', '"other"'))
    with pytest.raises(ResultError, match="is not the robot of this run"):
        Result.load("run.npz").load_plant("there.urdf")


def test_table_of_inverse_kinematics_names_joints(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["ik", "panda", "--v", "0.1", "0", "0", "0", "--csv", "ik.csv"]) == 0
    assert Path("ik.csv").read_text().splitlines()[0] == ",".join(["t", *(f"panda_joint{i}" for i in range(1, 8))])


def test_version_is_printed_by_command_and_module(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"eos-pin {eos_pin.__version__}\n"
    said = subprocess.run([sys.executable, "-m", "eos_pin", "--version"], capture_output=True, text=True, check=True)
    assert said.stdout == f"eos-pin {eos_pin.__version__}\n"
