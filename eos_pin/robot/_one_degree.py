"""Pinocchio models whose joints all have one coordinate: continuous and planar joints are replaced."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eos_pin.errors import RobotError

#: Limits from here on count as none, as in `Robot.lower`.
NONE = np.finfo(float).max
#: What Pinocchio has for every velocity, and a copy of a model must have as well.
OF_VELOCITIES = ("effortLimit", "velocityLimit", "armature", "damping", "friction", "rotorInertia", "rotorGearRatio")


class _Part(NamedTuple):
    """A joint with one coordinate, its limits, and the velocity in the old model that it takes over."""

    name: str
    joint: pin.JointModel
    lower: float
    upper: float
    velocity: int


def one_degree_model(model: pin.Model) -> pin.Model:
    """Copy of a model in which continuous joints are revolute without limits, and planar ones are three joints.

    Args:
        model: A model; a joint with a sine and a cosine as coordinates counts as continuous. A planar joint `base`
            becomes `base_x`, `base_y` and `base_heading`.

    Raises:
        RobotError: A joint is of another kind, such as a floating base.
    """
    if all((joint.nq, joint.nv) in ((1, 1), (0, 0)) for joint in list(model.joints)[1:]):
        return model.copy()
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    ids, taken = [0], []
    for i in range(1, model.njoints):
        parent, placement = ids[model.parents[i]], model.jointPlacements[i]
        for part in _parts(model, i):
            parent = new.addJoint(parent, part.joint, placement, part.name)
            placement = pin.SE3.Identity()
            taken.append(part)
        ids.append(parent)
        new.appendBodyToJoint(parent, model.inertias[i], pin.SE3.Identity())
    new.lowerPositionLimit = np.array([part.lower for part in taken])
    new.upperPositionLimit = np.array([part.upper for part in taken])
    for name in OF_VELOCITIES:
        setattr(new, name, np.array([getattr(model, name)[part.velocity] for part in taken]))
    for frame in list(model.frames)[1:]:
        copied = pin.Frame(frame.name, ids[frame.parentJoint], frame.parentFrame, frame.placement, frame.type)
        # The inertia of the frame is in that of its joint already.
        new.addFrame(copied, False)
    return new


def _parts(model: pin.Model, i: int) -> list[_Part]:
    """Joints with one coordinate that move like joint i of the model."""
    joint, name = model.joints[i], model.names[i]
    kind = joint.shortname()
    if (joint.nq, joint.nv) == (1, 1):
        lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        return [_Part(name, joint, lower, upper, joint.idx_v)]
    if (joint.nq, joint.nv) == (2, 1):
        data = joint.createData()
        joint.calc(data, pin.neutral(model))
        axis = np.asarray(data.S).reshape(6)[3:]
        return [_Part(name, pin.JointModelRevoluteUnaligned(axis), -NONE, NONE, joint.idx_v)]
    if kind == "JointModelPlanar":
        models = (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ())
        ends = zip(("x", "y", "heading"), models, strict=True)
        return [_Part(f"{name}_{end}", part, -NONE, NONE, joint.idx_v + k) for k, (end, part) in enumerate(ends)]
    advice = "load the chain that it carries without it, or lock it by pinocchio.buildReducedModel"
    raise RobotError(
        f"joint {name!r} ({kind}) of the model has nq = {joint.nq}, nv = {joint.nv}; eos_pin controls revolute, "
        f"continuous, prismatic and planar joints: {advice}"
    )
