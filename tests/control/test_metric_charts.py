"""Controllers on charts with a metric: laws, objectives, loops, and what runs record of it."""

from __future__ import annotations

import numpy as np
import pytest
from checks import tip

from eos_pin import (
    Atlas,
    Chart,
    ControlLoop,
    DescendPotential,
    EosController,
    Hold,
    ImpedanceController,
    KinematicLoop,
    LimitedEosController,
    PoseTask,
    PositionTask,
    Posture,
    ReduceKineticEnergy,
    Result,
    TaskForce,
    TaskSpaceDynamics,
    Track,
    circle,
    simulate,
    simulate_extended,
    simulate_sampled,
)
from eos_pin.control.objectives import Damp

READY = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
A = np.diag([3.0, 2.5, 2.0, 1.5, 1.0, 0.6, 0.3])
metrics = pytest.mark.parametrize("metric", ["inertial", A, lambda q: A + np.diag(q * q)])


@metrics
@pytest.mark.parametrize("kind", [PositionTask, PoseTask])
@pytest.mark.parametrize("objective", [None, Damp(5.0), Posture(READY + 0.1)])
def test_torque_is_that_of_the_formula_in_any_metric(panda, metric, kind, objective):
    """Eq. (35): M (H F* + E) − R, with W where velocities and accelerations are made coordinates."""
    task, random = kind(panda, tip(panda)), np.random.default_rng(0)
    q, dq = READY + 0.05 * random.normal(size=7), random.normal(size=7)
    controller = EosController(task, Hold(task.value(READY), task.m), objective, atlas=Atlas(task, metric=metric))
    state = controller.start(0.0, READY, 0.0 * READY)
    W, point = state.chart.W, state.chart.point(q, dq)
    F_v = {
        type(None): lambda: -100.0 * W.T @ (q - READY) - 20.0 * W.T @ dq,
        Damp: lambda: -5.0 * W.T @ dq,
        Posture: lambda: W.T @ (100.0 * (READY + 0.1 - q) - 20.0 * dq),
    }[type(objective)]()
    F_z = controller.task_acceleration(0.0, point.task)
    expected = panda.inverse_dynamics(q, dq, point.H @ np.concatenate((F_z, F_v)) + point.E)
    np.testing.assert_allclose(controller.torque(0.0, q, dq, state), expected, atol=1e-7)


@metrics
def test_gradients_go_along_the_columns_and_velocities_along_the_rows(panda, metric):
    """With V the energy falls at the base, whatever the metric; with W in its place it may rise."""
    task, dq = PositionTask(panda, tip(panda)), np.random.default_rng(1).normal(size=7)
    chart = Chart.from_base(task, READY, metric=metric)
    law = ReduceKineticEnergy(panda)
    F_v = law.acceleration(0.0, READY, dq, chart)
    np.testing.assert_allclose(F_v, -chart.V.T @ (panda.mass(READY) @ dq), atol=1e-12)
    assert (panda.mass(READY) @ dq) @ chart.V @ F_v <= 0.0
    slope = DescendPotential(lambda q: q - 1.0, gain=2.0, kd=3.0).acceleration(0.0, READY, dq, chart)
    np.testing.assert_allclose(slope, -2.0 * chart.V.T @ (READY - 1.0) - 3.0 * chart.W.T @ dq, atol=1e-12)
    np.testing.assert_array_equal(chart.along(READY), chart.V.T @ READY)


@metrics
def test_controller_errors_decay_as_designed_in_any_metric(panda, metric):
    """ε̈ + 20 ε̇ + 100 ε = 0 for task and self-motion apart, on one chart."""
    task = PositionTask(panda, tip(panda))
    z, v_d = task.value(READY) + 0.01, np.array([0.02, -0.02, 0.01, 0.03])
    controller = EosController(task, Hold(z), Track(v_d), atlas=Atlas(task, threshold=0.1, metric=metric))
    run = simulate(panda, controller, READY, duration=0.5, rtol=1e-11)
    left = (1.0 + 10.0 * run.t) * np.exp(-10.0 * run.t)
    assert run.ok
    assert not len(run.switches)
    np.testing.assert_allclose(run.error, np.outer(left, run.error[0]), atol=1e-8)
    np.testing.assert_allclose(run.self_motion_error, np.outer(left, v_d), atol=1e-8)


def test_limited_control_and_kinematic_loop_hold_v_on_inertial_charts(panda):
    """Compiled steps included."""
    task = PositionTask(panda, tip(panda))
    path, atlas = circle(task.value(READY), 0.05, period=2.0, plane="yz"), Atlas(task, threshold=0.2, metric="inertial")
    run = simulate_sampled(panda, LimitedEosController(task, path, atlas=atlas), READY, duration=3.0)
    assert run.summary()["task_error_max"] < 1e-4
    assert run.summary()["self_motion_error_max"] < 1e-3
    loop, q = KinematicLoop(task, path, control_period=0.01, atlas=atlas), READY
    for k in range(200):
        q = loop.step(0.01 * k, q).q
        assert np.abs(loop.chart.v(q)).max() < 1e-9
    assert loop.chart.metric == "inertial"
    assert np.abs(task.value(q) - path(2.0).z).max() < 1e-7


def test_torque_goes_on_where_charts_of_a_metric_change(panda):
    """The acceleration asked of v goes on where it was, and the jump of dv is forgotten."""
    task = PositionTask(panda, tip(panda))
    path = circle(task.value(READY), 0.15, period=2.0, plane="yz")
    controller = EosController(task, path, atlas=Atlas(task, threshold=0.8, metric="inertial"))
    loop, q, dq = ControlLoop(controller), READY, np.zeros(7)
    run = simulate(panda, controller, READY, duration=2.0)
    assert run.ok
    assert len(run.switches) > 0
    assert run.summary()["task_error_max"] < 1e-4
    loop.step(0.0, q, dq)
    state = loop.state
    q, dq = READY + 0.2, np.full(7, 0.5)
    before = controller.torque(0.1, q, dq, state)
    after = controller.torque(0.1, q, dq, controller.update(0.1, q, dq, state))
    np.testing.assert_allclose(after, before, atol=1e-8)


def test_saved_runs_have_the_metric_and_the_coupling(panda, tmp_path):
    task = PositionTask(panda, tip(panda))
    controller = EosController(task, Hold(task.value(READY)), atlas=Atlas(task, metric="inertial"))
    run = Result.load(simulate(panda, controller, READY, duration=0.1).save(tmp_path / "run.npz"))
    assert run.summary()["controller"]["metric"] == "inertial"
    assert run.summary()["coupling"]["max"] < 1e-6
    for metric, name in ((A, "matrix"), (lambda q: A, "function"), ("identity", "identity")):
        atlas = Atlas(task, metric=metric)
        run = simulate_extended(panda, controller, READY, atlas=atlas, duration=0.05)
        assert run.info["arguments"]["metric"] == name
        for kind in (EosController, ImpedanceController):
            assert kind(task, controller.reference, atlas=atlas).describe()["metric"] == name
        assert 0.1 < run.summary()["coupling"]["median"] <= run.summary()["coupling"]["max"] < 1.0


@pytest.mark.parametrize("kind", [PositionTask, PoseTask])
def test_inertial_charts_give_the_dynamically_consistent_law_at_their_base(panda, kind):
    """Khatib's force on the task, and the posture torque M a through Nᵀ: Eqs. (7)–(9)."""
    task, dq = kind(panda, tip(panda)), np.random.default_rng(2).normal(size=7)
    goal, rest = Hold(task.value(READY + 0.02), task.m), READY + 0.1
    controller = EosController(task, goal, Posture(rest, kp=40.0, kd=6.0), atlas=Atlas(task, metric="inertial"))
    state = controller.start(0.0, READY, dq)
    point = task.at(READY, dq)
    dynamics = TaskSpaceDynamics(panda, READY, dq, point)
    a = 40.0 * (rest - READY) - 6.0 * dq
    along = dynamics.force(controller.task_acceleration(0.0, point))
    expected = point.J.T @ along + dynamics.Nt @ (panda.mass(READY) @ a + panda.bias(READY, dq))
    np.testing.assert_allclose(controller.torque(0.0, READY, dq, state), expected, atol=1e-9)
    # So a stiffness in v is that of the consistent projector: V Wᵀ = N = I − M⁻¹G'ᵀΛG'.
    np.testing.assert_allclose(state.chart.V @ state.chart.W.T, dynamics.Nt.T, atol=1e-9)


@pytest.mark.usefixtures("unchecked")
def test_push_at_the_tool_leaves_a_soft_elbow_where_it_is_on_inertial_charts(panda):
    """At the base a force on the task accelerates no self-motion; impedance keeps the robot's own inertia."""
    task, moved = PoseTask(panda, tip(panda)), {}
    push = TaskForce(PositionTask(panda, tip(panda)), lambda t: (t < 0.2) * np.array([6.0, -6.0, 5.0]))
    for metric in ("identity", "inertial"):
        controller = ImpedanceController(task, Hold(task.value(READY), 6), atlas=Atlas(task, metric=metric))
        run = simulate(panda, controller, READY, duration=0.5, task_force=push)
        moved[metric] = np.abs(run.v).max()
    assert 5.0 * moved["inertial"] < moved["identity"]
