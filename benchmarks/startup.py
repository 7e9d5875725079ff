"""How long it takes from the start of a process to the first control step, and to the help of the command line.

    python benchmarks/startup.py [--rounds 15] [--json FILE]

Wall time of whole processes, interleaved, medians; beside them processes that only import NumPy, Pinocchio, or
the three packages that a control step needs.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, write_json

STEP = """
import numpy as np
from eos_pin import ControlLoop, EosController, PositionTask, figure_eight, load_robot
robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
loop = ControlLoop(EosController(task, figure_eight(task.value(q), 0.1, period=4.0, plane="yz")))
loop.step(0.0, q, 0.0 * q)
"""
#: What is started, and how long it may take [s].
STARTS: dict[str, tuple[str, float | None]] = {
    "python": ("pass", None),
    "import numpy": ("import numpy", None),
    "import pinocchio": ("import pinocchio", None),
    "all three that a step needs": ("import numpy, pinocchio, scipy.linalg", None),
    "import eos_pin": ("import eos_pin", None),
    "from eos_pin import *": ("from eos_pin import *", None),
    "first step of panda": (STEP, 0.8),
    "eos-pin --help": ("import sys; from eos_pin.cli.main import main; sys.exit(main(['--help']))", 0.6),
    "eos-pin track --help": (
        "import sys; from eos_pin.cli.main import main; sys.exit(main(['track', '--help']))",
        None,
    ),
    "eos-pin robots": ("import sys; from eos_pin.cli.main import main; sys.exit(main(['robots']))", None),
}


def benchmark(*, rounds: int = 15, json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None) -> int:
    """Time the start of processes.

    Args:
        rounds: Starts of each.
        json_file: File for the figures.
    """
    spent: dict[str, list[float]] = {name: [] for name in STARTS}
    for _ in range(rounds + 1):
        for name, (code, _) in STARTS.items():
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
            spent[name].append(time.perf_counter() - start)
    # The first round found files that were not in memory yet.
    median = {name: float(np.median(seconds[1:])) for name, seconds in spent.items()}
    rows = [
        (
            name,
            median[name],
            median[name] / median["import numpy"],
            median[name] / median["import pinocchio"],
            "" if allowed is None else f"{allowed:g}",
        )
        for name, (_, allowed) in STARTS.items()
    ]
    columns = ("a process that does", "seconds", "× numpy", "× pinocchio", "allowed")
    console.print(grid("Start-up", columns, rows))
    if json_file is not None:
        write_json(json_file, {"seconds": median, "least": {name: min(seconds) for name, seconds in spent.items()}})
    return 0 if all(allowed is None or median[name] <= allowed for name, (_, allowed) in STARTS.items()) else 1


if __name__ == "__main__":
    sys.exit(run(benchmark))
