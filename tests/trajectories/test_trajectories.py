"""Each trajectory against finite differences of itself, closed forms, and the promises of its docstring."""

from __future__ import annotations

import math
from itertools import pairwise, permutations

import numpy as np
import pinocchio as pin
import pytest
from checks import DIFFERENCED, EXACT, STEP, tip
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Geodesic,
    Harmonic,
    Hold,
    InputError,
    OrientationTask,
    PoseTask,
    PositionTask,
    StackedTask,
    StackedTrajectory,
    circle,
    cubic_spline,
    figure_eight,
    line,
    minimum_jerk,
    spline_from_csv,
)

POINTS = np.random.default_rng(4).normal(size=(5, 3))
TIMES = np.array([0.5, 1.2, 2.0, 2.7, 4.0])
RANDOM = np.random.default_rng(5)

KINDS = {
    "hold": Hold((1.0, 2.0, 3.0)),
    "line": line((0.1, 0.2, 0.3), (1.0, 0.0, -1.0), period=3.0),
    "circle": circle((0.0, 1.0), 0.5, period=2.0),
    "harmonic": Harmonic(RANDOM.normal(size=4), *RANDOM.normal(size=(2, 3, 4)), period=2.5, phase=0.3),
    "minimum jerk": minimum_jerk(POINTS, TIMES),
    "open spline": cubic_spline(POINTS, TIMES),
    "closed spline": cubic_spline([*POINTS, POINTS[0]], [*TIMES, 5.0]),
    "stacked": StackedTrajectory((circle((0.0, 1.0), 0.5, period=2.0), Hold((1.0,)), minimum_jerk(POINTS, TIMES))),
}
KINDS |= {f"figure eight {a + b}": figure_eight(POINTS[0], (0.4, 0.7), plane=a + b) for a, b in permutations("xyz", 2)}


def pose_path(task, times=(0.0, 1.0, 2.5)):
    """Geodesic through three poses; its first rotation is by almost half a turn, its second by none."""
    q = np.zeros(task.robot.n)
    first = task.value(q)
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    second = task.plus(first, np.concatenate(((0.1, -0.2, 0.3), (math.pi - 1e-6) * axis)))
    return Geodesic(task, [first, second, task.plus(second, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))], times)


def assert_derivatives(trajectory, t, minus=lambda a, b: a - b):
    before, here, after = (trajectory(t + s) for s in (-STEP, 0.0, STEP))
    scale = 1.0 + np.abs(here.dz).max() + 10.0 * np.abs(here.ddz).max()
    # The remainder of the central difference is a third derivative times STEP² / 6.
    np.testing.assert_allclose(minus(after.z, before.z) / (2.0 * STEP), here.dz, rtol=0.0, atol=DIFFERENCED * scale)
    np.testing.assert_allclose((after.dz - before.dz) / (2.0 * STEP), here.ddz, rtol=0.0, atol=DIFFERENCED * scale)


@pytest.mark.parametrize("name", KINDS)
@given(t=st.floats(0.0, 6.0))
def test_derivatives_are_those_of_the_point(name, t):
    if np.abs(t - np.append(TIMES, [5.0, 5.7])).min() < 10 * STEP:
        t += 20 * STEP  # the third derivative of a cubic spline jumps at its knots
    assert_derivatives(KINDS[name], t)


@given(t=st.floats(0.0, 3.0))
def test_derivatives_of_a_geodesic_are_those_of_the_pose(panda, t):
    task = PoseTask(panda, tip(panda))
    if np.abs(t - np.array([0.0, 1.0, 2.5])).min() < 10 * STEP:
        t += 20 * STEP
    assert_derivatives(pose_path(task), t, task.minus)


def test_geodesic_is_a_straight_line_about_a_constant_axis(panda):
    task = PoseTask(panda, tip(panda))
    path = pose_path(task)
    start, end = path(0.0).z, path(1.0).z
    np.testing.assert_allclose(end, path.points[1], atol=EXACT)
    whole = task.minus(end, start)
    for s in np.linspace(0.05, 1.0, 7):
        z, dz, _ = path(s)
        done = task.minus(z, start)
        share = 10 * s**3 - 15 * s**4 + 6 * s**5
        np.testing.assert_allclose(done, share * whole, atol=1e-9)
        np.testing.assert_allclose(np.cross(dz[3:], whole[3:]), 0.0, atol=1e-9)
    assert path.duration == 2.5
    assert path(99.0).z == pytest.approx(path.points[2])


def test_geodesic_has_its_derivatives_and_points(panda):
    orientation, position = OrientationTask(panda, tip(panda)), PositionTask(panda, tip(panda))
    R = pin.exp3(np.array([0.3, -0.2, 0.9]))
    turn = Geodesic(orientation, [np.eye(3), R], [1.0, 2.0])
    np.testing.assert_allclose(turn(1.5).z, pin.exp3(0.5 * pin.log3(R)).ravel(), atol=1e-12)
    assert_derivatives(turn, 1.3, orientation.minus)
    straight = Geodesic(position, POINTS, TIMES)
    assert_derivatives(straight, 1.5)
    for k, t in enumerate(TIMES):
        z, dz, ddz = straight(t)
        np.testing.assert_allclose(z, POINTS[k], atol=EXACT)
        np.testing.assert_allclose((dz, ddz), 0.0, atol=1e-12)


@given(t=st.floats(-10.0, 10.0))
def test_figure_eight_is_that_of_the_paper(t):
    # Eq. (34): (sin t, sin t cos t)
    z, dz, ddz = figure_eight((0.0, 0.0))(t)
    np.testing.assert_allclose(z, (math.sin(t), math.sin(t) * math.cos(t)), atol=1e-14)
    np.testing.assert_allclose(dz, (math.cos(t), math.cos(2 * t)), atol=1e-14)
    np.testing.assert_allclose(ddz, (-math.sin(t), -2 * math.sin(2 * t)), atol=1e-14)


def test_figure_eight_lies_in_its_plane_and_has_its_size():
    for a, b in permutations(range(3), 2):
        curve = figure_eight((1.0, 2.0, 3.0), (0.4, 0.7), period=2.0, plane="xyz"[a] + "xyz"[b])
        z = np.array([curve(t).z for t in np.linspace(0.0, 2.0, 401)]) - (1.0, 2.0, 3.0)
        np.testing.assert_allclose(z[0], 0.0, atol=EXACT)
        assert np.abs(z[:, a]).max() == pytest.approx(0.4)
        assert np.abs(z[:, b]).max() == pytest.approx(0.35)
        assert np.abs(z[:, 3 - a - b]).max() == 0.0


def test_circle_and_line_go_where_they_are_drawn():
    round_trip = circle((1.0, 2.0, 3.0), 0.5, period=4.0, plane="zx")
    z = np.array([round_trip(t).z for t in np.linspace(0.0, 4.0, 9)])
    np.testing.assert_allclose(z[0], (1.0, 2.0, 3.0), atol=EXACT)
    np.testing.assert_allclose(np.linalg.norm(z - (1.0, 2.0, 2.5), axis=1), 0.5, atol=EXACT)
    to_and_fro = line((1.0, 2.0), (0.5, 0.0), period=4.0)
    np.testing.assert_allclose([to_and_fro(t).z for t in (0.0, 1.0, 3.0)], [(1, 2), (1.5, 2), (0.5, 2)], atol=EXACT)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.period < math.inf])
def test_trajectories_with_a_period_repeat(name):
    trajectory = KINDS[name]
    for t in np.linspace(5.0, 7.0, 9):
        for now, later in zip(trajectory(t), trajectory(t + 3 * trajectory.period), strict=True):
            np.testing.assert_allclose(now, later, atol=1e-11)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.duration < math.inf])
def test_trajectories_of_finite_duration_rest_after_it(name):
    trajectory = KINDS[name]
    end = trajectory(trajectory.duration)
    for t in trajectory.duration + np.array([0.0, 1e-9, 1.0, 1e6]):
        z, dz, ddz = trajectory(float(t))
        np.testing.assert_allclose(z, end.z, atol=EXACT)
        assert not dz.any()
        assert not ddz.any()


def test_trajectories_have_their_period_and_duration():
    assert (Hold((1.0,)).period, Hold((1.0,)).duration) == (math.inf, 0.0)
    assert (KINDS["circle"].period, KINDS["circle"].duration) == (2.0, math.inf)
    assert (KINDS["minimum jerk"].period, KINDS["minimum jerk"].duration) == (math.inf, 4.0)
    assert (KINDS["closed spline"].period, KINDS["closed spline"].duration) == (4.5, math.inf)
    spline = KINDS["open spline"]
    circles = KINDS["circle"]
    assert StackedTrajectory((circles, Hold((1.0,)))).period == 2.0
    assert StackedTrajectory((Hold((1.0,)), spline)).duration == spline.duration
    assert StackedTrajectory((circles, spline)).duration == math.inf


def test_minimum_jerk_of_one_stretch_is_the_quintic():
    a, b = POINTS[:2]
    curve = minimum_jerk([a, b], [0.0, 2.0])
    for t in np.linspace(0.0, 2.0, 9):
        s = t / 2.0
        np.testing.assert_allclose(curve(t).z, a + (10 * s**3 - 15 * s**4 + 6 * s**5) * (b - a), atol=1e-12)


def test_minimum_jerk_has_the_least_jerk_of_all_curves_through_the_points():
    curve = minimum_jerk(POINTS, TIMES)
    np.testing.assert_allclose([curve(t).z for t in TIMES], POINTS, atol=1e-12)
    for t in TIMES[[0, -1]]:
        np.testing.assert_allclose(curve(t)[1:], 0.0, atol=1e-10)
    # A variation that keeps points and ends; to first order it must not change the integral of the squared jerk.
    inner = [1.2, 2.0, 2.7]
    for extra in ([], [1.0], [3.0, 3.5]):
        variation = np.polynomial.Polynomial.fromroots([0.5] * 3 + inner + [4.0] * 3 + extra).deriv(3)
        nodes, weights = np.polynomial.legendre.leggauss(20)
        first = scale = 0.0
        for a, b in pairwise(TIMES):
            t = 0.5 * (a + b) + 0.5 * (b - a) * nodes
            jerk, bump = curve.curve.derivative(3)(t), variation(t)[:, None]
            first += (0.5 * (b - a) * weights) @ (jerk * bump)
            scale += (0.5 * (b - a) * weights) @ np.abs(jerk * bump)
        assert np.abs(first / scale).max() < 1e-10


@pytest.mark.parametrize("name", ["open spline", "closed spline", "minimum jerk"])
def test_splines_go_through_their_points_with_continuous_acceleration(name):
    spline = KINDS[name]
    np.testing.assert_allclose([spline(t).z for t in TIMES], POINTS, atol=1e-12)
    for t in TIMES[1:-1]:
        for before, after in zip(spline(t - 1e-9), spline(t + 1e-9), strict=True):
            np.testing.assert_allclose(before, after, atol=1e-5)


def test_closed_spline_is_smooth_where_it_closes():
    spline = KINDS["closed spline"]
    for before, after in zip(spline(5.0 - 1e-9), spline(5.0 + 1e-9), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-5)
    # Whoever wants it open gets it open, at rest at both ends.
    again = cubic_spline([*POINTS, POINTS[0]], [*TIMES, 5.0], closed=False)
    assert (again.period, again.duration) == (math.inf, 5.0)
    assert not again(5.0).dz.any()
    assert again(0.5).dz == pytest.approx(np.zeros(3), abs=1e-12)


def test_stacked_trajectory_fits_a_stacked_task(panda):
    position, orientation = PositionTask(panda, tip(panda), "xy"), OrientationTask(panda, tip(panda))
    stack = StackedTask([position, orientation])
    path = StackedTrajectory([circle((0.4, 0.0), 0.1, period=2.0), Hold(np.eye(3).ravel(), 3)])
    z, dz, ddz = path(0.7)
    assert (z.size, dz.size, ddz.size) == (stack.size, stack.m, stack.m)


def test_targets_cannot_be_changed_from_outside():
    point = np.array([1.0, 2.0])
    hold, curve = Hold(point), Harmonic(point, np.ones((1, 2)), np.zeros((1, 2)), 1.0)
    point[0] = 99.0
    assert hold(0.0).z[0] == curve(0.0).z[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        hold(0.0).z[0] = 5.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Hold([1.0, math.nan]), "the point to hold must be finite"),
        (lambda: figure_eight((0.0, 0.0), plane="yz"), "two of the axes 'xy'"),
        (lambda: figure_eight((0.0, 0.0, 0.0), plane="xx"), "two of the axes 'xyz'"),
        (lambda: figure_eight((0.0, 0.0, 0.0), plane="xyz"), "two of the axes"),
        (lambda: figure_eight((0.0,)), "two of the axes"),
        (lambda: figure_eight((0.0, 0.0), -1.0), "the size must be a finite number above 0"),
        (lambda: figure_eight((0.0, 0.0), period=0.0), "period must be a finite number above 0"),
        (lambda: circle((0.0, 0.0), 0.0, period=1.0), "the radius must be a finite number above 0"),
        (lambda: circle((0.0, 0.0), 1.0, period=math.inf), "period must be a finite number"),
        (lambda: line((0.0, 0.0), (1.0,), period=1.0), "the center must be 1 numbers"),
        (lambda: Harmonic((0.0,), [[1.0, 2.0]], [[0.0]], 1.0), r"sines must be finite and of shape \(K, 1\)"),
        (lambda: Harmonic((0.0,), [[1.0], [2.0]], [[0.0]], 1.0), "must have one shape"),
        (lambda: minimum_jerk([(0.0, 0.0)], [0.0]), "at least two finite points"),
        (lambda: minimum_jerk([(0.0, 0.0), (1.0,)], [0.0, 1.0]), "rows of equally many numbers"),
        (lambda: minimum_jerk([(0.0,), (1.0,)], [0.0, 0.0]), "must increase"),
        (lambda: cubic_spline([(0.0,), (1.0,)], [0.0, 1.0, 2.0]), "the times of a path must be 2 numbers"),
        (lambda: cubic_spline([(0.0,), (math.inf,)], [0.0, 1.0]), "at least two finite points"),
        (lambda: cubic_spline([(0.0,), (1.0,), (2.0,)], [0.0, 1.0, 2.0], closed=True), "first and last"),
        (lambda: StackedTrajectory((KINDS["circle"], KINDS["line"])), "repeat after different times"),
        (lambda: StackedTrajectory(()), "at least one"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_geodesic_refuses_points_of_other_tasks(panda):
    task = PoseTask(panda, tip(panda))
    with pytest.raises(InputError, match="a point of"):
        Geodesic(task, [np.zeros(12), np.zeros(12)], [0.0, 1.0])
    with pytest.raises(InputError, match="at least two"):
        Geodesic(task, [task.value(np.zeros(7))], [0.0])


# -- files ---------------------------------------------------------------------------------------------------------


def test_spline_from_csv_is_that_of_its_rows(tmp_path):
    rows = "\n".join(f"{t},{','.join(map(repr, p.tolist()))}" for t, p in zip(TIMES, POINTS, strict=True))
    for text in (rows, f"t,x,y,z\n{rows}\n", f"\ufefft,x,y,z\r\n\r\n{rows}\r\n\r\n"):
        path = tmp_path / "path.csv"
        path.write_bytes(text.encode())
        spline = spline_from_csv(path)
        for t in (0.5, 1.0, 2.2, 4.0):
            np.testing.assert_allclose(spline(t - 0.5).z, KINDS["open spline"](t).z, atol=1e-14)
        assert "begin at 0.5 s" in spline.notes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x\n0,1\n1,two\n", "line 3: every entry must be a number, got 'two' in column x"),
        ("t,x\n0,1\n\n1,2,3\n", r"line 4: expected 2 columns \(t, x\), got 3"),
        ("0\n1\n", "line 1: one column only"),
        ("t,x\n0,1\n", "at least two rows; found 1"),
        ("", "no rows of numbers"),
        ("x\n0\n1\n", "takes columns t, and x, y, z .* path_from_csv also takes poses"),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n", "path_from_csv also takes poses"),
        ("t,x\n0,1\n0,2\n", r"path\.csv, line 3: the times must increase, got 0 after 0"),
        ("t,x\n0,1\n1,nan\n", "line 3: every entry must be finite"),
    ],
)
def test_errors_in_a_csv_file_name_the_line(tmp_path, text, message):
    path = tmp_path / "path.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        spline_from_csv(path)


def test_csv_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"cannot read the path .*missing\.csv"):
        spline_from_csv(tmp_path / "missing.csv")
    (tmp_path / "binary.csv").write_bytes(b"\x80\x81\x00\x01")
    with pytest.raises(InputError, match="cannot read the path"):
        spline_from_csv(tmp_path / "binary.csv")
