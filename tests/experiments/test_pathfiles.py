"""Paths from files and task points from numbers: columns against tasks, times, units, and reach."""

from __future__ import annotations

import numpy as np
import pytest
from checks import tip

from eos_pin import (
    Atlas,
    ComTask,
    HeadingTask,
    InputError,
    OrientationTask,
    PoseTask,
    PositionTask,
    RelativePoseTask,
    StackedTask,
    load_robot,
    path_from_csv,
)
from eos_pin.experiments.path_files import points_along, task_point
from eos_pin.trajectories.waypoints import from_angles

Q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])


def written(tmp_path, text):
    path = tmp_path / "path.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def arm():
    return load_robot("panda", chain_to="panda_hand_tcp")


@pytest.fixture(scope="module")
def planar():
    return load_robot("planar_chain_10", chain_to="auto")


PLACES = np.array([[0.5, 0.0, 0.5], [0.5, 0.1, 0.6], [0.45, 0.1, 0.5]])
ANGLES = np.array([[3.1, 0.0, 0.0], [3.0, 0.2, 0.3], [2.8, 0.0, -0.3]])


def rows(names, *blocks):
    return names + "\n" + "\n".join(",".join(map(repr, row.tolist())) for row in np.column_stack(blocks)) + "\n"


def test_path_of_poses_goes_through_its_rows(arm, tmp_path):
    text = rows("t,x,y,z,roll,pitch,yaw", [5.0, 6.0, 8.0], PLACES, ANGLES)
    path = path_from_csv(written(tmp_path, text), PoseTask(arm, tip(arm)), Q)
    for t, place, R in zip([0.0, 1.0, 3.0], PLACES, from_angles(ANGLES), strict=True):
        np.testing.assert_allclose(path(t).z, [*place, *R.ravel()], atol=1e-13)
    assert "begin at 5 s; they are counted from there" in path.notes[0]
    assert path.duration == 3.0


def test_path_of_a_pose_keeps_coordinates_without_columns(arm, tmp_path):
    task = PoseTask(arm, tip(arm))
    z0 = task.value(Q)
    path = path_from_csv(written(tmp_path, rows("t,z,x,y", [0.0, 1.0, 2.0], PLACES[:, [2, 0, 1]])), task, Q)
    np.testing.assert_allclose(path(1.0).z, [*PLACES[1], *z0[3:]], atol=1e-14)
    path = path_from_csv(written(tmp_path, rows("t,roll,pitch,yaw", [0.0, 1.0, 2.0], ANGLES)), task, Q)
    np.testing.assert_allclose(path(1.0).z, [*z0[:3], *from_angles(ANGLES)[1].ravel()], atol=1e-13)


def test_path_of_orientations_reports_positions_as_unused(arm, tmp_path):
    text = rows("t,x,y,z,roll,pitch,yaw", [0.0, 1.0, 2.0], PLACES, ANGLES)
    path = path_from_csv(written(tmp_path, text), OrientationTask(arm, tip(arm)), Q)
    np.testing.assert_allclose(path(1.0).z, from_angles(ANGLES)[1].ravel(), atol=1e-13)
    assert "x, y, z of" in path.notes[0]
    assert "do not count" in path.notes[0]


def test_path_without_names_is_in_the_order_of_a_task_point(arm, tmp_path):
    pose, turn = PoseTask(arm, tip(arm)), OrientationTask(arm, tip(arm))
    text = rows("", [0.0, 1.0, 2.0], PLACES, ANGLES).strip()
    path = path_from_csv(written(tmp_path, text), pose, Q)
    np.testing.assert_allclose(path(1.0).z, task_point(pose, [*PLACES[1], *ANGLES[1]], Q), atol=1e-13)
    path = path_from_csv(written(tmp_path, rows("", [0.0, 1.0, 2.0], ANGLES).strip()), turn, Q)
    np.testing.assert_allclose(path(1.0).z, task_point(turn, ANGLES[1], Q), atol=1e-13)


def test_path_of_a_planar_pose_takes_the_short_way_and_reports_it(planar, tmp_path):
    task = StackedTask([PositionTask(planar, tip(planar), "xy"), HeadingTask(planar, tip(planar))])
    q = np.full(10, 0.1)
    x, y, _ = task.value(q)
    text = f"t,x,y,heading\n0,{x},{y},3.1\n1,{x},{y},-3.1\n"
    path = path_from_csv(written(tmp_path, text), task, q)
    assert path(1.0).z[2] == pytest.approx(2.0 * np.pi - 3.1)
    assert "shorter way" in path.notes[0]
    path = path_from_csv(written(tmp_path, f"t,x,y\n0,{x},{y}\n1,{x},{y - 0.1}\n"), task, q)
    np.testing.assert_allclose(path(1.0).z, [x, y - 0.1, task.value(q)[2]])
    path = path_from_csv(written(tmp_path, f"0,{x},{y},0.1\n1,{x},{y},0.2\n"), task, q)
    assert path(1.0).z[2] == 0.2
    path = path_from_csv(written(tmp_path, "t,heading\n0,0\n1,0.5\n"), HeadingTask(planar, tip(planar)), q)
    assert path(1.0).z.tolist() == [0.5]


@pytest.mark.parametrize(
    ("text", "kind", "told"),
    [
        ("t,x,y,z,qw,qx,qy,qz\n0,.5,0,.5,1,0,0,0\n1,.5,0,.6,1,0,0,0\n", "position", "Choose the task pose"),
        ("t,x,y\n0,.5,0\n1,.5,0\n", "position", "needs the columns x, y, z; z is missing among t, x, y"),
        ("t,x,y\n0,.5,0\n1,.5,0\n", "pose", "z is missing"),
        ("t,x,y,z,heading\n0,.5,0,.5,0\n1,.5,0,.6,0\n", "pose", "heading is for planar robots"),
        ("t,x,y,z\n0,.5,0,.5\n1,.5,0,.6\n", "orientation", "takes qw, qx, qy, qz or roll, pitch, yaw"),
        ("0,.5,0\n1,.5,0\n", "position", r"rows have 2 coordinates, but .* has 3 \(x, y, z\)"),
        ("0,.5,0\n1,.5,0\n", "pose", "has 2 numbers; a pose is 3"),
        ("0,.5,0,1,1,1\n1,.5,0,0,0,0\n", "orientation", "has 5 numbers; an orientation is 3"),
        ("0,.5,0,.5,0,0,0,1\n1,.5,0,.5,0,0,0,1.1\n", "pose", r"line 2: a quaternion has length 1"),
        ("t,x,y,z\n0,.5,0,.5\n", "position", "at least two rows"),
        ("x,y,z\n.5,0,.5\n.5,0,.5\n", "position", "line 3 repeats line 2"),
    ],
)
def test_path_that_does_not_fit_the_task_is_refused(arm, tmp_path, text, kind, told):
    kinds = {"position": PositionTask, "pose": PoseTask, "orientation": OrientationTask}
    with pytest.raises(InputError, match=told) as error:
        path_from_csv(written(tmp_path, text), kinds[kind](arm, tip(arm)), Q)
    assert "path.csv" in str(error.value)


def test_path_along_fewer_axes_names_the_unused_column(arm, tmp_path):
    path = path_from_csv(
        written(tmp_path, rows("t,x,y,z", [0.0, 1.0, 2.0], PLACES)), PositionTask(arm, tip(arm), "xz"), Q
    )
    np.testing.assert_allclose(path(1.0).z, PLACES[1, [0, 2]])
    assert "column y" in path.notes[0]


# -- times -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [1.0, 0.001])
def test_path_without_times_keeps_the_velocity_limits(tmp_path, factor):
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    robot.model.velocityLimit[:] *= factor
    task = PoseTask(robot, tip(robot))
    z0 = task.value(Q)
    places = z0[:3] + np.array([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.1, 0.05], [0.05, 0.1, 0.05]])
    path = path_from_csv(written(tmp_path, rows("x,y,z", places)), task, Q)
    assert "has no times: it takes" in path.notes[0]
    t = np.linspace(0.0, path.duration, 400)
    speed = [np.linalg.norm(path(s).dz[:3]) for s in t[100:300]]
    assert max(speed) < 2.0 * min(speed)
    found = Atlas(task).follow(Q, [path(s).z for s in t])
    ratio = (np.abs(np.diff(found.q, axis=0)) / t[1] / robot.velocity).max()
    assert ratio < 1.0
    if factor < 1.0:
        assert ratio == pytest.approx(0.6, rel=0.05)


@pytest.mark.parametrize(
    ("scale", "unit"), [(1e3, "milliseconds, divide them by 1000"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_path_in_another_unit_of_time_is_refused(arm, tmp_path, scale, unit):
    text = rows("t,x,y,z", scale * (1.7e9 + np.array([0.0, 1.0, 2.0])), PLACES)
    task = PositionTask(arm, tip(arm))
    with pytest.raises(InputError, match=f"hardly moves.*{unit}.*--duration"):
        path_from_csv(written(tmp_path, text), task, Q)
    path = path_from_csv(written(tmp_path, text), task, Q, patient=True)
    assert path.duration == pytest.approx(2.0 * scale)
    if scale > 1e3:
        with pytest.raises(InputError, match="up to 300,000 are possible"):
            points_along(path)


def test_path_that_is_long_but_moves_is_taken(arm, tmp_path):
    t = np.arange(0.0, 1200.0, 4.0)
    places = PLACES[0] + 0.1 * np.column_stack((np.sin(t), np.cos(t), 0.0 * t))
    path = path_from_csv(written(tmp_path, rows("t,x,y,z", t, places)), PositionTask(arm, tip(arm)), Q)
    assert path.duration == 1196.0
    assert len(points_along(path)) == 119601


# -- reach -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scale", "unit"), [(100.0, "centimetres"), (1e3, "millimetres"), (1e6, "micrometres")])
@pytest.mark.parametrize("kind", [PositionTask, PoseTask])
def test_path_in_another_unit_of_length_is_refused(arm, tmp_path, kind, scale, unit):
    text = rows("t,x,y,z", [0.0, 1.0, 2.0], scale * PLACES)
    with pytest.raises(InputError, match=rf"path\.csv, line 3: the point .* m from the base .* {unit}, divide by"):
        path_from_csv(written(tmp_path, text), kind(arm, tip(arm)), Q)


def test_balls_contain_every_posture():
    random = np.random.default_rng(0)
    for name in ("panda", "ur5", "ppr", "planar_chain_10", "kinova", "talos_left_arm"):
        robot = load_robot(name, chain_to="auto")
        lower, upper = np.maximum(robot.lower, -4.0), np.minimum(robot.upper, 4.0)
        tasks = [PositionTask(robot, tip(robot), "xy"), ComTask(robot, "xy")]
        if robot.n >= 6:
            tasks.append(PoseTask(robot, tip(robot)))
        if robot.n >= 4:
            tasks.append(StackedTask(tasks[:2]))
        for task in tasks:
            found = task.balls()
            assert len(found) == (2 if isinstance(task, StackedTask) else 1) or not np.isfinite(robot.upper).all()
            for q in random.uniform(lower, upper, (200, robot.n)):
                for rows_, center, radius in found:
                    assert np.linalg.norm(task.value(q)[rows_] - center) <= radius


def test_balls_are_tight_for_a_stretched_arm(planar):
    task = PositionTask(planar, tip(planar), "xy")
    for rows_, center, radius in task.balls():
        straight = np.zeros(planar.n)
        straight[:2] = planar.upper[:2]
        assert np.linalg.norm(task.value(straight)[rows_] - center) > 0.6 * radius


def test_path_of_a_relative_pose_takes_the_columns_of_poses(tmp_path):
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    task = RelativePoseTask(robot, "panda_hand_tcp", "panda_link0")
    q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
    z = task.value(q)
    pose = PoseTask(robot, "panda_hand_tcp")
    np.testing.assert_allclose(z, pose.value(q), atol=1e-12)
    places = z[:3] + np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.01], [0.03, -0.02, 0.0]])
    file = written(tmp_path, rows("t,x,y,z", [0.0, 1.0, 2.0], places))
    for t in (0.0, 0.7, 2.0):
        np.testing.assert_allclose(path_from_csv(file, task, q)(t).z, path_from_csv(file, pose, q)(t).z, atol=1e-12)


# -- task points -----------------------------------------------------------------------------------------------------


def test_task_point_takes_the_counts_of_its_task(arm):
    pose, place, turn = PoseTask(arm, tip(arm)), PositionTask(arm, tip(arm)), OrientationTask(arm, tip(arm))
    R = from_angles(ANGLES)[1]
    half = 0.5 * ANGLES[1, 0]
    np.testing.assert_array_equal(task_point(place, PLACES[0], Q), PLACES[0])
    np.testing.assert_array_equal(task_point(pose, PLACES[0], Q), [*PLACES[0], *pose.value(Q)[3:]])
    np.testing.assert_allclose(task_point(pose, [*PLACES[0], *ANGLES[1]], Q), [*PLACES[0], *R.ravel()], atol=1e-14)
    np.testing.assert_allclose(task_point(pose, [*PLACES[0], *R.ravel()], Q), [*PLACES[0], *R.ravel()], atol=1e-14)
    turned = task_point(pose, [*PLACES[0], np.sin(half), 0.0, 0.0, np.cos(half)], Q)
    np.testing.assert_allclose(turned[3:], from_angles(np.array([[3.0, 0.0, 0.0]]))[0].ravel(), atol=1e-14)
    np.testing.assert_allclose(task_point(turn, ANGLES[1], Q), R.ravel(), atol=1e-14)
    np.testing.assert_allclose(task_point(turn, R.ravel(), Q), R.ravel(), atol=1e-14)


@pytest.mark.parametrize(
    ("kind", "values", "told"),
    [
        (PositionTask, [0.5, 0.0], r"must be 3 numbers \(x, y, z\)"),
        (PositionTask, [0.5, 0.0, 0.5, 0.0], "must be 3 numbers"),
        (PositionTask, [500.0, 0.0, 500.0], "millimetres"),
        (PoseTask, [0.5, 0.0], "2 numbers; a pose is 3"),
        (PoseTask, [0.5, 0.0, 0.5, 90.0, 0.0, 0.0], "degrees"),
        (PoseTask, [0.5, 0.0, 0.5, 1.0, 1.0, 0.0, 0.0], "quaternion"),
        (PoseTask, [0.5, 0.0, 0.5, *np.arange(9.0)], "no rotation matrix"),
        (OrientationTask, [0.5, 0.0], "2 numbers; an orientation is 3"),
        (PositionTask, [np.nan, 0.0, 0.0], "finite"),
    ],
)
def test_task_point_that_is_none_is_refused(arm, kind, values, told):
    with pytest.raises(InputError, match=told):
        task_point(kind(arm, tip(arm)), values, Q)
