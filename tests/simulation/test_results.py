"""Results: figures, checks from the raw arrays, and files that are whole or not there."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import pickle
import zipfile

import numpy as np
import pytest
import typecheck
from checks import READY as REST
from checks import tip

from eos_pin import (
    Atlas,
    EosController,
    EosError,
    InputError,
    OpenLoop,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Result,
    ResultError,
    SensorNoise,
    TaskForce,
    figure_eight,
    load_robot,
    simulate,
    simulate_extended,
    simulate_sampled,
)
from eos_pin.control.operational import BASELINES

pytestmark = pytest.mark.usefixtures("unchecked")


def closed_loop(panda, kind="position"):
    task = (PositionTask if kind == "position" else PoseTask)(panda, tip(panda))
    z = task.value(REST)
    path = figure_eight(z[:3], 0.05, period=0.5)
    if kind == "pose":
        path = PoseTrajectory(path, pose=z)
    return task, EosController(task, path)


@pytest.fixture(scope="module")
def runs(panda):
    """One run of each kind; `unchecked` serves a single test, so the type checks are switched off here once more."""
    with typecheck.off():
        yield make_runs(panda)


def make_runs(panda):
    """One run of each kind."""
    task, controller = closed_loop(panda)
    pose, pose_controller = closed_loop(panda, "pose")
    push = TaskForce(pose, lambda t: (1.0, 2.0, 3.0, 0.1, 0.2, 0.3 * math.sin(t)))
    falling = OpenLoop(lambda t: 0.9 * panda.gravity(REST))
    return {
        "continuous": simulate(panda, controller, REST, duration=1.1),
        "pose": simulate(panda, pose_controller, REST, duration=1.1),
        "pushed": simulate(panda, pose_controller, REST, duration=1.1, task_force=push),
        "pushed elsewhere": simulate(panda, controller, REST, duration=1.1, task_force=push),
        "traditional": simulate(
            panda, BASELINES["null-space-posture"](task, controller.reference, REST), REST, duration=1.1
        ),
        "sampled": simulate_sampled(panda, controller, REST, duration=0.6, substeps=4, noise=SensorNoise(1e-5, 1e-4)),
        "limited": simulate_sampled(panda, controller, REST, duration=0.3, torque_limits=True),
        "open loop": simulate(panda, falling, REST, duration=0.2),
        "extended": simulate_extended(panda, falling, REST, duration=0.2, atlas=Atlas(pose), task_force=push),
    }


KINDS = [
    "continuous",
    "pose",
    "pushed",
    "pushed elsewhere",
    "traditional",
    "sampled",
    "limited",
    "open loop",
    "extended",
]
ARRAYS = [field.name for field in dataclasses.fields(Result) if "Float" in str(field.type) or "Int" in str(field.type)]


def assert_same(a, b):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert (a.period, a.status, a.message) == (b.period, b.status, b.message)
    assert a.info == b.info
    assert repr(a.summary()) == repr(b.summary())  # NaN equals NaN here


@pytest.mark.parametrize("kind", KINDS)
def test_saved_run_comes_back_as_it_was(runs, tmp_path, kind):
    path = runs[kind].save(tmp_path / "run.npz")
    again = Result.load(path)
    assert_same(again, runs[kind])
    assert_same(Result.load(again.save(tmp_path / "copy.npz")), again)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["copy.npz", "run.npz"]


@pytest.mark.parametrize("kind", KINDS)
def test_residuals_are_near_rounding(runs, kind):
    found = runs[kind].residuals()
    assert found.pop("task", 0.0) < 1e-11
    assert found["torque"] < 1e-11
    # The samples of a continuous run come from the integrator's interpolation.
    assert found["power"] < (1e-5 if kind in ("sampled", "limited") else 1e-7)
    assert set(found) == {"torque", "power"}


@pytest.mark.parametrize("name", ["q", "dq", "tau", "z", "work"])
def test_residuals_show_tampered_arrays(runs, name):
    run = runs["continuous"]
    values = getattr(run, name).copy()
    values[len(values) // 2] += 0.01
    found = dataclasses.replace(run, **{name: values}).residuals()
    assert max(found.values()) > 1e-4


def test_plant_is_found_again(runs, panda, tmp_path):
    run = Result.load(runs["continuous"].save(tmp_path / "run"))
    plant = run.load_plant()
    assert plant.n == 7
    np.testing.assert_array_equal(plant.mass(REST), panda.mass(REST))
    tilted = load_robot("ppr", gravity=(0.0, -9.81, 0.0))
    planar = simulate(tilted, OpenLoop(lambda t: np.ones(3)), np.zeros(3), duration=0.1)
    np.testing.assert_array_equal(planar.load_plant().gravity(np.zeros(3)), tilted.gravity(np.zeros(3)))
    assert planar.residuals()["torque"] < 1e-12


def test_plant_that_was_made_in_memory_has_to_be_handed_over(panda):
    plant = panda.perturbed(mass=0.1)
    run = simulate(plant, OpenLoop(lambda t: np.zeros(7)), REST, duration=0.05)
    with pytest.raises(ResultError, match="made in memory"):
        run.residuals()
    assert run.residuals(plant)["torque"] < 1e-12


def test_plant_that_has_changed_since_is_not_taken_for_the_same(runs):
    run = runs["continuous"]
    info = run.info | {"robot": run.info["robot"] | {"urdf_sha256": "0" * 64}}
    with pytest.raises(ResultError, match="has changed since this run"):
        dataclasses.replace(run, info=info).load_plant()


# -- figures -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_summary_is_plain(runs, kind):
    summary = runs[kind].summary()
    assert json.loads(json.dumps(summary)).keys() == summary.keys()
    assert {
        "status",
        "message",
        "robot",
        "frame",
        "n",
        "m",
        "r",
        "cycles",
        "task_error_max",
        "self_motion_error_max",
        "joint_drift_per_cycle",
        "chart_switches",
        "kinetic_energy_mean",
        "torque_max",
        "cpu_seconds",
    } <= set(summary)
    assert (summary["robot"], summary["n"], summary["status"]) == ("panda", 7, "finished")
    assert summary["cpu_seconds"] > 0.0
    assert summary["torque_max"] == np.abs(runs[kind].tau).max()


def test_summary_of_a_closed_loop_has_its_figures(runs):
    summary = runs["pose"].summary()
    assert (summary["m"], summary["r"], summary["cycles"], summary["period"]) == (6, 1, 2, 0.5)
    assert summary["settled_from"] == 0.5
    assert len(summary["joint_drift_per_cycle"]) == 2
    late = runs["pose"].t >= 0.5
    assert summary["task_error_max"] == np.abs(runs["pose"].error[late]).max()


def artificial(t, q, period=math.inf, **columns):
    """A result with these joints and nothing else of interest."""
    t, q = np.asarray(t, dtype=float), np.asarray(q, dtype=float)
    rows = len(t)
    values = {name: np.zeros((rows, 1)) for name in ARRAYS}
    values |= {name: np.zeros(rows) for name in ("chart", "kinetic_energy", "work")} | {"switches": np.zeros(0)}
    return Result(**(values | {"t": t, "q": q[:, None]} | columns), period=period)


def test_drift_is_measured_at_exact_multiples_of_the_period():
    # Joints that go round with the period and grow by 0.01 a cycle; a neighbouring sample would be off by far more.
    period = math.sqrt(2.0)
    t = np.unique(np.concatenate((np.linspace(0.0, 5.0, 500), period * np.arange(4))))
    run = artificial(t, np.sin(2.0 * np.pi * t / period) + 0.01 * t / period, period)
    assert run.cycles == 3
    np.testing.assert_allclose(run.joint_drift_per_cycle, 0.01, atol=1e-12)
    np.testing.assert_array_equal(run.t[run.cycle_rows], period * np.arange(4))
    assert run.t[run.settled_row] == period


def test_summary_without_cycles_uses_second_half():
    t = np.linspace(0.0, 4.0, 41)
    run = artificial(t, t, kinetic_energy=t)
    assert (run.cycles, run.joint_drift_per_cycle.size) == (0, 0)
    assert run.t[run.settled_row] == pytest.approx(2.0)
    assert run.mean(run.kinetic_energy) == pytest.approx(3.0)


def test_mean_is_over_whole_cycles():
    # A square of a sine has the mean ½ over whole cycles; the uneven samples must not matter.
    t = np.unique(np.concatenate((np.linspace(0.0, 1.0, 3000), np.linspace(1.0, 3.3, 800), [1.0, 2.0, 3.0])))
    run = artificial(t, t, 1.0, kinetic_energy=np.sin(np.pi * t) ** 2)
    assert run.mean(run.kinetic_energy) == pytest.approx(0.5, abs=1e-5)


def test_result_cannot_be_changed_or_be_lopsided(runs):
    run = runs["continuous"]
    with pytest.raises(ValueError, match="read-only"):
        run.q[0, 0] = 1.0
    with pytest.raises(InputError, match="as many rows of q as times"):
        dataclasses.replace(run, q=run.q[:-1])


# -- files ---------------------------------------------------------------------------------------------------------


def test_save_adds_the_suffix_and_makes_the_folder(runs, tmp_path):
    path = runs["open loop"].save(tmp_path / "new" / "run.of.today")
    assert path == tmp_path / "new" / "run.of.today.npz"
    assert path.exists()


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt(), MemoryError()])
def test_write_that_fails_leaves_the_old_file(runs, tmp_path, monkeypatch, error):
    path = runs["open loop"].save(tmp_path / "run.npz")
    before = path.read_bytes()

    def fail(file, **arrays):
        file.write(b"half a fi")
        raise error

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(EosError if isinstance(error, OSError) else type(error)):
        runs["continuous"].save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_place_that_cannot_be_written(runs, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(EosError, match="cannot write"):
        runs["open loop"].save(tmp_path / "file" / "run.npz")
    with pytest.raises(EosError, match="cannot write"):
        runs["open loop"].to_csv(tmp_path)


class Trap:
    """Raises the alarm when it is unpickled."""

    def __reduce__(self):
        return pytest.fail, ("unpickled",)


def as_npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def changed(run, **replaced):
    """Bytes of a saved run with some entries replaced; None leaves one out."""
    header = {"format": "eos_pin result 2", "period": None, "status": "finished", "message": "", "info": {}}
    arrays = {"header": np.array(json.dumps(header))} | {name: getattr(run, name) for name in ARRAYS}
    return as_npz(**{name: value for name, value in (arrays | replaced).items() if value is not None})


FOREIGN = {
    "empty": lambda run: b"",
    "text": lambda run: b"t,q\n0,1\n",
    "an array": lambda run: (buffer := io.BytesIO(), np.save(buffer, np.zeros(3)))[0].getvalue(),
    "another npz": lambda run: as_npz(a=np.zeros(3)),
    "a zip": lambda run: (buffer := io.BytesIO(), zipfile.ZipFile(buffer, "w").close())[0].getvalue(),
    "a pickle": lambda run: pickle.dumps(Trap()),
    "a pickle inside": lambda run: changed(run, q=np.array([Trap()], dtype=object)),
    "a pickled header": lambda run: changed(run, header=np.array(Trap(), dtype=object)),
    "no header": lambda run: changed(run, header=None),
    "no joints": lambda run: changed(run, q=None),
    "lopsided": lambda run: changed(run, q=run.q[:-1]),
    "not a table": lambda run: changed(run, q=np.float64(1.0)),
    "strings": lambda run: changed(run, q=np.full(run.q.shape, "a")),
    "another format": lambda run: changed(run, header=np.array(json.dumps({"format": "eos_pin result 99"}))),
    "half a header": lambda run: changed(run, header=np.array(json.dumps({"format": "eos_pin result 2"}))),
    "a list for a header": lambda run: changed(run, header=np.array("[1, 2]")),
    "no JSON": lambda run: changed(run, header=np.array("{")),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_foreign_files_are_refused_and_never_unpickled(runs, tmp_path, kind):
    path = tmp_path / "run.npz"
    path.write_bytes(FOREIGN[kind](runs["open loop"]))
    with pytest.raises(ResultError, match=r"run\.npz"):
        Result.load(path)


def test_result_load_reads_the_unchanged_file(runs, tmp_path):
    (tmp_path / "run.npz").write_bytes(changed(runs["open loop"]))
    assert Result.load(tmp_path / "run.npz").ok


def test_result_load_refuses_missing_files_and_folders(tmp_path):
    for path in (tmp_path / "missing.npz", tmp_path):
        with pytest.raises(ResultError, match="cannot be read as a result of eos_pin"):
            Result.load(path)


def test_damaged_files_give_an_error_or_the_truth(runs, tmp_path):
    whole = runs["open loop"].save(tmp_path / "whole.npz")
    content, path = whole.read_bytes(), tmp_path / "damaged.npz"
    random = np.random.default_rng(3)
    refused = 0
    for trial in range(300):
        damaged = bytearray(content)
        if trial % 3:
            for place in random.integers(0, len(content), int(random.integers(1, 4))):
                damaged[place] ^= int(random.integers(1, 256))
        else:
            del damaged[int(random.integers(0, len(content))) :]
        path.write_bytes(bytes(damaged))
        try:
            found = Result.load(path)
        except ResultError:
            refused += 1
        else:
            assert_same(found, runs["open loop"])  # the damage was where nothing is stored
    assert refused > 250


@pytest.mark.parametrize("kind", ["continuous", "open loop", "pushed"])
def test_csv_is_readable(runs, tmp_path, kind):
    run = runs[kind]
    path = run.to_csv(tmp_path / "run.csv")
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert len(table) == len(run.t)
    for name in ("t", "chart", "kinetic_energy", "work"):
        np.testing.assert_array_equal(table[name], getattr(run, name))
    for name in ("z", "error", "v"):
        for i, column in enumerate(getattr(run, name).T, 1):
            np.testing.assert_array_equal(table[f"{name}{i}"], column)
    joints = [joint.name for joint in run.load_plant().joints]
    for name in ("q", "dq", "ddq", "tau"):
        for joint, column in zip(joints, getattr(run, name).T, strict=True):
            np.testing.assert_array_equal(table[f"{name}_{joint}"], column)
    assert len(table.dtype.names) == sum(
        1 if getattr(run, name).ndim == 1 else getattr(run, name).shape[1]
        for name in ARRAYS
        if name != "switches" and getattr(run, name).size
    )
