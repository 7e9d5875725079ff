"""Closed plans of paths that have a solution by construction: forward kinematics of a loop of joints within limits."""

from __future__ import annotations

import numpy as np
import pytest
from checks import TAU, links

from eos_pin import EosController, FollowPlan, Plan, PoseTask, PositionTask, load_robot, simulate
from eos_pin.errors import InputError, PlanError
from eos_pin.planning.advice import changes_for
from eos_pin.planning.planner import plan
from eos_pin.planning.problem import problem_of
from eos_pin.tasks.batch import Manifold


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


def around(count=3):
    """A planar arm of unit links, its tip at 2.5 around the base: each link has to turn with the tip."""
    s = np.linspace(0.0, 2.0 * np.pi, 33)
    circle = (count - 0.5) * np.column_stack((np.cos(s), np.sin(s)))
    return PositionTask(links(count), f"link{count + 1}", "xy"), circle


def test_closed_path_that_only_whole_turns_follow_is_refused_by_name():
    task, circle = around()
    with pytest.raises(PlanError, match=r"'joint1' would turn a whole turn .* allow_winding=True"):
        plan(task, circle, closed=True, effort=1)


@pytest.mark.usefixtures("unchecked")
def test_plan_that_may_wind_goes_on_round_after_round(tmp_path):
    task, circle = around()
    found = plan(task, circle, closed=True, effort=1, allow_winding=True)
    assert found.winding.tolist() == [1, 0, 0]
    assert found.info["winding"] == {"joint1": 1}
    turn, T = np.array([TAU, 0.0, 0.0]), found.period
    times = found.start + np.linspace(0.0, 3.0 * T, 301)
    rows = [found(float(t)) for t in times]
    q, dq, _ = (np.array(column) for column in zip(*rows, strict=True))
    np.testing.assert_allclose(q, found.joints(times), atol=1e-12)
    np.testing.assert_allclose(q[100:], q[:-100] + turn, atol=1e-9)
    np.testing.assert_allclose(dq[100:], dq[:-100], atol=1e-9)
    # The path by its own equation, and derivatives by differences, at the seam as well.
    angle = np.cumsum(q, axis=1)
    tip = np.column_stack((np.cos(angle).sum(axis=1), np.sin(angle).sum(axis=1)))
    np.testing.assert_allclose(np.linalg.norm(tip, axis=1), 2.5, atol=1e-3)
    h = 1e-4
    for t in (found.start + T, found.start + 2.0 * T + 0.3):
        before, now, after = (found(t + s) for s in (-h, 0.0, h))
        np.testing.assert_allclose((after.q - before.q) / (2.0 * h), now.dq, atol=1e-6)
        np.testing.assert_allclose((after.dq - before.dq) / (2.0 * h), now.ddq, atol=1e-5)
    assert Plan.load(found.save(tmp_path / "plan.npz"), task.robot).winding.tolist() == [1, 0, 0]
    table = found.table()[1]
    np.testing.assert_allclose(table[-1] - table[0], turn, atol=1e-9)
    assert np.abs(np.diff(table, axis=0)).max() < 0.1


@pytest.mark.usefixtures("unchecked")
def test_plan_that_winds_is_followed_round_after_round():
    task, circle = around()
    found = plan(task, circle, closed=True, times=np.linspace(0.0, 3.0, 33), effort=1, allow_winding=True)
    controller = EosController(task, found.path, FollowPlan(found))
    start = found(found.start)
    run = simulate(task.robot, controller, start.q, dq=start.dq, duration=2.0 * found.period, rtol=1e-6)
    assert run.joint_drift_per_cycle.max() < 1e-5
    assert run.turns_per_cycle.tolist() == 2 * [[1, 0, 0]]
    assert run.info["joint_distance"]["max"] < 1e-5


@pytest.mark.parametrize("count", [3, 5])
def test_plan_that_may_wind_begins_at_a_given_start_and_has_more_redundancy(count):
    task, circle = around(count)
    start = plan(task, circle[:3], effort=1).q[0] if count == 3 else None
    found = plan(task, circle, closed=True, effort=1, start=start, allow_winding=True)
    assert found.winding.tolist() == [1, *(count - 1) * [0]]
    assert start is None or np.abs(found.q[0] - start).max() < 1e-9
    rows = found.joints(np.linspace(found.start, found.end, 301))
    np.testing.assert_allclose(found.q[-1] - found.q[0], TAU * found.winding, atol=1e-9)
    assert np.abs(np.diff(rows, axis=0)).max() < 0.1


def test_whole_turns_are_tried_where_a_closed_path_was_refused():
    problem = problem_of(Manifold(around()[0]), None, None, False, 0.0, 0.0, None, None, 1.0)
    (change, *_), open_ = changes_for(problem, (), False, True), changes_for(problem, (), False, False)
    assert change.problem.winding
    assert "--allow-winding" in change.words
    assert "turns" not in " ".join(other.words for other in open_)


def test_winding_is_allowed_where_it_means_something_only(panda):
    with pytest.raises(InputError, match="without limits"):
        plan(PositionTask(panda, "panda_hand_tcp"), 0.5 * np.eye(3), closed=False, allow_winding=True)
