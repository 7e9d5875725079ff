"""Joints too weak for what they carry: who is kept, who brakes, and that nothing else is taken along."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from checks import REST, with_plain_limits
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from eos_pin import (
    Hold,
    JointLimits,
    LimitedEosController,
    PositionTask,
    Result,
    Robot,
    gravity_overload,
    load_robot,
    simulate_sampled,
)
from eos_pin._kernels.dispatch import NO_ANSWER
from eos_pin.control._smallest_change import FADE, SmallestChange

PERIOD = 1e-3


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_joints_are_lost_only_if_hopeless_or_excluded_by_joints_before_them(seed, answered):
    """Linear programs of their own find the least that each joint must lack, one after the other.

    That is so, too, where the first quadratic program finds no answer, as daqp does in rare states.
    """
    random = np.random.default_rng(seed)
    n = 4
    root = random.normal(size=(n, n))
    J, M = random.normal(size=(2, n)), root @ root.T + 0.2 * np.eye(n)
    # Light joints beside heavy ones may be accelerated a thousand times as much.
    quick = random.choice([np.ones(n), random.choice([1.0, 30.0, 1000.0], n)])
    M /= np.sqrt(np.outer(quick, quick))
    torque = quick * np.diag(M) * random.exponential(10.0, n)
    now, middle = random.uniform(-1.0, 1.0, n) * torque, quick * random.normal(size=n) * random.choice([5.0, 20.0])
    lower = np.concatenate((middle - quick * random.exponential(10.0, n), -torque - now))
    upper = np.concatenate((middle + quick * random.exponential(10.0, n), torque - now))
    order, W = [int(j) for j in random.permutation(n)], np.linalg.inv(M)
    smallest = SmallestChange(2, n, order)
    if not answered:
        smallest._rows[:] = np.vstack((M, J))
        smallest.program = lambda *_: (NO_ANSWER, np.full(n, np.nan))
    change = smallest(J, M, lower, upper)
    effort = M @ change
    assert (effort <= upper[n:] + 1e-6 * (1.0 + torque)).all()
    assert (effort >= lower[n:] - 1e-6 * (1.0 + torque)).all()
    box = np.column_stack((lower[n:], upper[n:]))
    reach = W * box[:, 0], W * box[:, 1]
    most, least = np.maximum(*reach).sum(axis=1), np.minimum(*reach).sum(axis=1)
    for j in range(n):
        side, lack = (1, lower[j] - most[j]) if most[j] < lower[j] else (0, least[j] - upper[j])
        if lack > 0.0:
            # Hopeless; those that are by a hair are on the way to braking with all they have.
            box[j, 1 - side] += min(lack * M[j, j] / torque[j], 1.0) * (box[j, side] - box[j, 1 - side])
            assert box[j, 0] - 1e-6 * (1.0 + torque[j]) <= effort[j] <= box[j, 1] + 1e-6 * (1.0 + torque[j])
    below, above = lower[:n].copy(), upper[:n].copy()
    for k, j in enumerate(order, 1):
        rows, slack = W[order[:k]], np.zeros((k, 1))
        slack[-1] = -1.0
        found = linprog(
            [*np.zeros(n), 1.0],
            A_ub=np.block([[rows, slack], [-rows, slack]]),
            b_ub=np.concatenate((above[order[:k]], -below[order[:k]])),
            bounds=[*box, (0.0, None)],
        )
        assert found.status == 0
        # A joint that can be kept is; one that cannot be lacks no more than the rule allows.
        allowed = (1.0 + FADE) * found.fun
        scale = 1e-3 + 1e-4 * allowed
        assert lower[j] - allowed - scale <= change[j] <= upper[j] + allowed + scale
        below[j], above[j] = below[j] - allowed - 1e-7, above[j] + allowed + 1e-7


def lift_arm(shoulder: float) -> Robot:
    """Strong lift that carries an arm whose shoulder has so much torque, but needs 31 N m."""
    joints = (("lift", "prismatic", "0 0 1", 0.4, 8000.0, 0.06), ("shoulder", "revolute", "0 1 0", 1.4, shoulder, 2.0))
    joints += (("elbow", "revolute", "0 1 0", 2.2, 40.0, 3.0),)
    links, parent = ["<link name='base'/>"], "base"
    for (name, kind, axis, room, effort, speed), mass, out in zip(
        joints, (40.0, 6.0, 3.0), ("0 0 0", "0 0 0", "0.45 0 0"), strict=True
    ):
        lever = 0.0 if name == "lift" else 0.2
        links.append(
            f"<link name='{name}_link'><inertial><origin xyz='{lever} 0 0'/><mass value='{mass}'/>"
            "<inertia ixx='0.05' iyy='0.05' izz='0.05' ixy='0' ixz='0' iyz='0'/></inertial></link>"
            f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{name}_link'/><origin "
            f"xyz='{out}'/><axis xyz='{axis}'/><limit lower='{-room}' upper='{room}' effort='{effort}' "
            f"velocity='{speed}'/></joint>"
        )
        parent = f"{name}_link"
    tip = (
        "<link name='tip'/><joint name='tip' type='fixed'><parent link='elbow_link'/><child link='tip'/>"
        "<origin xyz='0.3 0 0'/></joint>"
    )
    model = pin.buildModelFromXML(f"<robot name='lift_arm'>{''.join(links)}{tip}</robot>")
    return Robot(model=model, name="lift_arm")


def mean_acceleration(robot: Robot, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Mean acceleration over a period in which a torque is held, found in small steps."""
    x, v, h = q, dq, PERIOD / 50
    for _ in range(50):
        middle = v + 0.5 * h * robot.forward_dynamics(x, v, tau)
        x, v = x + h * middle, v + h * robot.forward_dynamics(x + 0.5 * h * v, middle, tau)
    return (v - dq) / PERIOD


WEAK = np.array([0.1, 0.1, -0.9])


@cache
def weak_run(period: float, compiled: bool) -> Result:
    """The lift, and an arm that cannot hold itself, at rest at first."""
    robot = lift_arm(11.0)
    task = PositionTask(robot, "tip", "xz")
    controller = LimitedEosController(task, Hold(task.value(WEAK)), control_period=period)
    if not compiled:
        with_plain_limits(controller)
    return simulate_sampled(robot, controller, WEAK, duration=1.5, control_period=period, record_rate=1.0 / period)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("compiled", [True, False])
def test_joint_too_weak_for_gravity_takes_no_other_along(compiled: bool) -> None:
    robot, run = lift_arm(11.0), weak_run(1e-3, compiled)
    others = [0, 2]
    assert (run.q[:, others] <= robot.upper[others] + 1e-5).all()
    assert (run.q[:, others] >= robot.lower[others] - 1e-5).all()
    assert (np.abs(run.dq[:, others]) <= robot.velocity[others] * (1.0 + 1e-3)).all()
    assert (np.abs(run.tau) <= robot.effort).all()
    # The shoulder falls, and brakes with all it has.
    over = np.abs(run.q[:, 1]) > robot.upper[1]
    falls = over & (run.q[:, 1] * run.dq[:, 1] > 0.1)
    assert falls.sum() > 10
    np.testing.assert_allclose(np.abs(run.tau[falls, 1]), 11.0)
    assert run.status == "degraded"
    assert "'shoulder' passed its position limit by" in run.message
    assert "as its torque of 11 N m was used up (gravity took up to" in run.message
    assert "'lift'" not in run.message
    assert "'elbow'" not in run.message


@pytest.mark.usefixtures("unchecked")
def test_torque_is_continuous_where_a_joint_is_too_weak() -> None:
    coarse, fine = (np.abs(np.diff(weak_run(period, True).tau, axis=0)).max() for period in (5e-4, 2.5e-4))
    assert fine < 0.6 * coarse


def test_gravity_overload_names_joints_that_cannot_hold_themselves(panda: Robot) -> None:
    robot = lift_arm(11.0)
    (note,) = gravity_overload(robot, WEAK)
    assert note.startswith("gravity takes ")
    assert "'shoulder' at the start, and its limit is 11 N m" in note
    (note,) = gravity_overload(robot)
    assert "'shoulder' in postures within the position limits" in note
    assert gravity_overload(robot, WEAK, np.full(3, 1e4)) == ()
    assert gravity_overload(panda, REST) == ()
    task = PositionTask(robot, "tip", "xz")
    controller = LimitedEosController(
        task, Hold(task.value(WEAK)), limits=JointLimits.from_robot(robot, torque=[9e3, 90.0, 2.0])
    )
    assert "'elbow'" in controller.overload(WEAK)[0]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("compiled", [True, False])
def test_joints_keep_their_bounds_beside_one_that_spins(compiled: bool) -> None:
    robot = load_robot("kinova", chain_to="auto")
    task, torque = PositionTask(robot, str(robot.options["chain_to"])), robot.effort.copy()
    torque[4] = 5.0
    limits = JointLimits.from_robot(robot, torque=torque)
    lower, upper = np.maximum(robot.lower, -np.pi) + 0.5, np.minimum(robot.upper, np.pi) - 0.5
    for seed in range(40):
        random = np.random.default_rng(seed)
        q, dq = random.uniform(lower, upper), 0.99 * robot.velocity * random.uniform(-1.0, 1.0, 6)
        dq[4] = random.choice([-10.0, 10.0]) * robot.velocity[4]
        controller = LimitedEosController(task, Hold(task.value(q)), limits=limits, control_period=PERIOD)
        if not compiled:
            with_plain_limits(controller)
        tau, _ = controller._within(q, dq, np.zeros(6), task.at(q, dq).J)
        mean = mean_acceleration(robot, q, dq, tau)
        least, most = limits.accelerations(q, dq, PERIOD)
        over = np.maximum(mean - most, least - mean)
        assert np.delete(over, 4).max() < 0.05


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("compiled", [True, False])
def test_held_torque_keeps_all_bounds_at_any_command(compiled: bool) -> None:
    """There is torque enough for every joint."""
    robot = load_robot("kinova", chain_to="auto")
    task = PositionTask(robot, str(robot.options["chain_to"]))
    limits = JointLimits.from_robot(robot, torque=1e4)
    lower, upper = np.maximum(robot.lower, -np.pi) + 0.5, np.minimum(robot.upper, np.pi) - 0.5
    for seed in range(40):
        random = np.random.default_rng(seed)
        q, dq = random.uniform(lower, upper), 0.99 * robot.velocity * random.choice([-1.0, 1.0], 6)
        controller = LimitedEosController(task, Hold(task.value(q)), limits=limits, control_period=PERIOD)
        if not compiled:
            with_plain_limits(controller)
        tau, _ = controller._within(q, dq, 100.0 * random.normal(size=6), task.at(q, dq).J)
        mean = mean_acceleration(robot, q, dq, tau)
        least, most = limits.accelerations(q, dq, PERIOD)
        assert np.maximum(mean - most, least - mean).max() < 0.03


def test_joint_is_kept_at_the_cost_of_lighter_ones():
    M = np.array([[1.0, -1e-3], [-1e-3, 1e-4]])
    # The first joint needs 12 rad/s²; of 3 N m it gets 3, so the second, lost one must turn at 9000 rad/s².
    lower, upper = np.array([12.0, -100.0, -3.0, -1.0]), np.array([50.0, 100.0, 3.0, 1.0])
    change = SmallestChange(1, 2, (0, 1))(np.array([[1.0, 0.0]]), M, lower, upper)
    assert change[0] >= 12.0 - 1e-6
    assert (np.abs(M @ change) <= upper[2:] + 1e-9).all()
