"""Your own objective: self-motion that takes the joints away from their limits while the hand follows its path.

Run it by `python examples/09_own_objective.py`.
"""

import numpy as np

from eos_pin import EosController, Objective, PositionTask, circle, load_robot, simulate


class Center(Objective):
    """Draw each joint towards the middle of its range, the harder the narrower the range, and damp v."""

    def __init__(self, robot, kp=60.0, kd=15.0):
        self.middle, self.range = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
        self.kp, self.kd = kp, kd

    def acceleration(self, t, q, dq, chart):
        """Self-motion acceleration F_v, (r,); the chart turns joint accelerations into those of v."""
        return chart.dv(self.kp * (self.middle - q) / self.range**2 - self.kd * dq)


robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 0.6, 2.4])  # joints 6 and 7 begin near their limits
path = circle(task.value(q), 0.1, period=4.0, plane="yz")

room = {}
for name, objective in {"v held": None, "Center": Center(robot)}.items():
    result = simulate(robot, EosController(task, path, objective), q, duration=12.0)
    assert result.ok
    late = slice(result.settled_row, None)
    room[name] = np.minimum(result.q - robot.lower, robot.upper - result.q)[late].min()
    error = np.abs(result.error[late]).max()
    print(f"{name}: at least {room[name]:.2f} rad from every limit, error of the hand {error:.1e} m")
    assert error < 1e-6

assert room["Center"] > room["v held"] + 0.2
