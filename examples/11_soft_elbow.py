"""A soft arm: stiffness of the tool in N/m, another of the elbow, a push, and hand guiding.

Run it by `python examples/11_soft_elbow.py`.
"""

import numpy as np

from eos_pin import (
    ControlLoop,
    ImpedanceController,
    PoseTask,
    PositionTask,
    TaskForce,
    load_robot,
    simulate_sampled,
)

robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PoseTask(robot, "panda_hand_tcp")  # six coordinates, so one is left over: the elbow
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])

stiff = {"m": 2000.0, "rad": 100.0}  # [N/m], [N m/rad]
controller = ImpedanceController(task, task.hold(q), stiffness=stiff, self_motion_stiffness=20.0)

# A push of 10 N at the tool: it gives way by 10 N / 2000 N/m, and the elbow keeps its coordinate.
push = TaskForce(task, lambda t: [0.0, 0.0, -10.0, 0.0, 0.0, 0.0])
result = simulate_sampled(robot, controller, q, duration=3.0, task_force=push)
moved = -result.error[-1][2]
print(f"pushed at the tool: {1e3 * moved:.3f} mm, elbow {result.v[-1][0]:.1e} rad")
assert abs(moved + 0.005) < 1e-6
assert abs(result.v[-1][0]) < 1e-6

# A push of 15 N at the elbow: the tool feels its share of it, unless external forces are observed and compensated.
push = TaskForce(PositionTask(robot, "panda_link4"), lambda t: [0.0, 15.0, 0.0])
for held in (controller, controller.with_mode(observer=50.0, compensate_external=True)):
    result = simulate_sampled(robot, held, q, duration=4.0, task_force=push)
    moved = np.linalg.norm(result.error[-1][:3])
    print(f"pushed at the elbow: tool {1e3 * moved:.3f} mm, elbow {result.v[-1][0]:.3f} rad")
    assert result.ok
assert moved < 1e-4  # the last one compensates

# Modes change while a loop runs, without a jump of the torque: here somebody leads the elbow by hand.
loop, dq, before = ControlLoop(controller), np.zeros(7), None
for k in range(2000):
    if k == 500:
        loop.controller = controller.led("elbow")
    if k == 1500:
        loop.controller = controller.with_mode(posture="here")
    tau = loop.step(1e-3 * k, q, dq)
    assert before is None or np.abs(tau - before).max() < 1.0
    before = tau
    hand = push.torque(0.0, q) if 700 < k < 1200 else 0.0
    dq = dq + 1e-3 * robot.forward_dynamics(q, dq, tau + hand)
    q = q + 1e-3 * dq
energies = loop.controller.energies(2.0, q, dq, loop.state)
print(f"led by hand to v = {loop.state.chart.v(q)[0]:.3f} rad, where it stays; {energies.tank:.2f} J in the tank")
assert abs(loop.state.chart.v(q)[0]) > 0.1
assert np.abs(dq).max() < 0.05
