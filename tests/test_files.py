"""A file that is being replaced while its process is killed is the old file or the new one, and loads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eos_pin import OutputError
from eos_pin._files import write_atomically

#: Forks a process that saves two results in turn, kills it at a random instant, and looks at the file; many times.
KILLER = """
import json, os, random, signal, sys, time
from pathlib import Path

import numpy as np

from eos_pin import EosError, Result

path, kills, atomic = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "atomic"
noise = np.random.default_rng(0).normal(size=(2, 2000, 7))


def result(k):
    column, none = noise[k][:, :1], np.zeros((2000, 0))
    joints = dict.fromkeys(("q", "dq", "ddq", "tau"), noise[k])
    task = dict.fromkeys(("z", "dz", "z_ref", "error", "task_force", "task_deficit", "deficit_from_limits"), column)
    rest = dict.fromkeys(("v", "dv", "v_ref"), none) | dict.fromkeys(("kinetic_energy", "work"), column[:, 0])
    chart = np.full(2000, k)
    return Result(t=np.arange(2000.0), **joints, **task, **rest, chart=chart, switches=np.zeros(0), message=str(k))


both = [result(0), result(1)]
if not atomic:
    import eos_pin.simulation._storage

    def write_in_place(path, write):
        with open(path, "wb") as file:
            write(file)

    eos_pin.simulation._storage.write_atomically = write_in_place
start = time.perf_counter()
both[0].save(path)
once = time.perf_counter() - start
figures = {"old or new": [0, 0], "damaged": 0, "interrupted": 0}
random.seed(0)
for kill in range(kills):
    pid = os.fork()
    if pid == 0:
        k = kill
        while True:
            k += 1
            both[k % 2].save(path)
    time.sleep(random.uniform(0.2, 2.5) * once)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    try:
        loaded = Result.load(path)
        k = int(loaded.message)
        assert np.array_equal(loaded.q, both[k].q) and (loaded.chart == k).all()
        figures["old or new"][k] += 1
    except EosError:
        figures["damaged"] += 1
    unfinished = [file for file in path.parent.iterdir() if file != path]
    figures["interrupted"] += len(unfinished)
    for file in unfinished:
        file.unlink()
print(json.dumps(figures))
"""


def kill(path: Path, count: int, how: str) -> dict:
    run = subprocess.run(
        [sys.executable, "-c", KILLER, str(path), str(count), how], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_save_that_is_killed_leaves_the_old_file_or_the_new(tmp_path: Path) -> None:
    figures = kill(tmp_path / "run.npz", 40, "atomic")
    assert figures["damaged"] == 0
    assert sum(figures["old or new"]) == 40
    assert min(figures["old or new"]) > 4
    # Most kills came in the middle of a save.
    assert figures["interrupted"] > 12


def test_save_in_place_would_be_damaged_by_a_kill(tmp_path: Path) -> None:
    """Written in place, as `numpy.savez` would, the file is lost."""
    assert kill(tmp_path / "run.npz", 20, "in place")["damaged"] > 5


def test_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def fail(file):
        file.write(b"new")
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left"):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_save_removes_files_that_a_killed_one_left_behind(tmp_path: Path) -> None:
    path = tmp_path / "run[1].npz"
    # The process ends in the middle of a save, without a chance to clean up.
    write = "lambda file: (file.write(b'half'), os._exit(0))"
    code = f"import os, sys; from eos_pin._files import write_atomically; write_atomically(sys.argv[1], {write})"
    for _ in range(2):
        subprocess.run([sys.executable, "-c", code, str(path)], check=True)
    young, old = sorted(tmp_path.iterdir())
    foreign = [tmp_path / ".run[1].npz.notes", tmp_path / ".run1.npz.abcdefgh.part"]
    for file in (old, *foreign):
        file.touch()
        os.utime(file, (0.0, 0.0))
    write_atomically(path, lambda file: file.write(b"new"))
    # What is young may belong to a save that is under way.
    assert set(tmp_path.iterdir()) == {path, young, *foreign}


def test_writing_to_forbidden_place_raises(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        write_atomically(tmp_path / "file" / "inside", lambda file: file.write(b"new"))
    with pytest.raises(OutputError, match="cannot write"):
        write_atomically(tmp_path, lambda file: file.write(b"new"))


def test_write_makes_missing_folders(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "file"
    write_atomically(path, lambda file: file.write(b"new"))
    assert path.read_bytes() == b"new"
    usual = tmp_path / "usual"
    usual.touch()
    assert path.stat().st_mode == usual.stat().st_mode
