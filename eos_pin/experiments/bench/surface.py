"""A surface that the tool runs into, in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin

from eos_pin._arrays import Vector
from eos_pin.robot.model import Robot
from eos_pin.simulation.mujoco import MujocoPlant
from eos_pin.trajectories.base import Trajectory

#: Radius of the tip that makes contact [m], and friction.
TIP, FRICTION = 0.01, 0.3
#: Time constant [s] and damping ratio of a contact, and MuJoCo's impedances of it. With them its stiffness is the mass
#: that it meets times 100 1/s², or 400 N/m for 4 kg: as soft as foam, so that laws can differ. Into a hard surface none
#: gets any further.
CONTACT, IMPEDANCE = (0.2, 1.0), (0.5, 0.5, 0.001, 0.5, 2.0)
#: Part of the path's half width that the surface cuts off.
CUT = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class SurfacePlant(MujocoPlant):
    """A robot whose last body has a round tip, and a plane that the tip cannot pass.

    Attributes:
        frame: Name of the tip's frame, which the last joint moves.
        point: Point of the plane, in the frame of the world [m].
        normal: Unit vector out of it, to the side where the tip is free.
    """

    frame: str = ""
    point: tuple[float, ...] = (0.0, 0.0, 0.0)
    normal: tuple[float, ...] = (0.0, 0.0, 1.0)

    def _more(self, mujoco: ModuleType, spec: Any, bodies: list[Any]) -> None:
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET
        q, contact = np.zeros(self.n), {"solref": CONTACT, "solimp": IMPEDANCE, "condim": 3}
        last = self.placement(q, self.joint_names[-1]).actInv(self.placement(q, self.frame))
        size = [TIP, 0.0, 0.0]
        sphere = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": size, "pos": last.translation, **contact}
        bodies[-1].add_geom(friction=[FRICTION, 0.0, 0.0], **sphere)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(self.normal)).coeffs()
        plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0.0, 0.0, 1.0], "quat": np.roll(turn, 1), **contact}
        place = np.array(self.point) - TIP * np.array(self.normal)
        spec.worldbody.add_geom(friction=[FRICTION, 0.0, 0.0], pos=place, **plane)


def cut_off(path: Trajectory, period: float) -> tuple[Vector, Vector]:
    """Point and normal of a plane that cuts off an end of the widest extent of a path.

    Args:
        path: Path of a point.
        period: Its period [s].
    """
    points = np.array([path(t).z for t in np.linspace(0.0, period, 200, endpoint=False)])
    middle = points.mean(axis=0)
    way = np.linalg.svd(points - middle, full_matrices=False)[2][0]
    return middle + (1.0 - CUT) * float(((points - middle) @ way).max()) * way, -way


def with_surface(robot: Robot, frame: str, point: Vector, normal: Vector) -> SurfacePlant:
    """The robot as MuJoCo moves it, with a plane in the way of its tool."""
    own = {item.name: getattr(robot, item.name) for item in fields(Robot)}
    return SurfacePlant(**own, integrator="implicitfast", frame=frame, point=tuple(point), normal=tuple(normal))
