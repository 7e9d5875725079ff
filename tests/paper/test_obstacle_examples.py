"""The two cited applications, as their scripts run them, checked by geometry that is not the package's."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import coal
import numpy as np
import pytest
import test_scripts

from eos_pin import Result, load_robot
from eos_pin.cli.main import run as run_command
from eos_pin.cli.output import Output
from eos_pin.paper.obstacle_examples import panda, planar_chain
from eos_pin.paper.run_obstacle_example import run_obstacle_example

pytestmark = pytest.mark.usefixtures("unchecked", "without_meshes")

FILES = {"json": "summary.json", "html": "replay.html", "plot": "figure.png", "csv": "samples.csv"}


def run(script, folder, *options):
    """Figures and run of a script."""
    wanted = [word for key, name in FILES.items() for word in (f"--{key}", str(folder / name))]
    assert run_command(test_scripts.load(script).main, ["--out", str(folder), *wanted, *options]) == 0
    assert all((folder / name).stat().st_size > 1000 for name in FILES.values())
    return json.loads((folder / "summary.json").read_text()), Result.load(folder / "run.npz")


def discs_at(t):
    """Centres and radii of the three discs."""
    angle = 2.0 * math.pi * t / 10.0
    moving = (2.1 + 0.25 * math.sin(angle), 0.5 + 0.75 * math.cos(angle), 0.25)
    return np.array([(1.0, -0.05, 0.35), (2.95, 0.15, 0.35), moving])


def chain_joints(q):
    """Joints of 23 links of 0.25 m, and the tip, in the plane."""
    heading = np.cumsum(q)
    steps = 0.25 * np.column_stack((np.cos(heading), np.sin(heading)))
    return np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))


def chain_distances(q, discs):
    """Distances of 23 capsules of radius 0.03 m from three discs, (23, 3)."""
    joints = chain_joints(q)
    start, along = joints[:-1, None], np.diff(joints, axis=0)[:, None]
    to = discs[None, :, :2] - start
    s = np.clip((to * along).sum(axis=2) / 0.25**2, 0.0, 1.0)
    return np.linalg.norm(to - s[..., None] * along, axis=2) - discs[:, 2] - 0.03


def test_23_joints_keep_every_body_clear_of_three_discs(tmp_path):
    figures, result = run("example_23dof_obstacles", tmp_path, "--cycles", "1")
    assert result.q.shape[1] == figures["n"] == 23
    assert figures["r"] == 20
    assert figures["clearance_min"] > 0.05
    assert figures["clearance_min_between_points"] > 0.05
    assert figures["task_error_max"] <= 1e-9
    assert figures["wall_seconds"] < 60.0
    assert figures["constant_v"]["clearance_min"] < -0.1
    # Ten times as densely as the path was solved, against segments and discs.
    times = np.linspace(0.0, result.t[-1], 10 * len(result.t))
    q = np.column_stack([np.interp(times, result.t, column) for column in result.q.T])
    least = min(chain_distances(*state).min() for state in zip(q, map(discs_at, times), strict=True))
    assert least > 0.05
    at_points = min(chain_distances(*state).min() for state in zip(result.q, map(discs_at, result.t), strict=True))
    assert figures["clearance_min"] == pytest.approx(at_points, abs=1e-6)
    # The path itself: a figure eight of 0.4 m by 0.8 m, while the heading nods by 0.6 rad.
    x0, heading0 = chain_joints(result.q[0])[-1], result.q[0].sum()
    for t, row in zip(result.t, result.q, strict=True):
        s, c = math.sin(math.tau * t / 10.0), math.cos(math.tau * t / 10.0)
        np.testing.assert_allclose(chain_joints(row)[-1], x0 + np.array([0.4 * s, 0.8 * s * c]), atol=1e-9)
        assert row.sum() == pytest.approx(heading0 + 0.6 * s, abs=1e-9)
    assert figures["joint_step_max"] == np.abs(np.diff(result.q, axis=0)).max() < 0.05


def test_arm_of_seven_joints_keeps_its_real_shape_clear_of_a_ball(tmp_path):
    figures, result = run("example_7dof_obstacle", tmp_path, "--cycles", "1", "--task", "pose")
    assert (figures["n"], figures["r"]) == (7, 1)
    assert figures["clearance_min_between_points"] > 0.02
    assert figures["constant_v"]["clearance_min"] < -0.005
    assert figures["task_error_max"] <= 1e-9
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    assert (robot.lower < result.q).all()
    assert (result.q < robot.upper).all()
    assert (np.abs(np.diff(result.q, axis=0)) <= robot.velocity * np.diff(result.t)[:, None]).all()
    # Every vertex of every collision mesh is clear of the ball.
    for shape in robot.collision.geometryObjects:
        if not shape.parentJoint or not isinstance(shape.geometry, coal.BVHModelBase):
            continue
        frame = robot.model.frames[shape.parentFrame]
        inside = frame.placement.actInv(shape.placement)
        points = inside.rotation @ np.asarray(shape.geometry.vertices()).T + inside.translation[:, None]
        for q in result.q[::10]:
            pose = robot.placement(q, frame.name)
            world = pose.rotation @ points + pose.translation[:, None]
            assert np.linalg.norm(world.T - [0.15, 0.06, 0.83], axis=1).min() > 0.07


def test_moving_disc_can_be_stopped_and_rounds_repeat():
    still = planar_chain(moving=False, cycles=1)
    assert np.ptp([still.clearance.obstacles[2].at(t).translation for t in (0.0, 3.0, 7.0)], axis=0).max() == 0.0
    application = planar_chain(cycles=2)
    result = application.run()
    assert result.ok
    # The first round begins with v at rest, from the second on it is the same each time.
    assert result.joint_drift_per_cycle[1] < 1e-8
    assert application.clearance.along(result.t, result.q).min() > 0.05


def test_robot_that_touches_an_obstacle_fails(capsys):
    """With a ball so near that it repels only when it is too late."""
    late = replace(panda(margin=1e-3, cycles=1), rate=25.0)
    assert run_obstacle_example(late, Output(), "too late") == 1
    assert "FAILS: every body is clear" in capsys.readouterr().out
