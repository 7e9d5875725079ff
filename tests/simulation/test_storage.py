"""Names of the task in results, and files of earlier versions."""

from __future__ import annotations

import json

import matplotlib.pyplot as plt
import numpy as np
import pytest
from checks import tip

from eos_pin import (
    ComTask,
    EosController,
    HeadingTask,
    Hold,
    InputError,
    OpenLoop,
    OrientationTask,
    PoseTask,
    PositionTask,
    RelativePositionTask,
    Result,
    ResultError,
    StackedTask,
    Task,
    simulate,
)
from eos_pin.cli.output import stderr
from eos_pin.cli.tables import run_table
from eos_pin.plots.panels import plot_errors, plot_path, plot_task_error
from eos_pin.viewer.replay import scene_of

pytestmark = pytest.mark.usefixtures("unchecked")

Q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7])
NAMES = ("labels", "units", "frame", "axes", "seen_from")
TASKS = {
    "position": (lambda robot, frame: PositionTask(robot, frame, "xz"), "xz", ""),
    "pose": (PoseTask, "xyz", ""),
    "orientation": (OrientationTask, "", ""),
    "com": (lambda robot, frame: ComTask(robot, "yz"), "yz", ""),
    "relative": (lambda robot, frame: RelativePositionTask(robot, frame, "panda_link1", "xz"), "xz", "panda_link1"),
    "stacked": (
        lambda robot, frame: StackedTask([PositionTask(robot, frame, "yz"), OrientationTask(robot, frame)]), "yz", "",
    ),
    "twice": (
        lambda robot, frame: StackedTask([PositionTask(robot, frame), PositionTask(robot, "panda_link4", "z")]),
        "xyz", "",
    ),
}  # fmt: skip


def run_of(task, q):
    return simulate(task.robot, EosController(task, Hold(task.value(q), task.m)), q, duration=0.02)


def written_by_0_1(result, path):
    """The file that version 0.1 wrote of a run."""
    old = {"task_deficit": "given_up", "deficit_from_limits": "given_up_to_limits"}
    arrays = (
        "t q dq ddq tau z dz z_ref error task_force task_deficit deficit_from_limits v dv v_ref chart kinetic_energy "
        "work switches"
    )
    header = {
        "format": "eos_pin result 2",
        "period": None if result.period == np.inf else result.period,
        "status": result.status,
        "message": result.message,
        "info": dict(result.info),
    }
    columns = {old.get(name, name): getattr(result, name) for name in arrays.split()}
    np.savez_compressed(path, header=np.array(json.dumps(header)), **columns)
    return path


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("writer", [lambda run, path: run.save(path), written_by_0_1], ids=["now", "0.1"])
def test_result_keeps_names_of_its_task(panda, tmp_path, name, writer):
    make, axes, seen_from = TASKS[name]
    task = make(panda, tip(panda))
    run = run_of(task, Q)
    assert (run.labels, run.units, run.axes, run.seen_from) == (task.labels, task.units, axes, seen_from)
    assert run.frame == ("" if name == "com" else tip(panda))
    again = Result.load(writer(run, tmp_path / "run.npz"))
    assert [getattr(again, key) for key in NAMES] == [getattr(run, key) for key in NAMES]
    for key in ("q", "task_deficit", "deficit_from_limits", "error"):
        np.testing.assert_array_equal(getattr(again, key), getattr(run, key))
    assert again.info == run.info
    assert again.residuals(panda)["task"] < 1e-12


def test_result_of_planar_heading_is_migrated(ppr, tmp_path):
    run = run_of(HeadingTask(ppr, tip(ppr)), np.array([0.1, 0.2, 0.3]))
    again = Result.load(written_by_0_1(run, tmp_path / "run.npz"))
    assert (again.labels, again.units) == (("heading",), ("rad",)) == (run.labels, run.units)


def test_result_without_a_task_is_migrated(panda, tmp_path):
    run = simulate(panda, OpenLoop(lambda t: np.zeros(7)), Q, duration=0.02)
    for path in (run.save(tmp_path / "now"), written_by_0_1(run, tmp_path / "old.npz")):
        again = Result.load(path)
        assert [getattr(again, key) for key in NAMES] == [(), (), "", "", ""]


def test_file_of_a_later_version_is_refused(panda, tmp_path):
    path = tmp_path / "run.npz"
    np.savez(path, header=np.array(json.dumps({"format": "eos_pin result 4"})))
    with pytest.raises(ResultError, match="has format 'eos_pin result 4', this version reads"):
        Result.load(path)


class Mixed(Task, kind="test_mixed"):
    """Height and distance from the axis of the base [m], heading [rad], and the height once more [mm]."""

    def __init__(self, robot):
        self._number = robot.frame_id(tip(robot))
        super().__init__(robot, ["height", "heading", "fine"], ["m", "rad", "mm"])

    def compute_point(self, data):
        x, y, z = self.frame_placement(data, self._number).translation
        return np.array([z, np.arctan2(y, x), 1000.0 * (z + x)])

    def compute_jacobian(self, data):
        (x, y, _), J = self.frame_placement(data, self._number).translation, self.frame_jacobian(data, self._number)
        return np.array([J[2], (x * J[1] - y * J[0]) / (x * x + y * y), 1000.0 * (J[2] + J[0])])

    def compute_drift(self, data):
        x, y, _ = self.frame_placement(data, self._number).translation
        u, v, _ = self.frame_velocity(data, self._number).linear
        a, b, c = self.frame_acceleration(data, self._number).linear
        square = x * x + y * y
        turn = (x * b - y * a) / square - 2.0 * (x * u + y * v) * (x * v - y * u) / square**2
        return np.array([c, turn, 1000.0 * (c + a)])


def test_own_task_has_its_units_in_plots_and_tables_after_a_load(panda, tmp_path):
    run = run_of(Mixed(panda), Q)
    run = Result.load(run.save(tmp_path / "run"))
    assert (run.labels, run.units, run.frame) == (("height", "heading", "fine"), ("m", "rad", "mm"), "")
    figure, axes = plt.subplots(3)
    plot_errors(axes[0], run)
    assert [line.get_label() for line in axes[0].lines[:3]] == ["task [m]", "rotation [rad]", "task [mm]"]
    plot_path(axes[1], run)
    assert axes[1].get_ylabel() == "task point [m, rad, mm]"
    plot_task_error(axes[2], {"a": run})
    assert axes[2].get_ylabel() == "task error [m, rad, mm]"
    plt.close(figure)
    summary = run.summary()
    assert (summary["labels"], summary["units"]) == (["height", "heading", "fine"], ["m", "rad", "mm"])
    table = run_table(summary)
    assert any(str(cell).endswith(" m or rad or mm") for cell in table.columns[1].cells)
    scene = scene_of(run, panda)
    assert (dict(scene.traces), dict(scene.paths)) == ({}, {})
    with stderr.capture() as shown:
        stderr.print(table)
    assert "m or rad or mm" in shown.get()


DRAWN = {"position": True, "pose": True, "stacked": True, "relative": False}


@pytest.mark.parametrize(("name", "drawn"), DRAWN.items())
def test_replay_draws_reference_of_places_in_the_world(panda, name, drawn):
    run = run_of(TASKS[name][0](panda, tip(panda)), Q)
    scene = scene_of(run, panda)
    assert dict(scene.traces) == {"actual": tip(panda)}
    assert ("reference" in scene.paths) == drawn
    if drawn:
        np.testing.assert_allclose(scene.paths["reference"][0], panda.placement(Q, tip(panda)).translation, atol=1e-9)


def test_result_refuses_units_of_another_task(panda):
    run = run_of(PositionTask(panda, tip(panda)), Q)
    fields = {name: getattr(run, name) for name in run.__dataclass_fields__}
    with pytest.raises(InputError, match="units for its 3 task coordinates"):
        Result(**{**fields, "units": ("m",)})
