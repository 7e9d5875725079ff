"""A tool that presses with 10 N on a surface that moves, in MuJoCo, while it slides on a circle and the elbow swings.

Run it by `python benchmarks/contact.py`; it prints the settings and the figures.
"""

from __future__ import annotations

import argparse
import math
from typing import Any, NamedTuple

import mujoco
import numpy as np
from marked import HOME, fill, table

from eos_pin import ControlLoop, ForceGoal, ImpedanceController, PoseTask, PoseTrajectory, Robot, circle, load_robot
from eos_pin.charts.chart import Chart
from eos_pin.simulation.mujoco import _compile

TOOL = "panda_hand_tcp"
#: Wanted force [N], control period [s], and its tool: radius of the tip [m].
FORCE, PERIOD, TIP = 10.0, 1e-3, 0.01
#: Motion of the surface: amplitude [m] and period [s].
RISE, WAVE = 0.01, 4.0
#: Circle of the tool: radius [m] and period [s]; and swing of the elbow in v [rad] and its period [s].
RADIUS, LAP, SWING, BEAT = 0.06, 4.0, 0.3, 3.0
#: Stiffness and damping of the contact as MuJoCo takes them.
CONTACT = (-20000.0, -400.0)


class Pressed(NamedTuple):
    """Figures of a run.

    Attributes:
        force_error: Largest error of the normal force after half a second [N].
        tangential: Largest tangential error of the tool after half a second [m].
        bounces: How often the contact was lost after it was first made.
        swung: Range of the elbow's motion in v [rad].
        stiffness: Force over depth of the contact at the end [N/m].
    """

    force_error: float
    tangential: float
    bounces: int
    swung: float
    stiffness: float


class Scene:
    """The robot and a surface that moves up and down, in MuJoCo.

    Args:
        robot: The robot.
        task: Pose of its tool.
        q: Joints at the start.
        gap: Distance of the tip from the surface at the start [m].
    """

    def __init__(self, robot: Robot, task: PoseTask, q: np.ndarray, gap: float) -> None:
        z = task.value(q)
        self.top, self.n = float(z[2]) - TIP - gap, robot.n
        last = robot.placement(q, robot.joint_names[-1]).actInv(robot.placement(q, TOOL))

        def more(_: Any, spec: Any, bodies: list[Any]) -> None:
            spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET
            # Friction that does not depend on its direction.
            spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
            tip = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [TIP, 0.0, 0.0], "pos": last.translation}
            bodies[-1].add_geom(name="tip", friction=[0.2, 0.0, 0.0], solref=CONTACT, condim=3, **tip)
            table = spec.worldbody.add_body(name="table", pos=[z[0], z[1], self.top - 0.1], mass=1000.0)
            table.explicitinertial, table.inertia = True, [100.0] * 3
            table.add_joint(name="table", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
            box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [1.0, 1.0, 0.1]}
            table.add_geom(name="table", friction=[0.2, 0.0, 0.0], solref=CONTACT, condim=3, **box)

        self.model = _compile(mujoco, robot.model, more)
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.model.opt.timestep = PERIOD
        self.data = mujoco.MjData(self.model)
        self.data.qpos[: robot.n] = q
        self.wrench, self.depth = np.zeros(6), 0.0

    def advance(self, t: float, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joints and velocities a period later; the surface is where it has to be."""
        data, w = self.data, math.tau / WAVE
        data.qpos[self.n], data.qvel[self.n] = RISE * math.sin(w * t), RISE * w * math.cos(w * t)
        data.qfrc_applied[: self.n] = tau
        mujoco.mj_step(self.model, data)
        self.wrench, self.depth, force = np.zeros(6), 0.0, np.zeros(6)
        for k, contact in enumerate(data.contact):
            mujoco.mj_contactForce(self.model, data, k, force)
            # Along the contact's axes, on the second geom; the robot's comes first or second.
            sign = 1.0 if self.model.geom(contact.geom2).name == "tip" else -1.0
            world = sign * contact.frame.reshape(3, 3).T @ force[:3]
            # About the tool's origin, which is the centre of the tip.
            centre = data.geom("tip").xpos
            self.wrench += np.concatenate((world, np.cross(contact.pos - centre, world)))
            self.depth = -float(contact.dist)
        return data.qpos[: self.n].copy(), data.qvel[: self.n].copy()


def press(duration: float, *, observer: float | None = None, gap: float = 0.0005) -> Pressed:
    """Press, slide and swing.

    Args:
        duration: Length of the run [s].
        observer: Rate of a momentum observer in the place of the measured force [1/s].
        gap: Distance of the tip from the surface at the start [m].
    """
    robot = load_robot("panda", chain_to=TOOL)
    task = PoseTask(robot, TOOL)
    q = np.array([0.0, -0.1, 0.0, -2.2, 0.0, 2.1, 0.8])
    scene, place = Scene(robot, task, q, gap), robot.placement(q, TOOL)
    path = PoseTrajectory(
        position=circle(place.translation, RADIUS, period=LAP, plane="xy"), orientation=place.rotation
    )
    V, rest = Chart.from_base(task, q).V[:, 0], q

    def swing(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        w = math.tau / BEAT
        s, ds, dds = 1.0 - math.cos(w * t), w * math.sin(w * t), w * w * math.cos(w * t)
        return rest + 0.5 * SWING * s * V, 0.5 * SWING * ds * V, 0.5 * SWING * dds * V

    controller = ImpedanceController(
        task, path, posture=swing, stiffness={"m": 3000.0, "rad": 100.0}, self_motion_stiffness=40.0,
        damping_ratio=1.0, force=ForceGoal({"z": -FORCE}),
        observer=observer, wrench=None if observer else lambda t: scene.wrench,
    )  # fmt: skip
    loop, dq = ControlLoop(controller), np.zeros(robot.n)
    forces, errors, v = [], [], []
    for k in range(round(duration / PERIOD)):
        t = k * PERIOD
        target = path(t)
        errors.append(float(np.linalg.norm((task.value(q) - target.z)[:2])))
        v.append(float(V @ q))
        q, dq = scene.advance(t, loop.step(t, q, dq))
        forces.append(scene.wrench[2])
    touching = np.array(forces) > 0.0
    first = int(np.argmax(touching))
    bounces = int((touching[first:-1] & ~touching[first + 1 :]).sum())
    late = slice(round(0.5 / PERIOD), None)
    return Pressed(
        float(np.abs(np.array(forces[late]) - FORCE).max()), max(errors[late]), bounces, max(v) - min(v),
        forces[-1] / max(scene.depth, 1e-12),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=8.0)
    parser.add_argument("--write", action="store_true", help="write the figures into docs/impedance.md")
    arguments = parser.parse_args()
    scene = (
        f"{FORCE:g} N on a surface that moves by ±{1e3 * RISE:g} mm in {WAVE:g} s (up to "
        f"{1e3 * RISE * math.tau / WAVE:.0f} mm/s), {1e3 * PERIOD:g} ms, friction 0.2"
    )
    rows = []
    for name, observer in (("measured", None), ("momentum observer, 200 1/s", 200.0)):
        found = press(arguments.duration, observer=observer)
        figures = f"{found.force_error:.3f}", str(found.bounces), f"{1e3 * found.tangential:.2f}", f"{found.swung:.2f}"
        rows.append([name, *figures, f"{1e-3 * found.stiffness:.0f}"])
    columns = ("force", "off after 0.5 s [N]", "bounces", "tangential error [mm]", "elbow swings [rad]")
    text = f"\n\n{scene}:\n{table((*columns, 'contact [kN/m]'), rows)}"
    print(text)
    if arguments.write:
        fill(HOME / "docs" / "impedance.md", "contact", text)


if __name__ == "__main__":
    main()
