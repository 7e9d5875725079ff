"""The plant that is not ours: MuJoCo's dynamics, its reader of URDF, and its integrators against Pinocchio's."""

from __future__ import annotations

import json
import pickle
import sys
from functools import cache

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from checks import READY as REST
from checks import random_chain, random_state, robot, tip
from lxml import etree

from eos_pin import (
    EosController,
    Friction,
    InputError,
    MissingDependencyError,
    MujocoPlant,
    OpenLoop,
    Payload,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Robot,
    TaskForce,
    figure_eight,
    load_robot,
    simulate,
    simulate_sampled,
)
from eos_pin.cli.main import main

pytestmark = pytest.mark.usefixtures("unchecked")

ROBOTS = ("panda", "kinova", "ppr", "chain", "xarm7")


@cache
def arm(name):
    return load_robot("xarm7") if name == "xarm7" else robot(name)


def states(n, count, seed=0):
    random = np.random.default_rng(seed)
    return zip(random.uniform(-np.pi, np.pi, (count, n)), random.uniform(-2.0, 2.0, (count, n)), strict=True)


def read_by_mujoco(robot):
    """MuJoCo's own model of the URDF, matched: no damping and friction, smallest masses far below any body's."""
    root = etree.fromstring(robot.shapes.urdf)
    etree.strip_elements(root, "visual", "collision", "material", with_tail=False)
    bounds = {"boundmass": "1e-9", "boundinertia": "1e-9", "balanceinertia": "true"}
    etree.SubElement(etree.SubElement(root, "mujoco"), "compiler", bounds)
    model = mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode"))
    model.opt.gravity[:] = robot.model.gravity.linear
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.dof_armature[:] = robot.model.armature
    assert [model.joint(i).name for i in range(model.njnt)] == [joint.name for joint in robot.joints]
    return model, mujoco.MjData(model)


def test_inverse_dynamics_undo_forward_dynamics():
    plant, random = MujocoPlant.from_robot(arm("panda")), np.random.default_rng(3)
    for q, dq in states(7, 20):
        ddq = random.normal(size=7)
        tau = plant.inverse_dynamics(q, dq, ddq)
        np.testing.assert_allclose(plant.forward_dynamics(q, dq, tau), ddq, atol=1e-9)


# -- the same robot ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_mass_and_bias_are_those_that_mujoco_reads_from_the_urdf(name):
    ours = arm(name)
    plant, (model, data) = MujocoPlant.from_robot(ours), read_by_mujoco(ours)
    for q, dq in states(ours.n, 1000):
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_forward(model, data)
        M = np.zeros((ours.n, ours.n))
        for column, unit in zip(M, np.eye(ours.n), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
        np.testing.assert_allclose(ours.mass(q), M, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(ours.bias(q, dq), data.qfrc_bias, rtol=0.0, atol=1e-6)
        # The plant's model is not bounded from below, so it agrees to rounding.
        np.testing.assert_allclose(plant.mass(q), ours.mass(q), rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(plant.bias(q, dq), ours.bias(q, dq), rtol=0.0, atol=1e-10)


def branched(parents=(0, 1, 2, 1)):
    """A tree of two branches, with armature, a skew axis and a skew gravity."""
    model = pin.Model()
    random = np.random.default_rng(3)
    joints = [0]
    skew = np.array([0.6, 0.0, 0.8])
    kinds = [pin.JointModelRZ(), pin.JointModelPX(), pin.JointModelRevoluteUnaligned(skew), pin.JointModelRY()]
    for i, (parent, kind) in enumerate(zip(parents, kinds, strict=True)):
        placement = pin.SE3(pin.exp3(random.normal(size=3)), random.normal(size=3))
        joints.append(model.addJoint(joints[parent], kind, placement, f"joint_{i + 1}"))
        model.appendBodyToJoint(joints[-1], pin.Inertia.Random(), pin.SE3.Identity())
    model.armature = np.array([0.1, 0.2, 0.3, 0.4])
    model.gravity = pin.Motion(np.array([1.0, -2.0, 3.0]), np.zeros(3))
    return Robot(model, name="branched")


VARIED = {
    "branched": branched,
    "random chain": lambda: random_chain(7),
    "payload": lambda: load_robot("panda", chain_to="panda_hand_tcp", payload=Payload(2.0, "panda_hand_tcp")),
    "no gravity": lambda: robot("panda").with_gravity(0.0),
    "model error": lambda: robot("panda").perturbed(mass=0.3, com=0.3, inertia=0.3, seed=1),
    "whole robot": lambda: load_robot("panda"),
}


@pytest.mark.parametrize("kind", VARIED)
def test_acceleration_is_the_same_for_every_variation_of_a_robot(kind):
    ours = VARIED[kind]()
    plant = MujocoPlant.from_robot(ours)
    for q, dq in states(ours.n, 50):
        tau = 10.0 * np.cos(np.arange(ours.n))
        ddq = ours.forward_dynamics(q, dq, tau)
        np.testing.assert_allclose(plant.forward_dynamics(q, dq, tau), ddq, rtol=0.0, atol=1e-10 * np.abs(ddq).max())
        np.testing.assert_allclose(plant.mass(q), ours.mass(q), atol=1e-11)


def test_variations_of_a_plant_are_plants(panda):
    q, dq = random_state(panda, 1)
    plant = MujocoPlant.from_robot(panda, integrator="Euler")
    varied = plant.with_gravity(1.6).perturbed(mass=0.2, seed=3)
    assert (type(varied), varied.integrator) == (MujocoPlant, "Euler")
    expected = panda.with_gravity(1.6).perturbed(mass=0.2, seed=3).bias(q, dq)
    np.testing.assert_allclose(varied.bias(q, dq), expected, atol=1e-11)
    again = pickle.loads(pickle.dumps(plant))
    np.testing.assert_array_equal(again.bias(q, dq), plant.bias(q, dq))
    assert repr(again) == "MujocoPlant('panda', n=7, Euler)"


# -- the same motion -----------------------------------------------------------------------------------------------


def control(robot, task_kind):
    task = (PositionTask if task_kind == "position" else PoseTask)(robot, tip(robot))
    z = task.value(REST)
    eight = figure_eight(z[:3], 0.15, period=4.0, plane="yz")
    return EosController(task, eight if task.m == 3 else PoseTrajectory(eight, pose=z))


@pytest.mark.parametrize("kind", ["position", "pose"])
def test_mujoco_plant_agrees_in_closed_loop(panda, kind):
    controller, options = control(panda, kind), {"duration": 10.0, "record_rate": 20.0}
    ours = simulate_sampled(panda, controller, REST, **options)
    fine = simulate_sampled(MujocoPlant.from_robot(panda), controller, REST, **options)
    assert ours.ok
    assert fine.ok
    assert np.abs(fine.q - ours.q).max() < 1e-9
    # The arrays are MuJoCo's: Pinocchio's inverse dynamics of them gives the torque back.
    residuals = fine.residuals()
    assert residuals["torque"] < 1e-12
    assert residuals["power"] < 1e-10
    arguments = fine.info["arguments"]
    assert (arguments["plant"], arguments["integrator"]) == ("MujocoPlant", "RK4")


@pytest.mark.slow
def test_integrator_of_order_1_agrees_at_a_fine_step(panda):
    controller, options = control(panda, "position"), {"duration": 10.0, "record_rate": 20.0}
    ours = simulate_sampled(panda, controller, REST, **options)
    euler = simulate_sampled(
        MujocoPlant.from_robot(panda, integrator="Euler"), controller, REST, substeps=20, **options
    )
    assert np.abs(euler.q - ours.q).max() < 1e-5


@pytest.mark.parametrize(("integrator", "order", "steps"), [("RK4", 4, (1, 2, 4)), ("Euler", 1, (4, 8, 16))])
def test_difference_shrinks_with_the_step_at_the_order_of_the_integrator(panda, integrator, order, steps):
    controller, plant = control(panda, "position"), MujocoPlant.from_robot(panda, integrator=integrator)

    def joints(plant, substeps):
        # A long period: at 1 kHz order 4 is at rounding with one step.
        return simulate_sampled(
            plant, controller, REST, duration=2.0, control_period=0.04, substeps=substeps, record_rate=20.0
        ).q  # fmt: skip

    ours = joints(panda, 64)
    differences = [np.abs(joints(plant, substeps) - ours).max() for substeps in steps]
    slope = -np.polyfit(np.log(steps), np.log(differences), 1)[0]
    assert slope == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("integrator", ["implicit", "implicitfast"])
def test_integrators_of_mujoco_all_follow(panda, integrator):
    controller = control(panda, "position")
    ours = simulate_sampled(panda, controller, REST, duration=1.0)
    run = simulate_sampled(MujocoPlant.from_robot(panda, integrator=integrator), controller, REST, duration=1.0)
    assert 1e-7 < np.abs(run.q - ours.q).max() < 1e-3


def test_mujoco_plant_feels_force_and_friction(panda):
    controller = control(panda, "position")
    push = TaskForce(controller.task, lambda t: (0.0, 0.0, -10.0 * (t > 0.2)))
    options = {"duration": 0.5, "task_force": push, "friction": Friction(viscous=0.5, coulomb=0.5)}
    ours = simulate_sampled(panda, controller, REST, **options)
    run = simulate_sampled(MujocoPlant.from_robot(panda), controller, REST, substeps=4, **options)
    assert np.abs(ours.error).max() > 1e-3
    # MuJoCo's step holds what depends on time and velocity, so this agrees to the first order only.
    assert np.abs(run.q - ours.q).max() < 1e-4


def test_continuous_run_takes_its_accelerations(panda):
    controller = control(panda, "position")
    ours, theirs = (simulate(plant, controller, REST, duration=2.0) for plant in (panda, MujocoPlant.from_robot(panda)))
    np.testing.assert_allclose(theirs.q, ours.q, atol=1e-7)


# -- trouble -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("tau", "status"), [(1e12, "diverged"), (np.nan, "failed")])
def test_run_away_ends_with_a_status_and_leaves_no_file(panda, tau, status, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    push = OpenLoop(lambda t: np.full(7, tau if t > 0.01 else 0.0))
    run = simulate_sampled(MujocoPlant.from_robot(panda), push, REST, duration=1.0, torque_limits=False)
    assert run.status == status
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_mujoco_plant_refuses_unknown_integrator_and_joints(panda, monkeypatch):
    with pytest.raises(InputError, match="'RK4' or 'Euler' or 'implicit' or 'implicitfast', got 'RK5'"):
        MujocoPlant.from_robot(panda, integrator="RK5")
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelHZ(0.1), pin.SE3.Identity(), "spindle")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    with pytest.raises(InputError, match="'spindle' is a screw"):
        MujocoPlant.from_robot(Robot(model))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'eos-pin\[mujoco\]'"):
        MujocoPlant.from_robot(panda)


@pytest.mark.usefixtures("quick_pictures")
def test_track_command_runs_on_mujoco(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["track", "ppr", "--plant", "mujoco", "--cycles", "2"]
    assert main([*words, "--html", "replay.html", "--plot", "figure.png", "--json", "figures.json"]) == 0
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["status"] == "finished"
    assert figures["task_error_max"] < 1e-3
