"""Joint logs recorded elsewhere: what `eos-pin analyze` finds in them, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from eos_pin import InputError, PositionTask, Result, UnknownNameError, circle, load_robot
from eos_pin.cli.main import main
from eos_pin.experiments.joint_logs import read_joint_log
from eos_pin.plots import overview
from eos_pin.simulation.analysis import analyze, round_of
from eos_pin.trajectories.bags import JointMotion, write_bag

pytestmark = pytest.mark.usefixtures("unchecked")
REST = np.array([0.0, -1.2, 1.8, -1.0, -1.5, 0.2])
PERIOD, H = 3.0, 0.01


@pytest.fixture(scope="module")
def log():
    """Joints of a resolved-rate loop with the pseudo-inverse: the task repeats, the joints do not."""
    robot = load_robot("ur5", chain_to="tool0")
    task = PositionTask(robot, "tool0")
    path = circle(task.value(REST), 0.1, period=PERIOD, plane="yz")
    q, rows = REST, []
    for k in range(round(3 * PERIOD / H) + 1):
        rows.append(q)
        for i in range(4):
            t = k * H + i * H / 4
            z, J = task.linearize(q)
            q = q + H / 4 * np.linalg.pinv(J) @ (path(t + H / 8).dz + 100.0 * (path(t).z - z))
    return task, H * np.arange(len(rows)), np.array(rows)


def drift_of(q):
    """Change of a joint from round to round, straight from the samples."""
    return np.abs(np.diff(q[:: round(PERIOD / H)], axis=0)).max(axis=1)


def table(path, t, q, names, *, head=None, factor=1.0):
    rows = [head or ",".join(("t", *names))]
    rows += [",".join(map(repr, row)) for row in np.column_stack((t, factor * q)).tolist()]
    path.write_text("\n".join(rows) + "\n")
    return path


def names_of(task):
    return [joint.name for joint in task.robot.joints]


def test_drift_of_a_pseudo_inverse_is_found_with_its_rounds(log):
    task, t, q = log
    run = analyze(task, t, q)
    assert run.period == pytest.approx(PERIOD, abs=1e-6)
    assert run.cycles == 3
    np.testing.assert_allclose(run.joint_drift_per_cycle, drift_of(q), atol=1e-6)
    assert drift_of(q).min() > 1e-3
    np.testing.assert_allclose(run.z, [task.value(row) for row in run.q], atol=1e-12)
    # v is Vᵀ q on the one chart, so it drifts as well.
    assert not len(run.switches)
    assert np.abs(run.v[run.cycle_rows[-1]] - run.v[0]).max() > 1e-3
    assert np.isnan(run.error).all()
    assert run.summary()["limits"]["velocity"]["ratio"] > 0.0
    assert overview(run).axes


def test_rounds_that_are_no_multiple_of_the_samples_are_found(log):
    task, _, _ = log
    t = 0.0137 * np.arange(700)
    q = REST + 0.3 * np.sin(2.0 * np.pi * t / 2.1)[:, None] * np.linspace(0.1, 1.0, 6) + 1e-3 * t[:, None]
    run = analyze(task, t, q)
    # The task drifts here, too.
    assert run.period == pytest.approx(2.1, abs=1e-2)
    given = analyze(task, t, q, period=2.1)
    np.testing.assert_allclose(given.joint_drift_per_cycle, 2.1e-3, rtol=1e-4)
    assert (np.diff(given.t) > 0.0).all()


def test_motion_without_rounds_has_none(log):
    task, _, _ = log
    t = np.linspace(0.0, 3.0, 100)
    assert round_of(task, t, REST + 0.2 * t[:, None]) == np.inf
    assert round_of(task, t, REST + 0.0 * t[:, None]) == np.inf
    assert analyze(task, t, REST + 0.2 * t[:, None]).cycles == 0


@pytest.mark.usefixtures("quick_pictures", "tables_fit")
def test_log_of_another_program_is_analyzed(log, tmp_path, capsys):
    task, t, q = log
    file = table(tmp_path / "log.csv", t + 1e9, q, names_of(task))
    out = str(tmp_path / "out")
    assert main(["analyze", str(file), "--robot", "ur5", "--frame", "tool0", "--out", out]) == 0
    told = capsys.readouterr()
    assert "3 cycles of 3 s" in told.out
    assert "counted from the first" in told.err
    figures = json.loads((tmp_path / "out" / "summary.json").read_text())
    np.testing.assert_allclose(figures["joint_drift_per_cycle"], drift_of(q), atol=1e-5)
    assert figures["task_error_max"] is None
    run = Result.load(tmp_path / "out" / "run.npz")
    assert run.info["arguments"]["source"] == str(file)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "run.npz", "summary.json", "overview.png", "replay.html",
    }  # fmt: skip


def test_columns_are_known_by_many_spellings(log, tmp_path):
    task, t, q = log
    robot, names = task.robot, names_of(task)
    expected = read_joint_log(table(tmp_path / "a.csv", t, q, names), robot)
    np.testing.assert_array_equal(expected.q, q)
    assert expected.dq is None
    for k, spell in enumerate(("q_{}", "{}/position", "/joint_states/position/{}", "/joint_states/{}/position")):
        file = table(tmp_path / f"{k}.csv", t, q[:, ::-1], [spell.format(name) for name in names[::-1]])
        np.testing.assert_array_equal(read_joint_log(file, robot).q, q)
    # Velocities, columns that do not count, and a last row that was cut off.
    head = ",".join(("time", "note", *(f"q_{n}" for n in names), *(f"dq_{n}" for n in names)))
    rows = [",".join(["0.1", "begun", *["0.5"] * 6, *["2.0"] * 6]), ",".join(["0.2", "", *["0.7"] * 6, *["2.0"] * 6])]
    (tmp_path / "b.csv").write_text("\n".join((head, *rows, "0.3,,0.9")))
    read = read_joint_log(tmp_path / "b.csv", robot)
    np.testing.assert_array_equal(read.q[:, 0], [0.5, 0.7])
    np.testing.assert_array_equal(read.dq, 2.0)
    np.testing.assert_allclose(read.t, [0.0, 0.1])


@pytest.mark.usefixtures("quick_pictures")
def test_bag_of_joint_states_is_analyzed(log, tmp_path, capsys):
    pytest.importorskip("rosbags")
    task, t, q = log
    names = [*names_of(task)[::-1], "gripper"]
    values = np.column_stack((q[:, ::-1], 0.0 * t))
    write_bag(tmp_path / "bag", JointMotion(names, t, values, 2.0 + 0.0 * values))
    for path in (tmp_path / "bag", next((tmp_path / "bag").glob("*.mcap"))):
        read = read_joint_log(path, task.robot)
        np.testing.assert_array_equal(read.q, q)
        np.testing.assert_array_equal(read.dq, 2.0)
        np.testing.assert_allclose(read.t, t, atol=1e-9)
    figures = tmp_path / "a.json"
    words = f"analyze {tmp_path / 'bag'} --robot ur5 --topic /joint_states --out {tmp_path / 'out'} --json {figures}"
    assert main(words.split()) == 0
    np.testing.assert_allclose(json.loads(figures.read_text())["joint_drift_per_cycle"], drift_of(q), atol=1e-5)
    capsys.readouterr()
    assert main([*words.split()[:4], "--topic", "/other"]) == 2
    assert "not on '/other'" in capsys.readouterr().err
    assert main(["analyze", str(tmp_path), "--robot", "ur5"]) == 2
    assert "is no bag of ROS 2" in " ".join(capsys.readouterr().err.split())
    with pytest.raises(InputError, match="does not apply"):
        read_joint_log(table(tmp_path / "a.csv", t, q, names_of(task)), task.robot, topic="/joint_states")


def test_analysis_names_own_columns_and_degrees(log, tmp_path):
    task, t, q = log
    own = table(tmp_path / "own.csv", t, q, "abcdef", factor=180.0 / np.pi)
    read = read_joint_log(own, task.robot, joints=list("abcdef"), degrees=True)
    np.testing.assert_allclose(read.q, q, atol=1e-12)
    with pytest.raises(InputError, match="--degrees"):
        read_joint_log(own, task.robot, joints=list("abcdef"))
    with pytest.raises(UnknownNameError, match="shoulder_pan_joint"):
        read_joint_log(own, task.robot)
    with pytest.raises(InputError, match="6 joint names"):
        read_joint_log(own, task.robot, joints=["a"])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the first row must name"),
        ("0,1,2,3,4,5,6\n", "the first row must name"),
        ("t,{}\n0,1,1,1,1,1,1\n", "has 1 rows"),
        ("when,{}\n0,1,1,1,1,1,1\n1,1,1,1,1,1,1\n", "no column has the times"),
        ("t,{}\n1,1,1,1,1,1,1\n1,1,1,1,1,1,1\n", "line 3: times must increase"),
        ("t,{}\n0,1,1,1,1,1,1\n1e6,1,1,1,1,1,1\n", "nanoseconds"),
        ("t,{}\n0,1,1,1,1,1,x\n1,1,1,1,1,1,1\n", "line 2: every entry must be a number"),
        ("t,{}\n0,1,1,1,1,1,nan\n1,1,1,1,1,1,1\n", "line 2: every entry must be finite"),
        ("t,{}\n0,1\n1,1,1,1,1,1,1\n", "line 2: expected 7 columns"),
    ],
)
def test_file_that_cannot_be_used_is_refused(text, told, log, tmp_path):
    task, _, _ = log
    file = tmp_path / "log.csv"
    file.write_text(text.format(",".join(names_of(task))))
    with pytest.raises(InputError, match=told):
        read_joint_log(file, task.robot)


def test_command_refuses_options_that_do_not_apply(log, tmp_path, monkeypatch, capsys):
    task, t, q = log
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "log.csv", t[:5], q[:5], names_of(task))
    for words, told in (
        ("analyze log.csv", "Add --robot NAME"),
        ("analyze log.csv --robot ur5 --q0 0 0 0 0 0 0", "--q0 does not apply"),
        ("analyze log.csv --robot ur5 --further axis", "--further and --further-path do not apply"),
        ("analyze log.csv --robot ur5 --view", "--view does not apply"),
        ("analyze missing.csv --robot ur5", "missing.csv"),
        ("analyze log.csv --robot panda", "panda_joint1"),
        ("analyze log.csv --robot ur5 --period -1", "period"),
    ):
        assert main(words.split()) == 2
        assert told in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
    with pytest.raises(InputError, match="increasing"):
        analyze(task, t[::-1].copy(), q)
