"""Compiled kernels beside their plain forms, and whole steps with and without what is compiled.

    python benchmarks/compiled.py [--rounds N] [--json FILE] [--write]

The robot is Panda. Times are CPU time of one thread, medians of rounds in which both take turns. With --write the ratio
for a step goes into README.md and docs/performance.md. That both forms compute the same is tested in
tests/kernels/test_compiled.py.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import json
import subprocess
import sys
import weakref
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import compiled_text
import numpy as np
import pinocchio as pin
import tyro
from chains import cpu
from rich.progress import track

from eos_pin import (
    Chart,
    Controller,
    ControlLoop,
    EosController,
    ImpedanceController,
    LimitedEosController,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Task,
    Trajectory,
    figure_eight,
    load_robot,
    simulate,
)
from eos_pin._arrays import ORTHONORMAL, border
from eos_pin._kernels.dispatch import REFERENCES, kernels
from eos_pin._kernels.ways import relaxed
from eos_pin.cli.main import run
from eos_pin.cli.output import console, grid, stderr, write_json
from eos_pin.control._smallest_change import SmallestChange

TIP, REST = "panda_hand_tcp", np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
#: A call, by what it does.
Calls = Mapping[str, Callable[[], Any]]


def problems() -> dict[str, tuple[Task, Trajectory]]:
    """A position and a pose to follow."""
    robot = load_robot("panda", chain_to=TIP)
    position, pose = PositionTask(robot, TIP), PoseTask(robot, TIP)
    path = figure_eight(position.value(REST), 0.1, period=4.0, plane="yz")
    return {
        "position": (position, path),
        "pose": (pose, PoseTrajectory(path, pose=pose.value(REST))),
    }


def plain_form(kernel: Any) -> Any:
    """The plain form of a compiled kernel, with the same arguments."""
    kind, arguments = kernel.__reduce__()
    arguments = (plain_form(part) if isinstance(part, kernels.Frame) else part for part in arguments)
    return REFERENCES[kind.__name__](*arguments)


def twins() -> tuple[Calls, Calls]:
    """Compiled kernels and their plain forms, on the same arguments."""
    compiled: dict[str, Callable[[], Any]] = {}
    plain: dict[str, Callable[[], Any]] = {}
    dq, dq_last = 0.1 * REST, 0.1 * REST
    for kind, (task, path) in problems().items():
        controller = EosController(task, path)
        state = controller.start(0.0, REST, dq)
        chart, point, target = state.chart, task.at(REST, dq), path(0.1)
        error = task.minus(target.z, point.z)
        law = REST, dq, *target, None
        F = controller.asked(0.1, REST, dq, chart, point)
        limited = LimitedEosController(task, path)
        ddq = state.drive(point.J, F, dq)[0]
        program = SmallestChange(task.m, task.robot.n).program
        bound = np.full(14, 10.0)
        change = point.J, task.robot.mass(REST), -bound, np.where(np.arange(14) == 1, -1.0, bound)

        soft = ImpedanceController(task, task.hold(REST)).start(0.0, REST, dq).laws[0].at_rest
        pull = dq, point.z, point.J, dq
        frame = plain_form(task.kernel)
        plain_law, plain_map, plain_limits = map(plain_form, (state.law, state.drive._kernel, limited._within))
        pairs: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
            "Frame.at": (partial(task.kernel.at, REST, dq), partial(frame.at, REST, dq)),
            "Frame.linearize": (partial(task.kernel.linearize, REST), partial(frame.linearize, REST)),
            "TrackingLaw": (partial(state.law, *law), partial(plain_law, *law)),
            "AccelerationMap": (partial(state.drive, point.J, F, dq), partial(plain_map, point.J, F, dq)),
            "Limits, none active": (
                partial(limited._within, REST, dq, ddq, point.J),
                partial(plain_limits, REST, dq, ddq, point.J),
            ),
            "Limits, one active": (
                partial(limited._within, REST, dq, 40.0 * ddq, point.J),
                partial(plain_limits, REST, dq, 40.0 * ddq, point.J),
            ),
            "ChangeProgram": (partial(program, *change), partial(plain_form(program), *change)),
            "Springs": (partial(soft, *pull), partial(plain_form(soft), *pull)),
            "on_chart_inverse": _pair("on_chart_inverse", point.J, chart.U),
            "newton_step": _pair("newton_step", REST, chart.U, error, chart.B_bar, error),
        }
        if kind == "pose":
            pairs["flat_pose"] = _pair("flat_pose", pin.SE3.Random().homogeneous, ORTHONORMAL)
            pairs["pose_difference"] = _pair("pose_difference", target.z, point.z)
        else:
            watches = kernels.StateMonitor(0.0, REST, 0.04), REFERENCES["StateMonitor"](0.0, REST, 0.04)
            pairs["StateMonitor"] = (
                partial(watches[0].accepts, 0.0, REST, dq),
                partial(watches[1].accepts, 0.0, REST, dq),
            )
            marks = {"self": None, "q": ((7,), ()), "dq": ((7,), ())}
            fast, slow = (form(tuple(marks)) for form in (border.compiled.Accepted, border.Accepted))
            for form in (fast, slow):
                form.remember(weakref.ref(task), marks)
            pairs["Accepted"] = partial(fast, (task, REST, dq), {}), partial(slow, (task, REST, dq), {})
            pairs["within_limits_fast"] = _pair("within_limits_fast", REST, np.full(7, 0.01))
            pairs["largest"] = _pair("largest", error)
            # A layer of a search: every posture goes on to every one of the next.
            end, start = (part.ravel() for part in np.indices((40, 40)))
            layer = np.zeros((40, 40)), start, end, np.ones(1600), 40
            pairs["relaxed"] = partial(relaxed, *layer), partial(REFERENCES["relaxed"], *layer)
            pairs["state_rate"] = _pair("state_rate", dq, dq_last, REST)
            curve = path.waves.at
            pairs["Curve"] = partial(curve, 0.1), partial(REFERENCES["Curve"](*curve.__reduce__()[1]), 0.1)
        for name, (one, other) in pairs.items():
            compiled[f"{name}, {kind}"], plain[f"{name}, {kind}"] = one, other
    return compiled, plain


def _pair(name: str, *arguments: Any) -> tuple[Callable[[], Any], Callable[[], Any]]:
    return partial(getattr(kernels, name), *arguments), partial(REFERENCES[name], *arguments)


def whole() -> Calls:
    """What a user calls."""
    calls: dict[str, Callable[[], Any]] = {}
    for kind, (task, path) in problems().items():
        controllers: dict[str, Controller] = {
            "step": EosController(task, path),
            "step within limits": LimitedEosController(task, path),
            "step of an impedance": ImpedanceController(task, task.hold(REST)),
        }
        for name, controller in controllers.items():
            loop = ControlLoop(controller)
            loop.step(0.0, REST, 0.0 * REST)
            calls[f"{name}, {kind}"] = partial(loop.step, 0.1, REST, 0.1 * REST)
        chart = Chart.from_base(task, REST)
        z = chart.z_bar + np.r_[0.02, 0.05, -0.08, np.zeros(task.size - 3)]
        calls[f"inverse kinematics from 0.1 m, {kind}"] = partial(chart.inverse, z, chart.v_bar)
        calls[f"continuous run of 1 s, {kind}"] = partial(simulate, task.robot, controllers["step"], REST, duration=1.0)
    return calls


def serve() -> None:
    """Time all of `whole` once for each line on stdin."""
    calls = whole()
    for _ in sys.stdin:
        print(json.dumps({name: cpu(call) for name, call in calls.items()}), flush=True)


def benchmark(
    *,
    rounds: int = 15,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    write: bool = False,
) -> int:
    """Time compiled kernels and what contains them, with and without.

    Args:
        rounds: Rounds over everything; the median counts.
        json_file: File for all figures, machine-readable.
        write: Write the ratio for a step into README.md and docs/performance.md.
    """
    if kernels is None:
        console.print("nothing is compiled here: install eos_pin where there is a C compiler", style="red")
        return 1
    tables = twins()
    workers = [
        subprocess.Popen(
            [sys.executable, __file__, "serve"],
            env=os.environ | {"EOS_PIN_COMPILED": switch},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for switch in "10"
    ]
    formulas: list[dict[str, list[float]]] = [{}, {}]
    paths: list[dict[str, list[float]]] = [{}, {}]
    for _ in track(range(rounds), description="compiled", console=stderr, transient=True):
        for calls, times in zip(tables, formulas, strict=True):
            for name, call in calls.items():
                times.setdefault(name, []).append(cpu(call, 0.003))
        for worker, times in zip(workers, paths, strict=True):
            assert worker.stdin
            assert worker.stdout
            worker.stdin.write("\n")
            worker.stdin.flush()
            for name, seconds in json.loads(worker.stdout.readline()).items():
                times.setdefault(name, []).append(seconds)
    for worker in workers:
        worker.communicate()
    found = {}
    for title, (compiled, plain) in {"Kernels": formulas, "Whole": paths}.items():
        figures = {name: (1e6 * median(compiled[name]), 1e6 * median(plain[name])) for name in compiled}
        rows = [(name, one, other, other / one) for name, (one, other) in figures.items()]
        console.print(grid(f"{title}, µs", ("what", "compiled", "plain", "ratio"), rows))
        found[title] = figures
    if json_file is not None:
        write_json(json_file, found | {"rounds": rounds})
    if write:
        steps = [plain / fast for name, (fast, plain) in found["Whole"].items() if name.startswith("step")]
        for document in compiled_text.DOCUMENTS:
            compiled_text.write(document, compiled_text.phrase(steps))
    return 0


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        serve()
    else:
        sys.exit(run(benchmark))
