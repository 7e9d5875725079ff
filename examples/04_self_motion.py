"""Self-motion to order: the elbow swings to and fro while the hand draws its circle undisturbed.

Run it by `python examples/04_self_motion.py`.
"""

import numpy as np

from eos_pin import EosController, PositionTask, Track, circle, line, load_robot, simulate

robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
path = circle(task.value(q), 0.1, period=4.0, plane="yz")

# Two trajectories, one for each part of the motion: z_d(t) for the hand, v_d(t) for the self-motion.
swing = line(np.zeros(4), [0.4, 0.0, 0.0, 0.0], period=2.0)
result = simulate(robot, EosController(task, path, Track(swing)), q, duration=12.0)
assert result.ok

late = slice(result.settled_row, None)
print(f"v1 moves between {result.v[late, 0].min():.3f} and {result.v[late, 0].max():.3f}")
assert np.abs(np.abs(result.v[late, 0]).max() - 0.4) < 1e-3

error, error_v = np.abs(result.error[late]).max(), np.abs(result.self_motion_error[late]).max()
print(f"error of the hand {error:.1e} m, of the self-motion {error_v:.1e}")
assert max(error, error_v) < 1e-6

# Both errors die out at the rate of the gains, whatever the other does. Here the self-motion starts 0.4 off its target.
elbow = Track([0.4, 0.0, 0.0, 0.0], kp=25.0, kd=10.0)
result = simulate(robot, EosController(task, path, elbow), q, duration=4.0)
t, off = result.t, result.self_motion_error[:, 0]
expected = 0.4 * (1.0 + 5.0 * t) * np.exp(-5.0 * t)  # critically damped
print(f"v1 approaches its target as designed, to {np.abs(off - expected).max():.1e}")
assert np.abs(off - expected).max() < 1e-6
