"""Equations of motion in w = (z, v) and in z alone, against joint-space dynamics."""

from __future__ import annotations

import checks
import numpy as np
import pytest
from checks import EXACT, all_tasks, every_task, exact
from hypothesis import assume, given
from hypothesis import strategies as st

from eos_pin import Chart, ExtendedDynamics, SingularError, TaskSpaceDynamics

TASKS = all_tasks(("panda", "kinova", "chain", "ppr"))
every = checks.every(TASKS)


def state(data, task):
    """A state at which the task is not close to singular."""
    q, dq = data.draw(checks.joints(task.robot)), data.draw(checks.velocities(task.robot))
    assume(np.linalg.cond(task.linearize(q)[1]) < 1e3)
    return q, dq


def chart_near(data, task, q):
    """A chart with q well inside."""
    q_bar = q + data.draw(checks.numbers(q.size, 0.3))
    J = task.linearize(q_bar)[1]
    assume(np.linalg.cond(J) < 1e3)
    chart = Chart.from_base(task, q_bar)
    assume(chart.margin(task.linearize(q)[1]) > 0.3)
    return chart


def largest(*arrays):
    return max(1.0, *(np.abs(a).max(initial=0.0) for a in arrays))


# -- in w = (z, v) ---------------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_equation_26_holds_block_by_block(task, data):
    """M11 ddz + M12 ddv + bias = force, with the blocks as printed, along any torque, force on the task and state."""
    robot, (q, dq) = task.robot, state(data, task)
    chart = chart_near(data, task, q)
    tau, task_force = data.draw(checks.numbers(robot.n, 10.0)), data.draw(checks.numbers(task.m, 10.0))
    extended = ExtendedDynamics.from_state(robot, chart, q, dq)
    M, point, m = robot.mass(q), extended.point, task.m
    UB, D, E = chart.U @ point.B, point.D, point.E
    scale = exact(point.H, point.H, scale=largest(M) * largest(point.H) ** 2)
    mass = extended.mass
    np.testing.assert_allclose(mass[:m, :m], UB.T @ M @ UB, atol=scale)
    np.testing.assert_allclose(mass[:m, m:], UB.T @ M @ D, atol=scale)
    np.testing.assert_allclose(mass[m:, :m], D.T @ M @ UB, atol=scale)
    np.testing.assert_allclose(mass[m:, m:], D.T @ M @ D, atol=scale)
    np.testing.assert_allclose(mass, mass.T, atol=scale)
    torque = M @ E + robot.bias(q, dq)
    bias = np.concatenate((UB.T @ torque, D.T @ torque))
    np.testing.assert_allclose(extended.bias, bias, atol=scale * largest(E, torque))
    # A force on the task does no work on v.
    force = np.concatenate((UB.T @ tau + task_force, D.T @ tau))
    np.testing.assert_allclose(extended.force(tau, task_force), force, atol=scale * 10.0)
    np.testing.assert_allclose(extended.force(tau), force - np.pad(task_force, (0, chart.r)), atol=scale * 10.0)


@every
@given(data=st.data())
def test_equation_30_is_equation_26_solved(task, data):
    """With the correction of the printed formula: H⁻¹(M⁻¹(R + F^y + G'ᵀF^z) − E)."""
    robot, (q, dq) = task.robot, state(data, task)
    chart = chart_near(data, task, q)
    tau, task_force = data.draw(checks.numbers(robot.n, 10.0)), data.draw(checks.numbers(task.m, 10.0))
    extended = ExtendedDynamics.from_state(robot, chart, q, dq)
    ddw = extended.acceleration(tau, task_force)
    left = extended.mass @ ddw + extended.bias
    scale = exact(extended.point.H, extended.point.H, robot.mass(q), scale=largest(left, ddw))
    np.testing.assert_allclose(left, extended.force(tau, task_force), atol=scale)
    np.testing.assert_array_equal(extended.acceleration(tau), extended.acceleration(tau, np.zeros(task.m)))


@every
@given(data=st.data())
def test_extended_accelerations_are_those_of_the_joints(task, data):
    """ddq = H ddw + E is what forward dynamics gives, and Mddq + bias is what drives it."""
    robot, (q, dq) = task.robot, state(data, task)
    chart = chart_near(data, task, q)
    tau, task_force = data.draw(checks.numbers(robot.n, 10.0)), data.draw(checks.numbers(task.m, 10.0))
    extended = ExtendedDynamics.from_state(robot, chart, q, dq)
    point = extended.point
    ddq = point.H @ extended.acceleration(tau, task_force) + point.E
    M, total = robot.mass(q), tau + point.task.J.T @ task_force
    expected = np.linalg.solve(M, total - robot.bias(q, dq))
    scale = exact(point.H, M, scale=largest(expected))
    np.testing.assert_allclose(ddq, expected, atol=scale)
    np.testing.assert_allclose(ddq, robot.forward_dynamics(q, dq, total), atol=scale)


@every
@given(data=st.data())
def test_kinetic_energy_is_the_same_in_both_coordinates(task, data):
    robot, (q, dq) = task.robot, state(data, task)
    chart = chart_near(data, task, q)
    extended = ExtendedDynamics.from_state(robot, chart, q, dq)
    dw = extended.point.dw
    energy = robot.kinetic_energy(q, dq)
    tolerance = exact(extended.point.H, extended.point.H, scale=largest(energy))
    assert 0.5 * dw @ extended.mass @ dw == pytest.approx(energy, abs=tolerance)


def test_mass_of_the_ppr_robot_in_closed_form(ppr):
    """At y3 = 0 on the chart based there, by hand: m11 of the paper's M is 3, and H is known."""
    task = every_task(ppr)["position xy"]
    extended = ExtendedDynamics.from_state(ppr, Chart.from_base(task, np.zeros(3)), np.zeros(3), np.zeros(3))
    half = np.sqrt(0.5)
    H = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -half], [0.0, 0.5, half]])
    M = np.array([[3.0, 0.0, 0.0], [0.0, 2.0, 1.0], [0.0, 1.0, 1.0]])
    np.testing.assert_allclose(extended.point.H, H, atol=EXACT)
    np.testing.assert_allclose(extended.mass, H.T @ M @ H, atol=10 * EXACT)
    # Gravity on the slider y2 and the tip, at rest: (0, 2 g, g) in the joints.
    np.testing.assert_allclose(extended.bias, H.T @ [0.0, 2 * 9.81, 9.81], atol=100 * EXACT)


# -- in z alone ------------------------------------------------------------------------------------------------------


@every
@given(data=st.data())
def test_task_space_dynamics_have_the_motion_they_stand_for(task, data):
    """Eqs. (5)–(9): Λ, μ, p, and the motion they stand for."""
    robot, (q, dq) = task.robot, state(data, task)
    tau = data.draw(checks.numbers(robot.n, 10.0))
    point = task.at(q, dq)
    dynamics, J, M = TaskSpaceDynamics(robot, q, dq, point), point.J, robot.mass(q)
    mobility = J @ np.linalg.solve(M, J.T)
    assume(np.linalg.cond(mobility) < 1e6)
    scale = exact(M, mobility, scale=largest(dynamics.Lambda) * largest(J))
    np.testing.assert_allclose(dynamics.Lambda, np.linalg.inv(mobility), atol=scale)
    # Any torque moves the task by Λ ddz + μ + p = J#ᵀ tau.
    ddz = J @ robot.forward_dynamics(q, dq, tau) + point.drift
    pushed = dynamics.J_sharp.T @ tau
    tolerance = scale * largest(ddz, pushed, point.drift, robot.bias(q, dq))
    np.testing.assert_allclose(dynamics.Lambda @ ddz + dynamics.mu + dynamics.p, pushed, atol=tolerance)
    np.testing.assert_allclose(dynamics.force(ddz), pushed, atol=tolerance)
    # So the torque J.T @ force gives just this acceleration.
    reached = J @ robot.forward_dynamics(q, dq, J.T @ dynamics.force(ddz)) + point.drift
    np.testing.assert_allclose(reached, ddz, atol=tolerance * largest(mobility))


@every
@given(data=st.data())
def test_consistent_inverse_and_its_projector_obey_equations_7_and_8(task, data):
    """Eqs. (7), (8): torques in the range of Nᵀ do not accelerate the task, and Nᵀ is a projector."""
    robot, (q, dq) = task.robot, state(data, task)
    point = task.at(q, dq)
    dynamics, J, M = TaskSpaceDynamics(robot, q, dq, point), point.J, robot.mass(q)
    mobility = J @ np.linalg.solve(M, J.T)
    assume(np.linalg.cond(mobility) < 1e6)
    scale = exact(M, mobility, scale=largest(dynamics.J_sharp) * largest(J))
    np.testing.assert_allclose(J @ dynamics.J_sharp, np.eye(task.m), atol=scale)
    Nt = dynamics.Nt
    np.testing.assert_allclose(Nt @ Nt, Nt, atol=scale * largest(Nt))
    np.testing.assert_allclose(Nt @ J.T, 0.0, atol=scale * largest(J))
    np.testing.assert_allclose(J @ np.linalg.solve(M, Nt), 0.0, atol=scale * largest(mobility, np.linalg.inv(M)))
    np.testing.assert_allclose(np.trace(Nt), robot.n - task.m, atol=scale * robot.n)
    # J# is the right inverse of least kinetic energy.
    dz = data.draw(checks.numbers(task.m))
    least = robot.kinetic_energy(q, dynamics.J_sharp @ dz)
    assert least <= robot.kinetic_energy(q, np.linalg.pinv(J) @ dz) + scale * largest(M)
    assert least == pytest.approx(0.5 * dz @ dynamics.Lambda @ dz, abs=scale * largest(M))


@every
@given(data=st.data())
def test_mu_is_all_velocity_and_p_is_all_gravity(task, data):
    robot, (q, dq) = task.robot, state(data, task)
    dynamics = TaskSpaceDynamics(robot, q, dq, task.at(q, dq))
    mobility = dynamics.task.J @ np.linalg.solve(robot.mass(q), dynamics.task.J.T)
    assume(np.linalg.cond(mobility) < 1e6)
    at_rest = TaskSpaceDynamics(robot, q, 0.0 * dq, task.at(q, 0.0 * dq))
    backwards = TaskSpaceDynamics(robot, q, -dq, task.at(q, -dq))
    scale = exact(robot.mass(q), mobility, scale=largest(dynamics.mu, dynamics.p))
    np.testing.assert_allclose(at_rest.mu, 0.0, atol=scale)
    np.testing.assert_allclose(at_rest.p, dynamics.p, atol=scale)
    np.testing.assert_allclose(backwards.mu, dynamics.mu, atol=scale)


@given(angle=st.floats(-3.0, 3.0), speed=st.floats(-3.0, 3.0))
def test_task_space_dynamics_of_the_ppr_robot_in_closed_form(ppr, angle, speed):
    """Tip of Sec. 4.3: mobility by hand from M = [[3, 0, −s], [0, 2, c], [−s, c, 1]]."""
    s, c = np.sin(angle), np.cos(angle)
    task = every_task(ppr)["position xy"]
    q, dq = np.array([0.2, -0.1, angle]), np.array([0.0, 0.0, speed])
    dynamics = TaskSpaceDynamics(ppr, q, dq, task.at(q, dq))
    M = np.array([[3.0, 0.0, -s], [0.0, 2.0, c], [-s, c, 1.0]])
    J = np.array([[1.0, 0.0, -s], [0.0, 1.0, c]])
    tolerance = 100 * exact(M)
    np.testing.assert_allclose(dynamics.Lambda, np.linalg.inv(J @ np.linalg.inv(M) @ J.T), atol=tolerance)
    # The tip's centripetal acceleration and the forces of the same mass on the sliders cancel but for their part in Λ.
    drift = -(speed**2) * np.array([c, s])
    coriolis = -(speed**2) * np.array([c, s, 0.0])
    mu = dynamics.Lambda @ (J @ np.linalg.solve(M, coriolis) - drift)
    np.testing.assert_allclose(dynamics.mu, mu, atol=tolerance * largest(drift))
    p = dynamics.Lambda @ J @ np.linalg.solve(M, 9.81 * np.array([0.0, 2.0, c]))
    np.testing.assert_allclose(dynamics.p, p, atol=10 * tolerance)


def test_singular_task_has_no_task_space_mass(panda):
    task, zero = every_task(panda)["pose"], np.zeros(7)
    dynamics = TaskSpaceDynamics(panda, zero, zero, task.at(zero, zero))
    with pytest.raises(SingularError) as caught:
        dynamics.force(np.zeros(6))
    assert caught.value.rank == 5
    assert len(caught.value.singular_values) == 6
