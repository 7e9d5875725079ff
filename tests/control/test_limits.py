"""Limits: kept always, at the price of the self-motion first and of the task last."""

from __future__ import annotations

import copy
import pickle

import daqp
import numpy as np
import pytest
from checks import REST, compiled_only, with_plain_limits
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    EosController,
    Geodesic,
    Hold,
    InputError,
    JointLimits,
    LimitedEosController,
    PoseTask,
    PositionTask,
    Posture,
    Result,
    Robot,
    figure_eight,
    simulate_sampled,
)
from eos_pin.control._smallest_change import (
    LIMIT_PRICE,
    LIMIT_WEIGHT,
    TASK_PRICE,
    TASK_WEIGHT,
    SmallestChange,
)
from eos_pin.control.limited import guaranteed_deceleration

TCP = "panda_hand_tcp"
PERIOD = 1e-3


@pytest.fixture(scope="module")
def task(panda: Robot) -> PositionTask:
    return PositionTask(panda, TCP)


@pytest.fixture(scope="module")
def limits(panda: Robot) -> JointLimits:
    return JointLimits.from_robot(panda)


def over(robot: Robot, q: np.ndarray) -> float:
    """Farthest beyond a position limit [rad]."""
    return float(np.maximum(q - robot.upper, robot.lower - q).max())


@given(st.integers(0, 2**32 - 1))
def test_limited_controller_equals_eos_without_active_limits(panda, task, limits, seed):
    random = np.random.default_rng(seed)
    path = figure_eight(task.value(REST), 0.1, period=4.0, plane="yz")
    plain, limited = EosController(task, path), LimitedEosController(task, path, limits=limits)
    q, dq = REST + 0.05 * random.normal(size=7), 0.05 * random.normal(size=7)
    state = plain.start(0.0, REST, 0.0 * REST)
    tau = plain.torque(0.3, q, dq, state)
    if (np.abs(tau) < panda.effort).all():
        assert np.array_equal(limited.torque(0.3, q, dq, state), tau)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1e-2]))
def test_accelerations_within_their_bounds_pass_no_limit(limits, seed, period):
    """A joint driven by the worst choices, to one bound and the other, stays viable for ever."""
    random = np.random.default_rng(seed)
    q, dq = 0.9 * limits.lower + 0.1 * limits.upper, np.zeros(7)
    towards = random.integers(0, 2, 7)
    for _ in range(400):
        least, most = limits.accelerations(q, dq, period)
        assert (least <= most).all()
        if random.random() < 0.02:
            towards = random.integers(0, 2, 7)
        ddq = np.clip(np.where(towards, most, least), -40.0, 40.0)
        ddq = np.clip(ddq, least, most)
        q, dq = q + period * dq + 0.5 * period**2 * ddq, dq + period * ddq
        assert (limits.lower - 1e-9 <= q).all()
        assert (q <= limits.upper + 1e-9).all()
        assert (np.abs(dq) <= limits.velocity + 1e-9).all()
        # It is always enough to brake with the deceleration that is sure.
        assert (least <= limits.braking + 1e-6).all()
        assert (most >= -limits.braking - 1e-6).all()


@pytest.mark.usefixtures("unchecked")
def test_self_motion_gives_way_first(panda: Robot, task: PositionTask) -> None:
    path = figure_eight(task.value(REST), 0.1, period=4.0, plane="yz")
    # A posture beyond the limit of joint 6 draws the self-motion into it.
    posture = REST.copy()
    posture[5] = 5.0
    plain = simulate_sampled(panda, EosController(task, path, Posture(posture, kp=20.0, kd=9.0)), REST, duration=6.0)
    kept = simulate_sampled(
        panda, LimitedEosController(task, path, Posture(posture, kp=20.0, kd=9.0)), REST, duration=6.0
    )
    assert over(panda, plain.q) > 0.1
    assert over(panda, kept.q) <= 0.0
    assert (np.abs(kept.tau) <= panda.effort).all()
    assert kept.ok
    assert kept.deficit_seconds == 0.0
    late = slice(kept.settled_row, None)
    assert np.abs(kept.error[late]).max() < 2.0 * np.abs(plain.error[late]).max() + 1e-6


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("kind", [PositionTask, PoseTask])
def test_target_out_of_reach_is_given_up_within_all_limits(panda: Robot, kind: type) -> None:
    task = kind(panda, TCP)
    z = task.value(REST)
    away = task.plus(z, np.eye(task.m)[2])
    path = Geodesic(task, [z, away, z], [0.0, 2.0, 4.0])
    run = simulate_sampled(panda, LimitedEosController(task, path), REST, duration=6.0, record_rate=1000.0)
    # Whether the task is taken up again depends on where it was given up.
    assert run.status in {"finished", "degraded"}
    assert "to keep the limits" in run.message
    met = run.summary()["singularities"]
    assert met["limit"]["seconds"] > 1.0
    assert run.deficit_seconds <= sum(met[kind]["seconds"] for kind in ("task", "limit") if kind in met)
    assert met.get("chart", {"times": 0})["times"] == len(run.switches)
    assert run.summary()["given_up_seconds"] > 1.0
    assert np.isfinite(run.tau).all()
    assert (np.abs(run.tau) <= panda.effort).all()
    assert over(panda, run.q) <= 0.0
    assert (np.abs(run.dq) <= panda.velocity * (1.0 + 1e-4)).all()
    # It comes back to its task.
    assert np.abs(run.error[-1]).max() < 1e-3


@pytest.mark.usefixtures("unchecked")
def test_torque_is_continuous_through_singularities_and_limits(panda: Robot) -> None:
    """What it changes by from one period to the next shrinks with the period; a jump would stay what it is."""
    posture = np.array([0.2, 0.3, -0.1, -1.0, 0.2, 2.4, 0.8])
    task = PositionTask(panda, TCP)
    z = task.value(posture)
    path = Geodesic(task, [z, task.plus(z, np.array([0.5, 0.1, 0.0]))], [0.0, 0.5])

    def steps(period: float) -> tuple[Result, np.ndarray]:
        controller = LimitedEosController(task, path, control_period=period)
        run = simulate_sampled(
            panda, controller, posture, duration=0.6, control_period=period, record_rate=1.0 / period
        )
        # Where a chart is left the self-motion is measured anew.
        return run, np.abs(np.diff(run.tau, axis=0))[np.diff(run.chart) == 0]

    run, coarse = steps(1e-3)
    _, fine = steps(1e-3 / 8.0)
    singular = [np.linalg.svd(task.linearize(q)[1], compute_uv=False)[-1] for q in run.q]
    assert min(singular) < 0.02
    met = run.summary()["singularities"]
    assert set(met) == {"task", "limit", "chart"}
    assert 0.0 < met["limit"]["first"] < met["task"]["first"] < 0.6
    assert "near a singularity of the task for" in run.message
    assert "to keep the limits for" in run.message
    # A small room is kept from the velocity limit.
    assert (np.abs(np.abs(run.dq) / panda.velocity - 1.0) < 3e-3).any()
    assert coarse.max() < 40.0
    assert fine.max() < 0.3 * coarse.max()


def with_slacks(
    J: np.ndarray, M: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`SmallestChange` word by word: w, t and Δ are unknown, and every inequality is a row."""
    m, n = J.shape
    none, I_n, I_m = np.zeros, np.eye(n), np.eye(m)
    weights = np.repeat((LIMIT_WEIGHT, TASK_WEIGHT, 1.0), (n, m, n))
    prices = np.repeat((LIMIT_PRICE, TASK_PRICE, 0.0), (n, m, n))
    A = np.block(
        [
            [-I_n, none((n, m + n))],
            [-I_n, none((n, m)), I_n],
            [-I_n, none((n, m)), -I_n],
            [none((n, n + m)), M],
            [none((n, n + m)), -M],
            [none((m, n)), -I_m, J],
            [none((m, n)), -I_m, -J],
        ]
    )
    most = np.concatenate((none(n), upper[:n], -lower[:n], upper[n:], -lower[n:], none(2 * m)))
    x, _, flag, _ = daqp.solve(np.diag(weights), prices, A, np.minimum(most, 1e20), np.full(len(most), -1e20))
    assert flag > 0
    return x[:n], x[n : n + m], x[n + m :]


@given(st.integers(0, 2**32 - 1), st.sampled_from([(1, 3), (3, 7), (6, 7), (6, 6)]))
def test_change_is_the_smallest(seed, size):
    m, n = size
    random = np.random.default_rng(seed)
    J, root = random.normal(size=(m, n)), random.normal(size=(n, n))
    # Often at or near a singularity.
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    s[-1] *= random.choice([0.0, 1e-9, 1e-3, 1.0])
    J, M = U * s @ Vt, root @ root.T + 0.1 * np.eye(n)
    # Some bounds demand a change, some forbid one, some are at odds with the torques, and some are not there.
    lower = random.choice([1.0, 10.0, 100.0]) * random.uniform(-3.0, 1.0, 2 * n)
    upper = np.where(random.random(2 * n) < 0.2, np.inf, lower + random.exponential(50.0, 2 * n))
    lower[n:] = np.minimum(lower[n:], 0.0)
    smallest = SmallestChange(m, n)
    change = smallest(J, M, lower, upper)
    w, t, expected = with_slacks(J, M, lower, upper)
    scale = 1.0 + np.abs(expected).max()
    assert (M @ change <= upper[n:] + 1e-5 * scale).all()
    assert (M @ change >= lower[n:] - 1e-5 * scale).all()
    # Where bounds must be passed it is another question by whom.
    if w.max() < 1e-6 * scale:
        np.testing.assert_allclose(change, expected, atol=1e-4 * scale)
        np.testing.assert_allclose(np.maximum(np.abs(J @ change) - t, 0.0), 0.0, atol=1e-4 * scale)
        assert (change <= upper[:n] + 1e-5 * scale).all()
    # Nothing is remembered, in copies neither.
    smallest(-J, M, lower - 1.0, upper)
    for use_compiled in (smallest, copy.deepcopy(smallest), pickle.loads(pickle.dumps(smallest))):
        np.testing.assert_array_equal(use_compiled(J, M, lower, upper), change)


@compiled_only
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1e-2]), st.sampled_from([1.0, 30.0, 1000.0]))
def test_compiled_limits_equal_the_plain_ones(panda, task, limits, seed, period, size):
    random = np.random.default_rng(seed)
    controller = LimitedEosController(task, Hold(task.value(REST)), limits=limits, control_period=period)
    # A beta distribution that favours the ends of the range.
    q = panda.lower + (panda.upper - panda.lower) * random.beta(0.3, 0.3, 7)
    dq, ddq = panda.velocity * random.normal(size=7) / 3.0, size * random.normal(size=7)
    point = task.at(q, dq)
    for _ in range(2):
        plain = with_plain_limits(copy.copy(controller))
        for one, other in zip(controller._within(q, dq, ddq, point.J), plain._within(q, dq, ddq, point.J), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * size)
        controller = pickle.loads(pickle.dumps(controller))


def test_sure_braking_is_held_by_the_torque_limits(panda: Robot) -> None:
    random = np.random.default_rng(5)
    a = guaranteed_deceleration(panda, panda.effort)
    for _ in range(200):
        q, dq = random.uniform(panda.lower, panda.upper), random.uniform(-panda.velocity, panda.velocity)
        tau = panda.inverse_dynamics(q, dq, random.choice([-1.0, 1.0], 7) * a)
        assert (np.abs(tau) <= panda.effort * 1.05).all()


def test_bad_limits_are_refused(panda: Robot, task: PositionTask) -> None:
    with pytest.raises(InputError, match="no room"):
        JointLimits.from_robot(panda, position_margin=2.0)
    with pytest.raises(InputError, match="positive"):
        JointLimits.from_robot(panda, velocity=0.0)
    with pytest.raises(InputError, match="7 numbers"):
        JointLimits.from_robot(panda, acceleration=[1.0, 2.0])
    with pytest.raises(InputError, match="period"):
        LimitedEosController(task, figure_eight(task.value(REST)), control_period=0.0)
