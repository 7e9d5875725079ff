"""Use of limits in a run: ratios to the limits of position, velocity and torque."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Vector
from eos_pin.robot.model import Robot

#: Limits of all joints in plain values: lists by name, None where a joint has no limit.
Limits: TypeAlias = Mapping[str, Any]
#: A limit counts as passed beyond this, in rad or m for positions and relative for velocities and torques.
POSITION_PASSED, RATIO_PASSED = 1e-5, 1e-3


def limits_of(robot: Robot, *, moving: bool = True) -> dict[str, Any]:
    """Limits of a robot in plain values, for the provenance of a run.

    Args:
        robot: The robot.
        moving: Whether velocities and torques are those of a motion; they have no limits otherwise.
    """
    bounds = {"lower": robot.lower, "upper": robot.upper}
    bounds |= {name: values if moving else np.full_like(values, np.inf) for name, values in _rates(robot).items()}
    return {
        "joints": [joint.name for joint in robot.joints],
        "units": ["m" if joint.kind == "prismatic" else "rad" for joint in robot.joints],
    } | {name: [x if math.isfinite(x) else None for x in values.tolist()] for name, values in bounds.items()}


def _rates(robot: Robot) -> dict[str, Vector]:
    return {"velocity": robot.velocity, "torque": robot.effort}


def use_of_limits(
    limits: Limits, q: Float[Array, "T n"], dq: Float[Array, "T n"], tau: Float[Array, "T n"]
) -> dict[str, Any]:
    """Largest ratios to the limits in the samples of a run; 1 is at the limit.

    The ratio of a position is its distance from the middle of the range relative to half of the range. Of a joint that
    has one limit only, or a range of 0, it is 1 and the distance beyond the limit [rad or m] where it is passed.

    Args:
        limits: Result of `limits_of`; empty where nothing is known.
        q: Joints [rad or m].
        dq: Joint velocities [rad/s or m/s].
        tau: Joint torques [N m or N].

    Returns:
        For `"position"`, `"velocity"` and `"torque"` the worst `ratio` with its `joint`, and `per_joint`, the ratio of
        each joint by name, NaN where it has no limit; for `"position"` also `beyond`, the largest distance beyond a
        limit [rad or m], and its `unit`. `"worst"` is the largest ratio of all, `"passed"` is whether any limit was
        passed, and `"message"` is all this in words.
    """
    if not limits or not len(q):
        return {"worst": math.nan, "passed": False, "message": ""}
    lower, upper = (np.array(limits[name], dtype=float) for name in ("lower", "upper"))
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    beyond = np.fmax.reduce(np.fmax(np.fmax(lower - q, q - upper), 0.0), axis=0)
    ratios = {"position": np.fmax.reduce(np.abs(q - middle), axis=0) / np.where(half > 0.0, half, np.nan)}
    ratios["position"] = np.where(np.isnan(ratios["position"]) & (beyond > 0.0), 1.0 + beyond, ratios["position"])
    for name, values in (("velocity", dq), ("torque", tau)):
        bound = np.array(limits[name], dtype=float)
        ratios[name] = np.fmax.reduce(np.abs(values), axis=0) / np.where(bound > 0.0, bound, np.nan)
    joints = limits["joints"]
    found: dict[str, Any] = {name: _worst(values, joints) for name, values in ratios.items()}
    worst = int(np.argmax(beyond))
    found["position"] |= {"beyond": float(beyond[worst]), "unit": limits["units"][worst]}
    words = {"position": f"by {beyond[worst]:.3g} {limits['units'][worst]} ({joints[worst]})"}
    words |= {name: f"{found[name]['ratio']:.3g} times ({found[name]['joint']})" for name in ("velocity", "torque")}
    over = {"position": beyond[worst] > POSITION_PASSED}
    over |= {name: found[name]["ratio"] > 1.0 + RATIO_PASSED for name in ("velocity", "torque")}
    passed = ", ".join(f"{name} {words[name]}" for name in ratios if over[name])
    kept = ", ".join(f"{name} {found[name]['ratio']:.0%}" for name in ratios if not math.isnan(found[name]["ratio"]))
    message = f"passed: {passed}" if passed else f"kept: {kept}" if kept else "the robot has none"
    return found | {
        "worst": float(np.fmax.reduce([found[name]["ratio"] for name in ratios])),
        "passed": bool(passed),
        "message": message,
    }


def _worst(values: Vector, joints: list[str]) -> dict[str, Any]:
    """Largest ratio and its joint, and all by name."""
    known = not np.isnan(values).all()
    worst = int(np.nanargmax(values)) if known else 0
    return {
        "ratio": float(values[worst]),
        "joint": joints[worst] if known else "",
        "per_joint": dict(zip(joints, values.tolist(), strict=True)),
    }
