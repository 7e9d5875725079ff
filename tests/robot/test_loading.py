"""Loading: names, files, locking against the full model, meshes, and what the world throws at a loader."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pickle
import re
import subprocess
import sys
import types

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eos_pin.errors import EosError, InputError, RobotError, UnknownNameError
from eos_pin.robot.library import available_robots, example_robots
from eos_pin.robot.loading import (
    Payload,
    Tool,
    default_frame,
    leaf_frames,
    load_robot,
)
from eos_pin.robot.model import Robot
from eos_pin.robot.reading.checking import DEEPEST_TREE

EXACT = 1e-11
ROBOTS = {robot.name: robot for robot in available_robots()}


# -- names -------------------------------------------------------------------------------------------------------


def test_names_are_unique_and_their_files_exist():
    names = [robot.name for robot in available_robots()]
    assert len(names) == len(set(names)) >= 71
    assert {"ppr", "planar_chain_10", "panda", "xarm7", "talos_left_arm", "kinova", "ur5_robot"} <= set(names)
    assert all(robot.path.is_file() and robot.description for robot in available_robots())
    assert example_robots().is_dir()


#: Robots of example-robot-data that have no arm to control, and the reason that is given.
REFUSED = {"ur3": "has no name", "quadrotor_base": "no moving joints", "iris_simple": "no moving joints"}


@pytest.mark.parametrize("name", [name for name in ROBOTS if name not in REFUSED])
def test_named_robots_load(name, capfd):
    robot = load_robot(name, chain_to="auto")
    assert robot.source == name
    assert default_frame(robot) == robot.options["chain_to"]
    assert load_robot(robot.source, **robot.options).n == robot.n
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("name", "reason"), REFUSED.items())
def test_robots_that_do_not_load_give_the_reason(name, reason, capfd):
    with pytest.raises(RobotError, match=reason):
        load_robot(name)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("given", "name", "n"),
    [
        ("panda", "panda", 9),
        ("example-robot-data:xarm7", "xarm7", 7),
        ("ur5", "ur5_robot", 6),
        ("example-robot-data:ur5", "ur5_robot", 6),
        ("anymal_b_simple/anymal", "anymal_b_simple/anymal", 12),
        ("kinova", "kinova", 6),
        ("ppr", "ppr", 3),
    ],
)
def test_robots_load_by_name(given, name, n):
    robot = load_robot(given)
    assert (robot.source, robot.n) == (name, n)
    assert re.fullmatch("[0-9a-f]{64}", robot.urdf_sha256)


def test_wrong_name_lists_near_ones():
    with pytest.raises(UnknownNameError, match="Did you mean panda"):
        load_robot("pandas")
    with pytest.raises(UnknownNameError, match="Did you mean"):
        load_robot("example-robot-data:xarm")
    with pytest.raises(UnknownNameError):
        load_robot("example-robot-data:ppr")
    with pytest.raises(RobotError, match="anymal_b_simple/anymal, anymal_c_simple/anymal"):
        load_robot("anymal")


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("panda", "panda_hand_tcp"),
        ("ur5", "tool0"),
        ("xarm7", "link_eef"),
        ("kinova", "j2s6s200_end_effector"),
        ("talos_left_arm", "wrist_left_ft_tool_link"),
        ("tiago", "hand_tool_link"),
        ("pr2", "l_gripper_tool_frame"),
        ("finger_edu", "finger_tip_link"),
        ("ppr", "tip"),
        ("planar_chain_10", "tip"),
    ],
)
def test_default_frame_is_the_one_a_person_means(name, frame):
    assert load_robot(name, chain_to="auto").options["chain_to"] == frame


def test_leaf_frames_end_every_branch():
    assert set(leaf_frames(load_robot("ppr"))) == {"tip", "rail_tip"}
    assert set(leaf_frames(load_robot("panda"))) == {"panda_leftfinger", "panda_rightfinger", "panda_hand_tcp"}
    assert default_frame(load_robot("panda")) == "panda_hand_tcp"


# -- continuous joints -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["kinova", "ppr", "planar_chain_10"])
def test_continuous_joints_become_revolute_with_the_same_dynamics(name):
    robot = load_robot(name)
    original = pin.buildModelFromUrdf(str(ROBOTS[name].path))
    data = original.createData()
    assert original.nq > original.nv == robot.n == robot.model.nq
    random = np.random.default_rng(0)
    for _ in range(50):
        q, dq = random.uniform(-4, 4, robot.n), random.normal(size=robot.n)
        full = pin.integrate(original, pin.neutral(original), q)
        bias = pin.nonLinearEffects(original, data, full, dq)
        M = pin.crba(original, data, full)
        assert robot.mass(q) == pytest.approx(np.triu(M) + np.triu(M, 1).T, abs=EXACT)
        assert robot.bias(q, dq) == pytest.approx(bias, abs=EXACT * max(1.0, np.abs(bias).max()))
    for i, joint in enumerate(robot.joints):
        assert joint.velocity == original.velocityLimit[i] or np.isinf(joint.velocity)
        if joint.kind == "continuous":
            assert (joint.lower, joint.upper) == (-np.inf, np.inf)
    assert all("continuous, so that" in note for note in robot.notes if "fixed" not in note)


# -- locking -----------------------------------------------------------------------------------------------------


def reduced(name, locked):
    """The same robot by the other road: Pinocchio's own reduction of the full model and of its geometry."""
    full = load_robot(name)
    q = np.zeros(full.n)
    for joint, value in locked.items():
        q[full.model.idx_qs[full.model.getJointId(joint)]] = value
    ids = [full.model.getJointId(joint) for joint in locked]
    model, geometries = pin.buildReducedModel(full.model, [full.visual, full.collision], ids, q)
    return full, q, model, geometries


@pytest.mark.parametrize(
    ("name", "locked"),
    [
        ("panda", {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.01}),
        ("panda", {"panda_joint2": 0.7, "panda_joint5": -1.2, "panda_finger_joint1": 0.0}),
        ("kinova", {"j2s6s200_joint_1": 7.0, "j2s6s200_joint_4": -1.0}),
        ("planar_chain_10", {"y2": 1.5, "y5": 0.3, "y10": -2.0}),
    ],
)
def test_locking_keeps_all_that_the_full_model_has(name, locked):
    robot = load_robot(name, lock=locked)
    full, position, model, (visual, collision) = reduced(name, locked)
    assert list(robot.model.names) == list(model.names)
    kept = [full.model.getJointId(joint) - 1 for joint in list(robot.model.names)[1:]]
    for limit in ("lower", "upper", "velocity", "effort"):
        assert np.array_equal(getattr(robot, limit), getattr(full, limit)[kept])
    for values in ("armature", "damping", "upperDryFrictionLimit", "rotorInertia", "rotorGearRatio"):
        assert np.array_equal(getattr(robot.model, values), getattr(full.model, values)[kept]), values
    assert set(robot.frames) == set(full.frames)
    assert robot.model.gravity == full.model.gravity

    pairs = ((robot.visual, visual), (robot.collision, collision))
    for ours, theirs in pairs:
        assert [shape.name for shape in ours.geometryObjects] == [shape.name for shape in theirs.geometryObjects]
    places = [[pin.GeometryData(ours), pin.GeometryData(theirs)] for ours, theirs in pairs]
    own, data = robot.model.createData(), model.createData()
    random = np.random.default_rng(1)
    for _ in range(10):
        q, dq, ddq = random.uniform(-2, 2, robot.n), random.normal(size=robot.n), random.normal(size=robot.n)
        position[kept] = q
        tau = robot.inverse_dynamics(q, dq, ddq)
        assert tau == pytest.approx(pin.rnea(model, data, q, dq, ddq), abs=EXACT * max(1, np.abs(tau).max()))
        M = full.mass(position)[np.ix_(kept, kept)]
        assert robot.mass(q) == pytest.approx(M, abs=EXACT * np.abs(M).max())
        for frame in full.frames:
            assert robot.placement(q, frame).isApprox(full.placement(position, frame), EXACT)
        for (ours, theirs), poses in zip(pairs, places, strict=True):
            pin.updateGeometryPlacements(robot.model, own, ours, poses[0], q)
            pin.updateGeometryPlacements(model, data, theirs, poses[1], q)
            for a, b in zip(poses[0].oMg, poses[1].oMg, strict=True):
                assert a.isApprox(b, EXACT)


def test_joint_whose_limits_leave_no_room_is_locked(urdf):
    text = ROBOTS["panda"].path.read_text()
    start = text.index("lower=", text.index('name="panda_joint3"'))
    end = text.index("/>", start)
    stuck = load_robot(urdf(text[:start] + 'lower="0.3" upper="0.3"' + text[end:]), chain_to="panda_hand")
    locked = load_robot("panda", chain_to="panda_hand", lock={"panda_joint3": 0.3})
    assert stuck.notes == ("locked, because its limits are both 0.3: panda_joint3",)
    q = np.linspace(-0.5, 0.5, 6)
    assert np.array_equal(stuck.mass(q), locked.mass(q))


def test_locked_joints_stand_at_zero_or_at_the_limit_nearest_to_it():
    # panda_joint4 moves from -3.07 to -0.07.
    full = load_robot("panda")
    robot = load_robot("panda", lock="panda_joint4")
    q = np.zeros(full.n)
    i = list(full.model.names).index("panda_joint4") - 1
    q[i] = full.upper[i]
    assert q[i] < 0.0
    kept = [j for j in range(full.n) if j != i]
    assert robot.placement(q[kept], "panda_hand").isApprox(full.placement(q, "panda_hand"), EXACT)
    assert load_robot("panda", lock=["panda_joint4"]).options == robot.options == {"lock": ["panda_joint4"]}


def test_chain_keeps_its_joints_and_carries_the_rest():
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    assert [joint.name for joint in robot.joints] == [f"panda_joint{i}" for i in range(1, 8)]
    full = load_robot("panda")
    total = sum(body.mass for body in full.model.inertias)
    assert sum(body.mass for body in robot.model.inertias) == pytest.approx(total, abs=EXACT)
    assert load_robot("panda", chain_to="panda_joint3").n == 3
    assert load_robot("panda", chain_to="panda_hand", lock={"panda_joint1": 0.5}).n == 6
    assert load_robot("talos_full_v2", chain_to="arm_left_7_link").n == 9
    with pytest.raises(UnknownNameError, match="panda_hand"):
        load_robot("panda", chain_to="panda_hnd")
    with pytest.raises(RobotError, match="no moving joints"):
        load_robot("panda", chain_to="panda_link0")


def test_mimic_joints_are_noted_only_where_they_are_left_out():
    assert any("mimic" in note for note in load_robot("panda").notes)
    assert load_robot("panda", chain_to="panda_hand").notes == ()
    assert load_robot("panda", chain_to="panda_rightfinger").joint_names[-1] == "panda_finger_joint1"
    assert load_robot("panda", chain_to="panda_rightfinger", lock=["panda_finger_joint2"]).n == 7


@pytest.mark.parametrize(
    ("lock", "error", "message"),
    [
        (["panda_joint9"], UnknownNameError, "Did you mean panda_joint"),
        (["panda_hand_joint"], UnknownNameError, "joint that moves"),
        ({"panda_joint1": 9.0}, InputError, r"moves from -2\.8973 to 2\.8973"),
        ({"panda_joint1": np.nan}, InputError, "finite"),
    ],
)
def test_locks_that_do_not_fit_are_refused(lock, error, message):
    with pytest.raises(error, match=message):
        load_robot("panda", lock=lock)


# -- tools and payloads ------------------------------------------------------------------------------------------


def test_tool_and_payload_obey_the_theorem_of_steiner():
    pose = pin.SE3(pin.exp3(np.array([0.1, -0.4, 0.2])), np.array([0.02, 0.0, 0.15]))
    inertia = np.diag([0.01, 0.02, 0.025])
    payload = Payload(1.5, "probe", com=[0.0, 0.03, 0.1], inertia=inertia)
    robot = load_robot("panda", chain_to="probe", tool=Tool("panda_hand", pose, name="probe"), payload=payload)
    bare = load_robot("panda", chain_to="panda_hand")
    q = np.linspace(-0.5, 0.6, 7)
    assert robot.n == 7
    assert robot.placement(q, "probe").isApprox(bare.placement(q, "panda_hand") * pose, EXACT)
    J = pin.computeFrameJacobian(robot.model, robot.model.createData(), q, robot.frame_id("probe"), pin.LOCAL)
    # A rigid body of mass m and inertia I about c: kinetic energy with the velocity of c.
    of_com = J[:3] - pin.skew(np.asarray(payload.com)) @ J[3:]
    added = 1.5 * of_com.T @ of_com + J[3:].T @ inertia @ J[3:]
    assert robot.mass(q) - bare.mass(q) == pytest.approx(added, abs=EXACT)


def test_tool_is_taken_in_any_form():
    position = load_robot("ppr", tool=Tool("tip", [0.1, 0.2, 0.0]))
    matrix = load_robot("ppr", tool=Tool("tip", pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.0])).homogeneous))
    q = np.array([0.3, 0.4, 0.5])
    assert position.placement(q, "tool").isApprox(matrix.placement(q, "tool"))
    with pytest.raises(InputError, match="placement"):
        Tool("tip", 2 * np.eye(4))
    with pytest.raises(InputError, match="placement"):
        Tool("tip", [1.0, 2.0])
    with pytest.raises(InputError, match="already has a frame"):
        load_robot("ppr", tool=Tool("tip", name="rail_tip"))
    with pytest.raises(UnknownNameError, match="Did you mean"):
        load_robot("ppr", tool=Tool("tipp"))


def test_payloads_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="mass"):
        Payload(-1.0, "tip")
    with pytest.raises(InputError, match="principal moment"):
        Payload(1.0, "tip", inertia=np.diag([1.0, 1.0, 3.0]))
    with pytest.raises(InputError, match="symmetric"):
        Payload(1.0, "tip", inertia=[[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(InputError, match="Payload"):
        load_robot("ppr", payload={"weight": 2.0})


def test_options_are_json_and_find_the_robot_again():
    robot = load_robot(
        "panda",
        chain_to="panda_hand",
        lock={"panda_joint1": np.float64(0.5)},
        tool=Tool("panda_hand", (0, 0, 0.1)),
        payload=Payload(1, "tool"),
        gravity=np.array([0.0, 0.0, -1.6]),
    )
    again = load_robot(robot.source, **json.loads(json.dumps(robot.options)))
    q = np.full(6, 0.3)
    assert np.array_equal(again.mass(q), robot.mass(q))
    assert np.array_equal(again.gravity(q), robot.gravity(q))
    assert again.options == robot.options
    assert again.placement(q, "tool") == robot.placement(q, "tool")


# -- files -------------------------------------------------------------------------------------------------------

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'


def joint(name="j", kind="revolute", parent="a", child="b", inner=LIMIT):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inner}</joint>'


def arm(inside="", *, links=f'<link name="a"/><link name="b">{INERTIAL}</link>', name='name="arm"'):
    return f"<robot {name}>\n{links}\n{inside or joint()}\n</robot>"


@pytest.fixture
def urdf(tmp_path):
    """Write a URDF, give its path."""

    def write(text, name="robot.urdf"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_load_robot_takes_paths_of_any_kind(urdf, monkeypatch, tmp_path):
    path = urdf(arm(), "möbel/räuber 機.urdf")
    monkeypatch.chdir(tmp_path)
    for source in (path, str(path), os.path.relpath(path, tmp_path)):
        robot = load_robot(source)
        assert robot.source == str(path)
        assert robot.n == 1
    assert load_robot(robot.source, **robot.options).urdf_sha256 == robot.urdf_sha256


def test_names_may_be_in_any_script(urdf):
    text = arm(
        joint("Gelenk-ä", parent="основа", child="手"),
        links=f'<link name="основа"/><link name="手">{INERTIAL}</link>',
        name='name="Πρώτος"',
    )
    robot = load_robot(urdf(text), chain_to="手")
    assert (robot.name, robot.joints[0].name) == ("Πρώτος", "Gelenk-ä")
    assert load_robot(urdf(text.encode("utf-16")), chain_to="手").n == 1


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
WRONG = {
    "empty": ("", "is empty"),
    "blank": ("  \n ", "is empty"),
    "not xml": ("name: arm", "line 1: not well-formed"),
    "truncated": (arm()[:-20], "line 3: not well-formed"),
    "binary": (bytes(range(256)), "not well-formed"),
    "other root": ("<sdf/>", "root element is <sdf>"),
    "html": ("<html><body/></html>", "root element is <html>"),
    "xacro": (
        '<robot xmlns:xacro="http://ros.org/wiki/xacro" name="r">\n<xacro:arm/></robot>',
        "line 2: this is a xacro file",
    ),
    "xacro value": (arm(links='<link name="${prefix}a"/>'), "xacro"),
    "no name": (arm(name=""), "has no name"),
    "no links": ('<robot name="r"/>', "no <link>"),
    "no joints": ('<robot name="r"><link name="a"/></robot>', "no moving joints"),
    "nameless link": (arm(links="<link/>"), "line 2: a <link> has no name"),
    "same link twice": (
        arm(links='<link name="a"/>\n<link name="a"/>'),
        "line 3: link 'a' is defined twice, first in line 2",
    ),
    "same joint twice": (arm(joint() + joint()), "joint 'j' is defined twice"),
    "unknown child": (arm(joint(child="c")), "line 3: the child of joint 'j', 'c'"),
    "unknown parent": (arm(joint(parent="aa")), "'aa', is no link of this file. Did you mean a"),
    "no parent": (arm('<joint name="j" type="fixed"><child link="b"/></joint>'), "no <parent>"),
    "two parents": (arm(joint() + joint("k")), "child of 2 joints"),
    "loop": (arm(joint() + joint("k", parent="b", child="a")), "closed loop"),
    "loop on itself": (arm(joint(parent="b")), "roots|closed loop"),
    "loop aside": (
        arm(
            joint() + joint("k", parent="c", child="d") + joint("l", parent="d", child="c"),
            links=f'<link name="a"/><link name="b">{INERTIAL}</link><link name="c"/><link name="d"/>',
        ),
        "links c, d form a closed loop",
    ),
    "two roots": (arm(links='<link name="a"/><link name="b"/><link name="c"/>'), "2 roots, a, c"),
    "unknown type": (arm(joint(kind="hinge")), "type 'hinge'; a URDF has revolute"),
    "no type": (arm(joint(kind="")), "type ''"),
    "floating": (arm(joint(kind="floating")), "line 3: joint 'j' is floating"),
    "no limit": (arm(joint(inner="")), "no <limit>"),
    "limits crossed": (arm(joint(inner='<limit lower="1" upper="-1"/>')), "lower limit, 1, above its upper, -1"),
    "limit no number": (
        arm(joint(inner='<limit lower="1" upper="much"/>')),
        'upper="much" of <limit> is not a finite number',
    ),
    "limit nan": (arm(joint(inner='<limit lower="nan" upper="1"/>')), "not a finite number"),
    "zero axis": (arm(joint(inner=LIMIT + '<axis xyz="0 0 0"/>')), "axis of joint 'j' is zero"),
    "short axis": (arm(joint(inner=LIMIT + '<axis xyz="0 1"/>')), "not 3 finite numbers"),
    "bad origin": (arm(joint(inner=LIMIT + '<origin xyz="0 1 inf"/>')), "not 3 finite numbers"),
    "bad damping": (arm(joint(inner=LIMIT + '<dynamics damping="some"/>')), "damping"),
    "mass missing": (
        arm(links='<link name="a"/><link name="b"><inertial><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'),
        "line 2: the <inertial> of link 'b' has no <mass>",
    ),
    "negative mass": (
        arm(links=f'<link name="a"/><link name="b">{INERTIAL}</link>'.replace('"1"/><', '"-1"/><')),
        "negative mass",
    ),
    "entity bomb": (BOMB + ']><robot name="r">&i;</robot>', "DOCTYPE|amplification"),
    "entity bomb in a name": (BOMB + ']><robot name="&i;"/>', "DOCTYPE|amplification"),
    "doctype": ("<!DOCTYPE robot>" + arm(), "DOCTYPE"),
    "utf-16 doctype": (("<!DOCTYPE robot>" + arm()).encode("utf-16"), "DOCTYPE"),
}


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=WRONG)
def test_wrong_files_are_refused_with_the_reason(text, message, urdf, capfd):
    path = urdf(text)
    with pytest.raises(RobotError, match=message) as caught:
        load_robot(path)
    assert capfd.readouterr() == ("", "")
    if "moving" not in message and message != "DOCTYPE":
        assert str(path) in str(caught.value)


def test_external_entities_are_not_read(urdf, tmp_path):
    secret = tmp_path / "secret"
    os.mkfifo(secret)  # opening it would wait for ever
    for declaration in ("SYSTEM", 'PUBLIC "x"'):
        for text in (
            f'<!DOCTYPE r [<!ENTITY x {declaration} "file://{secret}">]><robot name="r">&x;</robot>',
            f'<!DOCTYPE r {declaration} "file://{secret}"><robot name="r"/>',
            f'<!DOCTYPE r [<!ENTITY % x {declaration} "http://localhost:1/x"> %x;]><robot name="r"/>',
        ):
            with pytest.raises(RobotError, match=r"DOCTYPE|not well-formed"):
                load_robot(urdf(text))


def test_load_robot_refuses_paths_without_a_file(tmp_path, urdf):
    with pytest.raises(RobotError, match="there is no file"):
        load_robot(tmp_path / "missing.urdf")
    urdf(arm(), "one.urdf")
    with pytest.raises(RobotError, match=r"is a folder, not a URDF file; it holds one\.urdf"):
        load_robot(tmp_path)
    pipe = tmp_path / "pipe.urdf"
    os.mkfifo(pipe)
    with pytest.raises(RobotError, match="not a regular file"):
        load_robot(pipe)
    with pytest.raises(RobotError):
        load_robot("a\0b.urdf")
    huge = urdf("")
    os.truncate(huge, 65 * 2**20)
    with pytest.raises(RobotError, match="larger than 64 MB"):
        load_robot(huge)


def test_load_robot_reports_a_file_that_may_not_be_read(urdf, monkeypatch):
    path = urdf(arm())

    def refuse(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(path), "open", refuse)
    with pytest.raises(RobotError, match=r"cannot be read.*Permission denied"):
        load_robot(path)


def test_load_robot_reads_odd_files(urdf, capfd):
    drake = arm().replace("<robot", '<robot xmlns="http://drake.mit.edu"')
    assert load_robot(urdf(drake)).n == 1
    plugin = arm(joint() + "<gazebo><sensor:camera/></gazebo>")
    assert load_robot(urdf(plugin)).n == 1
    tabs = arm(joint(inner=LIMIT + '<axis xyz="\t0\n0  1 "/>'))
    assert load_robot(urdf(tabs)).n == 1
    endless = load_robot(urdf(arm(joint(inner='<limit lower="-inf" upper="1e400" effort="inf" velocity="2"/>'))))
    assert (endless.lower[0], endless.upper[0], endless.effort[0]) == (-np.inf, np.inf, np.inf)
    bare = load_robot(urdf(arm(joint(inner='<limit lower="-1" upper="1"/>'))))
    assert (bare.velocity[0], bare.effort[0]) == (np.inf, np.inf)
    unfilled = load_robot(urdf(arm(joint(inner='<limit effort="1" velocity="1"/>'))))
    assert np.isinf(unfilled.upper[0])
    assert "0 to 0" in unfilled.notes[0]
    odd = arm(links=f'<link name="a"/><link name="b">{INERTIAL}</link>'.replace('izz="1"', 'izz="9"'))
    assert "no real body" in load_robot(urdf(odd)).notes[0]
    floating = arm(
        joint(kind="floating", child="c") + joint("k", parent="c"),
        links=f'<link name="a"/><link name="c"/><link name="b">{INERTIAL}</link>',
    )
    assert load_robot(urdf(floating), lock=["j"]).n == 1
    assert capfd.readouterr() == ("", "")


def test_urdf_of_many_links_is_refused_beyond_the_most(urdf):
    beams = range(2 * DEEPEST_TREE)
    star = "".join(f'<link name="x{i}"/>' + joint(f"f{i}", "fixed", child=f"x{i}", inner="") for i in beams)
    assert load_robot(urdf(arm(joint() + star))).n == 1
    names = ["a", *(f"x{i}" for i in range(DEEPEST_TREE))]
    row = "".join(f'<link name="{b}"/>' + joint(f"f{b}", "fixed", a, b, "") for a, b in itertools.pairwise(names))
    assert load_robot(urdf(arm(joint() + row))).n == 1
    row += '<link name="last"/>' + joint("flast", "fixed", names[-1], "last", "")
    with pytest.raises(RobotError, match="row of links"):
        load_robot(urdf(arm(joint() + row)))


ODD = {
    "xml 0.0": ('<?xml version="0.0" ?>\n', "", "the XML declaration"),
    "no version": ("<?xml encoding='utf-8'?>", "", "the XML declaration"),
    "blank lines first": ('\n \n<?xml version="1.0"?>', "", "the XML declaration"),
    "a mark and blank lines first": ('\ufeff\n<?xml version="1.0"?>', "", "the XML declaration"),
    "blank lines and a mark first": ("\n\ufeff", "", "a byte order mark"),
    "dashes in a comment": ("<!-- a -- b --->", "", "comments with --"),
    "a comment of dashes": ("<!------- robot ------->", "", "comments with --"),
    "axis of a fixed joint without xyz": ("", joint("f", "fixed", "b", "c", "<axis/>"), "fixed, so that .*: f$"),
    "axis of a fixed joint of two numbers": ("", joint("f", "fixed", "b", "c", '<axis xyz="0 1"/>'), ""),
    "limits of a fixed joint crossed": (
        "", joint("f", "fixed", "b", "c", '<limit lower="2" upper="-2"/>'), "fixed, so that .*: f$",
    ),
    "limits of a fixed joint kept": ("", joint("f", "fixed", "b", "c", LIMIT), ""),
    "limits of a continuous joint crossed": (
        "", joint("k", "continuous", "b", "c", '<limit lower="2" upper="-2" effort="1"/>'), "continuous, so .*: k$",
    ),
    "limits of a continuous joint": ("", joint("k", "continuous", "b", "c", LIMIT), "continuous, so .*: k$"),
    "limits of a continuous joint that are words": (
        "", joint("k", "continuous", "b", "c", '<limit lower="none" upper="none"/>'), "continuous, so .*: k$",
    ),
    "limits from 1 to 0": (
        "", joint("k", parent="b", child="c", inner='<limit lower="1" upper="0" effort="1"/>'), "1 to 0 .* none: k$",
    ),
    "negative effort": (
        "", joint("k", parent="b", child="c", inner='<limit upper="1" effort="-1" velocity="1"/>'), "effort .*: k$",
    ),
    "negative velocity": (
        "", joint("k", parent="b", child="c", inner='<limit upper="1" effort="1" velocity="-1"/>'), "velocity .*: k$",
    ),
    "what xacro defined": (
        "",
        '<xacro:property name="m" value="2"/>'
        '<xacro:macro name="box" params="p"><link name="${p}"/><joint name="${p}j" type="fixed"/></xacro:macro>',
        "xacro, and not used: <xacro:property>, <xacro:macro>",
    ),
    "values for xacro beside the robot": (
        "", '<gazebo reference="${p}b"><file>a</file></gazebo>', "xacro, and not used: values of <gazebo>",
    ),
    "attributes of xacro": ("", "<link name='d' xacro:if='1'/>" + joint("f", "fixed", "b", "d", ""), "attributes of"),
}  # fmt: skip


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(("before", "inside", "note"), ODD.values(), ids=ODD)
def test_load_robot_reads_urdf_of_lenient_parsers_with_a_note(before, inside, note, encoding, urdf, capfd):
    more = f'<link name="c">{INERTIAL}</link>' if 'child link="c"' in inside else ""
    text = before + arm(joint() + inside, links=f'<link name="a"/><link name="b">{INERTIAL}</link>{more}')
    for source in (urdf(text.encode(encoding)), text, text.encode(encoding)):
        robot = load_robot(source)
        # Text has no use for a declaration, so it does not matter how odd it is.
        if note and not ("declaration" in note and not isinstance(source, os.PathLike)):
            assert re.search(note, " | ".join(robot.notes))
        else:
            assert robot.notes == ()
        first, *others = robot.joints
        assert (first.lower, first.upper, first.velocity, first.effort) == (-1.0, 1.0, 1.0, 1.0)
        for other in others:
            assert (other.lower, other.upper) in ((-np.inf, np.inf), (0.0, 1.0))
            assert min(other.velocity, other.effort) > 0.0
    assert capfd.readouterr() == ("", "")


def test_lines_are_counted_as_in_the_file_where_it_is_not_quite_xml(urdf):
    text = '\n<?xml version="1.0"\n?>\n<!-- -- \n -->\n' + arm(joint(kind="hinge"))
    line = text[: text.index("<joint")].count("\n") + 1
    for source in (urdf(text), text):
        with pytest.raises(RobotError, match=f" line {line}: joint 'j' has type"):
            load_robot(source)


def test_load_robot_error_names_joint_or_link(urdf):
    wrong = {
        "xyz=\"0 1\" of <origin> is not 3 finite numbers, in joint 'j'": arm(
            joint(inner=LIMIT + '<origin xyz="0 1"/>')
        ),
        "effort=\"lots\" of <limit> is not a finite number, in joint 'j'": arm(joint(inner='<limit effort="lots"/>')),
        "the <axis> of joint 'j' has no xyz": arm(joint(inner=LIMIT + "<axis/>")),
        "value=\"m\" of <mass> is not a finite number, in link 'b'": arm().replace('mass value="1"', 'mass value="m"'),
        'name="${p}" of <link> is for xacro to fill in': arm(links='<link name="a"/><link name="${p}"/>'),
        'xyz="${x} 0 0" of <origin> is for xacro to fill in; run `xacro FILE': arm(
            joint(inner=LIMIT + '<origin xyz="${x} 0 0"/>')
        ),
        "this is a xacro file": arm(joint() + "<xacro:gripper/>"),
    }
    for message, text in wrong.items():
        path = urdf(text)
        with pytest.raises(RobotError, match=re.escape(message)) as caught:
            load_robot(path)
        assert re.match(re.escape(str(path)) + r" line \d: ", str(caught.value))


def test_text_and_bytes_are_urdfs_as_well(monkeypatch, tmp_path, urdf):
    text = ROBOTS["panda"].path.read_text()
    of_file, of_text = load_robot("panda", chain_to="panda_hand"), load_robot(text, chain_to="panda_hand")
    q = np.linspace(-0.5, 0.5, 7)
    assert np.array_equal(of_file.mass(q), of_text.mass(q))
    assert of_text.options == of_file.options
    again = load_robot(of_text.source, **of_text.options)
    assert (again.source, again.urdf_sha256) == (of_text.source, of_text.urdf_sha256)
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "latin-1"):
        declared = f'<?xml version="1.0" encoding="{encoding.removesuffix("-sig")}"?>' + arm(name='name="Räuber"')
        assert load_robot(declared.encode(encoding)).name == load_robot(declared).name == "Räuber"
    # Meshes are looked for beside the current folder.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.stl").write_text("solid\nendsolid\n")
    mesh = '<visual><geometry><mesh filename="part.stl"/></geometry></visual>'
    shaped = arm(links=f'<link name="a"/><link name="b">{mesh}{INERTIAL}</link>')
    assert load_robot(shaped).notes == ()
    assert "mesh files were not found" in load_robot(shaped.replace("part", "lost")).notes[0]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("<robot", "the URDF text line 1: not well-formed"),
        ("<sdf/>", "the URDF text line 1: the root element is <sdf>"),
        (b"\xff\xfe<robot ", "not text in the encoding utf-16"),
        (b'<?xml version="1.0" encoding="klingon"?><robot/>', "not text in the encoding klingon"),
        (b"", "empty|not well-formed"),
    ],
)
def test_text_that_is_no_urdf_is_refused(source, message):
    with pytest.raises(RobotError, match=message):
        load_robot(source)


def test_modules_of_robot_descriptions_give_a_path_or_a_model(urdf):
    """Attributes as in version 3.3: paths in a clone, which lies in a cache."""
    module = types.ModuleType("robot_descriptions.arm_description")
    module.URDF_PATH = str(urdf(shaped('<mesh filename="package://arm/link.stl"/>'), "clone/robots/arm/urdf/arm.urdf"))
    module.PACKAGE_PATH = os.path.dirname(os.path.dirname(module.URDF_PATH))
    urdf(STL, "clone/robots/arm/link.stl")
    robot = load_robot(module.URDF_PATH, package_dirs=[module.PACKAGE_PATH])
    assert robot.notes == ()
    assert robot.visual.ngeoms == 1
    # As robot_descriptions.loaders.pinocchio has it.
    wrapper = pin.RobotWrapper.BuildFromURDF(module.URDF_PATH, [os.path.dirname(module.PACKAGE_PATH)])
    other = Robot.from_pinocchio(wrapper.model)
    np.testing.assert_array_equal(robot.placement([0.3], "b").homogeneous, other.placement([0.3], "b").homogeneous)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("source", [pin.Model(), None, 7, types.ModuleType("arm_description")])
def test_load_robot_refuses_other_sources(source):
    with pytest.raises(InputError, match=r"given by name, path or text .* Robot\.from_pinocchio\(model\)"):
        load_robot(source)


UNITS = {
    "millimetres": (' xyz="0 0 900"', "", "reaches 900 m; .* millimetres"),
    "centimetres": (' xyz="0 0 90"', "", "reaches 90 m; .* centimetres"),
    "metres": (' xyz="0 0 0.9"', "", ""),
    "degrees": (' xyz="0 0 0.9"', '<limit lower="-170" upper="170"/>', "look like degrees.*: j$"),
    "many turns": (' xyz="0 0 0.9"', '<limit lower="-1e4" upper="1e4"/>', ""),
    "grams": (' xyz="0 0 0.9"', "", "mass of 2e\\+04 kg"),
    "a crumb": (' xyz="0 0 0.9"', "", "mass of 2e-06 kg"),
    "wide": (' xyz="0 0 0.9"', "", "larger than the robot"),
}


@pytest.mark.parametrize(("place", "limit", "note"), UNITS.values(), ids=UNITS)
def test_numbers_in_other_units_are_noted(place, limit, note, urdf, request):
    mass, inertia = {"grams": (2e4, 1.0), "a crumb": (2e-6, 1e-9), "wide": (1.0, 2.0)}.get(
        request.node.callspec.id, (1.0, 0.1)
    )
    inertial = f'<inertial><mass value="{mass}"/><inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}"/></inertial>'
    tip = joint("f", "fixed", "b", "tip", f"<origin{place}/>")
    text = arm(
        joint(inner=limit or LIMIT) + tip, links=f'<link name="a"/><link name="b">{inertial}</link><link name="tip"/>'
    )
    notes = load_robot(urdf(text), chain_to="tip").notes
    assert [bool(re.search(note, each)) for each in notes] == [True] if note else notes == ()


# -- the default frame -------------------------------------------------------------------------------------------


def carrying(hand, *, joints=5):
    """An arm with a flange, and what is fixed to it."""
    names = [f"l{i}" for i in range(joints + 1)]
    text = "".join(joint(f"j{i}", parent=a, child=b) for i, (a, b) in enumerate(itertools.pairwise(names), 1))
    text += joint("fj", "fixed", names[-1], "flange", "")
    links = [*names, "flange", *re.findall(r'child link="(\w+)"', hand)]
    return arm(text + hand, links="".join(f'<link name="{link}">{INERTIAL}</link>' for link in links))


MIMIC = LIMIT + '<mimic joint="drive"/>'
HANDS = {
    "a driven joint and its follower behind it": joint("drive", parent="flange", child="d")
    + joint("pad", parent="d", child="p", inner=MIMIC),
    "a follower at the flange": joint("drive", parent="flange", child="d")
    + joint("other", parent="flange", child="e", inner=MIMIC),
    "a follower that carries the longest branch": joint("drive", parent="flange", child="d")
    + joint("k1", parent="flange", child="e", inner=MIMIC)
    + joint("k2", parent="e", child="f")
    + joint("k3", parent="f", child="tool"),
    "links called fingers": joint("g7", parent="flange", child="leftfinger")
    + joint("g8", parent="flange", child="rightfinger"),
    "knuckles": joint("left_inner_knuckle", parent="flange", child="n"),
    "branches without telling names": joint("a7", parent="flange", child="u")
    + joint("b7", parent="flange", child="w")
    + joint("b8", parent="w", child="x"),
    "a camera beside the flange": joint("c", "fixed", "l5", "camera_link", ""),
}


@pytest.mark.parametrize("hand", HANDS.values(), ids=HANDS)
def test_default_frame_is_the_flange_with_any_tool(hand, urdf):
    path = urdf(carrying(hand))
    robot = load_robot(path, chain_to="auto")
    assert (robot.n, robot.options["chain_to"]) == (5, "flange")
    assert default_frame(load_robot(path)) == "flange"


def test_default_frame_of_an_arm_with_a_follower_in_it_is_before_the_follower(urdf):
    text = carrying("").replace('name="j2"', 'name="drive"')
    text = text.replace(joint("j4", parent="l3", child="l4"), joint("j4", parent="l3", child="l4", inner=MIMIC))
    robot = load_robot(urdf(text), chain_to="auto")
    assert (robot.n, robot.options["chain_to"]) == (3, "l3")


def test_hand_alone_is_a_robot(urdf):
    robot = load_robot(urdf(carrying("", joints=3).replace('name="j', 'name="finger_j')), chain_to="auto")
    assert robot.options["chain_to"] == "flange"


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_urdf_gives_an_eos_error_or_a_robot(data, urdf, capfd):
    text = ROBOTS["ppr"].path.read_text()
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text) - 1))
        length = data.draw(st.integers(0, 60))
        piece = data.draw(
            st.sampled_from(["", '"', "<", ">", "/>", "nan", "-1", "1e999", "é", "link", text[start : start + 200]])
        )
        text = text[:start] + piece + text[start + length :]
    with contextlib.suppress(EosError):
        robot = load_robot(urdf(text))
        assert np.isfinite(robot.mass(np.zeros(robot.n))).all()
        assert robot.visual.ngeoms >= 0
    assert capfd.readouterr() == ("", "")


# -- meshes ------------------------------------------------------------------------------------------------------

STL = b"""solid triangle
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid triangle
"""


def shaped(geometry):
    return arm(
        links=f'<link name="a"><visual><geometry>{geometry}</geometry></visual></link><link name="b">{INERTIAL}</link>'
    )


@pytest.mark.parametrize(
    ("name", "file", "how"),
    [
        ("part.stl", "part.stl", ""),
        ("meshes/part.stl", "meshes/part.stl", ""),
        ("package://my_arm/meshes/part.stl", "../meshes/part.stl", "package folder"),
        ("package://my_arm/meshes/part.stl", "../../elsewhere/my_arm/meshes/part.stl", "package_dirs"),
        ("package://my_arm/meshes/part.stl", "../../elsewhere/my_arm/meshes/part.stl", "package itself"),
        ("package://my_arm/meshes/part.stl", "../../elsewhere/my_arm/meshes/part.stl", "ROS_PACKAGE_PATH"),
        ("package://my_arm/meshes/part.stl", "../../elsewhere/share/my_arm/meshes/part.stl", "AMENT_PREFIX_PATH"),
        ("package://other_name/meshes/part.stl", "../meshes/part.stl", "guessed"),
        ("file://{}", "part.stl", "absolute"),
        ("{}", "part é.stl", "absolute"),
    ],
)
def test_meshes_are_found(name, file, how, urdf, tmp_path, monkeypatch, capfd):
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    elsewhere = tmp_path / "elsewhere"
    dirs = {"package_dirs": [elsewhere], "package itself": [elsewhere / "my_arm"]}.get(how, ())
    if how.endswith("PATH"):
        monkeypatch.setenv(how, f"/nowhere{os.pathsep}{elsewhere}")
    path = urdf("", "my_arm/urdf/robot.urdf")
    mesh = urdf(STL, os.path.normpath(f"my_arm/urdf/{file}"))
    path.write_text(shaped(f'<mesh filename="{name.format(mesh)}"/>'))
    robot = load_robot(path, package_dirs=dirs)
    assert robot.notes == ()
    assert os.path.samefile(robot.visual.geometryObjects[0].meshPath, mesh)
    assert load_robot(robot.source, **robot.options).notes == ()
    assert capfd.readouterr() == ("", "")


def test_missing_meshes_are_left_out_with_a_note(urdf, capfd):
    good = '<box size="1 2 3"/></geometry></visual><visual><geometry>'
    robot = load_robot(urdf(shaped(good + '<mesh filename="package://none/lost.stl"/>')), package_dirs=["/nowhere"])
    assert "package://none/lost.stl" in robot.notes[0]
    assert "/nowhere" in robot.notes[0]
    assert robot.visual.ngeoms == 1
    assert robot.collision.ngeoms == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "geometry",
    ['<box size="1 2"/>', '<sphere radius="-1"/>', '<cylinder radius="1"/>', "<ellipsoid/>", "", '<mesh scale="1"/>'],
)
def test_unusable_shapes_are_left_out_with_a_note(geometry, urdf, capfd):
    robot = load_robot(urdf(shaped(geometry)))
    assert "line 2" in robot.notes[0]
    assert robot.visual.ngeoms == 0
    assert capfd.readouterr() == ("", "")


def test_damaged_meshes_are_left_out_with_a_warning(urdf, capfd):
    urdf("this is no mesh", "bad.stl")
    urdf(STL, "good.stl")
    both = '<mesh filename="bad.stl"/></geometry></visual><visual><geometry><mesh filename="good.stl"/>'
    robot = load_robot(urdf(shaped(both)))
    with pytest.warns(UserWarning, match=r"cannot be read: .*bad\.stl"):
        assert robot.visual.ngeoms == 1
    assert pickle.loads(pickle.dumps(robot)).n == 1
    assert capfd.readouterr() == ("", "")


def test_load_robot_repairs_materials(urdf, capfd):
    box = '<box size="1 2 3"/></geometry><material name="m"/></visual><visual><geometry><box size="1 1 1"/>'
    red = '<material name="m"><color rgba="1 0 0 1"/><texture filename="package://x/y.png"/></material>'
    robot = load_robot(urdf(shaped(box).replace("<link", red + red + "<material/><link", 1)))
    assert robot.visual.geometryObjects[0].meshColor.tolist() == [1.0, 0.0, 0.0, 1.0]
    assert robot.visual.ngeoms == 2
    assert capfd.readouterr() == ("", "")


def test_meshes_of_the_examples_are_all_found():
    for name in ("panda", "talos_left_arm", "kinova", "xarm7", "ur5"):
        assert not any("mesh" in note for note in load_robot(name).notes)
    assert load_robot("panda").visual.ngeoms == 11


# -- second opinions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "kinova", "ur5_robot", "planar_chain_10", "talos_left_arm"])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_poses_agree_with_yourdfpy(name):
    import yourdfpy

    other = yourdfpy.URDF.load(str(ROBOTS[name].path), load_meshes=False, build_scene_graph=True)
    robot = load_robot(name)
    random = np.random.default_rng(0)
    mimics = {joint.name for joint in other.robot.joints if joint.mimic is not None}
    leaders = {joint.mimic.joint for joint in other.robot.joints if joint.mimic is not None}
    q = random.uniform(-1, 1, robot.n)
    for i, joint in enumerate(robot.joints):
        # yourdfpy moves a mimic joint with the joint it follows; both stay at zero here.
        q[i] = 0.0 if joint.name in mimics or joint.name in leaders else q[i]
    other.update_cfg({joint.name: q[i] for i, joint in enumerate(robot.joints) if joint.name not in mimics})
    base = other.base_link
    for link in other.link_map:
        ours = robot.placement(q, base).actInv(robot.placement(q, link))
        assert ours.homogeneous == pytest.approx(other.get_transform(link, base), abs=1e-9)


def test_loading_is_light():
    """Neither the import nor panda needs yourdfpy or reads a mesh; both are slow."""
    code = (
        "import sys, eos_pin.robot.loading as l; l.load_robot('panda', chain_to='auto');"
        "print(*(m for m in ('yourdfpy', 'trimesh') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout.strip(), done.stderr) == ("", "")
