"""How closely numbers must agree, references that do not come from the package, and robots and states to try."""

from __future__ import annotations

import os
from functools import cache

import hypothesis
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import eos_pin
from eos_pin._arrays import frozen_copy
from eos_pin._kernels.dispatch import REFERENCES, kernels

#: Identities: rounding. Multiply by the condition number of what is inverted (`exact`).
EXACT = 1e-13
#: Results of Newton's method: its own tolerance, in the task's units.
SOLVED = 1e-10
#: Integrated motions: largest error in units of atol + rtol |x| (`integration_error`) that a run may collect.
INTEGRATED = 1e3
#: Central differences with the step below: their error is about rounding / step + step².
DIFFERENCED = 1e-7

STEP = 1e-5

#: For tests of what is compiled.
compiled_only = pytest.mark.skipif(
    kernels is None and "EOS_PIN_NEEDS_COMPILER" not in os.environ, reason="installed without a C compiler"
)

#: Postures of panda, well within its limits and away from singularities.
REST = frozen_copy(np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8]))
READY = frozen_copy(np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7]))
#: A whole turn [rad].
TAU = 2.0 * np.pi


def exact(*matrices, scale=1.0):
    """Tolerance for an identity in which these matrices are inverted: rounding times their condition numbers."""
    return EXACT * max(1.0, scale) * np.prod([np.linalg.cond(A) for A in matrices])


def integration_error(x, reference, *, rtol=1e-9, atol=1e-9):
    """Largest error of x in units of what the integrator was allowed in one step."""
    return float(np.max(np.abs(x - reference) / (atol + rtol * np.abs(reference))))


# -- references by finite differences ------------------------------------------------------------------------------


def numeric_jacobian(task, q, step=STEP):
    """Jacobian of a task by central differences in its tangent space."""
    z = task.value(q)
    columns = [
        task.minus(task.value(q + step * e), z) - task.minus(task.value(q - step * e), z) for e in np.eye(q.size)
    ]
    return np.array(columns).T / (2.0 * step)


def numeric_drift(task, q, dq, step=STEP):
    """Task acceleration at ddq = 0: the change of the Jacobian along dq, times dq."""
    return (task.linearize(q + step * dq)[1] - task.linearize(q - step * dq)[1]) @ dq / (2.0 * step)


# -- robots ----------------------------------------------------------------------------------------------------------

LOADING = {
    "panda": ("panda", {"chain_to": "panda_hand_tcp"}),
    "kinova": ("kinova", {"chain_to": "j2s6s200_end_effector"}),
    "ur5": ("ur5", {}),
    "ppr": ("ppr", {"gravity": (0.0, -9.81, 0.0)}),
    "chain": ("planar_chain_10", {"gravity": (0.0, -9.81, 0.0)}),
}


@cache
def robot(name):
    """One of the robots above; the same object whenever it is asked for."""
    source, options = LOADING[name]
    return eos_pin.load_robot(source, **options)


def planar(*joints, limits=3.0):
    """Planar robot of these joint models with links of 1 m along x, whose last frame is `tip`."""
    model, parent = pin.Model(), 0
    model.name = "planar"
    placement = pin.SE3.Identity()
    for i, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, placement, f"joint{i}")
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])))
        placement = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, placement, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -limits, limits
    return eos_pin.Robot(model)


_LINK = """<link name="link{k}"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint{k}" type="{kind}"><parent link="link{before}"/>
<child link="link{k}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>"""


def links(count):
    """Planar arm of links of 1 m, from a URDF, whose joints have no limits; its tip is the link after the last."""
    parts = [
        _LINK.format(k=k, before=k - 1, x=float(k > 1), kind="fixed" if k > count else "continuous")
        for k in range(1, count + 2)
    ]
    urdf = f'<robot name="links"><link name="link0"/>{"".join(parts)}</robot>'
    return eos_pin.load_robot(urdf, chain_to=f"link{count + 1}")


def random_chain(seed):
    """A serial robot: 5 to 12 joints, prismatic and revolute mixed, random axes, offsets and inertias; frame `tip`.

    About three in four joints are revolute, and the first three of these make sure that it moves in all directions.
    """
    random = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"random_chain_{seed}"
    joint = 0
    for i in range(int(random.integers(5, 13))):
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        prismatic = i >= 3 and random.random() < 0.25
        kind = pin.JointModelPrismaticUnaligned if prismatic else pin.JointModelRevoluteUnaligned
        placement = pin.SE3(pin.exp3(random.normal(size=3)), random.uniform(-0.4, 0.4, 3))
        joint = model.addJoint(joint, kind(axis), placement, f"joint_{i + 1}")
        model.addJointFrame(joint)
        # Moments of a solid box in random axes: of a real body, as the triangle inequality wants.
        mass, sides = random.uniform(0.2, 5.0), random.uniform(0.05, 0.5, 3)
        moments = mass / 12.0 * (np.sum(sides**2) - sides**2)
        axes = pin.exp3(random.normal(size=3))
        body = pin.Inertia(mass, random.uniform(-0.2, 0.2, 3), (axes * moments) @ axes.T)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        model.addBodyFrame(f"link_{i + 1}", joint, pin.SE3.Identity(), -1)
    tip = pin.SE3(pin.exp3(random.normal(size=3)), random.uniform(0.1, 0.4, 3))
    model.addFrame(pin.Frame("tip", joint, model.getFrameId(f"link_{model.nv}"), tip, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    return eos_pin.Robot(model)


@cache
def long_chain(n):
    """n equal rods in the plane of gravity, 2 m and 2 kg in all; frame `tip`."""
    model, joint, link = pin.Model(), 0, 2.0 / n
    model.name, model.gravity = f"long_chain_{n}", pin.Motion(np.array([0.0, -9.81, 0.0]), np.zeros(3))
    for i in range(n):
        placement = pin.SE3(np.eye(3), np.array([link if i else 0.0, 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRZ(), placement, f"joint_{i + 1}")
        middle = pin.SE3(np.eye(3), np.array([0.5 * link, 0.0, 0.0]))
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0 / n, link, 0.02, 0.02), middle)
    tip = pin.SE3(np.eye(3), np.array([link, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(n, -np.inf), np.full(n, np.inf)
    return eos_pin.Robot(model)


def is_planar(robot):
    """Whether all revolute joints turn about the world's z axis."""
    try:
        eos_pin.HeadingTask(robot, tip(robot))
    except eos_pin.InputError:
        return False
    return True


def tip(robot):
    """Frame at the end of the robot."""
    return eos_pin.default_frame(robot)


# -- tasks -----------------------------------------------------------------------------------------------------------


def every_task(robot):
    """One task of each kind that the robot can do, by name."""
    end, middle = tip(robot), _middle(robot)
    if is_planar(robot):
        tasks = {
            "position xy": eos_pin.PositionTask(robot, end, "xy"),
            "position x": eos_pin.PositionTask(robot, end, "x"),
            "com xy": eos_pin.ComTask(robot, "xy"),
            "heading": eos_pin.HeadingTask(robot, end),
        }
        stacked = {"position+heading": ["position xy", "heading"]}
        if robot.n > 4:
            tasks["relative xy"] = eos_pin.RelativePositionTask(robot, end, middle, "xy")
            stacked["position+com"] = ["position xy", "com xy"]
    else:
        tasks = {
            "position xyz": eos_pin.PositionTask(robot, end),
            "position xz": eos_pin.PositionTask(robot, end, "xz"),
            "position z": eos_pin.PositionTask(robot, end, "z"),
            "relative xyz": eos_pin.RelativePositionTask(robot, end, middle),
            "orientation": eos_pin.OrientationTask(robot, end),
            "com xyz": eos_pin.ComTask(robot),
            "look at": eos_pin.LookAtTask(robot, end, (1.3, -0.4, 1.2), "x"),
            "distance": eos_pin.DistanceTask(robot, end, (0.4, -1.3, 0.7)),
            "joints": eos_pin.JointTask(robot, [{robot.joints[0].name: 1.0, robot.joints[-1].name: -0.5}]),
            "axis": eos_pin.AxisTask(robot, end, "-x"),
        }
        stacked = {"orientation+z": ["orientation", "position z"]}
        if robot.n >= 6:
            tasks["pose"] = eos_pin.PoseTask(robot, end)
            base = robot.model.frames[1].name
            tasks["relative pose"] = eos_pin.RelativePoseTask(robot, end, base)
            pose, point_axis = tasks["pose"], eos_pin.PointAxisTask(robot, end, "y")
            tasks["tolerance of a pose"] = eos_pin.ToleranceTask(pose, {"rz": 0.2, "x": 0.01})
            tasks["cone"] = eos_pin.ToleranceTask(point_axis, {"cone": 0.26})
            tasks["point axis"] = eos_pin.PointAxisTask(robot, end, (1.0, 2.0, -0.5))
        if robot.n > 6:
            stacked["position+com"] = ["position xyz", "com xyz"]
    tasks |= {name: eos_pin.StackedTask([tasks[part] for part in parts]) for name, parts in stacked.items()}
    return {name: task for name, task in tasks.items() if task.m <= robot.n}


def _middle(robot):
    """Frame of a link at a third of the way, so that enough joints are left beyond it to move in all directions."""
    joint = max(1, robot.n // 3)
    return next(frame.name for frame in robot.model.frames if frame.parentJoint == joint)


@cache
def all_tasks(names=("panda", "kinova", "chain")):
    """Every task of several robots as (name, task), for `pytest.mark.parametrize`.

    Of kinova, a second arm, those that take most or all of its six joints, and one that leaves continuous joints.
    """
    tasks = {name: every_task(robot(name)) for name in names}
    if "panda" in names and "kinova" in names:
        tasks["kinova"] = {kind: t for kind, t in tasks["kinova"].items() if t.m > 3 or kind == "position xyz"}
    return [(f"{name}: {kind}", task) for name in names for kind, task in tasks[name].items()]


def every(tasks):
    """Parametrize a test by tasks. Where it draws states it draws fewer for each task, as the tasks are many."""
    cases = pytest.mark.parametrize("task", [task for _, task in tasks], ids=[name for name, _ in tasks])
    few = hypothesis.settings(max_examples=hypothesis.settings.default.max_examples // 4)
    return lambda test: cases(few(test) if hypothesis.is_hypothesis_test(test) else test)


# -- states ----------------------------------------------------------------------------------------------------------


def numbers(size, bound=1.0):
    """Vectors of `size` numbers up to `bound`."""
    return hnp.arrays(float, size, elements=st.floats(-bound, bound, allow_subnormal=False))


def joints(robot):
    """Configurations within the limits of the robot; a joint without limits, or with wide ones, turns up to π [rad]."""
    lower, upper = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    return numbers(robot.n).map(lambda x: lower + 0.5 * (1.0 + x) * (upper - lower))


def velocities(robot):
    """Joint velocities up to 2 rad/s or m/s."""
    return numbers(robot.n, 2.0)


def tangents(task, bound=1.0):
    """Steps in the tangent space of a task."""
    return numbers(task.m, bound)


def random_state(robot, seed=0):
    """One configuration and one velocity, for a test that needs just one."""
    random = np.random.default_rng(seed)
    lower, upper = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    return random.uniform(lower, upper), random.uniform(-1.0, 1.0, robot.n)


def with_plain_limits(controller):
    """A limited controller with the plain form of the kernel that keeps its limits."""
    vars(controller)["_within"] = REFERENCES["Limits"](*controller._within.__reduce__()[1])
    return controller


def task_and_eight(robot, kind, q):
    """A task of the robot's tip, `"pose"` or axes of its position, and a figure eight through its point at q."""
    if kind == "pose":
        task = eos_pin.PoseTask(robot, tip(robot))
        z = task.value(q)
        return task, eos_pin.PoseTrajectory(eos_pin.figure_eight(z[:3], 0.1, plane="yz"), pose=z)
    task = eos_pin.PositionTask(robot, tip(robot), kind)
    return task, eos_pin.figure_eight(task.value(q), 0.1)
