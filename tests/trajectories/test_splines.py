"""Splines of rotations and poses: their derivatives, their end conditions, and what they do not depend on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from checks import DIFFERENCED, STEP, tip
from scipy.spatial.transform import Rotation

from eos_pin import InputError, OrientationTask, PoseTask, pose_spline, rotation_spline

TIMES = np.array([0.0, 0.8, 1.5, 2.5])
TURNS = Rotation.from_rotvec(np.random.default_rng(3).normal(size=(4, 3)))
PLACES = np.random.default_rng(4).normal(size=(4, 3))


def poses_of(places, matrices):
    """Poses in the three forms in which people have them."""
    poses = [pin.SE3(matrix, place) for matrix, place in zip(matrices, places, strict=True)]
    forms = [lambda pose: pose, lambda pose: pose.homogeneous, lambda pose: [*pose.translation, *pose.rotation.ravel()]]
    return [forms[k % 3](pose) for k, pose in enumerate(poses)]


@pytest.mark.parametrize("closed", [False, True])
def test_pose_spline_has_the_derivatives_of_a_pose_task(panda, closed):
    task = PoseTask(panda, tip(panda))
    matrices, places = TURNS.as_matrix(), PLACES
    if closed:
        matrices, places = matrices[[0, 1, 2, 0]], places[[0, 1, 2, 0]]
    path = pose_spline(poses_of(places, matrices), TIMES)
    for t in (0.1, 0.5, 1.1, 1.9, 2.4):
        before, here, after = (path(t + s) for s in (-STEP, 0.0, STEP))
        np.testing.assert_array_equal(task.point(here.z), here.z)
        scale = 1.0 + np.abs(here.dz).max() + 10.0 * np.abs(here.ddz).max()
        difference = task.minus(after.z, before.z) / (2.0 * STEP)
        np.testing.assert_allclose(difference, here.dz, atol=DIFFERENCED * scale)
        np.testing.assert_allclose((after.dz - before.dz) / (2.0 * STEP), here.ddz, atol=DIFFERENCED * scale)
    # Twice continuously differentiable at its knots, and at the seam of a closed one.
    for t in (*TIMES[1:-1], *([2.5, 5.0] if closed else [])):
        for before, after in zip(path(t - 1e-9), path(t + 1e-9), strict=True):
            np.testing.assert_allclose(after, before, atol=1e-6)
    assert (path.period, path.duration) == ((2.5, np.inf) if closed else (np.inf, 2.5))


def test_pose_spline_goes_through_its_poses_and_rests_at_its_ends():
    path = pose_spline(poses_of(PLACES, TURNS.as_matrix()), TIMES)
    for t, place, turn in zip(TIMES, PLACES, TURNS.as_matrix(), strict=True):
        np.testing.assert_allclose(path(t).z, [*place, *turn.ravel()], atol=1e-14)
    for t in (-1.0, 0.0, 2.5, 9.0):
        np.testing.assert_allclose(path(t).dz, 0.0, atol=1e-14)
    np.testing.assert_array_equal(path(9.0).ddz, np.zeros(6))
    np.testing.assert_array_equal(path(9.0).z, path(2.5).z)


def test_rotation_spline_of_two_is_the_turn_about_a_constant_axis():
    vector = np.array([0.3, -2.0, 1.0])
    path = rotation_spline([np.eye(3), pin.exp3(vector)], [1.0, 3.0])
    for t in (1.2, 2.0, 2.9):
        target = path(t)
        np.testing.assert_allclose(np.cross(pin.log3(target.z.reshape(3, 3)), vector), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.cross(target.dz, vector), 0.0, atol=1e-12)
    np.testing.assert_allclose(path(2.0).z, pin.exp3(0.5 * vector).ravel(), atol=1e-14)


def test_rotation_spline_does_not_depend_on_axes():
    left, right = Rotation.random(2, random_state=5)
    path = rotation_spline(TURNS.as_matrix(), TIMES)
    other = rotation_spline((left * TURNS * right).as_matrix(), TIMES)
    L, R = left.as_matrix(), right.as_matrix()
    for t in (0.3, 1.7):
        np.testing.assert_allclose(other(t).z.reshape(3, 3), L @ path(t).z.reshape(3, 3) @ R, atol=1e-13)
        np.testing.assert_allclose(other(t).dz, L @ path(t).dz, atol=1e-12)


def test_rotation_spline_closes_after_a_full_turn():
    matrices = Rotation.from_rotvec(np.outer(np.linspace(0.0, 2.0 * np.pi, 9), [0.0, 0.0, 1.0])).as_matrix()
    path = rotation_spline(matrices, np.linspace(0.0, 4.0, 9))
    assert path.period == 4.0
    for t in (0.0, 0.2, 3.9, 4.0, 7.7):
        np.testing.assert_allclose(path(t).dz, [0.0, 0.0, np.pi / 2.0], rtol=0.02, atol=1e-12)


def test_rotation_spline_is_that_of_a_task(panda):
    task = OrientationTask(panda, tip(panda))
    target = rotation_spline(TURNS.as_matrix().reshape(4, 9), TIMES)(1.0)
    assert (target.z.shape, target.dz.shape, target.ddz.shape) == ((task.size,), (task.m,), (task.m,))


@pytest.mark.parametrize(
    ("rotations", "times", "told"),
    [
        (np.zeros((2, 3, 3)), [0.0, 1.0], "orthonormal"),
        (-np.stack([np.eye(3)] * 2), [0.0, 1.0], "determinant 1"),
        (np.zeros((2, 4)), [0.0, 1.0], r"matrices \(K, 3, 3\)"),
        (np.stack([np.eye(3)] * 2), [0.0, 0.0], "must increase"),
    ],
)
def test_rotation_spline_refuses_values_that_are_no_path(rotations, times, told):
    with pytest.raises(InputError, match=told):
        rotation_spline(rotations, times)


def test_rotation_spline_refuses_a_way_that_is_not_clear(monkeypatch):
    half_turns = Rotation.from_rotvec(np.pi * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]])).as_matrix()
    rotation_spline(half_turns, [0.0, 1.0, 1.1, 2.1])
    monkeypatch.setattr("eos_pin.trajectories.spline.SHORT", 0.95)
    with pytest.raises(InputError, match="too far apart"):
        rotation_spline(half_turns, [0.0, 1.0, 1.1, 2.1])


def test_rotation_spline_refuses_to_close_an_open_path():
    with pytest.raises(InputError, match="closed path must be equal"):
        rotation_spline(TURNS.as_matrix(), TIMES, closed=True)
