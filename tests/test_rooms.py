"""The rooms of the package: which room may import which, and which third-party packages it may use."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "eos_pin"

#: A room may import only rooms above it in this table. Of third-party packages it may import NumPy, jaxtyping and
#: lazy_loader (`errors` none of them) and those in its row. An import inside a function counts like any other.
TABLE = """
    errors
    _arrays
    _files
    _kernels        pinocchio scipy
    robot           coal lxml pinocchio yourdfpy
    tasks           pinocchio
    trajectories    pinocchio rosbags ruckig scipy
    charts          scipy
    planning        coal pinocchio scipy toppra trimesh yaml
    control         daqp pylibfranka scipy
    simulation      mujoco pinocchio scipy
    experiments     gymnasium joblib pinocchio pyarrow scipy
    viewer          coal pinocchio rerun tornado trimesh
    plots           matplotlib
    cli             matplotlib rich tyro
    paper           PIL coal matplotlib rich
"""
ROOMS = {name: set(packages) for name, *packages in (line.split() for line in TABLE.strip().splitlines())}
#: What a scripted reader of the package sees: at most this many entries on its top level, and in a room.
MOST_ENTRIES, MOST_MODULES, MOST_LINES = 16, 16, 400
#: A third of the 359 imports between rooms when every module was a room of its own; scripts and benchmarks included.
MOST_ARROWS = 119
#: `__init__` and `__main__` are the names that Python itself looks for.
PATHS = sorted(path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE or not path.name.startswith("__"))


def name_of(path):
    """Dotted name of a module below the package."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in PATHS}


@cache
def imported(path):
    """Modules that a file imports, at its top or inside a function, as (dotted name, line)."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno} imports relatively; write the module's full name"
            # `from eos_pin.robot import model` imports eos_pin.robot.model.
            whole = [f"{node.module}.{alias.name}".removeprefix("eos_pin.") for alias in node.names]
            inside = node.module.split(".")[0] == "eos_pin"
            found += [(f"eos_pin.{name}" if inside and name in MODULES else node.module, node.lineno) for name in whole]
    return found


def inside(path):
    """Modules of the package that a file imports."""
    return [(name.removeprefix("eos_pin."), line) for name, line in imported(path) if name.startswith("eos_pin.")]


def test_rooms_table_lists_every_room():
    found = {name.split(".")[0] for name in MODULES}
    assert set(ROOMS) == found, "add each new room of eos_pin to the table of this test, where it belongs"


def test_modules_import_only_rooms_below():
    order, faults = list(ROOMS), []
    for module, path in MODULES.items():
        room = module.split(".")[0]
        for name, line in inside(path):
            if order.index(other := name.split(".")[0]) > order.index(room):
                faults.append(f"{module}:{line} imports {other}, which lies below {room}")
    assert not faults, "\n".join(faults)


def test_modules_use_only_packages_of_their_room():
    faults = []
    for module, path in MODULES.items():
        room = module.split(".")[0]
        used = {name.split(".")[0] for name, _ in imported(path)} - sys.stdlib_module_names - {"eos_pin"}
        if more := used - ROOMS[room] - (set() if room == "errors" else {"numpy", "jaxtyping", "lazy_loader"}):
            faults.append(f"{module} imports {sorted(more)}; the row of {room} does not list it")
    assert not faults, "\n".join(faults)


def test_rooms_list_no_package_in_vain():
    used = {room: set() for room in ROOMS}
    for module, path in MODULES.items():
        used[module.split(".")[0]] |= {name.split(".")[0] for name, _ in imported(path)}
    assert {room: packages - used[room] for room, packages in ROOMS.items() if packages - used[room]} == {}


def test_modules_of_a_room_form_no_cycle():
    arrows = {module: {name for name, _ in inside(path) if name in MODULES} for module, path in MODULES.items()}
    done, open_ = set(), []

    def visit(module):
        assert module not in open_, f"a cycle of imports: {' -> '.join([*open_, module])}"
        if module not in done:
            open_.append(module)
            for other in sorted(arrows[module] - {module}):
                visit(other)
            open_.pop()
            done.add(module)

    for module in arrows:
        visit(module)


def test_arrows_between_rooms_are_few():
    home = PACKAGE.parent
    files = [
        *PATHS,
        *(path for folder in ("benchmarks", "scripts", "examples") for path in (home / folder).rglob("*.py")),
    ]
    rooms = [path.relative_to(PACKAGE if path.is_relative_to(PACKAGE) else home).parts[0] for path in files]
    names = [{name.split(".")[0].removesuffix(".py") for name, _ in inside(path)} & set(ROOMS) for path in files]
    arrows = {(room.removesuffix(".py"), other) for room, others in zip(rooms, names, strict=True) for other in others}
    found = {arrow for arrow in arrows if arrow[0] != arrow[1]}
    assert len(found) <= MOST_ARROWS, f"{len(found)} pairs of rooms import each other's modules: {sorted(found)}"


def test_paper_room_is_imported_by_scripts_only():
    for module, path in MODULES.items():
        if not module.startswith("paper"):
            assert not [name for name, _ in inside(path) if name.startswith("paper")], module


def test_modules_are_short():
    faults = []
    for path in (path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".pyx", ".pxd", ".pyi")):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        if lines > MOST_LINES:
            faults.append(f"{path.relative_to(PACKAGE)} has {lines} lines: split it by concept")
    assert not faults, "\n".join(faults)


def test_package_is_seen_at_once():
    built = ("__", "py.typed")
    entries = [path.name for path in PACKAGE.iterdir() if not path.name.startswith(built) and path.suffix != ".so"]
    assert len(entries) <= MOST_ENTRIES, sorted(entries)
    folders = Counter(path.parent for path in MODULES.values() if path.name != "__init__.py")
    assert {folder.name: count for folder, count in folders.items() if count > MOST_MODULES} == {}
