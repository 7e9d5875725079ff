"""Runs of robots that take positions or velocities: `simulate_kinematic`, `eos-pin track --command`, and the page."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from eos_pin import (
    Damp,
    FollowJoints,
    Hold,
    InputError,
    JointLimits,
    KinematicLoop,
    PositionTask,
    Result,
    Target,
    Trajectory,
    circle,
    load_robot,
    simulate_kinematic,
)
from eos_pin.cli.main import main
from eos_pin.experiments.commanded import commanded_loop, run_commanded
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.experiments.options import ControlOptions, TaskOptions
from eos_pin.plots import overview
from eos_pin.simulation.kinematic import SAME, chart_following

PAGE = (Path(__file__).parents[2] / "docs" / "positions.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture
def ran(ur5):
    """A loop on ur5 and its run of three rounds."""
    task = make_task(ur5)
    q = rest_posture(task)
    loop = KinematicLoop(task, fitting_path(task, q, period=4.0), control_period=0.008)
    return loop, simulate_kinematic(loop, q, duration=12.0)


def test_run_tracks_and_repeats_to_rounding(ran):
    _, run = ran
    assert run.ok
    summary = run.summary()
    assert run.cycles == 3
    assert np.abs(run.error[run.t > 4.0]).max() < 1e-9
    assert summary["joint_drift_per_cycle"][-1] < 1e-9
    assert np.abs(run.self_motion_error[run.t > 4.0]).max() < 1e-9
    assert summary["limits"]["velocity"]["ratio"] <= 1.0
    assert not summary["limits"]["passed"]
    assert summary["cpu_seconds"] > 0.0
    assert run.info["arguments"]["control_period"] == 0.008
    assert run.info["controller"]["kind"] == "KinematicLoop"


def test_samples_are_those_of_a_servo(ran):
    loop, run = ran
    periods = run.t / 0.008
    assert np.abs(periods - np.round(periods)).max() < SAME
    # Between samples the velocity is another in every period; the velocity of a sample led to it.
    loop.reset()
    q, found = run.q[0], [run.q[0]]
    for k in range(500):
        command = loop.step(k * 0.008, q)
        np.testing.assert_allclose(command.q, q + 0.008 * command.dq, atol=1e-12)
        q = command.q
        found.append(q)
    rows = np.round(periods[periods < 500.5]).astype(int)
    np.testing.assert_allclose(run.q[: len(rows)], np.array(found)[rows], atol=1e-12)
    assert np.isnan(run.tau).all()
    residuals = run.residuals(loop.robot)
    assert residuals["task"] < 1e-12
    assert np.isnan([residuals["torque"], residuals["power"]]).all()
    energy = [loop.robot.kinetic_energy(*row) for row in zip(run.q, run.dq, strict=True)]
    np.testing.assert_allclose(run.kinetic_energy, energy, atol=1e-12)
    np.testing.assert_allclose(run.dz, [loop.task.at(*row).dz for row in zip(run.q, run.dq, strict=True)], atol=1e-12)


def test_residuals_of_a_robot_without_inertia_are_those_of_the_task():
    joints = "".join(
        f'<joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/></joint><link name="l{i}"/>'
        for i in range(3)
    )
    robot = load_robot(f'<robot name="arm">{joints}<link name="l3"/></robot>')
    task, q = PositionTask(robot, "l3", axes="xy"), np.array([0.3, 0.9, -0.5])
    run = chart_following(task, circle(task.value(q), 0.05, period=1.0), q, duration=1.0)
    residuals = run.residuals(robot)
    assert residuals["task"] < 1e-9
    assert np.isnan([residuals["torque"], residuals["power"]]).all()


def test_run_is_saved_drawn_and_read_again(ran, tmp_path):
    _, run = ran
    again = Result.load(run.save(tmp_path / "run.npz"))
    np.testing.assert_array_equal(again.q, run.q)
    assert again.summary()["joint_drift_per_cycle"] == run.summary()["joint_drift_per_cycle"]
    assert overview(again).axes


def test_robot_without_inertia_is_commanded():
    text = (Path(__file__).parents[2] / "robots" / "ppr.urdf").read_text(encoding="utf-8")
    bare = load_robot(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL))
    assert bare.lacks_dynamics
    task = make_task(bare)
    q = rest_posture(task)
    loop = KinematicLoop(task, fitting_path(task, q, period=2.0), control_period=0.01)
    run = simulate_kinematic(loop, q, duration=4.0)
    assert run.ok
    assert math.isnan(run.summary()["kinetic_energy_mean"])
    assert overview(run, bare).axes


def test_joints_that_are_followed_are_reported(ur5):
    task = make_task(ur5)
    q = rest_posture(task)

    def joints(t):
        return q + 0.2 * t, 0.2 + 0.0 * q, 0.0 * q

    class Path(Trajectory):
        def __call__(self, t):
            point = task.at(*joints(t)[:2])
            return Target(point.z, point.dz, point.drift)

    run = simulate_kinematic(KinematicLoop(task, Path(), FollowJoints(joints), control_period=0.01), q, duration=2.0)
    assert run.ok
    assert run.summary()["joint_distance"]["end"] < 1e-5


def test_run_that_ends_early_keeps_its_samples(ur5):
    task = make_task(ur5)
    q = rest_posture(task)
    z = task.value(q)

    class Wild(Trajectory):
        def __call__(self, t):
            if t > 0.5:
                raise InputError("the way ends here")
            return Target(z, 0.0 * z, 0.0 * z)

    run = simulate_kinematic(KinematicLoop(task, Wild(), control_period=0.01), q, duration=2.0)
    assert run.status == "failed"
    assert "the way ends here" in run.message
    assert 0.4 < run.t[-1] <= 0.5


def test_task_out_of_reach_is_degraded(ur5):
    task = PositionTask(ur5, "tool0")
    q = rest_posture(task)
    loop = KinematicLoop(task, Hold(task.value(q) + np.array([3.0, 0.0, 0.0])), Damp(), control_period=0.01)
    run = simulate_kinematic(loop, q, duration=3.0)
    assert run.status == "degraded"
    assert "given up" in run.message


def test_wrong_arguments_are_refused(ur5):
    task = make_task(ur5)
    q = rest_posture(task)
    loop = KinematicLoop(task, Hold(task.value(q)), control_period=0.01)
    with pytest.raises(InputError, match="shorter"):
        simulate_kinematic(loop, q, duration=1e9)
    with pytest.raises(InputError, match="duration"):
        simulate_kinematic(loop, q, duration=-1.0)
    with pytest.raises(InputError, match="q at the start"):
        simulate_kinematic(loop, q[:3], duration=1.0)
    with pytest.raises(InputError, match="KinematicLoop"):
        simulate_kinematic(None, q, duration=1.0)


@pytest.mark.usefixtures("quick_pictures")
def test_track_commands_positions(tmp_path, capsys):
    words = (
        "track ur5 --task point-axis --further orientation --command position --control-rate 100 --period 4 --cycles 3"
    )
    words += " --cycles 2 --acceleration 20"
    # The roll of the tool goes its own way, which the task leaves free.
    roll = ["--further-path", "0 0; 2 0.8; 4 0"]
    files = f"--json {tmp_path}/a.json --csv {tmp_path}/a.csv --html {tmp_path}/a.html --plot {tmp_path}/a.png"
    assert main([*words.split(), *roll, "--out", str(tmp_path), *files.split()]) == 0
    assert "torque" not in capsys.readouterr().out
    figures = json.loads((tmp_path / "a.json").read_text())
    assert figures["joint_drift_per_cycle"][-1] < 1e-7
    assert figures["torque_max"] is None
    assert figures["further_task"]["kind"] == "orientation"
    assert figures["further_task"]["error_max"] < 1e-9
    run = Result.load(tmp_path / "run.npz")
    assert np.abs(run.further_error[run.settled_row :]).max() == figures["further_task"]["error_max"]
    turn = [run.load_plant().placement(q, run.frame).rotation for q in run.q]
    rolled = pin.log3(turn[0].T @ turn[np.searchsorted(run.t, 6.0)])
    np.testing.assert_allclose(rolled, [0.0, 0.0, 0.8], atol=1e-9)
    assert run.info["arguments"]["acceleration"] == [20.0] * 6
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", "a.csv", "a.html", "a.png", "run.npz"}


def test_velocities_are_commanded_with_the_same_options(ur5):
    control = ControlOptions(command="velocity", kp=50.0, self_motion="damp", chart_margin=0.6)
    task, q = TaskOptions().make(ur5)
    run = run_commanded(commanded_loop(control, task, task.hold(q), q), q, 0.1)
    assert run.ok
    assert run.info["controller"]["kp"] == [50.0] * 3
    assert run.info["arguments"]["control_period"] == 0.002


def test_page_runs_as_it_stands():
    names: dict = {}
    for example in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(example, "positions.md", "exec"), names)
    assert names["result"].ok
    assert names["result"].joint_drift_per_cycle[-1] < 1e-9

    class Control:
        """Stand-in for an RTDEControlInterface."""

        def __init__(self):
            self.joints = names["q"].tolist()

        def initPeriod(self):
            return 0.0

        def waitPeriod(self, start):
            pass

        def servoJ(self, q, speed, acceleration, period, lookahead, gain):
            self.joints = q

        def servoStop(self):
            pass

        def stopScript(self):
            pass

        def getActualQ(self):
            return self.joints

        def getActualQd(self):
            return [0.0] * 6

    robot = Control()
    connection, loop = names["UrConnection"](robot, robot), names["loop"]
    loop.reset()
    for k in range(3):
        connection.write(loop.step(0.002 * k, connection.read().q).q)
    connection.close()
    np.testing.assert_array_equal(robot.joints, loop.step(0.004, np.array(robot.joints)).q)
    assert isinstance(loop.limits, JointLimits)
