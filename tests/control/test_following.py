"""The law that follows a plan: rounds, chart changes, pushes, limits, pace, and starts elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import checks
import numpy as np
import pinocchio as pin
import pytest
from checks import planar

from eos_pin import (
    Atlas,
    Chart,
    ControlLoop,
    Damp,
    EosController,
    FollowJoints,
    FollowPlan,
    JointLimits,
    KinematicLoop,
    LimitedEosController,
    MujocoPlant,
    OrientationTask,
    PointAxisTask,
    PoseTask,
    PositionTask,
    SumObjective,
    Target,
    Task,
    TaskForce,
    Tool,
    TrackTask,
    Trajectory,
    circle,
    journey,
    load_robot,
    plan,
    simulate,
    simulate_kinematic,
    simulate_sampled,
)
from eos_pin.control._sampled_law import decay
from eos_pin.control.joining import distances
from eos_pin.errors import InputError, PlanError
from eos_pin.tasks.batch import Manifold
from eos_pin.trajectories.pace import Clock

PERIOD = 4.0

# Long runs.
pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(scope="module")
def found(task):
    """A circle on which v that is held needs several charts a round."""
    return plan(task, circle([0.7, 0.0, 0.4], 0.3, period=PERIOD))


def elsewhere(panda):
    """A plan for a pose, and joints with its first task point on another component."""
    task = PoseTask(panda, "panda_hand_tcp")
    start = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    pose = panda.placement(start, "panda_hand_tcp")
    points = [pin.SE3(pose.rotation, pose.translation + np.array([0.0, y, 0.0])) for y in np.linspace(0.0, 0.1, 5)]
    made = plan(task, points, start=start)
    assert np.abs(made.q[0] - start).max() < 1e-9
    Q, good = Manifold(task).search(
        np.random.default_rng(0).uniform(panda.lower, panda.upper, (300, 7)).T,
        np.repeat(task.value(start)[:, None], 300, axis=1),
        (panda.lower, panda.upper),
    )
    return made, next(q for q in Q[:, good].T if abs(q[0] - start[0]) > 1.5)


@dataclass
class PathOfJoints(Trajectory):
    """The task path of joints over time."""

    task: Task
    joints: Callable

    def __call__(self, t):
        q, dq, ddq = self.joints(t)
        point = self.task.at(q, dq)
        return Target(point.z, point.dz, point.J @ ddq + point.drift)


@pytest.mark.parametrize("away", [0.0, 0.1])
@pytest.mark.parametrize("law", [lambda law: law, lambda law: SumObjective([Damp(0.0), law])])
def test_joints_are_followed_through_a_singularity_of_the_task(away, law):
    """At t = 0.5 s a planar arm is straight, and its tip can no longer move along it."""
    robot = planar(*[pin.JointModelRZ()] * 4)
    task = PositionTask(robot, "tip", axes="xy")
    middle, bent = np.array([0.3, 0.0, 0.0, 0.0]), np.array([0.5, 0.8, -1.0, 0.6])
    assert np.linalg.svd(task.at(middle, 0.0 * middle).J, compute_uv=False)[-1] < 1e-12

    def joints(t):
        s = t - 0.5
        return middle + bent * np.sin(s), bent * np.cos(s), -bent * np.sin(s)

    q, dq, _ = joints(0.0)
    controller = EosController(task, PathOfJoints(task, joints), law(FollowJoints(joints)))
    run = simulate(robot, controller, q + away * bent, dq=dq, duration=2.0, rtol=1e-8, atol=1e-10)
    assert np.abs(run.q[-1] - joints(float(run.t[-1]))[0]).max() < 1e-6
    if not away:
        assert np.abs(run.error).max() < 1e-6
        assert run.message == ""


@pytest.mark.parametrize("kind", [EosController, LimitedEosController])
@pytest.mark.parametrize("mujoco", [False, True])
def test_rounds_at_1_khz_repeat_over_chart_changes_within_limits(found, task, panda, kind, mujoco):
    if mujoco:
        pytest.importorskip("mujoco")
    plant = MujocoPlant.from_robot(panda) if mujoco else panda
    controller = kind(task, found.path, FollowPlan(found), atlas=Atlas(task, threshold=0.8))
    run = simulate_sampled(plant, controller, found(0.0).q, dq=found(0.0).dq, duration=2.0 * PERIOD)
    assert run.status == "finished"
    assert len(run.switches) >= 2
    # A torque that is held for a period lags by half of it, the same in every round.
    first, second = run.joint_drift_per_cycle
    assert first < 1e-3
    # An acceleration that was carried over to a new chart near the end of a round is not quite forgotten there.
    assert second < 1e-7
    assert run.info["joint_distance"]["max"] < 2e-3
    assert ((run.q > panda.lower) & (run.q < panda.upper)).all()


@pytest.mark.parametrize("kind", [EosController, LimitedEosController])
def test_rounds_in_continuous_time_repeat_from_the_first(found, task, kind):
    controller = kind(task, found.path, FollowPlan(found), atlas=Atlas(task, threshold=0.8))
    run = simulate(task.robot, controller, found(0.0).q, dq=found(0.0).dq, duration=2.0 * PERIOD, rtol=1e-8)
    assert run.joint_drift_per_cycle.max() < 1e-6
    assert run.info["joint_distance"]["max"] < 1e-6


def test_targets_on_both_charts_of_a_change_are_those_of_the_joints(found, task):
    atlas, law = Atlas(task, threshold=0.8), FollowPlan(found)
    chart, changes = atlas.start(found(0.0).q), 0
    for t in np.linspace(0.0, PERIOD, 200):
        q, dq, ddq = found(t)
        point = task.at(q, dq)
        if atlas.holds(chart, point.J):
            continue
        before, chart, changes = chart, atlas.next(chart, q), changes + 1
        for side in (before, chart):
            v, dv, ddv = law.target_on(t, side)
            assert np.abs(side.inverse(found.path(t).z, v).q - q).max() < 1e-9
            assert np.abs(side.acceleration(point.J, point.dz, dv) - dq).max() < 1e-9
            assert np.abs(side.acceleration(point.J, found.path(t).ddz - point.drift, ddv) - ddq).max() < 1e-8
    assert changes >= 2


def test_joints_return_to_the_plan_after_a_push(found, task, panda):
    push = TaskForce(task, lambda t: [0.0, 30.0 * (0.5 < t < 0.7), 40.0 * (0.5 < t < 0.7)])
    controller = EosController(task, found.path, FollowPlan(found))
    run = simulate(panda, controller, found(0.0).q, dq=found(0.0).dq, duration=PERIOD, task_force=push, rtol=1e-8)
    apart = distances(found, run.t, run.q)
    assert apart.max() > 1e-2
    assert apart[-1] < 1e-6


def test_joints_return_to_the_plan_after_velocity_limits_held_them_back(found, task, panda):
    fastest = np.abs([found(t).dq for t in np.linspace(0.0, PERIOD, 400)]).max(axis=0)
    limits = JointLimits.from_robot(panda, velocity=0.97 * np.where(fastest == fastest.max(), fastest, 10.0))
    controller = LimitedEosController(task, found.path, FollowPlan(found), limits=limits)
    times = np.linspace(0.0, PERIOD, 400)
    peak = times[np.abs([found(t).dq for t in times]).max(axis=1).argmax()]
    run = simulate_sampled(panda, controller, found(0.0).q, dq=found(0.0).dq, duration=peak + 3.0)
    assert distances(found, run.t, run.q).max() > 2e-3
    held = distances(found, run.t, run.q)[-1]
    free = simulate_sampled(
        panda, EosController(task, found.path, FollowPlan(found)), found(0.0).q, dq=found(0.0).dq, duration=peak + 3.0
    )
    assert abs(held - distances(found, free.t, free.q)[-1]) < 1e-6


def test_joints_stay_on_the_plan_through_a_pause_and_another_speed(found, task, panda):
    clock = Clock()
    clock.pause(0.5)
    clock.resume(1.5, 0.5)
    clock.set_speed(3.0, 1.3)
    law = FollowPlan(found, clock=clock)
    run = simulate(
        panda, EosController(task, law.path, law), found(0.0).q, dq=found(0.0).dq, duration=PERIOD, rtol=1e-8
    )
    assert run.info["joint_distance"]["max"] < 1e-6
    resting = run.q[(run.t > 1.1) & (run.t < 1.5)]
    assert np.ptp(resting, axis=0).max() < 1e-6
    assert np.abs(run.q[-1] - found(clock(PERIOD)[0]).q).max() < 1e-6


def test_start_on_another_component_is_refused_and_a_run_from_there_reports(panda):
    made, away = elsewhere(panda)
    controller = EosController(made.task, made.path, FollowPlan(made))
    with pytest.raises(PlanError, match="Join them first"):
        simulate(panda, controller, away, duration=1.0)
    with pytest.raises(PlanError, match="cannot join the plan from where it stands"):
        journey(made, away)
    forced = EosController(made.task, made.path, FollowPlan(made, within=10.0))
    run = simulate(panda, forced, away, duration=4.0)
    assert run.status == "degraded"
    assert "away from those they were to follow" in run.message
    assert np.abs(run.error[-1]).max() < 1e-3


def test_joints_that_were_joined_repeat(found, task, panda):
    near = found(0.0).q + np.array([0.0, 0.2, -0.8, 0.1, 0.9, 0.1, 0.3])
    Q, good = Manifold(task).project(near[:, None], found.path(0.0).z[:, None])
    assert good[0]
    way = journey(found, Q[:, 0])
    controller = EosController(task, way.path, way.law())
    run = simulate(panda, controller, Q[:, 0], duration=way.seconds + 0.5 + 2.0 * PERIOD, rtol=1e-8)
    assert run.info["joint_distance"]["max"] < 1e-6
    assert np.abs(run.q[-1] - found(way.clock(float(run.t[-1]))[0]).q).max() < 1e-6


def test_torques_for_the_middle_of_their_period_keep_joints_on_the_plan(found, task, panda):
    """Held for 2 ms, they leave the joints beside the plan by the square of the period, and by the period otherwise."""
    off = {}
    for period, centred in ((2e-3, False), (2e-3, True), (1e-3, True)):
        run = simulate_sampled(
            panda, EosController(task, found.path, FollowPlan(found)), found(0.0).q, dq=found(0.0).dq, duration=1.0,
            control_period=period, centred=centred,
        )  # fmt: skip
        off[period, centred] = distances(found, run.t[run.t > 0.3], run.q[run.t > 0.3]).max()
    assert off[2e-3, True] < 0.02 * off[2e-3, False]
    assert off[1e-3, True] < 4e-7
    assert 3.5 < off[2e-3, True] / off[1e-3, True] < 4.5


def test_torques_for_the_middle_of_a_period_need_its_length(found, task):
    controller = EosController(task, found.path, FollowPlan(found))
    with pytest.raises(InputError, match="centred torques need a control_period"):
        ControlLoop(controller, centred=True)


def test_plan_is_refused_for_another_robot_or_task(found, panda):
    heavier = load_robot("panda", chain_to="panda_hand_tcp", payload={"mass": 1.0, "frame": "panda_hand_tcp"})
    for robot, frame, message in ((heavier, "panda_hand_tcp", "other masses"), (panda, "panda_link8", "for the task")):
        controller = EosController(PositionTask(robot, frame), found.path, FollowPlan(found, within=10.0))
        with pytest.raises(PlanError, match=message):
            simulate(robot, controller, found(0.0).q, duration=0.1)


# -- joints that jump --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def jumping(task, found):
    """Two branches of one path: those of the plan up to its middle, and further on those with the wrist turned."""
    K = len(found.times)
    middle = K // 2
    q = found.q.copy()
    q[middle:, 6] += 0.5
    return replace(found, q=q, closed=False, jumps=(middle - 1,))


def test_plan_that_jumps_has_its_task_point_on_both_sides_and_jumps_once(jumping, task):
    (where,) = jumping.jump_times
    times = np.linspace(jumping.start, jumping.end, 301)
    for t in (*times, where - 1e-9, where):
        assert np.abs(task.minus(task.value(jumping(t).q), jumping.path(t).z)).max() < 1e-9
    assert np.abs(jumping(where).q - jumping(where - 1e-9).q).max() == pytest.approx(0.5, abs=0.1)
    steps = np.abs(np.diff(jumping.joints(times), axis=0)).max(axis=1)
    assert (steps > 0.3).sum() == 1
    assert np.abs(jumping.joints(np.array([1.234]))[0] - jumping(1.234).q).max() < 1e-9
    h = 1e-5
    for t in (where - 0.01, where + 0.01):
        assert np.abs((jumping(t + h).q - jumping(t - h).q) / (2 * h) - jumping(t).dq).max() < 1e-6


def test_plan_that_jumps_is_saved_and_exported_but_not_followed(jumping, tmp_path):
    again = type(jumping).load(jumping.save(tmp_path / "plan.npz"))
    assert again.jump_times == jumping.jump_times
    assert np.isfinite(np.loadtxt(jumping.to_csv(tmp_path / "q.csv"), delimiter=",", skiprows=1)).all()
    with pytest.raises(PlanError, match="jump 1 times"):
        FollowPlan(jumping)
    with pytest.raises(PlanError, match="jump 1 times"):
        journey(jumping, jumping.q[0])


def test_follow_joints_counts_no_full_turns_of_continuous_joints(kinova):
    q = np.full(6, 0.1)
    law = FollowJoints(lambda t: (q, 0.0 * q, 0.0 * q))
    turned = q + 2.0 * np.pi * kinova.continuous
    assert law.distance(0.0, turned, kinova) < 1e-9
    assert law.distance(0.0, turned) > 6.0


class Turning(Trajectory):
    """Orientation that turns about an axis of the tool, from rest to rest, by `angle` in `T` seconds."""

    def __init__(self, R, axis, angle, T):
        self.R, self.axis, self.angle, self.T = R, axis, angle, T

    def __call__(self, t):
        s, w = min(t / self.T, 1.0), 2.0 * np.pi
        turn = self.angle * np.array(
            [s - np.sin(w * s) / w, (1.0 - np.cos(w * s)) / self.T, w * np.sin(w * s) / self.T**2]
        )
        world = self.R @ self.axis
        return Target((self.R @ pin.exp3(turn[0] * self.axis)).ravel(), turn[1] * world, turn[2] * world)


def rolling():
    """A torch whose axis is directed, and a roll by a whole turn from 0.3 rad beside."""
    torch = Tool(
        "tool0", pin.SE3(pin.exp3(np.array([0.0, np.radians(35.0), 0.0])), np.array([0.08, 0.0, 0.15])), "torch"
    )
    ur5 = load_robot("ur5", chain_to="torch", tool=torch)
    task, turn = PointAxisTask(ur5, "torch"), OrientationTask(ur5, "torch")
    q, beside = np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2]), 0.3
    z_axis, R = np.array([0.0, 0.0, 1.0]), turn.value(q).reshape(3, 3)
    path = Turning(R @ pin.exp3(-beside * z_axis), z_axis, 2.0 * np.pi, 3.0)
    return task, turn, q, beside, R @ z_axis, path


def test_roll_obeys_its_law_through_changes_of_charts():
    task, turn, q, beside, axis, path = rolling()
    controller = EosController(task, task.hold(q), TrackTask(turn, path), atlas=Atlas(task, threshold=0.9))
    run = simulate(task.robot, controller, q, duration=3.0, rtol=1e-9, atol=1e-11, record_rate=20.0)
    assert run.ok
    assert len(run.switches) >= 2
    assert np.abs(run.error).max() < 1e-8
    found = [turn.minus(turn.value(row), path(t).z) @ axis for t, row in zip(run.t, run.q, strict=True)]
    np.testing.assert_allclose(found, beside * (1.0 + 10.0 * run.t) * np.exp(-10.0 * run.t), rtol=0.0, atol=1e-7)


def test_kinematic_loop_rolls_by_a_law_of_its_own_through_changes_of_charts():
    task, turn, q, beside, axis, path = rolling()
    quick = JointLimits.without_torques(task.robot, velocity=99.0, acceleration=1e3)
    period, rest = 0.006, task.hold(q)
    loop = KinematicLoop(
        task, rest, TrackTask(turn, path), control_period=period, limits=quick, atlas=Atlas(task, threshold=0.9)
    )
    joints, charts, before, now = q, set(), beside, beside
    a1, a2 = decay(100.0, 20.0, period)
    for k in range(500):
        joints = loop.step(k * period, joints).q
        charts.add(loop.chart)
        before, now = now, a1 * now - a2 * before
        t = (k + 1) * period
        assert abs(turn.minus(turn.value(joints), path(t).z) @ axis - now) < 1e-10
        assert np.abs(task.minus(task.value(joints), rest.z)).max() < 1e-10
    assert len(charts) > 2


@pytest.mark.parametrize("law", [lambda law: law, lambda law: SumObjective([law, Damp(0.0)])])
def test_limits_that_take_a_further_task_are_named(law):
    task, turn, q, _, _, path = rolling()
    slow = {"velocity": 0.6, "acceleration": 20.0}
    law = law(TrackTask(turn, path))
    loop = KinematicLoop(
        task, task.hold(q), law, control_period=0.01, limits=JointLimits.without_torques(task.robot, **slow)
    )
    torques = LimitedEosController(
        task, task.hold(q), law, control_period=0.01, limits=JointLimits.from_robot(task.robot, **slow)
    )
    for run in (
        simulate_kinematic(loop, q, duration=1.5),
        simulate_sampled(task.robot, torques, q, duration=1.5, control_period=0.01),
    ):
        assert run.status == "degraded"
        assert "part of the further task, orientation of torch, was given up to keep the limits" in run.message
        assert run.summary()["further_task"]["given_up_seconds"] > 0.5
        assert run.summary()["further_task"]["error_end"] > 0.1


def test_further_task_has_the_acceleration_asked_of_it_as_far_as_the_task_allows(panda):
    frame = checks.tip(panda)
    task, turn = PositionTask(panda, frame), OrientationTask(panda, frame)
    q, dq = checks.random_state(panda, 3)
    chart, aim = Chart.from_base(task, q + 0.1), turn.hold(q + 0.2)
    law, point = TrackTask(turn, aim, kp=[30.0, 20.0, 10.0], kd=3.0), task.at(q, dq)
    F_z = np.array([1.0, -2.0, 3.0])
    ddq = chart.acceleration(point.J, F_z, law.acceleration_beside(0.0, q, dq, chart, point.J, F_z))
    z, J, dz, drift = turn.at(q, dq)
    asked = turn.tracking_acceleration(z, dz, aim(0.0), np.array([30.0, 20.0, 10.0]), np.full(3, 3.0))
    np.testing.assert_allclose(J @ ddq + drift, asked, atol=1e-9)
    np.testing.assert_allclose(point.J @ ddq, F_z, atol=1e-9)
    # A task that has the same directions cannot be moved beside it: nothing is asked, and the rest goes on.
    same = TrackTask(PositionTask(panda, frame), task.hold(q), rest=Damp(5.0))
    np.testing.assert_allclose(same.acceleration(0.0, q, dq, chart), -5.0 * chart.dv(dq), atol=1e-9)
    summed = SumObjective([law, Damp(5.0)]).acceleration_beside(0.0, q, dq, chart, point.J, F_z)
    alone = law.acceleration_beside(0.0, q, dq, chart, point.J, F_z)
    np.testing.assert_allclose(summed, alone - 5.0 * chart.dv(dq), atol=1e-9)
    with pytest.raises(InputError, match="7 joints, this one has 6"):
        law.check(6, 1)
    with pytest.raises(InputError, match="kp on the further task must be"):
        TrackTask(turn, aim, kp=[1.0, 2.0])
