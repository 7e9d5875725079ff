"""The solids of a plan's scene in the form that the viewer draws."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from eos_pin.planning.obstacles.bodies import hull
from eos_pin.planning.obstacles.clearance import Obstacle
from eos_pin.planning.obstacles.scene import Scene, rotation


def obstacles_of(solids: Scene | None) -> list[Obstacle]:
    """Scene as the viewer has them; meshes as the hulls they count as."""
    if solids is None:
        return []
    made = [
        Obstacle(coal.Box(*np.asarray(box.size)), pin.SE3(rotation(box), np.asarray(box.centre)), box.name)
        for box in solids.boxes
    ]
    for capsule in solids.capsules:
        start, end = np.asarray(capsule.start), np.asarray(capsule.end)
        length = float(np.linalg.norm(end - start))
        if not length:
            made.append(Obstacle(coal.Sphere(capsule.radius), start, capsule.name))
            continue
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).toRotationMatrix()
        made.append(Obstacle(coal.Capsule(capsule.radius, length), pin.SE3(turn, 0.5 * (start + end)), capsule.name))
    made += [Obstacle(hull(np.asarray(mesh.vertices)), pin.SE3.Identity(), mesh.name) for mesh in solids.meshes]
    return made
