"""`eos-pin info` on robots with which not everything can be done: all is listed, and each reason given."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from eos_pin.cli.main import main

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>'


def arm(joints=5, inertial=INERTIAL, *, axes=("0 0 1", "0 1 0", "1 0 0"), size=0.3):
    """URDF of an arm of links of equal length, whose joints turn about the axes in turn."""
    text = '<robot name="arm"><link name="l0"/>'
    for i in range(1, joints + 1):
        text += (
            f'<link name="l{i}">{inertial}</link><joint name="j{i}" type="revolute"><parent link="l{i - 1}"/>'
            f'<child link="l{i}"/><origin xyz="0 0 {size}"/><axis xyz="{axes[(i - 1) % len(axes)]}"/>'
            '<limit lower="-2.9" upper="2.9" effort="50" velocity="2"/></joint>'
        )
    text += f'<link name="tip"/><joint name="tipj" type="fixed"><parent link="l{joints}"/><child link="tip"/>'
    return text + f'<origin xyz="0 0 {size}"/></joint></robot>'


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch, quick_pictures):
    monkeypatch.chdir(tmp_path)


def described(capsys, text, *words):
    """What `info` says of a URDF, and its JSON."""
    Path("arm.urdf").write_text(text)
    assert main(["info", "arm.urdf", *words, "--json", "info.json"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    found = json.loads(Path("info.json").read_text())
    assert all(joint["name"] in said.out for joint in found["joints"])
    assert "All frames: universe, l0" in said.out
    return " ".join(said.out.split()), found


def test_info_of_a_complete_robot_lists_no_lack(capsys):
    said, found = described(capsys, arm())
    assert found["cannot"] == {}
    coupling = found["coupling"]
    assert coupling["inertial"]["start"] < 1e-12 < coupling["inertial"]["around"] < coupling["identity"]["around"]
    assert "0.00 and" in said
    assert "with --metric inertial" in said
    assert "Try: eos-pin track arm.urdf" in said


def test_info_names_links_without_inertia(capsys):
    said, found = described(capsys, arm(inertial=""))
    assert list(found["cannot"]) == ["dynamics"]
    assert found["coupling"] == {}
    assert (found["m"], found["r"], len(found["singular_values"])) == (3, 2, 3)
    assert "No dynamics, so no control" in said
    assert "give mass and inertia to links l1, l2, l3, l4, l5, tip" in said
    assert "Try: eos-pin ik arm.urdf" in said
    assert "Try: eos-pin track arm.urdf --command position" in said
    assert main(["ik", "arm.urdf", "--to", "0.3", "0.2", "1.0", "--json", "ik.json"]) == 0
    assert json.loads(Path("ik.json").read_text())["task_error_max"] < 1e-9
    assert main(["track", "arm.urdf"]) == 2
    assert "l1, l2, l3, l4, l5" in capsys.readouterr().err


def test_info_reports_a_task_that_takes_all_joints(capsys):
    said, found = described(capsys, arm(6), "--task", "pose")
    assert found["r"] == 0
    assert "there is no self-motion to command" in said
    assert "Try: eos-pin track arm.urdf --task pose" in said


def test_info_reports_a_task_that_does_not_fit(capsys):
    said, found = described(capsys, arm(4), "--task", "pose", "--html", "arm.html", "--plot", "arm.png")
    assert list(found["cannot"]) == ["task"]
    assert "No such task: PoseTask" in said
    assert (found["m"], found["r"], found["z"]) == (None, None, None)
    assert Path("arm.html").exists()
    assert Path("arm.png").exists()


def test_info_reports_a_frame_that_no_joint_moves(capsys):
    # The one joint turns about the line on which all frames lie.
    said, found = described(capsys, arm(1))
    assert list(found["cannot"]) == ["task"]
    assert "stays where it is" in said


def test_info_warns_where_no_chart_can_be_made(capsys):
    said, found = described(capsys, arm(3, axes=("0 1 0",)), "--axes", "xz", "--q0", "0", "0", "0")
    assert list(found["cannot"]) == ["chart"]
    assert "Warning:" in said
    assert found["singular"]


def test_info_refuses_mistakes_of_the_caller(capsys):
    Path("arm.urdf").write_text(arm())
    for words in (["--q0", "1", "2"], ["--axes", "xw"], ["--frame", "toool"]):
        assert main(["info", "arm.urdf", *words]) == 2
        assert capsys.readouterr().err.startswith("Error:")


def test_notes_are_printed_beside_the_results_of_every_command(capsys):
    Path("arm.urdf").write_text(
        arm().replace("<inertial>", '<visual><geometry><mesh filename="lost.stl"/></geometry></visual><inertial>')
    )
    for words in (
        ["track", "arm.urdf", "--duration", "0.1", "--out", "out"],
        ["compare", "arm.urdf", "--duration", "0.1", "--controllers", "eos", "--out", "out"],
        ["ik", "arm.urdf", "--to", "0.3", "0.2", "1.0"],
        ["replay", "out/run.npz", "--csv", "run.csv"],
        ["sweep", "arm.urdf", "--duration", "0.1", "--kp", "50,100", "--jobs", "1"],
    ):
        assert main(words) == 0
        said = capsys.readouterr()
        assert said.err.count("1 mesh files were not found") == said.err.count("Note: ") == 1
        assert "Note" not in said.out
    assert main(["info", "arm.urdf"]) == 0
    assert "Note: 1 mesh files were not found" in capsys.readouterr().out
