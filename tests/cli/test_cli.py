"""The command line, in process: what it prints, writes and returns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from eos_pin import Result
from eos_pin.cli.main import main

# The loops run for long; they are checked call by call elsewhere.
pytestmark = pytest.mark.usefixtures("unchecked", "without_meshes")


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def figures(*words: str) -> dict:
    """Run a command that must succeed; its JSON."""
    assert main([*words, "--json", "figures.json"]) == 0
    return json.loads(Path("figures.json").read_text())


TRACKED = [
    ("panda", "pose", 7, 6),
    ("talos_left_arm", "position", 6, 3),
    ("kinova", "position", 6, 3),
    ("ur5", "pose", 6, 6),
    ("ppr", "position", 3, 2),
]


@pytest.mark.slow
@pytest.mark.usefixtures("quick_pictures")
@pytest.mark.parametrize(("robot", "task", "n", "m"), TRACKED)
def test_track_holds_its_promises(robot: str, task: str, n: int, m: int) -> None:
    found = figures("track", robot, "--task", task, "--html", "replay.html", "--plot", "overview.png")
    assert (found["status"], found["n"], found["m"], found["r"]) == ("finished", n, m, n - m)
    assert found["cycles"] == 3
    assert found["task_error_max"] <= 1e-6
    # Without redundancy there is no self-motion to be wrong.
    assert (found["self_motion_error_max"] or 0.0) <= 1e-6
    assert found["chart_switches"] == 0
    assert all(drift <= 1e-6 for drift in found["joint_drift_per_cycle"][1:])
    assert Path("replay.html").stat().st_size > 10_000
    assert Path("overview.png").exists()


def test_track_writes_a_run_that_loads_and_replays(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["track", "ppr", "--cycles", "1", "--period", "2", "--csv", "samples.csv"]
    assert main(words) == 0
    folder = Path("runs/ppr-position")
    assert {path.name for path in folder.iterdir()} == {"run.npz", "summary.json", "replay.html", "overview.png"}
    assert (folder / "overview.png").stat().st_size > 10_000
    run = Result.load(folder / "run.npz")
    assert run.ok
    assert max(run.residuals().values()) < 1e-8
    assert len(np.loadtxt("samples.csv", delimiter=",", skiprows=1)) == len(run.t)
    assert "finished" in capsys.readouterr().out
    assert main(["replay", str(folder / "run.npz"), "--html", "again.html", "--out", "again"]) == 0
    assert Path("again.html").stat().st_size > 10_000


@pytest.mark.usefixtures("quick_pictures")
def test_track_takes_tool_payload_and_swing() -> None:
    source = Path(__file__).parents[2] / "robots" / "planar_chain_10.urdf"
    words = ["--tool", "0.5", "0", "0", "--payload", "0.2", "--swing", "0.2", "--cycles", "2"]
    found = figures("track", str(source), *words, "--size", "0.5")
    assert (found["status"], found["frame"]) == ("finished", "tool")
    assert found["task_error_max"] < 1e-6
    assert found["self_motion_error_max"] < 1e-6


@pytest.mark.usefixtures("quick_pictures")
def test_track_bears_noise_delay_and_model_error() -> None:
    against = ["--noise", "1e-6", "--delay", "0.001", "--model-error", "0.05", "--torque-limits", "--seed", "3"]
    found = figures("track", "panda", "--control-rate", "1000", "--cycles", "1", *against)
    assert found["status"] == "finished"
    assert 1e-5 < found["task_error_max"] < 2e-2


@pytest.mark.usefixtures("quick_pictures")
def test_track_bears_pushes_friction_and_missed_periods() -> None:
    words = ["track", "panda", "--control-rate", "1000", "--path", "line", "--size", "0.05", "--duration", "1"]
    errors = []
    for against in ([], ["--friction", "0.5", "0.5"], ["--push", "0", "5", "0", "--push-time", "0.4", "0.6"]):
        found = figures(*words, *against, "--dropout", "0.1")
        assert found["status"] == "finished"
        errors.append(found["task_error_max"])
    plain, rubbed, pushed = errors
    assert plain < 1e-3 < min(rubbed, pushed)
    assert max(rubbed, pushed) < 0.1


@pytest.mark.usefixtures("quick_pictures")
def test_track_takes_a_path_from_a_file_and_names_points_out_of_reach() -> None:
    Path("path.csv").write_text("t,x,y,z\n0,0.45,0,0.7\n1,0.45,0.2,0.6\n2,0.4,0,0.6\n")
    assert figures("track", "panda", "--path", "path.csv")["task_error_max"] < 1e-6
    Path("far.csv").write_text("0,0.45,0,0.7\n1,1,0,0.6\n")
    assert main(["track", "panda", "--path", "far.csv", "--duration", "0.95", "--json", "far.json"]) == 1
    far = json.loads(Path("far.json").read_text())
    assert far["status"] != "finished"
    assert far["message"]
    assert far["duration"] > 0.1


def test_compare_shows_the_difference_of_controllers() -> None:
    words = ["--controllers", "eos", "null-space-posture", "set-point", "--period", "2", "--cycles", "2"]
    found = figures("compare", "panda", *words, "--metric", "inertial", "--plot", "comparison.pdf")
    assert list(found) == ["eos", "null-space-posture", "set-point"]
    assert found["set-point"]["task_error_max"] > 1e3 * found["eos"]["task_error_max"]
    assert Path("comparison.pdf").read_bytes()[:4] == b"%PDF"
    assert {path.name for path in Path("runs/panda-compare").glob("*.npz")} == {f"{name}.npz" for name in found}


def test_ik_reaches_a_point_and_follows_a_path() -> None:
    found = figures("ik", "panda", "--to", "0.4", "0.1", "0.5", "--v", "0.2", "0", "0", "0")
    assert found["status"] == "finished"
    assert found["task_error_max"] < 1e-9
    inertial = figures("ik", "panda", "--to", "0.4", "0.1", "0.5", "--v", "0.2", "0", "0", "0", "--metric", "inertial")
    assert inertial["task_error_max"] < 1e-9
    # v counts other directions.
    assert np.abs(np.array(inertial["q"]) - found["q"]).max() > 0.01
    Path("path.csv").write_text("0,0.45,0,0.7\n1,0.45,0.2,0.6\n")
    assert main(["ik", "panda", "--path", "path.csv", "--csv", "joints.csv"]) == 0
    assert np.loadtxt("joints.csv", delimiter=",", skiprows=1).shape == (101, 8)
    assert main(["ik", "panda", "--to", "1", "0", "0.6"]) == 1


@pytest.mark.usefixtures("quick_pictures")
def test_poses_from_a_file_are_tracked_and_inverted(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        "# a log",
        "x;y;z;qw;qx;qy;qz;",
        "0.5;0;0.5;0;1;0;0;",
        "0.5;0,1;0.55;0;0.999;0.0447;0;",
        "0.5;0.1;0.5;0;1;0;0",
    ]
    Path("poses.csv").write_text("\n".join(rows))
    found = figures("ik", "panda", "--task", "pose", "--path", "poses.csv")
    assert found["task_error_max"] < 1e-8
    assert "poses.csv has no times: it takes" in capsys.readouterr().err
    q0 = [repr(value) for value in found["q"]]
    rows = ["t qw qx qy qz x y z", "100 0 1 0 0 .5 .1 .5", "101 0 0.999 0.0447 0 .5 .1 .5", "102 0 1 0 0 .5 .08 .5"]
    Path("poses.tsv").write_text("\n".join(rows))
    for task in ("pose", "orientation"):
        found = figures("track", "panda", "--task", task, "--path", "poses.tsv", "--q0", *q0, "--duration", "2")
        assert (found["status"], found["duration"]) == ("finished", 2.0)
        assert found["task_error_max"] < 1e-3
        said = " ".join(capsys.readouterr().err.split())
        assert "poses.tsv begin at 100 s; they are counted from there" in said
        assert ("do not count" in said) == (task == "orientation")


def test_ik_takes_poses_as_people_write_them() -> None:
    place, half = ["0.45", "0.1", "0.5"], repr(float(np.sqrt(0.5)))
    forms = [
        ["3.141592653589793", "0", "1.5707963267948966"],
        [half, half, "0", "0"],
        ["0", "1", "0", "1", "0", "0", "0", "0", "-1"],
    ]
    ends = [figures("ik", "panda", "--task", "pose", "--to", *place, *form)["q"] for form in forms]
    np.testing.assert_allclose(ends, [ends[0]] * 3, atol=1e-6)
    assert figures("ik", "panda", "--task", "orientation", "--to", *forms[0])["task_error_max"] < 1e-8
    assert figures("ik", "panda", "--task", "pose", "--to", *place)["task_error_max"] < 1e-8


def test_info_describes_a_robot(capsys: pytest.CaptureFixture[str]) -> None:
    found = figures("info", "kinova", "--task", "pose", "--html", "robot.html")
    assert (found["n"], found["m"], found["r"]) == (6, 6, 0)
    assert {joint["kind"] for joint in found["joints"]} == {"continuous", "revolute"}
    assert Path("robot.html").exists()
    assert "eos-pin track kinova" in capsys.readouterr().out


def test_info_warns_of_a_singular_start(capsys: pytest.CaptureFixture[str]) -> None:
    found = figures("info", "ur5", "--task", "pose", "--q0", "0", "0", "0", "0", "0", "0")
    assert "rank" in found["singular"]
    assert "Warning" in capsys.readouterr().out


def test_robots_command_lists_names() -> None:
    found = {robot["name"] for robot in figures("robots")["robots"]}
    assert {"panda", "ppr", "planar_chain_10", "xarm7"} <= found


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["track", "pandaa"], "panda"),
        (["track", "missing.urdf"], "missing.urdf"),
        (["track", "panda", "--frame", "panda_hnd"], "panda_hand"),
        (["track", "panda", "--size", "-1"], "above 0"),
        (["track", "panda", "--path", "spiral"], "eight"),
        (["track", "panda", "--path", "none.csv"], "none.csv"),
        (["track", "panda", "--q0", "1", "2"], "7 numbers"),
        (["track", "panda", "--v", "1", "2"], "4 numbers"),
        (["track", "panda", "--noise", "1"], "--control-rate"),
        (["track", "panda", "--push", "1", "0", "0"], "--control-rate"),
        (
            ["track", "panda", "--control-rate", "1000", "--push", "1", "0", "0", "--push-time", "2", "1"],
            "end after it begins",
        ),
        (["track", "panda", "--control-rate", "1000", "--dropout", "1"], "below 1"),
        (["track", "panda", "--chart-margin", "1"], "below 1"),
        (["track", "panda", "--plane", "qq"], "axes"),
        (["track", "panda", "--axes", "w"], "axes"),
        (["ik", "panda", "--to", "1", "2", "3", "4"], "must be 3 numbers"),
        (["ik", "panda", "--to", "0.4", "0.1"], "must be 3 numbers"),
        (["ik", "panda", "--to", "400", "100", "500"], "millimetres"),
        (["ik", "panda", "--task", "pose", "--to", "0.4", "0.1", "0.5", "0", "0"], "has 5 numbers; a pose is 3"),
        (["track", "panda", "--duration", "1e12"], "up to 1,000,000 are possible"),
        (["track", "panda", "--cycles", "1000000000"], "up to 1,000,000 are possible"),
        (["replay", "none.npz"], "none.npz"),
        (["robots", "nobody"], "nobody"),
        (["robots", "--html", "a.html"], "info"),
    ],
)
def test_bad_input_is_one_paragraph_and_code_2(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    said = capsys.readouterr()
    assert told in " ".join(said.err.split())
    assert "Traceback" not in said.err + said.out
    assert "\n\n" not in said.err.strip()


@pytest.mark.parametrize("command", ["track", "compare", "sweep", "info", "ik", "replay", "robots"])
def test_help_teaches_by_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert f"eos-pin {command}" in capsys.readouterr().out
