"""What a sampled loop meets outside of a simulation: missed periods, friction, pushes, wrong models."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from checks import READY as REST
from checks import random_state, tip

from eos_pin import (
    Controller,
    EosController,
    Friction,
    Hold,
    InputError,
    LimitedEosController,
    OpenLoop,
    PositionTask,
    SensorNoise,
    TaskForce,
    figure_eight,
    simulate,
    simulate_sampled,
)
from eos_pin.control.operational import BASELINES

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture
def task(panda):
    return PositionTask(panda, tip(panda))


def eight(task):
    return figure_eight(task.value(REST), 0.15, period=4.0, plane="yz")


class Clock(Controller):
    """A torque that says when it was computed, beside what holds the arm."""

    def __init__(self, hold):
        self.hold, self.times = hold, []

    def torque(self, t, q, dq, state):
        self.times.append(t)
        return self.hold + t


# -- missed periods ------------------------------------------------------------------------------------------------


def test_last_torque_stays_where_a_period_is_missed(panda):
    clock = Clock(panda.gravity(REST))
    run = simulate_sampled(panda, clock, REST, duration=1.0, dropout=0.3, seed=4, record_rate=1000.0)
    # The first period has no torque to fall back on.
    assert clock.times[0] == 0.0
    # 1,000 periods: three in ten are missed, give or take four standard deviations.
    assert abs(1.0 - len(clock.times) / 1000 - 0.3) < 4.0 * np.sqrt(0.3 * 0.7 / 1000)
    acted = (run.tau - clock.hold)[:-1, 0]
    newest = [max(s for s in clock.times if s <= t + 1e-9) for t in run.t[:-1]]
    # A sample at the end of a period has the torque of that period.
    before = np.array([newest[0], *newest[:-1]])
    assert np.minimum(np.abs(acted - newest), np.abs(acted - before)).max() < 1e-12


def test_dropouts_are_reproducible_and_none_is_none(panda, task):
    def run(seed, **options):
        controller = EosController(task, eight(task))
        return simulate_sampled(panda, controller, REST, duration=0.3, seed=seed, **options).q

    noise = SensorNoise(1e-5)
    np.testing.assert_array_equal(run(1, dropout=0.2, noise=noise), run(1, dropout=0.2, noise=noise))
    assert np.abs(run(1, dropout=0.2) - run(2, dropout=0.2)).max() > 0.0
    np.testing.assert_array_equal(run(1, dropout=0.0, noise=noise), run(1, noise=noise))


def test_dropout_of_half_the_periods_is_like_a_longer_period(panda, task):
    def error(**options):
        run = simulate_sampled(panda, EosController(task, eight(task)), REST, duration=2.0, **options)
        return np.abs(run.error[run.settled_row :]).max()

    assert error() < error(dropout=0.5) < error(control_period=4e-3)


@pytest.mark.parametrize("dropout", [-0.1, 1.0, np.nan])
def test_dropout_is_a_probability_below_1(panda, dropout):
    with pytest.raises(InputError, match="dropout"):
        simulate_sampled(panda, OpenLoop(lambda t: np.zeros(7)), REST, duration=0.1, dropout=dropout)


# -- friction --------------------------------------------------------------------------------------------------------


def test_friction_follows_its_law():
    law = Friction(viscous=[1.0, 0.0], coulomb=[0.0, 3.0], speed=0.05)
    np.testing.assert_allclose(law.torque(np.array([0.5, 0.5])), [-0.5, -3.0], rtol=1e-8)
    np.testing.assert_allclose(law.torque(np.array([0.5, 0.05])), [-0.5, -3.0 * np.tanh(1.0)])
    np.testing.assert_array_equal(law.torque(np.zeros(2)), np.zeros(2))
    assert law.describe() == {"viscous": [1.0, 0.0], "coulomb": [0.0, 3.0], "speed": 0.05}
    assert Friction(0.5).describe() == {"viscous": 0.5, "coulomb": 0.0, "speed": 0.1}


def test_viscous_friction_alone_is_an_exponential(ppr):
    # A slider with nothing else on it: M ddq = −c dq, a closed form.
    slider = ppr.with_gravity(0.0)
    # The link points along y, so nothing turns it.
    q, dq = np.array([0.0, 0.0, 0.5 * np.pi]), np.array([0.0, 1.0, 0.0])
    law = Friction(viscous=[0.0, 2.0, 0.0])
    run = simulate_sampled(slider, OpenLoop(lambda t: np.zeros(3)), q, dq, duration=1.0, friction=law)
    mass = slider.mass(q)[1, 1]
    np.testing.assert_allclose(run.dq[:, 1], np.exp(-2.0 * run.t / mass), atol=1e-9)


def test_work_of_friction_is_in_the_balance_and_never_positive(panda):
    q, dq = random_state(panda, 3)
    law = Friction(viscous=0.3, coulomb=0.4)
    run = simulate_sampled(
        panda, OpenLoop(lambda t: np.zeros(7)), q, dq, duration=1.0, control_period=2e-4, friction=law
    )
    energy = [panda.kinetic_energy(*row) + panda.potential_energy(row[0]) for row in zip(run.q, run.dq, strict=True)]
    np.testing.assert_allclose(run.work, np.array(energy) - energy[0], atol=1e-6 * np.ptp(energy))
    assert (np.diff(run.work) <= 0.0).all()
    assert run.info["arguments"]["friction"] == law.describe()


def test_friction_must_fit_the_robot(panda):
    arguments = {"duration": 0.1, "friction": Friction(viscous=[1.0, 2.0])}
    with pytest.raises(InputError, match=r"viscous friction must be 7 numbers"):
        simulate_sampled(panda, OpenLoop(lambda t: np.zeros(7)), REST, **arguments)
    for wrong in ({"viscous": -1.0}, {"coulomb": [1.0, -1.0]}, {"speed": 0.0}, {"coulomb": np.nan}):
        with pytest.raises(InputError, match="friction"):
            Friction(**wrong)


# -- control against all this ----------------------------------------------------------------------------------------


def controllers(task, path):
    return {
        "eos": EosController(task, path),
        "limited": LimitedEosController(task, path),
        "posture": BASELINES["null-space-posture"](task, path, REST),
    }


AGAINST = {
    "noise": {"noise": SensorNoise(1e-5, 1e-3)},
    "delay": {"delay": 5e-3},
    "dropout": {"dropout": 0.2},
    "friction": {"friction": Friction(viscous=0.5, coulomb=0.5)},
}


@pytest.mark.slow
@pytest.mark.parametrize("against", AGAINST)
@pytest.mark.parametrize("kind", ["eos", "limited", "posture"])
def test_controllers_bear_disturbances(panda, task, kind, against):
    controller = controllers(task, eight(task))[kind]
    run = simulate_sampled(panda, controller, REST, duration=6.0, torque_limits=True, **AGAINST[against])
    assert run.status == "finished", run.message
    assert np.abs(run.error[run.settled_row :]).max() < 0.05
    assert (np.abs(run.tau) <= panda.effort).all()


@pytest.mark.parametrize("kind", ["eos", "limited", "posture"])
def test_push_is_forgotten_at_the_rate_of_the_gains(panda, task, kind):
    controller = controllers(task, Hold(task.value(REST)))[kind]
    push = TaskForce(task, lambda t: (0.0, 30.0 * (0.2 <= t < 0.4), 0.0))
    run = simulate_sampled(panda, controller, REST, duration=2.5, task_force=push)
    size = np.linalg.norm(run.error, axis=1)
    assert 0.01 < size.max() < 0.2
    # Critically damped at 10 rad/s: two seconds later e^-20 (1 + 20) and its like are left.
    assert size[-1] < 1e-6 * size.max()


@pytest.mark.slow
def test_robustness_benchmark_measures_its_columns():
    path = Path(__file__).parents[2] / "benchmarks" / "robustness.py"
    benchmark = runpy.run_path(str(path))
    row = benchmark["measure"]("position", "all at once", "EOS", cycles=3, seeds=1)
    assert row.status == "finished"
    assert 0.03 < row.task_error_max < 0.1
    assert 0.5 < row.recovery < 3.0
    assert 25.0 < row.torque_max < 87.0
    assert set(benchmark["QUICK"]) < set(benchmark["SCENARIOS"])


def test_torque_that_is_not_finite_ends_a_run_at_once(panda):
    # A step size that is not finite would keep the integrator busy for ever.
    run = simulate(panda, OpenLoop(lambda t: np.full(7, np.nan)), REST, duration=1.0)
    assert run.status == "integration_failed"
    assert "not finite at t = 0 s" in run.message
    assert len(run.t) == 1
