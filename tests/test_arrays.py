"""The checks every argument passes through."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eos_pin._arrays import broadcast, frozen_copy, number, vector
from eos_pin.errors import InputError


def test_readonly_is_a_copy_that_nobody_can_write():
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
def test_every_kind_of_real_number_is_a_number(value, unchecked):
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
def test_vector_refuses_and_says_why(values, says, unchecked):
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
def test_number_refuses_what_is_none(value, unchecked):
    with pytest.raises(InputError, match="period must be a"):
        number(value, "period")


def test_number_keeps_its_bounds():
    assert number(0.0, "x", at_least=0.0) == 0.0
    with pytest.raises(InputError, match=r"x must be a finite number of at least 0, got -1"):
        number(-1, "x", at_least=0.0)
    with pytest.raises(InputError, match=r"x must be a finite number above 0, got 0"):
        number(0, "x", above=0.0)
