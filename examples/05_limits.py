"""Limits: joint positions, velocities and torques are kept, and the result tells whether the task suffered.

Run it by `python examples/05_limits.py`.
"""

import numpy as np

from eos_pin import EosController, JointLimits, LimitedEosController, PositionTask, circle, load_robot, simulate_sampled

robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
path = circle(task.value(q), 0.2, period=1.5, plane="yz")

# Limits come from the URDF; some of them may be replaced.
limits = JointLimits.from_robot(robot, velocity=1.0)  # [rad/s]

# Limits are kept from one sample to the next, so these runs are sampled at 1 kHz.
controllers = [EosController(task, path), LimitedEosController(task, path, limits=limits)]
fastest = []
for controller in controllers:
    result = simulate_sampled(robot, controller, q, duration=4.5, control_period=1e-3)
    late = slice(result.settled_row, None)
    fastest.append(np.abs(result.dq).max())
    error = np.abs(result.error[late]).max()
    print(f"{type(controller).__name__}: {result.status}, fastest joint {fastest[-1]:.4f} rad/s, error {error:.1e} m")
    # Other joints take over where one is at its limit: no part of the task is given up.
    assert result.ok
    assert result.deficit_seconds == 0.0
    assert error < 1e-3

assert fastest[0] > 1.2
assert fastest[1] < 1.0 + 1e-4
