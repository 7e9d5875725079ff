"""Joints with less torque than gravity needs, found before they move."""

from __future__ import annotations

import numpy as np

from eos_pin._arrays import JointVector, checked
from eos_pin.errors import RobotError
from eos_pin.robot.model import Robot


def most_gravity(robot: Robot) -> JointVector:
    """Largest gravity torques in postures drawn at random from within the position limits, (n,) [N m or N]."""
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    random = np.random.default_rng(0)
    return np.abs([robot._gravity(lower + (upper - lower) * random.random(robot.n)) for _ in range(200)]).max(axis=0)


def keeping_order(robot: Robot, torque: JointVector) -> tuple[int, ...]:
    """Joints in the order in which limits are kept where not all can be: most torque for gravity first.

    Joints with more than ten times what gravity takes are alike, and alike joints come from the base outwards.

    Args:
        robot: The robot.
        torque: Torque limits, (n,) [N m or N].
    """
    ratio = np.minimum(torque / np.maximum(most_gravity(robot), 1e-9), 10.0)
    return tuple(int(j) for j in np.argsort(-ratio, kind="stable"))


@checked
def gravity_overload(robot: Robot, q: JointVector | None = None, torque: JointVector | None = None) -> tuple[str, ...]:
    """Joints that cannot hold themselves against gravity, one sentence each; none if all can.

    Args:
        robot: The robot.
        q: Posture at the start; by default only postures drawn at random from within the position limits are tried.
        torque: Torque limits, (n,) [N m or N]; by default the robot's own.
    """
    most = robot.effort if torque is None else torque
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    try:
        robot._gravity(0.5 * (lower + upper))
    except RobotError:
        # Without inertia gravity is not known.
        return ()
    tried = most_gravity(robot)
    now = np.zeros(robot.n) if q is None else np.abs(robot._gravity(q))
    notes = []
    for joint, start, anywhere, limit in zip(robot.joints, now, tried, most, strict=True):
        unit = "N" if joint.kind == "prismatic" else "N m"
        if start > limit:
            notes.append(
                f"gravity takes {start:.3g} {unit} from joint {joint.name!r} at the start, and its limit is "
                f"{limit:.3g} {unit}: it will fall"
            )
        elif anywhere > limit:
            notes.append(
                f"gravity takes up to {anywhere:.3g} {unit} from joint {joint.name!r} in postures within the position "
                f"limits, and its limit is {limit:.3g} {unit}: there it will fall"
            )
    return tuple(notes)
