"""Your own task: the distance of the hand from a point, z = |p(q) - c|; the arm is free in all else.

Run it by `python examples/08_own_task.py`.
"""

import tempfile
from pathlib import Path

import numpy as np

from eos_pin import EosController, Harmonic, Result, Task, load_robot, simulate


class DistanceTask(Task, kind="distance"):
    """Distance of a frame's origin from a fixed point [m]."""

    arguments = ("frame", "center")  # attributes of these names make the task again when a run is loaded

    def __init__(self, robot, frame, center):
        self.frame, self.center, self.number = frame, tuple(center), robot.frame_id(frame)
        super().__init__(robot, labels=["distance"], units=["m"])

    def offset(self, data):
        """Vector from the center to the frame, and its length."""
        offset = self.frame_placement(data, self.number).translation - self.center
        return offset, np.linalg.norm(offset)

    def compute_point(self, data):
        return np.array([self.offset(data)[1]])

    def compute_jacobian(self, data):
        offset, z = self.offset(data)
        return (offset / z @ self.frame_jacobian(data, self.number)[:3])[None]

    def compute_drift(self, data):  # the second derivative of z where the joints do not accelerate
        offset, z = self.offset(data)
        speed, a = self.frame_velocity(data, self.number).linear, self.frame_acceleration(data, self.number).linear
        return np.array([(speed @ speed + offset @ a - (offset @ speed / z) ** 2) / z])


robot = load_robot("panda", chain_to="panda_hand_tcp")
task = DistanceTask(robot, "panda_hand_tcp", [0.5, 0.0, 0.1])
q, dq, h = np.array([0.1, -0.3, 0.2, -2.0, 0.1, 1.7, 0.8]), np.linspace(-1.0, 1.0, 7), 1e-5
before, here, after = (task.at(q + step * dq, dq) for step in (-h, 0.0, h))
off = abs(here.dz - (after.z - before.z) / (2 * h))[0], abs(here.drift - (after.dz - before.dz) / (2 * h))[0]
print(f"against finite differences: velocity off by {off[0]:.0e}, drift by {off[1]:.0e}")
assert max(off) < 1e-8

breathe = Harmonic(task.value(q), np.array([[0.1]]), np.zeros((1, 1)), 2.0)
result = simulate(robot, EosController(task, breathe), q, duration=6.0)
error = np.abs(result.error[result.settled_row :]).max()
print(f"{result.status}; error {error:.1e} {result.units[0]}")
assert result.ok
assert error < 1e-6

# Defined with a kind, the task is known where a saved run is loaded.
with tempfile.TemporaryDirectory() as folder:
    loaded = Result.load(result.save(Path(folder) / "run.npz"))
print(f"loaded: {loaded.info['task']}; z from the joints is off by {loaded.residuals()['task']:.0e} m")
assert (loaded.labels, loaded.units, loaded.frame) == (("distance",), ("m",), "panda_hand_tcp")
assert loaded.residuals()["task"] < 1e-12
