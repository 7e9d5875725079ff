"""The checks every argument passes through."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from checks import tip
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import Chart, PoseTask, PositionTask, load_robot
from eos_pin._arrays import broadcast, frozen_copy, number, vector
from eos_pin.errors import InputError


def test_frozen_copy_cannot_be_written():
    original = np.arange(3)
    copy = frozen_copy(original)
    original[0] = 7
    np.testing.assert_array_equal(copy, [0.0, 1.0, 2.0])
    assert copy.dtype == float
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 1.0


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=6))
def test_vector_takes_any_finite_numbers(values):
    np.testing.assert_array_equal(vector(values, len(values), "x"), np.array(values, dtype=float))
    np.testing.assert_array_equal(vector(tuple(values), None, "x"), np.array(values, dtype=float))


@pytest.mark.parametrize("value", [1, True, Fraction(1), Decimal(1), np.int8(1), np.float32(1), 1.0])
def test_real_numbers_of_every_kind_are_numbers(value, unchecked):
    assert number(value, "x") == 1.0
    assert type(number(value, "x")) is float
    np.testing.assert_array_equal(vector([value, value], 2, "x"), [1.0, 1.0])
    np.testing.assert_array_equal(broadcast(value, 3, "x"), [1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([1.0, 2.0], "q must be 3 numbers, got shape (2,)"),
        ([[1.0, 2.0, 3.0]], "got shape (1, 3)"),
        (1.0, "got shape ()"),
        ([1.0, np.nan, np.inf], "entries [1, 2]"),
        (["a", "b", "c"], "q must be numbers"),
        ([1.0, [2.0], 3.0], "q must be numbers"),
        ([1j, 0, 0], "q must be numbers"),
        ([10**400, 0, 0], "q must be numbers"),
        (None, "q must be"),
        (object(), "q must be numbers"),
    ],
)
def test_vector_refuses_with_the_reason(values, says, unchecked):
    with pytest.raises(InputError) as caught:
        vector(values, 3, "q")
    assert says in str(caught.value)


def test_vector_of_any_length_still_has_one_dimension(unchecked):
    assert vector([], None, "x").shape == (0,)
    with pytest.raises(InputError, match="one-dimensional"):
        vector([[1.0]], None, "x")


def test_spread_takes_one_number_or_as_many_as_needed(unchecked):
    np.testing.assert_array_equal(broadcast(2, 3, "kp"), [2.0, 2.0, 2.0])
    np.testing.assert_array_equal(broadcast([1, 2, 3], 3, "kp"), [1.0, 2.0, 3.0])
    for wrong in ([1.0, 2.0], [[1.0]], np.nan, "x", None):
        with pytest.raises(InputError, match="kp must be"):
            broadcast(wrong, 3, "kp")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 10**400, "a", None, [1.0, 2.0], 1j])
def test_number_refuses_other_values(value, unchecked):
    with pytest.raises(InputError, match="period must be a"):
        number(value, "period")


def test_number_keeps_its_bounds():
    assert number(0.0, "x", at_least=0.0) == 0.0
    with pytest.raises(InputError, match=r"x must be a finite number of at least 0, got -1"):
        number(-1, "x", at_least=0.0)
    with pytest.raises(InputError, match=r"x must be a finite number above 0, got 0"):
        number(0, "x", above=0.0)


# -- what a function accepted once ----------------------------------------------------------------------------------


def worse(x):
    """Arrays that look like a good one, and what is to be said of them."""
    bad = x.copy()
    bad[0] = np.nan
    yield bad, "finite"
    yield np.append(x, 0.0), "must be"
    yield x[None], "must be"
    yield ["a"] * len(x), "numbers"


def test_methods_check_every_call_after_one_that_they_accepted(unchecked):
    robots = [load_robot(name, chain_to="auto") for name in ("panda", "ur5")]
    for _ in range(3):
        for robot in robots:
            q = np.full(robot.n, 0.1)
            expected = robot.bias(q, q)
            for other, says in worse(q):
                for arguments in ((other, q), (q, other)):
                    with pytest.raises(InputError, match=says):
                        robot.bias(*arguments)
            strided, single, huge = np.repeat(q, 2)[::2], q.astype(np.float32), np.full(robot.n, 1e200)
            np.testing.assert_array_equal(robot.bias(strided, list(q)), expected)
            np.testing.assert_allclose(robot.bias(single, q), expected, rtol=1e-6)
            assert robot.mass(huge).shape == (robot.n, robot.n)
            with pytest.raises(InputError, match="one per joint"):
                robot.bias(np.full(13 - robot.n, 0.1), q)


def test_chart_checks_every_task_point_after_one_that_it_accepted(panda, unchecked):
    for kind in (PositionTask, PoseTask):
        chart = Chart.from_base(kind(panda, tip(panda)), 0.5 * (panda.lower + panda.upper))
        for _ in range(3):
            np.testing.assert_allclose(chart.inverse(chart.z_bar, chart.v_bar).q, chart.q_bar, atol=1e-9)
            for other, _ in worse(chart.z_bar):
                with pytest.raises(InputError):
                    chart.inverse(other, chart.v_bar)
            with pytest.raises(InputError, match="refresh must be True or False"):
                chart.inverse(chart.z_bar, chart.v_bar, refresh="yes")
            with pytest.raises(InputError, match="tol must be"):
                chart.inverse(chart.z_bar, chart.v_bar, tol=np.nan)
    mirrored = chart.z_bar.copy()
    mirrored[3:6] *= -1.0
    with pytest.raises(InputError, match="orthonormal columns and determinant 1"):
        chart.inverse(mirrored, chart.v_bar)
    # Digits that were rounded are mended, every time.
    rounded = np.round(chart.z_bar, 8)
    for _ in range(3):
        assert chart.inverse(rounded, chart.v_bar).residual <= 1e-10
