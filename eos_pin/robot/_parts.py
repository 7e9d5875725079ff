"""Parts of a robot: its joints, and the protocol of its geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import pinocchio as pin


@dataclass(frozen=True)
class Joint:
    """One degree of freedom.

    Attributes:
        name: Name in the URDF.
        kind: `"revolute"`, `"continuous"` (revolute without limits) or `"prismatic"`.
        lower: Lower position limit [rad or m], −inf without limit.
        upper: Upper position limit [rad or m], inf without limit.
        velocity: Velocity limit [rad/s or m/s], inf without limit.
        effort: Torque or force limit [N m or N], inf without limit.
    """

    name: str
    kind: str
    lower: float
    upper: float
    velocity: float
    effort: float


class HasShapes(Protocol):
    """Protocol of a robot's geometry, such as `eos_pin.robot.geometry.Shapes`."""

    @property
    def visual(self) -> pin.GeometryModel:
        """Visual geometry."""

    @property
    def collision(self) -> pin.GeometryModel:
        """Collision geometry."""
