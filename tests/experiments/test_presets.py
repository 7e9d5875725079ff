"""Defaults for robots nobody has described."""

from __future__ import annotations

import numpy as np
import pytest

from eos_pin import Atlas, Chart, InputError, PoseTask, PositionTask, StackedTask, load_robot
from eos_pin.experiments.defaults import (
    PASSABLE,
    fitting_path,
    make_task,
    regularity,
    rest_posture,
)

ROBOTS = ("panda", "xarm7", "talos_left_arm", "kinova", "ur5", "ppr", "planar_chain_10")


@pytest.mark.parametrize("name", ROBOTS)
def test_rest_posture_is_inside_limits_and_regular(name: str) -> None:
    robot = load_robot(name, chain_to="auto")
    task = make_task(robot)
    q = rest_posture(task)
    assert (robot.lower <= q).all()
    assert (q <= robot.upper).all()
    sigma = np.linalg.svd(Chart.from_base(task, q).U, compute_uv=False)
    assert sigma[-1] > 0.05 * sigma[0]


@pytest.mark.parametrize("shape", ["eight", "circle", "line"])
def test_fitting_path_starts_at_the_posture_and_fits(shape: str) -> None:
    robot = load_robot("panda", chain_to="auto")
    task = make_task(robot, "pose")
    q = rest_posture(task)
    path = fitting_path(task, q, shape=shape)  # type: ignore[arg-type]
    assert np.abs(task.minus(path(0.0).z, task.value(q))).max() < 1e-12
    times = np.linspace(0.0, path.period, 200)
    found = Atlas(task).follow(q, np.array([path(t).z for t in times]))
    assert found.complete
    assert len(found.charts) == 1
    assert (found.q >= robot.lower).all()
    assert (found.q <= robot.upper).all()
    assert (np.abs(np.diff(found.q, axis=0)) / times[1] <= robot.velocity).all()


@pytest.mark.usefixtures("unchecked")
def test_kinds_of_task_suit_the_robot() -> None:
    panda, chain = load_robot("panda", chain_to="auto"), load_robot("planar_chain_10")
    assert isinstance(make_task(panda, "pose"), PoseTask)
    assert make_task(panda, "com").m == 3
    planar = make_task(chain, "pose")
    assert isinstance(planar, StackedTask)
    assert planar.labels == ("x", "y", "heading")
    flat = make_task(chain)
    assert isinstance(flat, PositionTask)
    assert flat.axes == "xy"
    with pytest.raises(InputError, match="kind"):
        make_task(panda, "speed")  # type: ignore[arg-type]


def test_reach_bounds_how_far_the_tip_gets() -> None:
    robot = load_robot("panda", chain_to="auto")
    random = np.random.default_rng(0)
    shoulder = robot.model.jointPlacements[1].translation
    for _ in range(200):
        tip = robot.placement(random.uniform(robot.lower, robot.upper), "panda_hand_tcp").translation
        assert np.linalg.norm(tip - shoulder) <= robot.reach


@pytest.mark.usefixtures("unchecked")
def test_fitting_path_refuses_shapes_that_do_not_fit() -> None:
    task = make_task(load_robot("panda", chain_to="auto"), "orientation")
    q = rest_posture(task)
    with pytest.raises(InputError, match="hold"):
        fitting_path(task, q)
    assert fitting_path(task, q, shape="hold")(3.0).dz.shape == (3,)
    with pytest.raises(InputError, match="shape"):
        fitting_path(task, q, shape="spiral")  # type: ignore[arg-type]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("name", "frame", "axes"),
    [
        ("panda", "panda_hand_tcp", "xyz"),
        ("ppr", "tip", "xy"),
        ("pr2", "imu_link", "z"),  # one slider
        ("solo", "FL_FOOT", "xz"),  # a leg of two parallel joints
        ("go1", "FL_calf_rotor", "z"),  # the second joint turns about the frame
    ],
)
def test_axes_are_as_many_as_the_joints_move_independently(name: str, frame: str, axes: str) -> None:
    robot = load_robot(name, chain_to=frame)
    task = make_task(robot, frame=frame)
    assert isinstance(task, PositionTask)
    assert task.axes == axes
    q = rest_posture(task)
    assert regularity(task, q) > PASSABLE
    assert fitting_path(task, q).period >= 4.0


@pytest.mark.usefixtures("unchecked")
def test_make_task_refuses_directions_that_cannot_move() -> None:
    with pytest.raises(InputError, match="stays where it is"):
        make_task(load_robot("iris", chain_to="iris__rotor_0"))
    leg = load_robot("talos_full_v2", chain_to="gripper_left_base_link")
    assert make_task(leg, "pose").m == 6
    with pytest.raises(InputError, match="can move only 1 of them independently"):
        make_task(load_robot("go1", chain_to="FL_calf_rotor"), axes="yz")
    icub = make_task(load_robot("icub", chain_to="l_upper_arm_dh_frame"), "pose")
    with pytest.raises(InputError, match="no path is clear of singularities"):
        fitting_path(icub, rest_posture(icub))


@pytest.mark.usefixtures("unchecked")
def test_leg_hangs_away_from_its_limits() -> None:
    robot = load_robot("romeo", chain_to="l_sole")
    q = rest_posture(make_task(robot, "pose"))
    span = robot.upper - robot.lower
    assert (q > robot.lower + 0.05 * span).all()
    assert (q < robot.upper - 0.05 * span).all()
    assert robot.placement(q, "l_sole").translation[2] < -0.3


@pytest.mark.usefixtures("unchecked")
def test_regularity_vanishes_at_singularities_and_at_the_edge_of_a_chart() -> None:
    robot = load_robot("ppr")
    task = make_task(robot)
    chart = Chart.from_base(task, np.zeros(3))
    assert regularity(task, np.zeros(3), chart) == pytest.approx(min(1.0, regularity(task, np.zeros(3))))
    assert regularity(task, np.array([0.0, 0.0, np.pi]), chart) < regularity(task, np.array([0.0, 0.0, np.pi]))
    ur5 = make_task(load_robot("ur5", chain_to="auto"), "pose")
    assert regularity(ur5, np.zeros(6)) < 1e-3
