"""Compiled twins give what their originals give, to rounding."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import checks
import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT, all_tasks, exact, random_state, tip
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eos_pin import (
    Chart,
    ControlLoop,
    EosController,
    Hold,
    OrientationTask,
    PoseTask,
    PositionTask,
    TaskForce,
    Track,
)
from eos_pin._kernels.dispatch import REFERENCES, kernels
from eos_pin.control._regularize import AccelerationMap
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Target
from eos_pin.trajectories.harmonic import Waves

pytestmark = pytest.mark.skipif(
    kernels is None and "EOS_PIN_NEEDS_COMPILER" not in os.environ, reason="installed without a C compiler"
)
TASKS = [(name, task) for name, task in all_tasks() if isinstance(task, PositionTask | OrientationTask | PoseTask)]
frame_tasks = pytest.mark.parametrize("task", [task for _, task in TASKS], ids=[name for name, _ in TASKS])
floats = st.floats(-10.0, 10.0)
#: How many numbers a vector has.
sizes = st.integers(1, 12)


def vectors(size, elements=floats):
    return arrays(float, size, elements=elements)


def both(name, *arguments):
    """What the twin says, and what the original does."""
    return getattr(kernels, name)(*arguments), REFERENCES[name](*arguments)


def test_where_there_is_a_compiler_there_are_twins():
    assert ControlLoop, TaskForce  # their modules have twins, too, and have been imported
    assert kernels is not None
    assert len(REFERENCES) == 8
    assert all(hasattr(kernels, name) for name in REFERENCES)


@given(data=st.data())
def test_the_watch_of_the_loop(data):
    n = data.draw(sizes)
    odd = st.one_of(floats, st.sampled_from([np.nan, np.inf, -np.inf]))
    first = data.draw(floats), data.draw(vectors(n)), data.draw(st.floats(0.1, 1e4))
    watches = both("StateMonitor", *first)
    for _ in range(4):
        state = data.draw(odd), data.draw(vectors(n, odd)), data.draw(vectors(n, odd))
        use_compiled, original = (watch.accepts(*state) for watch in watches)
        assert use_compiled is original
        for one, other in zip(*(watch.last for watch in watches), strict=True):
            np.testing.assert_array_equal(one, other)
    t, q = watches[0].last
    for watch in (watches[0], pickle.loads(pickle.dumps(watches[0])), watches[1]):
        assert watch.accepts(t + 1.0, q, q)
        watch.last = t, q
        assert not watch.accepts(t - 1.0, q, q)


@pytest.mark.parametrize(
    "q", [[0.0, 0.0], None, "ab", np.zeros(3), np.zeros((2, 1)), np.zeros(2, int), np.zeros(4)[::2]]
)
def test_what_is_unusual_is_looked_at_more_closely(q):
    zero = np.zeros(2)
    watch = kernels.StateMonitor(0.0, zero, 1.0)
    for state in ((0.0, q, zero), (0.0, zero, q), (None, zero, zero), ("now", zero, zero)):
        assert watch.accepts(*state) is False
    assert kernels.within_limits_fast(q, np.ones(2)) is False


@given(data=st.data())
def test_the_watch_of_torques(data):
    n = data.draw(sizes)
    tau, per_limit = data.draw(vectors(n)), np.abs(data.draw(vectors(n)))
    assert len({*both("within_limits_fast", tau, per_limit)}) == 1
    tau[0] = np.nan
    assert kernels.within_limits_fast(tau, per_limit) is False


@given(data=st.data())
def test_waves(data):
    terms, size, m = (data.draw(st.integers(*range_)) for range_ in ((0, 4), (1, 12), (1, 6)))
    blocks = [data.draw(arrays(float, (2 * terms + 1, width), elements=floats)) for width in (size, m, m)]
    curve, t = Waves(data.draw(floats), data.draw(vectors(terms)), *blocks), data.draw(floats)
    for found in (curve.at(t), pickle.loads(pickle.dumps(curve.at))(t)):
        assert type(found) is Target
        for use_compiled, original in zip(found, curve._reference(t), strict=True):
            np.testing.assert_allclose(use_compiled, original, rtol=0.0, atol=EXACT * 100)


@given(turns=arrays(float, (2, 3), elements=st.floats(-4.0, 4.0)), places=arrays(float, (2, 3), elements=floats))
def test_pose_difference(turns, places):
    poses = [np.concatenate((p, pin.exp3(turn).ravel())) for p, turn in zip(places, turns, strict=True)]
    use_compiled, original = both("pose_difference", *poses)
    # Half a turn away a rotation vector and its opposite are the same.
    R, S = (pin.exp3(delta[3:]) for delta in (use_compiled, original))
    np.testing.assert_array_equal(use_compiled[:3], original[:3])
    np.testing.assert_allclose(R, S, atol=1e-7)
    with pytest.raises(ValueError, match="a vector of 12 numbers"):
        kernels.pose_difference(poses[0], np.zeros(3))


@given(turn=vectors(3), place=vectors(3), odd=st.sampled_from([0.0, 1e-9, 1.0, np.nan, np.inf]))
def test_flat_pose(turn, place, odd):
    matrix = pin.SE3(pin.exp3(turn), place).homogeneous
    flat = np.concatenate((place, matrix[:3, :3].ravel()))
    # Whether what is right to rounding counts as such is a matter of rounding.
    for use_compiled, original in (both("flat_pose", matrix), both("flat_pose", flat)):
        for found in (use_compiled, original):
            assert found is None or np.array_equal(found, flat)
    np.testing.assert_array_equal(kernels.flat_pose(np.eye(4)), REFERENCES["flat_pose"](np.eye(4)))
    disturbed = np.eye(4)
    disturbed[[0, 3], [1, 2]] += odd
    for wrong in (flat[:11], matrix[:3], -matrix, np.diag([1.0, 1.0, -1.0, 1.0]), disturbed):
        use_compiled, original = both("flat_pose", wrong)
        assert (use_compiled is None) == (original is None)


@given(data=st.data())
def test_the_parts_of_newtons_method(data):
    m = data.draw(st.integers(1, 7))
    n = m + data.draw(st.integers(0, 4))
    J, U = (data.draw(arrays(float, shape, elements=floats)) for shape in ((m, n), (n, m)))
    u, error, base = (data.draw(vectors(size)) for size in (m, m, n))
    assert both("largest", error) == (np.abs(error).max(),) * 2
    assert kernels.largest(np.array([1.0, np.nan, 3.0])) != kernels.largest(np.array([1.0, np.nan, 3.0]))
    B, original = both("on_chart_inverse", J, U)
    if np.linalg.cond(J @ U) < 1e6:
        assert (B is None) == (original is None) == (np.linalg.det(J @ U) < 0.0)
    if B is not None and np.linalg.cond(J @ U) < 1e6:
        np.testing.assert_allclose(B, original, rtol=0.0, atol=exact(J @ U))
        for use_compiled, plain in zip(*both("newton_step", base, U, u, original, error), strict=True):
            np.testing.assert_allclose(use_compiled, plain, rtol=0.0, atol=EXACT * (1.0 + np.abs(original).max()) * 1e4)
    assert kernels.on_chart_inverse(0.0 * J, U) is None


def test_arrays_of_another_kind_are_taken_or_refused():
    """A task of one's own may return what it likes."""
    J, U, base = np.ones((2, 3)) + np.eye(2, 3), np.eye(3, 2), np.arange(3.0)
    B, error = np.eye(2), np.array([1.0, 2.0])
    expected = kernels.newton_step(base, U, error, B, error)
    for kind in (np.float32, int, np.longdouble):
        found = kernels.newton_step(base.astype(kind), U, error.astype(kind), B.astype(kind), error.astype(kind))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other)
        np.testing.assert_allclose(kernels.on_chart_inverse(J.astype(kind), U), kernels.on_chart_inverse(J, U))
        assert kernels.largest(error.astype(kind)) == 2.0
    for one, other in zip(
        kernels.newton_step(base[::-1][::-1], U, error, B, np.repeat(error, 2)[::2]), expected, strict=True
    ):
        np.testing.assert_allclose(one, other)
    with pytest.raises(ValueError, match="a vector of 2 numbers"):
        kernels.newton_step(base, U, error, B, np.ones(3))
    with pytest.raises(ValueError, match="a matrix of 2 x 3 numbers"):
        kernels.on_chart_inverse(J.T, U)


@given(data=st.data())
def test_the_rate_of_the_state(data):
    n = data.draw(sizes)
    dq, ddq, tau = (data.draw(vectors(n)) for _ in range(3))
    for arguments in ((dq, ddq, tau), (dq[::-1], ddq, tau)):
        np.testing.assert_allclose(*both("state_rate", *arguments), rtol=0.0, atol=EXACT * 1e3)


@frame_tasks
@given(data=st.data())
def test_tasks_of_frames(task, data):
    q, dq = data.draw(checks.joints(task.robot)), data.draw(checks.velocities(task.robot))
    for name, state in (("value", (q,)), ("linearize", (q,)), ("at", (q, dq))):
        use_compiled, original = getattr(task, name)(*state), getattr(Task, name)(task, *state)
        assert type(use_compiled) is type(original)
        for one, other in zip(
            *([use_compiled], [original]) if name == "value" else (use_compiled, original), strict=True
        ):
            assert one.shape == other.shape
            np.testing.assert_allclose(one, other, rtol=0.0, atol=EXACT * (1.0 + np.abs(dq).max() ** 2))


@frame_tasks
@given(data=st.data())
def test_the_drive(task, data):
    q = data.draw(checks.joints(task.robot))
    if np.linalg.cond(task.linearize(q)[1]) > 1e3:
        return
    drive = AccelerationMap(Chart.from_base(task, q))
    q = q + 0.3 * data.draw(checks.numbers(task.robot.n))
    J, F, dq = task.linearize(q)[1], data.draw(checks.numbers(task.robot.n)), data.draw(checks.velocities(task.robot))
    use_compiled, original = drive._compiled(J, F, dq), drive._reference(J, F, dq)
    if use_compiled is not None:
        A = np.vstack((J, drive.chart.Vt))
        np.testing.assert_allclose(use_compiled[0], original[0], rtol=0.0, atol=exact(A, scale=10.0))
        assert use_compiled[1] == pytest.approx(original[1], abs=exact(A))
    assert drive._compiled(0.0 * J, F, dq) is None
    assert drive._compiled(J, F.astype(np.float32), dq) is None


@pytest.mark.parametrize("feedforward", [True, False])
@pytest.mark.parametrize("carried", [True, False])
@frame_tasks
@given(data=st.data())
def test_the_tracking_law(task, feedforward, carried, data):
    robot = task.robot
    random = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    q_bar, r = random_state(robot, random)[0], robot.n - task.m
    if np.linalg.norm(np.linalg.pinv(task.linearize(q_bar)[1]), 2) > 10.0:
        return
    target, gains = Hold(task.value(q_bar), task.m), random.uniform(5.0, 10.0, (4, robot.n))
    kp, kd, kp_v, kd_v = gains[0, : task.m], gains[1, : task.m], gains[2, :r], gains[3, :r]
    track = Track(random.uniform(-0.1, 0.1, r), kp=kp_v, kd=kd_v)
    controller = EosController(task, target, track, kp=kp, kd=kd, feedforward=feedforward)
    state = controller.start(0.0, q_bar, 0.0 * q_bar)
    q, dq = q_bar + random.uniform(-0.1, 0.1, robot.n), random.uniform(-2.0, 2.0, robot.n)
    point, more = task.at(q, dq), random.uniform(-1.0, 1.0, r) if carried else None
    law = pickle.loads(pickle.dumps(state.law))
    z_d, dz_d, ddz_d = target(0.0)
    use_compiled = law(q, dq, z_d, dz_d, ddz_d, more)
    F = controller.asked(0.0, q, dq, state.chart, point)
    if carried:
        F[task.m :] += more
    original = state.drive._reference(point.J, F, dq)
    if use_compiled is not None:
        tolerance = exact(np.vstack((point.J, state.chart.Vt)), scale=np.linalg.norm(F))
        np.testing.assert_allclose(use_compiled[0], original[0], rtol=0.0, atol=tolerance)
        assert use_compiled[1] == pytest.approx(original[1], abs=tolerance)


def test_tasks_are_copied_with_their_twins(panda):
    q, dq = random_state(panda, seed=3)
    task = PoseTask(panda, tip(panda))
    expected = task.at(q, dq)
    again = pickle.loads(pickle.dumps(task.compiled))
    task.value(0.0 * q)
    for one, other in zip(again.at(q, dq), expected, strict=True):
        np.testing.assert_array_equal(one, other)


STEP = """
import numpy as np
import eos_pin
from eos_pin._kernels.dispatch import kernels
robot = eos_pin.load_robot("panda", chain_to="panda_hand_tcp")
task = eos_pin.PoseTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
loop = eos_pin.ControlLoop(eos_pin.EosController(task, eos_pin.Hold(task.value(q + 0.1), 6)))
print(kernels is None, *loop.step(0.0, q, 0.1 * q))
"""


def test_the_originals_do_it_all_where_nothing_is_compiled():
    found = {}
    for switch in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-c", STEP], env=os.environ | {"EOS_PIN_COMPILED": switch}, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        without, *torque = done.stdout.split()
        assert without == str(switch == "0")
        found[switch] = np.array(torque, dtype=float)
    np.testing.assert_allclose(found["1"], found["0"], rtol=0.0, atol=1e-9)
