"""Default postures and paths need no more torque than there is, where that can be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eos_pin import EosController, Robot, simulate
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.experiments.strength import gravity_load


def weakened(robot: Robot, part: float) -> Robot:
    """The same robot with part of its torque limits."""
    model = robot.model.copy()
    model.effortLimit = part * model.effortLimit
    return Robot(model, name="weak", options=robot.options)


@pytest.mark.parametrize("part", [1.0, 0.6, 0.4])
def test_default_run_of_a_weak_arm_has_enough_torque(panda, part, unchecked):
    robot = weakened(panda, part)
    task = make_task(robot)
    q = rest_posture(task)
    path = fitting_path(task, q)
    run = simulate(robot, EosController(task, path), q, duration=path.period, rtol=1e-6)
    assert run.ok
    assert run.limits["torque"]["ratio"] <= 1.0
    if part == 1.0:
        assert path.period == 4.0


def test_posture_is_turned_to_where_the_joints_can_hold_it(panda):
    before = rest_posture(make_task(panda))
    part = 0.7 * gravity_load(panda, before)
    robot = weakened(panda, part)
    assert gravity_load(robot, before) > 1.4
    q = rest_posture(make_task(robot))
    assert gravity_load(robot, q) <= 1.0
    assert ((q >= robot.lower) & (q <= robot.upper)).all()


def test_strength_ignores_torque_where_no_posture_can_be_held(panda):
    robot = weakened(panda, 1e-3)
    task, strong = make_task(robot), make_task(panda)
    q = rest_posture(task)
    np.testing.assert_array_equal(q, rest_posture(strong))
    assert fitting_path(task, q).period == fitting_path(strong, q).period


def test_gravity_load_is_the_largest_ratio(panda):
    q = rest_posture(make_task(panda))
    expected = np.abs(panda.inverse_dynamics(q, 0.0 * q, 0.0 * q)) / panda.effort
    assert gravity_load(panda, q) == pytest.approx(expected.max(), rel=1e-12)
    assert gravity_load(weakened(panda, math.inf), q) == 0.0
