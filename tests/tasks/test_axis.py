"""Tasks of a tool's axis: the law of its angle, turns about it, opposite directions, and runs of both kinds."""

from __future__ import annotations

import math

import checks
import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT, SOLVED

from eos_pin import (
    Atlas,
    AxisTask,
    EosController,
    Hold,
    InputError,
    KinematicLoop,
    LookAtTask,
    OperationalSpaceController,
    PointAxisTask,
    Robot,
    SingularError,
    circle,
    inverse_kinematics,
    make_task,
    plan,
    simulate,
    simulate_extended,
    simulate_kinematic,
    simulate_sampled,
)
from eos_pin._kernels.dispatch import kernels
from eos_pin.trajectories.through import waypoint_path


def angle_between(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


def decayed(angle, t):
    """Solution of ε̈ + 4 ε̇ + 4 ε = 0 from rest."""
    return angle * (1.0 + 2.0 * t) * np.exp(-2.0 * t)


@pytest.mark.parametrize("angle", [0.5, 2.5])
def test_axis_angle_obeys_the_law_that_was_designed(panda, angle):
    task, (q, _) = AxisTask(panda, checks.tip(panda)), checks.random_state(panda, 4)
    goal = task.plus(task.value(q), angle * np.array([0.6, -0.8]))
    controller = EosController(task, Hold(goal, 2), kp=4.0, kd=4.0, smooth=False)
    run = simulate(panda, controller, q, duration=1.0, rtol=1e-11, atol=1e-12, record_rate=20.0)
    found = [angle_between(z, goal) for z in run.z]
    np.testing.assert_allclose(found, decayed(angle, run.t), atol=1e-9)


def test_point_axis_runs_agree_in_both_equations_of_motion(ur5):
    task = PointAxisTask(ur5, "tool0")
    q = np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2])
    goal = task.plus(task.value(q), np.array([0.05, -0.04, 0.03, 0.2, -0.1]))
    controller = EosController(task, Hold(goal, 5))
    options = {"duration": 0.3, "rtol": 1e-11, "atol": 1e-12, "record_rate": 10.0}
    joints = simulate(ur5, controller, q, **options)
    extended = simulate_extended(ur5, controller, q, atlas=Atlas(task), **options)
    np.testing.assert_allclose(extended.q, joints.q, atol=1e-9)


@pytest.mark.parametrize("kind", [AxisTask, PointAxisTask])
def test_axis_task_does_not_see_turns_about_the_axis(ur5, kind):
    task, (q, dq) = kind(ur5, "tool0", "z"), checks.random_state(ur5, 3)
    # The last joint of this robot turns the tool about its z axis, to the digits of its URDF file.
    turned = q + 1.3 * np.eye(6)[5]
    spun = dq + 2.0 * np.eye(6)[5]
    before, after = task.at(q, dq), task.at(turned, spun)
    np.testing.assert_allclose(after.z, before.z, atol=1e-10)
    np.testing.assert_allclose(after.dz, before.dz, atol=1e-10)
    np.testing.assert_allclose(after.drift, before.drift, atol=1e-10)
    np.testing.assert_allclose(before.J[:, 5], 0.0, atol=1e-10)


def test_axis_opposite_to_its_goal_turns_along_the_first_vector_of_its_basis(panda):
    task, (q, dq) = AxisTask(panda, checks.tip(panda)), checks.random_state(panda, 1)
    z = task.value(q)
    step = task.minus(-z, z)
    np.testing.assert_allclose(np.linalg.norm(step), np.pi, atol=EXACT)
    np.testing.assert_allclose(task.plus(z, step), -z, atol=10 * EXACT)
    controller = EosController(task, Hold(-z, 2))
    assert np.isfinite(controller.torque(0.0, q, dq, controller.start(0.0, q, dq))).all()


def test_axis_of_a_pole_has_an_orthonormal_basis_everywhere():
    from eos_pin.tasks import _sphere

    pole, aside = _sphere.POLE[:, 2], _sphere.POLE[:, 0]
    near = [math.sin(x) * aside - math.cos(x) * pole for x in (1e-3, 1e-6, 1e-8, 1e-12)]
    for a in (pole, -pole, *near, *np.eye(3), *-np.eye(3)):
        frame = np.vstack((_sphere.basis(a), a))
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e2 * EXACT)
        assert np.isfinite(_sphere.bending(a, np.ones(2))).all()


def test_axis_paths_need_the_same_charts_wherever_they_pass(panda):
    """Robot and path are turned together, so that the path passes the pole's opposite or not."""
    from eos_pin.tasks import _sphere

    random, opposite = np.random.default_rng(3), -_sphere.POLE[:, 2]
    q = checks.random_state(panda, 4)[0]
    for _ in range(3):
        start = AxisTask(panda, checks.tip(panda)).value(q)
        across = np.cross(start, random.normal(size=3))
        across /= np.linalg.norm(across)
        path = np.array([math.cos(x) * start + math.sin(x) * across for x in np.linspace(0.0, 1.4, 30)])
        found = []
        for off in (0.0, 1e-6, 1e-2, None):
            model = panda.model.copy()
            if off is None:
                turn = pin.exp3(random.normal(size=3))
            else:
                beside = math.cos(off) * opposite + math.sin(off) * np.cross(opposite, random.normal(size=3))
                turn = pin.Quaternion.FromTwoVectors(path[15], beside).toRotationMatrix()
            model.jointPlacements[1] = pin.SE3(turn, np.zeros(3)) * model.jointPlacements[1]
            found.append(Atlas(AxisTask(Robot(model, "turned"), checks.tip(panda))).follow(q, path @ turn.T))
        for other in found[:-1]:
            assert other.complete
            assert (len(other.charts), other.iterations) == (len(found[-1].charts), found[-1].iterations)
            np.testing.assert_allclose(other.q, found[-1].q, atol=SOLVED)


def test_axis_task_has_compiled_kinematics_also_opposite_to_the_pole(ur5):
    from eos_pin.tasks import _sphere

    task, random = PointAxisTask(ur5, "tool0", (1.0, 2.0, -0.5)), np.random.default_rng(0)
    assert task.kinematics.compiled == bool(kernels)
    near = [math.sin(x) * _sphere.POLE[:, 0] - math.cos(x) * _sphere.POLE[:, 2] for x in (1.0, 1e-3, 1e-6, 1e-12, 0.0)]
    Z0 = np.c_[np.zeros((5, 3)), near]
    Z1 = np.c_[np.zeros((5, 3)), [_sphere.direction(x, "x") for x in random.normal(size=(5, 3))]]
    expected = np.array([task.minus(z1, z0) for z1, z0 in zip(Z1, Z0, strict=True)])
    found = task.kinematics.minus(Z1, Z0)
    np.testing.assert_allclose(found[:3], expected[:3], atol=1e-9)
    # Where rounding decides how the basis is turned, lengths are right.
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(expected, axis=1), atol=EXACT * 10)


def test_direction_path_has_its_own_derivatives(ur5):
    task = PointAxisTask(ur5, "tool0")
    random = np.random.default_rng(2)
    points = np.c_[random.uniform(-0.3, 0.3, (5, 3)), random.normal([0.0, 0.0, -1.0], 0.3, (5, 3))]
    path, t, h = waypoint_path(task, points, [0.0, 1.0, 2.0, 3.0, 4.0]), 1.37, 1e-5
    z, dz, ddz = path(t)
    ahead, behind = path(t + h), path(t - h)
    np.testing.assert_allclose(np.linalg.norm(z[3:]), 1.0, atol=EXACT)
    np.testing.assert_allclose((task.minus(ahead.z, z) - task.minus(behind.z, z)) / (2 * h), dz, atol=1e-6)
    np.testing.assert_allclose((ahead.dz - behind.dz) / (2 * h), ddz, atol=1e-6)


@pytest.mark.parametrize("axis", ["w", "0 0", "a b c", (0.0, 0.0, 0.0), (1.0, 2.0)])
def test_tool_axis_is_refused_where_it_is_none(ur5, axis):
    with pytest.raises(InputError):
        AxisTask(ur5, "tool0", axis)


def test_tool_axis_is_taken_by_name_and_by_numbers(ur5):
    q, _ = checks.random_state(ur5)
    R = ur5.placement(q, "tool0").rotation
    for axis, column in (("x", R[:, 0]), ("-z", -R[:, 2]), ("0 2 0", R[:, 1]), ("0, 3, 4", R @ [0.0, 0.6, 0.8])):
        task = make_task(ur5, "point-axis", tool_axis=axis)
        np.testing.assert_allclose(task.value(q)[3:], column, atol=10 * EXACT)
        pose = ur5.placement(q, "tool0")
        np.testing.assert_allclose(task.point(pin.SE3(pose)), task.value(q), atol=10 * EXACT)


def test_look_at_turns_the_axis_to_the_point(ur5):
    q, centre = np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2]), np.array([0.9, 0.5, 0.1])
    task = LookAtTask(ur5, "tool0", centre, "x")
    controller = EosController(task, task.aim(), kp=25.0, kd=10.0)
    run = simulate(ur5, controller, q, duration=4.0, record_rate=1.0)
    end = ur5.placement(run.q[-1], "tool0")
    np.testing.assert_allclose(angle_between(end.rotation[:, 0], centre - end.translation), 0.0, atol=1e-6)


def moving_sight(robot):
    """A tool that looks at a point on a circle."""
    return LookAtTask(robot, "tool0", circle([0.9, 0.5, 0.1], 0.2, period=2.0, plane="yz"), "x")


def test_look_at_a_moving_point_has_the_derivatives_of_differences(ur5):
    task, (q, dq), h = moving_sight(ur5), checks.random_state(ur5, 3), 1e-5

    def at(t):
        return task.set_time(t).at(q + t * dq, dq)

    for t in (0.0, 0.7):
        now, before, after = at(t), at(t - h), at(t + h)
        np.testing.assert_allclose(task.minus(after.z, now.z) - task.minus(before.z, now.z), 2 * h * now.dz, atol=1e-13)
        np.testing.assert_allclose((after.dz - before.dz) / (2 * h), now.drift, atol=1e-8)
        np.testing.assert_allclose(at(t).dz - now.J @ dq, task.at(q + t * dq, 0 * dq).dz, atol=10 * EXACT)


def test_look_at_a_moving_point_obeys_the_law_in_both_equations_of_motion(ur5):
    task, q = moving_sight(ur5), np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2])
    controller = EosController(task, task.aim(), kp=4.0, kd=4.0, smooth=False)
    options = {"duration": 1.0, "rtol": 1e-11, "atol": 1e-12, "record_rate": 10.0}
    joints = simulate(ur5, controller, q, **options)
    extended = simulate_extended(ur5, controller, q, atlas=Atlas(task), **options)
    np.testing.assert_allclose(extended.q, joints.q, atol=1e-9)
    np.testing.assert_allclose(joints.residuals()["torque"], 0.0, atol=1e-9)
    # The target is at rest in the tool; the point's motion is in the rate that the error begins with.
    goal, t = task.aim().z, joints.t[:, None]
    error = np.array([task.minus(z, goal) for z in joints.z])
    rate = task.local_rate(error[0], joints.dz[0], goal)
    assert np.linalg.norm(rate) > 0.1
    np.testing.assert_allclose(error, np.exp(-2.0 * t) * (error[0] + t * (rate + 2.0 * error[0])), atol=1e-9)


def test_look_at_follows_a_moving_point_in_every_loop(ur5):
    task, period = moving_sight(ur5), 1e-3
    # At first it looks there, but does not follow.
    q = inverse_kinematics(task, task.aim().z, np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2])).q
    options = {"duration": 0.5, "record_rate": 20.0}
    eos = EosController(task, task.aim(), kp=1e4, kd=200.0)
    sampled = simulate_sampled(ur5, eos, q, control_period=period, centred=True, **options)
    loop = KinematicLoop(task, task.aim(), control_period=period, kp=1e4, kd=200.0)
    for run, bound in ((sampled, 1e-6), (simulate_kinematic(loop, q, **options), 1e-9)):
        late = run.t > 0.3
        assert np.abs(run.error[late]).max() < bound
        for t, q_t in zip(run.t[late], run.q[late], strict=True):
            tool, place = ur5.placement(q_t, "tool0"), circle([0.9, 0.5, 0.1], 0.2, period=2.0, plane="yz")(t).z
            assert angle_between(tool.rotation[:, 0], place - tool.translation) < bound


def test_look_at_a_moving_point_is_refused_by_controllers_and_plans_without_time(ur5):
    task, q = moving_sight(ur5), np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.2])
    for call in (
        lambda: OperationalSpaceController(task, task.aim()),
        lambda: plan(task, [task.value(q), task.aim().z]),
        lambda: LookAtTask(ur5, "tool0", circle([0.9, 0.5], 0.2, period=2.0)),
    ):
        with pytest.raises(InputError, match=r"moves|centre of a LookAtTask"):
            call()


def test_look_at_from_the_point_itself_is_refused(ur5):
    q, dq = checks.random_state(ur5)
    task = LookAtTask(ur5, "tool0", ur5.placement(q, "tool0").translation)
    for call in (lambda: task.value(q), lambda: task.linearize(q), lambda: task.at(q, dq)):
        with pytest.raises(SingularError, match="no direction"):
            call()
