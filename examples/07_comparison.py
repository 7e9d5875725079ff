"""Comparison: under traditional task-space control the joints drift from round to round, under EOS control they repeat.

Run it by `python examples/07_comparison.py`.
"""

import numpy as np

from eos_pin import (
    DampedNullSpace,
    EosController,
    OperationalSpaceController,
    PositionTask,
    PostureNullSpace,
    circle,
    load_robot,
    simulate,
)

robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
path = circle(task.value(q), 0.1, period=4.0, plane="yz")

controllers = {
    "task-space control, damped null space": OperationalSpaceController(task, path, DampedNullSpace()),
    "task-space control, posture in the null space": OperationalSpaceController(task, path, PostureNullSpace(q)),
    "EOS control": EosController(task, path),
}
drift = {}
for name, controller in controllers.items():
    result = simulate(robot, controller, q, duration=8.0)
    assert result.ok
    drift[name] = result.joint_drift_per_cycle
    print(f"{name}: change of a joint in each round", ", ".join(f"{d:.1e}" for d in drift[name]), "rad")

damped, posture, eos = drift.values()
assert damped.min() > 1e-3  # never repeats
assert posture[0] > 1e-3 > 1e-5 > posture[-1]  # repeats once the first round is over
assert eos.max() < 1e-6  # repeats from the first round on
