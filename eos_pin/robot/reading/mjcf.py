"""Robots from MJCF files: Pinocchio reads them, and joints are locked in its model."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from eos_pin.errors import RobotError, UnknownNameError
from eos_pin.robot._one_degree import one_degree_model
from eos_pin.robot._parts import find_frame, locked_at
from eos_pin.robot.geometry import quiet

#: So much of a file is looked at to tell its format [bytes].
BEGINNING = 4096
#: Note of every robot that comes from such a file.
NO_SHAPES = "shapes of MJCF files are not read; the robot is drawn by its joints"


def is_mjcf(path: Path) -> bool:
    """Whether a file is XML whose root is <mujoco>."""
    try:
        with path.open("rb") as file:
            beginning = file.read(BEGINNING)
    except OSError:
        return False
    return b"<mujoco" in beginning and b"<robot" not in beginning


def read_mjcf(path: Path) -> tuple[pin.Model, str]:
    """Model of an MJCF file, its joints with one coordinate each; and the hash of the file.

    Raises:
        RobotError: It cannot be read, or a joint cannot be controlled.
    """
    with quiet() as said:
        try:
            model = pin.buildModelFromMJCF(str(path))
        except (ValueError, RuntimeError, IndexError) as error:
            model, reason = None, error
    if model is None:
        raise RobotError(f"{path}: Pinocchio cannot read this MJCF file: {reason} {said[0]}".rstrip()) from reason
    return one_degree_model(model), hashlib.sha256(path.read_bytes()).hexdigest()


def locked_model(model: pin.Model, lock: Mapping[str, float | None], chain_to: str) -> pin.Model:
    """Model without joints that are held: those of `lock`, and those that are not on the way to a frame.

    Raises:
        UnknownNameError: There is no such joint or frame.
        InputError: A position is no number, or beyond the joint's limits.
    """
    joints = list(model.names)[1:]
    for name in lock:
        if name not in joints:
            raise UnknownNameError("joint that moves", name, joints)
    held = {model.getJointId(name): position for name, position in lock.items()}
    if chain_to:
        way = set(model.supports[model.frames[find_frame(model, chain_to)].parentJoint])
        held |= {i: held.get(i) for i in range(1, model.njoints) if i not in way}
    q = np.clip(np.zeros(model.nq), model.lowerPositionLimit, model.upperPositionLimit)
    for i, position in held.items():
        if position is not None:
            k = model.joints[i].idx_q
            q[k] = locked_at(model.names[i], position, model.lowerPositionLimit[k], model.upperPositionLimit[k])
    return pin.buildReducedModel(model, sorted(held), q) if held else model
