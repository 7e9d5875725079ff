"""The time of plans: parts of limits against inverse dynamics, the fastest time against closed forms, and files."""

from __future__ import annotations

import sys

import numpy as np
import pinocchio as pin
import pytest

from eos_pin import InputError, PositionTask, circle, load_robot
from eos_pin.errors import MissingDependencyError, PlanError
from eos_pin.planning.limit_use import MotionLimits, limit_use
from eos_pin.planning.planner import plan
from eos_pin.planning.plans import Plan
from eos_pin.planning.timing import fastest
from eos_pin.trajectories.spline import cubic_spline
from eos_pin.trajectories.through import waypoint_path
from eos_pin.trajectories.timed import Pace

SLIDER = (
    '<robot name="slider"><link name="base"/><link name="cart"><inertial><mass value="2"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="{axis}"/>'
    '<limit lower="-5" upper="5" velocity="{velocity}" effort="{effort}"/></joint></robot>'
)


def slider(axis="1 0 0", velocity=0.5, effort=30.0, length=1.0):
    """A cart of 2 kg on a straight way, and its plan along it at another pace."""
    robot = load_robot(SLIDER.format(axis=axis, velocity=velocity, effort=effort))
    task = PositionTask(robot, "cart", axes="x" if axis[0] == "1" else "z")
    times = np.linspace(0.0, 7.0, 30)
    places = length * times / 7.0
    path = waypoint_path(task, places[:, None], times)
    return Plan(task, path, times, places[:, None], False)


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda", chain_to="panda_hand_tcp")


@pytest.fixture(scope="module")
def closed(panda):
    return plan(PositionTask(panda, "panda_hand_tcp"), circle([0.5, 0.0, 0.4], 0.15, period=6.0))


@pytest.fixture(scope="module")
def quick(closed, panda):
    return fastest(closed, MotionLimits.of(panda, acceleration=8.0, torque=True))


@pytest.mark.parametrize(("velocity", "acceleration"), [(0.5, 2.0), (3.0, 2.0)])
def test_fastest_of_a_straight_way_takes_as_long_as_bang_bang_control(velocity, acceleration):
    made = slider(velocity=velocity)
    found = fastest(made, MotionLimits.of(made.robot, acceleration=acceleration))
    # Speed up, go on at the velocity limit where it is reached, and slow down.
    least = 2.0 / np.sqrt(acceleration)
    if np.sqrt(acceleration) > velocity:
        least = 1.0 / velocity + velocity / acceleration
    assert least * (1.0 - 1e-6) <= found.end - found.start <= 1.002 * least
    assert np.allclose([found(found.start).dq, found(found.end).dq], 0.0)


def test_fastest_against_gravity_takes_as_long_as_the_torque_allows():
    effort, g = 30.0, 9.81
    made = slider(axis="0 0 1", velocity=100.0, effort=effort)
    found = fastest(made, MotionLimits.of(made.robot, torque=True))
    up, down = effort / 2.0 - g, effort / 2.0 + g
    # 1 m at rest to rest: to the speed v with one acceleration, down with the other, v²/2 (1/up + 1/down) = 1.
    v = np.sqrt(2.0 / (1.0 / up + 1.0 / down))
    least = v / up + v / down
    assert least * (1.0 - 1e-6) <= found.end - found.start <= 1.002 * least


def test_fastest_keeps_limits_that_another_computation_finds(quick, panda):
    times = np.linspace(quick.start, quick.end, 1501)
    rows = [quick(t) for t in times]
    data = panda.model.createData()
    tau = np.array([pin.rnea(panda.model, data, row.q, row.dq, row.ddq) for row in rows])
    parts = [
        (np.abs([row.dq for row in rows]) / panda.model.velocityLimit).max(),
        np.abs([row.ddq for row in rows]).max() / 8.0,
        (np.abs(tau) / panda.model.effortLimit).max(),
    ]
    assert max(parts) <= 1.001
    assert max(parts) > 0.98
    use = limit_use(quick, MotionLimits.of(panda, acceleration=8.0, torque=True))
    assert use.kept
    # What is looked at elsewhere in time is nearly the same.
    assert np.allclose([use.velocity.ratio, use.acceleration.ratio, use.torque.ratio], parts, rtol=0.02)


def test_fastest_is_a_plan_with_consistent_derivatives(quick):
    task = quick.task
    for t in np.linspace(quick.start, quick.end, 9)[1:-1] + 1e-3:
        before, here, after = quick(t - 1e-6), quick(t), quick(t + 1e-6)
        assert np.allclose((after.q - before.q) / 2e-6, here.dq, atol=1e-6)
        assert np.allclose((after.dq - before.dq) / 2e-6, here.ddq, atol=1e-4)
        assert np.abs(task.minus(task.value(here.q), quick.path(t).z)).max() < 1e-9
        assert np.allclose(quick.joints(np.array([t]))[0], here.q, atol=1e-9)


def test_fastest_passes_the_seam_of_a_closed_plan_smoothly(quick):
    before, after = quick(quick.end - 1e-7), quick(quick.end + 1e-7)
    assert np.allclose(before.dq, after.dq, atol=1e-5)
    assert np.allclose(before.ddq, after.ddq, atol=1e-3)
    assert np.abs(before.dq).max() > 0.1
    assert quick.period == pytest.approx(quick.path.period)


def test_fastest_can_be_saved_and_timed_anew(quick, panda, tmp_path):
    read = Plan.load(quick.save(tmp_path / "plan.npz"), panda)
    for t in (0.0, 0.41, 3.3):
        assert all(np.array_equal(a, b) for a, b in zip(read(t), quick(t), strict=True))
    slower = fastest(read, MotionLimits.of(panda, acceleration=4.0))
    assert slower.end - slower.start > quick.end - quick.start


def test_fastest_refuses_impossible_limits():
    heavy = slider(axis="0 0 1", effort=15.0)
    with pytest.raises(PlanError, match=r"holding still takes 1\.308 times the torque of 'slide'"):
        fastest(heavy, MotionLimits.of(heavy.robot, torque=True))
    with pytest.raises(InputError, match="needs a limit of each joint's acceleration or torque"):
        fastest(heavy)
    with pytest.raises(InputError, match="largest accelerations must be"):
        MotionLimits.of(heavy.robot, acceleration=-1.0)


def test_fastest_names_the_package_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "toppra", None)
    made = slider()
    with pytest.raises(MissingDependencyError, match=r"eos-pin\[timing\]"):
        fastest(made, MotionLimits.of(made.robot, acceleration=1.0))


def test_limit_use_finds_where_a_harmonic_motion_is_fastest():
    robot = load_robot(SLIDER.format(axis="1 0 0", velocity=1.0, effort=30.0))
    task = PositionTask(robot, "cart", axes="x")
    times = np.linspace(0.0, 2.0, 81)
    places = 0.1 * np.cos(np.pi * times)
    swing = Plan(task, cubic_spline(places[:, None], times), times, places[:, None], False)
    use = limit_use(swing, MotionLimits.of(robot, acceleration=1.0, torque=True))
    assert use.velocity.ratio == pytest.approx(0.1 * np.pi, rel=1e-3)
    assert use.acceleration.ratio == pytest.approx(0.1 * np.pi**2, rel=1e-2)
    assert use.torque.ratio == pytest.approx(2.0 * 0.1 * np.pi**2 / 30.0, rel=1e-2)
    assert use.velocity.joint == "slide"


def test_plan_within_limits_of_acceleration_is_refused_or_slowed_down(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    path = circle([0.5, 0.0, 0.4], 0.15, period=1.5)
    with pytest.raises(PlanError, match=r"acceleration of 'panda_joint\d' is .* times its limit at"):
        plan(task, path, keep_time=True, acceleration=0.5)
    found = plan(task, path, keep_time=False, acceleration=0.5, torque=True)
    assert found.info["acceleration_part_max"] <= 1.0 + 1e-9
    assert found.info["torque_part_max"] <= 1.0
    assert found.info["duration"] == pytest.approx(found.end - found.start)
    ddq = np.array([found(t).ddq for t in np.linspace(found.start, found.end, 200)])
    assert 0.45 < np.abs(ddq).max() <= 0.5 + 1e-6


def test_plan_at_a_given_pace_keeps_velocity_limits_between_its_points(panda):
    found = plan(PositionTask(panda, "panda_hand_tcp"), circle([0.55, 0.0, 0.4], 0.1, period=0.45))
    dq = np.array([found(t).dq for t in np.linspace(found.start, found.end, 1500)])
    part = (np.abs(dq) / panda.velocity).max()
    assert 0.99 < part <= 1.0
    assert found.info["velocity_part_max"] == pytest.approx(part, abs=1e-4)


def test_pace_has_the_derivatives_of_its_nodes():
    times = np.array([1.0, 1.5, 2.6])
    pace = Pace(times, np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.0, 0.5]), np.array([0.0, 3.0, -1.0]))
    for i, t in enumerate(times):
        assert np.allclose(pace(t), (pace.places[i], pace.speeds[i], pace.accelerations[i]))
    assert np.allclose(pace.time(pace.place(np.linspace(1.0, 2.6, 11))), np.linspace(1.0, 2.6, 11))
    with pytest.raises(InputError, match="must increase"):
        Pace(times[::-1], pace.places, pace.speeds, pace.accelerations)
