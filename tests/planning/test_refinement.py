"""Refinement: never worse, never beyond limits, and stationary: the boundary value problem has the same solution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from eos_pin import HeadingTask, PoseTask, PositionTask, load_robot
from eos_pin.planning.planner import plan
from eos_pin.planning.problem import problem_of
from eos_pin.planning.refine import Course, refine
from eos_pin.tasks.batch import Manifold
from eos_pin.tasks.stacked import StackedTask

LINKS = (0.0, 7.0, 7.0, 4.0, 1.5)
JOINT = """<link name="link{k}"/><joint name="joint{k}" type="{kind}"><parent link="link{before}"/>
<child link="link{k}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>"""


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_refined_joints_cost_no_more_and_keep_limits(seed, closed):
    """From random smooth joints within limits, which need not be anywhere near the best."""
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    random = np.random.default_rng(seed)
    task = PoseTask(robot, "panda_hand_tcp") if seed % 2 else PositionTask(robot, "panda_hand_tcp")
    phase = 2.0 * np.pi * np.arange(40) / 40
    waves = np.column_stack([np.sin(phase + shift) for shift in random.uniform(0.0, 2.0 * np.pi, 7)])
    part = random.uniform(0.1, 0.35, 7)
    own = 0.5 * (robot.lower + robot.upper) + part * (robot.upper - robot.lower) * waves
    Z = np.array([task.value(q) for q in own])
    problem = problem_of(Manifold(task), None, None, False, 0.0, 0.01, None, None, 1.0)
    course = Course(problem, Z, np.full(40, 0.1), closed)
    assert course.kept(own)
    assert np.array_equal(refine(course, own, sound=lambda q: False), own)
    found = refine(course, own)
    assert course.cost(found) <= course.cost(own)
    assert course.kept(found)
    assert ((found >= robot.lower) & (found <= robot.upper)).all()
    assert max(np.abs(task.minus(task.value(q), z)).max() for q, z in zip(found, Z, strict=True)) < 1e-9


@pytest.mark.slow
def test_plan_of_the_planar_arm_solves_its_boundary_value_problem():
    """Kazerounian and Wang (1987): the least ∫|dq/ds|² ds has n·q'' = 0 along the way and n·q' = 0 at free ends."""
    joints = [
        JOINT.format(k=k, before=k - 1, x=LINKS[k - 1], kind="fixed" if k == 5 else "continuous") for k in range(1, 6)
    ]
    robot = load_robot(f'<robot name="arm"><link name="link0"/>{"".join(joints)}</robot>', chain_to="link5")
    task = StackedTask([PositionTask(robot, "link5", "xy"), HeadingTask(robot, "link5")])
    s = np.linspace(0.0, 2.0 * np.pi, 181)
    points = np.column_stack((6.0 + 4.0 * np.cos(s), 4.0 + 4.0 * np.sin(s), np.full(len(s), np.radians(-60.0))))
    found = plan(task, points, times=s, closed=False, keep_time=False)
    q = found.at_waypoints()

    def null(q):
        n = np.linalg.svd(task.linearize(q)[1])[2][-1]
        return n if n @ np.array([1.0, -1.0, 1.0, -1.0]) > 0.0 else -n

    def along(q, w, s):
        rate = np.linalg.pinv(task.linearize(q)[1]) @ [-4.0 * np.sin(s), 4.0 * np.cos(s), 0.0]
        return rate, rate + null(q) * w

    def rates(s, y):
        out = np.empty_like(y)
        for k, (now, state) in enumerate(zip(s, y.T, strict=True)):
            _, rate = along(state[:4], state[4], now)
            ahead, behind = null(state[:4] + 1e-6 * rate), null(state[:4] - 1e-6 * rate)
            out[:4, k], out[4, k] = rate, (ahead - behind) @ rate / 2e-6
        return out

    def ends(a, b):
        return np.array([*task.minus(task.value(a[:4]), points[0]), a[4], b[4]])

    guess = np.vstack((q.T, [null(row) @ rate for row, rate in zip(q, np.gradient(q, s, axis=0), strict=True)]))
    exact = solve_bvp(rates, ends, s, guess, tol=1e-5)
    assert exact.success
    assert np.abs(exact.sol(s)[:4].T - q).max() < 2e-3
    speed = np.array([along(exact.sol(x)[:4], exact.sol(x)[4], x)[1] for x in s])
    value = float((0.5 * (s[1:] - s[:-1]) * ((speed**2).sum(axis=1)[1:] + (speed**2).sum(axis=1)[:-1])).sum())
    assert value < 2.7505 * 1.001
