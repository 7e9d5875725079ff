"""Charts: the joints as an explicit function y(z, v) of the task point z and the self-motion coordinates v.

Run it by `python examples/03_charts.py`.
"""

import numpy as np

from eos_pin import (
    Atlas,
    Chart,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    circle,
    inverse_kinematics,
    load_robot,
)

robot = load_robot("panda", chain_to="panda_hand_tcp")
task = PositionTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])

# A chart is based at a configuration; there v is zero.
chart = Chart.from_base(task, q)
print(f"v has {chart.r} coordinates; at the base they are {chart.v(q)}")
assert not chart.v(q).any()

# Exact inverse kinematics: any task point and any v nearby give joints, and the joints give them back.
z, v = task.value(q) + np.array([0.05, -0.1, 0.02]), np.array([0.3, 0.0, -0.2, 0.1])
found = chart.inverse(z, v)
back = np.abs(task.value(found.q) - z).max(), np.abs(chart.v(found.q) - v).max()
print(f"joints {found.q.round(3)} after {found.iterations} Newton steps, off by {back[0]:.1e} m and {back[1]:.1e} in v")
assert max(back) < 1e-9

# Along a path the atlas makes a new chart where the one in use ends. With v held, the joints close with the path.
path = circle(task.value(q), 0.2, period=1.0, plane="yz")
joints = Atlas(task).follow(q, [path(t).z for t in np.linspace(0.0, 1.0, 101)])
gap = np.abs(joints.q[-1] - joints.q[0]).max()
print(f"{len(joints.q)} points on {len(joints.charts)} charts; the joints close to {gap:.1e} rad")
assert joints.complete
assert gap < 1e-9

# Any point within reach, near or far: by continuation through charts, or by a search.
far = Atlas(task).solve(q, [-0.4, 0.3, 0.5])
print(f"a point behind the robot: by {far.strategy}, error {far.residual:.1e} m, within limits: {far.within_limits}")
assert far.found
assert far.within_limits

# Poses are pin.SE3 or 4 x 4 matrices. Here the hand goes round the same circle with its orientation kept.
pose, start = PoseTask(robot, "panda_hand_tcp"), robot.placement(q, "panda_hand_tcp")
path = PoseTrajectory(position=path, orientation=start.rotation)
joints = Atlas(pose).follow(q, [path(t).z for t in np.linspace(0.0, 1.0, 101)])
print(f"with its orientation kept: the joints close to {np.abs(joints.q[-1] - joints.q[0]).max():.1e} rad")
assert joints.complete
assert inverse_kinematics(pose, start, q + 0.3).found
