"""Every public function, constructor and method with what it cannot take: errors of this package come out, no others.

The names are read from the stubs and the parameters from the signatures. What becomes public fails here until the table
of examples has its parameters.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
import warnings

import numpy as np
import pytest
from border_examples import arguments, callables, callbacks, special, values

import eos_pin

#: What only a backend would say.
FOREIGN = re.compile(
    r"Boost|ArgumentError|/pinocchio/|\.hxx|\.hpp|broadcast|not aligned|C\+\+ signature|has no attribute|__init__"
    r"|unsupported operand|positional argument|ufunc|matmul"
)
#: What may be given where it has no place.
BAD = {
    "None": None,
    "text": "x",
    "an object": object(),
    "a dictionary": {},
    "a complex number": 1j,
    "NaN": float("nan"),
    "infinity": float("inf"),
    "a negative number": -1.0,
    "an empty list": [],
    "an empty array": np.empty(0),
    "a matrix": np.ones((4, 2)),
    "three dimensions": np.ones((2, 2, 2)),
    "too many numbers": np.ones(57),
    "a list with NaN": [float("nan"), 0.0, 0.0],
    "an array with infinity": np.array([0.0, np.inf, 0.0]),
    "words": ["a", "b", "c"],
    "objects": [None, None, None],
    "rows of different lengths": [[0.0], [0.0, 1.0]],
}


def raises(*args, **kwargs):
    """A function of a caller that has a fault of its own."""
    raise ZeroDivisionError("a fault of my own")


#: What functions and classes of a caller may return.
NONSENSE = {
    "nothing": lambda *args: None,
    "words": lambda *args: ["a", "b", "c"],
    "another shape": lambda *args: np.ones((5, 2)),
    "too many numbers": lambda *args: [0.0] * 57,
    "NaN": lambda *args: [float("nan")] * 3,
    "rows of NaN": lambda *args: [[float("nan")] * 3] * 3,
    "an object": lambda *args: object(),
    "an error": raises,
}


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_borders_let_only_errors_of_the_package_out(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", lambda url: False)
    calls, faults = 0, []
    for label, function in callables():
        names, good = arguments(label, function)
        for name in names:
            for what, bad in BAD.items():
                calls += 1
                fault = tried(function, good | {name: bad})
                if fault:
                    faults.append(f"{label}({name}={what}): {fault}")
    for what, call in callbacks():
        for how, nonsense in NONSENSE.items():
            calls += 1
            fault = tried(call, {"f": nonsense})
            if fault:
                faults.append(f"{what} returns {how}: {fault}")
    print(f"{calls} calls, {len(faults)} faults")
    assert calls > 15000
    assert not faults, "\n".join(faults)


def tried(function, keywords) -> str:
    """What came out that should not; empty if nothing did."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            made = function(**keywords)
            if isinstance(made, eos_pin.Viewer):
                made.close()
    except eos_pin.EosError as error:
        return str(error)[:100] if FOREIGN.search(str(error)) else ""
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:60]}"
    return ""


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_borders_take_lists_for_arrays(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", lambda url: False)
    compared, faults = 0, []
    for label, function in callables():
        names, good = arguments(label, function)
        for name in names:
            given = good.get(name, special(label).get(name, values().get(name)))
            if not isinstance(given, np.ndarray):
                continue
            try:
                whole = function(**good | {name: given})
            except eos_pin.EosError:
                continue
            compared += 1
            try:
                listed = function(**good | {name: given.tolist()})
            except Exception as error:
                faults.append(f"{label}({name}=a list): {type(error).__name__}: {str(error)[:90]}")
                continue
            if apart := difference(whole, listed):
                faults.append(f"{label}({name}=a list): {apart}")
    print(f"{compared} results of lists, {len(faults)} faults")
    assert compared > 250
    assert not faults, "\n".join(faults)


def difference(a, b, depth=0) -> str:
    """Where two results differ; empty where they do not. What has no values that are known here counts as equal."""
    if type(a) is not type(b):
        return f"{type(a).__name__} and {type(b).__name__}"
    if isinstance(a, np.ndarray):
        return "" if a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype == float) else f"{a} and {b}"
    if isinstance(a, (int, str, bytes, bool)):
        return "" if a == b else f"{a} and {b}"
    if isinstance(a, float):
        return "" if a == b or (a != a and b != b) else f"{a} and {b}"
    if isinstance(a, (tuple, list)):
        return "; ".join(filter(None, (difference(x, y, depth + 1) for x, y in zip(a, b, strict=True))))
    if dataclasses.is_dataclass(a) and depth < 3:
        parts = [field.name for field in dataclasses.fields(a) if field.name != "info"]
        return "; ".join(filter(None, (difference(getattr(a, p), getattr(b, p), depth + 1) for p in parts)))
    return ""
