"""Closed plans of paths that have a solution by construction: forward kinematics of a loop of joints within limits."""

from __future__ import annotations

import numpy as np
import pytest

from eos_pin import PoseTask, PositionTask, load_robot
from eos_pin.errors import PlanError
from eos_pin.planning.planner import plan


def loop_of(robot, seed, part):
    """Joints of a closed loop in which each joint uses a part of its range, a turn at most, (65, n)."""
    random = np.random.default_rng(seed)
    phase = np.linspace(0.0, 2.0 * np.pi, 65)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    loop = np.column_stack([np.sin(phase + shift) for shift in random.uniform(0.0, 2.0 * np.pi, robot.n)])
    middle = 0.5 * (lower + upper) + 0.2 * part * (upper - lower) * random.uniform(-1.0, 1.0, robot.n)
    joints = middle + 0.5 * part * (upper - lower) * loop
    joints[-1] = joints[0]
    return joints


@pytest.mark.parametrize(("name", "seed"), [("panda", 1), ("xarm7", 2)])
def test_closed_plan_costs_no_more_than_the_loop_its_path_was_made_of(name, seed):
    robot = load_robot(name, chain_to="panda_hand_tcp" if name == "panda" else "auto")
    task = PoseTask(robot, robot.options["chain_to"])
    own = loop_of(robot, seed, 0.45)
    found = plan(task, [task.point(task.value(q)) for q in own], closed=True)
    joints, dt = found.at_waypoints(), np.diff(found.path.times)[:, None]
    assert joints.shape == own.shape
    assert np.abs(joints[-1] - joints[0]).max() < 1e-9
    assert ((joints >= robot.lower) & (joints <= robot.upper)).all()
    errors = [np.abs(task.minus(task.value(q), task.value(mine))).max() for q, mine in zip(joints, own, strict=True)]
    assert max(errors) < 1e-9
    cost, least = (float((np.diff(q, axis=0) ** 2 / dt).sum()) for q in (joints, own))
    assert cost <= least * (1.0 + 1e-9)


def test_closed_plan_does_not_wind_joints_without_limits():
    robot = load_robot("kinova", chain_to="auto")
    task = PoseTask(robot, robot.options["chain_to"])
    own = loop_of(robot, 5, 0.3)
    found = plan(task, [task.point(task.value(q)) for q in own], closed=True)
    times = np.linspace(found.start, found.end, 400)
    joints = found.joints(times)
    assert np.abs(np.diff(joints, axis=0)).max() < 0.5
    assert np.abs(joints[-1] - joints[0]).max() < 1e-9


CHAIN = """<robot name="chain"><link name="link0"/>{joints}</robot>"""
JOINT = """<link name="link{k}"/><joint name="joint{k}" type="{kind}"><parent link="link{before}"/>
<child link="link{k}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>"""


def test_closed_path_that_only_whole_turns_follow_is_refused_by_name():
    """A planar arm of three unit links, its tip at 2.5 around the base: each link has to turn with the tip."""
    joints = [
        JOINT.format(k=k, before=k - 1, x=float(k > 1), kind="fixed" if k == 4 else "continuous") for k in range(1, 5)
    ]
    robot = load_robot(CHAIN.format(joints="".join(joints)), chain_to="link4")
    s = np.linspace(0.0, 2.0 * np.pi, 33)
    circle = np.column_stack((2.5 * np.cos(s), 2.5 * np.sin(s)))
    with pytest.raises(PlanError, match="'joint1' would turn a whole turn"):
        plan(PositionTask(robot, "link4", "xy"), circle, closed=True, effort=1)
