"""Ctrl-C: a real signal to a real process ends the command with code 130, and only what is finished is kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import eos_pin
from eos_pin.errors import take
from eos_pin.experiments import sweeps
from eos_pin.experiments._interrupts import LOOK, patient_interrupts
from eos_pin.simulation._recorder import uninterrupted

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="signals and /proc of Linux")

#: Far more than a loaded machine needs, and far less than the runs would take that are interrupted [s].
PATIENCE = 60.0
LONG, LONGER = "8000", "9000"


class Command:
    """A command in a process group of its own, as a terminal starts it."""

    def __init__(self, *words: str) -> None:
        started = [sys.executable, "-m", "eos_pin.cli.main", *words]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self._process = subprocess.Popen(started, start_new_session=True, **pipes)

    def wait_until(self, ready: Callable[[], bool]) -> None:
        """Wait until something is there; the command must not end before."""
        end = time.monotonic() + PATIENCE
        while not ready():
            assert self._process.poll() is None, self._process.communicate()
            assert time.monotonic() < end, "the command did not come that far"
            time.sleep(0.02)

    @property
    def cpu_seconds(self) -> float:
        """Computing time of the first process so far."""
        words = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def interrupt(self, whole_group: bool) -> tuple[int, str]:
        """Exit code, and text on both streams, after Ctrl-C."""
        (os.killpg if whole_group else os.kill)(self._process.pid, signal.SIGINT)
        try:
            said = "".join(self._process.communicate(timeout=PATIENCE))
            left = self.left
        finally:
            self.end()
        assert not left, "processes of the command go on"
        return self._process.returncode, said

    @property
    def left(self) -> bool:
        """Whether any process of the group is there a while after the first one ended."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                os.killpg(self._process.pid, 0)
            except ProcessLookupError:
                return False
            time.sleep(0.02)
        return True

    def end(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Starts a command in an empty folder; what is left of it in the end is killed."""
    monkeypatch.chdir(tmp_path)
    started = []

    def start(*words: str) -> Command:
        started.append(Command(*words))
        return started[-1]

    yield start
    for each in started:
        each.end()


@pytest.mark.parametrize(
    ("jobs", "whole_group"),
    [(1, False), (2, True), (2, False)],
    ids=["one process", "as a terminal does", "to the first process only"],
)
def test_sweep_ends_and_keeps_finished_runs(command, jobs: int, whole_group: bool) -> None:
    words = ["sweep", "ppr", "--size", "0.05", "--cycles", "1", "--jobs", str(jobs), "--period"]
    finished = Path("runs/sweep/finished")
    swept = command(*words, f"1,2,{LONG},{LONGER}")
    swept.wait_until(lambda: len(list(finished.glob("*.json"))) == 2)
    code, said = swept.interrupt(whole_group)
    assert code == 130, said
    # Between the file and the count is an instant.
    assert "2 of 4 done; run the same command again to go on" in said or "1 of 4 done" in said
    assert "Traceback" not in said
    assert "Warning" not in said
    kept = [json.loads(file.read_text()) for file in finished.iterdir()]
    assert sorted(row["settings"]["period"] for row in kept) == [1.0, 2.0]
    assert all(row["figures"]["status"] == "finished" for row in kept)
    assert [path.name for path in Path("runs/sweep").iterdir()] == ["finished"]


@pytest.mark.parametrize(("word", "whole_group"), [("track", True), ("compare", False)])
def test_interrupted_run_leaves_no_file(command, word: str, whole_group: bool) -> None:
    begun = command(word, "ppr", "--size", "0.05", "--duration", LONG)
    begun.wait_until(lambda: begun.cpu_seconds > 2.5)
    code, said = begun.interrupt(whole_group)
    assert code == 130, said
    assert "Interrupted" in said
    assert "Traceback" not in said
    assert not list(Path().rglob("*.*"))


def test_sweep_started_from_python_does_not_keep_an_interrupted_run(tmp_path: Path, unchecked) -> None:
    class Interrupted(sweeps.Trial):
        def run(self, observer=None) -> eos_pin.Result:
            def stop(t: float, q: np.ndarray) -> None:
                if t > 0.1:
                    raise KeyboardInterrupt

            robot, controller, q, _ = self.prepare()
            return eos_pin.simulate(robot, controller, q, duration=1.0, observer=stop)

    with pytest.raises(KeyboardInterrupt, match="interrupted at t"):
        sweeps.sweep([Interrupted.from_settings("ppr")], folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_uninterrupted_passes_a_whole_result(ppr, unchecked) -> None:
    task = eos_pin.PositionTask(ppr, "tip", "xy")
    q = eos_pin.experiments.defaults.rest_posture(task)
    run = eos_pin.simulate(ppr, eos_pin.EosController(task, eos_pin.Hold(task.value(q))), q, duration=0.1)
    assert uninterrupted(run) is run


GREEDY = "import signal\ntry:\n    signal.raise_signal(signal.SIGINT)\nexcept BaseException:\n    greedy = True\n"


def test_ctrl_c_waits_until_a_module_is_imported(tmp_path: Path, monkeypatch) -> None:
    def work() -> None:
        with patient_interrupts():
            assert not hasattr(__import__("interrupted_module"), "greedy")
            time.sleep(PATIENCE)

    (tmp_path / "interrupted_module.py").write_text(GREEDY)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        work()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_in_the_last_import_is_not_lost(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "interrupted_last.py").write_text("import signal\nsignal.raise_signal(signal.SIGINT)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), patient_interrupts():
        __import__("interrupted_last")


def swallow() -> None:
    with suppress(BaseException):
        signal.raise_signal(signal.SIGINT)


class Dropped:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("lose", [swallow, Dropped], ids=["a library catches everything", "a destructor drops it"])
@pytest.mark.parametrize("seconds", [0.0, PATIENCE], ids=["the command ends", "the command goes on"])
def test_ctrl_c_that_is_lost_ends_the_command(lose: Callable[[], object], seconds: float) -> None:
    def work() -> None:
        with patient_interrupts():
            lose()
            time.sleep(seconds)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_that_is_dealt_with_is_not_repeated() -> None:
    with patient_interrupts():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as interrupt:
            take(interrupt)
        time.sleep(3.0 * LOOK)


def test_ctrl_c_is_not_repeated_while_files_are_closed() -> None:
    closed = []

    def work() -> None:
        with patient_interrupts():
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                time.sleep(3.0 * LOOK)
                closed.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert closed


@pytest.mark.parametrize("module", ["eos_pin.cli.main", "tyro", "rich.console"])
def test_command_line_is_interrupted_while_its_modules_are_imported(module: str, tmp_path: Path) -> None:
    script = f"""
import runpy, signal, sys
class Interrupts:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == {module!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupts)
runpy.run_module("eos_pin", run_name="__main__")
"""
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, timeout=PATIENCE, check=False
    )
    assert (ended.returncode, ended.stderr) == (130, "Interrupted\n")
