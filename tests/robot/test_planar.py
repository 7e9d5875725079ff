"""Planar joints, models from Pinocchio and MJCF, and the joint order of messages."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT

import eos_pin as eos

BODY = (
    '<inertial><origin xyz="0.1 0.2 0.3"/><mass value="{}"/>'
    '<inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0" iyz="0"/></inertial>'
)
CART = f"""<robot name="mobile">
<link name="ground"/><link name="cart">{BODY.format(30)}</link><link name="mast">{BODY.format(4)}</link>
<link name="arm">{BODY.format(2)}</link>
<joint name="base" type="planar"><parent link="ground"/><child link="cart"/><origin xyz="1 2 0.5" rpy="0.1 0 0.4"/>
<axis xyz="AXIS"/><limit velocity="0.7" effort="90"/></joint>
<joint name="lift" type="prismatic"><parent link="cart"/><child link="mast"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" velocity="1" effort="500"/></joint>
<joint name="turn" type="continuous"><parent link="mast"/><child link="arm"/><axis xyz="0 0.6 0.8"/>
<limit velocity="2" effort="50"/></joint>
</robot>"""


def test_planar_joint_moves_along_its_plane_and_turns_about_its_axis():
    normal = np.array([0.0, 0.6, 0.8])
    robot = eos.load_robot(CART.replace("AXIS", "0 0.6 0.8"))
    assert [joint.name for joint in robot.joints] == ["base_x", "base_y", "base_heading", "lift", "turn"]
    assert [joint.kind for joint in robot.joints] == ["prismatic", "prismatic", "continuous", "prismatic", "continuous"]
    assert robot.velocity[:3].tolist() == [0.7] * 3
    assert robot.effort[:3].tolist() == [90.0] * 3
    origin = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.0, 0.4), np.array([1.0, 2.0, 0.5]))
    assert any("base_heading" in note for note in robot.notes)
    at_rest = origin.actInv(robot.placement(np.zeros(5), "cart"))
    assert np.allclose(at_rest.homogeneous, np.eye(4), atol=EXACT)
    moved = origin.actInv(robot.placement([0.3, -0.2, 0.9, 0.0, 0.0], "cart"))
    assert abs(normal @ moved.translation) < EXACT
    assert np.linalg.norm(moved.translation) == pytest.approx(np.hypot(0.3, 0.2), abs=EXACT)
    assert np.allclose(moved.rotation, pin.exp3(0.9 * normal), atol=EXACT)


def test_planar_joint_has_the_dynamics_of_pinocchios_own():
    text = CART.replace("AXIS", "0 0 1")
    robot, model = eos.load_robot(text), pin.buildModelFromXML(text)
    data, random = model.createData(), np.random.default_rng(5)
    for _ in range(10):
        q, dq, ddq = random.normal(size=(3, 5))
        c, s = np.cos(q[2]), np.sin(q[2])
        whole = np.concatenate((q[:2], [c, s], q[3:4], [np.cos(q[4]), np.sin(q[4])]))
        # Pinocchio's planar joint has its velocity in its own frame.
        turn = np.eye(5)
        turn[:2, :2] = [[c, s], [-s, c]]
        rate = np.zeros((5, 5))
        rate[:2, :2] = dq[2] * np.array([[-s, c], [-c, -s]])
        M = turn.T @ pin.crba(model, data, whole) @ turn
        tau = turn.T @ pin.rnea(model, data, whole, turn @ dq, turn @ ddq + rate @ dq)
        assert np.allclose(robot.mass(q), M, atol=1e3 * EXACT)
        assert np.allclose(robot.inverse_dynamics(q, dq, ddq), tau, atol=1e4 * EXACT)


@pytest.mark.parametrize("axis", ["", '<axis xyz="0 0 1"/>'])
def test_planar_joint_without_axis_moves_in_the_x_y_plane(axis):
    robot = eos.load_robot(CART.replace('<axis xyz="AXIS"/>', axis))
    origin, moved = (robot.placement([x, 2.0 * x, 0.0, 0.0, 0.0], "cart") for x in (0.0, 0.1))
    assert np.allclose(origin.actInv(moved).translation, [0.1, 0.2, 0.0], atol=EXACT)


def test_planar_joint_can_be_locked_and_loaded_again():
    text = CART.replace("AXIS", "0 0 1")
    assert eos.load_robot(text, lock="base").n == 2
    robot = eos.load_robot(text, lock={"base_heading": 0.5}, chain_to="arm")
    assert [joint.name for joint in robot.joints] == ["base_x", "base_y", "lift", "turn"]
    again = eos.load_robot(robot.source, **robot.options)
    assert again.placement([0.1, 0.2, 0.3, 0.4], "arm") == robot.placement([0.1, 0.2, 0.3, 0.4], "arm")


def test_floating_joint_is_refused_with_advice():
    with pytest.raises(eos.RobotError, match="Lock it, or load the chain"):
        eos.load_robot(CART.replace("planar", "floating").replace('<axis xyz="AXIS"/>', ""))


def test_mobile_manipulator_keeps_the_velocity_limits_of_its_base_on_a_path_of_5_m():
    arm = eos.load_robot("ur5")
    cart = f"""<link name="ground"/><link name="cart">{BODY.format(60)}</link>
    <joint name="base" type="planar"><parent link="ground"/><child link="cart"/><axis xyz="0 0 1"/>
    <limit velocity="0.8" effort="400"/></joint>
    <joint name="mount" type="fixed"><parent link="cart"/><child link="world"/><origin xyz="0.2 0 0.4"/></joint>
    </robot>"""
    text = eos.robot.library.find_robot("ur5").path.read_text().replace("</robot>", cart)
    robot = eos.load_robot(text, chain_to="tool0")
    assert robot.n == 3 + arm.n
    task = eos.PositionTask(robot, "tool0")
    q = eos.rest_posture(task)
    z = task.value(q)
    path = eos.minimum_jerk([z, z + np.array([5.0, 0.0, 0.0])], [0.0, 12.5])
    controller = eos.LimitedEosController(task, path, control_period=5e-3)
    result = eos.simulate_sampled(robot, controller, q, duration=13.0, control_period=5e-3)
    assert result.status == "finished"
    assert np.abs(result.error[-1]).max() < 1e-6
    assert (np.abs(result.dq) / robot.velocity).max() < 1.0 + 1e-3


def test_model_of_pinocchio_becomes_a_robot_with_one_coordinate_a_joint():
    text = CART.replace("AXIS", "0 0 1")
    robot, other = eos.Robot.from_pinocchio(pin.buildModelFromXML(text)), eos.load_robot(text)
    assert [joint.name for joint in robot.joints] == [joint.name for joint in other.joints]
    assert [joint.kind for joint in robot.joints] == [joint.kind for joint in other.joints]
    for limit in ("lower", "upper", "velocity", "effort"):
        assert np.array_equal(getattr(robot, limit)[3:], getattr(other, limit)[3:])
    q, dq = np.random.default_rng(1).normal(size=(2, 5))
    assert np.allclose(robot.mass(q), other.mass(q), atol=1e2 * EXACT)
    assert np.allclose(robot.bias(q, dq), other.bias(q, dq), atol=1e3 * EXACT)
    assert np.allclose(robot.placement(q, "arm").homogeneous, other.placement(q, "arm").homogeneous, atol=EXACT)
    floating = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    with pytest.raises(eos.RobotError, match=r"'root_joint'.*buildReducedModel"):
        eos.Robot.from_pinocchio(floating)


def test_joint_map_takes_joints_from_messages_and_back(panda):
    names = ["finger", *(joint.name for joint in reversed(panda.joints)), "wheel"]
    order, q = eos.JointMap(panda, names), np.arange(7.0)
    message = order.to_message(q, others=9.0)
    assert message.tolist() == [9.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0, 9.0]
    message[0] = np.nan
    assert order.to_robot(message).tolist() == q.tolist()
    assert order.to_message(2.0 * q, message)[-1] == 9.0
    with pytest.raises(eos.UnknownNameError, match=panda.joints[6].name):
        eos.JointMap(panda, names[2:])
    with pytest.raises(eos.InputError, match="wheel more than once"):
        eos.JointMap(panda, [*names, "wheel"])
    for bad in (q, [np.nan] * 9):
        with pytest.raises(eos.InputError):
            order.to_robot(bad)
    with pytest.raises(eos.InputError, match="9 values"):
        order.to_message(q, others=[1.0, 2.0])


@pytest.mark.usefixtures("unchecked")
def test_wrong_types_are_refused(panda):
    with pytest.raises(eos.InputError, match=r"pinocchio\.Model is needed"):
        eos.Robot.from_pinocchio("panda")
    with pytest.raises(eos.InputError, match="must be a Robot"):
        eos.JointMap("panda", ["a"])
    with pytest.raises(eos.InputError, match="must be numbers"):
        eos.JointMap(panda, [joint.name for joint in panda.joints]).to_robot(["a"] * 7)
    with pytest.raises(eos.InputError, match="list of joint names"):
        eos.JointMap(panda, "panda_joint1")


MJCF = """<mujoco model="lamp"><compiler angle="radian"/><option gravity="0 0 -9.81"/>
<worldbody><body name="post" pos="0.1 0 0.2" euler="0.3 0 0">
<inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.15"/>
<joint name="swing" type="hinge" axis="0 0 1" range="-2 2" armature="0.01" actuatorfrcrange="-20 20"/>
<body name="beam" pos="0.4 0 0"><inertial pos="0.2 0 0" mass="1" diaginertia="0.02 0.1 0.1"/>
<joint name="reach" type="slide" axis="1 0 0" range="0 0.5"/>
<body name="head" pos="0.3 0.1 0"><inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.01 0.01 0.02"/>
<joint name="nod" type="hinge" axis="0 0.6 0.8" limited="false"/></body></body></body></worldbody></mujoco>"""


def test_robot_from_mjcf_has_the_masses_and_frames_of_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "lamp.xml").write_text(MJCF)
    robot = eos.load_robot(tmp_path / "lamp.xml", chain_to="head")
    assert [joint.kind for joint in robot.joints] == ["revolute", "prismatic", "continuous"]
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    for q in np.random.default_rng(2).uniform(-1.0, 1.0, (5, 3)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        M = np.zeros((3, 3))
        for column, unit in zip(M, np.eye(3), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
        assert np.allclose(robot.mass(q), M, atol=1e-9)
        head = robot.placement(q, "head")
        assert np.allclose(head.translation, data.body("head").xpos, atol=1e-9)
        assert np.allclose(head.rotation.ravel(), data.body("head").xmat, atol=1e-9)
    again = eos.load_robot(robot.source, **robot.options)
    assert np.allclose(again.mass(np.ones(3)), robot.mass(np.ones(3)), atol=EXACT)
    assert eos.load_robot(tmp_path / "lamp.xml", lock={"nod": 0.2}).n == 2


def test_mjcf_and_urdf_of_one_robot_agree(tmp_path):
    """The lamp again, as a URDF; armatures are none there."""
    pytest.importorskip("mujoco")

    def link(name, mass, place, *inertia):
        terms = " ".join(f'{key}="{x}"' for key, x in zip(("ixx", "iyy", "izz"), inertia, strict=True))
        inertial = f'<inertial><origin xyz="{place}"/><mass value="{mass}"/><inertia {terms} ixy="0" ixz="0" iyz="0"/>'
        return f'<link name="{name}">{inertial}</inertial></link>'

    def joint(name, kind, parent, child, origin, axis, limit):
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin {origin}/>'
            f'<axis xyz="{axis}"/><limit {limit} velocity="9" effort="20"/></joint>'
        )

    text = (
        '<robot name="lamp"><link name="world_link"/>'
        + link("post", 2, "0 0 0.1", 0.1, 0.2, 0.15)
        + link("beam", 1, "0.2 0 0", 0.02, 0.1, 0.1)
        + link("head", 0.5, "0 0 -0.1", 0.01, 0.01, 0.02)
        + joint(
            "swing", "revolute", "world_link", "post", 'xyz="0.1 0 0.2" rpy="0.3 0 0"', "0 0 1", 'lower="-2" upper="2"'
        )
        + joint("reach", "prismatic", "post", "beam", 'xyz="0.4 0 0"', "1 0 0", 'lower="0" upper="0.5"')
        + joint("nod", "continuous", "beam", "head", 'xyz="0.3 0.1 0"', "0 0.6 0.8", "")
        + "</robot>"
    )
    (tmp_path / "lamp.xml").write_text(MJCF.replace(' armature="0.01"', ""))
    robot, other = eos.load_robot(tmp_path / "lamp.xml", chain_to="head"), eos.load_robot(text, chain_to="head")
    assert robot.joint_names == other.joint_names
    for limit in ("lower", "upper"):
        np.testing.assert_array_equal(getattr(robot, limit), getattr(other, limit))
    for q, dq in np.random.default_rng(3).uniform(-1.0, 1.0, (5, 2, 3)):
        np.testing.assert_allclose(robot.mass(q), other.mass(q), atol=1e3 * EXACT)
        np.testing.assert_allclose(robot.bias(q, dq), other.bias(q, dq), atol=1e3 * EXACT)
        ends = (each.placement(q, "head").homogeneous for each in (robot, other))
        np.testing.assert_allclose(*ends, atol=1e2 * EXACT)
