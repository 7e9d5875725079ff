"""An hour of panda at 1 kHz with noise, delay and a model that is 20 % off; a minute of it wherever tests run.

    python -m pytest -m hour -s tests/simulation/test_hour.py

takes a quarter of an hour or less and prints what it found.
"""

from __future__ import annotations

import os
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from checks import READY as REST
from checks import tip

from eos_pin import EosController, PositionTask, SensorNoise, Track, figure_eight, simulate_sampled

#: Gains that a robot of 1 kHz bears with these delays.
GAINS = {"kp": 400.0, "kd": 40.0}


def resident():
    """Memory that the process holds now [bytes]; 0 where the system does not say."""
    pages = Path("/proc/self/statm")
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if pages.exists() else 0


def disturbed(panda, duration, rate, observer=None):
    """Figure eight after figure eight of a robot that is not what its controller takes it for."""
    task = PositionTask(panda, tip(panda))
    path = figure_eight(task.value(REST), 0.15, period=4.0, plane="yz")
    return simulate_sampled(
        panda.perturbed(mass=0.2, com=0.2, inertia=0.2, seed=1),
        EosController(task, path, Track(**GAINS), **GAINS),
        REST,
        duration=duration,
        noise=SensorNoise(q=1e-5, dq=1e-3),
        delay=2e-3,
        torque_limits=True,
        seed=1,
        record_rate=rate,
        observer=observer,
    )


def check_bounded(run, cycles):
    """The last cycles are no worse than the early ones, and the joints come back in each."""
    assert run.ok, run.message
    assert run.cycles == cycles
    size = np.linalg.norm(run.error, axis=1)
    half = len(size) // 2
    assert size[run.settled_row :].max() < 5e-3
    assert size[half:].max() < 1.2 * size[run.settled_row : half].max()
    assert np.abs(run.tau).max() <= 87.0
    # Noise moves the joints a little in each cycle; no cycle adds to the one before.
    q = run.q[run.cycle_rows][1:]
    assert run.joint_drift_per_cycle[1:].max() < 1e-4
    assert np.abs(q - q[0]).max() < 1e-4
    return size


@pytest.mark.usefixtures("unchecked")
@pytest.mark.slow
def test_minute_of_everything_at_once_is_bounded(panda):
    check_bounded(disturbed(panda, 60.0, 20.0), 15)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.slow
def test_memory_is_kept_only_for_the_samples(panda):
    held = {}
    tracemalloc.start()
    try:
        disturbed(panda, 6.0, 1.0, lambda t, q: held.setdefault(t, tracemalloc.get_traced_memory()[0]))
    finally:
        tracemalloc.stop()
    # 4,000 periods with four samples: had each period left one float, it would show.
    assert held[5.0] - held[1.0] < 4_000 * 8


@pytest.mark.usefixtures("unchecked")
@pytest.mark.slow
@pytest.mark.hour
def test_hour_of_everything_at_once_is_bounded(panda):
    start, held = time.perf_counter(), []
    run = disturbed(panda, 3600.0, 5.0, lambda t, q: held.append((t, resident())))
    wall = time.perf_counter() - start
    size = check_bounded(run, 900)
    t, state = np.array(held).T
    later = state[t > 60.0]
    grown = later[-1] - later[0]
    q = run.q[run.cycle_rows][1:]
    drift = run.joint_drift_per_cycle[1:]
    print(
        f"\n{run.t[-1]:.0f} s in {wall:.0f} s of wall time; task error at most {size[run.settled_row :].max():.3g} m, "
        f"root mean square {np.sqrt(np.mean(size[run.settled_row :] ** 2)):.3g} m; joint drift per cycle at most "
        f"{drift.max():.3g} rad, median {np.median(drift):.3g}; from the first cycle to the last "
        f"{np.abs(q[-1] - q[0]).max():.3g} rad; memory grew by {grown / 2**20:.1f} MB after the first minute, "
        f"{grown / len(later):.0f} bytes a sample"
    )
    # What a sample is: nine small arrays. 3.5 million periods without one leave nothing.
    assert grown < 2_000 * len(later)
