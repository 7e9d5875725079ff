"""Tolerances: what bands measure, what is tracked, plans within bands, and combinations that are refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from checks import REST

from eos_pin import (
    AxisTask,
    Chart,
    Damp,
    EosController,
    FollowPlan,
    Harmonic,
    Hold,
    InputError,
    JointLimits,
    KeepTolerance,
    KinematicLoop,
    LimitedEosController,
    OrientationTask,
    PlanError,
    PointAxisTask,
    PoseTask,
    PositionTask,
    Posture,
    StackedTask,
    TaskForce,
    ToleranceTask,
    Tool,
    Track,
    load_robot,
    plan,
    simulate,
    simulate_kinematic,
    simulate_sampled,
    task_from_description,
)
from eos_pin._kernels.dispatch import kernels
from eos_pin.control._smallest_change import SmallestChange
from eos_pin.control.tolerance import Bands
from eos_pin.trajectories.through import waypoint_path


@pytest.fixture(scope="module")
def torch():
    """A UR5 with a bent torch, so that no joint turns it about its own axis."""
    placement = pin.SE3(pin.exp3(np.array([0.0, 0.6, 0.0])), np.array([0.08, 0.0, 0.15]))
    return load_robot("ur5", chain_to="torch", tool=Tool("tool0", placement, "torch"))


def flat(pose):
    return np.concatenate((pose.translation, pose.rotation.ravel()))


def test_bands_of_a_pose_measure_tilts_and_turns_that_were_made(ur5):
    random = np.random.default_rng(0)
    task = ToleranceTask(PoseTask(ur5, "tool0"), {"ry": 0.4, "cone": 0.3, "z": 0.02})
    assert task.bands == ("z", "cone", "ry")
    for tilt, turn, height in ((0.1, 0.3, 0.01), (0.29, -0.39, -0.02), (1.2, 3.1, 0.0), (0.0, math.pi, 0.1)):
        target = pin.SE3.Random()
        about = np.insert(random.normal(size=2), 1, 0.0)
        about /= np.linalg.norm(about)
        placed = target.copy()
        # About axes of the frame: first the turn about y, then the tilt of y.
        placed.rotation = target.rotation @ pin.exp3(tilt * about) @ pin.exp3(np.array([0.0, turn, 0.0]))
        placed.translation = target.translation + np.array([0.5, -0.4, height])
        used = task.used(flat(placed)[None], flat(target)[None])[0]
        np.testing.assert_allclose(
            np.linalg.norm(used, axis=1), [abs(height) / 0.02, tilt / 0.3, abs(turn) / 0.4], atol=1e-9
        )


def test_cone_of_a_direction_measures_the_angle(ur5):
    random = np.random.default_rng(1)
    task = ToleranceTask(PointAxisTask(ur5, "tool0", "x"), {"cone": 0.2})
    assert task.m == 3
    Z, targets = random.normal(size=(2, 20, 6))
    Z[:, 3:] /= np.linalg.norm(Z[:, 3:], axis=1)[:, None]
    targets[:, 3:] /= np.linalg.norm(targets[:, 3:], axis=1)[:, None]
    used = np.linalg.norm(task.used(Z, targets), axis=2)[:, 0]
    np.testing.assert_allclose(0.2 * used, np.arccos((Z[:, 3:] * targets[:, 3:]).sum(axis=1)), atol=1e-9)


def test_tolerance_task_tracks_the_rest_along_a_path_of_poses(ur5):
    """Velocities of the path are those of what is tracked, against differences."""
    random = np.random.default_rng(2)
    poses = [pin.SE3(pin.exp3(0.4 * random.normal(size=3)), 0.3 * random.normal(size=3)) for _ in range(5)]
    for tolerance in ({"rz": 0.2}, {"rx": 0.3, "y": 0.01}, {"x": 0.1}, {"cone": 0.1, "rz": 1.0}):
        task, t, h = ToleranceTask(PoseTask(ur5, "tool0"), tolerance), 1.37, 1e-5
        path = waypoint_path(task, poses, [0.0, 1.0, 2.0, 3.0, 4.0])
        z, dz, ddz = path(t)
        ahead, behind = path(t + h), path(t - h)
        np.testing.assert_allclose((task.minus(ahead.z, z) - task.minus(behind.z, z)) / (2 * h), dz, atol=1e-6)
        np.testing.assert_allclose((ahead.dz - behind.dz) / (2 * h), ddz, atol=1e-6)
        again = task_from_description(ur5, task.describe())
        assert repr(again) == repr(task)


def wavy(count=40):
    """Poses on a closed curve of a curved surface, the z axis along the normal and x as near the world's as can be."""
    poses = []
    for s in 2.0 * np.pi * np.arange(count + 1) / count:
        z = np.array([0.25 * math.cos(s), 0.2 * math.sin(2.0 * s), -1.0])
        z /= np.linalg.norm(z)
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x /= np.linalg.norm(x)
        place = np.array([0.45 + 0.15 * math.cos(s), 0.1 + 0.15 * math.sin(s), 0.2])
        poses.append(pin.SE3(np.column_stack((x, np.cross(z, x), z)), place))
    return poses


def angles(task, q, poses):
    """Angle between the axes z, and the turn about them, at each posture, by Pinocchio."""
    for joints, pose in zip(q, poses, strict=True):
        E = pose.rotation.T @ task.robot.placement(joints, "torch").rotation
        yield math.acos(min(1.0, E[2, 2])), math.atan2(E[1, 0] - E[0, 1], E[0, 0] + E[1, 1])


@pytest.mark.parametrize("tolerance", [{"rz": 0.3}, {"rz": 0.3, "cone": 0.2}])
def test_plan_uses_its_tolerance_and_keeps_it(torch, tolerance):
    whole, poses = PoseTask(torch, "torch"), wavy()
    task = ToleranceTask(whole, tolerance)
    tight, found = plan(whole, poses, closed=True), plan(task, poses, closed=True)
    assert found.info["joint_motion"] < 0.95 * tight.info["joint_motion"]
    tilts, turns = np.array(list(angles(task, found.at_waypoints(), poses))).T
    assert np.abs(turns).max() <= tolerance["rz"]
    assert tilts.max() <= tolerance.get("cone", 1e-6)
    # And uses it.
    assert 0.9 < found.info["tolerance_used"]["rz"] <= 1.0
    law = FollowPlan(found, torch)
    start = found(found.start)
    run = simulate(torch, EosController(task, law.path, law), start.q, dq=start.dq, duration=0.2)
    assert run.status == "finished"
    assert np.abs(run.error).max() < 1e-6
    np.testing.assert_allclose(run.q[-1], found(run.t[-1]).q, atol=1e-6)


def test_plan_exists_with_a_tolerance_where_there_is_none_without(torch):
    whole, poses = PoseTask(torch, "torch"), wavy()
    limits = torch.lower.copy(), torch.upper.copy()
    turns = plan(whole, poses, closed=True).q[:, 5]
    # The last joint has not the room that it needs for a fixed roll.
    limits[0][5], limits[1][5] = turns.mean() - 0.3 * np.ptp(turns), turns.mean() + 0.3 * np.ptp(turns)
    with pytest.raises(PlanError):
        plan(whole, poses, closed=True, limits=limits, effort=1)
    found = plan(ToleranceTask(whole, {"rz": 0.5}), poses, closed=True, limits=limits, effort=1)
    assert (found.q[:, 5] >= limits[0][5]).all()
    assert (found.q[:, 5] <= limits[1][5]).all()
    assert found.info["tolerance_used"]["rz"] <= 1.0


@pytest.mark.parametrize(
    ("kind", "tolerance", "reason"),
    [
        (PoseTask, {}, "got none"),
        (PoseTask, {"roll": 0.1}, "takes tolerances of x, y, z, rx, ry, rz, cone; got roll"),
        (PoseTask, {"cone": 0.1}, "choose the task point-axis"),
        (PoseTask, {"rx": 0.1, "rz": 0.1}, "one of rx, ry and rz"),
        (PoseTask, {"rz": 4.0}, "at most 3.142 rad"),
        (PointAxisTask, {"cone": 1.6}, "at most 1.571 rad"),
        (PointAxisTask, {"rz": 0.1}, "takes tolerances of x, y, z, cone; got rz"),
        (OrientationTask, {"rz": 0.1, "cone": 0.1}, "nothing of"),
        (PositionTask, {"x": -0.1}, "above 0, got -0.1"),
        (AxisTask, {"cone": 0.1}, "takes tolerances of nothing"),
    ],
)
def test_tolerance_task_refuses_tolerances_it_cannot_keep(ur5, kind, tolerance, reason):
    with pytest.raises(InputError, match=reason):
        ToleranceTask(kind(ur5, "tool0"), tolerance)


def largest_part(task, run, path):
    """Largest part of a band that a run uses."""
    points = np.array([path(t).z for t in run.t])
    return np.linalg.norm(task.used(task.whole.kinematics.value(run.q), points), axis=2).max()


def test_control_keeps_a_tolerance_that_its_law_would_leave(torch):
    whole, poses = PoseTask(torch, "torch"), wavy()
    task = ToleranceTask(whole, {"rz": 0.15, "cone": 0.1})
    start = plan(whole, poses, closed=True)
    path = waypoint_path(task, poses, np.linspace(0.0, 3.0, len(poses)), closed=True)
    q, used = start.q[0], {}
    chart = Chart.from_base(task, q)
    dq = chart.acceleration(task.linearize(q)[1], path(0.0).dz, np.zeros(chart.r))
    for name, controller in {
        "held": EosController(task, path),
        "law": EosController(task, path, KeepTolerance(Track(), task, path)),
        "limits": LimitedEosController(task, path, control_period=2e-3),
    }.items():
        run = simulate_sampled(torch, controller, q, dq=dq, duration=0.9, control_period=2e-3)
        assert np.abs(run.error).max() < 1e-4
        used[name] = largest_part(task, run, path)
    run = simulate_kinematic(KinematicLoop(task, path, control_period=4e-3), q, duration=0.9)
    used["kinematic"] = largest_part(task, run, path)
    assert used["held"] > 1.5
    for name in ("law", "limits", "kinematic"):
        assert 0.9 < used[name] <= 1.0, name


@pytest.fixture(scope="module")
def arm():
    return load_robot("panda", chain_to="panda_hand_tcp")


POSTURE = np.array([0.0, -0.4, 0.0, -2.1, 0.0, 1.75, 0.8])


@pytest.mark.parametrize("period", [0.01, 0.03])
def test_every_command_is_within_the_bands(arm, period):
    whole = PoseTask(arm, "panda_hand_tcp")
    task = ToleranceTask(whole, {"x": 0.01, "ry": 0.1, "cone": 0.08})
    path = Hold(task.value(POSTURE), task.m)
    sides = np.random.default_rng(1).uniform(-0.1, 0.1, (2, task.robot.n - task.m))
    law = Track(Harmonic(np.zeros(sides.shape[1]), sides[:1], 0.0 * sides[1:], 1.5))
    loop = KinematicLoop(task, path, law, control_period=period)
    run = simulate_kinematic(loop, POSTURE, duration=0.75)
    assert 0.99 < largest_part(task, run, path) <= 1.0
    assert np.abs(run.error).max() < 1e-9
    # Limits of joints come first.
    loop = KinematicLoop(task, path, control_period=period, limits=JointLimits.without_torques(arm, velocity=0.05))
    loop.step(0.0, POSTURE)
    loop.reference = Hold(whole.plus(path.z, np.full(6, 0.2)), task.m)
    last = POSTURE
    for k in range(1, 20):
        q, dq = loop.step(k * period, last)
        np.testing.assert_allclose(q - last, period * dq, atol=1e-12)
        assert np.abs(dq).max() <= 0.05
        last = q
    # It comes back as fast as joints may, and says how far it is beyond.
    assert loop.limited
    assert np.abs(dq).max() > 0.03
    used = np.linalg.norm(task.used(task.value(q)[None], loop.reference.z[None])[0], axis=1)
    assert loop.tolerance_used == pytest.approx(dict(zip(task.bands, used, strict=True)))
    assert max(used) > 1.0


def test_bands_are_approached_as_slowly_as_joints_can_brake(arm):
    # The self-motion leads out of wide bands, at a speed that slow joints could not lose near the edge.
    task = ToleranceTask(PoseTask(arm, "panda_hand_tcp"), {"rz": 0.4, "cone": 0.3})
    path, law = Hold(task.value(POSTURE), task.m), Posture(POSTURE + np.array([1.6, 0.6, 1.6, 0.6, 1.6, 1.2, 2.4]))
    slow = JointLimits.without_torques(arm, acceleration=1.0)
    run = simulate_kinematic(KinematicLoop(task, path, law, control_period=0.01, limits=slow), POSTURE, duration=1.5)
    used = run.summary()["tolerance_used"]
    assert 0.99 < max(used.values()) <= 1.0
    within = JointLimits.from_robot(arm, acceleration=1.0)
    controller = LimitedEosController(task, path, law, limits=within, control_period=4e-3)
    run = simulate_sampled(arm, controller, POSTURE, duration=1.0, control_period=4e-3)
    assert 0.8 < max(run.info["tolerance_used"].values()) <= 1.0
    # A target that jumps takes the band along, and the run says so.
    far = Hold(task.whole.plus(path.z, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5])), task.m)
    run = simulate_kinematic(KinematicLoop(task, far, control_period=0.01, limits=slow), POSTURE, duration=0.2)
    assert run.info["tolerance_used"]["rz"] == pytest.approx(1.25, abs=0.01)
    assert run.status == "degraded"
    assert "bands of the task were passed (rz 1.25 times) for 0." in run.message


def test_bands_are_kept_where_joints_are_at_their_limits(arm):
    whole, random, limits = PointAxisTask(arm, "panda_hand_tcp"), np.random.default_rng(0), JointLimits.from_robot(arm)
    task, active, left = ToleranceTask(whole, {"cone": 0.2}), 0, 0
    bands = Bands(task)
    for _ in range(30):
        q, dq = POSTURE + random.uniform(-0.3, 0.3, 7), 0.1 * random.normal(size=7)
        # Near the edge of the cone, and two joints near their limits.
        tilt = np.insert(random.normal(size=2), 0, np.zeros(3))
        path = Hold(whole.plus(task.value(q), 0.196 * tilt / np.linalg.norm(tilt)), task.m)
        upper, near = limits.upper.copy(), random.choice(7, 2, replace=False)
        upper[near] = q[near] + 0.004
        within, law = replace(limits, upper=upper), Track(0.5 * random.normal(size=4))
        controller, free = LimitedEosController(task, path, law, limits=within), EosController(task, path, law)
        rows, most = bands(path, 0.0, q, dq)
        least, largest = within.accelerations(q, dq, 1e-3)
        asked, found = (
            arm.forward_dynamics(q, dq, c.torque(0.0, q, dq, c.start(0.0, q, dq))) for c in (free, controller)
        )
        active += bool(((asked < least) | (asked > largest)).any())
        left += bool((rows @ asked > most).any())
        # They are kept in the middle of the period, not at its start.
        assert (rows @ found <= most + 0.2).all()
        assert ((found >= least - 0.2) & (found <= largest + 0.2)).all()
    assert active > 8
    assert left > 8


def test_axis_comes_back_into_its_cone_after_a_push(arm):
    whole = PointAxisTask(arm, "panda_hand_tcp")
    task = ToleranceTask(whole, {"cone": 0.2})
    path = Hold(task.value(POSTURE), task.m)
    controller = LimitedEosController(task, path, Damp(5.0), control_period=2e-3)
    push = TaskForce(PoseTask(arm, "panda_hand_tcp"), lambda t: 10.0 * (t < 0.15) * np.array([0, 0, 0, 0.3, 1.0, 0]))
    run = simulate_sampled(arm, controller, POSTURE, duration=0.8, task_force=push)
    used = np.linalg.norm(task.used(whole.kinematics.value(run.q), path.z[None]), axis=2)[:, 0]
    assert used.max() > 1.05
    assert used[run.t > 0.5].max() <= 1.0


def test_smallest_change_within_bands_is_that_of_a_general_solver():
    from scipy.optimize import minimize

    from eos_pin.control.tolerance import _smallest

    random = np.random.default_rng(5)
    for _ in range(10):
        rows, most = random.normal(size=(2, 3)), random.normal(size=2)
        found = _smallest(rows, most)
        kept = {"type": "ineq", "fun": lambda x, rows=rows, most=most: most - rows @ x}
        expected = minimize(lambda x: 0.5 * x @ x, np.zeros(3), jac=lambda x: x, constraints=[kept]).x
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_smallest_change_is_within_bounds_that_leave_a_single_point():
    # Daqp gave up now and then where they are the same, so it is given a hair.
    change, J = SmallestChange(2, 4), np.eye(2, 4)
    solve, least = change.program, np.array([1.0, -2.0, 0.0, -1.0])

    def program(J, M, lower, upper):
        assert (upper - lower).min() > 1e-9
        return solve(J, M, lower, upper)

    change.program = program
    most = least + np.array([0.0, 0.0, 1e-13, 2.0])
    found = change.within(J, least, most)
    assert ((least <= found) & (found <= most)).all()
    assert found[3] == pytest.approx(0.0, abs=1e-6)


def test_stack_keeps_the_bands_of_its_parts(panda, unchecked):
    hand = OrientationTask(panda, "panda_hand_tcp")
    task = StackedTask([ToleranceTask(hand, {"rz": 0.2}), PositionTask(panda, "panda_hand_tcp")])
    assert (task.m, task.bands) == (5, ("rz",))
    two = StackedTask([ToleranceTask(hand, {"rz": 0.2}), ToleranceTask(hand, {"rz": 0.1})])
    assert two.bands == ("rz1", "rz2")
    z, s = np.tile(task.value(REST), (9, 1)), np.linspace(0.0, np.pi, 9)
    z[:, :9] = [(z[0, :9].reshape(3, 3) @ pin.exp3(np.array([0.0, 0.0, 0.4 * np.sin(x)]))).ravel() for x in s]
    z[:, -2] += 0.1 * np.sin(s)
    found = plan(task, z)
    run = simulate_kinematic(KinematicLoop(task, found.path, control_period=0.01), found(0.0).q, duration=found.end)
    assert np.abs(run.error[-1]).max() < 1e-9
    for joints, t in (*zip(found.q, found.times, strict=True), *zip(run.q, run.t, strict=True)):
        R, target = panda.placement(joints, "panda_hand_tcp").rotation, found.path(t).z[:9].reshape(3, 3)
        assert np.linalg.norm(pin.log3(target.T @ R)) <= 0.2
    assert task.kinematics.compiled == (kernels is not None)
    assert task_from_description(panda, task.describe()).bands == task.bands
