"""The compiled step of `KinematicLoop` gives what its own methods give, and only where all is ordinary."""

from __future__ import annotations

import copy
import pickle

import checks
import numpy as np
import pytest

from eos_pin import (
    Atlas,
    Damp,
    FollowJoints,
    Harmonic,
    JointLimits,
    KinematicLoop,
    OrientationTask,
    PositionTask,
    Posture,
    StackedTask,
    StateError,
    Track,
    load_robot,
)
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture

pytestmark = [checks.compiled_only, pytest.mark.usefixtures("unchecked")]
H = 0.004


def laws(robot, q):
    """One law of each kind."""
    r = robot.n - 3
    return {
        "held": Track(kp=np.linspace(50.0, 100.0, r)),
        "moved": Track(Harmonic(np.zeros(r), 0.1 * np.ones((1, r)), np.zeros((1, r)), 1.0)),
        "joints": FollowJoints(lambda t: (q, 0.0 * q, 0.0 * q)),
        "posture": Posture(q + 0.1),
        "damped": Damp(),
    }


@pytest.fixture
def counted(monkeypatch):
    """Compiled steps that were taken, and a switch that turns them off."""
    count = {"taken": 0, "off": False}
    ordinary = KinematicLoop._ordinary

    def watched(self, t, q, state):
        found = None if count["off"] else ordinary(self, t, q, state)
        count["taken"] += found is not None
        return found

    monkeypatch.setattr(KinematicLoop, "_ordinary", watched)
    return count


def run(make, counted, steps=300, changes=lambda loop, k: None):
    """Commands and deficits of the same run with and without compiled steps, and how many those are."""
    both = []
    for off in (False, True):
        counted.update(taken=0, off=off)
        loop, q = make()
        rows = []
        for k in range(steps):
            changes(loop, k)
            q, dq = loop.step(k * H, q)
            rows.append(np.concatenate((q, dq, loop.task_deficit, [loop.limited, loop.lag, loop.path_delay])))
        both.append((np.array(rows), counted["taken"]))
    (found, taken), (expected, none) = both
    assert none == 0
    return found, expected, taken


@pytest.mark.parametrize("law", ["held", "moved", "joints", "posture", "damped"])
def test_compiled_steps_equal_plain_ones_with_every_law(law, counted):
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    q = rest_posture(task)
    path = fitting_path(task, q, period=2.0)

    def make():
        return KinematicLoop(task, path, laws(robot, q)[law], control_period=H), q

    found, expected, taken = run(make, counted)
    np.testing.assert_allclose(found[:, : 2 * robot.n], expected[:, : 2 * robot.n], atol=1e-9)
    np.testing.assert_array_equal(found[:, -3:], expected[:, -3:])
    assert taken > 200


@pytest.mark.parametrize("kind", ["orientation", "pose", "stacked", "point-axis"])
def test_compiled_steps_equal_plain_ones_for_every_kind_of_task(kind, counted):
    robot = load_robot("kinova", chain_to="auto")
    tip = str(robot.options["chain_to"])
    task = StackedTask([PositionTask(robot, tip), OrientationTask(robot, tip)]) if kind == "stacked" else None
    task = task or make_task(robot, kind)
    q = rest_posture(task)

    # Continuous joints are measured wrapped.
    def make():
        loop = KinematicLoop(task, task.hold(q + 0.2), control_period=H)
        return loop, np.where(robot.continuous, q - 2.0 * np.pi, q)

    found, expected, taken = run(make, counted)
    np.testing.assert_allclose(found[:, : 2 * robot.n], expected[:, : 2 * robot.n], atol=1e-9)
    assert taken > 100
    np.testing.assert_allclose(task.minus(task.value(found[-1, : robot.n]), task.value(q + 0.2)), 0.0, atol=1e-3)


def test_compiled_steps_equal_plain_ones_where_everything_is_changed(counted):
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    q = rest_posture(task)
    path, other = fitting_path(task, q, period=2.0), fitting_path(task, q, shape="circle", period=3.0)

    def changes(loop, k):
        if k == 100:
            loop.pace = 0.5
        if k == 150:
            loop.reference = other
        if k == 200:
            loop.self_motion.kp = 30.0
        if k == 250:
            loop.kp = 50.0
        if k == 300:
            loop.limits = JointLimits.without_torques(robot, acceleration=30.0)
        if k == 350:
            loop.self_motion = Track(np.full(4, 0.1))

    def make():
        return KinematicLoop(task, path, Track(), control_period=H), q

    found, expected, taken = run(make, counted, 400, changes)
    np.testing.assert_allclose(found[:, : 2 * robot.n], expected[:, : 2 * robot.n], atol=1e-9)
    assert taken > 300


def test_compiled_steps_equal_plain_ones_across_charts(counted):
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    q = rest_posture(task)
    path = fitting_path(task, q, size=0.3, period=6.0)
    loops = []

    # The product of all cosines, the bound of the margin that comes with the acceleration, is often below the threshold
    # where the least cosine is not.
    def make():
        loops.append(KinematicLoop(task, path, control_period=H, atlas=Atlas(task, threshold=0.997)))
        return loops[-1], q

    found, expected, taken = run(make, counted, 600)
    np.testing.assert_allclose(found[:, : 2 * robot.n], expected[:, : 2 * robot.n], atol=1e-9)
    assert loops[0]._state.on.number == loops[1]._state.on.number > 0
    assert taken > 200


def test_measured_joints_are_looked_at_in_compiled_steps(counted):
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    q = rest_posture(task)
    loop = KinematicLoop(task, task.hold(q), control_period=H, jump=0.1, most_lag=0.3)
    for k in range(5):
        loop.step(k * H, q)
    taken = counted["taken"]
    assert taken > 0
    for wrong in (np.full(7, np.nan), q[:6], q + 0.2):
        with pytest.raises(StateError):
            loop.step(5 * H, wrong)
    assert counted["taken"] == taken
    loop.step(5 * H, q + 0.15)
    assert loop.lag == pytest.approx(0.15)


def test_loop_is_copied_and_pickled_while_it_runs():
    robot = load_robot("xarm7", chain_to="auto")
    task = make_task(robot, "position")
    q = rest_posture(task)
    loop = KinematicLoop(task, fitting_path(task, q, period=2.0), control_period=H)
    for k in range(10):
        q = loop.step(k * H, q).q
    for other in (copy.deepcopy(loop), pickle.loads(pickle.dumps(loop))):
        there = q
        for k in range(10, 20):
            there = other.step(k * H, there).q
        other.self_motion.kp = 50.0
        other.step(20 * H, there)
    for k in range(10, 20):
        q = loop.step(k * H, q).q
    np.testing.assert_allclose(q, there, atol=1e-12)
