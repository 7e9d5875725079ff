"""Self-motion manifolds: components by arc length, arcs within limits and clear of collision, coverings."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pinocchio as pin
import pytest
from checks import TAU, planar
from scipy.optimize import minimize
from scipy.stats import kstest

from eos_pin import InputError, PoseTask, PositionTask
from eos_pin.planning.manifolds.manifold import self_motion_manifold


@pytest.fixture
def arm():
    return planar(*[pin.JointModelRZ()] * 3)


@pytest.fixture
def pose(panda):
    return PoseTask(panda, "panda_hand_tcp")


def poses(task, count, seed=0):
    random = np.random.default_rng(seed)
    robot = task.robot
    return random.uniform(np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi), (count, robot.n))


def within(q, lower, upper, slack=0.0):
    return (q >= lower - slack).all() and (q <= upper + slack).all()


@pytest.mark.parametrize("z", [[1.5, 0.3], [0.4, -0.2], [2.6, 1.0]])
def test_components_of_a_planar_arm_are_as_many_as_its_theory_has(arm, z):
    """Links of 1, 1, 1: one closed curve beyond 1 from the base, two within it."""
    manifold = self_motion_manifold(PositionTask(arm, "tip", "xy"), z)
    assert len(manifold.components) == (2 if np.hypot(*z) < 1.0 else 1)
    assert all(component.closed for component in manifold.components)
    assert manifold.since_new >= 150
    assert manifold.missed(0.1) < 1e-6
    assert len(manifold.hits) == len(manifold.components)
    assert min(manifold.hits) >= 3
    assert sum(manifold.hits) == manifold.solved


def test_manifold_is_copied_and_pickled(pose):
    manifold = self_motion_manifold(pose, pose.value(poses(pose, 1)[0]))
    for again in (copy.deepcopy(manifold), pickle.loads(pickle.dumps(manifold))):
        assert again.components[0].kinematics.compiled == manifold.components[0].kinematics.compiled
        for one, other in zip(again.sampled(0.2), manifold.sampled(0.2), strict=True):
            np.testing.assert_array_equal(one, other)


def test_component_is_exact_at_any_arc_length(pose):
    q = poses(pose, 1)[0]
    z = pose.value(q)
    manifold = self_motion_manifold(pose, z)
    for component in manifold.components:
        s = np.linspace(-1.0, 2.5 * component.length, 200)
        Q = component.at(s)
        assert max(np.abs(pose.minus(z, pose.value(x))).max() for x in Q) <= 1e-9
        # Continuous, one unit of length for one of s, and whole turns from round to round.
        steps = np.linalg.norm(np.diff(component.at(np.linspace(0.0, 1.0, 101)), axis=0), axis=1)
        np.testing.assert_allclose(steps.sum(), 1.0, atol=1e-3)
        np.testing.assert_allclose(steps, 1e-2, rtol=0.05)
        np.testing.assert_allclose(
            component.at(0.3 + component.length), component.at(0.3) + TAU * component.winding, atol=1e-9
        )
        along = (component.at(0.7 + 1e-5) - component.at(0.7 - 1e-5)) / 2e-5
        np.testing.assert_allclose(component.tangent(0.7), along / np.linalg.norm(along), atol=1e-6)
        assert component.locate(component.at(0.4)).s == pytest.approx(0.4, abs=1e-3)
        assert component.locate(component.at(0.4)).distance <= 1e-9


def test_components_are_the_same_with_any_seed(pose):
    for q in poses(pose, 2, seed=3):
        z = pose.value(q)
        lengths = [
            sorted(component.length for component in self_motion_manifold(pose, z, seed=seed).components)
            for seed in range(3)
        ]
        for other in lengths[1:]:
            np.testing.assert_allclose(other, lengths[0], rtol=1e-4)


def test_state_on_a_thin_loop_is_on_it_whichever_strand_is_nearer():
    """Near the end of the reach the self-motion is a loop whose two strands are closer than its nodes."""
    robot = planar(*[pin.JointModelRZ()] * 3)
    task = PositionTask(robot, "tip", "xy")
    manifold = self_motion_manifold(task, [2.999, 0.0])
    assert len(manifold.components) == 1
    component = manifold.components[0]
    Q = component.at(np.linspace(0.0, component.length, 101))
    T = task.kinematics.tangents(Q, manifold.z)[0]
    assert component.passes(Q, T).all()
    assert max(component.locate(q).distance for q in Q) <= 1e-9


def test_turning_points_are_where_a_joint_turns_round(pose):
    component = self_motion_manifold(pose, pose.value(poses(pose, 1, seed=5)[0])).components[0]
    dense = np.linspace(0.0, component.length, 2001)
    Q = component.at(dense)
    for joint, turning in enumerate(component.turning):
        slope = np.diff(Q[:, joint])
        changes = dense[1:-1][slope[1:] * slope[:-1] < 0.0]
        if np.ptp(Q[:, joint]) < 1e-9:
            continue
        inner = turning[(turning > dense[2]) & (turning < dense[-3])]
        np.testing.assert_allclose(inner, changes[(changes > dense[2]) & (changes < dense[-3])], atol=0.02)
        if len(turning):
            assert np.abs(component.tangent(turning)[:, joint]).max() <= 1e-6


@pytest.mark.parametrize("seed", range(2))
def test_arcs_are_all_that_is_within_limits(pose, panda, seed):
    """Against a dense look at every component."""
    q = poses(pose, 1, seed=seed)[0]
    manifold = self_motion_manifold(pose, pose.value(q))
    covered = 0.0
    for number, component in enumerate(manifold.components):
        s = np.linspace(0.0, component.length, 801)[:-1]
        Q = component.at(s)
        middle = 0.5 * (panda.lower + panda.upper)
        wrapped = Q - TAU * np.round((Q - middle) / TAU)
        good = (wrapped >= panda.lower).all(axis=1) & (wrapped <= panda.upper).all(axis=1)
        arcs = [arc for arc in manifold.arcs if arc.component == number]
        assert sum(arc.length for arc in arcs) == pytest.approx(good.mean() * component.length, abs=0.03)
        covered += sum(arc.length for arc in arcs)
        for arc in arcs:
            inside = manifold.joints(arc, np.linspace(arc.start, arc.end, 50))
            assert within(inside, panda.lower, panda.upper)
            for end, cause in zip((arc.start, arc.end), arc.causes, strict=True):
                x = manifold.joints(arc, np.array([end]))[0]
                side, _, name = cause.partition(" limit of ")
                joint = component.kinematics.joint_names.index(name)
                limit = panda.lower if side == "lower" else panda.upper
                assert x[joint] == pytest.approx(limit[joint], abs=1e-9)
    assert covered > 0.0
    np.testing.assert_allclose(manifold.nearest(q), q, atol=1e-5)
    assert manifold.reasons


def test_arc_goes_round_as_often_as_limits_allow(arm):
    """A joint that winds once a round and may turn two and a half times."""
    task = PositionTask(arm, "tip", "xy")
    limits = np.array([-2.5 * np.pi, -10.0, -10.0]), np.array([2.5 * np.pi, 10.0, 10.0])
    manifold = self_motion_manifold(task, [0.05, 0.0], limits=limits)
    assert len(manifold.components) == 2
    for component in manifold.components:
        assert np.abs(component.winding).tolist() == [1, 0, 0]
    # Joints 2 and 3 stay near ±2π/3, and with ±10 each may be whole turns off: three values of each.
    assert len(manifold.arcs) == 2 * 3 * 3
    for arc in manifold.arcs:
        component = manifold.components[arc.component]
        Q = component.at(np.array([arc.start, arc.end])) + TAU * arc.shift
        assert np.abs(Q[1, 0] - Q[0, 0]) == pytest.approx(5.0 * np.pi, abs=1e-9)
        assert arc.length > 2.0 * component.length
        assert within(manifold.joints(arc, np.linspace(arc.start, arc.end, 100)), *limits)


def test_whole_component_is_one_closed_arc_without_limits(arm):
    task = PositionTask(arm, "tip", "xy")
    anything = np.full(3, np.inf)
    manifold = self_motion_manifold(task, [0.05, 0.0], limits=(-anything, anything))
    assert [arc.closed for arc in manifold.arcs] == [True, True]
    assert [arc.length for arc in manifold.arcs] == [component.length for component in manifold.components]
    assert [arc.causes for arc in manifold.arcs] == [("", "")] * 2


def test_open_component_ends_at_singularities(arm):
    anything = np.full(3, np.inf)
    manifold = self_motion_manifold(PositionTask(arm, "tip", "xy"), [1.0, 0.0], limits=(-anything, anything))
    assert all(component.curve.ends == ("singular", "singular") for component in manifold.components)
    ends = {cause for arc in manifold.arcs for cause in arc.causes}
    assert "singularity" in ends
    with pytest.raises(InputError, match="arc length"):
        manifold.components[0].at(-1.0)


@pytest.mark.parametrize("width", [0.3, 0.02, 1e-3, 1e-5])
def test_posture_is_found_where_limits_leave_a_small_arc(pose, panda, width):
    for q in poses(pose, 3, seed=7):
        limits = q - width, q + width
        manifold = self_motion_manifold(pose, pose.value(q), limits=limits, seeds=20, tries=60)
        assert not manifold.empty
        assert within(manifold.random(5), *limits)
        assert np.abs(manifold.nearest(q) - q).max() <= min(width, 1e-5)


def test_arcs_avoid_collision(pose):
    q = poses(pose, 1, seed=1)[0]
    z = pose.value(q)
    free = self_motion_manifold(pose, z, seeds=20, tries=60)

    def elbow(x):
        return pose.robot.placement(x, "panda_link4").translation[0]

    middle = np.median([elbow(x) for x in np.concatenate(free.sampled(0.1))])

    def elbow_low(x):
        return elbow(x) < middle

    clear = self_motion_manifold(pose, z, collision=elbow_low, seeds=20, tries=60)
    assert 0.0 < sum(arc.length for arc in clear.arcs) < sum(arc.length for arc in free.arcs)
    assert not any(elbow_low(x) for x in clear.random(200))
    assert any("collision" in arc.causes for arc in clear.arcs)
    dense = np.concatenate(free.sampled(0.01))
    share = np.mean([not elbow_low(x) for x in dense])
    found = sum(arc.length for arc in clear.arcs) / sum(arc.length for arc in free.arcs)
    assert found == pytest.approx(share, abs=0.01)


def test_random_postures_are_even_along_the_arcs(arm):
    manifold = self_motion_manifold(PositionTask(arm, "tip", "xy"), [0.4, -0.2], limits=([-3.0] * 3, [3.0, 2.0, 3.0]))
    arcs = manifold.arcs
    dense = [manifold.joints(arc, np.linspace(arc.start, arc.end, 401)) for arc in arcs]
    lengths = np.array([np.linalg.norm(np.diff(Q, axis=0), axis=1).sum() for Q in dense])
    drawn = manifold.random(1000)
    gaps = np.array([np.linalg.norm(drawn[:, None] - Q, axis=2) for Q in dense])
    assert gaps.min(axis=(0, 2)).max() < 0.02
    # Places along all arcs, one after the other, are uniform (Kolmogorov and Smirnov's test, 1e-4).
    arc, node = np.unravel_index(gaps.transpose(1, 0, 2).reshape(1000, -1).argmin(axis=1), gaps.shape[::2])
    place = (np.cumsum(lengths) - lengths + lengths * node[:, None] / 400.0)[np.arange(1000), arc] / lengths.sum()
    assert kstest(place, "uniform").pvalue > 1e-4


def test_best_posture_is_best(pose):
    manifold = self_motion_manifold(pose, pose.value(poses(pose, 1, seed=2)[0]), seeds=20, tries=60)

    def criterion(x):
        return float(np.sum(x * x))

    best = manifold.best(criterion)
    assert criterion(best) <= min(criterion(x) for x in np.concatenate(manifold.sampled(0.002))) + 1e-9
    np.testing.assert_allclose(manifold.nearest(np.zeros(7)), best, atol=1e-9)


def test_rail_and_arm_have_their_self_motion():
    robot = planar(pin.JointModelPX(), pin.JointModelRZ(), pin.JointModelRZ())
    task = PositionTask(robot, "tip", "xy")
    manifold = self_motion_manifold(task, [1.4, 0.3], limits=([-0.5, -np.inf, -np.inf], [0.5, np.inf, np.inf]))
    assert len(manifold.components) == 1
    assert len(manifold.arcs) == 2
    assert within(manifold.random(50)[:, 0], -0.5, 0.5)


def test_covering_of_two_redundant_joints_leaves_no_gaps():
    robot = planar(*[pin.JointModelRZ()] * 4)
    task = PositionTask(robot, "tip", "xy")
    z = np.array([1.5, 0.5])
    resolution = 0.8
    manifold = self_motion_manifold(task, z, resolution=resolution)
    cover = manifold.covering
    assert cover.complete
    assert within(cover.q, robot.lower, robot.upper)
    assert max(np.abs(task.value(q) - z).max() for q in cover.q) <= 1e-9
    gaps = np.linalg.norm(cover.q[:, None] - cover.q, axis=2) + 10.0 * np.eye(len(cover.q))
    assert gaps.min() >= 0.6 * resolution
    assert gaps.min(axis=1).max() <= 1.5 * resolution
    others = self_motion_manifold(task, z, resolution=1.2, seed=5, seeds=300).covering.q
    apart = np.linalg.norm(others[:, None] - cover.q, axis=2).min(axis=1)
    assert apart.max() <= resolution
    assert cover.chart(0).r == 2
    assert sum(map(len, cover.components)) == len(cover.q)
    i, j = cover.neighbours.T
    assert np.linalg.norm(cover.q[i] - cover.q[j], axis=1).max() <= 1.5 * resolution
    few = self_motion_manifold(task, z, resolution=resolution, most=20)
    assert len(few.covering.q) == 20
    assert not few.covering.complete
    # Posture by posture: one on the manifold is its own nearest; random ones lie between those of the covering.
    here = others[7]
    np.testing.assert_allclose(manifold.nearest(here), here, atol=1e-6)
    drawn = manifold.random(200, seed=2)
    assert within(drawn, robot.lower, robot.upper)
    assert max(np.abs(task.value(q) - z).max() for q in drawn) <= 1e-9
    apart = np.linalg.norm(drawn[:, None] - cover.q, axis=2).min(axis=1)
    assert apart.max() <= resolution
    assert np.median(apart) > 0.1 * resolution
    bounds = np.column_stack((robot.lower, robot.upper))
    tip = {"type": "eq", "fun": lambda q: task.value(q) - z}
    least = min(minimize(lambda q: q @ q, q, bounds=bounds, constraints=tip).fun for q in cover.q[::40])
    best = manifold.best(lambda q: float(q @ q))
    assert best @ best == pytest.approx(least, abs=1e-5)


def test_point_out_of_reach_has_no_posture(arm):
    manifold = self_motion_manifold(PositionTask(arm, "tip", "xy"), [4.0, 0.0], tries=100)
    assert manifold.empty
    assert manifold.components == ()
    with pytest.raises(InputError, match="no posture"):
        manifold.random(1)
    with pytest.raises(InputError, match="no posture"):
        manifold.nearest(np.zeros(3))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"limits": ([1.0, 0.0, 0.0], [0.0, 1.0, 1.0])}, "joint0 leave no room"),
        ({"limits": ([0.0, 0.0], [1.0, 1.0])}, "limits must be two vectors of 3"),
        ({"seeds": 0}, "at least 1"),
        ({"step": 0.0}, "step above 0"),
        ({"resolution": -1.0}, "resolution above 0"),
        ({"starts": [[0.0, 0.0]]}, "a start must be 3 numbers"),
    ],
)
def test_manifold_refuses_bad_arguments(arm, words, message):
    with pytest.raises(InputError, match=message):
        self_motion_manifold(PositionTask(arm, "tip", "xy"), [1.0, 0.2], **words)


def test_manifold_refuses_a_robot_without_redundancy(ur5):
    task = PoseTask(ur5, "tool0")
    with pytest.raises(InputError, match="no self-motion"):
        self_motion_manifold(task, task.value(np.zeros(6)))
