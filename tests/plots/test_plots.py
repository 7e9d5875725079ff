from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from eos_pin import (
    EosController,
    InputError,
    OpenLoop,
    OrientationTask,
    PoseTask,
    PositionTask,
    figure_eight,
    load_robot,
    simulate,
)
from eos_pin.control.operational import BASELINES
from eos_pin.errors import OutputError
from eos_pin.plots import pages as plots
from eos_pin.plots._style import (
    CONTROLLERS,
    LINES,
    add_axes,
    colors_of,
    faded,
)
from eos_pin.plots.keyframes import is_spatial
from eos_pin.plots.panels import has_depth
from eos_pin.trajectories.harmonic import Harmonic
from eos_pin.trajectories.pose import PoseTrajectory

PERIOD = math.tau


@plots.style()
def energies(results):
    """A small figure to save: kinetic energies of several runs."""
    figure = Figure((3.4, 2.4), layout="constrained")
    plots.plot_kinetic_energy(add_axes(figure, 111), results)
    return figure


@pytest.fixture(scope="module")
def ppr():
    return load_robot("ppr")


@pytest.fixture(scope="module")
def runs(ppr):
    """Sec. 5 of the paper: one robot, one path, EOS and the traditional controllers."""
    task, path, q = PositionTask(ppr, "tip", "xy"), figure_eight([0.0, 0.0], period=PERIOD), np.zeros(3)
    controllers = {"eos": EosController(task, path)}
    controllers |= {name: BASELINES[name](task, path, q) for name in ("task-space", "null-space-posture")}
    return {
        name: simulate(ppr, controller, q, duration=3 * PERIOD, rtol=1e-6, record_rate=20.0)
        for name, controller in controllers.items()
    }


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda", chain_to="panda_hand_tcp")


@pytest.fixture(scope="module")
def pose_run(panda):
    q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7])
    task = PoseTask(panda, "panda_hand_tcp")
    z = task.value(q)
    path = PoseTrajectory(figure_eight(z[:3], 0.1, period=1.0, plane="yz"), pose=z)
    return simulate(panda, EosController(task, path), q, duration=2.0, rtol=1e-5, record_rate=30.0)


@pytest.fixture
def ax():
    with plots.style():
        return add_axes(Figure(layout="constrained"), 111)


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def draw(figure):
    """Lay out everything that is drawn; a warning is an error here."""
    with plots.style():
        figure.draw_without_rendering()


class TestPages:
    @pytest.mark.parametrize("name", ["eos", "task-space"])
    def test_overview_of_a_planar_robot_has_eight_panels(self, runs, ppr, name, tmp_path):
        figure = plots.overview(runs[name], ppr)
        assert len(figure.axes) == 8
        assert plots.save(figure, tmp_path / "figure.png").stat().st_size > 20_000
        assert "finished" in figure.get_suptitle()

    def test_overview_of_a_spatial_robot_shows_it_in_depth(self, pose_run, panda, tmp_path):
        figure = plots.overview(pose_run, panda)
        assert is_spatial(panda, pose_run)
        assert [ax.name for ax in figure.axes].count("3d") == 1
        assert "rotation [rad]" in labels(figure.axes[5])
        assert plots.save(figure, tmp_path / "figure.png").stat().st_size > 20_000

    def test_robot_comes_from_the_provenance(self, runs):
        assert "[m]" in plots.overview(runs["eos"]).axes[3].get_ylabel()

    def test_figure_is_drawn_without_robot_task_or_cycle(self, ppr):
        plant = ppr.perturbed(mass=0.1)
        result = simulate(plant, OpenLoop(lambda t: np.zeros(3)), np.zeros(3), duration=0.2, rtol=1e-5)
        draw(plots.overview(result))
        draw(plots.comparison({"fall": result}))

    def test_overview_of_a_task_without_path_shows_its_coordinates(self, panda):
        q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7])
        task = OrientationTask(panda, "panda_hand_tcp")
        controller = EosController(task, task.hold(q))
        result = simulate(panda, controller, q, np.full(7, 0.2), duration=0.3, rtol=1e-5)
        figure = plots.overview(result, panda)
        assert figure.axes[0].get_ylabel() == "task point [rad]"
        draw(figure)

    def test_comparison_has_an_orbit_for_each(self, runs, ppr):
        figure = plots.comparison(runs, ppr)
        assert len(figure.axes) == 3 + len(runs)
        draw(figure)
        with pytest.raises(InputError, match="at least one run"):
            plots.comparison({})

    def test_names_may_be_long_and_many(self, runs, ppr):
        many = {f"{k} a very long name of some controller or other": runs["eos"] for k in range(9)}
        draw(plots.comparison(many, ppr))

    def test_energies_of_the_paper_have_the_colours_of_their_controllers(self, runs):
        figure = energies({"$T_0$": runs["task-space"], "$T_{EOS}$": runs["eos"]})
        assert [line.get_color() for line in figure.axes[0].lines] == [CONTROLLERS["task-space"], CONTROLLERS["eos"]]
        draw(figure)

    def test_failed_run_shows_the_reason(self, runs, ppr):
        why = "the run ended at t = 1 s: " + "the task is singular $here " * 20
        figure = plots.overview(replace(runs["eos"], status="singular", message=why), ppr)
        assert "singular" in figure.get_suptitle()
        draw(figure)

    def test_figure_of_one_sample_is_drawn(self, runs, ppr):
        names = [name for name, value in vars(runs["eos"]).items() if isinstance(value, np.ndarray)]
        first = {name: getattr(runs["eos"], name)[:1] for name in names if name != "switches"}
        draw(plots.overview(replace(runs["eos"], **first), ppr))


class TestPanels:
    def test_joints_are_marked_at_exact_multiples(self, ax, runs, ppr):
        result = runs["eos"]
        plots.plot_joints(ax, result, ppr)
        dots = [line for line in ax.lines if line.get_marker() == "o"]
        assert len(dots) == 3
        for joint, line in enumerate(dots):
            np.testing.assert_array_equal(line.get_xdata(), [k * PERIOD for k in range(4)])
            np.testing.assert_array_equal(line.get_ydata(), result.q[result.cycle_rows, joint])

    def test_curve_does_not_hide_an_equal_one(self, ax, runs, ppr):
        # q2 = q3 under EOS control from q = 0, and v is one coordinate
        plots.plot_joints(ax, runs["eos"], ppr)
        assert [line.get_linestyle() for line in ax.lines[:3]] == ["-", "-", "--"]

    def test_units_follow_the_joints(self, runs, ppr, panda, pose_run):
        for robot, result, unit in ((ppr, runs["eos"], "[rad, m]"), (panda, pose_run, "[rad]")):
            ax = Figure().add_subplot()
            plots.plot_joints(ax, result, robot)
            assert ax.get_ylabel() == f"joints {unit}"

    def test_joints_get_a_colour_scale_where_they_are_many(self, ax, runs):
        q = np.tile(runs["eos"].q, (1, 8))[:, :23] + np.arange(23.0)
        plots.plot_joints(ax, replace(runs["eos"], q=q))
        assert ax.get_legend() is None
        scale = ax.figure.axes[1]
        assert scale.get_yticklabels()[0].get_text() == "$q_{1}$"

    def test_orbit_of_the_joints_has_their_names(self, runs, ppr):
        ax = add_axes(Figure(), 111, solid=True)
        plots.plot_orbit(ax, runs["eos"], ppr)
        assert (ax.get_xlabel(), ax.get_zlabel()) == ("$q_{1}$ [m]", "$q_{3}$ [rad]")

    def test_principal_directions_keep_distances(self, ax, runs, ppr):
        # q2 = q3: the motion is plane, so two directions show all of it
        result = replace(runs["eos"], period=math.inf)
        plots.plot_orbit(ax, result, ppr)
        points = np.array(ax.lines[0].get_data()).T
        found = np.linalg.norm(points - points[100], axis=1)
        np.testing.assert_allclose(found, np.linalg.norm(result.q - result.q[100], axis=1), atol=1e-6)

    def test_joints_that_are_chosen_are_drawn(self, ax, runs, ppr):
        plots.plot_orbit(ax, runs["eos"], ppr, joints=(0, -1))
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("$q_{1}$ [m]", "$q_{3}$ [rad]")
        with pytest.raises(InputError, match="2 of the joints 0 to 2"):
            plots.plot_orbit(ax, runs["eos"], ppr, joints=(0, 3))

    def test_orbit_survives_rows_that_are_not_finite(self, ax, runs, ppr):
        q = runs["eos"].q.copy()
        q[-2:] = np.nan
        plots.plot_orbit(ax, replace(runs["eos"], q=q), ppr)

    def test_rounding_does_not_look_like_motion(self, ax, runs, ppr):
        plots.plot_self_motion(ax, runs["eos"], ppr)
        assert np.ptp(ax.get_ylim()) >= 0.02
        assert labels(ax) == ["reference", "$v_{1}$"]

    def test_charts_have_bands_and_numbers(self, ax, runs):
        result = runs["eos"]
        switches = np.array([4.0, 9.0])
        chart = np.searchsorted(switches, result.t)
        plots.plot_charts(ax, replace(result, switches=switches, chart=chart))
        assert [text.get_text() for text in ax.texts] == ["0", "1", "2"]
        assert [line.get_xdata()[0] for line in ax.lines] == [4.0, 9.0]

    def test_error_is_drawn_only_where_something_was_asked_for(self, ax, runs):
        empty = np.full_like(runs["eos"].error, np.nan)
        plots.plot_errors(ax, replace(runs["eos"], error=empty, v_ref=np.full_like(runs["eos"].v, np.nan)))
        assert not ax.lines

    def test_limits_are_shaded_where_they_are_near(self, runs, ppr):
        quiet = replace(runs["eos"], tau=np.clip(runs["eos"].tau, -5.0, 5.0))
        for scale, shaded in ((1.0, 0), (180.0, 2)):
            ax = Figure().add_subplot()
            plots.plot_torques(ax, replace(quiet, tau=scale * quiet.tau), ppr)
            assert len(ax.patches) == shaded
            assert [text.get_text() for text in ax.texts if "limit" in text.get_text()] == ["limit 1000"][shaded:]

    def test_unequal_limits_make_torques_relative(self, ax, pose_run, panda):
        plots.plot_torques(ax, pose_run, panda)
        assert ax.get_ylabel() == "torque / limit"
        np.testing.assert_allclose(ax.lines[6].get_ydata(), pose_run.tau[:, 6] / 12.0)

    def test_energies_that_differ_by_orders_are_logarithmic(self, runs):
        for factor, scale in ((1.0, "linear"), (1e3, "log")):
            ax = Figure().add_subplot()
            other = replace(runs["eos"], kinetic_energy=factor * runs["eos"].kinetic_energy)
            plots.plot_kinetic_energy(ax, {"a": runs["eos"], "b": other})
            assert ax.get_yscale() == scale

    def test_drift_is_the_result_s(self, ax, runs, ppr):
        plots.plot_drift(ax, runs, ppr)
        for line, result in zip(ax.lines, runs.values(), strict=True):
            np.testing.assert_allclose(line.get_ydata(), result.joint_drift_per_cycle, rtol=1e-12)

    def test_depth_is_used_where_a_path_has_it(self, pose_run):
        assert not has_depth(pose_run)
        solid = Harmonic(np.zeros(3), np.eye(3), np.zeros((3, 3)), 1.0)
        z = pose_run.z_ref.copy()
        z[:, :3] = [solid(t).z for t in pose_run.t]
        assert has_depth(replace(pose_run, z_ref=z))


class TestKeyFrames:
    def test_times_are_fractions_of_the_period(self, runs):
        times = plots.key_times(runs["eos"], per_cycle=4, first=1, last=2)
        np.testing.assert_allclose(times, PERIOD * (1 + np.arange(5) / 4))

    @given(st.floats(0.0, 3 * PERIOD))
    def test_joints_between_samples_are_interpolated(self, runs, t):
        result = runs["eos"]
        found = plots.joints_at(result, [t])[0]
        k = min(np.searchsorted(result.t, t, side="right"), len(result.t) - 1)
        low, high = np.minimum(result.q[k - 1], result.q[k]), np.maximum(result.q[k - 1], result.q[k])
        assert (found >= low - 1e-12).all()
        assert (found <= high + 1e-12).all()

    def test_links_are_where_the_paper_has_them(self, ax, runs, ppr):
        """The slider is at (y1, 0), the rail at (y1, y2), the tip one unit from there at angle y3."""
        time = 1.3 * PERIOD
        plots.plot_key_frames(ax, runs["eos"], ppr, times=[time])
        y1, y2, y3 = plots.joints_at(runs["eos"], [time])[0]
        ends = {tuple(np.round(np.array(line.get_data())[:, -1], 9)) for line in ax.lines if line.get_zorder() == 2}
        tip = (y1 + math.cos(y3), y2 + math.sin(y3))
        for point in ((y1, 0.0), (y1, y2), tip, (y1, y2 + 1.5)):
            assert min(math.dist(point, end) for end in ends) < 1e-8

    def test_key_frames_show_traces_and_obstacles(self, runs, ppr):
        figure = Figure()
        first, second = figure.add_subplot(121), figure.add_subplot(122)
        obstacles = [(0.0, 2.0, 0.2)]
        plots.plot_key_frames(first, runs["eos"], ppr, trace=("tip", "rail_tip"), obstacles=obstacles)
        assert {"path of tip", "path of rail_tip"} <= set(labels(first))
        assert len(first.patches) == 1
        plots.plot_key_frames(second, runs["eos"], ppr, times=[0.0, 1.0, 2.0], obstacles=lambda t: [(t, 2.0, 0.2)])
        assert [disc.center[0] for disc in second.patches] == [0.0, 1.0, 2.0]
        draw(figure)


class TestColours:
    @given(st.lists(st.sampled_from([*CONTROLLERS, "mine", "yours", "EOS"]), unique_by=str.lower, max_size=8))
    def test_colours_of_known_names_stay_and_others_differ(self, names):
        names = [name for name in names if "$" not in name]
        colors = colors_of(names)
        assert len(set(colors)) == len(names)
        for name, color in zip(names, colors, strict=True):
            assert CONTROLLERS.get(name.lower(), color) == color

    @given(st.sampled_from(LINES), st.floats(0.0, 1.0))
    def test_faded_is_between_white_and_itself(self, color, shade):
        assert all(a - 1e-12 <= b <= 1.0 for a, b in zip(to_rgb(color), faded(color, shade), strict=True))


class TestFiles:
    @pytest.mark.parametrize("suffix", ["png", "pdf", "svg", "PNG"])
    def test_figures_that_are_equal_give_equal_files(self, runs, suffix, tmp_path):
        files = [
            plots.save(energies(runs), tmp_path / folder / f"energy.{suffix}").read_bytes() for folder in ("a", "b")
        ]
        assert files[0] == files[1]
        assert files[0][:4] in (b"\x89PNG", b"%PDF", b"<?xm")

    @pytest.mark.parametrize("name", ["figure.gif", "figure", ".png"])
    def test_suffix_that_is_unknown_is_refused(self, runs, name, tmp_path):
        with pytest.raises(InputError, match=r"\.png, \.pdf or \.svg"):
            plots.save(energies(runs), tmp_path / name)
        assert not list(tmp_path.iterdir())

    def test_figure_in_a_forbidden_place_is_refused(self, runs, tmp_path):
        (tmp_path / "file").touch()
        with pytest.raises(OutputError, match="cannot write"):
            plots.save(energies(runs), tmp_path / "file" / "figure.png")

    def test_user_settings_neither_matter_nor_change(self, runs, tmp_path):
        usual = plots.save(energies(runs), tmp_path / "usual.png").read_bytes()
        with matplotlib.rc_context({"axes.facecolor": "black", "font.size": 30.0, "lines.linewidth": 9.0}):
            before = dict(matplotlib.rcParams)
            own = plots.save(energies(runs), tmp_path / "own.png").read_bytes()
            assert dict(matplotlib.rcParams) == before
        assert own == usual

    def test_matplotlib_is_needed_by_this_module_only_and_pyplot_by_none(self):
        code = (
            "import sys, eos_pin; assert 'matplotlib' not in sys.modules; "
            "import eos_pin.plots.pages; assert 'matplotlib.pyplot' not in sys.modules"
        )
        subprocess.run([sys.executable, "-c", code], check=True)
