"""The two systems of differential equations are the same motion in different coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from checks import DIFFERENCED, STEP, exact, random_state, tip

from eos_pin import (
    Atlas,
    EosController,
    Hold,
    OpenLoop,
    OrientationTask,
    PoseTask,
    PositionTask,
    StackedTask,
    TaskForce,
)
from eos_pin.simulation._systems import ExtendedSystem, JointSystem

TASKS = {
    "position": lambda robot: PositionTask(robot, tip(robot)),
    "pose": lambda robot: PoseTask(robot, tip(robot)),
    "stacked": lambda robot: StackedTask([OrientationTask(robot, tip(robot)), PositionTask(robot, tip(robot), "z")]),
}


def systems(task, seed=5):
    """Both systems at the same state, away from the base point of the chart, with torque and task force."""
    panda = task.robot
    q, dq = random_state(panda, seed)
    torque = OpenLoop(lambda t: panda.gravity(q) + np.arange(7.0))
    force = TaskForce(task, lambda t: np.arange(1.0, task.m + 1.0))
    joint, extended = JointSystem(panda, torque, force), ExtendedSystem(panda, torque, force, Atlas(task))
    joint.begin(q, dq)
    x = extended.begin(q, dq)
    chart = extended.chart
    q_near = q + 0.1 * np.cos(np.arange(7.0))
    point = task.at(q_near, dq)
    delta = task.minus(point.z, chart.z_bar)
    x = np.concatenate((delta, chart.v(q_near), point.dz, chart.dv(dq), [0.3]))
    return joint, np.concatenate((q_near, dq, [0.3])), extended, x


@pytest.mark.parametrize("kind", TASKS)
def test_systems_describe_one_state_and_its_acceleration(panda, kind):
    task = TASKS[kind](panda)
    joint, y, extended, x = systems(task)
    (q, dq), (q_w, dq_w) = joint.joints(0.0, y), extended.joints(0.0, x)
    np.testing.assert_allclose(q_w, q, atol=1e-11)
    np.testing.assert_allclose(dq_w, dq, atol=1e-10)
    dy, dx = joint.rhs(0.0, y), extended.rhs(0.0, x)
    m, n = task.m, 7
    point = extended.chart.point(q, dq)
    # ddq = H ddw + E; Eq. (20)
    ddq = point.H @ dx[n:-1] + point.E
    tolerance = 1e2 * exact(point.H, panda.mass(q), scale=np.linalg.norm(dy))
    np.testing.assert_allclose(ddq, dy[n:-1], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(dx[m:n], point.dv, atol=1e-10)
    assert dx[-1] == pytest.approx(dy[-1])


@pytest.mark.parametrize("kind", TASKS)
def test_local_coordinates_change_at_their_rate(panda, kind):
    task = TASKS[kind](panda)
    _, _, extended, x = systems(task)
    q, dq = extended.joints(0.0, x)
    z_bar, m = extended.chart.z_bar, task.m
    later, before = (task.minus(task.value(q + s * dq), z_bar) for s in (STEP, -STEP))
    np.testing.assert_allclose(extended.rhs(0.0, x)[:m], (later - before) / (2.0 * STEP), atol=100 * DIFFERENCED)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, math.pi - 1e-6, math.pi, 4.0, 6.0])
def test_local_rate_of_a_rotation_is_right_up_to_a_turn(panda, angle):
    task = OrientationTask(panda, tip(panda))
    z_bar = np.eye(3).ravel()
    delta = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    omega = np.array([0.3, 0.5, -0.7])
    rate = task.local_rate(delta, omega)
    # Where the coordinates move at this rate, the rotation turns with the angular velocity.
    ahead, behind = (task.plus(z_bar, delta + s * rate) for s in (STEP, -STEP))
    np.testing.assert_allclose(task.minus(ahead, behind) / (2.0 * STEP), omega, atol=10 * DIFFERENCED)
    assert task.local_margin(delta) == pytest.approx(1.0 - angle / math.pi)


def test_coordinates_of_a_rotation_wear_out(panda):
    for name, places in (("position", None), ("pose", slice(3, 6)), ("stacked", slice(0, 3))):
        task = TASKS[name](panda)
        delta = np.zeros(task.m)
        assert task.local_margin(delta) == 1.0
        if places:
            delta[places] = (math.pi, 0.0, 0.0)
            assert task.local_margin(delta) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("kind", TASKS)
def test_right_hand_sides_are_pure(panda, kind):
    joint, y, extended, x = systems(TASKS[kind](panda))
    for system, state in ((joint, y), (extended, x)):
        first, memory = system.rhs(0.1, state), system.state
        for s in (1e-3, -1e-2):
            system.rhs(0.2, state + s)
        np.testing.assert_array_equal(system.rhs(0.1, state), first)
        assert system.state is memory


@pytest.mark.parametrize("kind", TASKS)
def test_switch_keeps_the_state_of_the_robot(panda, kind):
    _, _, extended, x = systems(TASKS[kind](panda))
    (q, dq), old = extended.joints(0.0, x), extended.chart
    switched = extended.switch(0.0, x)
    assert extended.chart is not old
    np.testing.assert_allclose(extended.joints(0.0, switched), (q, dq), atol=1e-10)
    np.testing.assert_allclose(extended.chart.v(q), old.v(q), atol=1e-12)
    assert switched[-1] == x[-1]
    assert extended.switch_function(0.0, switched) == pytest.approx(1.0 - extended.atlas.threshold)


def test_task_force_does_the_work_of_the_task(panda):
    q, dq = random_state(panda, 5)
    task = PoseTask(panda, tip(panda))
    force = np.arange(1.0, 7.0)
    torque = TaskForce(task, lambda t: (t * force).tolist()).torque(2.0, q)
    # Virtual work: F^y · dq = F^z · dz
    assert torque @ dq == pytest.approx(2.0 * force @ task.at(q, dq).dz, rel=1e-12)


def test_controllers_chart_is_not_that_of_the_coordinates(panda):
    # Each is left on its own terms.
    task = PositionTask(panda, tip(panda))
    q, dq = random_state(panda, 5)
    controller = EosController(task, Hold(task.value(q)))
    system = ExtendedSystem(panda, controller, None, Atlas(task))
    x = system.begin(q, dq)
    memory = system.state
    system.switch(0.0, x)
    assert system.state is memory
