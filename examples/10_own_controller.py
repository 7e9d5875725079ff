"""Your own controller: a spring that draws the hand along, run and recorded like the package's own controllers.

Run it by `python examples/10_own_controller.py`.
"""

import numpy as np

from eos_pin import Controller, PositionTask, TaskForce, circle, load_robot, simulate, simulate_sampled


class Spring(Controller):
    """Impedance: tau = G'ᵀ (K (z_d - z) - D dz) - d dq + gravity, which yields to a push."""

    def __init__(self, task, reference, stiffness=4000.0, damping=200.0, joint_damping=2.0):
        self.robot, self.task, self.reference = task.robot, task, reference
        self.stiffness, self.damping, self.joint_damping = stiffness, damping, joint_damping

    def torque(self, t, q, dq, state):
        """Joint torques (n,) [N m]; nothing is remembered between calls, so memory is None."""
        point, target = self.task.at(q, dq), self.reference(t)
        force = self.stiffness * (target.z - point.z) + self.damping * (target.dz - point.dz)  # [N]
        return point.J.T @ force - self.joint_damping * dq + self.robot.gravity(q)

    def describe(self):
        """Plain values, kept with the run."""
        return super().describe() | {"stiffness": self.stiffness, "damping": self.damping}


robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
controller = Spring(task, circle(task.value(q), 0.1, period=4.0, plane="yz"))

result = simulate(robot, controller, q, duration=8.0)
error = np.abs(result.error[result.settled_row :]).max()
print(f"on a circle: {result.status}, error {1e3 * error:.2f} mm, as {result.info['controller']}")
assert result.ok
assert error < 1e-3

# At rest under a push of 20 N the spring gives way by 20 N / 4000 N/m = 5 mm.
push = TaskForce(task, lambda t: [0.0, 0.0, -20.0])
result = simulate_sampled(robot, Spring(task, task.hold(q)), q, duration=4.0, task_force=push)
print(f"under a push of 20 N: off by {(1e3 * result.error[-1]).round(3)} mm")
assert np.abs(result.error[-1] - [0.0, 0.0, 0.005]).max() < 1e-5
