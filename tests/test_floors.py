"""The floors of the package: who may import whom. The table below is the map of the modules."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "eos_pin"

#: A module may import only modules above it in this table. Of other people's packages it may import NumPy, jaxtyping
#: (`errors` not even these) and those in the last column. An import inside a function counts like any other.
TABLE = """
    0 ground    errors
                arrays
                files
                terminal
                waypoints
                interrupts
                compiled
                _kernels/flat       pinocchio
                _kernels/plain      scipy
                _kernels/tracing
                _kernels/kinematics
    1 robot     angles
                workspace       pinocchio
                postures
                robot           pinocchio
                notes           pinocchio
                library
                markup          lxml
                checking        lxml
                urdf            lxml pinocchio
                shapes          coal lxml pinocchio yourdfpy
                loading         lxml pinocchio
                clearance       coal pinocchio
    2 geometry  linear          scipy
                bases
                tasks           pinocchio
                frames          pinocchio
                positions       pinocchio
                orientations    pinocchio
                extent          pinocchio
                newton          scipy
                charts          scipy
                atlas
                planning/components
                planning/arcs
                planning/covering   scipy
                planning/manifold
    3 motion    dynamics        scipy
                targets
                trajectories
                splines         scipy
                objectives
                avoidance
    4 control   driving         scipy
                memories
                controllers
                baselines       scipy
                change          daqp
                overload
                limits
                loop
                batch
    5 run       strength
                presets         pinocchio
                pathfiles
                systems
                margins
                results
                recording
                simulation      scipy
                kinematics      scipy
                mujoco_plant    mujoco pinocchio
                applicability
                options
                sweeps          joblib pyarrow
                applications    coal
                paper
                claims
    6 show      meshes          coal pinocchio trimesh
                scene           pinocchio
                server          tornado
                viewer
                drawing         matplotlib
                panels          matplotlib
                keyframes       matplotlib
                plots           matplotlib
                figures         matplotlib
                animation       PIL matplotlib
                tables          rich
                report          matplotlib rich tyro
                encounters      coal matplotlib
                exhibits        rich
                sweeping        rich tyro
                describing
                cli             tyro
                __main__
"""


def read_table():
    """Module → (floor, other people's packages of its last column), from the ground up."""
    rows, floor = {}, ""
    for line in TABLE.strip().splitlines():
        *named, rest = line.strip().split(maxsplit=2) if line.strip()[0].isdigit() else (line,)
        floor = " ".join(named) or floor
        module, *others = rest.split()
        rows[module] = floor, set(others)
    return rows


ROWS = read_table()
#: Every module, a sub-package and its module joined by a slash.
MODULES = sorted(
    path.relative_to(PACKAGE).with_suffix("").as_posix() for path in PACKAGE.rglob("*.py") if path.stem != "__init__"
)
SOURCES = sorted(path for path in PACKAGE.rglob("*") if path.suffix in {".py", ".pyi", ".pyx", ".pxd"})


def imported(path):
    """Modules that a file imports, at its top or inside a function, as (dotted name, line)."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno} imports relatively; write the module's full name"
            # `from eos_pin import robot` imports eos_pin.robot, and likewise from a sub-package.
            package = (PACKAGE.parent / node.module.replace(".", "/")).is_dir()
            names = [f"{node.module}.{alias.name}" for alias in node.names] if package else [node.module]
            yield from ((name, node.lineno) for name in names)


def test_the_table_lists_every_module_and_no_other():
    assert sorted(ROWS) == MODULES, "add each new module of eos_pin to the table of this test, at its floor"
    floors = [floor for floor, _ in ROWS.values()]
    assert floors == sorted(floors)


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_only_what_is_below_it(module):
    path = PACKAGE / f"{module}.py"
    above = list(ROWS)
    allowed = set(above[: above.index(module)])
    for name, line in imported(path):
        if name.split(".")[0] == "eos_pin":
            other = "/".join(name.split(".")[1:])
            assert other in allowed, f"{path.name}:{line} imports {other}, which does not lie above it in the table"


@pytest.mark.parametrize("module", MODULES)
def test_a_module_uses_only_the_packages_its_row_names(module):
    path = PACKAGE / f"{module}.py"
    used = {name.split(".")[0] for name, _ in imported(path)} - sys.stdlib_module_names - {"eos_pin"}
    if module != "errors":
        used -= {"numpy", "jaxtyping"}
    assert used == ROWS[module][1], f"{path.name} imports {sorted(used)}; its row says {sorted(ROWS[module][1])}"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_a_module_is_short_enough_to_be_read(path):
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= 400, f"{path.name} has {lines} lines: split it by concept"
