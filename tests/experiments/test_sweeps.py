"""Sweeps: what a trial is, that no run is lost, computed twice or wrong, and the tables and the command."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import joblib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import EosController, InputError, PositionTask, UnknownNameError, load_robot, simulate_sampled
from eos_pin.cli.main import main
from eos_pin.errors import EosError, MissingDependencyError
from eos_pin.experiments.defaults import fitting_path, rest_posture
from eos_pin.experiments.sweeps import sweep, write_table
from eos_pin.experiments.trial import Trial, trials
from eos_pin.plots.pages import sweep as plot_sweep

# The loops run for long; they are checked call by call elsewhere.
pytestmark = pytest.mark.usefixtures("unchecked")

#: A run of a tenth of a second of computing.
SHORT = {"robot": "ppr", "control_rate": 200.0, "cycles": 1}


@dataclass(frozen=True)
class Noted(Trial):
    """A trial that notes in a file that it runs, and does what it is told there."""

    notes: str = ""
    number: int = 0
    fate: str = ""

    def run(self, observer=None):
        with open(self.notes, "a") as file:
            file.write(f"{self.number}\n")
        if self.fate == "slow":
            time.sleep(0.2)
        if self.fate == "raise":
            raise ZeroDivisionError("nothing to divide by")
        if self.fate == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        return super().run(observer)


def noted(folder, *, count=4, fate=""):
    return trials(Noted, **SHORT, notes=str(folder / "notes"), number=range(count), fate=fate)


def times_run(folder):
    """How often each number has run."""
    return Counter(map(int, (folder / "notes").read_text().split()))


def timeless(rows):
    return [{name: value for name, value in row.items() if name != "cpu_seconds"} for row in rows]


# -- trials --------------------------------------------------------------------------------------------------------


def test_trials_are_all_combinations_in_order():
    found = trials(robot=["ppr", "panda"], kp=np.linspace(50.0, 100.0, 2), seed=range(3), v=(0.1,), task="position")
    assert len(found) == len(set(found)) == len({trial.key for trial in found}) == 12
    assert [(t.robot.robot, t.control.kp, t.seed) for t in found[:4]] == [
        ("ppr", 50.0, 0),
        ("ppr", 50.0, 1),
        ("ppr", 50.0, 2),
        ("ppr", 100.0, 0),
    ]
    assert {trial.control.v for trial in found} == {(0.1,)}
    assert found[5] == Trial.from_settings("ppr", kp=100, seed=2, v=[0.1])


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"robot": "ppr", "kpp": 1.0}, "kp"),
        ({"robot": "ppr", "controller": "eoss"}, "eos"),
        ({"robot": "ppr", "task": ["position", "pos"]}, "position"),
        ({"robot": "ppr", "kp": object()}, "kp must be"),
        ({"kp": 1.0}, "robot"),
        ({"robot": "ppr", "seed": range(10**12)}, "make 1,000,000,000,000 runs; up to 100,000 are possible"),
    ],
)
def test_trial_that_cannot_be_is_refused_at_once(settings, told):
    with pytest.raises((InputError, UnknownNameError), match=told):
        trials(**settings)


def test_trial_takes_joints_by_name():
    trial = Trial.from_settings("planar_chain_10", q0={"y3": 0.5}, lock={"y10": np.float64(0.25)})
    robot, _, q, _ = trial.prepare()
    assert (robot.n, robot.options["lock"]) == (9, {"y10": 0.25})
    assert q[[joint.name for joint in robot.joints].index("y3")] == 0.5


def test_key_is_the_same_in_any_process_and_for_equal_numbers():
    trial = Trial.from_settings("panda", kp=50, v=(0.0, 1, 0.5, 0), control_rate=np.float64(500.0), seed=np.int64(3))
    settings = "seed=3, control_rate=500, v=[0, 1, 0.5, 0], kp=50.0"
    code = f"from eos_pin import Trial; print(Trial.from_settings('panda', {settings}).key)"
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert found.stdout.strip() == trial.key


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "kp": st.floats(1.0, 1e3),
            "seed": st.integers(0, 9),
            "task": st.sampled_from(["position", "pose"]),
            "control_rate": st.none() | st.floats(10.0, 1e3),
            "v": st.lists(st.floats(-1.0, 1.0), max_size=3),
        },
    )
)
def test_trial_can_be_made_again_from_its_settings(settings):
    trial = Trial.from_settings("panda", **settings)
    again = Trial.from_settings(**trial.settings)
    assert again == trial
    assert again.key == trial.key
    assert (trial.key == Trial.from_settings("panda").key) == (trial == Trial.from_settings("panda"))


def test_another_file_or_kind_of_trial_has_another_key(tmp_path):
    urdf = tmp_path / "robot.urdf"
    urdf.write_text("<robot name='a'/>")
    first = Trial.from_settings(str(urdf)).key
    urdf.write_text("<robot name='b'/>")
    assert Trial.from_settings(str(urdf)).key != first
    assert Noted.from_settings("ppr").key != Trial.from_settings("ppr").key


# -- sweeps --------------------------------------------------------------------------------------------------------


def test_row_equals_a_run_by_hand():
    (row,) = sweep(trials(**SHORT, kp=64.0, model_error=0.1, seed=3))
    robot = load_robot("ppr", chain_to="auto")
    task = PositionTask(robot, robot.options["chain_to"], "xy")
    q = rest_posture(task)
    path = fitting_path(task, q)
    plant = robot.perturbed(mass=0.1, com=0.1, inertia=0.1, seed=3)
    controller = EosController(task, path, kp=64.0)
    run = simulate_sampled(plant, controller, q, duration=path.period, control_period=1.0 / 200.0)
    assert row["status"] == "finished"
    assert row["task_error_max"] == run.summary()["task_error_max"]
    assert row["last_drift"] == run.joint_drift_per_cycle[-1]
    assert (row["kp"], row["seed"], row["ended"]) == (64.0, 3, path.period)


def test_sweep_in_two_processes_finds_the_same_as_in_one():
    planned = trials(robot=["ppr", "planar_chain_10"], kp=[50.0, 100.0], control_rate=200.0, cycles=1)
    assert timeless(sweep(planned, jobs=2)) == timeless(sweep(planned))


def test_finished_runs_are_kept_and_not_computed_again(tmp_path):
    told = []
    first = sweep(noted(tmp_path, count=2), folder=tmp_path / "kept")
    rows = sweep(noted(tmp_path), folder=tmp_path / "kept", observer=lambda done, of: told.append((done, of)))
    assert rows[:2] == first
    assert times_run(tmp_path) == {0: 1, 1: 1, 2: 1, 3: 1}
    assert told == [(2, 4), (3, 4), (4, 4)]
    assert sweep(noted(tmp_path), folder=tmp_path / "kept") == rows
    assert set(times_run(tmp_path).values()) == {1}


def test_damaged_file_is_computed_again_and_equal_trials_once(tmp_path):
    planned = noted(tmp_path, count=2)
    rows = sweep([*planned, *planned], folder=tmp_path)
    assert times_run(tmp_path) == {0: 1, 1: 1}
    assert rows[:2] == rows[2:]
    file = tmp_path / f"{planned[1].key}.json"
    file.write_text(file.read_text()[:-20])
    assert timeless(sweep(planned, folder=tmp_path)) == timeless(rows[:2])
    assert times_run(tmp_path) == {0: 1, 1: 2}


def test_run_that_fails_is_a_row_and_is_tried_again(tmp_path):
    planned = noted(tmp_path, count=3)
    planned[1] = replace(planned[1], fate="raise")
    for _ in range(2):
        rows = sweep(planned, folder=tmp_path / "kept")
        assert [row["status"] for row in rows] == ["finished", "failed", "finished"]
    assert rows[1]["message"] == "ZeroDivisionError: nothing to divide by"
    assert times_run(tmp_path) == {0: 1, 1: 2, 2: 1}


@pytest.mark.slow
def test_process_that_dies_ends_the_sweep_with_advice(tmp_path):
    planned = noted(tmp_path, count=3)
    with pytest.raises(EosError, match=r"died.* kept in"):
        sweep([*planned, replace(planned[0], fate="die")], folder=tmp_path / "kept", jobs=2)
    # What was kept before is whole, and the next sweep goes on.
    assert [row["status"] for row in sweep(planned, folder=tmp_path / "kept", jobs=2)] == ["finished"] * 3


@pytest.mark.slow
def test_sweep_that_was_killed_computes_no_finished_run_twice(tmp_path):
    code = (
        f"import sys, pathlib; sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parents[1])]!r}\n"
        "from test_sweeps import noted, sweep\n"
        "here = pathlib.Path(sys.argv[1])\n"
        "sweep(noted(here, count=5, fate='slow'), folder=here / 'kept', jobs=2)"
    )
    run = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], start_new_session=True)
    deadline = time.monotonic() + 60.0
    while len(list(tmp_path.glob("kept/*.json"))) < 2 and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    planned = noted(tmp_path, count=5, fate="slow")
    finished = {trial.number for trial in planned if (tmp_path / "kept" / f"{trial.key}.json").exists()}
    assert 2 <= len(finished) < 5
    rows = sweep(planned, folder=tmp_path / "kept")
    assert [row["status"] for row in rows] == ["finished"] * 5
    assert {times_run(tmp_path)[number] for number in finished} == {1}


@pytest.mark.slow
def test_dask_cluster_gives_the_same_table():
    distributed = pytest.importorskip("distributed")
    planned = trials(robot=["ppr", "planar_chain_10"], kp=[50.0, 100.0], control_rate=200.0, model_error=0.1, cycles=1)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config("dask"),
    ):
        rows = sweep(planned)
    assert timeless(rows) == timeless(sweep(planned))
    assert {row["status"] for row in rows} == {"finished"}


def test_sweep_refuses_no_jobs_at_all():
    with pytest.raises(InputError, match="-1"):
        sweep([], jobs=0)


# -- tables and figures --------------------------------------------------------------------------------------------


def failing():
    """Two runs, of which one fails."""
    rows = sweep(trials(**SHORT, size=[0.5, -1.0], v=(0.1,)))
    assert [row["status"] for row in rows] == ["finished", "failed"]
    return rows


def test_table_reads_back(tmp_path):
    rows = failing()
    path = write_table(rows, tmp_path / "runs.csv")
    with path.open(newline="") as file:
        read = list(csv.DictReader(file))
    assert [float(row["size"]) for row in read] == [0.5, -1.0]
    assert float(read[0]["task_error_max"]) == rows[0]["task_error_max"]
    assert (read[1]["task_error_max"], read[0]["v"], read[0]["gravity"]) == ("", "0.1", "")
    parquet = pytest.importorskip("pyarrow.parquet")
    (first, second) = parquet.read_table(write_table(rows, tmp_path / "runs.parquet")).to_pylist()
    assert first == rows[0]
    assert {name: value for name, value in second.items() if value is not None} == {
        name: value for name, value in rows[1].items() if value is not None
    }


def test_table_of_another_kind_is_refused(tmp_path, monkeypatch):
    rows = failing()
    with pytest.raises(InputError, match=r"\.parquet"):
        write_table(rows, tmp_path / "runs.xlsx")
    with pytest.raises(InputError, match="0 runs"):
        write_table([], tmp_path / "runs.csv")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match=r"eos-pin\[parquet\]"):
        write_table(rows, tmp_path / "runs.parquet")
    assert not list(tmp_path.iterdir())


def test_figure_leaves_out_failed_runs():
    rows = failing()
    figure = plot_sweep(rows, ["size"])
    assert [ax.get_xlabel() for ax in figure.axes] == ["size"] * 4
    assert figure.axes[0].containers[0].lines[0].get_ydata() == pytest.approx([rows[0]["task_error_max"]])
    # Nothing to draw is said in words.
    assert "no task error" in plot_sweep(rows[1:], []).axes[0].texts[0].get_text()


# -- the command ---------------------------------------------------------------------------------------------------


def test_command_sweeps_and_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [
        "sweep",
        "ppr",
        "--control-rate",
        "200",
        "--cycles",
        "1",
        "--jobs",
        "1",
        "--out",
        "out",
        "--json",
        "runs.json",
    ]
    assert main([*words, "--kp", "50,100", "--model-error", "0,0.2", "--seeds", "2"]) == 0
    rows = json.loads(Path("runs.json").read_text())["runs"]
    assert [(row["kp"], row["model_error"], row["seed"]) for row in rows][:3] == [(50, 0, 0), (50, 0, 1), (50, 0.2, 0)]
    assert len(list(Path("out/finished").glob("*.json"))) == len(rows) == 8
    assert Path("out/runs.csv").read_text().count("\n") == 9
    assert Path("out/sweep.png").stat().st_size > 10_000
    said = capsys.readouterr().out
    assert "8 runs" in said
    assert "2 of 2" in said
    before = {file: file.stat().st_mtime_ns for file in Path("out/finished").iterdir()}
    assert main([*words, "--kp", "50,100", "--model-error", "0,0.2", "--table", "more.csv"]) == 0
    assert before == {file: file.stat().st_mtime_ns for file in Path("out/finished").iterdir()}
    assert Path("more.csv").exists()


def test_command_ends_with_1_where_a_run_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--path", "circle", "--size", "1.5", "--cycles", "1"]
    assert main(["sweep", "panda", *words, "--jobs", "1", "--control-rate", "200"]) == 1
    assert "1 run: " in capsys.readouterr().out
    assert Path("runs/sweep/runs.csv").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "needs a robot"),
        (["panda", "pandaa"], "panda"),
        (["ppr", "--seeds", "0"], "at least 1"),
        (["ppr", "--jobs", "0"], "-1"),
        (["ppr", "--noise", "0,1e-5"], "--control-rate"),
        (["ppr", "--controller", "eos,eoss"], "eos"),
        (["ppr", "--size", "0.1,-1"], "above 0"),
        (["ppr", "--seeds", "1000000000000"], "up to 100,000 are possible"),
    ],
)
def test_bad_input_is_one_paragraph_and_code_2(words, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", *words]) == 2
    said = capsys.readouterr().err
    assert told in " ".join(said.split())
    assert "Traceback" not in said
    assert not Path("runs").exists()
