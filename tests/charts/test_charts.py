"""Charts: the identities of Sec. 3, the inverse kinematic map, where a chart ends, and how v is carried on."""

from __future__ import annotations

import checks
import numpy as np
import pytest
import scipy.linalg
from checks import EXACT, SOLVED, all_tasks, every_task, exact
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.linalg import lapack

from eos_pin import (
    Chart,
    ChartError,
    InputError,
    InverseError,
    SingularError,
)
from eos_pin.charts import _basis, directions
from eos_pin.charts import chart as charts
from eos_pin.control import _regularize as linear

TASKS = all_tasks()
every = checks.every(TASKS)
seeds = st.integers(0, 2**32 - 1)
HOME = (0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8)  # panda, elbow bent
WORST = 1e3  # condition number of G' up to which configurations are tried


def regular(data, task):
    """A configuration at which the task is not close to singular."""
    q = data.draw(checks.joints(task.robot))
    assume(np.linalg.cond(task.linearize(q)[1]) < WORST)
    return q


def near(data, chart, distance=0.3, margin=0.3):
    """A configuration well inside the chart."""
    q = chart.q_bar + data.draw(checks.numbers(chart.n, distance))
    J = chart.task.linearize(q)[1]
    assume(np.linalg.cond(J) < WORST)
    assume(chart.margin(J) > margin)
    return q


def room(chart):
    """A chart is as large as the smallest singular value of G' allows."""
    return min(1.0, np.linalg.svd(chart.U, compute_uv=False)[-1])


# -- identities ------------------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_chart_has_the_parts_of_equation_10(task, data):
    chart = Chart.from_base(task, regular(data, task))
    n, m = task.robot.n, task.m
    z, J = task.linearize(chart.q_bar)
    assert (chart.n, chart.m, chart.r) == (n, m, n - m)
    assert [a.shape for a in (chart.U, chart.V, chart.B_bar)] == [(n, m), (n, n - m), (m, m)]
    np.testing.assert_array_equal(chart.z_bar, z)
    np.testing.assert_array_equal(chart.U, J.T)
    np.testing.assert_array_equal(chart.v_bar, 0.0)
    np.testing.assert_allclose(chart.V.T @ chart.V, np.eye(n - m), atol=EXACT)
    np.testing.assert_allclose(J @ chart.V, 0.0, atol=EXACT * np.linalg.norm(J))
    np.testing.assert_allclose(chart.B_bar @ (J @ J.T), np.eye(m), atol=exact(J @ J.T))
    for array in (chart.q_bar, chart.z_bar, chart.v_bar, chart.U, chart.V, chart.B_bar, chart.Vt):
        assert not array.flags.writeable


@every
@given(data=st.data())
def test_configuration_is_given_by_its_coordinates(task, data):
    """Eq. (11): q = q_bar + V (v − v_bar) − U u, on the chart or not."""
    first = Chart.from_base(task, regular(data, task))
    chart = Chart.from_base(task, near(data, first), previous=first)
    q = data.draw(checks.joints(task.robot))
    tolerance = exact(chart.U, chart.U, scale=np.abs(q).max())
    np.testing.assert_allclose(chart.q(chart.v(q), chart.u(q)), chart.unwrap(q), atol=tolerance)
    np.testing.assert_allclose(chart.u(chart.q_bar), 0.0, atol=EXACT)
    np.testing.assert_allclose(chart.v(chart.q_bar), chart.v_bar, atol=10 * EXACT)


@every
@given(data=st.data())
def test_chart_point_has_velocities_and_accelerations_of_the_task(task, data):
    """Eqs. (15)–(20) at a state of the robot."""
    chart = Chart.from_base(task, regular(data, task))
    q, dq, ddq = near(data, chart), data.draw(checks.velocities(task.robot)), data.draw(checks.velocities(task.robot))
    point = chart.point(q, dq)
    J, identity = point.task.J, np.eye(chart.n)
    tolerance = exact(point.H_inverse, scale=np.abs(point.task.drift).max())
    np.testing.assert_array_equal(point.H_inverse, np.vstack((J, chart.V.T)))
    np.testing.assert_allclose(point.H @ point.H_inverse, identity, atol=tolerance * np.linalg.norm(J))
    np.testing.assert_allclose(point.H_inverse @ point.H, identity, atol=tolerance * np.linalg.norm(J))
    np.testing.assert_allclose(J @ chart.U @ point.B, np.eye(chart.m), atol=exact(J @ chart.U))
    np.testing.assert_allclose(J @ point.D, 0.0, atol=tolerance * np.linalg.norm(J))
    np.testing.assert_allclose(chart.V.T @ point.D, np.eye(chart.r), atol=tolerance)
    np.testing.assert_allclose(point.dw, point.H_inverse @ dq, atol=tolerance)
    np.testing.assert_allclose(point.H @ point.dw, dq, atol=10 * tolerance)
    ddw = point.H_inverse @ ddq + np.r_[point.task.drift, np.zeros(chart.r)]
    np.testing.assert_allclose(point.H @ ddw + point.E, ddq, atol=10 * tolerance)
    np.testing.assert_allclose(point.v, chart.v(q), atol=EXACT)


@every
@given(data=st.data())
def test_acceleration_needs_neither_h_nor_e(task, data):
    """Both of its forms, up to n = 16 and above, are H ddw + E."""
    chart = Chart.from_base(task, regular(data, task))
    point = chart.point(near(data, chart), data.draw(checks.velocities(task.robot)))
    ddw = data.draw(checks.numbers(chart.n))
    expected = point.H @ ddw + point.E
    tolerance = 10 * exact(point.H_inverse, scale=np.abs(expected).max())
    arguments = point.task.J, ddw[: chart.m] - point.task.drift, ddw[chart.m :]
    np.testing.assert_allclose(chart.acceleration(*arguments), expected, atol=tolerance)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(directions, "DENSE", 0)
        np.testing.assert_allclose(chart.acceleration(*arguments), expected, atol=tolerance)


@every
def test_h_is_the_derivative_of_the_joints_by_z_and_v(task):
    """The columns of H are ∂y/∂z and ∂y/∂v: finite differences of the inverse kinematic map itself."""
    chart = Chart.from_base(task, _regular_state(task))
    q = chart.q_bar + 0.05 * np.random.default_rng(5).normal(size=chart.n)
    z, v, step = task.value(q), chart.v(q), 1e-4
    here = chart.inverse(z, v, tol=1e-13)
    H = chart.point(q, np.zeros(chart.n)).H
    for k, unit in enumerate(np.eye(chart.n)):
        dz, dv = step * unit[: chart.m], step * unit[chart.m :]
        ahead, behind = (chart.inverse(task.plus(z, s * dz), v + s * dv, start=here, tol=1e-13).q for s in (1.0, -1.0))
        slope = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(slope, H[:, k], atol=1e-6 * max(1.0, np.abs(H).max() ** 3))


def _regular_state(task, seed=0):
    random = np.random.default_rng(seed)
    lower, upper = np.clip(task.robot.lower, -3, 3), np.clip(task.robot.upper, -3, 3)
    trials = (random.uniform(lower, upper) for _ in range(100))
    return next(q for q in trials if np.linalg.cond(task.linearize(q)[1]) < 30)


@given(seed=seeds)
def test_random_robots_have_charts(seed):
    """5 to 12 joints, prismatic and revolute mixed, with random axes, offsets and inertias."""
    robot = checks.random_chain(seed)
    q, dq = checks.random_state(robot, seed)
    for task in every_task(robot).values():
        J = task.linearize(q)[1]
        if np.linalg.cond(J) > WORST:
            continue
        chart = Chart.from_base(task, q)
        moved = q + 0.1 * room(chart) * dq
        point = chart.point(moved, dq)
        np.testing.assert_allclose(J, checks.numeric_jacobian(task, q), atol=checks.DIFFERENCED)
        tolerance = exact(point.H, scale=np.abs(J).max())
        np.testing.assert_allclose(point.H @ point.H_inverse, np.eye(robot.n), atol=tolerance)
        np.testing.assert_allclose(point.H @ point.dw, dq, atol=tolerance)
        found = chart.inverse(task.value(moved), chart.v(moved))
        np.testing.assert_allclose(found.q, moved, atol=2 * SOLVED * np.linalg.norm(point.H, 2) * task.m)


# -- B ---------------------------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_b_by_iteration_is_b_by_solve(task, data):
    """Eq. (21), started from the value at a point nearby."""
    chart = Chart.from_base(task, regular(data, task))
    J = task.linearize(near(data, chart, distance=0.1 * room(chart)))[1]
    B = chart.B(J)
    condition = np.linalg.cond(J @ chart.U)
    assume(np.abs(J @ chart.U @ chart.B_bar - np.eye(chart.m)).sum() < 0.9)  # where the iteration contracts
    iterated = chart.B(J, chart.B_bar, tol=1e-12 * condition)
    np.testing.assert_allclose(iterated, B, atol=1e-10 * condition * np.abs(B).max())


@pytest.mark.parametrize("factor", [-1.0, 2.5, 1e9])
def test_iteration_for_b_that_diverges_is_an_error(panda, factor):
    chart = Chart.from_base(every_task(panda)["pose"], checks.random_state(panda)[0])
    with pytest.raises(ChartError, match="diverges"):
        chart.B(chart.U.T, factor * chart.B_bar)


def test_b_has_quadratic_convergence(panda):
    """The residual that iteration (21) leaves is the square of the one before, so few iterations do."""
    chart = Chart.from_base(every_task(panda)["position xyz"], checks.random_state(panda)[0])
    GU, B, residuals = chart.U.T @ chart.U, 0.9 * chart.B_bar, []
    for tol in (0.2, 0.02, 2e-4, 2e-8):
        B = chart.B(chart.U.T, B, tol=tol)
        residuals.append(np.linalg.norm(GU @ B - np.eye(chart.m), 2))
    np.testing.assert_allclose(residuals, [1e-1, 1e-2, 1e-4, 1e-8], rtol=1e-6)


# -- the inverse kinematic map ---------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_h_recovers_the_joints(task, data):
    """Eq. (13): on its chart a configuration is the one that has its (z, v)."""
    chart = Chart.from_base(task, regular(data, task))
    q = near(data, chart, distance=0.1 * room(chart), margin=0.8)
    z, v = task.value(q), chart.v(q)
    found = chart.inverse(z, v)
    tolerance = 2 * SOLVED * np.linalg.norm(np.linalg.inv(np.vstack((task.linearize(q)[1], chart.V.T))), 2)
    assert found.residual <= SOLVED
    np.testing.assert_allclose(found.q, q, atol=tolerance)
    np.testing.assert_allclose(found.q, chart.q(v, found.u), atol=exact(chart.U, scale=10.0))
    np.testing.assert_allclose(chart.v(found.q), v, atol=10 * EXACT)


@every
def test_constant_and_refreshed_b_find_the_same(task):
    """Eq. (22) with B kept from the start, and with B computed anew in each step."""
    chart = Chart.from_base(task, _regular_state(task))
    random = np.random.default_rng(1)
    for _ in range(5):
        q = chart.q_bar + random.uniform(-0.01, 0.01, chart.n)
        arguments = task.value(q), chart.v(q)
        refreshed = chart.inverse(*arguments)
        constant = chart.inverse(*arguments, refresh=False, max_iterations=50)
        tolerance = 2 * SOLVED * np.linalg.norm(np.linalg.inv(np.vstack((task.linearize(q)[1], chart.V.T))), 2)
        np.testing.assert_allclose(constant.q, refreshed.q, atol=2 * tolerance)
        assert refreshed.iterations <= 4


@every
def test_warm_start_needs_few_steps(task):
    chart = Chart.from_base(task, _regular_state(task))
    direction = np.random.default_rng(2).normal(size=chart.n)
    known = None
    for reached in np.linspace(0.0, 0.02, 11):
        q = chart.q_bar + reached * direction
        known = chart.inverse(task.value(q), chart.v(q), start=known)
        assert known.iterations <= 3
        np.testing.assert_allclose(chart.v(known.q), chart.v(q), atol=10 * EXACT)


@pytest.mark.parametrize(
    ("name", "size"), [("position xyz", 0.15), ("pose", 0.15), ("orientation", 0.5), ("com xyz", 0.05)]
)
def test_long_step_finds_the_connected_solution(panda, name, size):
    """What one call finds is what fifty small steps along the straight line in (z, v) lead to; none is missed."""
    task, random = every_task(panda)[name], np.random.default_rng(7)
    found = 0
    for seed in range(12):
        chart = Chart.from_base(task, _regular_state(task, seed))
        delta, v = random.uniform(-size, size, task.m), 0.1 * random.normal(size=chart.r)
        goal = task.plus(chart.z_bar, delta), v
        step = None
        try:
            for s in np.linspace(0.02, 1.0, 50):
                step = chart.inverse(task.plus(chart.z_bar, s * delta), s * v, start=step, walking=False)
        except InverseError:
            with pytest.raises(InverseError):
                chart.inverse(*goal)
            continue
        tolerance = 4 * SOLVED * np.linalg.norm(chart.point(step.q, np.zeros(7)).H, 2)
        np.testing.assert_allclose(chart.inverse(*goal).q, step.q, atol=tolerance)
        found += 1
    assert found >= 3


def test_walking_reaches_points_where_newton_alone_fails(panda):
    """Targets half a metre away: walking finds all that Newton's method finds in one go, and more."""
    task, random = every_task(panda)["position xyz"], np.random.default_rng(0)
    chart = Chart.from_base(task, HOME)
    at_once, walked = set(), set()
    for k in range(40):
        z = chart.z_bar + random.uniform(-0.5, 0.5, 3)
        for found, walking in ((at_once, False), (walked, True)):
            try:
                q = chart.inverse(z, chart.v_bar, walking=walking).q
            except InverseError:
                continue
            np.testing.assert_allclose(task.value(q), z, atol=SOLVED)
            np.testing.assert_allclose(chart.v(q), chart.v_bar, atol=10 * EXACT)
            found.add(k)
    assert at_once < walked


@pytest.mark.parametrize("refresh", [True, False])
def test_point_out_of_reach_is_an_error_with_its_data(panda, refresh):
    task = every_task(panda)["position xyz"]
    chart = Chart.from_base(task, HOME)
    with pytest.raises(InverseError, match="out of reach") as caught:
        chart.inverse(np.array([2.0, 0.0, 0.5]), np.zeros(4), refresh=refresh)
    assert caught.value.iterations > 0
    # The arm reaches 0.855 m from its shoulder, at most.
    assert 0.8 < caught.value.residual < 2.0


def test_chart_inverse_refuses_a_point_that_is_not_finite(panda):
    chart = Chart.from_base(every_task(panda)["position xyz"], HOME)
    with pytest.raises(InputError, match="must be finite"):
        chart.inverse(np.array([np.nan, 0.0, 0.5]), np.zeros(4))
    with pytest.raises(InputError, match="v must be finite"):
        chart.inverse(chart.z_bar, np.full(4, np.nan))


def test_solution_beyond_the_edge_is_not_taken(ur5):
    """Newton's method may jump to joints where det G'U < 0; they have the (z, v) asked for, but on another sheet."""
    task, found = every_task(ur5)["position xyz"], 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        chart = Chart.from_base(task, checks.random_state(ur5, seed)[0])
        try:
            q = chart.inverse(chart.z_bar + random.uniform(-0.5, 0.5, 3), chart.v_bar, walking=False).q
        except InverseError:
            continue
        assert np.linalg.det(task.linearize(q)[1] @ chart.U) > 0.0
        found += 1
    assert found > 10


@given(turn=st.floats(-6.0, 6.0))
def test_solution_on_the_chart_is_the_one_with_positive_determinant(ppr, turn):
    """(z, v) fix y3 + sin y3 of this robot, so beyond y3 = π its solution is off the chart of y3 = 0."""
    task = every_task(ppr)["position xy"]
    chart = Chart.from_base(task, np.zeros(3))
    q = np.array([0.3, -0.2, turn])
    assume(abs(abs(turn) - np.pi) > 0.3)
    if abs(turn) < np.pi:
        np.testing.assert_allclose(chart.inverse(task.value(q), chart.v(q)).q, q, atol=1e3 * SOLVED)
    else:
        # v as if the joint had turned that far on this chart.
        with pytest.raises(InverseError):
            chart.inverse(task.value(q), chart.V.T @ q)


# -- r = 0 -----------------------------------------------------------------------------------------------------------


def test_chart_without_redundancy_is_inverse_kinematics(ur5):
    task = every_task(ur5)["pose"]
    q_bar = np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.2])
    chart = Chart.from_base(task, q_bar)
    assert (chart.r, chart.V.shape) == (0, (6, 0))
    q, dq = q_bar + 0.1, np.linspace(-1.0, 1.0, 6)
    point = chart.point(q, dq)
    np.testing.assert_allclose(point.H, np.linalg.inv(point.task.J), atol=exact(point.task.J, scale=1e2))
    np.testing.assert_allclose(point.H @ point.dw, dq, atol=exact(point.task.J))
    assert point.D.shape == (6, 0)
    assert chart.margin(point.task.J) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(chart.inverse(task.value(q), np.zeros(0)).q, q, atol=1e3 * SOLVED)
    np.testing.assert_allclose(point.task.J @ chart.acceleration(point.task.J, dq, np.zeros(0)), dq, atol=1e-11)
    after = Chart.from_base(task, q, previous=chart)
    assert after.v(q).shape == (0,)


# -- where a chart ends ----------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_margin_is_the_cosine_of_the_largest_principal_angle(task, data):
    chart = Chart.from_base(task, regular(data, task))
    J = task.linearize(regular(data, task))[1]
    expected = np.cos(scipy.linalg.subspace_angles(J.T, chart.U).max())
    assert chart.margin(J) == pytest.approx(expected, abs=exact(J, chart.U))
    assert chart.margin(chart.U.T) == pytest.approx(1.0, abs=exact(chart.U))


@every
@given(seed=seeds, threshold=st.floats(0.01, 0.99), spread=st.floats(0.0, 2.0))
def test_chart_contains_joints_of_positive_margin(task, seed, threshold, spread):
    """For any Jacobian, close to that of the base point or not."""
    chart = Chart.from_base(task, _regular_state(task))
    random = np.random.default_rng(seed)
    J = chart.U.T + spread * random.normal(size=chart.U.T.shape)
    assume(np.linalg.cond(J) < 1e5)
    margin = chart.margin(J)
    assume(abs(margin - threshold) > 1e-9)
    assert chart.contains(J, threshold) == (margin > threshold)


@given(base=st.floats(-3.0, 3.0), turn=st.floats(-3.1, 3.1))
def test_margin_of_the_ppr_robot_has_its_closed_form(ppr, base, turn):
    """In closed form: turned by a from its base point it is (1 + cos a) / 2, so the chart ends at half a turn."""
    task = every_task(ppr)["position xy"]
    chart = Chart.from_base(task, [0.1, -0.2, base])
    J = task.linearize(np.array([1.0, 2.0, base + turn]))[1]
    assert chart.margin(J) == pytest.approx(0.5 * (1.0 + np.cos(turn)), abs=10 * EXACT)
    edge = task.linearize(np.array([1.0, 2.0, base + np.pi]))[1]
    assert chart.margin(edge) == pytest.approx(0.0, abs=10 * EXACT)
    assert np.linalg.cond(np.vstack((edge, chart.V.T))) > 1e14


def test_edge_of_a_chart_is_distinguished_from_a_singular_task(chain):
    """On the edge the Jacobian has full rank, but a direction orthogonal to all rows of the base point's."""
    chart = Chart.from_base(every_task(chain)["position xy"], checks.random_state(chain)[0])
    J = np.array([chart.V[:, 0], chart.U[:, 1]])
    assert chart.margin(J) == pytest.approx(0.0, abs=EXACT)
    assert not chart.contains(J, 1e-6)
    flat = np.zeros_like(J)
    flat[:, 0] = 1.0
    with pytest.raises(SingularError):
        chart.margin(flat)
    with pytest.raises(ChartError, match="edge of the chart"):
        chart.B(flat)
    for limit in (0, 16):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(directions, "DENSE", limit)
            with pytest.raises(ChartError, match="edge of the chart"):
                chart.acceleration(np.zeros_like(J), np.ones(2), np.ones(8))


@pytest.mark.parametrize(
    ("name", "kind", "rank"),
    [("ur5", "pose", 5), ("ur5", "orientation", 2), ("panda", "pose", 5), ("chain", "relative xy", 1)],
)
def test_singular_task_has_no_chart(name, kind, rank):
    """Arms stretched out: the wrist axes of ur5 and panda align at q = 0, and the chain is a straight line."""
    robot = checks.robot(name)
    task, zero = every_task(robot)[kind], np.zeros(robot.n)
    with pytest.raises(SingularError, match="singular") as caught:
        Chart.from_base(task, zero)
    assert caught.value.rank == rank
    assert len(caught.value.singular_values) == task.m
    assert caught.value.singular_values[-1] < 1e-7 < caught.value.singular_values[-2]
    chart = Chart.from_base(task, _regular_state(task))
    J = task.linearize(zero)[1]
    for ask in (chart.margin, lambda J: chart.contains(J, 0.5)):
        with pytest.raises(SingularError):
            ask(J)


def test_base_point_is_a_configuration(panda):
    task = every_task(panda)["position xyz"]
    for wrong in (np.zeros(6), np.zeros((7, 1)), [0.0] * 6 + [np.nan]):
        with pytest.raises(InputError, match="base configuration q"):
            Chart.from_base(task, wrong)


# -- from chart to chart ---------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_v_continues_and_its_directions_turn_the_least(task, data):
    """The next chart's V is as close to the last one's as any basis of the null space can be (Procrustes)."""
    old = Chart.from_base(task, regular(data, task))
    q = near(data, old, margin=0.3)
    new, raw = Chart.from_base(task, q, previous=old), Chart.from_base(task, q)
    np.testing.assert_allclose(new.v(q), old.v(q), atol=10 * EXACT)
    np.testing.assert_allclose(new.V.T @ new.V, np.eye(new.r), atol=EXACT)
    np.testing.assert_allclose(new.U.T @ new.V, 0.0, atol=EXACT * np.linalg.norm(new.U))
    np.testing.assert_array_equal(new.U, raw.U)
    # Any basis is raw.V times an orthogonal matrix.
    random = np.random.default_rng(0)
    turn = np.linalg.norm(new.V - old.V)
    for basis in [raw.V, *(raw.V @ np.linalg.qr(random.normal(size=(new.r, new.r)))[0] for _ in range(5))]:
        assert turn <= np.linalg.norm(basis - old.V) + 100 * EXACT
    # So the velocity of a pure self-motion of the old chart jumps no more than the angle between the null spaces says.
    dv = random.normal(size=new.r)
    jump = np.linalg.norm(new.dv(old.V @ dv) - dv)
    angle = scipy.linalg.subspace_angles(new.V, old.V).max() if new.r else 0.0
    assert jump <= (1.0 - np.cos(angle)) * np.linalg.norm(dv) + 100 * EXACT


def test_chart_at_the_same_point_is_the_same(panda):
    task = every_task(panda)["pose"]
    q = checks.random_state(panda)[0]
    old = Chart.from_base(task, q)
    new = Chart.from_base(task, q, previous=old)
    np.testing.assert_allclose(new.V, old.V, atol=EXACT)
    np.testing.assert_allclose(new.v_bar, old.v_bar, atol=EXACT)


# -- linear algebra --------------------------------------------------------------------------------------------------


def test_null_space_of_the_ppr_robot_has_the_sign_of_the_paper(ppr):
    chart = Chart.from_base(every_task(ppr)["position xy"], np.zeros(3))
    np.testing.assert_allclose(chart.V, np.array([[0.0], [-1.0], [1.0]]) / np.sqrt(2.0), atol=EXACT)


@given(m=st.integers(1, 6), r=st.integers(0, 6), seed=seeds)
def test_null_space_is_an_orthonormal_basis_with_fixed_signs(m, r, seed):
    random = np.random.default_rng(seed)
    J = random.normal(size=(m, m + r))
    V = _basis.null_space(J)
    assert V.shape == (m + r, r)
    np.testing.assert_allclose(V.T @ V, np.eye(r), atol=EXACT)
    np.testing.assert_allclose(J @ V, 0.0, atol=EXACT * np.linalg.norm(J))
    for column in V.T:
        assert column[np.flatnonzero(np.abs(column) > 0.5001 * np.abs(column).max())[-1]] > 0.0
    # A library that returned columns of other signs, or rounded otherwise, would give the same basis.
    noise = 1e-15 * random.normal(size=J.shape)
    for other in (-J, 2.0 * J, J + noise):
        np.testing.assert_allclose(_basis.null_space(other), V, atol=1e3 * exact(J))


@given(m=st.integers(2, 6), r=st.integers(0, 4), seed=seeds, lost=st.integers(1, 2))
def test_check_rank_refuses_exactly_the_deficient(m, r, seed, lost):
    """Where singular values are smaller than the 1e-7th part of the largest."""
    X, values, Y = np.linalg.svd(np.random.default_rng(seed).normal(size=(m, m + r)), full_matrices=False)
    lost = min(lost, m - 1)
    values[: m - lost] = np.maximum(values[: m - lost], 0.1 * values[0])
    values[m - lost :] = 2e-7 * values[0]
    _basis.check_rank((X * values) @ Y)
    values[m - lost :] = 0.5e-7 * values[0]
    with pytest.raises(SingularError) as caught:
        _basis.check_rank((X * values) @ Y)
    assert caught.value.rank == m - lost


@given(size=st.integers(1, 8), seed=seeds)
def test_is_odd_is_the_sign_of_the_determinant(size, seed):
    A = np.random.default_rng(seed).normal(size=(size, size))
    LU, pivots, _ = lapack.dgetrf(A)
    assert _basis.is_odd(LU, pivots) == (np.linalg.det(A) < 0.0)


@given(size=st.integers(1, 8), seed=seeds)
def test_fade_changes_nothing_where_nothing_fades(size, seed):
    random = np.random.default_rng(seed)
    X, Y = (np.linalg.qr(random.normal(size=(size, size)))[0] for _ in range(2))
    values = random.uniform(1.001 * linear.SINGULAR_VALUE_FLOOR, 2.0, size)
    A, b, dq = (X * values) @ Y, random.normal(size=size), random.normal(size=size) / size
    Z, c = linear.damped_system(A, b, dq)
    np.testing.assert_allclose(Z.T @ c, np.linalg.solve(A, b), atol=1e3 * exact(A))


@given(size=st.integers(1, 8), seed=seeds, fraction=st.floats(0.0, 0.999), speed=st.floats(-30.0, 30.0))
def test_damped_system_is_bounded_and_brakes(size, seed, fraction, speed):
    """The last direction, with singular value s below its threshold ε: s/ε² of what is asked, 1 − s²/ε² of braking."""
    random = np.random.default_rng(seed)
    X, Y = (np.linalg.qr(random.normal(size=(size, size)))[0] for _ in range(2))
    values = random.uniform(0.5, 2.0, size)
    values[-1] = fraction * linear.SINGULAR_VALUE_FLOOR
    dq, b = speed * Y[-1], random.normal(size=size)
    Z, c = linear.damped_system((X * values) @ Y, b, dq)
    x = Z.T @ c
    speed_ratio_squared = max(1.0, abs(speed) / linear.FAST_SPEED)
    fraction /= speed_ratio_squared
    asked = fraction / (speed_ratio_squared * linear.SINGULAR_VALUE_FLOOR) * (X.T @ b)[-1]
    braking = -(1.0 - fraction**2) * speed_ratio_squared * linear.BRAKING_RATE * speed
    assert Y[-1] @ x == pytest.approx(asked + braking, abs=1e-9 * max(1.0, abs(speed)))
    # All other directions have what was asked for.
    np.testing.assert_allclose((Y @ x)[:-1], (X.T @ b)[:-1] / values[:-1], atol=1e-9 * max(1.0, abs(speed)))


@given(size=st.integers(1, 8), seed=seeds, fraction=st.floats(0.0, 2.0), speed=st.floats(0.0, 30.0))
def test_damped_system_gives_up_nothing_of_joints_that_have_the_task(size, seed, fraction, speed):
    """Of a right side J a the solution is a, however small a singular value, where a leads."""
    random = np.random.default_rng(seed)
    X, Y = (np.linalg.qr(random.normal(size=(size, size)))[0] for _ in range(2))
    values = random.uniform(0.5, 2.0, size)
    values[-1] = fraction * linear.SINGULAR_VALUE_FLOOR
    J, a, dq = (X * values) @ Y, random.normal(size=size), speed * Y[-1]
    Z, c = linear.damped_system(J, J @ a, dq, a)
    np.testing.assert_allclose(Z.T @ c, a, atol=1e-12)


# -- walking ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", [1.0, 0.5, 0.01])
def test_walk_visits_points_of_the_straight_line_and_ends_exactly_at_the_goal(panda, first):
    task = every_task(panda)["pose"]
    z0, z1 = (task.value(checks.random_state(panda, seed)[0]) for seed in (1, 2))
    v0, v1 = np.zeros(1), np.ones(1)
    visited = []
    assert charts.walk(task, (z0, v0), (z1, v1), lambda z, v: not visited.append((z, v)), first=first) == 1.0
    assert visited[-1][0] is z1
    assert visited[-1][1] is v1
    fractions = np.array([v[0] for _, v in visited])
    steps = np.diff(fractions, prepend=0.0)
    assert steps[0] == first
    np.testing.assert_allclose(steps[1:-1], 2.0 * steps[:-2])
    assert (steps > 0.0).all()
    for (z, _), s in zip(visited, fractions, strict=True):
        np.testing.assert_allclose(task.minus(z, z0), s * task.minus(z1, z0), atol=1e3 * EXACT)


@given(wall=st.floats(0.0, 0.999))
def test_walk_reports_the_part_of_the_way_done(panda, wall):
    task = every_task(panda)["position xyz"]
    z, v = np.zeros(3), np.zeros(4)
    reached = charts.walk(task, (z, v), (z + 1.0, v), lambda z, _: z[0] <= wall)
    assert wall - 2e-3 <= reached <= wall
