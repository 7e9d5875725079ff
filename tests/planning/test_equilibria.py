"""Equilibria of the self-motion under gravity: closed forms, scans, and simulated motions."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from eos_pin import (
    Hold,
    InputError,
    OperationalSpaceController,
    load_robot,
    make_task,
    rest_posture,
    self_motion_manifold,
    simulate,
)
from eos_pin.planning import equilibria
from eos_pin.planning.manifolds.equilibria import Equilibrium, crossings, slopes

pytestmark = pytest.mark.usefixtures("unchecked")
PAGE = (Path(__file__).parents[2] / "docs" / "explore.md").read_text(encoding="utf-8")


@cache
def found_at(name: str, kind: str, **options):
    """Manifold at the rest posture, and its equilibria."""
    robot = load_robot(name, chain_to="auto", **options)
    task = make_task(robot, kind)
    q = rest_posture(task)
    manifold = self_motion_manifold(task, task.value(q), starts=[q], most=60)
    return manifold, equilibria(manifold, starts=[q], count=4)


@pytest.fixture
def panda_pose(unchecked: None):
    return found_at("panda", "pose")


@pytest.fixture
def hanging(unchecked: None):
    return found_at("planar_chain_10", "position", gravity=(0.0, -9.81, 0.0))


def on_the_page(what: str) -> list[int]:
    """Numbers of stable equilibria, of their frequencies, and of unstable ones that the page has."""
    (row,) = re.findall(rf"\| {what} \| (\d+) \| (\d+) \| .*?% \| (\d+) \|", PAGE)
    return list(map(int, row))


def counts(found: Sequence[Equilibrium]) -> list[int]:
    stable = [each for each in found if each.stable]
    return [len(stable), sum(len(each.frequencies) for each in stable), len(found) - len(stable)]


def coordinate(each: Equilibrium, mode: int, task, q) -> np.ndarray:
    """Motion along one mode."""
    away = np.array([task.robot.way(each.q, row) for row in q])
    return away @ (task.robot.mass(each.q) @ each.modes[:, mode])


def moved(manifold, each: Equilibrium, mode: int, size: float, duration: float):
    """A run of the robot, whose task is held by forces on it alone, from close to an equilibrium."""
    task = manifold.task
    start = task.kinematics.project((each.q + size * each.modes[:, mode])[None], manifold.z, tol=1e-11).q[0]
    controller = OperationalSpaceController(task, Hold(manifold.z, task.m))
    run = simulate(task.robot, controller, start, duration=duration, record_rate=200.0, rtol=1e-10)
    assert run.ok
    return run.t, coordinate(each, mode, task, run.q)


def frequency(t: np.ndarray, x: np.ndarray) -> float:
    """Frequency of an oscillation by its zero crossings [Hz]."""
    i = np.flatnonzero((x[1:] >= 0.0) != (x[:-1] >= 0.0))
    cross = t[i] - x[i] * (t[i + 1] - t[i]) / (x[i + 1] - x[i])
    return (len(cross) - 1) / (2.0 * (cross[-1] - cross[0]))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "component"), [("panda", 0), ("panda", 2), ("xarm7", 0), ("xarm7", 2)])
def test_equilibria_predict_small_motions_of_arms(name: str, component: int) -> None:
    manifold, found = found_at(name, "pose")
    own = [each for each in found if each.component == component]
    (stable,) = (each for each in own if each.stable)
    (unstable,) = (each for each in own if not each.stable)
    t, x = moved(manifold, stable, 0, 1e-3, 2.6 / stable.frequencies[0])
    assert frequency(t, x) == pytest.approx(stable.frequencies[0], rel=0.01)
    assert np.abs(x).max() < 1.1e-3
    # Half an exponential falls: from rest x = size cosh(growth t).
    t, x = moved(manifold, unstable, 0, 1e-5, 6.0 / unstable.growth[0])
    assert np.abs(x[-1]) > 100.0 * np.abs(x[0])
    late = t > 3.0 / unstable.growth[0]
    rate = np.polyfit(t[late], np.log(np.abs(x[late])), 1)[0]
    assert rate == pytest.approx(unstable.growth[0], rel=0.01)


@pytest.mark.slow
def test_equilibria_predict_small_motions_of_a_chain(hanging) -> None:
    manifold, found = hanging
    lowest = found[0]
    assert lowest.stable
    assert len(lowest.frequencies) == 8
    for mode in (2, 7):
        t, x = moved(manifold, lowest, mode, 1e-3, 3.1 / lowest.frequencies[mode])
        assert frequency(t, x) == pytest.approx(lowest.frequencies[mode], rel=0.01)
    highest = found[-1]
    assert not highest.stable
    t, x = moved(manifold, highest, 0, 1e-5, 6.0 / highest.growth.max())
    assert np.abs(x[-1]) > 100.0 * np.abs(x[0])


@pytest.mark.parametrize("name", ["panda", "xarm7"])
def test_equilibria_miss_nothing(name: str) -> None:
    manifold, found = found_at(name, "pose")
    assert counts(found) == on_the_page(f"{name}, pose")
    for i, component in enumerate(manifold.components):
        s = np.linspace(0.0, component.length, math.ceil(component.length / 1e-3))
        d = slopes(manifold.task.robot, component, s)
        changes = s[np.flatnonzero((d[1:] >= 0.0) != (d[:-1] >= 0.0))]
        own = np.array([each.s for each in found if each.component == i])
        assert len(own) == len(changes)
        assert np.abs(np.sort(own) - changes).max() < 1.1e-3
        # On a closed curve hills and valleys take turns.
        kinds = [each.stable for each in found if each.component == i]
        assert all(a != b for a, b in zip(kinds, kinds[1:] + kinds[:1], strict=True))


def test_stiffness_is_the_second_derivative_of_the_potential(panda_pose) -> None:
    manifold, found = panda_pose
    robot = manifold.task.robot
    for each in found[:4]:
        component, h = manifold.components[each.component], 1e-3
        s = each.s + h * np.arange(-2, 3)
        energy = np.array([robot.potential_energy(q) for q in component.at(s)])
        second = energy @ np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * h * h)
        assert each.stiffness[0, 0] == pytest.approx(second, rel=2e-4)
        assert energy[2] == pytest.approx(each.potential)


def test_equilibria_of_many_joints_are_level_and_symmetric(hanging) -> None:
    manifold, found = hanging
    # How many unstable ones a search finds is a matter of chance.
    assert counts(found)[:2] == on_the_page("planar_chain_10, position")[:2]
    task = manifold.task
    assert [each.potential for each in found] == sorted(each.potential for each in found)
    for each in found:
        J = task.linearize(each.q)[1]
        g = task.robot.gravity(each.q)
        # Gravity is balanced by a force on the task alone.
        assert np.abs(g - J.T @ np.linalg.lstsq(J.T, g, rcond=None)[0]).max() < 1e-6
        M = task.robot.mass(each.q)
        assert np.allclose(each.modes.T @ M @ each.modes, np.eye(8), atol=1e-9)
        assert len(each.frequencies) + len(each.growth) == 8


def test_crossings_lead_over_the_highest_point_between(panda_pose) -> None:
    manifold, found = panda_pose
    ways = crossings(manifold, found)
    assert ways
    for way in ways:
        component = manifold.components[found[way.start].component]
        s = np.linspace(0.0, component.length, 4000)
        energy = [manifold.task.robot.potential_energy(q) for q in component.at(s)]
        # One hill: the highest of all.
        assert way.energy == pytest.approx(max(energy) - found[way.start].potential, abs=1e-3)
        assert found[way.start].stable
        assert not found[way.top].stable


def test_equilibria_refuse_a_plane_that_lies_flat() -> None:
    with pytest.raises(InputError, match=r"gravity does no work on the self-motion.*--gravity 0 -9.81 0"):
        found_at("planar_chain_10", "position")
