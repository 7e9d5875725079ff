"""Charts one after the other: cyclic inverse kinematics, Sec. 3.3, against the generalized inverse, Sec. 2.2."""

from __future__ import annotations

from itertools import pairwise

import checks
import numpy as np
import pinocchio as pin
import pytest
import scipy.integrate
from checks import EXACT, SOLVED, all_tasks, every_task
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import Atlas, Chart, InputError, PositionTask, Robot, SingularError, inverse_kinematics

HOME = np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8])


@pytest.fixture
def position(panda):
    return PositionTask(panda, "panda_hand_tcp")


def circle(center, radius, count, turns=1):
    """Points of a circle in the y-z plane that starts and ends at `center`."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, count)
    return center + radius * np.column_stack((0.0 * angle, np.sin(angle), 1.0 - np.cos(angle)))


def largest_step(path):
    return np.abs(np.diff(path.q, axis=0)).max()


#: Difference of two computations of one task error [m, rad].
ROUNDING = 1e-15


def check(atlas, path):
    """What holds on every path: the task is met, v is what it says on its chart, and charts carry v on."""
    for q, z, v, number in zip(path.q, path.z, path.v, path.chart, strict=True):
        error = np.abs(atlas.task.minus(atlas.task.value(q), z)).max()
        # The residual was computed at the same joints, to rounding.
        assert error <= max(path.residual, EXACT) + ROUNDING
        assert path.residual <= SOLVED
        # A chart that a point was found on may also be the one it was left for, right there.
        np.testing.assert_allclose(path.charts[number].v(q), v, atol=100 * EXACT)
    assert (np.diff(path.chart) >= 0).all()
    for old, new in pairwise(path.charts):
        np.testing.assert_allclose(new.v_bar, old.v(new.q_bar), atol=100 * EXACT)
        assert np.linalg.norm(new.V - old.V) <= np.linalg.norm(Chart.from_base(atlas.task, new.q_bar).V - old.V) + 1e-9
    for array in (path.q, path.z, path.v, path.chart):
        assert not array.flags.writeable


# -- cyclic on a chart, and drift of the generalized inverse -----------------------------------------------------------


def test_closed_path_is_cyclic_on_a_chart_and_drifts_by_the_pseudoinverse(position):
    points = circle(position.value(HOME), 0.12, 241, turns=3)
    atlas = Atlas(position)
    path = atlas.follow(HOME, points)
    check(atlas, path)
    assert path.complete
    assert len(path.charts) == 1
    assert np.abs(path.q[[80, 160, 240]] - path.q[0]).max() < 1e-9
    assert largest_step(path) < 0.05

    def velocity(s, q):
        dz = 0.12 * 2.0 * np.pi * np.array([0.0, np.cos(2 * np.pi * s), np.sin(2 * np.pi * s)])
        return np.linalg.pinv(position.linearize(q)[1]) @ dz

    drifting = scipy.integrate.solve_ivp(velocity, (0.0, 3.0), HOME, rtol=1e-9, atol=1e-9).y[:, -1]
    np.testing.assert_allclose(position.value(drifting), points[-1], atol=1e-6)
    assert np.abs(drifting - HOME).max() > 0.01


@checks.every(all_tasks())
def test_task_of_any_kind_goes_round_and_comes_back(task):
    """Out along a tangent and back, by another way: the same joints at the end as at the start."""
    random = np.random.default_rng(4)
    trials = (checks.random_state(task.robot, seed)[0] for seed in range(100))
    q = next(q for q in trials if np.linalg.cond(task.linearize(q)[1]) < 30)
    room = 0.1 * np.linalg.svd(task.linearize(q)[1], compute_uv=False)[-1]
    z, corners = task.value(q), room * random.normal(size=(2, task.m))
    path = Atlas(task).follow(q, [z, task.plus(z, corners[0]), task.plus(z, corners[1]), z])
    check(Atlas(task), path)
    assert path.complete
    assert len(path.charts) == 1
    np.testing.assert_allclose(path.q[[0, -1]], [q, q], atol=1e-8)


# -- several charts ----------------------------------------------------------------------------------------------------


def test_joints_move_continuously_through_several_charts(ppr):
    """v grows by more than one chart holds: y3 of the ppr robot turns several times."""
    task = every_task(ppr)["position xy"]
    atlas, count = Atlas(task), 400
    points = np.tile(task.value(np.zeros(3)), (count, 1))
    path = atlas.follow(np.zeros(3), points, v=np.linspace(0.0, 12.0, count)[:, None])
    check(atlas, path)
    assert path.complete
    assert len(path.charts) > 5
    assert largest_step(path) < 0.1
    # The tip stands still, so along the way dv = Vᵀ dq with V the null space: y3 grows for good.
    assert (np.diff(path.q[:, 2]) > 0.0).all()
    assert path.q[-1, 2] > 2.0 * np.pi


@pytest.mark.parametrize("threshold", [0.3, 0.5, 0.9])
def test_path_across_the_workspace_is_followed(panda, position, threshold):
    start = position.value(HOME)
    corners = [start, [0.1, 0.5, 0.5], [-0.4, 0.2, 0.6], [0.1, -0.5, 0.3], start]
    points = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(corners)])
    atlas = Atlas(position, threshold=threshold)
    path = atlas.follow(HOME, points)
    check(atlas, path)
    assert path.complete
    assert len(path.charts) > 1
    assert largest_step(path) < 0.4


def test_paths_of_two_thresholds_are_close_where_steps_are_small(ppr):
    """Between charts dv = Vᵀ dq is measured along slightly different directions; with fine steps it hardly matters."""
    task = every_task(ppr)["position xy"]
    angle = np.linspace(0.0, 1.0, 200)[:, None]
    points = task.value(np.zeros(3)) + angle * [1.0, 0.5]
    ends = [Atlas(task, threshold=threshold).follow(np.zeros(3), points).q[-1] for threshold in (0.3, 0.5, 0.7)]
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=1e-8)


def test_worn_chart_is_replaced_where_it_fails(ppr):
    """The chart of y3 = 0 ends at y3 = π: handed over at 3.1 it cannot make the first step on, its successor can."""
    task = every_task(ppr)["position xy"]
    chart, q = Chart.from_base(task, np.zeros(3)), np.array([0.0, 0.0, 3.1])
    path = Atlas(task).follow(q, [task.value(q)], v=chart.v(q) + 1.0, chart=chart)
    check(Atlas(task), path)
    assert path.complete
    assert path.charts[0] is chart
    assert path.q[0, 2] > np.pi


def test_atlas_follow_walks_to_a_far_first_point(position):
    """The path need not start where the robot is, and its points may lie far apart."""
    goals = np.array([[0.3, 0.45, 0.4], [0.4, -0.4, 0.6]])
    path = Atlas(position).follow(HOME, goals)
    check(Atlas(position), path)
    assert path.complete
    assert path.iterations > 4


# -- v along the path --------------------------------------------------------------------------------------------------


def test_v_is_a_constant_an_array_or_a_function(position):
    points = circle(position.value(HOME), 0.05, 9)
    atlas = Atlas(position)
    still = atlas.follow(HOME, points)
    np.testing.assert_array_equal(still.v, 0.0)
    for v in ([0.1, 0.0, -0.1, 0.05], np.tile([0.1, 0.0, -0.1, 0.05], (9, 1)), lambda k: [0.1, 0.0, -0.1, 0.05]):
        path = atlas.follow(HOME, points, v=v)
        check(atlas, path)
        np.testing.assert_array_equal(path.v, np.tile([0.1, 0.0, -0.1, 0.05], (9, 1)))
    moving = atlas.follow(HOME, points, v=lambda k: 0.02 * k * np.ones(4))
    check(atlas, moving)
    np.testing.assert_allclose(moving.v[:, 2], 0.02 * np.arange(9), atol=EXACT)
    np.testing.assert_array_equal(atlas.follow(HOME, list(points)).q, still.q)
    np.testing.assert_array_equal(atlas.follow(HOME, iter(points)).q, still.q)


def test_path_may_go_on_from_the_chart_of_another(position):
    points = circle(position.value(HOME), 0.1, 21)
    atlas = Atlas(position)
    whole = atlas.follow(HOME, points)
    half = atlas.follow(HOME, points[:11])
    rest = atlas.follow(half.q[-1], points[11:], chart=half.charts[-1])
    np.testing.assert_allclose(np.vstack((half.q, rest.q)), whole.q, atol=1e-8)
    np.testing.assert_allclose(rest.v, whole.v[11:], atol=1e-12)


def test_atlas_follow_without_redundancy_is_inverse_kinematics(ur5):
    task = every_task(ur5)["pose"]
    q = np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.2])
    z = task.value(q)
    out = task.plus(z, np.array([0.05, -0.05, 0.1, 0.3, -0.2, 0.1]))
    path = Atlas(task).follow(q, [z, out, z])
    check(Atlas(task), path)
    assert path.v.shape == (3, 0)
    np.testing.assert_allclose(path.q[-1], q, atol=1e-8)


# -- what cannot be done -----------------------------------------------------------------------------------------------


def test_atlas_follow_ends_where_path_leaves_workspace(position):
    points = np.linspace(position.value(HOME), [1.5, 0.0, 0.3], 30)
    atlas = Atlas(position)
    path = atlas.follow(HOME, points)
    check(atlas, path)
    assert not path.complete
    assert 0 < len(path.q) < 30
    assert f"point {len(path.q)} of 30 was not reached" in path.message
    # The last point found is close to the farthest that the arm can do.
    assert np.linalg.norm(points[len(path.q)] - [0.0, 0.0, 0.333]) > 0.75
    assert len(path.q) == len(path.z) == len(path.v) == len(path.chart)


def test_atlas_follow_is_empty_when_first_point_is_out_of_reach(position):
    path = Atlas(position).follow(HOME, [[5.0, 0.0, 0.0]])
    assert path.q.shape == (0, 7)
    assert path.v.shape == (0, 4)
    assert "point 0 of 1" in path.message


def test_empty_path_is_complete(position):
    path = Atlas(position).follow(HOME, np.zeros((0, 3)))
    assert path.complete
    assert path.q.shape == (0, 7)


@pytest.mark.parametrize(
    "wrong",
    [
        {"path": np.zeros((4, 2))},
        {"path": np.zeros((4, 3, 1))},
        {"path": np.full((2, 3), np.nan)},
        {"path": [[0.0, 0.0, "a"]]},
        {"path": [[0.0, 0.0, 0.0], [0.0, 0.0]]},
        {"v": np.zeros((3, 4))},
        {"v": np.zeros((2, 3))},
        {"v": np.zeros(3)},
        {"v": np.full((2, 4), np.inf)},
        {"v": "abc"},
        {"v": lambda k: np.zeros(5)},
        {"q": np.zeros(6)},
        {"q": np.full(7, np.nan)},
    ],
    ids=lambda wrong: "-".join(wrong),
)
def test_wrong_shapes_are_refused(position, wrong, unchecked):
    arguments = {"q": HOME, "path": np.tile(position.value(HOME), (2, 1))} | wrong
    with pytest.raises(InputError):
        Atlas(position).follow(arguments.pop("q"), arguments.pop("path"), **arguments)


def test_singular_start_is_an_error(ur5):
    task = every_task(ur5)["pose"]
    with pytest.raises(SingularError):
        Atlas(task).follow(np.zeros(6), [task.value(np.zeros(6))])


@pytest.mark.parametrize("threshold", [0.0, 1.0, -0.5, 2.0, np.nan, np.inf])
def test_threshold_lies_between_0_and_1(position, threshold):
    with pytest.raises(InputError, match="threshold must be"):
        Atlas(position, threshold=threshold)


def test_charts_follow_each_other_by_the_rule(ppr):
    """A chart is left where the margin falls to the threshold: (1 + cos a) / 2 for this robot."""
    task = every_task(ppr)["position xy"]
    atlas = Atlas(task, threshold=0.5)
    chart = atlas.start([0.0, 0.0, 0.0])
    assert (chart.v_bar == 0.0).all()
    for turn, holds in ((0.0, True), (1.5, True), (1.6, False), (-1.5, True), (-1.6, False), (np.pi, False)):
        assert atlas.holds(chart, task.linearize(np.array([0.0, 0.0, turn]))[1]) == holds
    q = np.array([0.3, 0.4, 1.6])
    following = atlas.next(chart, q)
    np.testing.assert_allclose(following.v(q), chart.v(q), atol=EXACT)
    assert atlas.holds(following, task.linearize(q)[1])


# -- one point, by whatever way ----------------------------------------------------------------------------------------


def reachable(task, count):
    """Task points of postures within the limits."""
    random, robot = np.random.default_rng(0), task.robot
    least, most = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return [task.value(random.uniform(least, most)) for _ in range(count)]


def start_of(robot):
    return HOME if robot.n == 7 else np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.2])


@pytest.mark.parametrize("points", [1, 2])
@pytest.mark.parametrize("kind", ["position xyz", "pose"])
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_reachable_points_are_reached_within_limits(request, name, kind, points):
    robot = request.getfixturevalue(name)
    task = every_task(robot)[kind]
    frame, data, ways = robot.model.getFrameId(task.frame), robot.model.createData(), set()
    for z in reachable(task, 40):
        reached = Atlas(task).solve(start_of(robot), z, points=points)
        assert reached.found
        assert reached.within_limits
        assert ((robot.lower <= reached.q) & (reached.q <= robot.upper)).all()
        assert not reached.q.flags.writeable
        assert reached.residual <= SOLVED
        assert (reached.path is None) == (reached.strategy == "search")
        pin.framesForwardKinematics(robot.model, data, reached.q)
        placement = data.oMf[frame]
        np.testing.assert_allclose(placement.translation, z[:3], atol=SOLVED)
        if kind == "pose":
            np.testing.assert_allclose(placement.rotation.ravel(), z[3:], atol=SOLVED)
        ways.add(reached.strategy)
    assert ways == {"search"} if points == 1 else len(ways) > 1


def test_walks_and_detours_are_continuous_and_end_at_v(panda):
    task = every_task(panda)["pose"]
    atlas, seen = Atlas(task), set()
    for z in reachable(task, 12):
        reached = atlas.solve(HOME, z, v=[0.2], points=400)
        assert reached.strategy != "search"
        if not reached.found:
            continue
        check(atlas, reached.path)
        np.testing.assert_array_equal(reached.path.q[[0, -1]], [HOME, reached.q])
        np.testing.assert_allclose(reached.path.charts[-1].v(reached.q), 0.2, atol=100 * EXACT)
        np.testing.assert_allclose(task.value(reached.q), z, atol=SOLVED)
        # Near singularities the joints hurry, but none turns over.
        assert largest_step(reached.path) < 1.0
        assert len(reached.path.q) == {"continuation": 401, "via": 801}[reached.strategy]
        seen.add(reached.strategy)
    assert seen == {"continuation", "via"}


def test_walk_is_the_same_as_follow(position):
    goal = [0.3, 0.45, 0.4]
    reached = Atlas(position).solve(HOME, goal, strategies=["continuation"])
    assert reached.strategy == "continuation"
    np.testing.assert_allclose(reached.q, Atlas(position).follow(HOME, [goal]).q[-1], atol=1e-9)


def test_seed_determines_the_joints_found(panda):
    task = every_task(panda)["pose"]
    for z in reachable(task, 10):
        one, same = (Atlas(task).solve(HOME, z, strategies=["search"], seed=3) for _ in range(2))
        np.testing.assert_array_equal(one.q, same.q)


@pytest.mark.parametrize(
    "form", [lambda pose: pose, lambda pose: pose.homogeneous, lambda pose: pose.homogeneous.tolist()]
)
def test_atlas_takes_poses_in_every_form(panda, form):
    task = every_task(panda)["pose"]
    start, atlas = panda.placement(HOME, task.frame), Atlas(task)
    poses = [start * pin.SE3(pin.exp3(np.array([0.0, 0.0, s])), np.array([0.0, s, 0.0])) for s in (0.0, 0.02, 0.05)]
    found = atlas.follow(HOME, [form(pose) for pose in poses])
    same = atlas.follow(HOME, np.array([task.point(pose) for pose in poses]))
    np.testing.assert_array_equal(found.q, same.q)
    options = {"strategies": ["continuation"]}
    for solution in (
        atlas.solve(HOME, form(poses[-1]), **options),
        inverse_kinematics(task, form(poses[-1]), HOME, **options),
    ):
        np.testing.assert_allclose(solution.q, found.q[-1], atol=1e-8)
        assert panda.placement(solution.q, task.frame).isApprox(poses[-1], 1e-9)


def test_atlas_refuses_a_path_that_is_no_sequence_of_points(panda, position, unchecked):
    pose = every_task(panda)["pose"]
    for task, path, message in (
        (pose, panda.placement(HOME, pose.frame), "sequence of task points"),
        (position, 0.5, "sequence of task points"),
        (position, [pin.SE3.Identity()], "must be 3 numbers"),
        (pose, np.zeros((2, 3)), "shape"),
        (pose, np.zeros((2, 4, 4)), "last row"),
    ):
        with pytest.raises(InputError, match=message):
            Atlas(task).follow(HOME, path)


def test_pose_is_taken_as_a_matrix(panda):
    task = every_task(panda)["pose"]
    z = task.plus(task.value(HOME), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.3]))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = z[3:].reshape(3, 3), z[:3]
    np.testing.assert_allclose(Atlas(task).solve(HOME, matrix).q, Atlas(task).solve(HOME, z).q, atol=1e-9)


def test_joints_beyond_their_limits_are_the_last_resort(panda):
    """With hardly any room within the limits there is a solution beyond them only, and the motion to it comes first."""
    model = panda.model.copy()
    model.lowerPositionLimit, model.upperPositionLimit = HOME - 0.1, HOME + 0.1
    task = PositionTask(Robot(model), "panda_hand_tcp")
    atlas, z = Atlas(task), task.value(HOME + 0.5)
    walked, jumped = (atlas.solve(HOME, z, strategies=ways, tries=5) for ways in (None, ["search"]))
    assert (walked.strategy, jumped.strategy) == ("continuation", "search")
    for reached in (walked, jumped):
        assert reached.found
        assert not reached.within_limits
        np.testing.assert_allclose(task.value(reached.q), z, atol=SOLVED)


def test_jump_leaves_a_singular_start(ur5):
    task, start = every_task(ur5)["pose"], np.zeros(6)
    z = task.value(start_of(ur5))
    reached = Atlas(task).solve(start, z)
    assert reached.found
    assert reached.strategy == "search"
    alone = Atlas(task).solve(start, z, strategies=["continuation"])
    assert not alone.found
    assert "rank" in alone.message
    np.testing.assert_array_equal(alone.q, start)


def test_atlas_solve_reports_target_out_of_reach(position):
    """The joints that are returned are nearer than any of a thousand postures."""
    z = np.array([2.0, 0.0, 0.333])
    reached = Atlas(position).solve(HOME, z, tries=10)
    assert not reached.found
    assert reached.within_limits
    assert f"the best of 11 starts misses the task point by {reached.residual:.3g}" in reached.message
    others = [np.linalg.norm(z - other) for other in reachable(position, 1000)]
    assert np.linalg.norm(z - position.value(reached.q)) < min(others)
    walked = Atlas(position).solve(HOME, z, strategies=["continuation", "via"])
    assert not walked.found
    assert "straight line" in walked.message


def search(task, q, z, bounds):
    found = task.kinematics.project(q[None], z, lower=bounds[0], upper=bounds[1])
    return found.q[0], found.residual[0]


@given(data=st.data())
def test_search_keeps_its_bounds(panda, data):
    task = every_task(panda)["pose"]
    seed, width = data.draw(st.integers(0, 2**32 - 1)), data.draw(st.floats(0.0, 3.0))
    random = np.random.default_rng(seed)
    middle, q = random.uniform(-2.0, 2.0, (2, 7))
    bounds = middle - width, middle + width
    z = task.value(random.uniform(*bounds))
    q_found, residual = search(task, q, z, bounds)
    assert ((bounds[0] <= q_found) & (q_found <= bounds[1])).all()
    assert residual == pytest.approx(np.abs(task.minus(z, task.value(q_found))).max(), abs=EXACT)
    nearest = np.clip(q, *bounds)
    # Downhill in the sum of squares, so at most √6 times as far by the largest entry.
    assert residual <= 2.5 * np.abs(task.minus(z, task.value(nearest))).max() + ROUNDING


def test_search_without_a_way_downhill_ends(ur5):
    """Stretched out towards the target no joint brings the tip nearer; with all joints at their bounds none may."""
    task = every_task(ur5)["position xyz"]
    q = np.zeros(6)
    z = task.value(q) * [3.0, 1.0, 1.0]
    anywhere = np.full(6, np.inf)
    assert search(task, q, z, (q, q))[1] == pytest.approx(np.abs(z - task.value(q)).max(), abs=EXACT)
    assert np.isfinite(search(task, q, z, (-anywhere, anywhere))[0]).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"q": np.zeros(6)},
        {"z": [0.1, 0.2]},
        {"z": [np.nan, 0.0, 0.0]},
        {"v": np.zeros(3)},
        {"strategies": []},
        {"strategies": ["fly"]},
        {"points": 0},
        {"tries": -1},
    ],
    ids=lambda wrong: "-".join(wrong),
)
def test_atlas_solve_refuses_wrong_arguments(position, wrong, unchecked):
    arguments = {"q": HOME, "z": [0.4, 0.1, 0.5]} | wrong
    with pytest.raises(InputError):
        Atlas(position).solve(arguments.pop("q"), arguments.pop("z"), **arguments)
