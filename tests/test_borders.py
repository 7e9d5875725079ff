"""Every public function, constructor and method with what it cannot take: errors of this package come out, no others.

The names are read from the stubs and the parameters from the signatures. What becomes public fails here until the table
of examples has its parameters.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import inspect
import io
import re
import warnings

import numpy as np
import pytest
from border_examples import arguments, callables, callbacks, objects, special, values

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


def uses():
    """Objects whose attributes may be assigned, and a use of each, by class."""
    q, dq, chart = (values()[name] for name in ("q", "dq", "chart"))
    steps = {
        eos_pin.ControlLoop: lambda loop: loop.step(0.0, q, dq),
        eos_pin.KinematicLoop: lambda loop: loop.step(0.0, q),
        eos_pin.Controller: lambda own: own.torque(0.0, q, dq, own.start(0.0, q, dq)),
        eos_pin.Objective: lambda law: law.acceleration(0.0, q, dq, chart),
    }
    for kind, use in steps.items():
        yield from ((made, use) for made in objects().values() if isinstance(made, kind))


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_borders_check_assigned_values() -> None:
    calls, faults = 0, []
    for made, use in uses():
        own = [name for name, part in inspect.getmembers(type(made)) if getattr(part, "fset", None) is not None]
        # The memory of a loop is its controller's own matter.
        for name in [name for name in (*vars(made), *own) if not name.startswith("_") and name != "state"]:
            for what, bad in BAD.items():
                calls += 1
                fault = tried(assigned, {"made": made, "use": use, "name": name, "value": bad})
                if fault:
                    faults.append(f"{type(made).__name__}.{name} = {what}: {fault}")
    print(f"{calls} assignments, {len(faults)} faults")
    assert calls > 1400
    assert not faults, "\n".join(faults)


def assigned(made, use, name, value):
    """What a copy does with another attribute; nothing where it is frozen."""
    other = copy.copy(made)
    try:
        setattr(other, name, value)
    except AttributeError:
        return None
    return use(other)


@pytest.mark.usefixtures("unchecked")
def test_borders_check_settings() -> None:
    trial, plan = (objects()[kind] for kind in (eos_pin.Trial, eos_pin.Plan))
    near = plan(0.0).q + 0.01
    settings = [(eos_pin.Trial.from_settings, {"robot": "ppr"}, name) for name in trial.settings if name != "robot"]
    settings += [(eos_pin.trials, {"robot": "ppr"}, name) for name in trial.settings if name != "robot"]
    settings += [(eos_pin.journey, {"plan": plan, "q": near}, name) for name in ("scene", "cost", "margin")]
    faults = []
    for function, good, name in settings:
        for what, bad in BAD.items():
            fault = tried(function, good | {name: bad})
            if fault:
                faults.append(f"{function.__name__}({name}={what}): {fault}")
    print(f"{len(settings) * len(BAD)} settings, {len(faults)} faults")
    assert not faults, "\n".join(faults)


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
