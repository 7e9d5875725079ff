"""Continuation along the self-motion, compiled and plain: closure, singular ends, winding, prismatic joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT, TAU, planar

from eos_pin import InputError, PoseTask, PositionTask, SingularError
from eos_pin._kernels import tracing
from eos_pin._kernels.kinematics import MOST_NODES, SHORTEST


@pytest.fixture
def arm():
    return planar(*[pin.JointModelRZ()] * 3)


def gap(q, curve):
    """Distance of a state from the nearest of a curve's nodes, modulo whole turns."""
    difference = q - curve.q
    return np.abs(difference - TAU * np.round(difference / TAU)).max(axis=1).min()


@pytest.mark.parametrize("seed", range(5))
def test_curve_of_a_pose_is_closed_and_the_same_from_anywhere_on_it(panda, seed):
    task = PoseTask(panda, "panda_hand_tcp")
    q = np.random.default_rng(seed).uniform(panda.lower, panda.upper)
    z = task.value(q)
    curve = task.kinematics.trace(q)
    assert curve.ends == ("closed", "closed")
    np.testing.assert_array_equal(curve.q[0], q)
    np.testing.assert_allclose(curve.q[-1], q + TAU * curve.winding, atol=1e-12)
    for node, t in zip(curve.q, curve.t, strict=True):
        z_node, J = task.linearize(node)
        assert np.abs(task.minus(z, z_node)).max() <= 1e-10
        assert np.abs(J @ t).max() <= 1e-9
        assert np.linalg.norm(t) == pytest.approx(1.0)
    steps = np.diff(curve.q, axis=0)
    assert np.abs(steps).max() <= 0.12
    assert (np.sum(curve.t[1:] * curve.t[:-1], axis=1) >= np.cos(0.2)).all()
    other = task.kinematics.trace(curve.q[len(curve.q) // 3], step=0.05)
    np.testing.assert_array_equal(np.abs(other.winding), np.abs(curve.winding))
    assert max(gap(node, other) for node in curve.q) <= 0.05


def test_plain_trace_equals_the_compiled_one(panda):
    task = PoseTask(panda, "panda_hand_tcp")
    kinematics = task.kinematics
    q = np.random.default_rng(2).uniform(panda.lower, panda.upper)
    z = task.value(q)
    curve = kinematics.trace(q)
    plain = tracing.trace(
        kinematics._plain, q, z, kinematics.revolute, 1.0, 0.1, 0.2, 300.0, SHORTEST, 1e-11, MOST_NODES
    )
    assert plain[2] == tracing.CLOSED
    np.testing.assert_allclose(curve.q, plain[0], atol=1e-8)
    np.testing.assert_allclose(curve.t, plain[1], atol=1e-7)
    T, regular = kinematics.tangents(curve.q, z)
    plain_T, plain_regular = tracing.tangents(kinematics._plain, curve.q, z)
    np.testing.assert_allclose(T, plain_T, atol=1e-11)
    np.testing.assert_allclose(regular, plain_regular, atol=1e-11)


def test_curve_ends_where_self_motions_cross(arm):
    """Where a three-link arm reaches one link far, a posture with all links in one line is on its self-motion."""
    task = PositionTask(arm, "tip", "xy")
    q = np.array([0.3, 1.2, 0.0])
    z = np.array([1.0, 0.0])
    start = task.kinematics.project(q[None], z).q[0]
    curve = task.kinematics.trace(start, z=z)
    assert curve.ends == ("singular", "singular")
    for end in (curve.q[0], curve.q[-1]):
        assert np.abs(np.sin(end)).max() <= 1e-5
    assert (np.abs(np.diff(curve.q, axis=0)) <= 0.12).all()
    with pytest.raises(SingularError, match="self-motions meet"):
        task.kinematics.trace(np.array([0.0, np.pi, 0.0]), z=z)


def test_curve_counts_whole_turns(arm):
    """A point near the base: the whole arm turns about it while its links keep a triangle."""
    task = PositionTask(arm, "tip", "xy")
    triangle = np.array([0.0, TAU / 3, TAU / 3])
    q = task.kinematics.project(triangle[None] + 0.01, np.array([1e-3, 0.0])).q[0]
    curve = task.kinematics.trace(q)
    assert curve.ends == ("closed", "closed")
    assert np.abs(curve.winding).tolist() == [1, 0, 0]
    np.testing.assert_allclose(curve.q[-1] - curve.q[0], TAU * curve.winding, atol=EXACT)


def test_curve_of_a_joint_that_does_not_move_the_task_is_one_turn():
    robot = planar(pin.JointModelRZ(), pin.JointModelRZ(), pin.JointModelRZ())
    task = PositionTask(robot, "tip", "x")
    assert task.m == 1
    task = PositionTask(planar(pin.JointModelPX(), pin.JointModelRX()), "tip", "x")
    curve = task.kinematics.trace(np.array([0.2, 0.3]))
    assert curve.ends == ("closed", "closed")
    assert np.abs(curve.winding).tolist() == [0, 1]


def test_curve_without_an_end_is_as_long_as_allowed():
    """Two rails in one line may go apart for ever."""
    task = PositionTask(planar(pin.JointModelPX(), pin.JointModelPX()), "tip", "x")
    curve = task.kinematics.trace(np.zeros(2), length=5.0)
    assert curve.ends == ("long", "long")
    assert np.linalg.norm(curve.q[-1] - curve.q[0]) == pytest.approx(10.0, abs=0.3)
    assert (curve.winding == 0).all()


def test_curve_with_a_prismatic_joint_is_closed():
    """A rail and two links: the ellipse-like self-motion of a slider crank, against its equation."""
    task = PositionTask(planar(pin.JointModelPX(), pin.JointModelRZ(), pin.JointModelRZ()), "tip", "xy")
    z = np.array([1.4, 0.3])
    q = task.kinematics.project(np.array([[0.0, 0.5, -0.8]]), z).q[0]
    curve = task.kinematics.trace(q, z=z)
    assert curve.ends == ("closed", "closed")
    x, a, b = curve.q.T
    np.testing.assert_allclose(np.sin(a) + np.sin(a + b), 0.3, atol=1e-10)
    np.testing.assert_allclose(1.0 + x + np.cos(a) + np.cos(a + b), 1.4, atol=1e-10)


def test_trace_refuses_more_than_one_redundant_joint(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    with pytest.raises(InputError, match="7 joints and 3 coordinates"):
        task.kinematics.trace(np.zeros(7))
    with pytest.raises(InputError, match="7 joints and 3 coordinates"):
        task.kinematics.tangents(np.zeros((1, 7)), np.zeros(3))
