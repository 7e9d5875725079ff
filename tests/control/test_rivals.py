"""Published laws against independent forms: constrained least squares by their KKT system, finite differences, runs."""

from __future__ import annotations

import checks
import numpy as np
import pytest
from checks import DIFFERENCED, STEP, random_state, tip
from checks import READY as REST

from eos_pin import (
    EosController,
    Hold,
    InputError,
    JointTask,
    OperationalSpaceController,
    PoseTask,
    PositionTask,
    Posture,
    PostureNullSpace,
    SingularError,
    Track,
    figure_eight,
    simulate,
    simulate_sampled,
)
from eos_pin.control.rivals.hierarchies import HierarchyController
from eos_pin.control.rivals.least_torque import LeastTorque
from eos_pin.control.rivals.parts import SpringNullSpace, inverse_rate, jacobian_rate, right_inverse
from eos_pin.control.rivals.resolved import (
    IntegratedVelocity,
    NullSpaceDynamics,
    ResolvedAcceleration,
    ResolvedAccelerationWithTorque,
    ResolvedVelocity,
)
from eos_pin.control.rivals.sliding import SlidingModeController
from eos_pin.robot.regressor import parameter_bounds, passive_regressor, passive_torque

CASES = [("panda", 1), ("panda", 2), ("chain", 3)]
#: Gains that are not the usual ones, so that a mix-up shows.
GAINS = {"kp": 70.0, "kd": 11.0, "kp_posture": 40.0, "kd_posture": 9.0}


def nearest(W, a, A, b):
    """Minimize (x − a)ᵀW(x − a) subject to A x = b, by the KKT system."""
    n, m = W.shape[0], A.shape[0]
    K = np.block([[W, A.T], [A, np.zeros((m, m))]])
    return np.linalg.solve(K, np.concatenate((W @ a, b)))[:n]


class Case:
    """A robot with a task and a path in a random state, and every term of its equations of motion."""

    def __init__(self, name, seed):
        self.robot = robot = checks.robot(name)
        self.random = np.random.default_rng(seed)
        self.rest = REST if name == "panda" else 0.3 * self.random.normal(size=robot.n)
        self.task = PositionTask(robot, tip(robot), "xyz" if name == "panda" else "xy")
        self.path = figure_eight(self.task.value(self.rest), 0.1, period=4.0)
        self.q = self.rest + 0.2 * self.random.normal(size=robot.n)
        self.dq, self.t = 0.5 * self.random.normal(size=robot.n), 0.7
        self.M, self.h = robot.mass(self.q), robot.bias(self.q, self.dq)
        self.J = self.task.linearize(self.q)[1]
        self.xi = 40.0 * (self.rest - self.q) - 9.0 * self.dq
        self.inertia = np.diag(1.0 / np.diag(np.linalg.inv(robot.mass(self.rest))))

    def asked(self, t=None):
        """Task acceleration that is asked for, without the drift; Eq. (33)."""
        z_d, dz_d, ddz_d = self.path(self.t)
        z = self.task.value(self.q)
        drift = checks.numeric_drift(self.task, self.q, self.dq)
        return ddz_d + 11.0 * (dz_d - self.J @ self.dq) + 70.0 * (z_d - z) - drift

    def torque(self, controller):
        return controller.torque(self.t, self.q, self.dq, controller.start(self.t, self.q, self.dq))

    def agrees(self, controller, tau):
        found = self.torque(controller)
        np.testing.assert_allclose(found, tau, atol=DIFFERENCED * np.abs(tau).max(), rtol=0.0)


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def case(request):
    return Case(*request.param)


# -- parts -----------------------------------------------------------------------------------------------------------


def test_jacobian_rate_gives_the_drift_of_positions_and_rotations():
    for task in (
        PositionTask(checks.robot("panda"), "panda_hand_tcp"),
        PoseTask(checks.robot("panda"), "panda_hand_tcp"),
    ):
        q, dq = random_state(task.robot, 3)
        np.testing.assert_allclose(jacobian_rate(task, q, dq) @ dq, task.at(q, dq).drift, atol=1e-7)
        assert not jacobian_rate(task, q, 0.0 * dq).any()


def test_inverse_rate_is_the_difference_of_inverses(case):
    task, q, dq = case.task, case.q, case.dq
    J = case.J
    found = inverse_rate(J, jacobian_rate(task, q, dq), right_inverse(J, J.T))
    after, before = (np.linalg.pinv(task.linearize(q + step * dq)[1]) for step in (STEP, -STEP))
    np.testing.assert_allclose(found, (after - before) / (2.0 * STEP), atol=1e-6)


def test_right_inverse_of_a_singular_jacobian_is_refused():
    J = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(SingularError):
        right_inverse(J, J.T)


# -- the eight laws of Nakanishi et al. ------------------------------------------------------------------------------


def test_resolved_acceleration_is_nearest_to_the_posture_acceleration(case):
    ddq = nearest(np.eye(case.robot.n), case.xi, case.J, case.asked())
    case.agrees(ResolvedAcceleration(case.task, case.path, case.rest, **GAINS), case.M @ ddq + case.h)


def test_resolved_acceleration_with_torque_projects_the_torque(case):
    ddq = nearest(np.eye(case.robot.n), 0.0 * case.q, case.J, case.asked())
    free = nearest(np.eye(case.robot.n), case.inertia @ case.xi, case.J, 0.0 * case.asked())
    controller = ResolvedAccelerationWithTorque(case.task, case.path, case.rest, **GAINS)
    case.agrees(controller, case.M @ ddq + case.h + free)


def desired(case, step):
    """Desired velocity a little later on the motion through the state, by the KKT system."""
    q, t = case.q + step * case.dq, case.t + step
    z, J = case.task.linearize(q)
    target = case.path(t)
    dz = target.dz + 70.0 / 11.0 * (target.z - z)
    return nearest(np.eye(q.size), 40.0 / 9.0 * (case.rest - q), J, dz)


def test_resolved_velocity_and_its_rate(case):
    dq_d = desired(case, 0.0)
    ddq_d = (desired(case, STEP) - desired(case, -STEP)) / (2.0 * STEP)
    tau = case.M @ ddq_d + case.h + 11.0 * case.inertia @ (dq_d - case.dq)
    case.agrees(ResolvedVelocity(case.task, case.path, case.rest, **GAINS), tau)
    # At the start the desired joints are those of the robot.
    tau = case.M @ (ddq_d + 11.0 * (dq_d - case.dq)) + case.h
    case.agrees(IntegratedVelocity(case.task, case.path, case.rest, **GAINS), tau)


def test_integrated_velocity_integrates_by_trapezoids(case):
    controller = IntegratedVelocity(case.task, case.path, case.rest, **GAINS)
    state = controller.start(case.t, case.q, case.dq)
    _, after = controller.step(case.t + 0.01, case.q + 0.01 * case.dq, case.dq, state)
    expected = case.q + 0.005 * (desired(case, 0.0) + desired(case, 0.01))
    np.testing.assert_allclose(after.q, expected, atol=1e-12)
    assert state.t == case.t


def test_null_space_dynamics_let_the_null_space_velocity_error_decay(case):
    controller = NullSpaceDynamics(case.task, case.path, case.rest, **GAINS)
    ddq = case.robot.forward_dynamics(case.q, case.dq, case.torque(controller))
    np.testing.assert_allclose(case.J @ ddq, case.asked(), atol=1e-6 * np.abs(ddq).max())

    def error(step):
        q, dq = case.q + step * case.dq, case.dq + step * ddq
        J = case.task.linearize(q)[1]
        return nearest(np.eye(q.size), 40.0 / 9.0 * (case.rest - q) - dq, J, np.zeros(len(J)))

    rate, N = (error(STEP) - error(-STEP)) / (2.0 * STEP), np.eye(case.q.size) - np.linalg.pinv(case.J) @ case.J
    np.testing.assert_allclose(N @ rate, -9.0 * error(0.0), atol=1e-6 * np.abs(ddq).max())


@pytest.mark.parametrize("variant", ["Gauss", "decoupled", "decoupled, with springs"])
def test_force_laws_are_gauss_principle(case, variant):
    # Accelerations nearest to those of the null space's torque alone, in the metric M.
    spring = {"stiffness": 40.0 * np.diag(case.inertia), "damping": 9.0 * np.diag(case.inertia)}
    torque = case.inertia @ case.xi
    law, free = {
        "Gauss": (SpringNullSpace(case.rest, **spring, compensates=False), np.linalg.solve(case.M, torque - case.h)),
        "decoupled": (PostureNullSpace(case.rest, kp=40.0, kd=9.0), case.xi),
        "decoupled, with springs": (SpringNullSpace(case.rest, **spring), np.linalg.solve(case.M, torque)),
    }[variant]
    ddq = nearest(case.M, free, case.J, case.asked())
    case.agrees(OperationalSpaceController(case.task, case.path, law, kp=70.0, kd=11.0), case.M @ ddq + case.h)


# -- hierarchies -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("structure", ["successive", "augmented"])
@pytest.mark.parametrize("consistency", ["static", "dynamic", "stiffness"])
def test_hierarchy_is_made_of_projections(case, structure, consistency):
    robot, J = case.robot, case.J
    random = np.random.default_rng(0)
    K = random.normal(size=(robot.n, robot.n))
    K = K @ K.T + np.eye(robot.n)
    second = JointTask(robot, [{robot.joint_names[1]: 1.0, robot.joint_names[2]: -0.5}])
    controller = HierarchyController(
        case.task, case.path, case.rest, structure=structure, consistency=consistency, second=second, stiffness=K,
        **GAINS,
    )  # fmt: skip
    weight = {"static": np.eye(robot.n), "dynamic": case.M, "stiffness": K}[consistency]
    compliance = np.linalg.inv(weight)

    def free(A, tau):
        return nearest(compliance, tau, A @ compliance, np.zeros(len(A)))

    def pulled(A, ddz):
        # Torque Aᵀf for a force f with which the robot, else at rest, gets the acceleration.
        return A.T @ np.linalg.solve(A @ np.linalg.solve(case.M, A.T), ddz)

    J_2 = second.linearize(case.q)[1]
    ddz_2 = 40.0 * (second.value(case.rest) - second.value(case.q)) - 9.0 * J_2 @ case.dq
    tau_2, tau_3 = pulled(J_2, ddz_2), case.M @ case.xi
    both = {
        "successive": free(J, tau_2) + free(J, free(J_2, tau_3)),
        "augmented": free(J, tau_2) + free(np.vstack((J, J_2)), tau_3),
    }[structure]
    case.agrees(controller, pulled(J, case.asked()) + both + case.h)


def test_hierarchy_of_dynamic_consistency_keeps_the_task_free(case):
    for structure in ("successive", "augmented"):
        controller = HierarchyController(case.task, case.path, case.rest, structure=structure, **GAINS)
        ddq = case.robot.forward_dynamics(case.q, case.dq, case.torque(controller))
        np.testing.assert_allclose(case.J @ ddq, case.asked(), atol=1e-6 * np.abs(ddq).max())


def test_hierarchy_refuses_a_second_task_that_does_not_fit(case):
    made = {"task": case.task, "reference": case.path, "posture": case.rest}
    with pytest.raises(InputError, match="structure"):
        HierarchyController(**made, structure="parallel")
    with pytest.raises(InputError, match="consistency"):
        HierarchyController(**made, consistency="total")
    with pytest.raises(InputError, match="symmetric"):
        HierarchyController(**made, stiffness=-np.eye(case.robot.n))
    with pytest.raises(InputError, match="second task"):
        HierarchyController(**made, second=JointTask(case.robot, [{name: 1.0} for name in case.robot.joint_names]))
    pose = PoseTask(checks.robot("panda"), "panda_hand_tcp")
    with pytest.raises(InputError, match="two joints or more"):
        HierarchyController(pose, pose.hold(REST), REST)


# -- least torques ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("norm", ["torque", "range", "acceleration"])
@pytest.mark.parametrize("damping", [None, 7.0])
def test_least_torque_is_the_least(case, norm, damping):
    controller = LeastTorque(case.task, case.path, norm=norm, damping=damping, kp=70.0, kd=11.0)
    inverse = np.linalg.inv(case.M)
    effort = np.where(np.isfinite(case.robot.effort), case.robot.effort, 1.0)
    Q = {"torque": np.eye(case.robot.n), "range": np.diag(effort**-2), "acceleration": inverse @ inverse}[norm]
    wanted = 0.0 * case.h if damping is None else case.h - damping * case.M @ case.dq
    A = case.J @ inverse
    case.agrees(controller, nearest(Q, wanted, A, case.asked() + A @ case.h))
    with pytest.raises(InputError, match="norm"):
        LeastTorque(case.task, case.path, norm="power")


@pytest.mark.usefixtures("unchecked")
def test_least_torque_without_damping_builds_up_speed():
    # What Hollerbach and Suh found: the torque is small at first, and later beyond all bounds.
    case = Case("panda", 1)
    speeds = []
    for damping in (None, 10.0):
        run = simulate(case.robot, LeastTorque(case.task, case.path, damping=damping), REST, duration=2.0, rtol=1e-6)
        speeds.append(np.linalg.norm(run.dq, axis=1).max())
    assert speeds[0] > 5.0 * speeds[1]


# -- sliding mode ----------------------------------------------------------------------------------------------------


def test_passive_torque_keeps_energy_and_is_linear_in_parameters(case):
    robot, q, dq = case.robot, case.q, case.dq
    s, ddq_r = case.random.normal(size=(2, robot.n))
    coriolis = passive_torque(robot, q, dq, s, 0.0 * s) - robot.gravity(q)
    # dM/dt − 2C is skew.
    rate = (robot.mass(q + STEP * dq) - robot.mass(q - STEP * dq)) / (2.0 * STEP)
    assert s @ coriolis == pytest.approx(0.5 * s @ rate @ s, rel=1e-6)
    own = passive_torque(robot, q, dq, dq, ddq_r)
    np.testing.assert_allclose(own, robot.inverse_dynamics(q, dq, ddq_r), atol=1e-9)
    theta = np.concatenate([body.toDynamicParameters() for body in list(robot.model.inertias)[1:]])
    Y = passive_regressor(robot, q, dq, s, ddq_r)
    np.testing.assert_allclose(Y @ theta, passive_torque(robot, q, dq, s, ddq_r), atol=1e-9)


@pytest.mark.parametrize("error", [0.05, 0.3])
def test_parameter_bounds_hold_for_every_perturbed_robot(error):
    robot = checks.robot("panda")
    theta, bounds = parameters(robot), parameter_bounds(robot, error)
    apart = np.array([np.abs(parameters(perturbed(robot, error, seed)) - theta) for seed in range(200)])
    assert (apart <= bounds + 1e-12).all()
    # And are not bounds of anything: masses come near theirs.
    assert apart.max(axis=0)[::10].sum() > 0.9 * bounds[::10].sum()


def parameters(robot):
    return np.concatenate([body.toDynamicParameters() for body in list(robot.model.inertias)[1:]])


def perturbed(robot, error, seed):
    return robot.perturbed(mass=error, com=error, inertia=error, seed=seed)


def test_sliding_mode_bound_covers_the_effect_of_wrong_models(case):
    # The force on w of a wrong model, by the robots themselves and not by the regressor.
    controller = SlidingModeController(case.task, case.path, model_error=0.2)
    state = controller.start(case.t, case.rest, 0.0 * case.dq)
    found = controller.surface(case.t, case.q, case.dq, state)
    H = np.linalg.inv(np.vstack((case.J, state.chart.Wt)))
    dq_r = case.dq + H @ found.s
    # dJ dq_r + J ddq_r = ddz_r, with the rate of J by another difference.
    target, v = case.path(case.t), state.chart.v(case.q)
    ddw_r = np.concatenate((target.ddz + 10.0 * (target.dz - case.J @ case.dq), -10.0 * (state.chart.Wt @ case.dq)))
    after, before = (case.task.linearize(case.q + step * case.dq)[1] for step in (STEP, -STEP))
    ddw_r[: len(case.J)] -= (after - before) @ dq_r / (2.0 * STEP)
    ddq_r = H @ ddw_r
    dw_r = np.concatenate((target.dz + 10.0 * (target.z - case.task.value(case.q)), -10.0 * v))
    np.testing.assert_allclose(dq_r, H @ dw_r, atol=1e-9)
    nominal = passive_torque(case.robot, case.q, case.dq, dq_r, ddq_r)
    M_w = H.T @ case.M @ H
    L = np.linalg.cholesky(M_w)
    for seed in range(30):
        other = passive_torque(perturbed(case.robot, 0.2, seed), case.q, case.dq, dq_r, ddq_r)
        assert (np.abs(np.linalg.solve(L, H.T @ (other - nominal))) <= found.bound * (1.0 + 1e-6)).all()
    np.testing.assert_array_less(found.bound, found.force)
    # The distance has the energy of what is lacking.
    assert found.sigma @ found.sigma == pytest.approx(found.s @ M_w @ found.s)
    # The torque: the nominal one, and H⁻ᵀ of a force that is cut.
    force = L @ np.clip(50.0 * found.sigma, -found.force, found.force)
    np.testing.assert_allclose(found.layer, found.force / 50.0, rtol=1e-9)
    case_torque = controller.torque(case.t, case.q, case.dq, state)
    tau = nominal + np.linalg.solve(H.T, force)
    np.testing.assert_allclose(case_torque, tau, atol=DIFFERENCED * np.abs(tau).max())


@pytest.mark.usefixtures("unchecked")
def test_sliding_mode_stands_the_model_error_it_is_made_for():
    case = Case("panda", 1)
    controller = SlidingModeController(case.task, case.path, Track(), model_error=0.2)
    for seed in range(2):
        run = simulate_sampled(perturbed(case.robot, 0.2, seed), controller, REST, duration=1.5, control_period=2e-3)
        assert run.ok, run.message
        chart = controller.start(0.0, REST, 0.0 * REST)
        surfaces = [controller.surface(t, q, dq, chart) for t, q, dq in zip(run.t, run.q, run.dq, strict=True)]
        assert max(np.abs(each.sigma / each.layer).max() for each in surfaces[len(surfaces) // 2 :]) < 1.0


def test_sliding_mode_in_its_layer_is_eos_with_the_same_gains():
    case = Case("panda", 2)
    controller = SlidingModeController(case.task, case.path, rate=2.0, bandwidth=5.0)
    plain = EosController(case.task, case.path, Track(kp=10.0, kd=7.0), kp=10.0, kd=7.0)
    # At rest, where what is of second order in velocities vanishes.
    start, q, rest = controller.start(case.t, case.rest, 0.0 * case.dq), case.rest + 0.005, 0.0 * case.dq
    found = controller.surface(case.t, q, rest, start)
    assert (np.abs(found.sigma) < found.layer).all()
    tau = plain.torque(case.t, q, rest, plain.start(case.t, case.rest, rest))
    np.testing.assert_allclose(controller.torque(case.t, q, rest, start), tau, atol=1e-9)


def test_sliding_mode_refuses_arguments_that_do_not_fit():
    case = Case("panda", 1)
    with pytest.raises(InputError, match="Track"):
        SlidingModeController(case.task, case.path, Posture(REST))
    for name in ("rate", "bandwidth", "model_error"):
        with pytest.raises(InputError):
            SlidingModeController(case.task, case.path, **{name: -1.0})
    controller = SlidingModeController(case.task, case.path)
    with pytest.raises(InputError, match="rate and bandwidth"):
        controller.kp = 3.0


# -- all together ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_laws_bring_a_resting_robot_to_a_point_nearby():
    case = Case("panda", 1)
    goal = Hold(case.task.value(REST) + np.array([0.03, -0.02, 0.02]))
    posture = (case.task, goal, REST)
    laws = [
        *(kind(*posture) for kind in (ResolvedAcceleration, ResolvedVelocity, IntegratedVelocity, NullSpaceDynamics)),
        HierarchyController(*posture),
        LeastTorque(case.task, goal, damping=10.0),
        SlidingModeController(case.task, goal),
    ]
    for law in laws:
        run = simulate_sampled(case.robot, law, REST, duration=1.5, control_period=4e-3)
        assert run.ok, (law, run.message)
        assert np.abs(run.error[-1]).max() < 2e-3, law
        assert law.describe()["kind"] == type(law).__name__
