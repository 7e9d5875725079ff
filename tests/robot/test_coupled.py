"""Joints that follow others: the projected equations of motion of the whole tree."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Chart,
    CoupledRobot,
    EosController,
    InputError,
    KinematicLoop,
    MujocoPlant,
    PositionTask,
    Robot,
    RobotError,
    circle,
    load_robot,
    simulate,
)
from eos_pin.viewer.scene import Scene

INERTIA = '<mass value="1"/><inertia ixx="0.1" iyy="0.12" izz="0.13" ixy="0" ixz="0" iyz="0"/>'


def link(k: int) -> str:
    return f'<link name="l{k}"><inertial><origin xyz="0.1 0.02 {0.03 * k}"/>{INERTIA}</inertial></link>'


def joint(name: str, k: int, axis: str, more: str = "", kind: str = "revolute", limit: str = "") -> str:
    limit = limit or 'lower="-2" upper="2" velocity="1" effort="50"'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0.3 0.1 0.2" '
        f'rpy="0.3 0.1 0"/><axis xyz="{axis}"/><limit {limit}/>{more}</joint>'
    )


def text(*joints: str) -> str:
    return f'<robot name="coupled">{"".join(map(link, range(len(joints) + 1)))}{"".join(joints)}</robot>'


def mimic(leader: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


#: A revolute joint and a slider follow joint c; the slider by way of f.
XML = text(
    joint("a", 0, "0 0 1"),
    joint("c", 1, "0.6 0.8 0"),
    joint("f", 2, "0 1 0", mimic("c", -0.5, 0.2)),
    joint("d", 3, "1 0 0"),
    joint("p", 4, "0 0.6 0.8", mimic("f", 0.4, 0.1), kind="prismatic"),
    joint("e", 5, "0 0 1"),
)
S = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, -0.5, 0, 0], [0, 0, 1, 0], [0, -0.2, 0, 0], [0, 0, 0, 1]], dtype=float)
OFFSET = np.array([0.0, 0.0, 0.2, 0.0, 0.18, 0.0])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(XML, chain_to="l6")


@pytest.fixture(scope="module")
def tree() -> tuple[pin.Model, pin.Data]:
    """All joints, each on its own: the brute-force model."""
    model = pin.buildModelFromXML(XML)
    return model, model.createData()


@given(st.integers(0, 10**6))
def test_dynamics_are_those_of_the_whole_tree_projected(robot: Robot, tree, seed: int) -> None:
    model, data = tree
    q, dq, tau = np.random.default_rng(seed).uniform(-2.0, 2.0, (3, 4))
    full, rate = S @ q + OFFSET, S @ dq
    M, bias = S.T @ pin.crba(model, data, full) @ S, S.T @ pin.nonLinearEffects(model, data, full, rate)
    slope = S.T @ pin.computeCoriolisMatrix(model, data, full, rate).T @ rate
    pairs = [
        (robot.mass(q), M),
        (robot.bias(q, dq), bias),
        (robot.gravity(q), S.T @ pin.computeGeneralizedGravity(model, data, full)),
        (robot.forward_dynamics(q, dq, tau), np.linalg.solve(M, tau - bias)),
        (robot.inverse_dynamics(q, dq, tau), M @ tau + bias),
        (robot.energy_slope(q, dq), slope),
        (robot.kinetic_energy(q, dq), pin.computeKineticEnergy(model, data, full, rate)),
        (robot.potential_energy(q), pin.computePotentialEnergy(model, data, full)),
    ]
    for ours, theirs in pairs:
        assert np.abs(ours - theirs).max() < 1e-12 * max(1.0, np.abs(theirs).max()) * np.linalg.cond(M)
    placed = robot.placement(q, "l6")
    pin.framesForwardKinematics(model, data, full)
    assert np.abs(placed.homogeneous - data.oMf[model.getFrameId("l6")].homogeneous).max() < 1e-13


def test_tasks_and_charts_see_followers_move(robot: Robot, tree) -> None:
    model, data = tree
    task = PositionTask(robot, "l6", "xyz")
    q, dq = np.array([0.55, -1.5, 1.4, 0.8]), np.array([0.5, -0.3, 0.2, 0.7])
    world = pin.LOCAL_WORLD_ALIGNED
    J = pin.computeFrameJacobian(model, data, S @ q + OFFSET, model.getFrameId("l6"), world)[:3] @ S
    point = task.at(q, dq)
    assert np.abs(point.J - J).max() < 1e-13
    step = 1e-6
    ahead, behind = (task.at(q + sign * step * dq, dq).dz for sign in (1.0, -1.0))
    assert np.abs(point.drift - (ahead - behind) / (2 * step)).max() < 1e-7
    chart = Chart.from_base(task, q)
    at = chart.point(q, dq)
    assert np.abs(at.H @ at.H_inverse - np.eye(4)).max() < 1e-12
    z, v = task.value(q) + 0.02, np.array([0.05])
    found = chart.inverse(z, v).q
    assert np.abs(task.value(found) - z).max() < 1e-9
    # Many states at once, without the compiled kernel.
    assert not task.kinematics.compiled
    values, jacobians = task.kinematics.linearize(np.array([q, found]))
    assert np.abs(values[0] - task.value(q)).max() < 1e-13
    assert np.abs(jacobians[0] - J).max() < 1e-13


def test_eos_control_runs_on_a_chain_with_followers(robot: Robot) -> None:
    task, q = PositionTask(robot, "l6"), np.array([0.55, -1.5, 1.4, 0.8])
    run = simulate(
        robot, EosController(task, circle(task.value(q), 0.03, period=2.0, plane="xy")), q, duration=4.0, rtol=1e-10
    )
    assert run.status == "finished"
    assert np.abs(run.error[run.t > 3.0]).max() < 1e-6
    # Energy: what the torques did is what kinetic and potential energy have gained.
    states = zip(run.q, run.dq, strict=True)
    gained = np.array([robot.kinetic_energy(*state) + robot.potential_energy(state[0]) for state in states])
    assert np.abs(gained - gained[0] - (run.work - run.work[0])).max() < 1e-6


def test_limits_of_followers_are_carried_over() -> None:
    slow = 'lower="-0.5" upper="1" velocity="0.25" effort="1"'
    robot = load_robot(
        text(joint("a", 0, "0 0 1"), joint("f", 1, "0 1 0", mimic("a", -0.5, 0.2), limit=slow)), chain_to="l2"
    )
    (only,) = robot.joints
    # −0.5 ≤ −a/2 + 0.2 ≤ 1 leaves −1.6 ≤ a ≤ 1.4; half as fast is a quarter of a radian per second.
    assert (only.lower, only.upper) == pytest.approx((-1.6, 1.4))
    assert (only.velocity, only.effort) == pytest.approx((0.5, 50.0))
    assert any("follows 'a'" in note for note in robot.notes)


def test_kinematic_loop_keeps_the_limits_of_followers(robot: Robot) -> None:
    task = PositionTask(robot, "l6")
    for seed in range(3):
        random = np.random.default_rng(seed)
        far = circle(random.uniform(-1.0, 1.0, 3), radius=0.8, period=1.0)
        loop, q = KinematicLoop(task, far, control_period=0.01), random.uniform(robot.lower, robot.upper)
        for k in range(100):
            q, dq = loop.step(0.01 * k, q)
            assert np.abs(S @ q + OFFSET).max() <= 2.0
            assert np.abs(S @ dq).max() <= 1.0 + 1e-12


def test_follower_of_a_joint_that_stands_still_stands_still() -> None:
    xml = text(joint("a", 0, "0 0 1"), joint("f", 1, "0 1 0", mimic("a", -0.5, 0.2)), joint("b", 2, "0 1 0"))
    robot = load_robot(xml, chain_to="l3", lock={"a": 0.4})
    assert robot.joint_names == ("b",)
    tree = pin.buildModelFromXML(xml)
    data = tree.createData()
    pin.framesForwardKinematics(tree, data, np.array([0.4, 0.0, 0.7]))
    there = robot.placement(np.array([0.7]), "l3").homogeneous
    assert np.abs(there - data.oMf[tree.getFrameId("l3")].homogeneous).max() < 1e-12


@pytest.mark.parametrize(
    ("joints", "told"),
    [
        ([joint("a", 0, "0 0 1", mimic("x"))], "no joint of this file"),
        ([joint("a", 0, "0 0 1", mimic("b")), joint("b", 1, "0 1 0", mimic("a"))], "which follows it"),
        (
            [joint("a", 0, "0 0 1"), joint("b", 1, "0 1 0", mimic("a"), limit='lower="3" upper="4" velocity="1"')],
            "leave no room",
        ),
    ],
    ids=["unknown leader", "circle", "no room"],
)
def test_mimic_joints_that_make_no_sense_are_refused(joints: list[str], told: str) -> None:
    with pytest.raises(RobotError, match=told):
        load_robot(text(*joints), chain_to=f"l{len(joints)}")


def test_continuous_leader_is_not_where_it_was_after_a_turn_if_its_follower_is_not() -> None:
    def loaded(multiplier: float) -> Robot:
        follower = joint("f", 1, "0 1 0", mimic("a", multiplier), kind="continuous")
        return load_robot(text(joint("a", 0, "0 0 1", kind="continuous"), follower), chain_to="l2")

    assert loaded(-2.0).turns
    assert not loaded(0.5).turns


def test_model_with_followers_makes_a_coupled_robot() -> None:
    # Pinocchio's own reader knows no followers of followers.
    model = pin.buildModelFromXML(XML.replace(mimic("f", 0.4, 0.1), mimic("c", -0.2, 0.18)), mimic=True)
    with pytest.raises(RobotError, match="CoupledRobot"):
        Robot.from_pinocchio(model)
    robot = CoupledRobot.from_pinocchio(model)
    assert robot.joint_names == ("a", "c", "d", "e")
    with pytest.raises(InputError, match="follow"):
        MujocoPlant.from_robot(robot)


def test_followers_move_in_the_replay(robot: Robot, tree) -> None:
    model, data = tree
    scene, q = Scene(robot), np.array([0.55, -1.5, 1.4, 0.8])
    assert model.njoints - 1 == len(scene.poses(0.0, q)) == 6
    pin.forwardKinematics(model, data, S @ q + OFFSET)
    assert np.abs(scene.poses(0.0, q)[-1, :3] - data.oMi[6].translation).max() < 1e-12
    packed = gzip.decompress(scene.pack(np.array([0.0, 1.0]), np.array([q, 0.5 * q])))
    header = json.loads(packed[4 : 4 + int.from_bytes(packed[:4], "little")])
    assert header["bodies"] == header["joints"] == 6
