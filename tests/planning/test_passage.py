"""Motions from one posture to another at one task point, and certain refusals."""

from __future__ import annotations

import numpy as np
import pytest

from eos_pin import PoseTask, PositionTask, load_robot
from eos_pin.errors import InputError
from eos_pin.planning.manifolds.manifold import self_motion_manifold
from eos_pin.planning.manifolds.passage import passage
from eos_pin.planning.planner import plan
from eos_pin.planning.problem import problem_of
from eos_pin.tasks.batch import Manifold

READY = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda", chain_to="panda_hand_tcp")


def problem(task, margin=0.0):
    return problem_of(Manifold(task), None, None, False, 0.0, margin, None, None, 1.0)


def followed(task, z, q, start, end):
    """Whether joints lead from start to end, on the manifold, within limits and in short steps."""
    robot = task.robot
    errors = [np.abs(task.minus(z, task.value(row))).max() for row in q]
    inside = ((robot.lower <= q) & (q <= robot.upper)).all()
    ends = np.array_equal(q[0], start) and np.array_equal(q[-1], end)
    return max(errors) < 1e-9 and inside and ends and np.abs(np.diff(q, axis=0)).max() < 0.25


def test_passage_leads_along_an_arc_and_to_no_other(panda):
    task = PoseTask(panda, "panda_hand_tcp")
    z = task.value(READY)
    arcs = self_motion_manifold(task, z).sampled(0.05)
    own = min(arcs, key=lambda arc: np.abs(arc - READY).max(axis=1).min())
    start, end = own[2], own[-3]
    found = passage(problem(task), z, start, end)
    assert found.q is not None
    assert followed(task, z, found.q, start, end)
    for other in arcs:
        if other is own:
            continue
        refused = passage(problem(task), z, start, other[len(other) // 2])
        assert refused.q is None
        assert refused.certain
        assert "limit of panda_joint" in refused.reason


def test_passage_is_found_by_trees_where_four_joints_are_redundant(panda):
    task = PositionTask(panda, "panda_hand_tcp")
    z = task.value(READY)
    away = READY + np.array([0.0, 0.3, -1.5, 0.2, 1.2, 0.3, 2.0])
    Q, good = Manifold(task).search(away[:, None], z[:, None], (panda.lower + 0.02, panda.upper - 0.02))
    assert good[0]
    found = passage(problem(task), z, READY, Q[:, 0])
    assert found.q is not None
    assert followed(task, z, found.q, READY, Q[:, 0])


def test_plan_begins_from_a_guess_and_refuses_one_of_another_size(panda):
    task = PoseTask(panda, "panda_hand_tcp")
    q = READY + np.linspace(0.0, 0.4, 30)[:, None] * np.array([1.0, 0.5, -1.0, 0.5, 1.0, 0.3, 0.2])
    points = np.array([task.value(row) for row in q])
    found = plan(task, points, guess=q, effort=0)
    assert found.info["task_error_max"] < 1e-9
    assert found.info["cost"] <= 1.01 * float((np.diff(q, axis=0) ** 2 / np.diff(found.path.times)[:, None]).sum())
    with pytest.raises(InputError, match="a row of 7 joints for each of 30 way points"):
        plan(task, points, guess=q[1:])
