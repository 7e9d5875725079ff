"""`AccelerationMap`: joint accelerations of a control law, near singularities of the task and far from them."""

from __future__ import annotations

import checks
import numpy as np
import pytest
from checks import all_tasks
from hypothesis import assume, given
from hypothesis import strategies as st

from eos_pin import Chart, ChartError
from eos_pin.charts import directions
from eos_pin.control import _regularize as linear
from eos_pin.control._regularize import AccelerationMap

TASKS = all_tasks()
every = checks.every(TASKS)


def base(data, task):
    """A chart whose base point is not close to a singularity."""
    q = data.draw(checks.joints(task.robot))
    assume(np.linalg.cond(task.linearize(q)[1]) < 1e3)
    return Chart.from_base(task, q)


@every
@given(data=st.data())
def test_acceleration_fades_only_near_singularities(task, data):
    """Far from them dq changes nothing; at one the result is still a bounded number."""
    chart = base(data, task)
    dq, ddw = data.draw(checks.velocities(task.robot)), data.draw(checks.numbers(chart.n))
    for limit in (0, 16):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(directions, "DENSE", limit)
            plain = chart.acceleration(chart.U.T, ddw[: chart.m], ddw[chart.m :])
            drive = AccelerationMap(chart)
            if np.linalg.svd(chart.U, compute_uv=False)[-1] > 0.5 * max(1.0, task.robot.reach):
                np.testing.assert_allclose(drive(chart.U.T, ddw, dq)[0], plain, atol=1e-9 * np.abs(plain).max())
            lost, _ = drive(0.0 * chart.U.T, ddw, dq)
            speed = np.linalg.norm(dq)
            most = linear.BRAKING_RATE * speed * max(1.0, speed / linear.FAST_SPEED) + np.linalg.norm(ddw)
            assert np.linalg.norm(lost) <= 2.0 * most / linear.SINGULAR_VALUE_FLOOR
            with pytest.raises(ChartError, match="edge"):
                AccelerationMap(chart, smooth=False)(0.0 * chart.U.T, ddw, dq)


@every
@given(data=st.data())
def test_margin_that_comes_with_the_acceleration_is_a_lower_bound(task, data):
    """H = [U B, D], and the least inverse singular value of D is the margin."""
    chart = base(data, task)
    J = task.linearize(chart.q_bar + 0.3 * data.draw(checks.numbers(chart.n)))[1]
    drive, zero = AccelerationMap(chart), np.zeros(chart.n)
    assert drive(J, zero, zero)[1] <= chart.margin(J) + 1e-9
    assert drive(chart.U.T, zero, zero)[1] in (pytest.approx(1.0), 0.0)


@every
def test_self_motion_of_joints_that_run_away_is_braked(task, monkeypatch):
    """Beyond 16 rad/s by ten times the excess, and the task feels nothing of it."""
    random = np.random.default_rng(5)
    chart = Chart.from_base(task, checks.random_state(task.robot, random)[0])
    along, zero = chart.V @ random.normal(size=chart.r), np.zeros(chart.n)
    along /= np.linalg.norm(along) or 1.0
    for smooth in (True, False):
        drive = AccelerationMap(chart, smooth=smooth)
        drive.most = np.inf  # nothing fades
        for most, call in ((40, lambda *state, drive=drive: drive(*state)[0]), (0, drive._for_many_joints)):
            monkeypatch.setattr(directions, "DENSE", most)
            for speed, braking in ((15.0, 0.0), (20.0, 10.0 * 4.0 * 20.0 * smooth)):
                ddq = call(chart.U.T, zero, speed * along)
                np.testing.assert_allclose(ddq, -braking * along, atol=1e-9 * max(1.0, braking))
