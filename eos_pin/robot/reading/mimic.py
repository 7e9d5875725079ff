"""Mimic joints: joints that follow another one, with their limits carried over to it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from eos_pin.errors import RobotError
from eos_pin.robot.reading.checking import UrdfJoint


class Follower(NamedTuple):
    """A joint's position as a function of another one's: factor times that plus offset.

    Attributes:
        leader: Name of the other joint, which follows none.
        factor: How many times as far it moves.
        offset: Its position where the leader's is 0 [rad or m].
    """

    leader: str
    factor: float
    offset: float


def follower(joints: Mapping[str, UrdfJoint], name: str) -> Follower:
    """Joint that one follows in the end, as leaders may follow others themselves.

    Raises:
        RobotError: A leader does not exist or has other than one degree of freedom, or joints follow each other.
    """
    joint, factor, offset = joints[name], 1.0, 0.0
    seen = [name]
    while joint.mimics:
        leader = joints.get(joint.mimics)
        where = f"line {joint.line}: joint {joint.name!r} mimics {joint.mimics!r}"
        if leader is None:
            raise RobotError(f"{where}, which is no joint of this file")
        if leader.name in seen:
            raise RobotError(
                f"{where}, which follows it in a circle; drop one of their <mimic>: {' -> '.join([*seen, leader.name])}"
            )
        if not (leader.has_one_degree or leader.kind == "fixed"):
            raise RobotError(f"{where}, which is {leader.kind}; a joint can follow one with one degree of freedom only")
        offset += factor * joint.offset
        factor *= joint.multiplier
        joint = leader
        seen.append(leader.name)
    return Follower(joint.name, factor, offset)


def followers_in(joints: Mapping[str, UrdfJoint], names: Collection[str]) -> dict[str, Follower]:
    """Those of some joints that follow another one."""
    return {name: follower(joints, name) for name in names if joints[name].mimics}


def limits_with(joint: UrdfJoint, others: Sequence[tuple[UrdfJoint, Follower]]) -> dict[str, float]:
    """Limits of a joint that keep those of the joints that follow it as well; effort is its own.

    Args:
        joint: The joint.
        others: Joints that follow one, with how they do.

    Raises:
        RobotError: Nothing is left between the limits.
    """
    lower, upper = _range(joint)
    velocity = joint.velocity
    for other, (leader, factor, offset) in others:
        if leader != joint.name or factor == 0.0:
            continue
        ends = sorted((end - offset) / factor for end in _range(other))
        lower, upper = max(lower, ends[0]), min(upper, ends[1])
        if other.velocity:
            # 0 stands for none.
            velocity = min(velocity or math.inf, other.velocity / abs(factor))
        if not lower < upper:
            raise RobotError(
                f"line {other.line}: joint {other.name!r} follows {joint.name!r}, and their limits leave no room"
            )
    return {"lower": lower, "upper": upper, "effort": joint.effort, "velocity": velocity}


def _range(joint: UrdfJoint) -> tuple[float, float]:
    return (-math.inf, math.inf) if joint.unlimited else (joint.lower, joint.upper)
