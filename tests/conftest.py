"""What all tests share: run-time type checks of the package, one thread, no display, and a few robots."""

from __future__ import annotations

import os
import sys

# Before NumPy is imported: more threads make small matrices slower and results depend on the machine.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import signal  # noqa: E402

import hypothesis  # noqa: E402
import pytest  # noqa: E402
import typecheck  # noqa: E402

# Before eos_pin is imported.
typecheck.install()

import checks  # noqa: E402

import eos_pin  # noqa: E402

# A shell starts background jobs deaf to Ctrl-C, and so would be the processes that tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

COMMON = {
    "deadline": None,
    # Near singular configurations are sorted out, and robots like to be singular where all numbers are simple.
    "suppress_health_check": [hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.filter_too_much],
}
hypothesis.settings.register_profile("ci", derandomize=True, database=None, max_examples=20, **COMMON)
hypothesis.settings.register_profile("explore", max_examples=500, database=None, **COMMON)
# `--hypothesis-profile=explore` looks for new counterexamples; by default every run draws the same ones.
hypothesis.settings.load_profile("ci")


@pytest.fixture(autouse=True)
def _counted_calls():
    typecheck.begin()


@pytest.fixture(scope="session")
def panda():
    """Arm with seven revolute joints."""
    return checks.robot("panda")


@pytest.fixture(scope="session")
def task(panda):
    """Position of that arm's hand, for tests that need just one task."""
    return eos_pin.PositionTask(panda, checks.tip(panda))


@pytest.fixture(scope="session")
def kinova():
    """Arm with six revolute joints, three of them without limits."""
    return checks.robot("kinova")


@pytest.fixture(scope="session")
def ur5():
    """Arm with six revolute joints."""
    return checks.robot("ur5")


@pytest.fixture(scope="session")
def ppr():
    """Planar robot of Sec. 4.3, n = 3, with gravity along −y as in the paper."""
    return checks.robot("ppr")


@pytest.fixture(scope="session")
def chain():
    """Planar robot of Sec. 6, n = 10, with gravity along −y as in the paper."""
    return checks.robot("chain")


@pytest.fixture
def unchecked():
    """Switch the run-time type checks off: for arguments of a wrong type, and for long runs."""
    with typecheck.off():
        yield


@pytest.fixture
def without_meshes(monkeypatch):
    """Robots are drawn by their joints: for pages whose robot nobody looks at. Reading meshes takes seconds."""
    monkeypatch.setattr(eos_pin.Robot, "visual", None)


@pytest.fixture
def quick_pictures(monkeypatch, without_meshes):
    """Pages of figures are empty: for what writes them beside that which is tested. Drawing takes seconds."""
    from matplotlib.figure import Figure

    from eos_pin.plots import pages

    for name in ("overview", "comparison", "sweep"):
        monkeypatch.setattr(pages, name, lambda *arguments, **options: Figure((1.0, 1.0)))


@pytest.fixture
def tables_fit(monkeypatch):
    """Each table of a command is looked at on terminals of usual widths as it is printed."""
    import screen

    screen.watch(monkeypatch)


@pytest.fixture(params=["compiled", "plain"])
def build(request, monkeypatch):
    """With what is compiled, and without."""
    if request.param == "plain":
        from eos_pin._kernels.dispatch import REFERENCES, kernels
        from eos_pin.control import _regularize, limited, loop  # noqa: F401 - they choose their kernels

        plain = {} if kernels is None else {id(getattr(kernels, name)): form for name, form in REFERENCES.items()}
        for module in [module for name, module in sys.modules.items() if name.startswith("eos_pin.")]:
            for name, value in list(vars(module).items()):
                if id(value) in plain:
                    monkeypatch.setattr(module, name, plain[id(value)])
