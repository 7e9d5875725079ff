"""Many states at once: the numbers of one state after the other, and what is refused."""

from __future__ import annotations

import checks
import numpy as np
import pytest

from eos_pin import (
    Chart,
    Damp,
    EosController,
    Harmonic,
    HeadingTask,
    Hold,
    InputError,
    InverseError,
    LimitedEosController,
    OpenLoop,
    PoseTask,
    PositionTask,
    Posture,
    ReduceKineticEnergy,
    StackedTask,
    Track,
    control_torques,
    inverse_kinematics,
)
from eos_pin.presets import fitting_path, rest_posture

#: Largest difference to the loop, relative to the largest number.
SAME = 1e-12


def states(q, *, count=40, seed=0, spread=0.1):
    """Joints about q, joint velocities, and times."""
    random = np.random.default_rng(seed)
    return (
        q + spread * random.normal(size=(count, q.size)),
        0.3 * random.normal(size=(count, q.size)),
        random.random(count),
    )


def tasks():
    panda, chain, ppr = (checks.robot(name) for name in ("panda", "chain", "ppr"))
    tip = checks.tip(chain)
    return {
        "panda position": PositionTask(panda, "panda_hand_tcp"),
        "panda pose": PoseTask(panda, "panda_hand_tcp"),
        "chain position": PositionTask(chain, tip, "xy"),
        "chain stack": StackedTask([PositionTask(chain, tip, "xy"), HeadingTask(chain, tip)]),
        "ppr": PositionTask(ppr, checks.tip(ppr), "xy"),
        "ur5 pose": PoseTask(checks.robot("ur5"), checks.tip(checks.robot("ur5"))),
    }


TASKS = tasks()


def laws(task, q):
    r = task.robot.n - task.m
    moving = Harmonic(np.full(r, 0.1), 0.2 * np.eye(r)[:1], np.zeros((1, r)), 2.0) if r else np.zeros(0)
    return {
        "default": {},
        "track": {"self_motion": Track(moving, kp=np.arange(1.0, r + 1), kd=3.0), "kp": np.arange(1.0, task.m + 1)},
        "damp": {"self_motion": Damp(2.0), "feedforward": False},
        "posture": {"self_motion": Posture(q + 0.1), "gravity": False},
        "energy": {"self_motion": ReduceKineticEnergy(task.robot)},
    }


def assert_same(found, expected):
    assert np.abs(found - expected).max() <= SAME * np.abs(expected).max()


@pytest.mark.parametrize("law", ["default", "track", "damp", "posture", "energy"])
@pytest.mark.parametrize("name", TASKS)
def test_torques_are_those_of_one_state_after_the_other(name, law):
    task = TASKS[name]
    q0 = rest_posture(task)
    path = fitting_path(task, q0)
    controller = EosController(task, path, **laws(task, q0)[law])
    memory = controller.start(0.0, q0, 0.0 * q0)
    q, dq, t = states(q0)
    assert_same(
        control_torques(controller, t, q, dq, memory=memory),
        np.array([controller.torque(*state, memory) for state in zip(t, q, dq, strict=True)]),
    )
    assert_same(
        control_torques(controller, 0.7, q, dq, memory=memory),
        np.array([controller.torque(0.7, *state, memory) for state in zip(q, dq, strict=True)]),
    )


def test_near_and_at_a_singularity_the_law_fades_as_it_should(panda):
    """With a straight elbow the law of one state gives a direction up; the batch must do the same."""
    task = PoseTask(panda, "panda_hand_tcp")
    q0 = rest_posture(task)
    controller = EosController(task, Hold(task.value(q0), task.m))
    memory = controller.start(0.0, q0, 0.0 * q0)
    q, dq, _ = states(np.zeros(7), spread=0.03)
    q[0] = 0.0
    q[20:] += q0
    gains = [np.linalg.svd(np.vstack((task.linearize(x)[1], memory.chart.Vt)), compute_uv=False)[-1] for x in q]
    assert min(gains) < 0.05 < max(gains)
    one_by_one = np.array([controller.torque(0.0, *state, memory) for state in zip(q, dq, strict=True)])
    assert_same(control_torques(controller, 0.0, q, dq, memory=memory), one_by_one)


def test_states_on_several_charts_or_each_on_its_own(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    q0 = rest_posture(task)
    controller = EosController(task, fitting_path(task, q0))
    q, dq, t = states(q0)
    two = [controller.start(0.0, q[k], dq[k]) for k in (0, 1)]
    mixed = [two[k % 2] for k in range(len(q))]
    found = control_torques(controller, t, q, dq, memory=mixed)
    expected = [controller.torque(*state) for state in zip(t, q, dq, mixed, strict=True)]
    assert_same(found, np.array(expected))
    expected = [controller.torque(*state, controller.start(*state)) for state in zip(t, q, dq, strict=True)]
    assert_same(control_torques(controller, t, q, dq), np.array(expected))


def test_any_controller_will_do(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    q0 = rest_posture(task)
    q, dq, _ = states(q0, count=10)
    limited = LimitedEosController(task, Hold(task.value(q0)))
    memory = limited.start(0.0, q0, 0.0 * q0)
    expected = np.array([limited.torque(0.0, *state, memory) for state in zip(q, dq, strict=True)])
    assert np.array_equal(control_torques(limited, 0.0, q, dq, memory=memory), expected)
    sines = OpenLoop(lambda t: np.full(7, np.sin(t)))
    assert np.array_equal(control_torques(sines, range(10), q, dq), np.repeat(np.sin(range(10))[:, None], 7, axis=1))


@pytest.mark.parametrize("name", TASKS)
def test_inverse_kinematics_is_that_of_one_point_after_the_other(name):
    task = TASKS[name]
    chart = Chart.at(task, rest_posture(task))
    known, _, _ = states(chart.q_bar)
    z, v = np.array([task.value(q) for q in known]), np.array([chart.v(q) for q in known])
    found = inverse_kinematics(chart, z, v)
    assert found.found.all()
    assert found.residual.max() <= checks.SOLVED
    expected = np.array([chart.inverse(*point).q for point in zip(z, v, strict=True)])
    np.testing.assert_allclose(found.q, expected, atol=1e-8)
    assert np.abs(found.q - known).max() < 1e-8


def test_what_is_far_or_out_of_reach_is_as_alone(panda):
    """Far points are walked to, and what is out of reach is told, without touching the others."""
    task = PositionTask(panda, "panda_hand_tcp")
    chart = Chart.at(task, rest_posture(task))
    random = np.random.default_rng(3)
    z = chart.z_bar + random.uniform(-0.7, 0.7, (60, 3))
    v = random.uniform(-1.0, 1.0, (60, 4))
    found = inverse_kinematics(chart, z, v)
    assert 10 < found.found.sum() < 60
    for k in range(60):
        if not found.found[k]:
            assert np.isnan(found.q[k]).all()
            with pytest.raises(InverseError) as alone:
                chart.inverse(z[k], v[k])
            assert found.residual[k] == alone.value.residual
            continue
        np.testing.assert_allclose(found.q[k], chart.inverse(z[k], v[k]).q, atol=1e-8)
        assert np.abs(task.value(found.q[k]) - z[k]).max() <= checks.SOLVED
        assert np.abs(chart.v(found.q[k]) - v[k]).max() <= 1e-9


def test_no_state_is_no_torque(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    q = rest_posture(task)
    controller = EosController(task, Hold(task.value(q)))
    nothing = np.zeros((0, 7))
    assert control_torques(controller, 0.0, nothing, nothing).shape == (0, 7)
    assert inverse_kinematics(Chart.at(task, q), np.zeros((0, 3)), np.zeros((0, 4))).q.shape == (0, 7)


def test_wrong_shapes_are_refused(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    q = rest_posture(task)
    controller, chart = EosController(task, Hold(task.value(q))), Chart.at(task, q)
    table, memory = np.tile(q, (5, 1)), controller.start(0.0, q, 0.0 * q)
    with pytest.raises(InputError, match=r"q must be of shape \(K, 7\)"):
        control_torques(controller, 0.0, q, q)
    with pytest.raises(InputError, match=r"dq must be of shape \(5, 7\)"):
        control_torques(controller, 0.0, table, table[:4])
    with pytest.raises(InputError, match="one for each of the 5"):
        control_torques(controller, [0.0, 1.0], table, table)
    with pytest.raises(InputError, match="got 2"):
        control_torques(controller, 0.0, table, table, memory=[memory, memory])
    with pytest.raises(InputError, match="finite; row 3"):
        control_torques(controller, 0.0, np.where(np.arange(5)[:, None] == 3, np.nan, table), table)
    with pytest.raises(InputError, match=r"v must be of shape \(2, 4\)"):
        inverse_kinematics(chart, np.zeros((2, 3)), np.zeros((2, 3)))
