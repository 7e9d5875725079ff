"""Costs by name: each against a formula of its own, and each draws a plan where it says."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from eos_pin import InputError
from eos_pin.errors import UnknownNameError
from eos_pin.planning.costs import NAMES, costs_of
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.planning.planner import plan
from eos_pin.tasks.batch import Manifold

POINTS = [[0.6, y, 0.5] for y in np.linspace(-0.3, 0.3, 9)]


@pytest.fixture(scope="module")
def clearances(panda):
    bodies = Bodies.of(panda, {"panda_hand": Capsule([0, 0, 0], [0, 0, 0.1], 0.05)})
    return Clearances(bodies, Scene([Box([0.45, 0.3, 0.35], [0.1, 0.1, 0.1], name="crate")]))


def made(cost, task, clearances=None, reference=0.0):
    robot = task.robot
    return costs_of(cost, Manifold(task), (robot.lower, robot.upper), clearances, np.full(robot.n, reference))


def some(panda, count=6):
    return np.random.default_rng(3).uniform(panda.lower, panda.upper, (count, 7))


def test_costs_of_postures_are_their_formulas(panda, task, clearances):
    Q = some(panda)
    assert np.allclose(made("posture", task, reference=0.1).posture(Q), [(q - 0.1) @ (q - 0.1) for q in Q])
    half = 0.5 * (panda.upper - panda.lower)
    assert np.allclose(
        made("limits", task).posture(Q), (((Q - 0.5 * (panda.lower + panda.upper)) / half) ** 2).sum(axis=1)
    )
    data = panda.model.createData()
    loads = [pin.computeGeneralizedGravity(panda.model, data, q) / panda.model.effortLimit for q in Q]
    assert np.allclose(made("torque", task).posture(Q), [load @ load for load in loads])
    near = np.maximum(1.0 - clearances(Q.T) / 0.15, 0.0)
    assert (made("clearance", task, clearances).posture(Q) >= near**2 - 1e-12).all()


def test_cost_of_manipulability_falls_as_it_grows(panda, task):
    Q = some(panda, 30)
    rows = [task.linearize(q)[1] for q in Q]
    w = [np.sqrt(np.linalg.det(J @ J.T)) for J in rows]
    order = np.argsort(w)
    assert (np.diff(made("manipulability", task).posture(Q)[order]) <= 1e-12).all()


def test_energy_weighs_joints_by_their_inertia(panda, task):
    weights = made("energy", task).weights
    assert (weights > 1.0).all()
    # The first joints carry the whole arm.
    assert weights[:2].min() > weights[5:].max()


def test_costs_with_weights_add_up(panda, task):
    Q = some(panda)
    own = lambda Q: np.abs(Q).sum(axis=1)  # noqa: E731
    both = made({"limits": 0.5, own: 2.0, "motion": 3.0}, task)
    assert np.allclose(both.posture(Q), 0.5 * made("limits", task).posture(Q) + 2.0 * own(Q))
    assert np.allclose(both.weights, 3.0)


@pytest.mark.parametrize(
    ("cost", "message"),
    [("comfort", "no cost is named 'comfort'"), ({"limits": -1.0}, "weight"), ("clearance", "nothing to be clear of")],
)
def test_costs_that_cannot_be_used_are_refused(task, cost, message):
    with pytest.raises(InputError, match=message) as error:
        made(cost, task)
    if isinstance(error.value, UnknownNameError):
        assert error.value.available == NAMES


@pytest.fixture(scope="module")
def without(task):
    return plan(task, POINTS)


@pytest.mark.parametrize("name", sorted({*NAMES} - {"motion"}))
def test_plan_with_a_named_cost_has_less_of_it(task, without, clearances, name):
    near = {"scene": clearances.scene, "bodies": clearances.bodies} if name == "clearance" else {}
    drawn, costs = plan(task, POINTS, cost={name: 20.0}, **near), made({name: 20.0}, task, clearances)
    totals = []
    for one in (drawn, without):
        dt, q = np.diff(one.times), one.q
        totals.append(float((costs.weights * np.diff(q, axis=0) ** 2 / dt[:, None]).sum()))
        if costs.posture is not None:
            values = costs.posture(q)
            totals[-1] += 0.5 * float(dt @ (values[1:] + values[:-1]))
    assert totals[0] < 0.995 * totals[1]


def test_plan_command_takes_costs(tmp_path, capsys):
    from eos_pin.cli.main import main

    shape = ["--path", "0.5 0 0.4; 0.5 0.1 0.4"]
    assert main(["plan", "panda", *shape, "--cost", "limits=0.5", "manipulability"]) == 0
    assert main(["plan", "panda", *shape, "--cost", "limits=much"]) == 2
    assert "names with weights" in capsys.readouterr().err
    assert main(["plan", "panda", *shape, "--cost", "comfort"]) == 2
    assert "no cost is named" in capsys.readouterr().err
