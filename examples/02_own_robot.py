"""Your own robot: a URDF is all that is needed.

Run it by `python examples/02_own_robot.py`.
"""

import tempfile
from pathlib import Path

import numpy as np

from eos_pin import EosController, PositionTask, circle, load_robot, simulate

# A planar arm of four equal links that turn about z. A file of your own has meshes and more; no more than this is used.
LINK = """
  <link name="link{i}">
    <inertial><origin xyz="0.15 0 0"/><mass value="1"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.008" iyz="0" izz="0.008"/></inertial>
  </link>
  <joint name="joint{i}" type="revolute">
    <parent link="{parent}"/><child link="link{i}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="3" effort="40"/>
  </joint>"""
links = [LINK.format(i=i, parent=f"link{i - 1}" if i > 1 else "base", x=0.3 if i > 1 else 0.0) for i in range(1, 5)]
tip = """<link name="tip"/>
  <joint name="end" type="fixed"><parent link="link4"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>"""

with tempfile.TemporaryDirectory() as folder:
    urdf = Path(folder) / "arm.urdf"
    urdf.write_text(f'<robot name="arm"><link name="base"/>{"".join(links)}{tip}</robot>')
    robot = load_robot(urdf)

print(f"{robot.name}: {[joint.name for joint in robot.joints]}, reach {robot.reach:.2f} m")
assert robot.n == 4

# All joints turn about z, so the task is the position in the plane; two joints are left over.
task = PositionTask(robot, "tip", axes="xy")
q = np.array([0.6, -0.9, 0.8, 0.7])
path = circle(task.value(q), 0.15, period=3.0, plane="xy")
result = simulate(robot, EosController(task, path), q, duration=6.0)

figures = result.summary()
print(f"{figures['status']}: error {figures['task_error_max']:.1e} m, torque at most {figures['torque_max']:.1f} N m")
assert result.ok
assert figures["task_error_max"] < 1e-7
assert figures["torque_max"] < 40.0  # the limit of the joints
