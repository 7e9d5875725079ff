"""The EOS controller against the paper's long form, and the loop a user runs it in."""

from __future__ import annotations

import json
from functools import cache

import checks
import numpy as np
import pytest
from checks import EXACT, exact, integration_error, random_state, task_and_eight, tip
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Atlas,
    ControlLoop,
    Damp,
    EosController,
    ExtendedDynamics,
    Harmonic,
    Hold,
    InputError,
    OpenLoop,
    PoseTask,
    PositionTask,
    Posture,
    ReduceKineticEnergy,
    SingularError,
    StateError,
    Track,
    figure_eight,
    simulate,
)
from eos_pin.control.operational import BASELINES


@cache
def example(name):
    """A task by name, with a controller that tracks a moving reference and a moving self-motion."""
    name, kind = name.split()
    robot = checks.robot(name)
    q, _ = random_state(robot, seed=7)
    task, reference = task_and_eight(robot, kind, q)
    r = robot.n - task.m
    self_motion = Track(0.1 * np.ones(r), kp=50.0, kd=np.linspace(5.0, 10.0, r)) if r else None
    return EosController(task, reference, self_motion, kp=np.linspace(50.0, 100.0, task.m))


EXAMPLES = ["panda xyz", "panda pose", "kinova xyz", "chain xy", "ur5 pose"]


def draw_state(name, draw):
    """A controller with its memory at a chart's base point, and a state not far from there."""
    controller = example(name)
    robot = controller.robot
    random = np.random.default_rng(draw(st.integers(0, 10**6)))
    while True:
        q_bar = random_state(robot, random)[0]
        q, dq = q_bar + random.uniform(-0.1, 0.1, robot.n), random.uniform(-2.0, 2.0, robot.n)
        # Nearer to a singularity of the task, directions are given up on purpose.
        if all(np.linalg.norm(J, -2) > 0.05 * np.linalg.norm(J, 2) for J in map(jacobian(controller), (q_bar, q))):
            state = controller.start(0.0, q_bar, dq)
            return controller, state, state.chart.point(q, dq), draw(st.floats(0.0, 7.0))


def jacobian(controller):
    """The Jacobian of a controller's task as a function of the joints."""
    return lambda q: controller.task.linearize(q)[1]


def asked_acceleration(controller, state, point, t):
    """F* of Eqs. (36), (45), term by term."""
    task, chart, objective = controller.task, state.chart, controller.self_motion
    z_d, dz_d, ddz_d = controller.reference(t)
    z, _, dz, _ = point.task
    F_z = ddz_d + controller.kd * (dz_d - dz) + controller.kp * task.minus(z_d, z)
    v_d = objective.reference.z if objective.reference else np.zeros(chart.r)
    return np.concatenate((F_z, objective.kd * -point.dv + objective.kp * (v_d - point.v)))


@pytest.mark.parametrize("name", EXAMPLES)
@given(data=st.data())
def test_torque_is_the_long_form_of_the_paper(name, data):
    # Eqs. (35), (44): F^y = M(H F* + E) − R, with R = −bias
    controller, state, point, t = draw_state(name, data.draw)
    robot, q, dq = controller.robot, point.q, point.dq
    F = asked_acceleration(controller, state, point, t)
    ddq, M = point.H @ F + point.E, robot.mass(q)
    expected = M @ ddq + robot.bias(q, dq)
    size = np.linalg.norm(M) * np.linalg.norm(point.H) * np.linalg.norm(F) + np.linalg.norm(robot.bias(q, dq))
    found = controller.torque(t, q, dq, state)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=exact(point.H_inverse, scale=size))


@pytest.mark.parametrize("name", EXAMPLES)
@given(data=st.data())
def test_exact_model_moves_with_the_acceleration_asked_for(name, data):
    controller, state, point, t = draw_state(name, data.draw)
    F = asked_acceleration(controller, state, point, t)
    tau = controller.torque(t, point.q, point.dq, state)
    found = ExtendedDynamics(controller.robot, point).acceleration(tau)
    M = controller.robot.mass(point.q)
    tolerance = exact(point.H_inverse, M, scale=np.linalg.norm(F) + np.linalg.norm(point.E))
    np.testing.assert_allclose(found, F, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("name", EXAMPLES)
def test_self_motion_that_moves_is_tracked_like_self_motion_that_rests(name):
    """v_d(t) at one time is a constant v_d, plus what its velocity and acceleration ask for."""
    known, t = example(name), 0.7
    q, dq = random_state(known.robot, seed=3)
    r = known.robot.n - known.task.m
    moving = Harmonic(np.zeros(r), np.full((1, r), 0.1), np.full((1, r), 0.2), 4.0)
    v, dv, ddv = moving(t)
    asked = []
    for v_d in (moving, v) if r else ():
        controller = EosController(known.task, known.reference, Track(v_d, kp=50.0, kd=5.0))
        state = controller.start(0.0, q, dq)
        ddq = known.robot.forward_dynamics(q, dq, controller.torque(t, q, dq, state))
        asked.append(state.chart.dv(ddq))
    if r:
        np.testing.assert_allclose(asked[0] - asked[1], 5.0 * dv + ddv, atol=1e-9)


def test_law_of_ones_own_is_used(panda):
    """A subclass that changes the task's law, and self-motion that is not tracked, have no ready product."""

    class Lazy(EosController):
        def task_acceleration(self, t, point):
            return 0.0 * point.dz

    q, dq = random_state(panda, seed=7)
    task = PositionTask(panda, tip(panda))
    controller = Lazy(task, Hold(task.value(q) + 0.1))
    tau = ControlLoop(controller).step(0.0, q, 0.0 * dq)
    ddq = panda.forward_dynamics(q, 0.0 * dq, tau)
    np.testing.assert_allclose(task.linearize(q)[1] @ ddq, 0.0, atol=1e-9)
    assert EosController(task, task.hold(q), Damp()).start(0.0, q, dq).law is None


@pytest.mark.parametrize("name", EXAMPLES)
def test_torque_is_a_pure_function(name):
    controller = example(name)
    q, dq = random_state(controller.robot, seed=7)
    state = controller.start(0.0, q, dq)
    chart = state.chart
    first = controller.torque(0.3, q, dq, state)
    for shift in (0.01, -0.02):
        controller.torque(99.0, q + shift, -dq, state)
        controller.validity(99.0, q + shift, -dq, state)
        controller.update(99.0, q + shift, -dq, state)
    np.testing.assert_array_equal(controller.torque(0.3, q, dq, state), first)
    assert state.chart is chart
    assert state.number == 0


def test_gains_are_checked_and_kept_per_coordinate(panda):
    task = PositionTask(panda, tip(panda))
    q, dq = random_state(panda, seed=7)
    target = Hold(task.value(q) + 0.1)
    controller = EosController(task, target, kp=[1.0, 2.0, 3.0], kd=(4.0, 5.0, 6.0))
    point = task.at(q, dq)
    expected = [0.1, 0.2, 0.3] - np.array([4.0, 5.0, 6.0]) * point.dz
    np.testing.assert_allclose(controller.task_acceleration(0.0, point), expected, atol=EXACT * 10)
    with pytest.raises(InputError, match="the task gain kp must be 3 numbers"):
        EosController(task, target, kp=[1.0, 2.0])
    with pytest.raises(InputError, match="the task gain kd must be finite"):
        EosController(task, target, kd=np.nan)


def test_reference_and_atlas_must_fit_the_task(panda):
    task, pose = PositionTask(panda, tip(panda)), PoseTask(panda, tip(panda))
    with pytest.raises(InputError, match="the reference does not fit the task"):
        EosController(task, Hold((0.0, 0.0)))
    with pytest.raises(InputError, match="12 velocity components"):
        EosController(pose, Hold(pose.value(np.zeros(7))))
    with pytest.raises(InputError, match="the controller's own task object"):
        EosController(task, Hold(np.zeros(3)), atlas=Atlas(pose))


def test_controller_without_gravity_compensation_leaves_gravity_out(panda):
    task = PositionTask(panda, tip(panda))
    q, dq = random_state(panda, seed=7)
    reference = task.hold(q)
    full, bare = (EosController(task, reference, gravity=gravity) for gravity in (True, False))
    difference = full.torque(0.0, q, dq, full.start(0.0, q, dq)) - bare.torque(0.0, q, dq, bare.start(0.0, q, dq))
    np.testing.assert_allclose(difference, panda.gravity(q), atol=1e-12)


def test_controller_without_feedforward_ignores_rates_of_the_reference(panda):
    task = PositionTask(panda, tip(panda))
    q, dq = random_state(panda, seed=7)
    reference = figure_eight(task.value(q), 0.2)
    controller = EosController(task, reference, feedforward=False)
    point = task.at(q, dq)
    expected = 100.0 * (reference(0.4).z - point.z) - 20.0 * point.dz
    np.testing.assert_allclose(controller.task_acceleration(0.4, point), expected, atol=1e-12)


def test_describe_is_plain():
    q = np.zeros(7)
    eos = example("panda xyz")
    made = [make(eos.task, eos.reference, q) for make in BASELINES.values()]
    objectives = [None, Damp(), Posture(q), ReduceKineticEnergy(eos.robot)]
    made += [EosController(eos.task, eos.reference, objective) for objective in objectives]
    for controller in [*map(example, EXAMPLES), *made, OpenLoop(lambda t: q)]:
        description = json.loads(json.dumps(controller.describe()))
        assert description["kind"] == type(controller).__name__


# -- a loop of the user's own --------------------------------------------------------------------------------------


def test_loop_gives_the_controllers_torque_and_takes_lists(panda):
    controller = example("panda xyz")
    q, dq = random_state(panda, seed=7)
    expected = controller.torque(0.2, q, dq, controller.start(0.2, q, dq))
    forms = [(q, dq), (q.tolist(), dq.tolist()), (tuple(q), dq), (np.asfortranarray(q)[:], dq[::-1].copy()[::-1])]
    for form in forms:
        np.testing.assert_array_equal(ControlLoop(controller).step(0.2, *form), expected)


def test_loop_takes_other_number_types(unchecked):
    controller = example("panda xyz")
    q, dq = np.array([0, -1, 0, -2, 0, 2, 1]), np.zeros(7, dtype=int)
    expected = ControlLoop(controller).step(0.0, q.astype(float), dq.astype(float))
    for kind in (int, np.float32, np.int8):
        np.testing.assert_array_equal(ControlLoop(controller).step(0, q.astype(kind), dq.astype(kind)), expected)


NAN, INF = np.full(7, np.nan), np.r_[np.zeros(6), np.inf]


@pytest.mark.parametrize(
    ("q", "dq", "message"),
    [
        (NAN, np.zeros(7), "q must be finite"),
        (np.zeros(7), INF, "dq must be finite"),
        (np.zeros(6), np.zeros(7), "q must be 7 numbers"),
        (np.zeros(7), np.zeros((7, 1)), r"dq must be 7 numbers, got shape \(7, 1\)"),
        (np.zeros((7, 7)), np.zeros(7), "q must be 7 numbers"),
        (["a"] * 7, np.zeros(7), "q must be numbers"),
        (None, np.zeros(7), "q must be"),
        (0.0, 0.0, "q must be 7 numbers"),
    ],
)
def test_loop_refuses_an_unusable_state_and_goes_on(panda, unchecked, q, dq, message):
    good = random_state(panda, seed=7)
    controller = example("panda xyz")
    loop, other = ControlLoop(controller), ControlLoop(controller)
    with pytest.raises(StateError, match=message):
        loop.step(0.0, q, dq)
    for t in (0.0, 0.1):
        np.testing.assert_array_equal(loop.step(t, *good), other.step(t, *good))
        state = loop.state
        with pytest.raises(StateError, match=message):
            loop.step(t, q, dq)
        assert loop.state is state


def test_loop_refuses_a_singular_start(ur5):
    straight = np.zeros(6)
    task = PoseTask(ur5, tip(ur5))
    loop = ControlLoop(EosController(task, task.hold(straight)))
    with pytest.raises(SingularError, match="the task is singular here") as caught:
        loop.step(0.0, straight, straight)
    assert caught.value.rank < 6
    q, dq = random_state(ur5, seed=7)
    assert np.isfinite(loop.step(0.0, q, dq)).all()


def test_loop_changes_charts_where_the_controller_would(ppr):
    task = PositionTask(ppr, "tip", "xy")
    controller = EosController(task, figure_eight((0.0, 0.0)))
    loop = ControlLoop(controller, torque_limits=False)
    dq = np.zeros(3)
    last = None
    for angle in np.linspace(0.0, 2.0 * np.pi, 100):
        q = np.array([0.0, 0.0, angle])
        tau = loop.step(0.0, q, dq)
        np.testing.assert_array_equal(tau, controller.torque(0.0, q, dq, loop.state))
        margin = loop.state.chart.margin(task.linearize(q)[1])
        assert margin > controller.atlas.threshold
        if last and loop.state is not last:
            np.testing.assert_allclose(loop.state.chart.v(q), last.chart.v(q), atol=1e-12)
        last = loop.state
    assert loop.state.number >= 3
    loop.reset()
    loop.step(0.0, np.zeros(3), dq)
    assert loop.state.number == 0


@pytest.mark.parametrize("name", BASELINES)
def test_loop_runs_controllers_without_charts(panda, name):
    task = PositionTask(panda, tip(panda))
    q, dq = random_state(panda, seed=7)
    controller = BASELINES[name](task, task.hold(q), q)
    tau = ControlLoop(controller).step(0.0, q, dq)
    np.testing.assert_array_equal(tau, controller.torque(0.0, q, dq, None))


def test_open_loop_is_the_given_torque(panda):
    assert OpenLoop(lambda t: [t, 2.0]).torque(3.0, np.zeros(2), np.zeros(2), None).tolist() == [3.0, 2.0]
    run = simulate(panda, OpenLoop(lambda t: panda.gravity(np.zeros(7))), np.zeros(7), duration=0.2)
    assert integration_error(run.q, 0.0 * run.q) < 1.0
