"""Balls that points of a robot never leave while the joints are within limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Vector
from eos_pin.robot.model import Robot


class Ball(NamedTuple):
    """A ball that some coordinates of a task never leave.

    Attributes:
        rows: Which coordinates of z.
        center: Its centre in these coordinates [m].
        radius: Its radius [m]; infinite where a slider has no limits.
    """

    rows: slice
    center: Vector
    radius: float


def frame_ball(robot: Robot, frame: str, axes: str = "xyz") -> Ball:
    """Ball of a frame's origin about the base of its chain; along some axes only, it counts in these.

    The radius is the length from joint to joint with all travel of sliders.
    """
    end = robot.model.frames[robot.frame_id(frame)]
    center, radius = _chain(robot, end.parentJoint)
    rows = ["xyz".index(axis) for axis in axes]
    return Ball(slice(0, len(rows)), center[rows], radius + float(np.linalg.norm(end.placement.translation)))


def com_ball(robot: Robot, axes: str = "xyz") -> Ball:
    """Ball of the centre of mass, which is a mean of those of the bodies, about the origin."""
    radius = 0.0
    for joint, body in enumerate(robot.model.inertias):
        if joint and body.mass > 0.0:
            center, length = _chain(robot, joint)
            radius = max(radius, float(np.linalg.norm(center)) + length + float(np.linalg.norm(body.lever)))
    return Ball(slice(0, len(axes)), np.zeros(len(axes)), radius)


def _chain(robot: Robot, joint: int) -> tuple[Vector, float]:
    """Place of the first joint on the way to a joint, and the length of the rest of the way [m]."""
    model: pin.Model = robot.model
    way = [i for i in model.supports[joint] if i]
    if not way:
        return np.zeros(3), 0.0
    center = model.jointPlacements[way[0]].translation.copy()
    length = sum(float(np.linalg.norm(model.jointPlacements[i].translation)) for i in way[1:])
    own = robot.coordinates
    travel = [
        max(abs(own.factor[i] * end[own.column[i]] + own.offset[i]) for end in (robot.lower, robot.upper))
        for i in way
        if own.slides[i]
    ]
    return center, length + float(sum(travel))
