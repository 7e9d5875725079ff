"""Pages of the documentation: their Python runs, their commands parse, and the site builds without a warning."""

from __future__ import annotations

import html
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from eos_pin import (
    EosController,
    circle,
    load_robot,
    make_task,
    rest_posture,
    simulate,
)
from eos_pin.cli.main import main
from eos_pin.planning.obstacles.scene import read_scene
from eos_pin.robot.library import find_robot

ROOT = Path(__file__).parent.parent
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


@pytest.mark.usefixtures("unchecked")
# The page on planning is run by its own test, which looks at what it finds.
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python") and page != "planning"])
def test_examples_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(blocks(page, "python")), f"{page}.md", "exec"), {})


def test_commands_of_pages_have_only_options_that_exist(capsys):
    said = {}
    for page, text in PAGES.items():
        lines = re.findall(r"^(?:\.venv/bin/)?(eos-pin .*)$", "\n".join(blocks(page, "sh")), re.MULTILINE)
        for line in lines + re.findall(r"`(eos-pin \w[^`]*)`", text):
            command, *words = shlex.split(line, comments=True)[1:]
            if command not in said:
                with pytest.raises(SystemExit):
                    main([command, "--help"])
                said[command] = capsys.readouterr().out
            for option in (word for word in words if re.match(r"--[a-z]", word)):
                assert re.search(rf"{option}\b", said[command]), f"{page}.md: {command} has no {option}"


def test_scene_on_the_page_is_read(tmp_path):
    (scene,) = blocks("planning", "yaml")
    (tmp_path / "scene.yaml").write_text(scene)
    trimesh.creation.box((100.0, 100.0, 100.0)).export(tmp_path / "part.stl")
    found = read_scene(tmp_path / "scene.yaml")
    # A sphere is a capsule without length.
    assert [len(found.boxes), len(found.capsules), len(found.meshes)] == [1, 2, 1]


@pytest.mark.slow
def test_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("sphinx")
    for module in ("myst_parser", "furo"):
        pytest.importorskip(module)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", ROOT / "docs", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Nothing is fetched when a page is opened from disk.
    texts = {page: page.read_text(encoding="utf-8") for page in (tmp_path / "site").rglob("*.html")}
    anchors = {page: set(re.findall(r"\b(?:id|name)=\"([^\"]+)\"", text)) for page, text in texts.items()}
    for page, text in texts.items():
        assert not re.findall(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"https?:", text), page
        # Each link within the site leads somewhere.
        for link in re.findall(r"<(?:a|script|link|img|iframe)\b[^>]*\b(?:src|href)=\"([^\"]+)\"", text):
            file, _, anchor = unquote(html.unescape(link)).partition("#")
            if not re.match(r"https?:|data:|mailto:", file):
                target = (page.parent / file.partition("?")[0]).resolve() if file else page
                assert target.exists(), f"{page}: {link}"
                assert not anchor or anchor in anchors.get(target, {anchor}), f"{page}: {link}"


@pytest.fixture
def inputs(tmp_path, monkeypatch):
    """The folder in which commands of pages run, with the files that they name, and a browser that opens at once."""
    for name, robot in {"path/to/robot.urdf": "ur5", "robot.urdf": "panda"}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).symlink_to(find_robot(robot).path)
    task = make_task(load_robot("panda", chain_to="panda_hand_tcp"), "pose")
    q = rest_posture(task)
    placement, turns = task.robot.placement(q, task.frame), np.linspace(0.0, 2.0 * np.pi, 41)
    points = placement.translation + 0.08 * np.column_stack((np.cos(turns) - 1.0, np.sin(turns), 0.0 * turns))
    rows = np.column_stack((points, np.tile(pin.rpy.matrixToRpy(placement.rotation), (len(turns), 1))))
    for name in ("poses.csv", "path.csv"):
        np.savetxt(tmp_path / name, rows, delimiter=",", header="x,y,z,roll,pitch,yaw", comments="")
    (tmp_path / "boxes.yaml").write_text("boxes:\n  - {centre: [-0.5, 0.5, 0.2], size: [0.1, 0.1, 0.1]}\n")
    arm = make_task(load_robot("ur5", chain_to="tool0"), "position")
    start = rest_posture(arm)
    path = circle(arm.value(start), 0.05, period=2.0, plane="yz")
    run = simulate(arm.robot, EosController(arm, path), start, duration=4.0)
    run.to_csv(tmp_path / "log.csv")
    for name in ("first", "second"):
        run.save(tmp_path / name / "run.npz")
    monkeypatch.setattr("webbrowser.open", lambda *address, **how: True)
    monkeypatch.setattr("eos_pin.viewer.viewer.Served.open", lambda *viewer, **how: True)
    monkeypatch.chdir(tmp_path)


@pytest.mark.hour
@pytest.mark.slow
@pytest.mark.usefixtures("unchecked", "inputs")
@pytest.mark.parametrize("page", [page for page in PAGES if "eos-pin " in "".join(blocks(page, "sh"))])
def test_commands_of_a_page_run(page):
    for line in re.findall(r"^(?:\.venv/bin/)?eos-pin .*$", "\n".join(blocks(page, "sh")), re.MULTILINE):
        # A rehearsal takes as long as it says.
        words = shlex.split(line.replace("--duration 60", "--duration 1"), comments=True)[1:]
        assert main(words) == 0, line
