"""A control loop of your own: joint positions and velocities in, torques out, once a period.

Run it by `python examples/06_control_loop.py`.
"""

import numpy as np

from eos_pin import ControlLoop, EosController, PositionTask, StateError, circle, load_robot

PERIOD = 1e-3  # [s]


class Driver:
    """The place of your robot's driver: reads sensors and takes torques. Here it is a simulation."""

    def __init__(self, q):
        self.robot, self.q, self.dq = load_robot("panda", chain_to="panda_hand_tcp"), np.array(q), np.zeros(7)

    def read(self):
        """Joint positions [rad] and velocities [rad/s]."""
        return self.q.copy(), self.dq.copy()

    def write(self, tau):
        """Hold the torques [N m] for one period."""
        ddq = self.robot.forward_dynamics(self.q, self.dq, tau)
        self.q, self.dq = self.q + PERIOD * self.dq + 0.5 * PERIOD**2 * ddq, self.dq + PERIOD * ddq


robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
driver = Driver([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
path = circle(task.value(driver.q), 0.1, period=4.0, plane="yz")
loop = ControlLoop(EosController(task, path))  # torques are cut at the limits of the URDF

for k in range(4000):
    q, dq = driver.read()
    driver.write(loop.step(k * PERIOD, q, dq))

error = np.abs(task.value(driver.q) - path(4.0).z).max()
print(f"after 4 s the hand is {1e3 * error:.3f} mm from its target; torque cut in the last step: {loop.saturated}")
assert error < 1e-3

# A state that cannot be is refused; nothing changes, and the next good state goes on.
try:
    loop.step(4.0, np.full(7, np.nan), np.zeros(7))
except StateError as refusal:
    print(f"refused: {refusal}")
tau = loop.step(4.001, *driver.read())
assert np.isfinite(tau).all()
