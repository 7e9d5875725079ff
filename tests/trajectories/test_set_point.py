"""`SetPoint`: smooth and bounded motions between orders that come at any time."""

from __future__ import annotations

import sys

import numpy as np
import pinocchio as pin
import pytest
from checks import REST

from eos_pin import InputError, KinematicLoop, MissingDependencyError, PoseTask, PositionTask, SetPoint
from eos_pin.trajectories.set_point import rotation_rates

HAND = "panda_hand_tcp"
BOUNDS = {"velocity": 0.3, "acceleration": 1.0, "jerk": 8.0}

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.mark.parametrize("seed", range(10))
def test_set_point_keeps_bounds_at_random_orders(panda, seed):
    random = np.random.default_rng(seed)
    task = PositionTask(panda, HAND)
    point = SetPoint(task, task.value(REST), **BOUNDS)
    h, last = 1e-3, None
    due = np.cumsum(random.uniform(0.0, 0.6, 10))
    for k in range(4000):
        t = k * h
        while due.size and due[0] <= t:
            (point.move_to, point.drive)[random.integers(2)](random.uniform(-0.5, 0.5, 3), float(due[0]))
            due = due[1:]
        now = point(t)
        assert np.abs(now.dz).max() <= 0.3 * (1.0 + 1e-9)
        assert np.abs(now.ddz).max() <= 1.0 * (1.0 + 1e-9)
        if last is not None:
            # The jerk bounds the change of the acceleration, and its integrals those of the rest.
            assert np.abs(now.ddz - last.ddz).max() <= 8.0 * h * (1.0 + 1e-6)
            assert np.abs(now.dz - last.dz - 0.5 * h * (now.ddz + last.ddz)).max() <= 8.0 * h**2
            assert np.abs(now.z - last.z - 0.5 * h * (now.dz + last.dz)).max() <= 8.0 * h**3
        last = now


def test_set_point_arrives_and_rests(panda):
    task = PositionTask(panda, HAND)
    point = SetPoint(task, task.value(REST), **BOUNDS)
    goal = task.value(REST) + np.array([0.2, -0.1, 0.05])
    end = point.move_to(goal, 0.5)
    np.testing.assert_allclose(point(0.5).z, task.value(REST))
    found = point(end + 1.0)
    np.testing.assert_allclose(found.z, goal, atol=1e-9)
    np.testing.assert_allclose(found.dz, 0.0, atol=1e-9)


def test_set_point_brakes_when_its_velocity_is_stale(panda):
    task = PositionTask(panda, HAND)
    point = SetPoint(task, task.value(REST), stale=0.5, **BOUNDS)
    for k in range(20):
        point.drive([0.1, 0.0, 0.0], 0.05 * k)
        point(0.05 * k)
    np.testing.assert_allclose(point(1.4).dz, [0.1, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(point(2.2).dz, 0.0, atol=1e-9)
    # One that comes late finds the point at rest where it braked.
    rest = point(2.2).z
    point.drive([0.1, 0.0, 0.0], 3.0)
    np.testing.assert_allclose(point(3.0).z, rest, atol=1e-12)


def test_set_point_turns_about_one_axis_with_the_rates_of_its_rotation(panda):
    task = PoseTask(panda, HAND)
    start, h = task.value(REST), 1e-5
    point = SetPoint(task, start, **BOUNDS)
    turn = np.array([0.0, 0.0, 0.1, 0.5, -0.3, 0.2])
    end = point.move_to(task.plus(start, turn), 0.0)
    np.testing.assert_allclose(point(end).z, task.plus(start, turn), atol=1e-9)
    point.move_to(start, 0.6 * end)
    for t in (0.3 * end, 0.61 * end, 0.9 * end):
        before, now, after = (point(s) for s in (t - h, t, t + h))
        np.testing.assert_allclose(now.dz, task.minus(after.z, before.z) / (2.0 * h), atol=1e-6)
        np.testing.assert_allclose(now.ddz, (after.dz - before.dz) / (2.0 * h), atol=1e-3)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.0199, 0.0201, 1.0, 3.0])
def test_rotation_rates_are_derivatives_of_the_exponential_map(angle):
    random, h = np.random.default_rng(1), 1e-5
    axis, dx, ddx = random.normal(size=(3, 3))
    x = angle * axis / np.linalg.norm(axis)

    def omega(t):
        R = pin.exp3(x + t * dx + 0.5 * t * t * ddx)
        rate = dx + t * ddx
        return pin.exp3(x + t * dx + 0.5 * t * t * ddx) @ pin.Jexp3(x + t * dx + 0.5 * t * t * ddx) @ rate, R

    found, alpha = rotation_rates(x, dx, ddx)
    np.testing.assert_allclose(found, omega(0.0)[0], atol=1e-9)
    np.testing.assert_allclose(alpha, (omega(h)[0] - omega(-h)[0]) / (2.0 * h), atol=1e-8)


def test_kinematic_loop_follows_a_set_point_without_a_step(panda):
    task = PositionTask(panda, HAND)
    point = SetPoint(task, task.value(REST), **BOUNDS)
    loop, q, h = KinematicLoop(task, point, control_period=0.01), REST, 0.01
    for k in range(150):
        if k in (20, 33):
            # Between two steps.
            point.move_to(task.value(REST) + 0.01 * k * np.array([0.2, -0.4, 0.1]), k * h - 0.004)
        q = loop.step(k * h, q).q
        np.testing.assert_allclose(task.value(q), point((k + 1) * h).z, atol=1e-9)
        assert not loop.limited


def test_set_point_refuses_bounds_and_times_that_do_not_fit(panda, monkeypatch):
    task = PositionTask(panda, HAND)
    with pytest.raises(InputError, match="jerk bounds"):
        SetPoint(task, task.value(REST), velocity=1.0, acceleration=1.0, jerk=0.0)
    point = SetPoint(task, task.value(REST), **BOUNDS)
    point.stop(1.0)
    with pytest.raises(InputError, match="must not go back"):
        point.stop(0.5)
    with pytest.raises(InputError):
        point.drive([0.1, np.nan, 0.0], 2.0)
    with pytest.raises(InputError):
        point.move_to([0.1, 0.2], 2.0)
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(MissingDependencyError, match="ruckig"):
        SetPoint(task, task.value(REST), **BOUNDS)
