"""Equality and hashes of everything public: values by what they hold, all else by identity."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from border_examples import name_of, objects

import eos_pin
from eos_pin.control.base import ControlReport

#: What has a workspace or a memory, or holds shapes that may change, is equal to itself only.
THINGS = {"Atlas", "Avoidance", "Chart", "ChartPoint", "Clearance", "CoupledRobot", "ExtendedDynamics", "MujocoPlant"}
THINGS |= {"Obstacle", "Robot", "SelfMotionManifold", "TaskSpaceDynamics"}


def is_value(kind):
    frozen = dataclasses.is_dataclass(kind) and kind.__dataclass_params__.frozen
    return (frozen or issubclass(kind, tuple)) and name_of(kind) not in THINGS


def again(thing):
    """A value of the same parts, whose arrays are other objects."""
    copied = lambda part: part.copy() if isinstance(part, np.ndarray) else part  # noqa: E731
    if isinstance(thing, tuple):
        return type(thing)(*map(copied, thing))
    twin = object.__new__(type(thing))
    vars(twin).update({name: copied(part) for name, part in vars(thing).items()})
    return twin


def compare(a, b):
    """Whether two things are equal; both operators agree, and equal things have equal hashes."""
    equal, unequal = a == b, a != b
    assert type(equal) is type(unequal) is bool
    assert equal != unequal
    assert not equal or hash(a) == hash(b)
    assert len({a, b}) == (1 if equal else 2)
    return equal


@pytest.mark.usefixtures("unchecked")
def test_public_objects_compare_and_hash():
    for kind, thing in objects().items():
        label = name_of(kind)
        assert compare(thing, thing), label
        assert not compare(thing, 3), label
        assert not compare(thing, None), label
        if not is_value(kind):
            assert kind.__eq__ is object.__eq__, f"{label} is no value"
            continue
        assert compare(thing, again(thing)), label
        for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
            other = again(thing)
            object.__setattr__(other, field.name, "another")
            assert not compare(thing, other), f"{label}.{field.name}"


def test_trajectories_are_equal_where_they_are_made_alike():
    make = [
        lambda x: eos_pin.Hold([1.0, x]),
        lambda x: eos_pin.circle([0.0, 0.0, x], 0.1, period=2.0),
        lambda x: eos_pin.cubic_spline([[0.0], [1.0], [x], [0.0]], [0.0, 1.0, 2.0, 3.0]),
        lambda x: eos_pin.minimum_jerk([[0.0], [1.0], [x]], [0.0, 1.0, 2.0]),
        lambda x: eos_pin.rotation_spline([np.eye(3), _turned(x), np.eye(3)], [0.0, 1.0, 2.0]),
        lambda x: eos_pin.PoseTrajectory(position=eos_pin.Hold([0.0, 0.0, x]), orientation=np.eye(3)),
    ]
    for one in make:
        assert compare(one(0.5), one(0.5))
        assert not compare(one(0.5), one(0.25))
    assert compare(eos_pin.Hold([0.0]), eos_pin.Hold([-0.0]))
    assert not compare(eos_pin.Hold([1.0, 2.0]), eos_pin.Hold([1.0, 2.0], m=1))


def test_values_with_nan_are_equal_to_their_copies():
    report = ControlReport(*(np.array([np.nan, 1.0]) for _ in range(5)))
    assert compare(report, again(report))


def test_subclass_of_a_value_is_equal_to_itself_only():
    class Moving(eos_pin.Hold):
        speed = 0.0

    one = Moving([1.0])
    assert compare(one, one)
    assert not compare(one, Moving([1.0]))
    assert not compare(one, eos_pin.Hold([1.0]))


def test_saved_run_is_equal_after_a_load(tmp_path):
    robot = eos_pin.load_robot("ppr")
    task = eos_pin.PositionTask(robot, eos_pin.default_frame(robot), "xy")
    q = np.array([0.3, 0.2, 0.4])
    run = eos_pin.simulate(robot, eos_pin.EosController(task, task.hold(q)), q, duration=0.02)
    run.save(tmp_path / "run.npz")
    assert compare(eos_pin.Result.load(tmp_path / "run.npz"), run)


def _turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
