"""Curves that a replay draws beside the picture: joints, errors, self-motion, torques and energies over time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin.robot.model import Robot
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Trajectory

#: Samples that the curves of a run keep, beside the largest and the smallest value of each.
SAMPLES = 1000
#: Least height of a panel: what moves less is drawn as the constant it is, not as rounding errors.
STILL = {"rad": 0.02, "m": 0.02, "": 0.02, "N m": 0.1, "N": 0.1, "J": 1e-3}
#: Errors below this are rounding.
LEAST_ERROR = 1e-12
#: Colours of runs, which people with any kind of colour vision tell apart (Okabe and Ito).
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#9a8f00")


@dataclass(frozen=True)
class Line:
    """A curve.

    Attributes:
        name: Its name, short.
        values: Values, (T,).
        reference: Values that were asked for; none where nothing was.
        limits: Least and largest value that is allowed; None where there is none.
    """

    name: str
    values: Vector
    reference: Vector | None = None
    limits: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True)
class Panel:
    """Curves in one diagram.

    Attributes:
        title: What they are.
        unit: Unit of all.
        lines: The curves.
        log: Whether the axis is logarithmic.
    """

    title: str
    unit: str
    lines: tuple[Line, ...] = field(repr=False)
    log: bool = False


def panels_of(result: Result, robot: Robot) -> list[Panel]:
    """Panels of joints, errors, self-motion, torques and energies of a run, as far as they are known."""
    panels = [*_joints(robot, result.q.T), *_errors(result)]
    if result.v.size:
        pairs = zip(result.v.T, result.v_ref.T, strict=True)
        lines = [Line(f"v{i + 1}", v, ref if np.isfinite(ref).any() else None) for i, (v, ref) in enumerate(pairs)]
        panels.append(Panel("self-motion v", " or ".join(dict.fromkeys(_units(robot))), tuple(lines)))
    panels += [*_torques(robot, result.tau.T), *_energies(result)]
    return panels


def short_names(names: Sequence[str]) -> list[str]:
    """Names without the words that all of them begin or end with."""
    if len(names) < 2:
        return list(names)
    words = [re.split(r"(?<=[_/.-])", name) for name in names]
    for end in (0, -1):
        while min(map(len, words)) > 1 and len({own[end] for own in words}) == 1:
            for own in words:
                own.pop(end)
    return ["".join(own).strip("_/.-") for own in words]


def _joints(robot: Robot, columns: Iterable[Vector]) -> Iterator[Panel]:
    """Joints by unit, each with its limits."""
    names, units = short_names([joint.name for joint in robot.joints]), _units(robot)
    lines = [
        Line(name, values, limits=(_finite(low), _finite(high)))
        for name, values, low, high in zip(names, columns, robot.lower, robot.upper, strict=True)
    ]
    for unit in dict.fromkeys(units):
        own = tuple(line for line, its in zip(lines, units, strict=True) if its == unit)
        yield Panel("joints", unit, own)


def _errors(result: Result) -> Iterator[Panel]:
    """Norms of the errors of the task by unit, and of the self-motion, on a logarithmic axis."""
    lines = []
    units = np.array(result.units or ["m or rad"] * result.error.shape[1])
    for unit in dict.fromkeys(units.tolist()):
        error = np.linalg.norm(result.error[:, units == unit], axis=1)
        if np.isfinite(error).any():
            name = {"m": "position" if result.axes else "task", "rad": "rotation"}.get(unit, "task")
            lines.append(Line(f"{name} [{unit}]", error))
    error = np.linalg.norm(result.self_motion_error, axis=1)
    if result.v.size and np.isfinite(error).any():
        lines.append(Line("self-motion", error))
    if lines:
        yield Panel("errors", "", tuple(lines), log=True)


def _torques(robot: Robot, columns: Iterable[Vector]) -> Iterator[Panel]:
    """Torques, relative to their limits where all joints have one."""
    names, units = short_names([joint.name for joint in robot.joints]), _units(robot)
    own, relative = list(columns), bool(np.isfinite(robot.effort).all())
    if not all(np.isfinite(column).any() for column in own):
        return
    kind = {"rad": "N m", "m": "N"}
    title, unit = ("torque / limit", "") if relative else ("torque", " or ".join({kind[u]: 0 for u in units}))
    lines = []
    for name, values, effort in zip(names, own, robot.effort, strict=True):
        limit = 1.0 if relative else _finite(effort)
        limits = (None if limit is None else -limit, limit)
        lines.append(Line(name, values / effort if relative else values, limits=limits))
    yield Panel(title, unit, tuple(lines))


def _energies(result: Result) -> Iterator[Panel]:
    named = (("kinetic", result.kinetic_energy), ("work since the start", result.work))
    lines = tuple(Line(name, values) for name, values in named if np.isfinite(values).any())
    if lines:
        yield Panel("energy", "J", lines)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# -- what the page is told -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LiveCurves:
    """Curves that grow while a run goes on.

    Attributes:
        panels: The panels at the start: a value for each line.
        read: Values of all lines in their order, for a time and joints.
    """

    panels: tuple[Panel, ...]
    read: Callable[[float, JointVector], Vector]


def live_curves(robot: Robot, q: JointVector, follows: tuple[Task, Trajectory] | None = None) -> LiveCurves:
    """Joints and task error of a run that goes on.

    Args:
        robot: The robot that moves.
        q: Joints at the start.
        follows: Task and path, where there are any.
    """
    kinds = list(dict.fromkeys(follows[0].units)) if follows else []

    def errors(t: float, q: JointVector) -> list[float]:
        if follows is None:
            return []
        task, reference = follows
        error = task.minus(reference(t).z, task.set_time(t).value(q))
        return [float(np.linalg.norm(error[np.array(task.units) == unit])) for unit in kinds]

    joints = tuple(_joints(robot, q[:, None]))
    own = _units(robot)
    order = [i for unit in dict.fromkeys(own) for i in range(len(own)) if own[i] == unit]
    first = zip(kinds, errors(0.0, q), strict=True)
    lines = tuple(Line(f"task [{unit}]", np.array([error])) for unit, error in first)
    panels = (*joints, Panel("errors", "", lines, log=True)) if lines else joints
    return LiveCurves(panels, lambda t, q: np.array([*q[order], *errors(t, q)]))


def _units(robot: Robot) -> list[str]:
    return ["m" if joint.kind == "prismatic" else "rad" for joint in robot.joints]


def described(runs: Mapping[str, tuple[Vector, Sequence[Panel]]]) -> dict[str, Any]:
    """Panels of runs in plain values for the page; a line has a curve for each run.

    Args:
        runs: Times of the samples and panels, by the name of the run.
    """
    panels: dict[tuple[str, str], dict[str, Any]] = {}
    kept = {name: _rows(t, own) for name, (t, own) in runs.items()}
    for k, (name, (_, own)) in enumerate(runs.items()):
        for panel in own:
            least = LEAST_ERROR if panel.log else STILL.get(panel.unit, 0.02)
            plain = {"title": panel.title, "unit": panel.unit, "log": panel.log, "least": least, "lines": {}}
            lines = panels.setdefault((panel.title, panel.unit), plain)["lines"]
            for line in panel.lines:
                into = lines.setdefault(line.name, {"name": line.name, "limits": list(line.limits), "of": []})
                curve = {"run": k, "values": _single(line.values[kept[name]])}
                if line.reference is not None:
                    curve["reference"] = _single(line.reference[kept[name]])
                into["of"].append(curve)
    return {
        "runs": [
            {"name": name, "color": COLORS[k % len(COLORS)], "times": t[kept[name]]}
            for k, (name, (t, _)) in enumerate(runs.items())
        ],
        "panels": [panel | {"lines": list(panel["lines"].values())} for panel in panels.values()],
    }


def _rows(t: Vector, panels: Sequence[Panel]) -> Array:
    """Rows that are kept: evenly spaced ones, and the extremes of every curve, so that no peak is lost."""
    rows = {int(row) for row in np.linspace(0, len(t) - 1, min(len(t), SAMPLES))}
    for line in (line for panel in panels for line in panel.lines):
        if np.isfinite(line.values).all():
            rows |= {int(line.values.argmin()), int(line.values.argmax())}
    return np.array(sorted(rows), dtype=int)


def _single(values: Vector) -> Array:
    return values.astype(np.float32)
