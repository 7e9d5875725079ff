"""Traditional task-space control against its long form, and what is known about it."""

from __future__ import annotations

import checks
import numpy as np
import pytest
from checks import READY as REST
from checks import exact, numbers, random_state, task_and_eight, tip
from hypothesis import assume, given
from hypothesis import strategies as st

from eos_pin import (
    DampedNullSpace,
    EosController,
    FreeNullSpace,
    InputError,
    OperationalSpaceController,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    PostureNullSpace,
    SingularError,
    TaskSpaceDynamics,
    figure_eight,
    simulate,
)
from eos_pin.control.operational import BASELINES

#: Variants whose task acceleration is exactly what is asked for.
FAITHFUL = ("task-space", "task-space-energy", "null-space-damping", "null-space-posture")


def example(name, kind, q, variant):
    robot = checks.robot(name)
    task, reference = task_and_eight(robot, kind, q)
    return BASELINES[variant](task, reference, q)


def draw_case(name, kind, variant, draw):
    """A controller, and a state not far from its posture where the task is not singular."""
    robot = checks.robot(name)
    q = draw(checks.joints(robot))
    controller = example(name, kind, q, variant)
    q, dq = q + 0.1 * draw(numbers(robot.n)), draw(checks.velocities(robot))
    point = controller.task.at(q, dq)
    assume(np.linalg.cond(point.J) < 1e3)
    return controller, q, dq, point, TaskSpaceDynamics(robot, q, dq, point), draw(st.floats(0.0, 7.0))


def null_torque(variant, robot, q, dq, rest):
    """F⁰ of each variant, written out."""
    M, bias = robot.mass(q), robot.bias(q, dq)
    return {
        "task-space": 0.0 * bias,
        "task-space-energy": -M @ dq,
        "null-space-damping": bias - M @ (20.0 * dq),
        "null-space-posture": bias + M @ (100.0 * (rest - q) - 20.0 * dq),
    }[variant]


@pytest.mark.parametrize(("name", "kind"), [("panda", "xyz"), ("panda", "pose"), ("chain", "xy"), ("ur5", "pose")])
@pytest.mark.parametrize("variant", FAITHFUL)
@given(data=st.data())
def test_torque_is_the_long_form_and_gives_the_task_acceleration(name, kind, variant, data):
    # F^y = G'ᵀ(Λ F* + μ + p) + Nᵀ F⁰; Eqs. (32), (38)
    controller, q, dq, point, dynamics, t = draw_case(name, kind, variant, data.draw)
    robot = controller.robot
    z_d, dz_d, ddz_d = controller.reference(t)
    F = ddz_d + 20.0 * (dz_d - point.dz) + 100.0 * controller.task.minus(z_d, point.z)
    rest = getattr(controller.null_space, "q", q)
    task_force, F_0 = dynamics.Lambda @ F + dynamics.mu + dynamics.p, null_torque(variant, robot, q, dq, rest)
    expected = point.J.T @ task_force + dynamics.Nt @ F_0
    tau = controller.torque(t, q, dq, None)
    scale = np.linalg.norm(task_force) + np.linalg.norm(F_0) + np.linalg.norm(robot.bias(q, dq))
    M = robot.mass(q)
    inverse = np.linalg.inv(dynamics.Lambda)
    np.testing.assert_allclose(tau, expected, rtol=0.0, atol=exact(M, inverse, scale=scale))
    # Whatever happens in the null space, the task accelerates as asked.
    ddz = point.J @ robot.forward_dynamics(q, dq, tau) + point.drift
    np.testing.assert_allclose(ddz, F, rtol=0.0, atol=exact(M, inverse, scale=np.linalg.norm(F) + scale))


@pytest.mark.parametrize(("variant", "least"), [("without-drift", 1e-3), ("set-point", 1e-2)])
def test_popular_shortcuts_miss_the_task_acceleration(panda, variant, least):
    q, dq = random_state(panda, seed=7)
    controller = example("panda", "xyz", q, variant)
    point = controller.task.at(q, dq)
    z_d, dz_d, ddz_d = controller.reference(0.3)
    asked = ddz_d + 20.0 * (dz_d - point.dz) + 100.0 * (z_d - point.z)
    ddz = point.J @ panda.forward_dynamics(q, dq, controller.torque(0.3, q, dq, None)) + point.drift
    missed = ddz - asked
    assert np.abs(missed).max() > least
    # and by exactly what is left out: the drift, and the reference's velocity and acceleration
    left_out = point.drift - (0.0 if controller.feedforward else ddz_d + 20.0 * dz_d)
    np.testing.assert_allclose(missed, left_out, atol=1e-9)


def test_gravity_can_be_left_uncompensated(panda):
    q, dq = random_state(panda, seed=7)
    task = PositionTask(panda, tip(panda))
    full, bare = (
        OperationalSpaceController(task, task.hold(q), DampedNullSpace(), gravity=gravity) for gravity in (True, False)
    )
    difference = full.torque(0.0, q, dq, None) - bare.torque(0.0, q, dq, None)
    np.testing.assert_allclose(difference, panda.gravity(q), atol=1e-10)


def test_singular_task_is_refused(ur5):
    task = PoseTask(ur5, tip(ur5))
    straight = np.zeros(6)
    controller = OperationalSpaceController(task, task.hold(straight))
    with pytest.raises(SingularError, match="the task is singular here"):
        controller.torque(0.0, straight, straight, None)
    with pytest.raises(SingularError):
        simulate(ur5, controller, straight, duration=0.1)


def test_posture_must_fit_the_robot(panda):
    task = PositionTask(panda, tip(panda))
    for posture in ([0.0], [0.0] * 6):
        controller = OperationalSpaceController(task, task.hold(REST), PostureNullSpace(posture))
        with pytest.raises(InputError, match=f"the posture has {len(posture)} joints, 'panda' has 7"):
            controller.torque(0.0, REST, np.zeros(7), None)


def test_variants_run_on_every_kind_of_task(panda, unchecked):
    assert set(FAITHFUL) < set(BASELINES)
    for kind in ("xyz", "pose"):
        for variant in BASELINES:
            run = simulate(panda, example("panda", kind, REST, variant), REST, duration=0.2, rtol=1e-6)
            assert run.ok, run.message
            assert run.residuals()["torque"] < 1e-12


@pytest.mark.parametrize("kind", ["xyz", "pose"])
def test_controllers_repeat_from_which_cycle_on(panda, unchecked, kind):
    """The facts that the comparison of the package rests on; each cycle takes two seconds."""
    task = PoseTask(panda, tip(panda)) if kind == "pose" else PositionTask(panda, tip(panda))
    z = task.value(REST)
    reference = figure_eight(z[:3], 0.2, period=2.0, plane="yz")
    if kind == "pose":
        reference = PoseTrajectory(reference, pose=z)
    # Start on the path, so that there is no transient of the task and the first cycle is a fair one.
    start = np.linalg.lstsq(task.linearize(REST)[1], reference(0.0).dz, rcond=None)[0]

    def drift(controller, cycles):
        run = simulate(panda, controller, REST, start, duration=2.0 * cycles, rtol=1e-8)
        assert run.ok, run.message
        assert np.abs(run.error).max() < 1e-5
        return run.joint_drift_per_cycle

    free = drift(OperationalSpaceController(task, reference, FreeNullSpace()), 2)
    damped = drift(BASELINES["null-space-damping"](task, reference, REST), 3)
    posture = drift(BASELINES["null-space-posture"](task, reference, REST), 5)
    eos = drift(EosController(task, reference), 3)
    assert free.min() > 1e-2
    assert damped.min() > 1e-3
    assert posture[0] > 1e-3
    assert posture[-1] < 1e-4 * posture[0]
    assert eos.max() < 1e-6
