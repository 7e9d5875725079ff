"""`KinematicLoop`: tracking to rounding, the designed decay, limits that always hold, and refusals."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from checks import REST

from eos_pin import (
    Damp,
    FollowJoints,
    Harmonic,
    InputError,
    JointLimits,
    KinematicLoop,
    PoseTask,
    PositionTask,
    Posture,
    StateError,
    SumObjective,
    Target,
    Track,
    Trajectory,
    circle,
    load_robot,
)
from eos_pin.control._sampled_law import decay
from eos_pin.control._velocity_box import VelocityBox

TURNED = REST + 0.6 * np.eye(7)[2]
HAND = "panda_hand_tcp"

pytestmark = pytest.mark.usefixtures("unchecked")


def run(loop, q, steps, start=0):
    """Commands of an ideal robot, which is where it was commanded to be."""
    found = []
    for k in range(start, start + steps):
        found.append(loop.step(k * loop.control_period, q))
        q = found[-1].q
    return np.array([c.q for c in found]), np.array([c.dq for c in found])


@pytest.mark.parametrize(("kp", "kd"), [(100.0, 20.0), (100.0, 4.0), (30.0, 40.0)])
def test_decay_samples_the_linear_law(kp, kd):
    from scipy.linalg import expm

    h, x = 0.004, np.array([0.3, -1.2])
    flow = expm(h * np.array([[0.0, 1.0], [-kp, -kd]]))
    errors = [x[0], *((x := flow @ x)[0] for _ in range(5))]
    a1, a2 = decay(kp, kd, h)
    np.testing.assert_allclose(errors[2:], [a1 * b - a2 * a for a, b in itertools.pairwise(errors[:-1])], rtol=1e-12)


def test_kinematic_loop_error_decays_as_designed(panda):
    task = PositionTask(panda, HAND)
    z = task.value(REST)
    loop = KinematicLoop(
        task, task.hold(REST), control_period=0.004, limits=JointLimits.without_torques(panda, acceleration=1e3)
    )
    run(loop, REST, 1)
    q, _ = run(loop, REST, 1, start=1)
    # Both roots are -10/s, so a step of the target decays as (1 + b t) exp(-10 t); it was as large a period before.
    b = -np.expm1(-10.0 * 0.004) / 0.004
    loop.reference = type(loop.reference)(z + np.array([0.01, 0.0, 0.0]))
    q, _ = run(loop, q[-1], 100, start=2)
    t = 0.004 * np.arange(1, 101)
    told = z + np.outer(1.0 - (1.0 + b * t) * np.exp(-10.0 * t), [0.01, 0.0, 0.0])
    np.testing.assert_allclose([task.value(row) for row in q], told, atol=1e-11)


@pytest.mark.parametrize("h", [0.001, 0.008])
def test_kinematic_loop_tracks_to_rounding_and_joints_repeat(panda, h):
    task = PositionTask(panda, HAND)
    path = circle(task.value(REST), radius=0.05, period=1.0)
    v = Harmonic(np.zeros(4), 0.1 * np.ones((1, 4)), np.zeros((1, 4)), 1.0)
    free = JointLimits.without_torques(panda, acceleration=100.0)
    loop = KinematicLoop(task, path, Track(v), control_period=h, limits=free)
    q, _ = run(loop, REST, round(5.0 / h))
    late = range(round(3.5 / h), len(q))
    assert max(np.abs(task.minus(path((k + 1) * h).z, task.value(q[k]))).max() for k in late) < 1e-9
    assert max(np.abs(v((k + 1) * h).z - loop.chart.v(q[k])).max() for k in late) < 1e-9
    np.testing.assert_allclose(q[-1], q[-1 - round(1.0 / h)], atol=1e-9)


def test_kinematic_loop_follows_joints_on_any_chart(panda):
    task = PoseTask(panda, HAND)

    def joints(t):
        return REST + 0.3 * np.sin(t), np.full(7, 0.3 * np.cos(t)), np.full(7, -0.3 * np.sin(t))

    class Path(Trajectory):
        def __call__(self, t):
            q, dq, ddq = joints(t)
            point = task.at(q, dq)
            return Target(point.z, point.dz, point.J @ ddq + point.drift)

    loop = KinematicLoop(task, Path(), FollowJoints(joints), control_period=0.002)
    q, _ = run(loop, REST, 1500)
    np.testing.assert_allclose(q[-1], joints(3.0)[0], atol=1e-9)


@pytest.mark.parametrize("summed", [False, True])
def test_kinematic_loop_asks_a_law_beside_the_task_for_its_acceleration(panda, summed):
    class Beside(Damp):
        """Also moves v where the task is accelerated, which `acceleration` alone does not know."""

        def acceleration_beside(self, t, q, dq, chart, J, task):
            asked.append(task)
            return self.acceleration(t, q, dq, chart) + np.abs(task).max()

    asked: list[np.ndarray] = []
    task, law = PositionTask(panda, HAND), Beside(5.0)
    assert not law.independent
    assert Damp(5.0).independent
    law = SumObjective([Posture(REST), law]) if summed else law
    path = circle(task.value(REST), 0.05, period=2.0, plane="yz")
    q, _ = run(KinematicLoop(task, path, law, control_period=0.004), REST, 20)
    assert len(asked) >= 19
    plain, _ = run(KinematicLoop(task, path, Damp(5.0), control_period=0.004), REST, 20)
    assert np.abs(q - plain).max() > 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_kinematic_loop_never_exceeds_limits(panda, seed):
    random = np.random.default_rng(seed)
    task = PositionTask(panda, HAND)
    limits = JointLimits.without_torques(panda, acceleration=random.uniform(1.0, 20.0, 7))
    law = (None, Posture(random.uniform(panda.lower, panda.upper)), Damp())[seed % 3]
    far = circle(random.uniform(-1.0, 1.0, 3), radius=random.uniform(0.1, 0.9), period=random.uniform(0.5, 3.0))
    h = (0.001, 0.008)[seed % 2]
    loop = KinematicLoop(task, far, law, control_period=h, limits=limits)
    start = random.uniform(panda.lower, panda.upper)
    q, dq = run(loop, start, 500)
    assert (q <= panda.upper).all()
    assert (q >= panda.lower).all()
    assert (np.abs(dq) <= panda.velocity).all()
    change = np.diff(np.vstack((np.zeros(7), dq)), axis=0) / h
    assert (np.abs(change) <= limits.acceleration * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(np.diff(np.vstack((start, q)), axis=0), h * dq, atol=1e-12)


def test_velocity_box_brings_a_joint_to_its_end_and_no_farther():
    random = np.random.default_rng(0)
    for _ in range(10):
        b, speed, h = random.uniform(0.5, 20.0), random.uniform(0.1, 3.0), random.choice([0.001, 0.01])
        one = np.ones(1)
        limits = JointLimits(-one, one, speed * one, 2.0 * b * one, b * one, np.inf * one)
        box = VelocityBox(limits, 1, h)
        q, u = -0.9 * one, 0.0 * one
        for _ in range(round((3.0 / speed + 3.0 * speed / b + 2.0 / b**0.5) / h)):
            least, most = box(q, u)
            assert least <= most
            u = most
            q = q + h * u
            assert q <= 1.0
        assert q > 1.0 - 1e-3


def test_kinematic_loop_stays_bounded_out_of_reach_and_reports_the_deficit(panda):
    task = PositionTask(panda, HAND)
    loop = KinematicLoop(
        task, type(task.hold(REST))(task.value(REST) + np.array([2.0, 0.0, 0.0])), control_period=0.002
    )
    assert loop.task_deficit is None
    _, dq = run(loop, REST, 1000)
    assert np.abs(loop.task_deficit).max() > 1.0
    assert (np.abs(dq) <= panda.velocity).all()


@pytest.mark.parametrize("wrapped", [True, False])
def test_kinematic_loop_takes_wrapped_angles(kinova, wrapped):
    task = PositionTask(kinova, kinova.options["chain_to"] if "chain_to" in kinova.options else kinova.frames[-1])
    q = np.array([0.3, 2.0, 1.5, 1.0, 0.5, 0.2, 0.1])[: kinova.n]
    goal = q + 5.0 * kinova.continuous
    loop = KinematicLoop(task, task.hold(goal), Posture(goal), control_period=0.01)
    for k in range(300):
        seen = np.where(kinova.continuous, (q + np.pi) % (2.0 * np.pi) - np.pi, q) if wrapped else q
        q = loop.step(0.01 * k, seen).q
    assert loop.lag < 1e-12


def test_kinematic_loop_refuses_and_goes_on(panda):
    task = PositionTask(panda, HAND)
    loop = KinematicLoop(task, task.hold(REST), control_period=0.01)
    first = loop.step(0.0, REST)
    np.testing.assert_array_equal(first.q, loop.step(0.0, REST).q)
    for q, told in ((REST[:6], "7 numbers"), (np.full(7, np.nan), "finite"), ("abcdefg", "numbers")):
        with pytest.raises(StateError, match=told):
            loop.step(0.01, q)
    with pytest.raises(StateError, match="monotonic"):
        loop.step(-1.0, REST)
    with pytest.raises(StateError, match=r"q\[2\] jumped"):
        loop.step(0.01, TURNED)
    with pytest.raises(StateError, match="does not follow"):
        loop.step(0.01, TURNED)
    with pytest.raises(StateError, match="jumped"):
        loop.step(0.01, REST)
    np.testing.assert_allclose(loop.step(0.01, REST).q, REST, atol=1e-9)


def test_kinematic_loop_refuses_bad_settings(panda):
    task = PositionTask(panda, HAND)
    hold = task.hold(REST)
    with pytest.raises(InputError, match="control_period"):
        KinematicLoop(task, hold, control_period=0.0)
    with pytest.raises(InputError, match="finite limit of every acceleration"):
        KinematicLoop(task, hold, control_period=0.01, limits=JointLimits.from_robot(panda))
    loop = KinematicLoop(task, hold, control_period=0.01)
    with pytest.raises(InputError, match="cannot be changed"):
        loop.task = task
    with pytest.raises(InputError):
        loop.kp = -1.0
    loop.kp = [1.0, 2.0, 3.0]
    with pytest.raises(InputError):
        loop.reference = PoseTask(panda, HAND).hold(REST)


def test_kinematic_loop_needs_no_inertia(tmp_path):
    arm = "".join(
        f'<link name="l{i}"/><joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="0"/></joint>'
        for i in range(3)
    )
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{arm}<link name="l3"/></robot>')
    robot = load_robot(file)
    task, q = PositionTask(robot, "l3", axes="xy"), np.array([0.3, 0.9, -0.5])
    loop = KinematicLoop(task, task.hold(q), control_period=0.01)
    np.testing.assert_allclose(run(loop, q, 10)[0][-1], q, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_kinematic_loop_stops_on_its_path_within_limits_and_goes_on(panda, seed):
    random = np.random.default_rng(seed)
    task = PositionTask(panda, HAND)
    path = circle(task.value(REST), radius=0.1, period=3.0)
    limits = JointLimits.without_torques(panda, acceleration=6.0)
    loop = KinematicLoop(task, path, control_period=0.008, limits=limits)
    # The start is a transient; stop once it has decayed.
    before = 400 + int(random.integers(100))
    q, dq = run(loop, REST, before)
    loop.pace = 0.0
    more, slower = run(loop, q[-1], 125, start=before)
    assert np.abs(slower[-10:]).max() < 1e-6
    change = np.diff(np.vstack((dq[-1], slower)), axis=0) / 0.008
    assert (np.abs(change) <= 6.0 * (1.0 + 1e-9)).all()
    radius = 0.1
    middle = path(0.0).z + path(1.5).z
    away = [np.linalg.norm(task.value(row) - 0.5 * middle) - radius for row in more]
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
    loop.pace = 1.0
    last, _ = run(loop, more[-1], 250, start=before + 125)
    at = (before + 375) * 0.008 - loop.path_delay
    np.testing.assert_allclose(task.value(last[-1]), path(at).z, atol=1e-9)
