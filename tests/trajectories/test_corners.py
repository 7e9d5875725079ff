"""Way points on straight lines: corners that are rounded or stopped at, and the pace along them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from checks import tip
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from eos_pin import InputError, PointAxisTask, PoseTask, PositionTask, load_robot, path_from_csv
from eos_pin.trajectories.corners import AGILITY, paced, rounded
from eos_pin.trajectories.spline import Geodesic
from eos_pin.trajectories.through import read_path, waypoint_path

Q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
SQUARE = "0.5 0 0.4; 0.5 0.2 0.4; 0.5 0.2 0.5; 0.5 0 0.5"


@pytest.fixture(scope="module")
def arm():
    return load_robot("panda", chain_to="panda_hand_tcp")


def distance(points, corners):
    """Distance of each point from a chain of straight lines."""
    found = []
    for a, b in pairwise(corners):
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        found.append(np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
    return np.min(found, axis=0)


@given(seed=st.integers(0, 10_000), closed=st.booleans(), blend=st.none() | st.floats(0.01, 0.3))
def test_rounded_corners_leave_the_lines_by_three_eighths_of_the_blend_at_most(arm, seed, closed, blend):
    corners = np.random.default_rng(seed).uniform(-1.0, 1.0, (5, 3))
    if closed:
        corners[-1] = corners[0]
    points = rounded(PositionTask(arm, tip(arm)), corners, blend, closed=closed)
    size = 0.1 * np.linalg.norm(np.diff(corners, axis=0), axis=1).max() if blend is None else blend
    assert distance(points, corners).max() <= 0.375 * size + 1e-12
    if closed:
        np.testing.assert_array_equal(points[0], points[-1])
    else:
        np.testing.assert_allclose(points[[0, -1]], corners[[0, -1]], atol=1e-15)


def test_rounded_straight_line_stays_straight_and_goes_forward(arm):
    corners = np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 0.0], [1.0, 0.5, 0.0]])
    points = rounded(PositionTask(arm, tip(arm)), corners, 0.05)
    assert distance(points, corners).max() < 1e-15
    assert (np.diff(points[:, 0]) > 0.0).all()


def test_rounded_poses_turn_about_one_axis_from_corner_to_corner(arm):
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.6, 0.3, 0.0], [0.6, 0.3, 0.5]])
    corners = np.hstack((np.eye(3), turns.as_matrix().reshape(-1, 9)))
    points = rounded(PoseTask(arm, tip(arm)), corners, 0.1)
    vectors = Rotation.from_matrix(points[:, 3:].reshape(-1, 3, 3)).as_rotvec()
    first = np.linalg.norm(points[:, :3] - corners[1, :3], axis=1) > 0.1
    first &= points[:, 0] > points[:, 2]
    assert np.abs(np.cross(vectors[first], [0.6, 0.3, 0.0])).max() < 1e-12


@given(seed=st.integers(0, 10_000), closed=st.booleans())
def test_pace_keeps_speed_and_acceleration(seed, closed):
    angles = np.random.default_rng(seed).uniform(-0.6, 0.6, 60).cumsum()
    steps = np.random.default_rng(seed + 1).uniform(0.01, 0.1, 60)[:, None] * np.column_stack(
        (np.cos(angles), np.sin(angles))
    )
    times = paced(steps, closed=closed)
    lengths, spans = np.linalg.norm(steps, axis=1), np.diff(times)
    speeds = lengths / spans
    assert speeds.max() <= 1.0 + 1e-12
    # Mean speeds of neighbouring steps differ by what the acceleration allows between their middles.
    assert (np.abs(np.diff(speeds)) <= AGILITY * 0.5 * (spans[1:] + spans[:-1]) + 1e-12).all()
    bends = np.linalg.norm(np.diff(steps / lengths[:, None], axis=0), axis=1) / (0.5 * (lengths[1:] + lengths[:-1]))
    assert (speeds[1:] ** 2 * bends <= AGILITY + 2.0 * AGILITY * lengths[1:] * bends + 1e-9).all()


@pytest.mark.parametrize("kind", [PositionTask, PoseTask])
def test_path_with_stops_rests_at_every_way_point(arm, kind):
    task = kind(arm, tip(arm))
    path = path_from_csv(SQUARE, task, Q, corners="stop")
    assert isinstance(path, Geodesic)
    corners = np.array([[0.5, 0.0, 0.4], [0.5, 0.2, 0.4], [0.5, 0.2, 0.5], [0.5, 0.0, 0.5]])
    for t, corner in zip(path.times.tolist(), corners, strict=True):
        np.testing.assert_allclose(path(t).z[:3], corner, atol=1e-14)
        assert np.abs(path(t).dz).max() < 1e-12
    shown = np.array([path(t).z[:3] for t in np.linspace(0.0, path.duration, 200)])
    assert distance(shown, corners).max() < 1e-14


@pytest.mark.parametrize("kind", [PositionTask, PoseTask])
def test_path_with_round_corners_never_stops_within(arm, kind):
    path = path_from_csv(SQUARE, kind(arm, tip(arm)), Q, corners="round", blend=0.03)
    moving = [np.linalg.norm(path(t).dz[:3]) for t in np.linspace(0.2, path.duration - 0.2, 100)]
    assert min(moving) > 0.01
    assert np.abs(path(0.0).dz).max() < 1e-12


def test_way_points_of_a_point_with_an_axis_keep_the_axis(arm):
    task = PointAxisTask(arm, tip(arm))
    z = task.value(Q)
    for corners in ("smooth", "round", "stop"):
        path = read_path(SQUARE, task, z, corners=corners)
        np.testing.assert_allclose(path(0.5).z[3:], z[3:], atol=1e-12)


def test_closed_path_with_stops_repeats(arm):
    task = PositionTask(arm, tip(arm))
    path = waypoint_path(task, [[0.5, 0.0, 0.4], [0.5, 0.2, 0.4], [0.6, 0.1, 0.4]], closed=True, corners="stop")
    np.testing.assert_allclose(path(0.3).z, path(0.3 + path.period).z, atol=1e-14)


def test_way_points_in_a_text_are_those_of_a_file(arm, tmp_path):
    file = tmp_path / "square.csv"
    file.write_text("x,y,z\n" + SQUARE.replace(" ", ",").replace(";,", "\n"), encoding="utf-8")
    task = PoseTask(arm, tip(arm))
    a, b = path_from_csv(SQUARE, task, Q), path_from_csv(file, task, Q)
    np.testing.assert_array_equal(a(0.7).z, b(0.7).z)
    z = task.value(Q)
    np.testing.assert_array_equal(read_path(SQUARE, task, z).points, read_path(file, task, z).points)


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("0.5 0 0.4; 0.5 0.2", {}, "expected 3 columns"),
        ("0.5 0 0.4; 0.5 0 0.4", {}, "repeats line 1"),
        (SQUARE, {"corners": "sharp"}, "'smooth' or 'round' or 'stop'"),
        (SQUARE, {"blend": 0.1}, "does not apply"),
        (SQUARE, {"corners": "round", "blend": 0.0}, "above 0"),
        (SQUARE, {"corners": "round", "blend": 1e-8}, "too many points"),
    ],
)
def test_way_points_that_cannot_be_used_are_refused(arm, text, options, told):
    with pytest.raises(InputError, match=told):
        path_from_csv(text, PositionTask(arm, tip(arm)), Q, **options)


def test_round_corners_with_times_are_refused(arm, tmp_path):
    file = tmp_path / "timed.csv"
    file.write_text("t,x,y,z\n0,0.5,0,0.4\n1,0.5,0.2,0.4\n2,0.5,0.2,0.5\n", encoding="utf-8")
    with pytest.raises(InputError, match="has no times"):
        path_from_csv(file, PositionTask(arm, tip(arm)), Q, corners="round")
