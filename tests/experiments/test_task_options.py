"""Tasks from options: tolerances, points of the world, and directions in files."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from checks import REST

from eos_pin import (
    DistanceTask,
    InputError,
    LookAtTask,
    Plan,
    PointAxisTask,
    ToleranceTask,
    load_robot,
    make_task,
    plan,
)
from eos_pin.cli.main import main
from eos_pin.experiments.options import ControlOptions, PathOptions, RobotOptions, TaskOptions
from eos_pin.experiments.path_files import path_from_csv
from eos_pin.trajectories.through import read_path

Q = np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2])


def test_tolerance_from_options_is_planned_and_saved(ur5, tmp_path):
    task, q = TaskOptions("pose", tolerance=("rz=0.3", "z=0.005"), q0=tuple(Q)).make(ur5, kept=True)
    assert isinstance(task, ToleranceTask)
    path = PathOptions("circle", size=0.08, plane="xy").make(task, q)
    found = plan(task, path)
    assert max(found.info["tolerance_used"].values()) <= 1.0
    again = Plan.load(found.save(tmp_path / "plan.npz"))
    np.testing.assert_allclose(again(1.3).q, found(1.3).q, atol=1e-12)


@pytest.mark.parametrize(
    ("words", "kept", "reason"),
    [
        (("rz=0.3",), False, "kept by plans"),
        (("rz",), True, "half widths by name"),
        (("a=1",), True, "tolerances of x"),
    ],
)
def test_tolerance_is_refused_where_nothing_keeps_it(ur5, words, kept, reason):
    with pytest.raises(InputError, match=reason):
        TaskOptions("pose", tolerance=words).make(ur5, kept=kept)


def test_tasks_of_points_are_made_by_kind(panda):
    looking = make_task(panda, "look-at", point=[1.0, 0.0, 0.3], tool_axis="x")
    assert isinstance(looking, LookAtTask)
    task, q = TaskOptions("look-at", point=(1.0, 0.0, 0.3)).make(panda)
    np.testing.assert_allclose(PathOptions("hold").make(task, q)(0.0).z, [0.0, 0.0, 1.0])
    assert isinstance(make_task(panda, "distance", point=(1.0, 0.0, 0.3)), DistanceTask)
    for kind, point in (("look-at", None), ("pose", [0.0, 0.0, 1.0])):
        with pytest.raises(InputError, match="a point of the world"):
            make_task(panda, kind, point=point)


def test_directions_of_a_file_are_those_of_its_columns_or_poses(ur5, tmp_path):
    task = PointAxisTask(ur5, "tool0", "x")
    z = task.value(Q)
    place, random = z[:3], np.random.default_rng(0)
    turns = [pin.exp3(0.1 * random.normal(size=3)) @ ur5.placement(Q, "tool0").rotation for _ in range(4)]
    places = place + 0.02 * random.normal(size=(4, 3))
    quaternions = [pin.Quaternion(R) for R in turns]
    named = tmp_path / "directions.csv"
    rows = [
        ",".join(map(repr, [*map(float, p), *map(float, 2.0 * R[:, 0])])) for p, R in zip(places, turns, strict=True)
    ]
    named.write_text("\n".join(["x,y,z,ax,ay,az", *rows]))
    posed = tmp_path / "poses.csv"
    rows = [",".join(map(str, [*p, q.w, q.x, q.y, q.z])) for p, q in zip(places, quaternions, strict=True)]
    posed.write_text("\n".join(["x,y,z,qw,qx,qy,qz", *rows]))
    expected = np.hstack((places, [R[:, 0] for R in turns]))
    for file in (named, posed):
        np.testing.assert_allclose(read_path(file, task, z).points, expected, atol=1e-9)
        np.testing.assert_allclose(path_from_csv(file, task, Q).points, expected, atol=1e-9)
    named.write_text("ax,ay,az\n0,0,1\n0,0,0\n")
    with pytest.raises(InputError, match="line 3: the direction ax, ay, az is zero"):
        read_path(named, task, z)


def test_point_that_moves_and_further_task_are_made_from_words(panda, tmp_path):
    rows = "0 1 0 0.3; 1 1 0.2 0.3; 2 1 0 0.3"
    (tmp_path / "point.csv").write_text("t,x,y,z\n" + rows.replace(" ; ", "\n").replace("; ", "\n").replace(" ", ","))
    made = [TaskOptions("look-at", point=(text,)).make(panda, led=True) for text in (rows, str(tmp_path / "point.csv"))]
    for task, _ in made:
        assert task.moves
        np.testing.assert_allclose(task.centre(1.0).z, [1.0, 0.2, 0.3], atol=1e-12)
        np.testing.assert_allclose(task.centre(3.0).z, [1.0, 0.2, 0.3], atol=1e-12)
    # Point and axis are those of the task that needs them.
    options = TaskOptions("position", point=(1.0, 0.0, 0.3), tool_axis="x", further="look-at")
    task, _ = options.make(panda, led=True)
    further, aim = options.make_further(panda, REST)
    assert isinstance(further, LookAtTask)
    np.testing.assert_allclose(aim(0.0).z, [1.0, 0.0, 0.0])
    assert TaskOptions().make_further(panda, REST) is None
    for words, options in (
        ("leave out --further", {"further": "axis"}),
        ("a .csv file", {"task": "look-at", "point": ("a",)}),
        ("each row of --point", {"task": "look-at", "point": ("0 1 2; 1 2 3",)}),
        ("a point at rest", {"task": "distance", "point": (rows,)}),
    ):
        with pytest.raises(InputError, match=words):
            TaskOptions(**options).make(panda, led="further" not in options)


def test_further_path_is_a_turn_about_the_tool_or_a_path_as_any(panda, tmp_path):
    (tmp_path / "roll.csv").write_text("t,z1\n0,0\n1,0.5\n2,-0.2\n")
    (tmp_path / "turns.csv").write_text("t,roll,pitch,yaw\n0,0,0,0\n1,0.1,0,0\n")
    R = panda.placement(REST, "panda_hand_tcp").rotation
    for words in ("0 0; 1 0.5; 2 -0.2", str(tmp_path / "roll.csv")):
        options = TaskOptions("point-axis", tool_axis="-x", further="orientation", further_path=words)
        task, path = options.make_further(load_robot("panda", chain_to="panda_hand_tcp"), REST)
        for t, angle in ((0.0, 0.0), (1.0, 0.5), (2.0, -0.2), (9.0, -0.2)):
            z, dz, ddz = path(t)
            np.testing.assert_allclose(z.reshape(3, 3), R @ pin.exp3(np.array([-angle, 0.0, 0.0])), atol=1e-12)
        # Rates are those of the rotation, in the axes of the world.
        t, h = 0.37, 1e-5
        (z, dz, ddz), ahead, behind = path(t), path(t + h), path(t - h)
        np.testing.assert_allclose((task.minus(ahead.z, z) - task.minus(behind.z, z)) / (2 * h), dz, atol=1e-8)
        np.testing.assert_allclose((ahead.dz - behind.dz) / (2 * h), ddz, atol=1e-8)
    _, path = TaskOptions(further="orientation", further_path=str(tmp_path / "turns.csv")).make_further(panda, REST)
    np.testing.assert_allclose(path(1.0).z.reshape(3, 3), pin.exp3(np.array([0.1, 0.0, 0.0])), atol=1e-12)
    _, path = TaskOptions(further="com", further_path="0.1 0 0.3; 0.1 0 0.4").make_further(panda, REST)
    np.testing.assert_allclose(path(path.duration).z, [0.1, 0.0, 0.4], atol=1e-12)
    for told, words in (
        ("got 'circle'", {"further": "com", "further_path": "circle"}),
        ("--point moves", {"further": "look-at", "point": (1.0, 0.0, 0.3), "further_path": "0 0; 1 1"}),
        ("at least two rows", {"further": "orientation", "further_path": "0 0;"}),
        ("increase", {"further": "orientation", "further_path": "0 0; 0 1"}),
        ("--tool-axis x does not apply", {"further": "orientation", "tool_axis": "x", "further_path": "0 0 0; 0 0 1"}),
        ("has 4 numbers|has 5 numbers", {"further": "orientation", "further_path": "0 0 0 0 1; 0 0 1 1 1"}),
    ):
        with pytest.raises(InputError, match=told):
            TaskOptions(**words).make_further(panda, REST)


@pytest.mark.usefixtures("unchecked", "quick_pictures")
@pytest.mark.parametrize("path", ["", "0 0; 0.5 0.3; 1 0"])
def test_further_task_is_done_by_torques(tmp_path, path):
    words = "track ur5 --task point-axis --further orientation --size 0.02 --period 1 --cycles 1"
    assert main([*words.split(), *["--further-path", path] * bool(path), "--out", str(tmp_path)]) == 0
    beside = json.loads((tmp_path / "summary.json").read_text())["further_task"]
    assert beside["kind"] == "orientation"
    assert beside["error_max"] < 1e-6


def test_further_task_and_its_path_are_two_things_of_their_kinds(panda):
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    task, q = TaskOptions().make(robot)
    further, path = TaskOptions(further="com").make_further(robot, REST)
    control = ControlOptions()
    assert control.make(task, task.hold(q), q, None, further=[further, path]).self_motion.task is further
    for wrong in ([further], [path, further], [further, path, path], further):
        with pytest.raises(InputError, match="further must be"):
            control.make(task, task.hold(q), q, None, further=wrong)


def test_two_hands_and_combined_joints_are_tasks_of_options():
    robot = RobotOptions("baxter", frame="left_gripper", seen_from="right_gripper").load()
    assert robot.n == 14
    assert robot.options["branch_to"] == "right_gripper"
    task, q = TaskOptions("relative-pose").make(robot)
    left, right = (robot.placement(q, f"{side}_gripper") for side in ("left", "right"))
    np.testing.assert_allclose(task.value(q)[:3], right.actInv(left).translation, atol=1e-12)
    ur5 = load_robot("ur5", chain_to="tool0")
    joints, q = TaskOptions("joints", combine=("shoulder_pan_joint=1,elbow_joint=-0.5",)).make(ur5)
    np.testing.assert_allclose(joints.value(q), [q[0] - 0.5 * q[2]], atol=1e-12)
    for words, options in (
        ("relative-pose, which needs one", {"task": "relative-pose"}),
        ("task joints, which needs", {"task": "joints"}),
        ("factors of joints by name", {"task": "joints", "combine": ("a",)}),
        ("task joints, which needs", {"combine": ("elbow_joint=1",)}),
    ):
        with pytest.raises(InputError, match=words):
            TaskOptions(**options).make(ur5)
    with pytest.raises(InputError, match="give chain_to, too"):
        load_robot("baxter", branch_to="right_gripper")
