"""Self-motion objectives against their formulas, with gradients by finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from checks import DIFFERENCED, EXACT, STEP, joints, random_state, tip, velocities
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Chart,
    Damp,
    DescendPotential,
    EosController,
    FollowJoints,
    Hold,
    InputError,
    Objective,
    PositionTask,
    Posture,
    ReduceKineticEnergy,
    SumObjective,
    Track,
    line,
    simulate,
)

KP, KD = np.array([100.0, 50.0, 30.0, 10.0]), np.array([20.0, 10.0, 5.0, 2.0])


@pytest.fixture(scope="module")
def state(panda):
    """A chart of panda's position task (r = 4), and a state away from its base point."""
    q, dq = random_state(panda, seed=2)
    chart = Chart.from_base(PositionTask(panda, tip(panda)), q)
    return chart, q + 0.1 * np.sin(np.arange(7.0)), dq


def test_track_holds_v_by_default(state):
    chart, q, dq = state
    at_start = Track().acceleration(0.0, chart.q_bar, np.zeros(7), chart)
    np.testing.assert_allclose(at_start, 0.0, atol=EXACT)
    np.testing.assert_allclose(
        Track(kp=KP, kd=KD).acceleration(5.0, q, dq, chart), -KP * chart.v(q) - KD * chart.dv(dq), atol=1e-12
    )
    assert not Track().target(1.0, 4).z.any()


@given(t=st.floats(0.0, 10.0))
def test_track_is_a_linear_law_with_feedforward(state, t):
    chart, q, dq = state
    v_d, dv_d, ddv_d = (reference := line(np.ones(4), (0.1, 0.2, 0.3, 0.4), period=3.0))(t)
    expected = ddv_d + KD * (dv_d - chart.V.T @ dq) + KP * (v_d - chart.V.T @ (q - chart.q_bar))
    objective = Track(reference, kp=KP, kd=KD)
    np.testing.assert_allclose(objective.acceleration(t, q, dq, chart), expected, atol=1e-11)
    np.testing.assert_array_equal(objective.target(t, 4).z, v_d)


def test_track_serves_robots_of_different_redundancy(state, ppr):
    chart, q, dq = state
    objective = Track()
    assert objective.acceleration(0.0, q, dq, chart).shape == (4,)
    planar = Chart.from_base(PositionTask(ppr, "tip", "xy"), np.zeros(3))
    assert objective.acceleration(0.0, np.zeros(3), np.zeros(3), planar).shape == (1,)


def test_damp_and_posture_accelerate_by_their_gains(state):
    chart, q, dq = state
    np.testing.assert_allclose(Damp(3.0).acceleration(0.0, q, dq, chart), -3.0 * chart.V.T @ dq, atol=EXACT)
    assert not Damp(0.0).acceleration(0.0, q, dq, chart).any()
    rest, kp = np.linspace(-1.0, 1.0, 7), np.linspace(1.0, 7.0, 7)
    expected = chart.V.T @ (kp * (rest - q) - 2.0 * dq)
    np.testing.assert_allclose(Posture(rest, kp=kp, kd=2.0).acceleration(0.0, q, dq, chart), expected, atol=1e-12)
    assert Posture(rest).target(0.0, 4) is None


@pytest.mark.parametrize("name", ["panda", "chain"])
@given(data=st.data())
def test_energy_gradients_are_those_of_the_kinetic_energy(request, name, data):
    robot = request.getfixturevalue(name)
    q, dq = data.draw(joints(robot)), data.draw(velocities(robot))
    energy, steps = robot.kinetic_energy, STEP * np.eye(robot.n)
    by_velocity = [(energy(q, dq + e) - energy(q, dq - e)) / (2.0 * STEP) for e in steps]
    by_joints = [(energy(q + e, dq) - energy(q - e, dq)) / (2.0 * STEP) for e in steps]
    scale = DIFFERENCED * (1.0 + energy(q, dq))
    for gradient, expected in (("velocity", by_velocity), ("configuration", by_joints)):
        found = ReduceKineticEnergy(robot, gradient=gradient).energy_gradient(q, dq)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=10.0 * scale)


def test_reduce_kinetic_energy_goes_down_its_gradient(panda, state):
    chart, q, dq = state
    for gradient, slope in (("velocity", panda.mass(q) @ dq), ("configuration", panda.energy_slope(q, dq))):
        found = ReduceKineticEnergy(panda, 2.0, gradient).acceleration(0.0, q, dq, chart)
        np.testing.assert_allclose(found, -2.0 * chart.V.T @ slope, atol=1e-11)
    with pytest.raises(InputError, match="'velocity' or 'configuration'"):
        ReduceKineticEnergy(panda, gradient="speed")


def test_descend_potential_descends(panda):
    q, _ = random_state(panda, seed=2)
    task = PositionTask(panda, tip(panda))
    lift = DescendPotential(panda.gravity, gain=0.3, kd=5.0)
    chart = Chart.from_base(task, q)
    dq = np.ones(7)
    np.testing.assert_allclose(
        lift.acceleration(0.0, q, dq, chart), chart.V.T @ (-0.3 * panda.gravity(q) - 5.0 * dq), atol=1e-12
    )
    run = simulate(panda, EosController(task, Hold(task.value(q)), lift), q, duration=0.5, rtol=1e-6)
    height = [panda.potential_energy(row) for row in run.q]
    assert height[-1] < height[0] - 0.01
    assert np.abs(run.error).max() < 1e-4


def test_sum_objective_adds_its_parts(panda, state):
    chart, q, dq = state
    parts = [Posture(q), Damp(1.0), Track(0.1 * np.ones(4)), Track()]
    expected = sum(part.acceleration(0.3, q, dq, chart) for part in parts)
    np.testing.assert_allclose(SumObjective(parts).acceleration(0.3, q, dq, chart), expected, atol=1e-12)
    np.testing.assert_array_equal(SumObjective(parts).target(0.0, 4).z, 0.1 * np.ones(4))
    assert SumObjective([Damp()]).target(0.0, 4) is None
    with pytest.raises(InputError, match="at least one objective"):
        SumObjective([])


class Wrong(Objective):
    """Asks for an acceleration of another size than the self-motion has."""

    def acceleration(self, t, q, dq, chart):
        return dq


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (Track([1.0, 2.0]), "v_d must be 4 numbers"),
        (Track(line((0.0, 0.0), (1.0, 1.0), period=1.0)), "v_d must be 4 numbers"),
        (Track(kp=[1.0, 2.0]), "the self-motion gain kp must be 4 numbers"),
        (Track(kd=[1.0] * 7), "the self-motion gain kd must be 4 numbers"),
        (Posture([0.0] * 3), "the posture has 3 joints, the robot 7"),
        (FollowJoints(lambda t: tuple(np.zeros((3, 6)))), "the joints to follow are 6, the robot has 7"),
        (DescendPotential(lambda q: q[:4]), "does not fit this robot and task"),
        (SumObjective([Damp(), Track([0.0])]), "v_d must be 4 numbers"),
        (Wrong(), "the result of Wrong.acceleration must be 4 numbers"),
    ],
)
def test_objective_is_checked_at_start(panda, unchecked, objective, message):
    q, _ = random_state(panda, seed=2)
    task = PositionTask(panda, tip(panda))
    controller = EosController(task, Hold(task.value(q)), objective)
    with pytest.raises(InputError, match=message):
        controller.start(0.0, q, np.zeros(7))


def test_bad_values_are_refused():
    with pytest.raises(InputError, match="the posture must be finite"):
        Posture([0.0, np.nan])
    with pytest.raises(InputError, match="a posture gain must be 2 numbers"):
        Posture([0.0, 0.0], kp=[1.0])
    with pytest.raises(InputError, match="v_d must be finite"):
        Track([np.inf])
