"""Trajectories of poses, and points to hold, in the forms in which people have poses."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from checks import every_task, tip
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Chart,
    EosController,
    Geodesic,
    Harmonic,
    Hold,
    InputError,
    OrientationTask,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    StackedTrajectory,
    circle,
    load_robot,
    rotation_spline,
)
from eos_pin.planning import Obstacle

Q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
TURN = pin.exp3(np.array([0.4, -1.1, 0.3]))
PLACE = np.array([0.5, -0.2, 0.3])
POSE = pin.SE3(TURN, PLACE)
FLAT = np.array([*PLACE, *TURN.ravel()])
CIRCLE = circle(PLACE, 0.1, period=4.0, plane="yz")
TURNING = rotation_spline([np.eye(3), TURN, np.eye(3)], [0.0, 2.0, 4.0])
#: Nine coordinates with nine velocities, which are no rotations.
NINE = Harmonic(np.zeros(9), np.ones((1, 9)), np.zeros((1, 9)), 1.0)


@pytest.mark.parametrize("pose", [POSE, POSE.homogeneous, POSE.homogeneous.tolist()], ids=["SE3", "matrix", "lists"])
def test_hold_takes_a_pose_and_has_its_dimension(pose):
    target = Hold(pose)(0.0)
    np.testing.assert_allclose(target.z, FLAT, atol=1e-15)
    assert target.dz.shape == target.ddz.shape == (6,)
    assert Hold(pose).m == 6


def test_hold_takes_a_rotation_matrix():
    np.testing.assert_allclose(Hold(TURN)(0.0).z, TURN.ravel(), atol=1e-15)
    assert Hold(TURN).m == 3


@pytest.mark.parametrize(
    ("point", "m", "message"),
    [
        (POSE, 12, "dimension 6, but m=12"),
        (TURN, 9, "dimension 3, but m=9"),
        (2.0 * TURN, None, "orthonormal"),
        (POSE.homogeneous * [[1.0], [1.0], [1.0], [2.0]], None, "last row"),
        (np.full((4, 4), np.nan), None, "the point to hold"),
        (np.zeros((2, 2)), None, "one-dimensional"),
        ([1.0, 2.0], 1.5, "whole number"),
        ([1.0, 2.0], -1, "at least 0"),
        ([1.0, 2.0], "two", "must be a number"),
    ],
)
def test_hold_refuses_values_that_are_no_point(point, m, message, unchecked):
    with pytest.raises(InputError, match=message):
        Hold(point, m)


def test_task_hold_fits_every_task(panda):
    for task in every_task(panda).values():
        target = task.hold(Q.tolist())(3.0)
        np.testing.assert_array_equal(target.z, task.value(Q))
        assert target.dz.shape == target.ddz.shape == (task.m,)
        assert not target.dz.any()
        EosController(task, task.hold(Q))


def test_holds_are_equal_where_their_points_are():
    assert Hold([1.0, 2.0]) == Hold([1.0, 2.0])
    assert len({Hold([1.0, 2.0]), Hold([1.0, 2.0]), Hold([1.0, 3.0])}) == 2


@given(t=st.floats(0.0, 8.0))
def test_pose_trajectory_is_its_position_and_its_orientation(t):
    path = PoseTrajectory(position=CIRCLE, orientation=TURNING)
    z, dz, ddz = path(t)
    for part, points, rates in ((CIRCLE, slice(3), slice(3)), (TURNING, slice(3, None), slice(3, None))):
        target = part(t)
        np.testing.assert_allclose(z[points], target.z, atol=1e-15)
        np.testing.assert_allclose(dz[rates], target.dz, atol=1e-15)
        np.testing.assert_allclose(ddz[rates], target.ddz, atol=1e-15)
    assert path.period == 4.0


@pytest.mark.parametrize(
    "path",
    [
        PoseTrajectory(position=CIRCLE, orientation=TURN),
        PoseTrajectory(position=CIRCLE, orientation=TURN.tolist()),
        PoseTrajectory(position=CIRCLE, orientation=POSE),
        PoseTrajectory(position=CIRCLE, orientation=Hold(TURN)),
        PoseTrajectory(position=CIRCLE, orientation=Hold(TURN.ravel())),
        PoseTrajectory(position=CIRCLE, orientation=Hold(TURN.ravel(), 3)),
        PoseTrajectory(position=CIRCLE, pose=POSE),
        PoseTrajectory(position=CIRCLE, pose=POSE.homogeneous),
        PoseTrajectory(position=CIRCLE, pose=FLAT),
    ],
)
def test_pose_trajectory_keeps_the_orientation(path):
    same = StackedTrajectory((CIRCLE, Hold(TURN.ravel(), 3)))
    for t in (0.0, 0.7, 9.1):
        for one, other in zip(path(t), same(t), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-14)


@pytest.mark.parametrize(
    "path",
    [
        PoseTrajectory(PLACE, TURNING),
        PoseTrajectory(PLACE.tolist(), TURNING),
        PoseTrajectory(POSE, TURNING),
        PoseTrajectory(Hold(PLACE), TURNING),
        PoseTrajectory(orientation=TURNING, pose=POSE),
    ],
)
def test_pose_trajectory_keeps_the_position(path):
    np.testing.assert_allclose(path(1.3).z, [*PLACE, *TURNING(1.3).z], atol=1e-15)
    assert not path(1.3).dz[:3].any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "needs position and orientation, or a pose"),
        ({"position": CIRCLE}, "needs orientation, or a pose"),
        ({"orientation": TURN}, "needs position, or a pose"),
        ({"position": CIRCLE, "orientation": 2.0 * TURN}, "orthonormal"),
        ({"position": CIRCLE, "orientation": [1.0, 0.0]}, "9 numbers"),
        ({"position": CIRCLE, "orientation": CIRCLE}, "the orientation of a PoseTrajectory"),
        ({"position": TURNING, "orientation": TURN}, "the position of a PoseTrajectory"),
        ({"position": Hold(POSE), "orientation": TURN}, "the position of a PoseTrajectory"),
        ({"position": [0.0, np.nan, 0.0], "orientation": TURN}, "finite"),
        ({"position": CIRCLE, "pose": [0.0, 0.0, 0.0]}, "the pose"),
        (
            {"position": CIRCLE, "orientation": NINE},
            "the orientation",
        ),
    ],
)
def test_pose_trajectory_refuses_values_that_are_no_pose(arguments, message, unchecked):
    with pytest.raises(InputError, match=message):
        PoseTrajectory(**arguments)


def test_controller_refuses_a_reference_of_another_task_with_advice(panda):
    pose, position = PoseTask(panda, tip(panda)), PositionTask(panda, tip(panda))
    z = pose.value(Q)
    with pytest.raises(InputError, match=r"poses of 12 numbers, .* points of 3 numbers\. To keep the orientation"):
        EosController(pose, circle(z[:3], 0.1, period=4.0))
    with pytest.raises(InputError, match=r"12 velocity components, .* has 6\. .* task\.hold\(q\) or Hold\(z, m=6\)"):
        EosController(pose, Hold(z))
    with pytest.raises(InputError, match=r"points of 3 numbers, the trajectory gives points of 12 numbers$"):
        EosController(position, Hold(POSE))


def test_geodesic_takes_poses(panda):
    task = PoseTask(panda, tip(panda))
    path = Geodesic(task, [POSE, POSE.homogeneous @ POSE.homogeneous], [0.0, 1.0])
    np.testing.assert_allclose(path(0.0).z, FLAT, atol=1e-14)
    np.testing.assert_allclose(path(1.0).z[:3], (POSE * POSE).translation, atol=1e-14)


def test_obstacle_takes_a_matrix():
    import coal

    place = Obstacle(coal.Sphere(0.1), POSE.homogeneous).at(0.0)
    assert place.isApprox(POSE)
    with pytest.raises(InputError, match="orthonormal"):
        Obstacle(coal.Sphere(0.1), 2.0 * np.eye(4) + np.diag([0.0, 0.0, 0.0, -1.0])).at(0.0)


@pytest.mark.parametrize("form", [lambda pose: pose, lambda pose: pose.homogeneous])
def test_chart_inverse_takes_a_pose(panda, form, unchecked):
    task = PoseTask(panda, tip(panda))
    pose = panda.placement(Q, task.frame) * pin.SE3(np.eye(3), np.array([0.0, 0.02, 0.0]))
    found = Chart.from_base(task, Q).inverse(form(pose), [0.1])
    assert panda.placement(found.q, task.frame).isApprox(pose, 1e-9)


def test_orientation_task_takes_a_pose(panda):
    task = OrientationTask(panda, tip(panda))
    np.testing.assert_allclose(task.point(POSE), TURN.ravel(), atol=1e-15)


def test_pose_trajectory_is_the_eight_line_program():
    """Panda's hand on a circle, its orientation kept: joints close with the path."""
    from eos_pin import Atlas

    robot = load_robot("panda", chain_to="panda_hand_tcp")
    task = PoseTask(robot, "panda_hand_tcp")
    start = robot.placement(Q, "panda_hand_tcp")
    path = PoseTrajectory(position=circle(start.translation, 0.1, period=4.0, plane="yz"), orientation=start.rotation)
    found = Atlas(task).follow(Q, [path(t).z for t in np.linspace(0.0, 4.0, 101)])
    assert found.complete
    np.testing.assert_allclose(found.q[-1], found.q[0], atol=1e-9)
