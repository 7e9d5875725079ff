"""The workspace for many joints: every number that is asked of it is that of Pinocchio's own."""

from __future__ import annotations

import checks
import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT

from eos_pin import (
    ComTask,
    HeadingTask,
    OrientationTask,
    PoseTask,
    PositionTask,
    RelativePositionTask,
    Robot,
)
from eos_pin.robot import _data as workspace

JOINTS = 60


@pytest.fixture(scope="module")
def tree():
    """A robot with branches, and with joints of all kinds that `Robot` takes, in random places."""
    random = np.random.default_rng(0)
    model = pin.Model()
    for i in range(JOINTS):
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        kinds = [
            pin.JointModelRX(),
            pin.JointModelPZ(),
            pin.JointModelRevoluteUnaligned(axis),
            pin.JointModelPrismaticUnaligned(axis),
        ]
        # The last joint of a branch has no children; a branch has twenty joints, the next one leaves it halfway.
        parent = i if i % 20 else max(0, i - 10)
        placement = pin.SE3(pin.exp3(random.normal(size=3)), random.uniform(-0.2, 0.2, 3))
        joint = model.addJoint(parent, kinds[i % 4], placement, f"joint_{i + 1}")
        body = pin.Inertia.FromBox(random.uniform(0.2, 2.0), *random.uniform(0.05, 0.3, 3))
        model.appendBodyToJoint(joint, body, pin.SE3(np.eye(3), random.uniform(-0.1, 0.1, 3)))
        model.addFrame(pin.Frame(f"link_{i + 1}", joint, 0, placement, pin.FrameType.OP_FRAME))
    model.armature = random.uniform(0.0, 0.1, JOINTS)
    model.lowerPositionLimit, model.upperPositionLimit = np.full(JOINTS, -np.inf), np.full(JOINTS, np.inf)
    return Robot(model)


ASKED = {
    "mass": lambda robot, q, dq, x: robot.mass(q),
    "bias": lambda robot, q, dq, x: robot.bias(q, dq),
    "gravity": lambda robot, q, dq, x: robot.gravity(q),
    "inverse dynamics": lambda robot, q, dq, x: robot.inverse_dynamics(q, dq, x),
    "forward dynamics": lambda robot, q, dq, x: robot.forward_dynamics(q, dq, x),
    "kinetic energy": lambda robot, q, dq, x: robot.kinetic_energy(q, dq),
    "potential energy": lambda robot, q, dq, x: robot.potential_energy(q),
    "slope of the energy": lambda robot, q, dq, x: robot.energy_slope(q, dq),
    "placement": lambda robot, q, dq, x: robot.placement(q, "link_40").homogeneous,
}


@pytest.mark.parametrize("name", ASKED)
def test_workspace_serves_the_dynamics(tree, name):
    """From a workspace that is new, and from one that was used before."""
    random = np.random.default_rng(1)
    full = Robot(tree.model)
    full.__dict__["_data"] = pin.Data(full.model)
    tree.__dict__["_data"] = workspace.workspace(tree.model)
    for _ in range(3):
        q, dq, x = random.uniform(-2.0, 2.0, (3, JOINTS))
        np.testing.assert_allclose(ASKED[name](tree, q, dq, x), ASKED[name](full, q, dq, x), rtol=EXACT)


@pytest.mark.parametrize(
    "make",
    [
        lambda robot: PositionTask(robot, "link_20"),
        lambda robot: RelativePositionTask(robot, "link_60", "link_35"),
        lambda robot: OrientationTask(robot, "link_40"),
        lambda robot: PoseTask(robot, "link_60"),
        lambda robot: ComTask(robot),
    ],
    ids=["position", "relative", "orientation", "pose", "com"],
)
def test_workspace_serves_tasks(tree, make, monkeypatch):
    task = make(tree)
    monkeypatch.setattr(workspace, "FULL", JOINTS)
    full, random = make(tree), np.random.default_rng(2)
    for _ in range(3):
        q, dq = random.uniform(-2.0, 2.0, (2, JOINTS))
        np.testing.assert_array_equal(task.value(q), full.value(q))
        np.testing.assert_array_equal(task.linearize(q)[1], full.linearize(q)[1])
        for found, expected in zip(task.at(q, dq), full.at(q, dq), strict=True):
            np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(task.linearize(q)[1], checks.numeric_jacobian(task, q), atol=checks.DIFFERENCED)


def test_workspace_of_a_thousand_joints_agrees_with_closed_form():
    """Against the closed form of a planar chain; Pinocchio's own workspace would take 32 GB."""
    robot = checks.long_chain(1000)
    n, link = robot.n, 2.0 / robot.n
    task = PositionTask(robot, "tip", "xy")
    q, dq, ddq = np.random.default_rng(3).normal(size=(3, n)) / np.sqrt(n)
    angle, turn = np.cumsum(q), np.cumsum(dq)
    along, across = (
        link * np.column_stack(pair) for pair in ((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle)))
    )
    point = task.at(q, dq)
    np.testing.assert_allclose(point.z, along.sum(axis=0), atol=n * EXACT)
    np.testing.assert_allclose(point.J, np.cumsum(across[::-1], axis=0)[::-1].T, atol=n * EXACT)
    np.testing.assert_allclose(point.drift, -(turn**2) @ along, atol=n * EXACT * turn.max() ** 2)
    assert HeadingTask(robot, "tip").value(q) == pytest.approx(np.arctan2(*along[-1, ::-1]), abs=n * EXACT)
    middles = np.cumsum(along, axis=0) - 0.5 * along
    assert robot.potential_energy(q) == pytest.approx(9.81 * 2.0 / n * middles[:, 1].sum(), rel=n * EXACT)
    tau = robot.inverse_dynamics(q, dq, ddq)
    np.testing.assert_allclose(robot.forward_dynamics(q, dq, tau), ddq, atol=1e-6 * np.abs(ddq).max())
    np.testing.assert_allclose(robot.mass(q) @ ddq + robot.bias(q, dq), tau, atol=n * EXACT * np.abs(tau).max())
