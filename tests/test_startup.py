"""What starting costs: each module is imported when something of it is used, and not before."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "eos_pin"

#: What takes time to import, from the lightest.
HEAVY = ("numpy", "lxml", "pinocchio", "scipy.linalg", "scipy.integrate", "joblib", "tyro", "rich", "matplotlib")
HEAVY += ("tornado", "meshcat", "trimesh", "yourdfpy", "mujoco", "pyarrow", "toppra", "distributed")


def loaded(code):
    """Which of the heavy packages a process has imported after some code."""
    code = f"import sys\n{code}\nprint(*[name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    run = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    return set(run.stderr.split())


def test_importing_the_package_imports_nothing_else():
    assert loaded("import eos_pin") == set()


def test_each_kernel_may_be_imported_first():
    code = """
import importlib, os, sys
import jaxtyping, pinocchio, scipy.linalg
for name in sys.argv[1:]:
    if not os.fork():
        importlib.import_module(name)
        os._exit(0)
    assert os.wait()[1] == 0, name
"""
    # Extension modules, too, if they have been built.
    stems = {file.name.partition(".")[0] for kind in (".py", ".so") for file in (PACKAGE / "_kernels").glob(f"*{kind}")}
    names = [f"eos_pin._kernels.{stem}" for stem in sorted(stems - {"__init__"})]
    subprocess.run([sys.executable, "-c", code, *names], check=True)


def test_control_loop_needs_no_more_than_the_dynamics():
    code = """
import numpy as np
from eos_pin import ControlLoop, EosController, Hold, PositionTask, load_robot
robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
ControlLoop(EosController(task, Hold(task.value(q)))).step(0.0, q, 0.0 * q)
"""
    assert loaded(code) == {"numpy", "lxml", "pinocchio", "scipy.linalg"}


def test_help_does_not_wait_for_the_dynamics():
    code = """
from contextlib import suppress
from eos_pin.cli.main import main
for words in (["--help"], ["sweep", "--help"]):
    with suppress(SystemExit):
        main(words)
"""
    assert loaded(code) == {"numpy", "tyro", "rich"}


def test_public_names_are_there():
    import eos_pin

    assert sorted(eos_pin.__all__) == sorted(set(eos_pin.__all__))
    assert all(hasattr(eos_pin, name) for name in eos_pin.__all__)
    assert set(eos_pin.__all__) <= set(dir(eos_pin))
    assert {"Chart", "load_robot", "sweep"} <= set(eos_pin.__all__)
    with pytest.raises(AttributeError, match="nobody"):
        _ = eos_pin.nobody


@pytest.mark.parametrize("room", sorted(path.parent.name for path in PACKAGE.glob("*/__init__.pyi")))
def test_public_names_of_rooms_are_there(room):
    module = importlib.import_module(f"eos_pin.{room}")
    assert module.__all__
    assert all(hasattr(module, name) for name in module.__all__)
    assert set(module.__all__) <= set(dir(module))


def test_rooms_that_users_import_from_have_public_names():
    rooms = {"charts", "control", "experiments", "planning", "plots", "robot", "simulation", "tasks", "trajectories"}
    assert rooms | {"viewer"} == {path.parent.name for path in PACKAGE.glob("*/__init__.pyi")}


def test_task_of_a_plan_is_known_in_a_process_that_used_no_task_before():
    code = """
from eos_pin import load_robot
from eos_pin.tasks.stacked import task_from_description
words = {"kind": "pose", "frame": "panda_hand_tcp"}
assert task_from_description(load_robot("panda", chain_to="panda_hand_tcp"), words).describe() == words
"""
    subprocess.run([sys.executable, "-c", code], check=True)
