"""Errors: one root, data that survives a process boundary, and advice."""

from __future__ import annotations

import copy
import inspect
import pickle

import pytest

from eos_pin import errors
from eos_pin.errors import (
    EosError,
    InverseError,
    MissingDependencyError,
    SingularError,
    UnknownNameError,
    suggest,
)

CLASSES = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]
EXAMPLES = [
    UnknownNameError("frame", "tip0", ["tip", "base"], "Try harder."),
    InverseError("out of reach", 0.25, 17),
    SingularError("rank 2 of 3", 2, [1.0, 0.5, 1e-17]),
    MissingDependencyError("a film", "cinema", "pip install cinema"),
]
EXAMPLES += [kind("something was wrong") for kind in CLASSES if kind not in map(type, EXAMPLES)]


@pytest.mark.parametrize("kind", CLASSES)
def test_errors_are_all_caught_by_one_except(kind):
    assert issubclass(kind, EosError)
    assert kind.__doc__


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_error_survives_pickle_and_copy(error):
    for use_compiled in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(use_compiled) is type(error)
        assert str(use_compiled) == str(error)
        assert use_compiled.__dict__ == error.__dict__


def test_errors_are_also_the_classes_python_would_raise():
    assert issubclass(errors.InputError, ValueError)
    assert issubclass(UnknownNameError, KeyError)
    assert not issubclass(UnknownNameError, errors.RobotError)
    assert issubclass(MissingDependencyError, ImportError)


def test_missing_dependency_error_has_the_command_that_helps():
    error = MissingDependencyError("a film", "cinema", "pip install cinema")
    assert str(error) == "a film needs cinema, which is not installed; run: pip install cinema"
    assert (error.package, error.command) == ("cinema", "pip install cinema")


def test_unknown_name_error_has_near_matches():
    error = UnknownNameError("frame", "panda_hand_tpc", ["panda_hand_tcp", "base"], "Or choose another.")
    assert str(error) == "no frame is named 'panda_hand_tpc'. Did you mean panda_hand_tcp? Or choose another."
    assert (error.kind, error.name) == ("frame", "panda_hand_tpc")
    assert error.available == ("panda_hand_tcp", "base")


def test_suggestions_come_closest_first_then_by_part_then_all():
    assert suggest("wrist", ["ur5_wrist_3_link", "base"]) == "Did you mean ur5_wrist_3_link? "
    assert suggest("xyz", ["base", "tip"]) == "Available: base, tip. "
    assert suggest("xyz", [f"a{i}" for i in range(50)]).endswith("a39 and 10 more. ")
    assert suggest("xyz", []) == "There are none. "


def test_data_of_numerical_errors_is_kept():
    error = SingularError("rank 2 of 3", 2, [1.0, 0.5, 1e-17])
    assert (error.rank, error.singular_values) == (2, (1.0, 0.5, 1e-17))
    error = InverseError("out of reach", 0.25, 17)
    assert (error.residual, error.iterations) == (0.25, 17)
