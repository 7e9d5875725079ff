"""What all workers share: answer requests on stdin, one JSON line each, and time what is asked for.

A worker gives `serve` a function that turns a problem into cases: names, and calls that take one input and return
one answer, all flat lists of numbers or vectors. What a library prints goes to stderr; stdout holds replies only.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import gc
import json
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

#: One repetition: an input in, an answer out.
Call = Callable[[Any], Any]
#: What a worker can do on a problem, by name.
Build = Callable[["Problem"], Mapping[str, Call]]


class Problem:
    """One robot and one task, as every worker is given them.

    Attributes:
        urdf: File that describes the robot; the joints that do not count are fixed in it, meshes are left out.
        frame: Frame that is moved.
        joints: Names of the joints, in the order of q.
        whole: Whether the task is the frame's pose, not just its position.
        posture: Rest posture, where inverse kinematics starts.
        target: Placement that a control step wants, (4, 4).
        dz: Its velocity (linear, angular) in world axes, (6,).
        ddz: Its acceleration, (6,).
        t: Time of the step [s], for those who know the path: a figure eight about the frame's place in the posture,
        size: of this half width [m]
        round: and this time of one round [s].
        kp: Gain on errors [1/s²].
        kd: Gain on velocity errors [1/s].
        rate: What a velocity controller is to do of the error in one second [1/s].
        period: Control period [s].
        lower, upper, velocity, effort: Limits of the joints.
        acceleration: Limits of acceleration that are active in the step that is timed.
        tol: Largest task error at the end of inverse kinematics [m, rad].
        max_iterations: Most steps of an iterative solver.
    """

    def __init__(self, **given: Any) -> None:
        for name, value in given.items():
            setattr(self, name, np.array(value) if isinstance(value, list) and name != "joints" else value)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"the problem has no {name}")

    @property
    def m(self) -> int:
        """Dimension of the task."""
        return 6 if self.whole else 3

    def split(self, given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start and wanted placement from the input of an inverse-kinematics case."""
        n = len(self.joints)
        return given[:n], given[n:].reshape(4, 4)


def iterate(error: Callable[[], np.ndarray], improve: Callable[[], Any], problem: Problem) -> None:
    """Improve until the error is small enough, or the allowed steps are used up.

    Args:
        error: Task error left, position and, for a pose, rotation.
        improve: One step.
        problem: Says what is small and how many steps are allowed.
    """
    for _ in range(problem.max_iterations):
        if max(map(abs, error().tolist())) <= problem.tol:
            return
        improve()


def serve(build: Build) -> None:
    """Answer requests until stdin ends.

    Requests are {"problem": {...}}, which is answered by the names of the cases; {"run": name, "inputs": [...],
    "repeats": k}, by microseconds of CPU time per call and the answer for each input; {"each": name, "inputs": [...],
    "count": k}, by the microseconds of every single call, and the memory that was kept.
    """
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    cases: Mapping[str, Call] = {}
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if "problem" in request:
                cases = build(Problem(**request["problem"]))
                reply: dict[str, Any] = {"cases": sorted(cases)}
            elif "run" in request:
                reply = _run(cases[request["run"]], request["inputs"], request["repeats"])
            else:
                reply = _each(cases[request["each"]], request["inputs"], request["count"])
        except Exception as error:
            traceback.print_exc()
            reply = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(reply), file=replies, flush=True)


def _run(call: Call, inputs: list[list[float]], repeats: int) -> dict[str, Any]:
    """Time of one call for each input, and its answer, which is empty where the call raises an error."""
    microseconds, answers, trouble = [], [], ""
    for given in map(np.array, inputs):
        answer: Any = ()
        start = time.process_time_ns()
        try:
            answer = np.ravel(call(given)).astype(float)
            if repeats:
                start = time.process_time_ns()
            for _ in range(repeats):
                call(given)
        except Exception as error:
            trouble = f"{type(error).__name__}: {error}"
        microseconds.append(1e-3 * (time.process_time_ns() - start) / max(repeats, 1))
        answers.append(list(answer))
    return {"microseconds": microseconds, "answers": answers, "trouble": trouble}


def _each(call: Call, inputs: list[list[float]], count: int) -> dict[str, Any]:
    """Percentiles of the time of single calls, garbage collector on, and the memory that their second half kept.

    All is done three times. What the code itself takes long for comes again at the same call; what interrupts the
    machine does not, and is not in the least of three times.
    """
    states = [np.array(given) for given in inputs]
    taken = np.full((3, count), 0)  # written once, so that its own pages do not count as memory kept
    clock, length = time.thread_time_ns, len(states)
    for given in states:
        call(given)
    kept = grown = 0
    for k in range(3 * count):
        if k == count // 2:
            gc.collect()
            kept, grown = -sys.getallocatedblocks(), -_resident()
        if k == count:
            gc.collect()
            kept += sys.getallocatedblocks()
            grown += _resident()
        given = states[k % length]
        start = clock()
        call(given)
        taken.flat[k] = clock() - start
    overhead = [clock() - clock() for _ in range(1000)]
    taken += int(np.median(overhead))  # negative: what reading the clock takes
    percentiles = np.percentile(1e-3 * taken[0], [50.0, 99.0, 99.9, 100.0]).tolist()
    own = float(np.percentile(1e-3 * taken.min(axis=0), 99.9))
    return {"percentiles": percentiles, "own": own, "blocks": kept, "bytes": grown, "collections": gc.isenabled()}


def _resident() -> int:
    """Memory of this process [bytes]; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0
