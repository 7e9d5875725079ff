"""Tasks: derivatives against finite differences, the group each task lives in, and the forms of a point."""

from __future__ import annotations

import json

import checks
import numpy as np
import pinocchio as pin
import pytest
from checks import DIFFERENCED, EXACT, STEP, all_tasks, every_task, numeric_drift, numeric_jacobian
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    ComTask,
    HeadingTask,
    InputError,
    OrientationTask,
    PoseTask,
    PositionTask,
    RelativePositionTask,
    StackedTask,
    UnknownNameError,
    load_robot,
    task_from_description,
)

every = checks.every(all_tasks())
# The kinds differ by the group of their points; one robot shows them all.
groups = checks.every(all_tasks(("panda", "ppr")))
TURNING = ["orientation", "pose", "orientation+z"]
turning = pytest.mark.parametrize("task", [every_task(checks.robot("panda"))[name] for name in TURNING], ids=TURNING)


def size_of(*arrays):
    return max(1.0, *(np.abs(a).max() for a in arrays))


# -- derivatives -----------------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_derivatives_are_those_of_finite_differences(task, data):
    q, dq = data.draw(checks.joints(task.robot)), data.draw(checks.velocities(task.robot))
    point = task.at(q, dq)
    np.testing.assert_allclose(point.J, numeric_jacobian(task, q), atol=DIFFERENCED)
    np.testing.assert_allclose(point.drift, numeric_drift(task, q, dq), atol=DIFFERENCED * size_of(point.drift))


@every
def test_passes_agree_and_their_results_stay(task):
    q, dq = checks.random_state(task.robot, 1)
    point, (z, J), value = task.at(q, dq), task.linearize(q), task.value(q)
    kept = [a.copy() for a in (*point, z, J, value)]
    np.testing.assert_allclose(point.z, value, atol=EXACT)
    np.testing.assert_allclose(z, value, atol=EXACT)
    np.testing.assert_allclose(J, point.J, atol=EXACT)
    np.testing.assert_allclose(point.dz, J @ dq, atol=EXACT * size_of(J))
    # Nothing that was returned is a view into Pinocchio's workspace.
    other, velocity = checks.random_state(task.robot, 2)
    task.at(other, velocity), task.linearize(other), task.value(other)
    for before, now in zip(kept, (*point, z, J, value), strict=True):
        np.testing.assert_array_equal(now, before)


@every
def test_sizes_names_and_units_fit(task):
    q, dq = checks.random_state(task.robot)
    z, J, dz, drift = task.at(q, dq)
    assert (z.shape, J.shape, dz.shape, drift.shape) == ((task.size,), (task.m, task.robot.n), (task.m,), (task.m,))
    assert len(task.labels) == len(set(task.labels)) == len(task.units) == task.m
    assert set(task.units) <= {"m", "rad"}


# -- what z is, by other means ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "kinova", "ur5"])
@given(data=st.data())
def test_points_are_read_off_the_placement_of_the_frame(name, data):
    robot = checks.robot(name)
    q, frame = data.draw(checks.joints(robot)), checks.tip(robot)
    pose = robot.placement(q, frame)
    tasks = every_task(robot)
    np.testing.assert_allclose(tasks["position xyz"].value(q), pose.translation, atol=EXACT)
    np.testing.assert_allclose(tasks["position xz"].value(q), pose.translation[[0, 2]], atol=EXACT)
    np.testing.assert_allclose(tasks["orientation"].value(q), pose.rotation.ravel(), atol=EXACT)
    np.testing.assert_allclose(tasks["pose"].value(q), np.r_[pose.translation, pose.rotation.ravel()], atol=EXACT)
    reference = robot.placement(q, tasks["relative xyz"].reference)
    seen = reference.rotation.T @ (pose.translation - reference.translation)
    np.testing.assert_allclose(tasks["relative xyz"].value(q), seen, atol=EXACT)


@pytest.mark.parametrize("name", ["panda", "chain"])
@given(data=st.data())
def test_centre_of_mass_is_the_mean_of_the_bodies_weighted_by_mass(name, data):
    robot = checks.robot(name)
    q = data.draw(checks.joints(robot))
    workspace = robot.model.createData()
    pin.forwardKinematics(robot.model, workspace, q)
    bodies = list(zip(robot.model.inertias, workspace.oMi, strict=True))[1:]
    mean = sum(b.mass * place.act(b.lever) for b, place in bodies) / sum(b.mass for b, _ in bodies)
    np.testing.assert_allclose(ComTask(robot, "xy").value(q), mean[:2], atol=10 * EXACT)


@given(data=st.data())
def test_relative_position_does_not_see_motion_of_both_frames(panda, data):
    task = every_task(panda)["relative xyz"]
    q = data.draw(checks.joints(panda))
    before = panda.model.frames[panda.frame_id(task.reference)].parentJoint
    moved = np.r_[data.draw(checks.joints(panda))[:before], q[before:]]
    np.testing.assert_allclose(task.value(moved), task.value(q), atol=EXACT)
    np.testing.assert_allclose(task.linearize(q)[1][:, :before], 0.0, atol=EXACT)


def test_position_relative_to_the_base_is_a_position(panda):
    q, dq = checks.random_state(panda)
    relative = RelativePositionTask(panda, "panda_hand_tcp", "universe").at(q, dq)
    for a, b in zip(relative, PositionTask(panda, "panda_hand_tcp").at(q, dq), strict=True):
        np.testing.assert_allclose(a, b, atol=EXACT)


@given(data=st.data())
def test_heading_of_the_chain_is_the_sum_of_its_angles(chain, data):
    q = data.draw(checks.joints(chain))
    task = HeadingTask(chain, "tip")
    np.testing.assert_allclose(task.minus(task.value(q), q[2:].sum(keepdims=True)), 0.0, atol=10 * EXACT)


# -- the group -------------------------------------------------------------------------------------------------------


@groups
@given(data=st.data())
def test_minus_and_plus_undo_each_other(task, data):
    z0, z1 = (task.value(data.draw(checks.joints(task.robot))) for _ in range(2))
    delta = data.draw(checks.tangents(task, 1.5))
    # Near a half turn the logarithm loses a few digits, hence the factor.
    np.testing.assert_allclose(task.minus(task.plus(z0, task.minus(z1, z0)), z1), 0.0, atol=1e3 * EXACT)
    np.testing.assert_allclose(task.minus(task.plus(z0, delta), z0), delta, atol=1e3 * EXACT)
    np.testing.assert_allclose(task.minus(z0, z0), 0.0, atol=EXACT)
    np.testing.assert_allclose(task.plus(z0, np.zeros(task.m)), z0, atol=EXACT)
    step = task.plus(z0, delta)
    there, back = task.minus(step, z0), task.minus(z0, step)
    if task.is_curved:
        # Each way is in the axes of where it begins.
        there, back = np.linalg.norm(there), -np.linalg.norm(back)
    np.testing.assert_allclose(back, -there, atol=1e3 * EXACT)


@turning
@pytest.mark.parametrize("short_of_pi", [np.pi, 3.0, 1.0, 1e-2, 1e-5, 1e-8, 1e-12, 0.0], ids="π−{}".format)
def test_differences_of_rotations_are_right_up_to_half_a_turn(task, short_of_pi):
    """From rotation 0 to exactly π, about axes in general and in special position."""
    angle = np.pi - short_of_pi
    random = np.random.default_rng(3)
    axes = [*np.eye(3), *-np.eye(3), (1, 1, 0), (0, -1, 1), (1, 1, 1), *random.normal(size=(10, 3))]
    turn = task.labels.index("rx")
    for axis in axes:
        z0 = task.value(checks.random_state(task.robot, int(random.integers(1000)))[0])
        delta = np.zeros(task.m)
        delta[turn : turn + 3] = angle * np.array(axis) / np.linalg.norm(axis)
        z1 = task.plus(z0, delta)
        back = task.minus(z1, z0)
        np.testing.assert_allclose(np.linalg.norm(back), angle, atol=1e3 * EXACT)
        np.testing.assert_allclose(task.plus(z0, back), z1, atol=1e3 * EXACT)
        # At half a turn both directions about the axis are right.
        either = min(np.abs(back - delta).max(), np.abs(back + delta).max() if short_of_pi < 1e-9 else np.inf)
        assert either < 1e3 * EXACT


@groups
@given(data=st.data())
def test_local_rate_is_the_rate_of_the_local_coordinates(task, data):
    """Also beyond half a turn, up to nearly a whole one."""
    z_bar = task.value(data.draw(checks.joints(task.robot)))
    delta, dz = data.draw(checks.tangents(task, 3.0)), data.draw(checks.tangents(task))
    z, rate = task.plus(z_bar, delta), task.local_rate(delta, dz, z_bar)
    moved = [task.minus(task.plus(z_bar, delta + s * STEP * rate), z) for s in (1.0, -1.0)]
    np.testing.assert_allclose((moved[0] - moved[1]) / (2 * STEP), dz, atol=DIFFERENCED * size_of(rate) ** 3)


@groups
@given(data=st.data())
def test_local_coordinates_end_at_half_a_turn(task, data):
    delta = data.draw(checks.tangents(task, 3.0))
    angles = [label in ("rx", "ry", "rz", "tilt1", "tilt2") for label in task.labels]
    angle = np.linalg.norm(delta[angles])
    assert task.local_margin(delta) == pytest.approx(1.0 - angle / np.pi)


def test_headings_differ_by_the_shorter_way(chain):
    task = HeadingTask(chain, "tip")
    np.testing.assert_allclose(task.minus(np.array([3.0]), np.array([-3.0])), 6.0 - 2 * np.pi)
    np.testing.assert_allclose(task.minus(np.array([100.0]), np.array([0.0])), 100.0 - 32 * np.pi)


# -- points as people write them -------------------------------------------------------------------------------------


def test_pose_is_taken_in_any_of_its_forms(panda, unchecked):
    pose, placement = PoseTask(panda, "panda_hand_tcp"), pin.SE3.Random()
    flat = np.r_[placement.translation, placement.rotation.ravel()]
    for form in (placement, placement.homogeneous, placement.homogeneous.tolist(), flat, flat.tolist(), tuple(flat)):
        np.testing.assert_allclose(pose.point(form), flat, atol=EXACT)
    turn = OrientationTask(panda, "panda_hand_tcp")
    for form in (placement, placement.rotation, placement.rotation.tolist(), flat[3:]):
        np.testing.assert_allclose(turn.point(form), flat[3:], atol=EXACT)


def test_rounded_rotations_are_straightened(panda):
    written = np.round(pin.exp3(np.array([0.3, -0.2, 1.0])), 7)
    R = OrientationTask(panda, "panda_hand_tcp").point(written).reshape(3, 3)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=EXACT)
    np.testing.assert_allclose(R, written, atol=1e-7)


@groups
def test_points_of_a_task_are_points(task):
    z = task.value(checks.random_state(task.robot)[0])
    np.testing.assert_allclose(task.point(z), z, atol=EXACT)
    np.testing.assert_allclose(task.point(z.tolist()), z, atol=EXACT)
    for wrong in (z[:-1], np.r_[z, 0.0], np.full(task.size, np.nan), z.reshape(1, -1)[:, :0]):
        with pytest.raises(InputError):
            task.point(wrong)


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("pose", "abc"),
        ("pose", None),
        ("pose", np.eye(3)),
        ("pose", np.diag([1.0, 1.0, 1.0, 2.0])),
        ("pose", np.diag([1.0, 1.0, -1.0, 1.0])),
        ("pose", np.full((4, 4), np.nan)),
        ("orientation", "abc"),
        ("orientation", [["a"] * 3] * 3),
        ("orientation", -np.eye(3)),
        ("orientation", 1.001 * np.eye(3)),
        ("orientation", np.eye(4)),
        ("position xyz", pin.SE3.Identity()),
        ("orientation+z", np.zeros(10)),
    ],
)
def test_task_point_refuses_other_values(panda, kind, value, unchecked):
    with pytest.raises(InputError, match="a point of"):
        every_task(panda)[kind].point(value)


# -- making tasks ----------------------------------------------------------------------------------------------------


@every
def test_task_comes_back_from_its_description(task):
    q, dq = checks.random_state(task.robot)
    use_compiled = task_from_description(task.robot, json.loads(json.dumps(task.describe())))
    assert repr(use_compiled) == repr(task)
    for a, b in zip(use_compiled.at(q, dq), task.at(q, dq), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    "description",
    [
        {},
        {"kind": "dance"},
        {"kind": ["pose"]},
        {"kind": "pose"},
        {"kind": "com", "axes": 3},
        {"kind": "pose", "frame": "panda_hand_tcp", "speed": 1.0},
        {"kind": "stacked"},
        {"kind": "stacked", "tasks": 5},
        {"kind": "stacked", "tasks": []},
    ],
)
def test_foreign_description_is_refused(panda, description, unchecked):
    with pytest.raises(InputError):
        task_from_description(panda, description)


@pytest.mark.parametrize("kind", [PositionTask, OrientationTask, PoseTask, HeadingTask])
def test_unknown_frame_is_named_with_near_ones(panda, kind):
    for make in (
        lambda: kind(panda, "panda_hand_tpc"),
        lambda: task_from_description(panda, {"kind": kind.kind, "frame": "tcp"}),
    ):
        with pytest.raises(UnknownNameError, match="panda_hand_tcp"):
            make()


@pytest.mark.parametrize("axes", ["", "yx", "xx", "w", "xyzz", "x y"])
def test_axes_are_some_of_xyz_in_order(panda, axes):
    for make in (lambda: ComTask(panda, axes), lambda: PositionTask(panda, "panda_hand_tcp", axes)):
        with pytest.raises(InputError, match="axes must be"):
            make()


@pytest.mark.parametrize("axes", ["x", "y", "z", "xy", "xz", "yz", "xyz"])
def test_subsets_of_axes_pick_their_rows(panda, axes):
    q, dq = checks.random_state(panda)
    rows = ["xyz".index(axis) for axis in axes]
    part, whole = PositionTask(panda, "panda_hand_tcp", axes), PositionTask(panda, "panda_hand_tcp")
    assert part.labels == tuple(axes)
    for a, b in zip(part.at(q, dq), whole.at(q, dq), strict=True):
        np.testing.assert_allclose(a, b[rows], atol=EXACT)


def test_task_has_no_more_coordinates_than_the_robot_has_joints(ppr):
    with pytest.raises(InputError, match=r"PoseTask.*has 6 coordinates, but 'ppr' only 3 joints"):
        PoseTask(ppr, "tip")
    position = PositionTask(ppr, "tip", "xy")
    with pytest.raises(InputError, match="has 4 coordinates"):
        StackedTask([position, ComTask(ppr, "xy")])


def test_stack_has_parts_of_one_robot(panda, ur5):
    with pytest.raises(InputError, match="at least one"):
        StackedTask([])
    with pytest.raises(InputError, match="one Robot object"):
        StackedTask([ComTask(panda, "x"), ComTask(ur5, "y")])


def test_heading_needs_a_planar_robot(panda):
    with pytest.raises(InputError, match="OrientationTask"):
        HeadingTask(panda, "panda_hand_tcp")


def test_stack_is_its_parts_one_after_the_other(panda):
    parts = [OrientationTask(panda, "panda_hand_tcp"), PositionTask(panda, "panda_link4", "z")]
    stack = StackedTask(parts)
    q, dq = checks.random_state(panda)
    for whole, *pieces in zip(stack.at(q, dq), *(part.at(q, dq) for part in parts), strict=True):
        np.testing.assert_allclose(whole, np.concatenate(pieces), atol=EXACT)
    assert stack.labels == ("rx", "ry", "rz", "z")
    twice = StackedTask([PositionTask(panda, "panda_link4"), PositionTask(panda, "panda_hand_tcp")])
    assert twice.labels == ("x1", "y1", "z1", "x2", "y2", "z2")


@pytest.mark.parametrize(
    "make",
    [
        lambda robot: PositionTask(robot, "tip", "x"),
        lambda robot: RelativePositionTask(robot, "tip", "base", "x"),
        lambda robot: ComTask(robot, "x"),
        lambda robot: HeadingTask(robot, "tip"),
    ],
    ids=["position", "relative position", "centre of mass", "heading"],
)
def test_robot_of_one_joint_has_a_jacobian_of_one_column(make):
    # Pinocchio gives a vector where there is one column.
    inertial = '<inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    robot = load_robot(
        f'<robot name="one"><link name="base"/><link name="arm">{inertial}</link><link name="tip"/>'
        '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>'
        '<joint name="f" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.4 0 0"/></joint></robot>'
    )
    task, q, step = make(robot), np.array([0.4]), 1e-6
    _, J = task.linearize(q)
    slope = task.minus(task.value(q + step), task.value(q - step)) / (2.0 * step)
    assert J.shape == task.at(q, q).J.shape == (1, 1)
    np.testing.assert_allclose(J[:, 0], slope, atol=1e-8)
