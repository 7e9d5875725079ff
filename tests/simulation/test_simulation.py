"""Runs against closed forms, against each other, and at their ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from checks import INTEGRATED, integration_error, random_state, tip
from checks import READY as REST

from eos_pin import (
    Atlas,
    Controller,
    ControlLoop,
    EosController,
    FunctionError,
    Geodesic,
    Hold,
    InputError,
    OpenLoop,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    SensorNoise,
    SingularError,
    Target,
    TaskForce,
    Track,
    Trajectory,
    cubic_spline,
    figure_eight,
    line,
    minimum_jerk,
    simulate,
    simulate_extended,
    simulate_sampled,
)
from eos_pin.control.operational import BASELINES
from eos_pin.simulation.kinematic import chart_following

# The type checks cost more than the runs.
pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(params=["position", "pose"])
def task(request, panda):
    return (PositionTask if request.param == "position" else PoseTask)(panda, tip(panda))


def eight(task, size=0.15, period=4.0):
    """A figure eight of the task from where panda rests, its orientation held."""
    z = task.value(REST)
    curve = figure_eight(z[:3], size, period=period, plane="yz")
    return curve if task.m == 3 else PoseTrajectory(curve, pose=z)


# -- the closed loop -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["DOP853", "LSODA"])
def test_closed_loop_tracks_and_repeats(panda, task, method):
    run = simulate(panda, EosController(task, eight(task)), REST, duration=12.0, method=method)
    assert run.ok
    late = slice(run.settled_row, None)
    assert np.abs(run.error[late]).max() < 1e-6
    assert np.abs(run.self_motion_error[late]).max() < 1e-6
    # The task starts with an error of velocity, which has died out by the end of the first cycle.
    assert run.joint_drift_per_cycle[1:].max() < 1e-6
    assert np.ptp(run.q, axis=0).max() > 0.1
    # Exact multiples of the period, not their neighbours on the grid of samples.
    np.testing.assert_allclose(run.t[run.cycle_rows], [0.0, 4.0, 8.0, 12.0], rtol=0.0, atol=0.0)


def test_errors_decay_as_they_are_designed_to(panda):
    # kp = 100, kd = 20: e(t) = (1 + 10 t) exp(−10 t) e(0), for the task and the self-motion independently
    task = PositionTask(panda, tip(panda))
    e_z, e_v = np.array([0.1, -0.05, 0.08]), np.array([0.2, 0.1, -0.1, 0.15])
    controller = EosController(task, Hold(task.value(REST) + e_z), Track(e_v))
    run = simulate(panda, controller, REST, duration=2.0)
    decay = ((1.0 + 10.0 * run.t) * np.exp(-10.0 * run.t))[:, None]
    assert integration_error(run.error, decay * e_z) < INTEGRATED
    assert integration_error(run.self_motion_error, decay * e_v) < INTEGRATED


def test_self_motion_follows_its_command_and_leaves_the_task_alone(panda):
    task = PositionTask(panda, tip(panda))
    v_d = line(np.zeros(4), (0.3, -0.2, 0.3, 0.2), period=2.0)
    slow = simulate(panda, EosController(task, task.hold(REST), Track(v_d)), REST, duration=4.0)
    late = slice(slow.settled_row, None)
    assert np.abs(slow.error).max() < 1e-8
    assert np.abs(slow.self_motion_error[late]).max() < 1e-6
    assert np.ptp(slow.v, axis=0).min() > 0.3


def test_perturbed_plant_is_followed_badly_but_followed(panda, task):
    plant = panda.perturbed(mass=0.2, com=0.2, inertia=0.2, seed=1)
    run = simulate(plant, EosController(task, eight(task), kp=400.0, kd=40.0), REST, duration=4.0, rtol=1e-6)
    assert run.ok
    worst = np.abs(run.error[run.settled_row :]).max()
    assert 1e-4 < worst < 0.1
    # The plant of the residuals is the one that moved.
    assert run.residuals(plant)["torque"] < 1e-12
    assert run.residuals(panda)["torque"] > 1e-3


# -- both equations of motion --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("duration", "threshold", "fewest"), [(2.0, 0.05, 0), (10.0, 0.5, 3), (10.0, 0.9, 4)])
def test_equations_of_motion_agree_in_the_example_of_the_paper(ppr, duration, threshold, fewest):
    # Sec. 4.3
    task = PositionTask(ppr, "tip", "xy")
    torque = OpenLoop(lambda t: (0.0, 9.0, math.sin(math.pi * t)))
    start = np.zeros(3), (-1.0, 1.0, 0.0)
    options = {
        "duration": duration,
        "rtol": 1e-13,
        "atol": 1e-13,
        "task_force": TaskForce(task, lambda t: (0.0, 9.0)),
    }
    joints = simulate(ppr, torque, *start, **options)
    extended = simulate_extended(ppr, torque, *start, atlas=Atlas(task, threshold=threshold), **options)
    assert joints.ok
    assert extended.ok
    assert len(extended.switches) >= fewest
    assert (len(extended.switches) == 0) == (duration == 2.0)
    np.testing.assert_array_equal(extended.t, joints.t)
    assert np.linalg.norm(extended.q - joints.q, axis=1).max() < 1e-11
    assert np.abs(extended.dq - joints.dq).max() < 1e-10
    # so that there was something to agree about
    assert np.abs(joints.q[-1]).max() > 1.0


class Shaken(Controller):
    """Gravity compensation and a smooth random torque."""

    def __init__(self, robot, q, seed, size=0.5):
        random = np.random.default_rng(seed)
        self.robot = robot
        self.amplitude = size * random.normal(size=(3, robot.n)) * np.diag(robot.mass(q))
        self.frequency = random.uniform(1.0, 6.0, size=3)

    def torque(self, t, q, dq, state):
        return self.robot.gravity(q) + np.sin(self.frequency * t) @ self.amplitude


def shaken(panda, task, seed, rtol, size=0.5, method=None):
    controller = Shaken(panda, REST, seed, size)
    force = TaskForce(task, lambda t: np.array([0.5, 0.5, 0.5, 0.02, 0.02, 0.02])[: task.m] * math.sin(3.0 * t))
    options = {"duration": 2.0, "rtol": rtol, "method": method, "task_force": force}
    joints = simulate(panda, controller, REST, **options)
    return joints, simulate_extended(panda, controller, REST, atlas=Atlas(task), **options)


def shifting(robot):
    """A metric that is another one on almost every chart: of the paper, of the mass matrix, and one of neither."""
    scale = np.diag(np.linspace(1.0, 4.0, robot.n))
    return lambda q: (np.eye(robot.n), robot.mass(q), scale)[int(np.floor(40.0 * q.sum())) % 3]


@pytest.mark.parametrize("seed", range(2))
def test_equations_of_motion_agree_through_changes_of_chart_and_metric(panda, task, seed):
    controller = Shaken(panda, REST, seed)
    options = {"duration": 1.5, "rtol": 1e-13}
    joints = simulate(panda, controller, REST, **options)
    for metric in ("inertial", shifting(panda)):
        atlas = Atlas(task, threshold=0.9, metric=metric)
        extended = simulate_extended(panda, controller, REST, atlas=atlas, **options)
        assert extended.ok, extended.message
        assert len(extended.switches) > 0
        assert np.abs(extended.q - joints.q).max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_equations_of_motion_agree_under_random_forces(panda, task, seed):
    joints, extended = shaken(panda, task, seed, 1e-12)
    assert joints.ok
    assert extended.ok, extended.message
    assert np.abs(extended.q - joints.q).max() < 1e-9
    assert np.ptp(joints.q, axis=0).max() > 1.0
    np.testing.assert_allclose(extended.work, joints.work, atol=1e-8)


@pytest.mark.parametrize("seed", [2, 3])
def test_trial_steps_beyond_the_edge_of_a_chart_do_not_end_a_run(panda, seed):
    joints, extended = shaken(panda, PoseTask(panda, tip(panda)), seed, 1e-9, size=1.0, method="DOP853")
    assert extended.ok, extended.message
    assert np.abs(extended.q - joints.q).max() < 1e-5


def test_extended_space_carries_rotations_by_more_than_half_a_turn(panda):
    # The last joint turns the frame about its own axis, which wears no chart; but the coordinates of SO(3) end at π.
    task = PoseTask(panda, tip(panda))
    controller = Shaken(panda, REST, 0, size=0.0)
    spin = np.r_[np.zeros(6), 5.0]
    joints = simulate(panda, controller, REST, spin, duration=2.0)
    extended = simulate_extended(panda, controller, REST, spin, atlas=Atlas(task, threshold=0.01), duration=2.0)
    assert joints.q[-1, 6] - joints.q[0, 6] > 2.0 * math.pi
    assert extended.ok
    assert np.abs(extended.q - joints.q).max() < 1e-6


# -- chart after chart ---------------------------------------------------------------------------------------------


class Ramp(Trajectory):
    """A self-motion that goes on at a constant speed."""

    def __init__(self, speed):
        self.speed = np.atleast_1d(speed)

    def __call__(self, t):
        return Target(self.speed * t, self.speed, 0.0 * self.speed)


def winding(ppr):
    """The link of the planar robot turns round and round while the tip draws a figure eight."""
    return EosController(PositionTask(ppr, "tip", "xy"), figure_eight((0.0, 0.0)), Track(Ramp(2.0)))


def test_chart_switches_cost_no_accuracy(ppr):
    exact, *runs = (
        simulate(ppr, winding(ppr), np.zeros(3), duration=12.0, rtol=rtol) for rtol in (1e-12, 1e-9, 1e-7, 1e-5)
    )
    assert exact.ok
    assert len(exact.switches) >= 7
    errors = [np.abs(run.q - exact.q).max() for run in runs]
    assert errors[0] < 1e-8
    # The error follows the tolerance: two decades of the one for about two of the other.
    slope = np.polyfit(np.log([1e-9, 1e-7, 1e-5]), np.log(errors), 1)[0]
    assert 0.6 < slope < 1.3
    for run in runs:
        assert np.abs(run.switches - exact.switches).max() < 1e-3
    # v goes on across a switch.
    assert np.abs(np.diff(exact.v[:, 0])).max() < 0.06
    assert (np.diff(exact.chart) >= 0).all()
    assert exact.chart[-1] == len(exact.switches)


def test_switch_is_recorded_where_the_margin_is_used_up(ppr):
    controller = winding(ppr)
    run = simulate(ppr, controller, np.zeros(3), duration=3.0)
    charts = [0, *np.flatnonzero(np.diff(run.chart)) + 1]
    assert len(charts) == len(run.switches) + 1
    for row, switch in zip(charts[1:], run.switches, strict=True):
        assert run.t[row - 1] <= switch <= run.t[row]
    sampled = simulate_sampled(ppr, controller, np.zeros(3), duration=3.0)
    assert len(sampled.switches) == len(run.switches)
    assert np.abs(sampled.switches - run.switches).max() < 0.02


# -- the sampled loop ----------------------------------------------------------------------------------------------


def test_sampled_error_falls_with_the_period(panda, task):
    periods = np.array([4e-3, 2e-3, 1e-3])
    errors = []
    for period in periods:
        run = simulate_sampled(panda, EosController(task, eight(task)), REST, duration=4.0, control_period=period)
        assert run.ok
        errors.append(np.abs(run.error[run.settled_row :]).max())
    assert errors[-1] < 1e-3
    assert 0.8 < np.polyfit(np.log(periods), np.log(errors), 1)[0] < 1.2


def test_sampled_run_approaches_the_continuous_one(panda):
    task = PositionTask(panda, tip(panda))
    controller = EosController(task, Hold(task.value(REST) + 0.05))
    options = {"duration": 0.5, "record_rate": 20.0}
    continuous = simulate(panda, controller, REST, **options)
    errors = [
        np.abs(simulate_sampled(panda, controller, REST, control_period=period, **options).q - continuous.q).max()
        for period in (4e-3, 1e-3)
    ]
    assert errors[1] < 0.35 * errors[0] < 0.01


def test_held_torque_is_integrated_exactly(panda):
    # One torque for the whole run: the plant's own integrator is all there is.
    tau = panda.gravity(REST) + 0.1
    plant = simulate(panda, OpenLoop(lambda t: tau), REST, duration=0.2, rtol=1e-12)
    coarse, fine = (
        np.abs(
            simulate_sampled(
                panda, OpenLoop(lambda t: tau), REST, duration=0.2, control_period=0.01, substeps=substeps
            ).q[-1]
            - plant.q[-1]
        ).max()
        for substeps in (1, 2)
    )
    assert fine < 1e-7
    assert 8.0 < coarse / fine < 32.0  # order 4


def test_noise_is_reproducible_and_acts(panda):
    task = PositionTask(panda, tip(panda))

    def run(seed, noise):
        controller = EosController(task, task.hold(REST))
        return simulate_sampled(panda, controller, REST, duration=0.2, noise=noise, seed=seed)

    noise = SensorNoise(q=1e-4, dq=1e-3)
    np.testing.assert_array_equal(run(1, noise).q, run(1, noise).q)
    assert np.abs(run(1, noise).q - run(2, noise).q).max() > 1e-7
    assert np.abs(run(0, None).error).max() < 1e-12
    assert 1e-6 < np.abs(run(1, noise).error).max() < 1e-2


def test_delay_is_that_of_whole_periods(panda):
    # A torque that is the measured velocity shows what the controller sees.
    class Sees(Controller):
        def torque(self, t, q, dq, state):
            return panda.gravity(REST) + 0.01 * (q - REST) + 0.001

    run = simulate_sampled(panda, Sees(), REST, duration=0.02, control_period=1e-3, delay=2.6e-3, record_rate=1000.0)
    assert run.info["arguments"]["delay"] == pytest.approx(3e-3)
    seen = (run.tau - panda.gravity(REST) - 0.001) / 0.01
    for k in range(len(run.t) - 1):
        row = int(np.searchsorted(run.t, max(0.0, run.t[k] - 3e-3) - 1e-9))
        # A sample at the end of a period has the torque of that period.
        assert np.abs(seen[k] - (run.q - REST)[[max(row - 1, 0), row]]).max(axis=1).min() < 1e-9


def test_delay_costs_accuracy(panda):
    task = PositionTask(panda, tip(panda))
    runs = [
        simulate_sampled(panda, EosController(task, eight(task)), REST, duration=2.0, delay=delay)
        for delay in (0.0, 5e-3)
    ]
    errors = [np.abs(run.error[run.settled_row :]).max() for run in runs]
    assert 2.0 * errors[0] < errors[1] < 0.1


def test_torque_limits_are_kept(panda, ppr):
    task = PositionTask(panda, tip(panda))
    controller = EosController(task, Hold(task.value(REST) + 0.3))
    free = simulate_sampled(panda, controller, REST, duration=0.1, torque_limits=False)
    assert (np.abs(free.tau) > panda.effort).any()
    kept = simulate_sampled(panda, controller, REST, duration=0.1)
    assert (np.abs(kept.tau) <= panda.effort).all()
    tight = simulate_sampled(panda, controller, REST, duration=0.1, torque_limits=40.0)
    assert np.abs(tight.tau).max() == 40.0
    each = np.linspace(20.0, 80.0, 7)
    assert (np.abs(simulate_sampled(panda, controller, REST, duration=0.1, torque_limits=each).tau) <= each).all()


# -- samples -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", [simulate, simulate_sampled])
def test_samples_contain_the_exact_multiples_of_the_period(panda, drive):
    task = PositionTask(panda, tip(panda))
    period = math.sqrt(0.05)
    run = drive(panda, EosController(task, eight(task, 0.02, period)), REST, duration=1.0, record_rate=30.0)
    assert run.cycles == 4
    np.testing.assert_allclose(run.t[run.cycle_rows], period * np.arange(5), rtol=0.0, atol=1e-15)
    assert run.t[0] == 0.0
    assert run.t[-1] == 1.0
    assert (np.diff(run.t) > 0.0).all()
    assert len(run.t) in (34, 35)


@pytest.mark.parametrize("drive", [simulate, simulate_sampled])
def test_observer_is_called_with_every_sample(panda, drive):
    task = PositionTask(panda, tip(panda))
    seen = []
    run = drive(
        panda,
        EosController(task, task.hold(REST)),
        REST,
        duration=0.1,
        observer=lambda t, q: seen.append((t, *q)),
    )
    np.testing.assert_array_equal(np.array(seen), np.column_stack((run.t, run.q)))


# -- endings -------------------------------------------------------------------------------------------------------


LAWS = {
    "eos without fading": lambda task, path: EosController(task, path, smooth=False),
    "null-space-posture": lambda task, path: BASELINES["null-space-posture"](task, path, REST),
}


@pytest.mark.parametrize("make", LAWS.values(), ids=LAWS)
def test_path_out_of_reach_ends_the_run_and_keeps_its_samples(panda, make):
    task = PositionTask(panda, tip(panda))
    path = line(task.value(REST), (0.8, 0.0, 0.0), period=4.0)
    run = simulate(panda, make(task, path), REST, duration=4.0, rtol=1e-6)
    assert run.status in ("singular", "chart_lost", "diverged")
    assert "Make the path smaller" in run.message or "make the path smaller" in run.message
    assert not run.ok
    assert 0.3 < run.t[-1] < 0.6
    assert len(run.t) == len(run.q) == len(run.tau) > 30
    assert run.residuals()["task"] < 1e-12
    assert run.summary()["status"] == run.status


def test_sampled_run_out_of_reach_ends_too(panda):
    task = PositionTask(panda, tip(panda))
    path = line(task.value(REST), (0.8, 0.0, 0.0), period=4.0)
    run = simulate_sampled(panda, EosController(task, path, smooth=False), REST, duration=4.0, torque_limits=False)
    assert run.status in ("singular", "diverged", "failed", "chart_lost")
    assert 0.3 < run.t[-1] < 0.6


@pytest.mark.parametrize("drive", [simulate, simulate_sampled])
@pytest.mark.parametrize("period", [4.0, 1.0, 0.5])
def test_path_out_of_reach_is_given_up_and_taken_up_again(panda, drive, period):
    """However fast it leads through singularities, the joints never run away."""
    task = PositionTask(panda, tip(panda))
    z = task.value(REST)
    path = minimum_jerk([z, z + np.array([0.8, 0.0, 0.0]), z], [0.0, 0.5 * period, period])
    # What the law asks for, without the limits of the motors.
    freely = {"torque_limits": False} if drive is simulate_sampled else {}
    run = drive(panda, EosController(task, path), REST, duration=period + 2.0, **freely)
    assert run.ok
    assert run.deficit_seconds > 0.03
    assert np.isfinite(run.tau).all()
    assert np.abs(run.dq).max() < 60.0
    assert np.abs(run.error[-1]).max() < 1e-6


def test_torque_is_continuous_through_singularities_and_changes_of_chart(panda):
    """What it changes by from one period to the next shrinks with the period; a jump would stay what it is."""
    task = PositionTask(panda, tip(panda))
    path = line(task.value(REST), (0.8, 0.0, 0.0), period=1.0)

    def largest(period):
        controller = EosController(task, path)
        rates = {"control_period": period, "record_rate": 1.0 / period}
        run = simulate_sampled(panda, controller, REST, duration=0.3, torque_limits=False, **rates)
        assert len(run.switches) >= 2
        assert run.deficit_seconds > 0.005
        return np.abs(np.diff(run.tau, axis=0)).max()

    assert largest(1.25e-4) < 0.3 * largest(5e-4)


def test_extended_space_ends_where_no_chart_is(ur5):
    # Without redundancy nothing leads around a singular pose: the arm is driven straight through one.
    task = PoseTask(ur5, tip(ur5))
    q, dq = np.array([0.0, -0.5, 0.3, 0.5, 1.0, 0.0]), np.array([0.0, 0.0, -0.6, 0.0, 0.0, 0.0])
    controller = Shaken(ur5, q, 0, size=0.0)
    through = simulate(ur5, controller, q, dq, duration=1.0)
    assert through.ok
    assert through.q[-1, 2] < -0.1
    run = simulate_extended(ur5, controller, q, dq, atlas=Atlas(task), duration=1.0)
    assert run.status in ("singular", "chart_lost")
    assert 0.3 < run.t[-1] < 0.9
    np.testing.assert_allclose(run.q, through.q[: len(run.t)], atol=1e-5)


@pytest.mark.parametrize("method", ["DOP853", "LSODA"])
def test_integrator_that_gives_up_ends_the_run(ppr, method):
    run = simulate(ppr, OpenLoop(lambda t: ((1.0 - t) ** -2, 0.0, 0.0)), np.zeros(3), duration=2.0, method=method)
    assert run.status in ("diverged", "integration_failed", "stuck")
    assert 0.9 < run.t[-1] <= 1.0
    if method == "DOP853":
        torn = OpenLoop(lambda t: (math.nan if t > 0.5 else 0.0, 0.0, 0.0))
        run = simulate(ppr, torn, np.zeros(3), duration=1.0, method=method)
        assert run.status == "integration_failed"
        assert "gave up at t = 0.5 s" in run.message


def test_gains_too_high_for_the_period_end_the_run(panda):
    task = PositionTask(panda, tip(panda))
    controller = EosController(task, Hold(task.value(REST) + 0.02), kp=1e5, kd=700.0)
    run = simulate_sampled(panda, controller, REST, duration=2.0, control_period=0.02, torque_limits=False)
    assert run.status in ("diverged", "singular")
    assert np.isfinite(run.q).all()


@pytest.mark.parametrize("drive", [simulate, simulate_sampled])
def test_interrupted_run_is_kept(panda, drive):
    task = PositionTask(panda, tip(panda))

    def observer(t, q):
        if t >= 0.2:
            raise KeyboardInterrupt

    run = drive(panda, EosController(task, task.hold(REST)), REST, duration=9.0, observer=observer)
    assert (run.status, run.message) == ("interrupted", "interrupted at t = 0.2 s")
    assert run.t[-1] == pytest.approx(0.2)
    assert run.residuals()["torque"] < 1e-12


def test_other_errors_of_a_users_code_are_not_swallowed(panda):
    def torque(t):
        raise ZeroDivisionError

    for drive in (simulate, simulate_sampled):
        with pytest.raises(FunctionError, match="tau of an OpenLoop raised ZeroDivisionError") as caught:
            drive(panda, OpenLoop(torque), REST, duration=1.0)
        assert isinstance(caught.value.__cause__, ZeroDivisionError)


@pytest.mark.parametrize("drive", [simulate, simulate_sampled])
def test_singular_start_is_refused(ur5, drive):
    task = PoseTask(ur5, tip(ur5))
    straight = np.zeros(6)
    reference = task.hold(straight)
    for controller in (EosController(task, reference), BASELINES["task-space"](task, reference, straight)):
        with pytest.raises(SingularError, match="the task is singular here"):
            drive(ur5, controller, straight, duration=1.0)


# -- arguments -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drive", "arguments", "message"),
    [
        (simulate, {"duration": 0.0}, "duration must be a finite number above 0"),
        (simulate, {"duration": math.nan}, "duration must be a finite number"),
        (simulate, {"record_rate": 0.0}, "the sample rate must be a finite number above 0"),
        (simulate, {"method": "Euler"}, "method must be .DOP853"),
        (simulate, {"rtol": 0.0}, "rtol must be a finite number above 0"),
        (simulate, {"atol": -1.0}, "atol must be a finite number above 0"),
        (simulate, {"q": [0.0] * 6}, "q at the start must be 7 numbers"),
        (simulate, {"q": [math.nan] * 7}, "q at the start must be finite"),
        (simulate, {"dq": [0.0] * 8}, "dq at the start must be 7 numbers"),
        (simulate_sampled, {"control_period": 0.0}, "the control period must be a finite number above 0"),
        (simulate_sampled, {"delay": -1e-3}, "the delay must be a finite number of at least 0"),
        (simulate_sampled, {"substeps": 0}, "substeps must be a whole number"),
        (simulate_sampled, {"substeps": 1.5}, "substeps must be a whole number"),
        (simulate_sampled, {"torque_limits": [1.0]}, "the torque limits must be 7 numbers"),
        (simulate_sampled, {"torque_limits": -1.0}, "the torque limits must be above 0"),
        (simulate_sampled, {"duration": -1.0}, "the duration must be"),
        (simulate, {"duration": 1e12}, "up to 1,000,000 are possible. Make it shorter, or keep fewer"),
        (simulate, {"record_rate": 1e9}, "up to 1,000,000 are possible"),
        (simulate_sampled, {"duration": 1e12, "record_rate": 1e-9}, "more than 100,000,000 steps"),
        (simulate_sampled, {"control_period": 1e-12}, "more than 100,000,000 steps"),
        (simulate_sampled, {"delay": 1e9}, "more than 100,000,000 steps"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_runs(panda, drive, arguments, message):
    def observer(t, q):
        pytest.fail("the run began")

    words = {"q": REST, "duration": 1.0, "observer": observer} | arguments
    with pytest.raises(InputError, match=message):
        drive(panda, OpenLoop(lambda t: np.zeros(7)), words.pop("q"), **words)


@pytest.mark.parametrize("make", [minimum_jerk, cubic_spline, Geodesic])
def test_runs_that_end_before_their_path_begins_are_refused(panda, make):
    task = PositionTask(panda, tip(panda))
    z = task.value(REST)
    knots = [z, z + 0.01], [1.7e9, 1.7e9 + 1.0]
    path = make(task, *knots) if make is Geodesic else make(*knots)
    for drive in (simulate, simulate_sampled):
        with pytest.raises(InputError, match=r"begins at t = 1700000000 s, .* such as times - times\[0\]"):
            drive(panda, EosController(task, path), REST, duration=5.0)
    with pytest.raises(InputError, match="begins at t = 1700000000 s"):
        chart_following(task, path, REST, duration=5.0)
    # A loop may run on the clock of the path.
    assert np.isfinite(ControlLoop(EosController(task, path)).step(1.7e9, REST, np.zeros(7))).all()


def test_runs_keep_as_many_samples_as_memory_holds(panda, monkeypatch):
    monkeypatch.setattr("eos_pin.simulation._recorder.MOST_JOINT_SAMPLES", 700)
    with pytest.raises(InputError, match="101 samples of 7 joints are more than can be kept; up to 100 are possible"):
        simulate(panda, OpenLoop(lambda t: np.zeros(7)), REST, duration=1.0)


def test_simulation_refuses_a_plant_of_other_joints(panda, ppr):
    task, planar = PositionTask(panda, tip(panda)), PositionTask(ppr, "tip", "xy")
    controller = EosController(task, task.hold(REST))
    idle = OpenLoop(lambda t: np.zeros(3))
    with pytest.raises(InputError, match="the controller is for 7 joints, the plant 'ppr' has 3"):
        simulate(ppr, controller, np.zeros(3), duration=1.0)
    with pytest.raises(InputError, match="the task force is on a robot with 3 joints, the plant has 7"):
        simulate(panda, controller, REST, duration=1.0, task_force=TaskForce(planar, lambda t: (0.0, 0.0)))
    with pytest.raises(InputError, match="the atlas is of a robot with 7 joints, the plant has 3"):
        simulate_extended(ppr, idle, np.zeros(3), duration=1.0, atlas=Atlas(task))


def test_simulation_starts_from_any_state(panda):
    q, dq = random_state(panda, seed=7)
    task = PositionTask(panda, tip(panda))
    run = simulate(panda, EosController(task, task.hold(q)), q.tolist(), dq.tolist(), duration=1)
    np.testing.assert_allclose(run.dq[0], dq, atol=1e-12)
    assert run.ok
