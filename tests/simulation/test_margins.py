"""Ratios to the limits: right values on runs made by hand, and told wherever a run is shown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from eos_pin import EosController, Hold, PositionTask, Result, Robot, simulate
from eos_pin.cli.output import console
from eos_pin.cli.tables import run_table
from eos_pin.plots.panels import plot_joints
from eos_pin.simulation._recorder import joint_run
from eos_pin.simulation.limit_use import limits_of, use_of_limits
from eos_pin.viewer.replay import scene_of


def bounds(**changes):
    """Limits of three joints: two that turn, one of them without limits, and one that slides."""
    plain = {
        "joints": ["a", "b", "c"],
        "units": ["rad", "rad", "m"],
        "lower": [-1.0, None, 0.0],
        "upper": [3.0, None, 0.5],
        "velocity": [2.0, 4.0, None],
        "torque": [10.0, None, 100.0],
    }
    return plain | changes


Q = np.array([[1.0, 50.0, 0.25], [-0.5, -9.0, 0.4]])
DQ = np.array([[0.5, -3.0, 9.0], [-1.0, 1.0, 9.0]])
TAU = np.array([[2.0, 1e6, -30.0], [-5.0, 0.0, 0.0]])


def test_ratios_are_those_to_the_middle_of_the_range_and_to_the_largest_value():
    found = use_of_limits(bounds(), Q, DQ, TAU)
    for kind, expected in (("position", [0.75, np.nan, 0.6]), ("velocity", [0.5, 0.75, np.nan])):
        np.testing.assert_allclose(list(found[kind]["per_joint"].values()), expected)
    np.testing.assert_allclose(list(found["torque"]["per_joint"].values()), [0.5, np.nan, 0.3])
    assert (found["position"]["joint"], found["velocity"]["joint"], found["torque"]["joint"]) == ("a", "b", "a")
    assert (found["worst"], found["passed"], found["position"]["beyond"]) == (0.75, False, 0.0)
    assert found["message"] == "kept: position 75%, velocity 75%, torque 50%"


def test_limits_that_are_passed_are_reported_with_joint_and_size():
    found = use_of_limits(bounds(), Q + np.array([2.2, 0.0, 0.0]), 2.0 * DQ, TAU)
    assert found["passed"]
    assert found["message"] == "passed: position by 0.2 rad (a), velocity 1.5 times (b)"
    assert found["position"]["beyond"] == pytest.approx(0.2)
    assert found["worst"] == pytest.approx(1.5)
    found = use_of_limits(bounds(), Q + np.array([0.0, 0.0, 0.7]), DQ, 3.0 * TAU)
    assert found["message"] == "passed: position by 0.6 m (c), torque 1.5 times (a)"


def test_limits_that_a_robot_lacks_are_none_moving_or_not(panda):
    model = panda.model.copy()
    model.effortLimit, model.velocityLimit = np.full(7, np.inf), np.full(7, np.inf)
    endless = replace(panda, model=model, source="", urdf_sha256="")
    for moving in (True, False):
        assert (
            limits_of(endless, moving=moving)["torque"] == limits_of(endless, moving=moving)["velocity"] == [None] * 7
        )


@pytest.mark.parametrize(("upper", "beyond"), [(None, 0.5), (-1.0, 2.0)])
def test_range_without_width_or_end_still_reports_passed_limits(upper, beyond):
    q = Q - [1.0, 0.0, 0.0] if upper is None else Q
    found = use_of_limits(bounds(upper=[upper, None, 0.5]), q, DQ, TAU)
    assert found["position"]["beyond"] == pytest.approx(beyond)
    assert found["position"]["ratio"] == pytest.approx(1.0 + beyond)
    assert found["passed"]


def test_robot_without_limits_and_a_run_without_samples_have_no_ratios():
    nothing = [None] * 3
    found = use_of_limits(bounds(lower=nothing, upper=nothing, velocity=nothing, torque=nothing), Q, DQ, TAU)
    assert math.isnan(found["worst"])
    assert (found["passed"], found["message"]) == (False, "the robot has none")
    assert not use_of_limits({}, Q, DQ, TAU)["passed"]
    assert not use_of_limits(bounds(), Q[:0], DQ[:0], TAU[:0])["passed"]


def pressed(result: Result, robot: Robot, i: int = 3, by: float = 0.3) -> Result:
    """The same run with one joint beyond its limit at the end."""
    q = result.q.copy()
    q[-1, i] = robot.upper[i] + by
    return replace(result, q=q)


@pytest.fixture(scope="module")
def still(panda) -> Result:
    task = PositionTask(panda, "panda_hand_tcp")
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    return simulate(panda, EosController(task, Hold(task.value(q))), q, duration=0.1)


def test_run_has_its_ratios_in_summary_table_caption_and_file(panda, still, tmp_path):
    assert still.limits["torque"]["ratio"] == pytest.approx((np.abs(still.tau) / panda.effort).max())
    assert still.summary()["limits"]["message"].startswith("kept: position ")
    run = Result.load(pressed(still, panda).save(tmp_path / "run.npz"))
    told = "passed: position by 0.3 rad (panda_joint4)"
    assert run.status == "finished"
    assert run.summary()["limits"]["message"] == told
    assert run.summary()["limit_ratio_max"] > 1.0
    with console.capture() as capture:
        console.print(run_table(run.summary()))
    said = capture.get()
    assert "limits" in said
    assert "by 0.3 rad" in said
    assert scene_of(run, panda).caption.endswith(f"; limits {told}")


def test_run_of_an_earlier_version_has_no_ratios(still):
    run = replace(still, info={key: value for key, value in still.info.items() if key != "limits"})
    assert math.isnan(run.summary()["limit_ratio_max"])
    run_table(run.summary())


def test_joints_without_dynamics_have_ratios_of_position_only(panda, still):
    task = PositionTask(panda, "panda_hand_tcp")
    found = joint_run(task, still.t, still.q, still.z).limits
    assert found["position"]["ratio"] == still.limits["position"]["ratio"]
    assert math.isnan(found["velocity"]["ratio"])
    assert math.isnan(found["torque"]["ratio"])
    assert limits_of(panda)["torque"] == panda.effort.tolist()


def test_joints_panel_has_lines_at_limits_that_are_near(panda, still):
    def dashed(result: Result) -> set[float]:
        ax = Figure().add_subplot()
        plot_joints(ax, result, panda)
        return {float(line.get_ydata()[0]) for line in ax.lines if line.get_linewidth() == 0.7}

    upper = float(panda.upper[3])
    assert dashed(still) == set()
    assert dashed(pressed(still, panda)) == {upper}
