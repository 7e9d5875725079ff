"""Kinematics of many states at once, compiled and plain, against Pinocchio and against each other."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT, every_task

from eos_pin import EosError, InputError, PoseTask, PositionTask, Robot
from eos_pin._kernels.dispatch import kernels
from eos_pin._kernels.flat import flat_model
from eos_pin._kernels.plain import PlainChain

ROBOTS = ("panda", "kinova", "ur5", "ppr", "chain")


@pytest.fixture(params=ROBOTS)
def any_robot(request):
    return request.getfixturevalue(request.param)


def states(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(-3.0, 3.0, (count, robot.n))


def branched():
    """Two arms of one revolute, one prismatic and one slanted joint each, on a turning base."""
    model = pin.Model()
    random = np.random.default_rng(3)

    def add(parent, joint, name):
        i = model.addJoint(parent, joint, pin.SE3.Random(), name)
        model.appendBodyToJoint(i, pin.Inertia.Random(), pin.SE3.Identity())
        model.addFrame(pin.Frame(name + "_frame", i, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
        return i

    pin.seed(3)
    base = add(0, pin.JointModelRY(), "base")
    for side in "lr":
        slanted = random.normal(size=3)
        slanted /= np.linalg.norm(slanted)
        i = add(base, pin.JointModelPX(), side + "1")
        i = add(i, pin.JointModelRevoluteUnaligned(slanted), side + "2")
        i = add(i, pin.JointModelPrismaticUnaligned(slanted[::-1].copy()), side + "3")
    model.lowerPositionLimit[:] = -2.0
    model.upperPositionLimit[:] = 2.0
    return Robot(model, "branched")


def test_kinematics_equal_those_of_the_task(any_robot):
    for task in every_task(any_robot).values():
        Q = states(any_robot, 20)
        Z, J = task.kinematics.linearize(Q)
        for q, z, jacobian in zip(Q, Z, J, strict=True):
            expected, expected_jacobian = task.linearize(q)
            np.testing.assert_allclose(z, expected, atol=EXACT)
            np.testing.assert_allclose(jacobian, expected_jacobian, atol=EXACT)
        np.testing.assert_array_equal(task.kinematics.value(Q), Z)
        steps = task.kinematics.minus(Z[1:], Z[:-1])
        np.testing.assert_allclose(steps, [task.minus(a, b) for a, b in zip(Z[1:], Z[:-1], strict=True)], atol=EXACT)


def test_kinematics_of_branches_and_of_slanted_and_sliding_joints_equal_pinocchio():
    robot = branched()
    assert flat_model(robot.model).prismatic.tolist() == [0, 1, 0, 1, 1, 0, 1]
    for frame in ("l3_frame", "r3_frame", "base_frame"):
        task = PositionTask(robot, frame)
        assert task.kinematics.compiled == bool(kernels)
        q = states(robot, 1)
        z, J = task.kinematics.linearize(q)
        np.testing.assert_allclose(z[0], robot.placement(q[0], frame).translation, atol=EXACT)
        data = robot.model.createData()
        i = robot.frame_id(frame)
        expected = pin.computeFrameJacobian(robot.model, data, q[0], i, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
        np.testing.assert_allclose(J[0], expected, atol=EXACT)


def test_difference_of_orientations_is_exact_near_zero_and_near_pi(panda):
    task = every_task(panda)["orientation"]
    random = np.random.default_rng(1)
    R = pin.exp3(random.normal(size=3))
    for angle in (0.0, 1e-12, 1e-7, 1e-3, 3.0, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12):
        for axis in (*np.eye(3), *random.normal(size=(5, 3))):
            step = angle * axis / np.linalg.norm(axis)
            z1 = (pin.exp3(step) @ R).ravel()
            found = task.kinematics.minus(z1[None], R.ravel()[None])[0]
            # The rotation's own rounding is all that may be lost.
            np.testing.assert_allclose(pin.exp3(found) @ R, z1.reshape(3, 3), atol=1e-14)
            np.testing.assert_allclose(found, step, atol=1e-7 if angle > 3.1 else 1e-14)


def test_projection_agrees_with_the_plain_search(any_robot):
    for name, task in every_task(any_robot).items():
        if "com" in name:
            continue
        Z = task.kinematics.value(states(any_robot, 30))
        starts = states(any_robot, 30, seed=1)
        lower, upper = np.full((2, any_robot.n), [[-3.0], [3.0]])
        found = task.kinematics.project(starts, Z, lower=lower, upper=upper)
        q, _, steps = PlainChain(task, any_robot.n).search(starts, Z, lower, upper, 1e-10, 60, False)
        assert found.found.any()
        # A search that wanders takes many steps, and rounding is then enough to lead it elsewhere.
        short = found.found & (steps < 15)
        np.testing.assert_allclose(found.q[short], q[short], atol=1e-9)
        assert ((found.q >= lower) & (found.q <= upper)).all()
        assert (found.found == (found.residual <= 1e-10)).all()


def test_projection_of_a_near_state_is_the_nearest(panda):
    """The way to the task manifold is orthogonal to it."""
    task = PositionTask(panda, "panda_hand_tcp")
    q = np.array([0.1, -0.4, 0.2, -2.0, 0.1, 1.6, 0.8])
    near = q + 1e-4 * np.random.default_rng(0).normal(size=(10, 7))
    found = task.kinematics.project(near, task.value(q))
    for start, end in zip(near, found.q, strict=True):
        J = task.linearize(end)[1]
        across = np.linalg.lstsq(J.T, start - end, rcond=None)[0] @ J - (start - end)
        assert np.linalg.norm(across) <= 1e-3 * np.linalg.norm(start - end)


def test_search_goes_on_from_other_states_until_one_leads_there(panda):
    task = PoseTask(panda, "panda_hand_tcp")
    q = np.array([0.1, -0.4, 0.2, -2.0, 0.1, 1.6, 0.8])
    z = task.value(q)
    bounds = panda.lower, panda.upper
    drawn = []

    def others(count):
        drawn.append(count)
        return np.array([q] if len(drawn) == 2 else [panda.lower])

    # Both ends of the limits lead nowhere.
    found, residual = task.kinematics.search(panda.upper, z, bounds, others)
    assert residual <= 1e-10
    np.testing.assert_allclose(found, q, atol=1e-9)
    assert drawn == [4, 8]
    strided = [np.repeat(x, 2)[::2] for x in (q, z, *bounds)]
    found, residual = task.kinematics.search(strided[0], strided[1], (strided[2], strided[3]), others)
    assert len(drawn) == 2
    np.testing.assert_array_equal(found, q)
    found, residual = task.kinematics.search(q, z + 5.0, bounds, lambda count: np.empty((0, 7)))
    assert residual > 1.0


def test_projection_refuses_wrong_numbers_of_points(panda):
    task = PoseTask(panda, "panda_hand_tcp")
    with pytest.raises(InputError, match="one task point"):
        task.kinematics.project(np.zeros((3, 7)), np.zeros((2, 12)))
    with pytest.raises(InputError, match="bounds must be 7"):
        task.kinematics.project(np.zeros((3, 7)), np.zeros(12), lower=np.zeros(3))


def test_search_from_numbers_that_are_not_finite_finds_nothing(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    found = task.kinematics.project(np.full((1, 7), np.nan), np.zeros(3))
    assert not found.found.any()
    found = task.kinematics.project(np.zeros((1, 7)), np.full(3, np.nan))
    assert not found.found.any()


@pytest.mark.parametrize("wrong", [np.zeros(7), np.zeros((2, 6)), np.zeros((1, 2, 7))])
def test_kinematics_refuse_wrong_shapes(panda, wrong):
    with pytest.raises(InputError, match="states"):
        PositionTask(panda, "panda_hand_tcp").kinematics.value(wrong)


def test_links_are_where_pinocchio_has_them(panda):
    kinematics = PositionTask(panda, "panda_hand_tcp").kinematics
    names = ["panda_link0", "panda_link4", "panda_hand"]
    Q = states(panda, 3)
    poses = kinematics.links(Q, [panda.frame_id(name) for name in names])
    for q, row in zip(Q, poses, strict=True):
        for name, pose in zip(names, row, strict=True):
            np.testing.assert_allclose(pose, PoseTask(panda, name).value(q), atol=EXACT)


class Shifted(PositionTask):
    """A task whose point is not that of its frame."""

    def compute_point(self, data):
        return super().compute_point(data) + 0.1


class Wrong(Shifted):
    """The same, by an author who states its frames nevertheless."""

    def frame_parts(self):
        return PositionTask.frame_parts(self)


def test_kinematics_that_differ_from_the_task_are_an_error(panda):
    if kernels:
        with pytest.raises(EosError, match="frame_parts"):
            _ = Wrong(panda, "panda_hand_tcp").kinematics
    task = Shifted(panda, "panda_hand_tcp")
    assert not task.kinematics.compiled
    q = states(panda, 1)
    np.testing.assert_array_equal(task.kinematics.value(q)[0], task.value(q[0]))


def test_task_with_kinematics_is_pickled(panda):
    task = PoseTask(panda, "panda_hand_tcp")
    Q = states(panda, 2)
    Z = task.kinematics.value(Q)
    again = pickle.loads(pickle.dumps(task))
    np.testing.assert_array_equal(again.kinematics.value(Q), Z)
