"""First run: the hand of a Panda arm follows a figure eight, and its joints repeat from the first round on.

Run it by `python examples/01_first_run.py`.
"""

import numpy as np

from eos_pin import EosController, PositionTask, figure_eight, load_robot, simulate

# The arm up to the hand: seven joints, without the fingers.
robot = load_robot("panda", chain_to="panda_hand_tcp")

# Three coordinates are enough for the position of the hand, so four joints are left over for self-motion.
task = PositionTask(robot, "panda_hand_tcp")
print(f"{robot.n} joints, {task.m} task coordinates, {robot.n - task.m} of self-motion")
assert (robot.n, task.m) == (7, 3)

# A figure eight of 0.2 m by 0.1 m around the point where the hand is, one round in 4 s.
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])  # [rad]
path = figure_eight(task.value(q), (0.1, 0.1), period=4.0, plane="yz")

# Three rounds. Without another order, the controller holds the self-motion coordinates v where they are.
result = simulate(robot, EosController(task, path), q, duration=12.0)
print(f"the run {result.status} after {result.t[-1]:g} s and {result.cycles} rounds")
assert result.ok

error = np.abs(result.error[result.settled_row :]).max()
print(f"largest distance from the path after the first round: {error:.1e} m")
assert error < 1e-7

drift = result.joint_drift_per_cycle
print("largest change of a joint from round to round:", ", ".join(f"{d:.1e}" for d in drift), "rad")
assert drift.max() < 1e-6
