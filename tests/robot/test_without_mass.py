"""A robot whose file has no inertia: all of kinematics works, and dynamics names the links that lack mass."""

from __future__ import annotations

import numpy as np
import pytest

from eos_pin import Chart, EosController, Hold, PositionTask, load_robot, simulate
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.dynamics import ExtendedDynamics
from eos_pin.control.limited import JointLimits
from eos_pin.control.objectives import ReduceKineticEnergy
from eos_pin.control.operational import OperationalSpaceController
from eos_pin.errors import RobotError
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.simulation.mujoco import MujocoPlant
from eos_pin.tasks.position import ComTask

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>'


def arm(joints=5, inertial=""):
    """Arm whose links of 0.3 m turn about y and x in turn, the first about z."""
    text = '<robot name="arm"><link name="l0"/>'
    for i in range(1, joints + 1):
        axis = "0 0 1" if i == 1 else ("0 1 0", "1 0 0")[i % 2]
        text += (
            f'<link name="l{i}">{inertial}</link><joint name="j{i}" type="revolute"><parent link="l{i - 1}"/>'
            f'<child link="l{i}"/><origin xyz="0 0 0.3"/><axis xyz="{axis}"/>'
            '<limit lower="-2.9" upper="2.9" effort="50" velocity="2"/></joint>'
        )
    text += f'<link name="tip"/><joint name="tipj" type="fixed"><parent link="l{joints}"/><child link="tip"/>'
    return text + '<origin xyz="0 0 0.3"/></joint></robot>'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    (folder / "light.urdf").write_text(arm())
    (folder / "heavy.urdf").write_text(arm(inertial=INERTIAL))
    return folder


@pytest.fixture(scope="module")
def light(folder):
    return load_robot(folder / "light.urdf", chain_to="tip")


@pytest.fixture(scope="module")
def heavy(folder):
    return load_robot(folder / "heavy.urdf", chain_to="tip")


def test_kinematics_is_that_of_the_same_robot_with_mass(light, heavy):
    found = []
    for robot in (light, heavy):
        task = make_task(robot)
        q = rest_posture(task)
        chart = Chart.from_base(task, q)
        path = fitting_path(task, q, shape="circle")
        reached = Atlas(task).solve(q, task.value(q) + np.array([0.05, 0.0, -0.05]))
        followed = Atlas(task).follow(q, [path(t).z for t in np.linspace(0.0, path.period, 21)])
        assert reached.residual < 1e-9
        assert followed.complete
        found.append(np.concatenate((q, chart.inverse(task.value(q), 0.1 * np.ones(chart.r)).q, followed.q[-1])))
    np.testing.assert_allclose(*found, atol=1e-9)


DYNAMICS = {
    "EosController": lambda task, q: EosController(task, Hold(task.value(q), task.m)),
    "OperationalSpaceController": lambda task, q: OperationalSpaceController(task, Hold(task.value(q), task.m)),
    "ReduceKineticEnergy": lambda task, q: ReduceKineticEnergy(task.robot),
    "ExtendedDynamics": lambda task, q: (
        ExtendedDynamics.from_state(task.robot, Chart.from_base(task, q), q, 0.0 * q).mass
    ),
    "Atlas": lambda task, q: Atlas(task, metric="inertial"),
    "JointLimits": lambda task, q: JointLimits.from_robot(task.robot),
    "MujocoPlant": lambda task, q: MujocoPlant.from_robot(task.robot),
}


@pytest.mark.parametrize("use", DYNAMICS.values(), ids=DYNAMICS)
def test_dynamics_names_the_links_without_mass(light, use):
    task = PositionTask(light, "tip")
    with pytest.raises(
        RobotError, match=r"j1, j2, j3, j4, j5 move no mass .* to links l1, l2, l3, l4, l5, tip, or lock"
    ):
        use(task, rest_posture(task))


def test_plant_without_mass_is_refused_before_the_run(light, heavy):
    task = PositionTask(heavy, "tip")
    q = rest_posture(task)
    with pytest.raises(RobotError, match="move no mass"):
        simulate(light, EosController(task, Hold(task.value(q), task.m)), q, duration=0.1)


def test_centre_of_mass_needs_mass(light):
    with pytest.raises(RobotError, match="no link that moves has mass"):
        ComTask(light)
