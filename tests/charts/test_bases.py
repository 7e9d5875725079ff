"""Bases of null spaces, written out and not, against orthogonal Procrustes; and charts of many joints."""

from __future__ import annotations

import checks
import numpy as np
import pytest
import scipy.linalg
from checks import EXACT, SOLVED, exact
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Chart,
    ControlLoop,
    Damp,
    DescendPotential,
    EosController,
    Hold,
    PositionTask,
    Posture,
)
from eos_pin.charts import _basis as bases

seeds = st.integers(0, 2**32 - 1)
forms = pytest.mark.parametrize("dense", [0, 10**6], ids=["sparse", "dense"])


def first(J, dense):
    """The first basis of a motion, written out if it has at most `dense` rows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bases, "DENSE", dense)
        return bases.null_basis(J, rows(J))


def rows(J):
    """Orthonormal basis of the row space."""
    return np.linalg.qr(J.T)[0]


def nearest(J, V):
    """The basis of the null space of J that is nearest to V, by orthogonal Procrustes."""
    N = scipy.linalg.null_space(J)
    X, _, Yt = np.linalg.svd(N.T @ V)
    return N @ (X @ Yt)


def check(basis, J):
    """It is an orthonormal basis of the null space, and its products are those of the matrix."""
    V, random = basis.matrix, np.random.default_rng(0)
    n, r = V.shape
    np.testing.assert_allclose(V.T @ V, np.eye(r), atol=EXACT)
    np.testing.assert_allclose(J @ V, 0.0, atol=EXACT * np.linalg.norm(J))
    for columns in ((), (3,)):
        y, x = random.normal(size=(r, *columns)), random.normal(size=(n, *columns))
        np.testing.assert_allclose(basis.apply(y), V @ y, atol=EXACT)
        np.testing.assert_allclose(basis.project(x), V.T @ x, atol=EXACT)


@forms
@given(m=st.integers(1, 6), r=st.integers(1, 60), seed=seeds)
def test_basis_has_the_products_of_its_columns(dense, m, r, seed):
    J = np.random.default_rng(seed).normal(size=(m, m + r))
    check(first(J, dense), J)


@given(m=st.integers(1, 6), r=st.integers(50, 80), seed=seeds)
def test_basis_for_many_joints_is_the_nearest_to_unit_vectors(m, r, seed):
    random = np.random.default_rng(seed)
    J = random.normal(size=(m, m + r))
    basis = bases.null_basis(J, rows(J))
    units = np.eye(m + r)[:, basis.joints]
    np.testing.assert_allclose(basis.matrix, nearest(J, units), atol=1e-12)
    # Whatever a library's QR factorization is like, and however it rounds.
    turned = rows(J) @ np.linalg.qr(random.normal(size=(m, m)))[0]
    for other, Q in ((-J, turned), (J + 1e-15 * random.normal(size=J.shape), rows(J))):
        np.testing.assert_allclose(bases.null_basis(other, Q).matrix, basis.matrix, atol=1e3 * exact(J))


@forms
@given(m=st.integers(1, 6), r=st.integers(1, 60), seed=seeds, size=st.floats(0.0, 3.0))
def test_carrying_is_orthogonal_procrustes(dense, m, r, seed, size):
    """However far the next null space is, and from chart to chart."""
    random = np.random.default_rng(seed)
    J = random.normal(size=(m, m + r))
    basis, smallest = first(J, dense), 1.0
    for _ in range(4):
        old, J = rows(J), J + size * random.normal(size=J.shape)
        smallest = min(smallest, np.linalg.svd(old.T @ rows(J), compute_uv=False)[-1])
        expected = nearest(J, basis.matrix)
        basis = bases.carried(basis, old, rows(J))
        check(basis, J)
        np.testing.assert_allclose(basis.matrix, expected, atol=1e-12 / smallest)


@forms
def test_null_space_at_a_right_angle_has_a_basis_too(dense):
    """Where Procrustes has many solutions, as beyond the edge of a chart."""
    J, other = np.eye(60)[:2], np.eye(60)[[1, 7]]
    check(bases.carried(first(J, dense), rows(J), rows(other)), other)


@forms
def test_rounding_errors_do_not_collect(dense):
    random = np.random.default_rng(4)
    parts = random.normal(size=(3, 2, 30))
    J = parts[0]
    basis = first(J, dense)
    for angle in np.linspace(0.0, 100.0, 2000):
        old, J = rows(J), parts[0] + np.sin(angle) * parts[1] + np.cos(2.0 * angle) * parts[2]
        basis = bases.carried(basis, old, rows(J))
    check(basis, J)


def test_motion_that_repeats_needs_no_more_columns():
    """A basis is written out only where its columns have become too many."""
    random = np.random.default_rng(5)
    parts = random.normal(size=(3, 2, 200))
    J = parts[0]
    basis = bases.null_basis(J, rows(J))
    for angle in np.linspace(0.0, 20.0 * np.pi, 401)[1:]:
        old, J = rows(J), parts[0] + 0.5 * np.sin(angle) * parts[1] + 0.5 * np.cos(angle) * parts[2]
        basis = bases.carried(basis, old, rows(J))
        assert basis.F.shape[1] <= 64
    for _ in range(100):
        old, J = rows(J), J + random.normal(size=J.shape)
        expected = nearest(J, basis.matrix)
        basis = bases.carried(basis, old, rows(J))
        np.testing.assert_allclose(basis.matrix, expected, atol=1e-11)
    assert isinstance(basis, bases.DenseBasis)
    check(basis, J)


# -- charts of many joints -------------------------------------------------------------------------------------------


@pytest.fixture(params=[30, 120])
def chart(request):
    """A chart of a long chain, the second of a motion."""
    robot = checks.long_chain(request.param)
    task, q = PositionTask(robot, "tip", "xy"), np.full(robot.n, 1.5 * np.pi / robot.n)
    before = Chart.from_base(task, q + 0.3 * np.random.default_rng(0).normal(size=robot.n) / np.sqrt(robot.n))
    return Chart.from_base(task, q, previous=before)


def test_charts_of_many_joints_keep_the_identities(chart):
    """Eqs. (11), (16)–(20) with V as it is written out."""
    n, random = chart.n, np.random.default_rng(1)
    q, dq, ddw = chart.q_bar + 0.1 * random.normal(size=n) / np.sqrt(n), *random.normal(size=(2, n))
    check(chart.basis, chart.U.T)
    point = chart.point(q, dq)
    tolerance = exact(point.H_inverse, scale=10.0)
    np.testing.assert_allclose(point.H @ point.H_inverse, np.eye(n), atol=tolerance)
    np.testing.assert_allclose(chart.q(chart.v(q), chart.u(q)), q, atol=tolerance)
    np.testing.assert_allclose(chart.v(q), chart.v_bar + chart.V.T @ (q - chart.q_bar), atol=tolerance)
    np.testing.assert_allclose(chart.dv(dq), chart.V.T @ dq, atol=tolerance)
    ddq = chart.acceleration(point.task.J, ddw[:2] - point.task.drift, ddw[2:])
    np.testing.assert_allclose(ddq, point.H @ ddw + point.E, atol=tolerance * np.abs(ddq).max())
    found = chart.inverse(chart.task.value(q), chart.v(q))
    np.testing.assert_allclose(found.q, q, atol=SOLVED * np.linalg.norm(point.H, 2))
    np.testing.assert_allclose(chart.v(found.q), chart.v(q), atol=tolerance)


def test_control_of_many_joints_is_that_of_the_formula(chart):
    """Eq. (35): torque M (H F* + E) − R."""
    n, task, robot, random = chart.n, chart.task, chart.task.robot, np.random.default_rng(2)
    q, dq = chart.q_bar + 0.01 * random.normal(size=n) / np.sqrt(n), random.normal(size=n) / n
    loop = ControlLoop(EosController(task, Hold(chart.z_bar)))
    loop.step(0.0, chart.q_bar, dq)
    tau = loop.step(0.01, q, dq)
    point = Chart.from_base(task, chart.q_bar).point(q, dq)
    z = np.concatenate((point.task.z - chart.z_bar, point.v))
    F = -100.0 * z - 20.0 * point.dw
    expected = robot.mass(q) @ (point.H @ F + point.E) + robot.bias(q, dq)
    np.testing.assert_allclose(tau, expected, atol=exact(point.H, scale=10.0 * n))


@pytest.mark.parametrize("chart", [120], indirect=True)
def test_v_is_not_written_out_for_many_joints(chart, monkeypatch):
    """Not for a chart, a step of control with any objective, or inverse kinematics: these take time ∝ n."""

    def written(self):
        raise AssertionError("V was written out")

    monkeypatch.setattr(bases.SparseBasis, "matrix", property(written))
    task, q, dq = chart.task, chart.q_bar, np.full(chart.n, 0.01)
    Chart.from_base(task, q, previous=Chart.from_base(task, q + 0.001)).inverse(chart.z_bar + 0.01, np.zeros(chart.r))
    chart.acceleration(chart.U.T, np.ones(2), np.ones(chart.r))
    for objective in (None, Damp(), Posture(q), DescendPotential(lambda q: q)):
        ControlLoop(EosController(task, Hold(chart.z_bar), objective)).step(0.0, q, dq)
