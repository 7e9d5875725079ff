"""Charts with a metric: their identities for any A, decoupling, their edge, and how v is carried on between metrics."""

from __future__ import annotations

import checks
import numpy as np
import pytest
import scipy.linalg
from checks import EXACT, SOLVED, all_tasks, every_task, exact
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from eos_pin import Atlas, Chart, ExtendedDynamics, FunctionError, InputError, PositionTask
from eos_pin.charts import directions
from eos_pin.control._regularize import AccelerationMap

TASKS = all_tasks()
every = pytest.mark.parametrize("task", [task for _, task in TASKS], ids=[name for name, _ in TASKS])
#: Where the task itself hardly matters.
some = pytest.mark.parametrize("task", [task for _, task in TASKS[::4]], ids=[name for name, _ in TASKS[::4]])
METRICS = ("identity", "inertial", "matrix", "function")
HOME = np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8])


def positive(n, seed, spread=3.0):
    """A symmetric positive matrix with eigenvalues over so many orders of magnitude."""
    random = np.random.default_rng(seed)
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    return (Q * 10.0 ** random.uniform(-0.5 * spread, 0.5 * spread, n)) @ Q.T


def metric(data, task):
    """A metric of any kind."""
    kind, seed = data.draw(st.sampled_from(METRICS)), data.draw(st.integers(0, 2**32 - 1))
    n = task.robot.n
    if kind == "inertial" and task.robot.lacks_dynamics:
        kind = "identity"
    made = {"matrix": lambda: positive(n, seed), "function": lambda: lambda q: positive(n, seed) + np.diag(q * q)}
    return made[kind]() if kind in made else kind


def regular(data, task):
    q = data.draw(checks.joints(task.robot))
    assume(np.linalg.cond(task.linearize(q)[1]) < 1e3)
    return q


def matrix_of(chart):
    """A at the base."""
    return np.eye(chart.n) if chart.weights is None else chart.weights.A


@every
@settings(max_examples=10)
@given(data=st.data())
def test_identities_hold_in_any_metric(task, data):
    """At the base, on the chart, and for the inverse kinematic map; rounding times condition."""
    first = Chart.from_base(task, regular(data, task), metric=metric(data, task))
    chart = Chart.from_base(task, regular(data, task), metric=metric(data, task), previous=first)
    n, r, A = chart.n, chart.r, matrix_of(chart)
    U, V, W, J = chart.U, chart.V, chart.W, task.linearize(chart.q_bar)[1]
    tolerance = exact(A, J)
    np.testing.assert_allclose(A @ U, J.T, atol=tolerance * np.abs(J).max())
    np.testing.assert_allclose(chart.J_bar, J, atol=tolerance * np.abs(J).max())
    np.testing.assert_allclose(V.T @ V, np.eye(r), atol=10 * EXACT)
    np.testing.assert_allclose(J @ V, 0.0, atol=10 * EXACT * np.linalg.norm(J))
    np.testing.assert_allclose(W.T @ V, np.eye(r), atol=tolerance)
    np.testing.assert_allclose(W.T @ U, 0.0, atol=tolerance * np.linalg.norm(U))
    np.testing.assert_allclose(W @ (V.T @ A @ V), A @ V, atol=tolerance * np.linalg.norm(A))
    np.testing.assert_allclose(chart.B_bar @ (J @ U), np.eye(chart.m), atol=tolerance * np.linalg.cond(J))
    q = chart.q_bar + data.draw(checks.numbers(n, 0.2))
    point = chart.point(q, data.draw(checks.velocities(task.robot)))
    assume(np.linalg.cond(point.task.J) < 1e3)
    assume(chart.margin(point.task.J) > 0.3)
    tolerance *= np.linalg.cond(point.H_inverse)
    np.testing.assert_array_equal(point.H_inverse, np.vstack((point.task.J, W.T)))
    np.testing.assert_allclose(point.H @ point.H_inverse, np.eye(n), atol=tolerance)
    np.testing.assert_allclose(point.task.J @ point.D, 0.0, atol=tolerance)
    np.testing.assert_allclose(point.dv, W.T @ point.dq, atol=tolerance)
    np.testing.assert_allclose(chart.q(chart.v(q), chart.u(q)), chart.unwrap(q), atol=tolerance)
    np.testing.assert_allclose(chart.v(q), chart.v_bar + W.T @ (chart.unwrap(q) - chart.q_bar), atol=tolerance)
    ddw = data.draw(checks.numbers(n))
    expected = point.H @ ddw + point.E
    scale = max(1.0, np.abs(expected).max(), np.abs(point.task.drift).max())
    arguments = point.task.J, ddw[: chart.m] - point.task.drift, ddw[chart.m :]
    for limit in (0, 16):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(directions, "DENSE", limit)
            np.testing.assert_allclose(chart.acceleration(*arguments), expected, atol=10 * tolerance * scale)
    drive = AccelerationMap(chart, smooth=False)
    ddq, bound = drive(point.task.J, np.concatenate(arguments[1:]), point.dq)
    np.testing.assert_allclose(ddq, expected, atol=10 * tolerance * scale)
    assert bound <= chart.margin(point.task.J) + tolerance


@some
@pytest.mark.parametrize("kind", ["inertial", "matrix"])
def test_inverse_kinematics_hold_in_any_metric(task, kind):
    for seed in range(3):
        q = checks.random_state(task.robot, seed)[0]
        J = task.linearize(q)[1]
        if np.linalg.cond(J) > 30.0 or (kind == "inertial" and task.robot.lacks_dynamics):
            continue
        chart = Chart.from_base(task, q, metric=kind if kind == "inertial" else positive(task.robot.n, seed, 1.5))
        random = np.random.default_rng(seed)
        goal = chart.q_bar + 0.02 * random.normal(size=chart.n) * np.linalg.svd(J, compute_uv=False)[-1]
        found = chart.inverse(task.value(goal), chart.v(goal), tol=1e-12)
        error = 2.0 * SOLVED * np.linalg.norm(np.linalg.inv(chart.point(goal, 0.0 * goal).H_inverse), 2)
        np.testing.assert_allclose(found.q, chart.unwrap(goal), atol=error)


def test_identity_charts_have_one_set_of_arrays(panda):
    """So that they cost no more than without a metric."""
    task = every_task(panda)["pose"]
    chart = Chart.from_base(task, HOME)
    assert chart.dual is chart.basis
    assert chart.Wt is chart.Vt
    assert chart.u_basis is chart.row_basis
    same = Chart.from_base(task, HOME, metric=np.eye(7))
    for name in ("U", "V", "W", "B_bar"):
        np.testing.assert_allclose(getattr(same, name), getattr(chart, name), atol=1e3 * EXACT)


@given(seed=st.integers(0, 2**32 - 1), factor=st.floats(1e-6, 1e6))
def test_unit_of_a_metric_does_not_matter(panda, seed, factor):
    task, A = every_task(panda)["pose"], positive(7, seed)
    one, other = (Chart.from_base(task, HOME, metric=c * A) for c in (1.0, factor))
    J = task.linearize(HOME + 0.1)[1]
    np.testing.assert_allclose(one.W, other.W, atol=exact(A))
    np.testing.assert_allclose(one.point(HOME + 0.1, HOME).H, other.point(HOME + 0.1, HOME).H, atol=exact(A, A))
    assert one.margin(J) == pytest.approx(other.margin(J), abs=exact(A))


# -- decoupling ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["position xyz", "pose", "orientation"])
def test_coupling_is_the_cosine_between_motions_of_z_and_of_v(panda, kind):
    """In the metric M; zero at the base of an inertial chart, and not elsewhere."""
    task, random = every_task(panda)[kind], np.random.default_rng(3)
    for metric, q_bar in (("identity", HOME), ("inertial", HOME), (positive(7, 0), HOME)):
        chart = Chart.from_base(task, q_bar, metric=metric)
        for q in (q_bar, q_bar + 0.1 * random.normal(size=7)):
            dynamics = ExtendedDynamics.from_state(panda, chart, q, 0.0 * q)
            L = np.linalg.cholesky(panda.mass(q))
            angles = scipy.linalg.subspace_angles(L.T @ chart.U, L.T @ dynamics.point.D)
            assert dynamics.coupling == pytest.approx(np.cos(angles.min()), abs=1e-9)
            decoupled = isinstance(metric, str) and metric == "inertial" and q is q_bar
            assert (dynamics.coupling < 1e-12) == decoupled
            m = task.m
            assert (np.abs(dynamics.mass[:m, m:]).max() < 1e-12) == decoupled


def test_task_without_redundancy_has_no_coupling(ur5):
    q = np.array([0.0, -1.2, 1.4, -1.0, 1.2, 0.0])
    chart = Chart.from_base(every_task(ur5)["pose"], q, metric="inertial")
    assert chart.W.shape == (6, 0)
    assert ExtendedDynamics.from_state(ur5, chart, q, q).coupling == 0.0
    assert chart.margin(chart.task.linearize(q + 0.1)[1]) == pytest.approx(1.0)


# -- the edge --------------------------------------------------------------------------------------------------------


@some
@settings(max_examples=10)
@given(data=st.data())
def test_margin_is_that_of_the_paper_in_coordinates_of_the_metric(task, data):
    """In L' q with A = L L' the metric is the identity."""
    chart = Chart.from_base(task, regular(data, task), metric=metric(data, task))
    A, J = matrix_of(chart), task.linearize(regular(data, task))[1]
    L = np.linalg.cholesky(A)
    rows = [np.linalg.solve(L, G.T) for G in (J, chart.J_bar)]
    expected = np.cos(scipy.linalg.subspace_angles(*rows).max())
    assert chart.margin(J) == pytest.approx(expected, abs=1e-7 + exact(A, J))
    assert chart.margin(chart.J_bar) == pytest.approx(1.0, abs=exact(A, chart.J_bar))
    for threshold in (0.2, 0.5, 0.9):
        if abs(expected - threshold) > 1e-6 + exact(A, J):
            assert chart.contains(J, threshold) == (expected > threshold)


@given(seed=st.integers(0, 2**32 - 1))
def test_margin_is_zero_exactly_where_g_u_is_singular(panda, seed):
    """A Jacobian of full rank one of whose rows is W's, so that G'U loses rank."""
    task, random = every_task(panda)["position xyz"], np.random.default_rng(seed)
    A = positive(7, seed)
    chart = Chart.from_base(task, HOME, metric=A)
    edge = np.vstack((chart.W[:, 0] / np.linalg.norm(chart.W[:, 0]), chart.J_bar[1:])) + 0.0
    assume(np.linalg.cond(edge) < 1e2)
    assert chart.margin(edge) == pytest.approx(0.0, abs=exact(A, edge))
    J = edge + 0.1 * random.normal(size=edge.shape)
    assume(np.linalg.cond(J) < 1e2)
    singular = np.linalg.svd(J @ chart.u_basis, compute_uv=False)[-1]
    assert (chart.margin(J) > 1e-9) == (singular > 1e-9 / np.linalg.cond(A))


# -- from chart to chart ---------------------------------------------------------------------------------------------


@some
@settings(max_examples=10)
@given(data=st.data())
def test_v_continues_between_metrics(task, data):
    old = Chart.from_base(task, regular(data, task), metric=metric(data, task))
    q = old.q_bar + data.draw(checks.numbers(task.robot.n, 0.2))
    assume(np.linalg.cond(task.linearize(q)[1]) < 1e3)
    new = Chart.from_base(task, q, metric=metric(data, task), previous=old)
    size = np.linalg.svd(old.W, compute_uv=False).max(initial=0.0)
    np.testing.assert_allclose(new.v(q), old.v(q), atol=100 * EXACT * size)
    # V is turned as the paper's is, whatever the metric.
    plain = Chart.from_base(task, q, previous=Chart.from_base(task, old.q_bar))
    old_plain = Chart.from_base(task, old.q_bar)
    np.testing.assert_allclose(old.V, old_plain.V, atol=EXACT)
    np.testing.assert_allclose(new.V, plain.V, atol=100 * EXACT)


def test_metric_goes_on_where_none_is_given(panda):
    task = every_task(panda)["position xyz"]
    old = Chart.from_base(task, HOME, metric="inertial")
    assert Chart.from_base(task, HOME + 0.1, previous=old).metric == "inertial"
    assert Chart.from_base(task, HOME + 0.1, metric="identity", previous=old).weights is None
    atlas = Atlas(task, metric="inertial")
    chart = atlas.next(Chart.from_base(task, HOME), HOME + 0.1)
    np.testing.assert_allclose(chart.weights.A, panda.mass(HOME + 0.1))


def test_atlas_follows_a_path_on_inertial_charts(panda):
    """The end of one round differs from that of the paper's charts, as v means something else; the task is the same."""
    task = every_task(panda)["position xyz"]
    z = task.value(HOME)
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.3, -0.3], [0.0, 0.0, 0.0]])
    path = z + corners
    found = Atlas(task, metric="inertial", threshold=0.8).follow(HOME, path)
    assert found.complete
    assert len(found.charts) > 1
    assert found.residual < 1e-10
    for chart, q, v in zip(found.chart, found.q, found.v, strict=True):
        np.testing.assert_allclose(found.charts[chart].v(q), v, atol=1e-9)


# -- many joints, bad metrics ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [30, 120])
def test_metric_of_many_joints(n):
    """W stays a basis that is not written out, where V is."""
    robot = checks.long_chain(n)
    task, q = PositionTask(robot, "tip", "xy"), np.full(n, 1.5 * np.pi / n)
    A = np.diag(np.linspace(1.0, 5.0, n))
    chart = Chart.from_base(task, q, metric=A, previous=Chart.from_base(task, q + 0.001, metric=A))
    assert type(chart.dual) is type(chart.basis)
    np.testing.assert_allclose(chart.W.T @ chart.V, np.eye(n - 2), atol=1e3 * EXACT)
    np.testing.assert_allclose(chart.W, A @ chart.V @ np.linalg.inv(chart.V.T @ A @ chart.V), atol=1e3 * EXACT)
    near = q + 0.01 * np.sin(np.arange(n))
    J, F = task.linearize(near)[1], np.random.default_rng(0).normal(size=n)
    expected = np.linalg.solve(np.vstack((J, chart.W.T)), F)
    np.testing.assert_allclose(AccelerationMap(chart)(J, F, 0.0 * q)[0], expected, atol=1e-9 * np.abs(expected).max())
    found = chart.inverse(task.value(near), chart.v(near))
    np.testing.assert_allclose(found.q, near, atol=1e-7)


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        ("mass", "'identity', 'inertial', a symmetric positive matrix, or a function"),
        (np.eye(6), "shape \\(7, 7\\)"),
        (np.eye(7) + np.eye(7, k=1), "symmetric"),
        (np.diag([1.0, 1, 1, 1, 1, 1, -1]), "positive definite; its eigenvalues go from -1 to 1"),
        (np.diag([1.0, 1, 1, 1, 1, 1, 1e-14]), "positive definite"),
        (np.diag([1.0, 1, 1, 1, 1, 1, np.nan]), "finite"),
    ],
)
def test_bad_metric_is_refused(panda, metric, message):
    task = every_task(panda)["position xyz"]
    for make in (lambda: Atlas(task, metric=metric), lambda: Chart.from_base(task, HOME, metric=metric)):
        with pytest.raises(InputError, match=message):
            make()
    if not isinstance(metric, str):
        with pytest.raises(FunctionError, match="returned no metric"):
            Atlas(task, metric=lambda q: metric).start(HOME)


def test_metric_function_that_raises_is_named(panda):
    with pytest.raises(FunctionError, match="the function of a metric raised ZeroDivisionError"):
        Atlas(every_task(panda)["pose"], metric=lambda q: 1 / 0).start(HOME)
