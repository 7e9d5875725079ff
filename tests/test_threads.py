"""Threads: each has a robot of its own and what is made of it; values are shared. Nothing else is promised."""

from __future__ import annotations

import copy
import sys
import threading

import numpy as np
import pytest
from checks import random_state

import eos_pin

THREADS, STEPS, PERIOD = 3, 90, 0.002


@pytest.fixture
def busy():
    """Threads that take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def motion(robot, path, limits, seed):
    """Torques of a loop, commands of another, a run and joints at points: as many numbers as possible."""
    task = eos_pin.PoseTask(robot, "panda_hand_tcp")
    q = random_state(robot, seed=seed)[0]
    z = task.value(q)
    reference = eos_pin.PoseTrajectory(position=path, orientation=z[3:].reshape(3, 3))
    loop = eos_pin.ControlLoop(eos_pin.EosController(task, reference), torque_limits=False)
    limited = eos_pin.ControlLoop(
        eos_pin.LimitedEosController(task, task.hold(q), limits=limits, control_period=PERIOD)
    )
    found = [loop.step(PERIOD * k, q + 1e-3 * np.sin(0.1 * k), 0.1 * np.cos(q + k)) for k in range(STEPS)]
    found += [limited.step(PERIOD * k, q + 1e-3 * np.sin(0.1 * k), 0.0 * q) for k in range(STEPS // 3)]
    found.append(eos_pin.inverse_kinematics(task, task.value(q + 0.1), q).q)
    run = eos_pin.simulate(robot, eos_pin.EosController(task, task.hold(q)), q, duration=0.05)
    return np.concatenate([*found, run.q.ravel(), run.tau.ravel()])


@pytest.mark.usefixtures("unchecked", "busy")
def test_threads_with_robots_of_their_own_agree_with_one_thread():
    robot = eos_pin.load_robot("panda", chain_to="panda_hand_tcp")
    path = eos_pin.circle([0.4, 0.1, 0.5], 0.05, period=2.0)
    limits = eos_pin.JointLimits.from_robot(robot)
    alone = [motion(robot, path, limits, seed) for seed in range(THREADS)]
    found, start = [None] * THREADS, threading.Barrier(THREADS)

    def work(i):
        own = copy.deepcopy(robot) if i % 2 else eos_pin.load_robot("panda", chain_to="panda_hand_tcp")
        start.wait()
        found[i] = motion(own, path, limits, i)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for together, single in zip(found, alone, strict=True):
        np.testing.assert_array_equal(together, single)
