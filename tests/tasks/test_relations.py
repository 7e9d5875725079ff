"""Relative poses, distances and combinations of joints: references, and where they end."""

from __future__ import annotations

import checks
import numpy as np
import pytest
from checks import EXACT

from eos_pin import (
    DistanceTask,
    EosController,
    Hold,
    InputError,
    JointTask,
    Payload,
    PositionTask,
    RelativePoseTask,
    SingularError,
    StackedTask,
    StackedTrajectory,
    circle,
    load_robot,
    simulate,
)


@pytest.fixture(scope="module")
def baxter():
    return load_robot("baxter")


def test_relative_pose_of_two_hands_has_derivatives_of_finite_differences(baxter):
    task = RelativePoseTask(baxter, "left_gripper", "right_gripper")
    for seed in range(5):
        q, dq = checks.random_state(baxter, seed)
        left, right = (baxter.placement(q, name) for name in ("left_gripper", "right_gripper"))
        seen, point = right.actInv(left), task.at(q, dq)
        np.testing.assert_allclose(point.z, np.r_[seen.translation, seen.rotation.ravel()], atol=10 * EXACT)
        np.testing.assert_allclose(point.J, checks.numeric_jacobian(task, q), atol=1e-8)
        np.testing.assert_allclose(point.drift, checks.numeric_drift(task, q, dq), atol=1e-7)


def test_distance_zero_is_refused_without_nan(panda):
    q, dq = checks.random_state(panda)
    centre = panda.placement(q, checks.tip(panda)).translation
    task = DistanceTask(panda, checks.tip(panda), centre)
    np.testing.assert_allclose(task.value(q), 0.0, atol=EXACT)
    for call in (lambda: task.linearize(q), lambda: task.at(q, dq)):
        with pytest.raises(SingularError, match="at the centre"):
            call()


@pytest.mark.parametrize("rows", [[], [{"elbow": 1.0}], [{"panda_joint1": np.nan}], [{"panda_joint1": 1.0}] * 2, [{}]])
def test_joint_task_refuses_bad_combinations(panda, rows):
    with pytest.raises(InputError):
        JointTask(panda, rows)


def test_joint_task_is_the_combination(panda):
    q, dq = checks.random_state(panda)
    task = JointTask(panda, [{"panda_joint2": 1.0, "panda_joint4": -0.5}, {"panda_joint1": 1.0}])
    point = task.at(q, dq)
    np.testing.assert_allclose(point.z, [q[1] - 0.5 * q[3], q[0]], atol=EXACT)
    np.testing.assert_allclose(point.dz, [dq[1] - 0.5 * dq[3], dq[0]], atol=EXACT)
    assert task.labels == ("panda_joint2 -0.5 panda_joint4", "panda_joint1")


@pytest.mark.slow
def test_two_arms_carry_a_load_along_a_circle_and_keep_their_relative_pose():
    loose = {"head_pan": None} | {f"{s}_gripper_{f}_finger_joint": None for s in "lr" for f in "lr"}
    box = Payload(1.5, "left_gripper", (0.0, 0.0, 0.2))
    robot = load_robot("baxter", lock=loose, payload=box)
    bent = {"s0": -0.4, "s1": -0.5, "e0": -0.6, "e1": 1.5, "w0": 0.3, "w1": 0.9, "w2": 0.0}
    # The right arm mirrors the left one: what turns about the length of an arm changes sign.
    q = robot.posture(
        {f"left_{joint}": value for joint, value in bent.items()}
        | {f"right_{joint}": -value if joint in ("s0", "e0", "w0", "w2") else value for joint, value in bent.items()}
    )
    grasp = RelativePoseTask(robot, "right_gripper", "left_gripper")
    task = StackedTask([PositionTask(robot, "left_gripper"), grasp])
    z = task.value(q)
    around = circle(z[:3], 0.08, period=4.0, plane="yz")
    path = StackedTrajectory((around, Hold(z[3:], 6)))
    run = simulate(robot, EosController(task, path), q, duration=4.0, rtol=1e-10, atol=1e-11, record_rate=10.0)
    # The arms do go round: both hands are at the far side of the circle after half of it.
    np.testing.assert_allclose(run.z[20, :3], around(2.0).z, atol=1e-3)
    np.testing.assert_allclose([grasp.minus(row[3:], z[3:]) for row in run.z], 0.0, atol=1e-9)
