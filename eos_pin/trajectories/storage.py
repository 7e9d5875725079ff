"""Task paths as plain values, for files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from eos_pin.errors import InputError, ResultError
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Hold, Trajectory
from eos_pin.trajectories.harmonic import Harmonic
from eos_pin.trajectories.spline import Geodesic, RotationSpline, Spline
from eos_pin.trajectories.stacked import StackedTrajectory
from eos_pin.trajectories.through import WaypointPath
from eos_pin.trajectories.timed import Pace, TimedPath
from eos_pin.trajectories.tolerated import ToleratedPath

#: What a pace consists of.
NODES = ("times", "places", "speeds", "accelerations")


def described(path: Trajectory) -> dict[str, Any]:
    """Plain values from which `path_from` makes the same path.

    Raises:
        InputError: The path is a function of a kind that is not known here.
    """
    if isinstance(path, WaypointPath):
        return {"kind": "waypoints"} | path.describe()
    if isinstance(path, TimedPath):
        nodes = {name: getattr(path.pace, name).tolist() for name in NODES}
        return {"kind": "timed", "path": described(path.path)} | nodes
    if isinstance(path, Harmonic):
        values = {name: np.asarray(getattr(path, name)).tolist() for name in ("center", "sines", "cosines")}
        return {"kind": "harmonic", "period": path.period, "phase": path.phase} | values
    if isinstance(path, Hold):
        return {"kind": "hold", "z": path.z.tolist(), "m": path.m}
    if isinstance(path, StackedTrajectory):
        return {"kind": "stacked", "parts": [described(part) for part in path.parts]}
    if isinstance(path, ToleratedPath):
        return {"kind": "tolerated", "path": described(path.path)}
    if isinstance(path, Geodesic):
        points, times = np.asarray(path.points).tolist(), path.times.tolist()
        return {"kind": "geodesic", "points": points, "times": times, "closed": path.closed}
    if isinstance(path, (Spline, RotationSpline)):
        from scipy.interpolate import BSpline, PPoly

        curve = PPoly.from_spline(path.curve) if isinstance(path.curve, BSpline) else path.curve
        values = {"c": np.asarray(curve.c).tolist(), "x": np.asarray(curve.x).tolist()}
        kind = "spline" if isinstance(path, Spline) else "rotation_spline"
        return {"kind": kind, "start": path.start, "end": path.end, "closed": path.closed} | values
    raise InputError(
        f"a plan along a {type(path).__name__} cannot be saved: only paths of way points, circles and other sums of "
        "sines, splines and geodesics can be made anew from a file"
    )


def path_from(task: Task, description: Mapping[str, Any]) -> Trajectory:
    """Path that `described` described.

    Raises:
        ResultError: The description is not of a path of this version.
    """
    words = dict(description)
    kind = words.pop("kind", None)
    try:
        if kind == "waypoints":
            return WaypointPath(task, np.array(words["points"]), np.array(words["times"]), words["closed"])
        if kind == "timed":
            return TimedPath(path_from(task, words["path"]), Pace(*(np.array(words[name]) for name in NODES)))
        if kind == "harmonic":
            arrays = {name: np.array(words.pop(name)) for name in ("center", "sines", "cosines")}
            return Harmonic(period=words["period"], phase=words["phase"], **arrays)
        if kind == "hold":
            return Hold(np.array(words["z"]), words["m"])
        if kind == "stacked":
            return StackedTrajectory(tuple(path_from(task, part) for part in words["parts"]))
        if kind == "tolerated" and task.whole is not task:
            return ToleratedPath(task, path_from(task.whole, words["path"]))
        if kind == "geodesic":
            closed = words.get("closed", False)
            return Geodesic(task, np.array(words["points"]), np.array(words["times"]), closed)
        if kind in ("spline", "rotation_spline"):
            from scipy.interpolate import PPoly

            curve = PPoly(np.array(words["c"]), np.array(words["x"]))
            made = Spline if kind == "spline" else RotationSpline
            return made(curve, words["start"], words["end"], words["closed"])
    except (KeyError, TypeError, ValueError) as error:
        raise ResultError(f"the path of a plan is not described in full: {error}") from error
    raise ResultError(f"the kind {kind!r} of a plan's path is not known to this version")
