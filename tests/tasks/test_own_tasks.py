"""Tasks of one's own: the public hooks, and that whatever a subclass defines counts."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from checks import TAU, all_tasks, random_state

from eos_pin import (
    ControlLoop,
    EosController,
    Harmonic,
    HeadingTask,
    Hold,
    InputError,
    OrientationTask,
    PoseTask,
    PositionTask,
    StackedTask,
    StackedTrajectory,
    Task,
    load_robot,
)

pytestmark = pytest.mark.usefixtures("unchecked")

TIP = "panda_hand_tcp"
SCALE = np.array([2.0, -1.0, 0.5])


class Scaled(PositionTask):
    """Position with another unit along each axis, by its hooks."""

    def compute_point(self, data):
        return SCALE * super().compute_point(data)

    def compute_jacobian(self, data):
        return SCALE[:, None] * super().compute_jacobian(data)

    def compute_drift(self, data):
        return SCALE * super().compute_drift(data)


class ScaledOutside(PositionTask):
    """The same around the values of its parent."""

    def value(self, q):
        return SCALE * super().value(q)

    def linearize(self, q):
        z, J = super().linearize(q)
        return SCALE * z, SCALE[:, None] * J

    def at(self, q, dq):
        z, J, dz, drift = super().at(q, dq)
        return type(super().at(q, dq))(SCALE * z, SCALE[:, None] * J, SCALE * dz, SCALE * drift)


class FromZero(Task):
    """The same from nothing, by what hooks may read."""

    def __init__(self, robot, frame):
        self._number = robot.frame_id(frame)
        super().__init__(robot, ["x", "y", "z"], ["m"] * 3)

    def compute_point(self, data):
        return SCALE * self.frame_placement(data, self._number).translation

    def compute_jacobian(self, data):
        return SCALE[:, None] * self.frame_jacobian(data, self._number)[:3]

    def compute_drift(self, data):
        return SCALE * self.frame_acceleration(data, self._number).linear


OWN = [Scaled, ScaledOutside, FromZero]


def law_of(task, q, dq, **options):
    """Torque of the first step, its memory, and that of the formula without any short cut."""
    target = task.value(q + 0.02)
    target[:3] = 0.4, -0.1, 0.5
    controller = EosController(task, Hold(target, task.m), **options)
    state = controller.start(0.0, q, dq)
    point = task.at(q + 0.01, dq)
    F = controller.asked(0.0, q + 0.01, dq, state.chart, point)
    ddq = np.linalg.solve(np.vstack((point.J, state.chart.Vt)), F)
    return controller.torque(0.0, q + 0.01, dq, state), task.robot.inverse_dynamics(q + 0.01, dq, ddq), state


@pytest.mark.parametrize("kind", OWN)
@pytest.mark.parametrize("stacked", [False, True])
def test_own_task_counts_in_every_evaluation(panda, kind, stacked):
    own, plain = kind(panda, TIP), PositionTask(panda, TIP)
    scale = np.concatenate((np.ones(2), SCALE)) if stacked else SCALE
    if stacked:
        own, plain = (StackedTask([PositionTask(panda, "panda_link4", "xy"), part]) for part in (own, plain))
    for seed in range(3):
        q, dq = random_state(panda, seed=seed)
        expected, found = plain.at(q, dq), own.at(q, dq)
        np.testing.assert_allclose(own.value(q), scale * expected.z, atol=1e-13)
        for z, J in (own.linearize(q), found[:2]):
            np.testing.assert_allclose(z, scale * expected.z, atol=1e-13)
            np.testing.assert_allclose(J, scale[:, None] * expected.J, atol=1e-13)
        np.testing.assert_allclose(found.dz, scale * expected.dz, atol=1e-12)
        np.testing.assert_allclose(found.drift, scale * expected.drift, atol=1e-11)
        Z, jacobians = own.kinematics.linearize(q[None])
        np.testing.assert_allclose(Z[0], scale * expected.z, atol=1e-13)
        np.testing.assert_allclose(jacobians[0], scale[:, None] * expected.J, atol=1e-13)


@pytest.mark.parametrize("kind", OWN)
def test_own_task_counts_in_torque_of_controller(panda, kind):
    q, dq = random_state(panda, seed=7)
    found, expected, _ = law_of(kind(panda, TIP), q, 0.2 * dq)
    plain, _, _ = law_of(PositionTask(panda, TIP), q, 0.2 * dq)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)
    assert np.abs(found - plain).max() > 1e-2


class ScaledPart:
    """Hooks that come from a second parent."""

    def compute_point(self, data):
        return SCALE * super().compute_point(data)

    def compute_jacobian(self, data):
        return SCALE[:, None] * super().compute_jacobian(data)


def test_own_hooks_from_a_second_parent_count(panda):
    task = type("Mixed", (ScaledPart, PositionTask), {})(panda, TIP)
    q, dq = random_state(panda, seed=2)
    expected = PositionTask(panda, TIP).at(q, dq)
    for z in (task.value(q), task.linearize(q)[0], task.at(q, dq).z, task.kinematics.value(q[None])[0]):
        np.testing.assert_allclose(z, SCALE * expected.z, atol=1e-13)


class Locked(PoseTask):
    """Pose whose rotation does not count: the error in it is zero."""

    def minus(self, z1, z0):
        step = super().minus(z1, z0)
        step[3:] = 0.0
        return step


class Doubled(PositionTask):
    """Position with twice the error."""

    def minus(self, z1, z0):
        return 2.0 * (z1 - z0)

    def plus(self, z, delta):
        return z + 0.5 * delta


@pytest.mark.parametrize("kind", [Locked, Doubled])
def test_own_difference_counts_in_torque_and_searches(panda, kind):
    task, q = kind(panda, TIP), random_state(panda, seed=4)[0]
    found, expected, _ = law_of(task, q, 0.0 * q)
    plain, _, _ = law_of(kind.__mro__[1](panda, TIP), q, 0.0 * q)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)
    assert np.abs(found - plain).max() > 1e-2
    z = task.value(q + 0.1)
    np.testing.assert_allclose(task.kinematics.minus(z[None], task.value(q)[None])[0], task.minus(z, task.value(q)))


def test_built_in_tasks_keep_their_short_cuts(panda):
    for kind, vector in ((PositionTask, True), (OrientationTask, False), (PoseTask, False)):
        task = type("Renamed", (kind,), {})(panda, TIP)
        assert task.is_vector is vector
        assert task.frame_parts() == kind(panda, TIP).frame_parts() != None  # noqa: E711
        assert task.kernel is not None
        assert not task._needs_frames
    assert not HeadingTask.is_vector


@pytest.mark.parametrize(
    ("old", "new"), [("_z", "compute_point"), ("_J", "compute_jacobian"), ("_drift", "compute_drift")]
)
def test_task_with_a_hook_of_0_1_is_refused_with_the_new_name(old, new):
    with pytest.raises(InputError, match=f"Old defines {old}.*{new}"):
        type("Old", (Task,), {old: lambda self, data: data})


def test_task_of_one_joint_has_a_jacobian_of_one_column():
    robot = load_robot(
        '<robot name="one"><link name="base"/><link name="tip"><inertial><mass value="1"/><origin xyz="1 0 0"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute">'
        '<parent link="base"/><child link="tip"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" '
        'velocity="9"/>'
        "</joint></robot>"
    )

    class Turn(Task):
        def __init__(self, robot):
            super().__init__(robot, ["turn"], ["rad"])

        def compute_point(self, data):
            return np.array([pin.rpy.matrixToRpy(self.frame_placement(data, self.robot.frame_id("tip")).rotation)[2]])

        def compute_jacobian(self, data):
            return self.frame_jacobian(data, self.robot.frame_id("tip"))[5:]

        def compute_drift(self, data):
            return self.frame_acceleration(data, self.robot.frame_id("tip")).angular[2:]

    for task in (Turn(robot), StackedTask([Turn(robot)])):
        point = task.at(np.array([0.3]), np.array([2.0]))
        assert (point.z, point.J.tolist(), point.dz, point.drift) == (pytest.approx(0.3), [[1.0]], 2.0, 0.0)


class Swaying(Hold):
    """A point that moves all the same."""

    def __call__(self, t):
        z, dz, ddz = super().__call__(t)
        return type(super().__call__(t))(z + np.sin(t), dz + np.cos(t), ddz - np.sin(t))


class Late(Harmonic):
    """A harmonic curve, one second later."""

    def __call__(self, t):
        return super().__call__(t - 1.0)


def test_own_trajectory_counts_where_a_hold_or_a_harmonic_has_a_short_cut():
    assert Swaying([1.0, 2.0]).constant is None
    np.testing.assert_array_equal(Hold([1.0, 2.0]).constant, [1.0, 2.0])
    curve = np.zeros(1), np.array([[0.1]]), np.array([[0.0]]), 3.0
    for t in (0.0, 0.4, 2.2):
        stack = StackedTrajectory((Swaying([1.0]), Harmonic(*curve)))
        np.testing.assert_allclose(stack(t).z, [1.0 + np.sin(t), 0.1 * np.sin(2.0 * np.pi * t / 3.0)], atol=1e-15)
        stack = StackedTrajectory((Hold([1.0]), Late(*curve)))
        np.testing.assert_allclose(stack(t).z, [1.0, 0.1 * np.sin(2.0 * np.pi * (t - 1.0) / 3.0)], atol=1e-15)


def test_own_task_runs_in_a_control_loop(panda):
    task, q = Scaled(panda, TIP), np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7])
    loop = ControlLoop(EosController(task, Hold(task.value(q))))
    np.testing.assert_allclose(loop.step(0.0, q, 0.0 * q), panda.gravity(q), atol=1e-9)


@pytest.mark.parametrize(("name", "task"), all_tasks())
def test_channels_are_the_parts_of_a_point(name, task):
    q = random_state(task.robot, seed=1)[0]
    z, ends = task.value(q), [0]
    for part, kind in task.channels():
        assert part.start == ends[-1]
        ends.append(part.stop)
        values = z[part]
        if kind == "rotation":
            R = values.reshape(3, 3)
            np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        elif kind == "direction":
            assert np.linalg.norm(values) == pytest.approx(1.0, abs=1e-12)
        elif kind == "angle":
            turned = z.copy()
            turned[part] += TAU
            np.testing.assert_allclose(task.minus(turned, z), 0.0, atol=1e-12)
    assert ends[-1] == task.size
    assert task.form == tuple(kind for _, kind in task.channels())
