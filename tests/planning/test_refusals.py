"""Refusals: place, causes, and changes that were tried and help; and paths and limits that cannot be used."""

from __future__ import annotations

from functools import partial
from itertools import product

import numpy as np
import pytest
from checks import links

from eos_pin import InputError, PositionTask, circle, load_robot
from eos_pin._kernels.ways import Steps, closed_ways, open_ways
from eos_pin.errors import PlanError
from eos_pin.planning.obstacles.bodies import Bodies
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.planning.planner import plan
from eos_pin.planning.problem import problem_of
from eos_pin.planning.search import unbroken
from eos_pin.tasks.batch import Manifold


@pytest.fixture(scope="module")
def task():
    return PositionTask(load_robot("panda", chain_to="panda_hand_tcp"), "panda_hand_tcp")


@pytest.fixture(scope="module")
def two_links():
    """A planar arm of two unit links."""
    return links(2)


def test_refusal_advises_distance_that_helps(task):
    """The hand, 5 cm thick, passes 3 cm above a box."""
    bodies = Bodies.of(task.robot, {"panda_hand": Capsule([0, 0, 0], [0, 0, 0.1], 0.05)})
    scene = Scene([Box([0.45, 0.0, 0.27], [0.1, 0.1, 0.1], name="crate")])
    path = [[0.45, y, 0.35] for y in np.linspace(-0.3, 0.3, 25)]
    with pytest.raises(PlanError, match="With 3 cm more distance from 'crate' there is one"):
        plan(task, path, scene=scene, bodies=bodies, effort=1)


def test_refusal_advises_range_of_the_joint_that_ends_the_path(two_links):
    """The first joint ends 0.05 rad before the path does, and the elbow cannot change sides."""
    q1 = np.linspace(0.0, 1.0, 21)
    path = np.column_stack((np.cos(q1) + np.cos(q1 + 0.5), np.sin(q1) + np.sin(q1 + 0.5)))
    limits = [-1.0, 0.1], [0.95, 2.0]
    with pytest.raises(PlanError, match=r"With 0\.1 rad beyond the upper limit of 'joint1' there is one") as refused:
        plan(PositionTask(two_links, "link3", "xy"), path, limits=limits, margin=0.0, effort=1)
    assert 0.9 < refused.value.reached < 1.0


def test_refusal_advises_a_smaller_path_that_is_within_reach(two_links):
    """The path leaves the reach of 2 by a tenth; at 80 % of its size it ends at 1.89."""
    path = [[x, 0.1] for x in np.linspace(1.1, 2.1, 12)]
    with pytest.raises(PlanError, match="With the path at 80% of its size there is one"):
        plan(PositionTask(two_links, "link3", "xy"), path, effort=1)


def test_refusal_without_advice_that_helps_has_the_changes_tried_and_those_left(two_links):
    path = [[x, 0.1] for x in np.linspace(1.1, 3.5, 12)]
    with pytest.raises(PlanError, match=r"found none either with .*80% of its size.* Next, .* smaller still.*--effort"):
        plan(PositionTask(two_links, "link3", "xy"), path, effort=1)


def test_refusal_is_confirmed_with_twice_the_points_and_postures(two_links):
    path = [[x, 0.1] for x in np.linspace(1.2, 2.4, 7)]
    with pytest.raises(PlanError, match="twice as many points and postures found none") as refused:
        plan(PositionTask(two_links, "link3", "xy"), path, effort=2)
    assert refused.value.waypoint == 3


def test_refusal_of_a_closed_path_has_the_end_of_a_round_or_its_gap(two_links):
    """The tip goes around the base, and the first joint with it."""
    s = np.linspace(0.0, 2.0 * np.pi, 33)
    circle, task = 1.9 * np.column_stack((np.cos(s), np.sin(s))), PositionTask(two_links, "link3", "xy")
    with pytest.raises(PlanError, match=r"no motion from .* \(\d+ by the upper limit of 'joint1'\)") as refused:
        plan(task, circle, closed=True, limits=([-2.0, -2.0], [2.0, 2.0]), effort=1)
    # The first joint is half the elbow's angle, which is ±0.635 rad, behind the direction of the tip.
    assert s[refused.value.waypoint] < 2.0 + 0.5 * 2.0 * np.arccos(0.95) < s[refused.value.waypoint + 2]
    with pytest.raises(PlanError, match=r"'joint1' would turn a whole turn .*; allow_winding=True .* lets them"):
        plan(task, circle, closed=True, effort=1)
    with pytest.raises(PlanError, match=r"'joint1' would turn a whole turn each round, which winds cables up\. "):
        plan(task, circle, closed=True, limits=([-9.0, -2.0], [9.0, 2.0]), effort=1)
    three = PositionTask(links(3), "link4", "xy")
    with pytest.raises(PlanError, match=r"went once round ended with 'joint1' 6\.\d+ rad from its start"):
        plan(
            three,
            circle,
            closed=True,
            start=[-1.1257778752514458, 1.1455671113422463, 1.0620320727714923],
            limits=([-9.0] * 3, [9.0] * 3),
            effort=1,
        )


def test_refusal_counts_the_components_that_limits_bar():
    """Links of 1, 1, 1 have two components with the tip within 1 of the base, and need bent elbows there."""
    path = [[x, 0.0] for x in np.linspace(1.3, 0.3, 21)]
    words = "its self-motion manifold there has 2 components, none within the limits"
    with pytest.raises(PlanError, match=words) as refused:
        plan(PositionTask(links(3), "link4", "xy"), path, limits=([-3.0, -1.8, -1.8], [3.0, 1.8, 1.8]), effort=1)
    # Elbows at 1.8 rad both leave the tip so far from the base.
    least = abs(1.0 + np.exp(1.8j) + np.exp(3.6j))
    assert path[refused.value.waypoint + 1][0] < least + 0.02 < path[refused.value.waypoint - 1][0]


def test_refusal_names_the_way_point_out_of_reach(task):
    path = [[x, 0.1 * k, 0.4] for k, x in enumerate((0.4, 0.55, 0.7, 1.4, 0.7, 0.55, 0.4))]
    with pytest.raises(PlanError, match="reach") as refused:
        plan(task, path, effort=1)
    assert refused.value.waypoint == 2
    assert "to way point 3" in str(refused.value) or "from way point 2 to 3" in str(refused.value)


def test_bodies_take_pairs_of_links_without_capsules_but_no_unknown_names(task):
    """Of three capsules along the arm the first and the last are checked; the others are neighbours."""
    capsules = {f"panda_{link}": Capsule([0, 0, 0], [0, 0, 0.1], 0.05) for link in ("link0", "link4", "hand")}
    assert len(Bodies.of(task.robot, capsules, [("panda_link0", "panda_link5")]).pairs) == 1
    assert len(Bodies.of(task.robot, capsules, [("panda_link0", "panda_hand")]).pairs) == 0
    with pytest.raises(InputError, match="'panda_link55'"):
        Bodies.of(task.robot, capsules, [("panda_link4", "panda_link55")])


def test_box_around_the_base_is_refused_by_name(task):
    scene = Scene([Box([0.0, 0.0, 0.2], [0.4, 0.4, 0.6], name="crate")])
    with pytest.raises((InputError, PlanError), match="'crate'"):
        plan(task, [[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], scene=scene, effort=1)


def test_ways_are_without_steps_that_jump_from_branch_to_branch(two_links):
    """Near the end of its reach the elbow is left or right, and steps that change sides cost nothing."""
    task = PositionTask(two_links, "link3", "xy")
    angles, half = np.linspace(0.0, 0.4, 5), np.arccos(0.95)
    nodes = [np.array([[a - half, a + half], [2.0 * half, -2.0 * half]]) for a in angles]
    Z = [1.9 * np.column_stack((np.cos(a), np.sin(a))) for a in (angles, angles + 0.05)]
    np.testing.assert_allclose([task.value(Q[:, 1]) for Q in nodes], Z[0], atol=1e-12)
    start, end = np.array([0, 1, 0, 1]), np.array([0, 0, 1, 1])
    steps = [Steps(start, end, (start == end).astype(float)) for _ in angles[1:]]
    problem = problem_of(Manifold(task), None, None, False, 0.0, 0.0, None, None, 1.0)
    find = partial(open_ways, nodes, steps, np.ones(2), 4, np.zeros(2))
    assert any((np.abs(np.diff(way, axis=0)) > 1.0).any() for way in find())
    found = unbroken(problem, find, nodes, steps, Z[1])
    assert len(found) == 2
    assert max(np.abs(np.diff(way, axis=0)).max() for way in found) < 0.11


def test_closed_way_is_the_best_of_all_that_end_where_they_begin():
    """Of random steps between layers of four postures; in some no way is closed."""
    met = set()
    for seed in range(30):
        random = np.random.default_rng(seed)
        nodes = [10.0 * np.arange(4)[None] + 1000.0 * k for k in range(4)]
        table = np.where(random.random((4, 4, 4)) < 0.7, np.inf, random.integers(9, size=(4, 4, 4)))
        steps = []
        for costs in table:
            end, start = np.nonzero(np.isfinite(costs.T))
            steps.append(Steps(start, end, costs[start, end]))
        best = min(sum(table[k][i[k], i[(k + 1) % 4]] for k in range(4)) for i in product(range(4), repeat=4))
        found = closed_ways(nodes, steps, np.ones(1), 1)
        met.add(bool(found))
        assert bool(found) == np.isfinite(best), seed
        for way in found:
            i = np.round((way[:, 0] - 1000.0 * np.arange(4)) / 10.0).astype(int)
            assert sum(table[k][i[k], i[(k + 1) % 4]] for k in range(4)) == best, seed
    assert met == {True, False}


@pytest.mark.parametrize(
    ("path", "options", "message"),
    [
        ([[0.5, 0.0, 0.4], [0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {}, "same"),
        ([[0.5, 0.0, 0.4], [0.5, float("nan"), 0.4]], {}, "finite"),
        ([[0.5, 0.0, 0.4]], {}, "two"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4], [0.5, 0.2, 0.4]], {"closed": True}, "clos"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {"scene": Scene()}, "empty"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {"times": [0.0, 0.0]}, "time"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {"margin": -1.0}, "margin"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {"joint_step": 0.0}, "step"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {"weights": 0.0}, "weights"),
        ([[0.5, 0.0, 0.4], [0.5, 0.1, 0.4]], {"start": np.zeros(7)}, "away from that point"),
    ],
)
def test_plan_refuses_arguments_that_cannot_be_used(task, path, options, message):
    with pytest.raises(InputError, match=message):
        plan(task, path, **options)


def test_closed_trajectory_has_no_end_of_its_own(task):
    with pytest.raises(InputError, match="give its start"):
        plan(task, circle([0.6, 0.0, 0.4], 0.1, period=4.0), end=np.zeros(7))
