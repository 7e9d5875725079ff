"""The two bundled robots against the formulas of the paper, and `Robot` against a second route to each number."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pinocchio as pin
import pytest

from eos_pin.errors import InputError, RobotError, UnknownNameError
from eos_pin.robot.loading import load_robot
from eos_pin.robot.model import MOST_JOINTS, Robot

EXACT = 1e-12
GRAVITY = 9.81


def states(n, count=1000, seed=0):
    """Random joint positions and velocities."""
    random = np.random.default_rng(seed)
    return zip(random.uniform(-4, 4, (count, n)), random.uniform(-3, 3, (count, n)), strict=True)


def point_masses(q):
    """Positions (k, 2), Jacobians (k, 2, n) and their slopes (k, 2, n, n) of the unit masses of Sec. 4.3 and Sec. 6.

    Mass 1 sits on slider y1, mass 2 on slider y2, each further one at the end of a unit link at angle y3 + ... + yk.
    """
    n = len(q)
    r, J, slope = np.zeros((n, 2)), np.zeros((n, 2, n)), np.zeros((n, 2, n, n))
    r[:, 0] = q[0]
    r[1:, 1] = q[1]
    J[:, 0, 0] = 1.0
    J[1:, 1, 1] = 1.0
    for link in range(2, n):
        angle = q[2 : link + 1].sum()
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        turning = np.arange(2, link + 1)
        r[link:] += along
        J[np.ix_(range(link, n), range(2), turning)] += across[:, None]
        slope[np.ix_(range(link, n), range(2), turning, turning)] -= along[:, None, None]
    return r, J, slope


def relative(difference, scale):
    return np.abs(difference).max() / max(1.0, np.abs(scale).max())


@pytest.mark.parametrize("name", ["ppr", "planar_chain_10"])
def test_bundled_robots_are_the_robots_of_the_paper(name):
    robot = load_robot(name, gravity=(0.0, -GRAVITY, 0.0))
    n = robot.n
    tip = robot.frame_id("tip")
    data = robot.model.createData()
    worst = dict.fromkeys(("z", "J", "drift", "M", "bias", "gravity", "T", "P"), 0.0)
    for q, dq in states(n):
        r, J, slope = point_masses(q)
        drift = slope @ dq @ dq
        M = np.einsum("kci,kcj->ij", J, J)
        down = GRAVITY * J[:, 1].sum(axis=0)
        bias = np.einsum("kci,kc->i", J, drift) + down
        pin.forwardKinematics(robot.model, data, q, dq, 0 * q)
        got = {
            "z": (robot.placement(q, "tip").translation[:2], r[-1]),
            "J": (pin.computeFrameJacobian(robot.model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)[:2], J[-1]),
            "drift": (
                pin.getFrameClassicalAcceleration(robot.model, data, tip, pin.LOCAL_WORLD_ALIGNED).linear[:2],
                drift[-1],
            ),
            "M": (robot.mass(q), M),
            "bias": (robot.bias(q, dq), bias),
            "gravity": (robot.gravity(q), down),
            "T": (robot.kinetic_energy(q, dq), 0.5 * dq @ M @ dq),
            "P": (robot.potential_energy(q), GRAVITY * r[:, 1].sum()),
        }
        for key, (value, expected) in got.items():
            worst[key] = max(worst[key], relative(value - expected, expected))
    assert max(worst.values()) <= EXACT, worst


def test_ppr_matches_the_matrices_printed_in_the_paper():
    robot = load_robot("ppr", gravity=(0.0, -GRAVITY, 0.0))
    for q, dq in states(3, 200, seed=1):
        s, c = np.sin(q[2]), np.cos(q[2])
        M = np.array([[3.0, 0.0, -s], [0.0, 2.0, c], [-s, c, 1.0]])
        R = np.array([dq[2] ** 2 * c, dq[2] ** 2 * s - 2.0 * GRAVITY, -GRAVITY * c])
        assert relative(robot.mass(q) - M, M) <= EXACT
        assert relative(robot.bias(q, dq) + R, R) <= EXACT


def test_ppr_rail_tip_moves_with_the_second_body():
    robot = load_robot("ppr")
    for q, _ in states(3, 20):
        assert robot.placement(q, "rail_tip").translation == pytest.approx([q[0], q[1] + 1.5, 0.0], abs=EXACT)


@pytest.mark.parametrize("name", ["ppr", "planar_chain_10"])
def test_bundled_robots_stay_in_their_plane_without_gravity_in_it(name):
    robot = load_robot(name)
    for q, _ in states(robot.n, 20):
        assert np.abs(robot.gravity(q)).max() == 0.0
        assert robot.placement(q, "tip").translation[2] == 0.0


def test_inverse_and_forward_dynamics_undo_each_other():
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    random = np.random.default_rng(2)
    for q, dq in states(robot.n, 50):
        ddq = random.normal(size=robot.n)
        tau = robot.inverse_dynamics(q, dq, ddq)
        scale = np.linalg.cond(robot.mass(q))
        assert tau == pytest.approx(robot.mass(q) @ ddq + robot.bias(q, dq), abs=1e-11)
        assert robot.forward_dynamics(q, dq, tau) == pytest.approx(ddq, abs=1e-13 * scale)


def test_results_are_copies():
    robot = load_robot("ppr")
    M = robot.mass(np.zeros(3))
    kept = M.copy()
    robot.mass(np.ones(3))
    assert np.array_equal(M, kept)
    pose = robot.placement(np.zeros(3), "tip")
    robot.placement(np.ones(3), "tip")
    assert pose.translation[0] == 1.0


def test_limits_are_readonly_and_infinite_where_there_are_none():
    robot = load_robot("kinova")
    assert np.isinf(robot.lower[0])
    assert np.isinf(robot.upper[0])
    assert robot.joints[0].kind == "continuous"
    with pytest.raises(ValueError, match="read-only"):
        robot.lower[0] = 0.0


def test_gravity_is_part_of_the_options():
    robot = load_robot("panda", chain_to="panda_hand")
    free = robot.with_gravity(0.0)
    q = np.full(robot.n, 0.3)
    assert np.abs(free.gravity(q)).max() == 0.0
    assert np.abs(robot.gravity(q)).max() > 1.0
    assert robot.with_gravity(1.62).options["gravity"] == [0.0, 0.0, -1.62]
    again = load_robot(free.source, **free.options)
    assert np.abs(again.gravity(q)).max() == 0.0
    with pytest.raises(InputError, match="gravity"):
        robot.with_gravity([0.0, np.nan, 0.0])


def test_frames_are_found_by_name():
    robot = load_robot("panda")
    assert robot.model.frames[robot.frame_id("panda_hand")].type == pin.FrameType.BODY
    with pytest.raises(UnknownNameError, match="Did you mean panda_hand") as caught:
        robot.frame_id("panda_hnd")
    assert caught.value.kind == "frame"


def test_link_comes_before_a_joint_of_the_same_name():
    model = chain(1)
    model.addFrame(pin.Frame("j0", 1, pin.SE3.Random(), pin.FrameType.BODY))
    robot = Robot(model)
    assert robot.model.frames[robot.frame_id("j0")].type == pin.FrameType.BODY


def test_callers_model_is_left_alone():
    model = chain(2)
    robot = Robot(model, name="mine")
    assert robot.with_gravity(0.0).name == "mine"
    assert model.gravity == chain(2).gravity
    model.inertias[1] = pin.Inertia.Zero()
    assert robot.mass(np.zeros(2))[0, 0] > 0.0
    assert robot.visual is None
    assert robot.collision is None


def test_pickle_keeps_the_dynamics_and_leaves_the_meshes():
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    shapes = robot.visual.ngeoms
    data = pickle.dumps(robot)
    again = pickle.loads(data)
    q = np.full(robot.n, 0.2)
    assert np.array_equal(again.mass(q), robot.mass(q))
    assert again.options == robot.options
    assert again.visual.ngeoms == shapes
    assert len(data) < 200_000


def test_perturbed_robots_are_physical_and_reproducible():
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    other = robot.perturbed(mass=0.2, com=0.2, inertia=0.2, seed=5)
    q = np.full(robot.n, 0.2)
    assert np.array_equal(other.mass(q), robot.perturbed(mass=0.2, com=0.2, inertia=0.2, seed=5).mass(q))
    assert relative(other.mass(q) - robot.mass(q), robot.mass(q)) > 0.01
    for body in list(other.model.inertias)[1:]:
        moments = np.linalg.eigvalsh(body.inertia)
        assert moments.sum() - 2 * moments[-1] >= -EXACT
    assert np.allclose(robot.perturbed().mass(q), robot.mass(q), atol=1e-9)


def chain(n, inertia=None):
    """Serial arm of n unit links in a vertical plane."""
    model = pin.Model()
    joint = 0
    for i in range(n):
        placement = pin.SE3(np.eye(3), np.array([float(i > 0), 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRY(), placement, f"j{i}")
        model.appendBodyToJoint(joint, inertia or pin.Inertia.Random(), pin.SE3.Identity())
        model.addJointFrame(joint)
    return model


def test_robots_that_cannot_be_controlled_are_refused():
    with pytest.raises(RobotError, match="no moving joints"):
        Robot(pin.Model())
    floating = pin.Model()
    floating.appendBodyToJoint(
        floating.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base"),
        pin.Inertia.Random(),
        pin.SE3.Identity(),
    )
    with pytest.raises(RobotError, match="nq = 7, nv = 6"):
        Robot(floating)


def slides():
    """Two sliders along one line carry one mass: each moves it, but both together are one too many."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "a")
    second = model.addJoint(first, pin.JointModelPX(), pin.SE3.Identity(), "b")
    model.appendBodyToJoint(second, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return model


def turned_into_less_than_nothing():
    """About z it is light at 0, and worth less than nothing when joint b has turned it by a right angle."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "a")
    second = model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), "b")
    model.appendBodyToJoint(first, pin.Inertia(1.0, np.zeros(3), np.diag([1.0, 1.0, 1.0])), pin.SE3.Identity())
    odd = pin.Inertia(1.0, np.zeros(3), np.eye(3))
    odd.inertia = np.diag([1.0, -2.0, 1.0])
    model.appendBodyToJoint(second, odd, pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -3.0, 3.0
    return model


def weightless_end():
    model = chain(2)
    model.addBodyFrame("hand", 2, pin.SE3.Identity(), -1)
    model.inertias[2] = pin.Inertia.Zero()
    return model


DYNAMICS = {
    "mass": lambda robot, q: robot.mass(q),
    "bias": lambda robot, q: robot.bias(q, q),
    "gravity": lambda robot, q: robot.gravity(q),
    "inverse_dynamics": lambda robot, q: robot.inverse_dynamics(q, q, q),
    "forward_dynamics": lambda robot, q: robot.forward_dynamics(q, q, q),
    "kinetic_energy": lambda robot, q: robot.kinetic_energy(q, q),
    "potential_energy": lambda robot, q: robot.potential_energy(q),
    "energy_slope": lambda robot, q: robot.energy_slope(q, q),
    "of a copy": lambda robot, q: pickle.loads(pickle.dumps(robot)).with_gravity(0.0).mass(q),
}


@pytest.mark.parametrize("use", DYNAMICS.values(), ids=DYNAMICS)
@pytest.mark.parametrize(
    ("model", "message"),
    [
        (weightless_end(), "joints j1 move no mass .* give mass and inertia to links hand, or lock"),
        (turned_into_less_than_nothing(), r"no mass \(M\(q\) is singular at q = \[.*\d.*\]\)\. For dynamics, check"),
        (chain(1, pin.Inertia(1.0, np.full(3, np.nan), np.eye(3))), "not finite"),
        (slides(), "not positive definite"),
    ],
    ids=["no mass", "negative in some postures", "not finite", "one slider too many"],
)
def test_dynamics_of_a_robot_that_lacks_them_are_refused_and_its_kinematics_are_not(model, message, use):
    robot = Robot(model)
    with pytest.raises(RobotError, match=message):
        use(robot, np.full(robot.n, 0.1))
    with pytest.raises(RobotError, match=message):
        robot.check_dynamics()
    assert re.search(message, robot.lacks_dynamics)
    assert robot.placement(np.zeros(robot.n), robot.frames[-1]).translation.shape == (3,)


def test_robot_with_mass_lacks_no_dynamics():
    robot = Robot(chain(3))
    assert robot.lacks_dynamics == ""
    robot.check_dynamics()


def test_branches_in_a_mixed_order_are_refused_because_pinocchio_gets_them_wrong():
    def tree(*parents):
        model = pin.Model()
        for i, parent in enumerate(parents):
            joint = model.addJoint(parent, pin.JointModelRY(), pin.SE3.Random(), f"j{i + 1}")
            model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
        return model

    def error_of_mass(model):
        data, q, rest = model.createData(), np.full(model.nq, 0.3), np.zeros(model.nq)
        M = np.triu(pin.crba(model, data, q))
        bias = pin.rnea(model, data, q, rest, rest)
        columns = [pin.rnea(model, data, q, rest, e) - bias for e in np.eye(model.nq)]
        return np.abs(M + np.triu(M, 1).T - columns).max()

    for parents in ((0, 1, 0, 3), (0, 1, 2, 1), (0, 1, 2, 2, 1)):
        assert error_of_mass(tree(*parents)) < 1e-12
        assert Robot(tree(*parents)).n == len(parents)
    for parents, name in (((0, 0, 1, 2), "j3"), ((0, 1, 1, 2), "j4")):
        assert error_of_mass(tree(*parents)) > 1e-3
        with pytest.raises(RobotError, match=f"'{name}'.*branch"):
            Robot(tree(*parents))


def test_too_many_joints_are_refused():
    with pytest.raises(RobotError, match="joints; up to"):
        Robot(chain(MOST_JOINTS + 1))
