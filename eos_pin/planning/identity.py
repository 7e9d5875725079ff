"""The identity of a robot: hashes of all that a plan depends on."""

from __future__ import annotations

import hashlib

from eos_pin.robot.model import Robot


def identity(robot: Robot) -> dict[str, str]:
    """Hashes of a plan's dependencies: joints and their placement, limits, frames (tools), masses (payloads)."""
    model, own = robot.model, robot.coordinates
    frames = [(f.name, f.parentJoint, f.placement.homogeneous.round(12).tolist()) for f in model.frames]
    kinematics: list[object] = [
        (
            model.names[i],
            model.joints[i].shortname(),
            int(model.parents[i]),
            model.jointPlacements[i].homogeneous.round(12).tolist(),
        )
        for i in range(1, model.njoints)
    ]
    if own.coupled:
        kinematics += [own.column.tolist(), own.factor.tolist(), own.offset.tolist()]
    masses = [model.inertias[i].toDynamicParameters().round(9).tolist() for i in range(1, model.njoints)]
    parts = {
        "joints": kinematics,
        "masses or payloads": masses,
        "limits": [robot.lower.round(12).tolist(), robot.upper.round(12).tolist()],
        "frames or tools": frames,
    }
    return {what: hashlib.sha256(repr(value).encode()).hexdigest()[:16] for what, value in parts.items()}
