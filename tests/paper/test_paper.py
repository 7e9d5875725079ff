"""The paper: its printed formulas, its examples and its claims."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import typecheck
from checks import EXACT, INTEGRATED, exact, integration_error
from PIL import Image

from eos_pin import (
    Atlas,
    Chart,
    Damp,
    DescendPotential,
    EosController,
    ExtendedDynamics,
    Hold,
    InputError,
    PositionTask,
    TaskSpaceDynamics,
    simulate,
)
from eos_pin.errors import OutputError
from eos_pin.paper import claims as claiming
from eos_pin.paper import examples as paper
from eos_pin.paper.animation import write_gif
from eos_pin.paper.claims import Claim
from eos_pin.paper.figures import motion, page, paper_figures, paths
from eos_pin.plots import pages as plots

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "scripts"))
import reproduce  # noqa: E402
from claim_tables import PLAN, beside_table, claims_table, study_table, update_block  # noqa: E402


@pytest.fixture(scope="module")
def runs():
    """Every run of the plan, without the run-time type checks, which would take minutes."""
    with typecheck.off():
        return {
            label: {name: experiment.run() for name, experiment in make().experiments.items()}
            for label, make in PLAN.items()
        }


def drifts(result):
    return result.joint_drift_per_cycle


# -- what is printed, and what holds ---------------------------------------------------------------------------------


@pytest.fixture
def state():
    """The planar robot on the chart at y = 0, somewhere off its base and moving."""
    task, *_ = paper.planar_robot()
    random = np.random.default_rng(7)
    q, dq = random.uniform(-0.6, 0.6, 3), random.uniform(-1.0, 1.0, 3)
    return task, Chart.from_base(task, np.zeros(3)), q, dq


def test_planar_robot_is_the_one_of_section_4_3(state):
    task, _, q, dq = state
    s, c, w = math.sin(q[2]), math.cos(q[2]), dq[2]
    robot = task.robot
    assert np.abs(robot.mass(q) - [[3, 0, -s], [0, 2, c], [-s, c, 1]]).max() < EXACT
    R = np.array([w * w * c, w * w * s - 2 * paper.GRAVITY, -paper.GRAVITY * c])
    assert np.abs(robot.bias(q, dq) + R).max() < 100 * EXACT
    z, J = task.linearize(q)
    assert np.abs(z - [q[0] + c, q[1] + s]).max() < EXACT
    assert np.abs(J - [[1, 0, -s], [0, 1, c]]).max() < EXACT


def test_chart_at_zero_is_the_one_printed_in_section_4_3():
    task, *_ = paper.planar_robot()
    chart = Chart.from_base(task, np.zeros(3))
    # U spans the rows of G', V is their complement; the sign of V is anyone's choice.
    V = np.array([0.0, -1.0, 1.0]) / math.sqrt(2.0)
    assert min(np.abs(chart.V[:, 0] - V).max(), np.abs(chart.V[:, 0] + V).max()) < EXACT
    assert np.abs(chart.U.T @ chart.V).max() < EXACT


def test_equation_30_holds_as_corrected_and_not_as_printed(state):
    task, chart, q, dq = state
    tau, force = np.array([0.0, 9.0, 0.5]), np.array([0.0, 9.0])
    point = chart.point(q, dq)
    M, H_inverse = task.robot.mass(q), np.vstack((point.task.J, chart.V.T))
    total = tau - task.robot.bias(q, dq) + point.task.J.T @ force
    # What the joints do, and from it what w = (z, v) does by the chain rule.
    ddq = np.linalg.solve(M, total)
    ddw = np.concatenate((point.task.J @ ddq + point.task.drift, chart.V.T @ ddq))
    corrected = H_inverse @ (np.linalg.solve(M, total) - point.E)
    printed = -H_inverse @ point.E + np.linalg.solve(M, H_inverse @ total)
    assert np.abs(corrected - ddw).max() < 100 * exact(M, H_inverse)
    assert np.abs(ExtendedDynamics.from_state(task.robot, chart, q, dq).acceleration(tau, force) - ddw).max() < 1e-11
    assert np.abs(printed - ddw).max() > 0.1


def test_mu_needs_the_time_derivative_of_the_jacobian(state):
    task, _, q, dq = state
    point, robot = task.at(q, dq), task.robot
    dynamics = TaskSpaceDynamics(robot, q, dq, point)
    wanted = np.array([0.3, -0.7])

    def reached(mu):
        force = dynamics.Lambda @ wanted + mu + dynamics.p
        ddq = robot.forward_dynamics(q, dq, point.J.T @ force)
        return point.J @ ddq + point.drift

    S = robot.gravity(q) - robot.bias(q, dq)
    printed = -dynamics.Lambda @ (point.J @ np.linalg.solve(robot.mass(q), S)) - dynamics.Lambda @ (point.J @ dq)
    assert np.abs(reached(dynamics.mu) - wanted).max() < 1e-11
    assert np.abs(reached(printed) - wanted).max() > 0.1


def test_chain_is_the_one_of_section_6_with_gravity_along_minus_y():
    task, *_ = paper.planar_chain(gravity=True)
    random = np.random.default_rng(3)
    q = random.uniform(-1.0, 1.0, 10)
    angles = np.cumsum(q[2:])
    z, J = task.linearize(q)
    assert np.abs(z - [q[0] + np.cos(angles).sum(), q[1] + np.sin(angles).sum()]).max() < 20 * EXACT
    # Column k of the Jacobian sums over the links from k on.
    columns = [[-np.sin(angles[k:]).sum(), np.cos(angles[k:]).sum()] for k in range(8)]
    assert np.abs(J - np.column_stack((np.eye(2), np.transpose(columns)))).max() < 20 * EXACT
    # Q^y = −g Σ m (∂r/∂y)ᵀ [0 1]ᵀ over ten unit masses: one at each slider, one at the end of each link. Three
    # components, as printed, would not multiply with masses that lie in a plane.
    Q = np.zeros(10)
    Q[1] = 9.0
    for i in range(8):
        for k in range(i + 1):
            Q[2 + k] += np.cos(angles[k : i + 1]).sum()
    assert np.abs(task.robot.gravity(q) - paper.STANDARD_GRAVITY * Q).max() < 1e3 * EXACT


def test_chain_starts_as_a_closed_octagon_on_its_path():
    task, path, q, _ = paper.planar_chain()
    assert np.abs(task.value(q) - path(0.0).z).max() < 20 * EXACT
    # The eight entries that are printed leave two joints out; those at the front straight, it is no octagon.
    printed = np.concatenate((np.zeros(2), -0.25 * np.pi * np.array([0, 0, 1, 1, 1, 1, 1, 1])))
    assert np.abs(task.value(printed) - path(0.0).z).max() > 0.5


# -- what the examples show ------------------------------------------------------------------------------------------


def test_forms_of_the_equations_agree(unchecked):
    example = paper.equivalence(duration=2.0, threshold=0.5, rtol=1e-9)
    joints, extended = (experiment.run() for experiment in example.experiments.values())
    assert not len(extended.switches)
    assert integration_error(extended.q, joints.q) < INTEGRATED


def test_velocity_control_drifts_and_charts_do_not(unchecked):
    runs = {name: e.run() for name, e in paper.noncyclic(cycles=3).experiments.items()}
    assert drifts(runs["velocity control"]).min() > 0.05
    assert drifts(runs["charts"]).max() < 1e-11
    assert np.array_equal(runs["charts"].z_ref, runs["velocity control"].z_ref)


def test_path_of_several_charts_repeats_only_once_the_joints_have_found_one(unchecked):
    run = paper.noncyclic(robot="planar_chain_10", path="circle", cycles=20).experiments["charts"].run()
    assert run.ok
    assert len(run.switches) > 5
    assert drifts(run)[0] > 0.1
    assert drifts(run)[-1] < 1e-9


@pytest.mark.parametrize("threshold", [0.5, 0.7, 0.9])
def test_undamped_self_motion_runs_away_from_chart_to_chart(threshold, unchecked):
    # With ddv = 0 on each chart, dv is constant there; the joints move faster by 1 / margin. So the next chart begins
    # with dv larger by 1 / threshold, and is used up sooner by as much: infinitely many charts take a finite time.
    task = PositionTask(paper.planar_robot().task.robot, "tip", "xy")
    law = {"atlas": Atlas(task, threshold=threshold), "smooth": False}
    controller = EosController(task, Hold([1.0, 0.0]), Damp(0.0), **law)
    start = 0.3 * np.array([0.0, -1.0, 1.0]) / math.sqrt(2.0)
    run = simulate(task.robot, controller, np.zeros(3), start, duration=40.0, record_rate=10.0)
    assert not run.ok
    lengths = np.diff(run.switches)[:6]
    assert np.abs(lengths[1:] / lengths[:-1] - threshold).max() < 1e-4
    assert run.t[-1] < run.switches[0] + lengths[0] / (1.0 - threshold) + 0.2
    damped = EosController(task, Hold([1.0, 0.0]), Damp(1.0), **law)
    assert simulate(task.robot, damped, np.zeros(3), start, duration=40.0, record_rate=10.0).ok


def test_printed_distance_repels_from_below_and_a_negative_one_from_above(unchecked):
    for offset, side in ((3.0, 1.0), (-3.0, -1.0)):
        run = paper.obstacle(cycles=1, offset=offset, damping=20.0).experiments["eos"].run()
        still = paper.self_motion_tracking(cycles=1).experiments["eos"].run()
        assert side * (run.q[-1, 1] - still.q[-1, 1]) > 1e-3


@pytest.mark.parametrize("options", [{"cycles": 0}, {"offset": 0.0}, {"damping": -1.0}, {"offset": math.nan}])
def test_examples_refuse_settings_that_cannot_be_run(options):
    with pytest.raises(InputError):
        paper.obstacle(**options)


@pytest.mark.slow
def test_kinetic_energies_have_the_order_of_the_paper_only_at_its_gain(runs, unchecked):
    def means(found):
        return {name: claiming._mean_energy(run) for name, run in found.items()}

    stronger = paper.kinetic_energy(gain=10.0).only("eos", "task-space-energy").experiments
    one, ten = means(runs["5.3"]), means({name: experiment.run() for name, experiment in stronger.items()})
    assert one["eos"] < one["task-space-energy"]
    assert ten["eos"] > ten["task-space-energy"]
    assert one["null-space-damping"] < one["eos"]


@pytest.mark.slow
def test_zero_second_row_serves_only_an_exact_model(unchecked):
    task, path, q, duration = paper.planar_chain()
    plant = task.robot.perturbed(mass=0.05, com=0.05, inertia=0.05, seed=0)
    held = simulate(plant, EosController(task, path), q, duration=duration)
    free = simulate(plant, EosController(task, path, Damp(0.0)), q, duration=duration)
    assert held.ok
    assert np.abs(held.v).max() < 0.1
    assert drifts(held)[1:].max() < 1e-8
    assert not free.ok or np.abs(free.v).max() > 1.0


@pytest.mark.slow
def test_posture_control_of_the_chain_repeats_but_for_a_turn_of_one_joint(runs):
    run = runs["6.1"]["null-space-posture"]
    steps = np.diff(run.q[run.cycle_rows], axis=0)[1:] / math.tau
    assert np.abs(steps - np.round(steps)).max() < 1e-9
    assert np.abs(np.round(steps)).sum(axis=1).tolist() == [1.0, 1.0]


# -- the claims ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_reproduce_checks_every_claim_and_the_docs_have_the_measurements(
    runs, tmp_path, monkeypatch, capsys, unchecked
):
    monkeypatch.setattr(reproduce, "simulate", lambda label, name, rtol: runs[label][name])
    assert reproduce.main(out=tmp_path, study=False, pictures=False, jobs=1) == 0
    claims = json.loads((tmp_path / "claims.json").read_text())["claims"]
    assert len(claims) > 30
    assert [claim for claim in claims if not claim["holds"]] == []
    assert f"{len(claims)} of {len(claims)} claims hold" in capsys.readouterr().out
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    block = page.partition("<!-- claims -->\n")[2].partition("<!-- /claims -->")[0]
    assert block == (tmp_path / "claims.md").read_text(), "run: python scripts/reproduce.py --update-docs"
    assert f"<!-- beside -->\n{beside_table(runs)}\n<!-- /beside -->" in page


@pytest.mark.slow
def test_figures_of_the_paper_have_counterparts(runs, tmp_path):
    planar, chain = paper.planar_robot().task.robot, paper.planar_chain().task.robot
    figures = paper_figures(runs, planar, chain)
    assert sorted(figures) == [f"figure_{k:02}" for k in (5, 6, 8, 9, 10, 13, 14, 16, 17, 18)]
    for name in ("figure_08", "figure_10", "figure_16"):
        labels = [ax.get_xlabel() for ax in figures[name].axes] + [ax.get_ylabel() for ax in figures[name].axes]
        assert any("[" in label for label in labels)
        assert plots.save(figures[name], tmp_path / f"{name}.pdf").stat().st_size > 5_000


def test_claim_compares_one_number_with_one_bound():
    assert Claim("1", "small", 1e-12, 1e-9).holds
    assert not Claim("1", "small", 2e-9, 1e-9).holds
    assert Claim("1", "large", 3.0, 1.0, at_least=True).holds
    for at_least in (False, True):
        assert not Claim("1", "not measured", math.nan, 1.0, at_least).holds


def test_claim_table_has_digits_that_are_the_same_everywhere():
    small, ratio, failed = (
        Claim("1", "a", 3e-13, 1e-9),
        Claim("2", "b", 0.12345, 1.0, digits=3),
        Claim("3", "c", 2.0, 1.0),
    )
    rows = claims_table([small, ratio, failed]).splitlines()
    assert rows[2:5] == ["| 1 | a | ≤ 1e-09 | yes |", "| 2 | b | 0.123 | yes |", "| 3 | c | 2 | **no** |"]
    assert claims_table([small]) == claims_table([Claim("1", "a", 4e-12, 1e-9)])
    assert study_table({1e-6: [small], 1e-9: [ratio]}).splitlines()[0].endswith("| rtol 1e-06 | rtol 1e-09 |")


def test_block_is_replaced_or_appended_and_nothing_else_changes(tmp_path):
    path = tmp_path / "README.md"
    path.write_text("# Title\n\n<!-- claims -->\nold\n<!-- /claims -->\nend\n", encoding="utf-8")
    update_block(path, "claims", "new", "Claims")
    assert path.read_text(encoding="utf-8") == "# Title\n\n<!-- claims -->\nnew\n<!-- /claims -->\nend\n"
    update_block(path, "other", "text", "Other")
    assert path.read_text(encoding="utf-8").endswith("## Other\n\n<!-- other -->\ntext\n<!-- /other -->\n")
    path.write_text("<!-- claims -->\n", encoding="utf-8")
    with pytest.raises(OutputError, match="/claims"):
        update_block(path, "claims", "new", "Claims")


# -- pictures --------------------------------------------------------------------------------------------------------


def test_gif_shows_the_robot_moving(tmp_path, unchecked):
    example = paper.self_motion_tracking(cycles=1)
    run = example.experiments["eos"].run()
    path = write_gif(tmp_path / "eos.gif", run, example.robot, end=1.0, fps=5.0)
    with Image.open(path) as image:
        assert image.n_frames == 5
        assert image.info["duration"] == 200
        first = np.asarray(image.convert("RGB")).astype(int)
        image.seek(4)
        assert np.abs(np.asarray(image.convert("RGB")) - first).max() > 50


def test_gif_of_a_robot_in_space_is_refused(panda, tmp_path):
    task = PositionTask(panda, "panda_hand_tcp")
    q = np.array([0.0, -0.3, 0.3, -2.0, 0.2, 1.7, 0.8])
    run = simulate(panda, EosController(task, Hold(task.value(q))), q, duration=0.05)
    with pytest.raises(InputError, match="in space"):
        write_gif(tmp_path / "panda.gif", run, panda)


def test_page_has_the_quantities_of_the_paper_on_its_axes(unchecked):
    example = paper.self_motion_tracking(cycles=1)
    run = example.experiments["eos"].run()
    figure = page([paths(run), motion(run, trace=["tip", "rail_tip"])], example.robot)
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
    assert labels[0] == ("$z_1$ [m]", "$z_2$ [m]")
    assert labels[1] == ("$q_{1}$ [m]", "$q_{2}$ [m]")
    assert labels[2] == ("time [s]", "joints [rad, m]")
    assert labels[3] == ("x [m]", "y [m]")


def test_obstacle_potential_has_the_gradient_of_equation_40():
    law = paper.obstacle(offset=4.0).experiments["eos"].controller.self_motion
    assert isinstance(law, DescendPotential)
    q, step = np.array([0.3, -0.4, 0.5]), 1e-6

    def potential(y):
        return 0.5 / (4.0 + y[1]) ** 2

    numeric = [(potential(q + step * e) - potential(q - step * e)) / (2.0 * step) for e in np.eye(3)]
    assert np.abs(law.gradient(q) - numeric).max() < 1e-9
