"""Impedance in (z, v): springs that have an energy, pushes in MuJoCo, damping, modes, and gains that are refused."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from checks import REST
from hypothesis import given
from hypothesis import strategies as st

from eos_pin import (
    Atlas,
    AxisTask,
    ControlLoop,
    ForceGoal,
    Friction,
    ImpedanceController,
    InputError,
    MujocoPlant,
    OrientationTask,
    PoseTask,
    PoseTrajectory,
    PositionTask,
    Robot,
    Safety,
    TaskForce,
    circle,
    figure_eight,
    simulate,
    simulate_sampled,
)
from eos_pin.control.compliant.gains import damping_of
from eos_pin.control.compliant.observer import MomentumObserver
from eos_pin.control.compliant.safety import yielded
from eos_pin.control.rivals.projected import ProjectedImpedance
from eos_pin.experiments.options import ControlOptions

TIP = "panda_hand_tcp"
TASKS = {"position": PositionTask, "orientation": OrientationTask, "pose": PoseTask}
PERIOD = 1e-3
pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture
def pose(panda: Robot) -> PoseTask:
    return PoseTask(panda, TIP)


def full(size: int, seed: int) -> np.ndarray:
    """A symmetric positive matrix with entries everywhere."""
    X = np.random.default_rng(seed).normal(size=(size, size))
    return 50.0 * (X @ X.T + np.eye(size))


@pytest.mark.parametrize("clip", [None, {"m": 0.05, "rad": 0.3, "v": 0.2}], ids=["linear", "clipped"])
@pytest.mark.parametrize("axes", ["world", "tool"])
@pytest.mark.parametrize("kind", TASKS)
def test_springs_are_gradients_of_their_energy(panda, kind, axes, clip) -> None:
    task = TASKS[kind](panda, TIP)
    if axes == "tool" and kind == "position":
        return
    stiffness = full(task.m, 1)
    if kind == "pose" and clip:
        # Clips are for the springs of lengths and of angles apart.
        stiffness[:3, 3:] = stiffness[3:, :3] = 0.0
    controller = ImpedanceController(
        task, task.hold(REST), stiffness=stiffness, self_motion_stiffness=full(7 - task.m, 2), axes=axes,
        largest_error=clip,
    )  # fmt: skip
    law = controller.start(0.0, REST, 0.0 * REST).laws[0]
    random = np.random.default_rng(3)
    for spread in (0.05, 0.4, 1.5):
        q = REST + spread * random.normal(size=7)
        tau = law.pull(0.0, q, *task.linearize(q))
        ends = [[law.energy(0.0, x, task.value(x)) for x in (q + h, q - h)] for h in 1e-6 * np.eye(7)]
        slope = np.array([(plus - minus) / 2e-6 for plus, minus in ends])
        np.testing.assert_allclose(tau, -slope, atol=1e-6 * max(1.0, np.abs(slope).max()))


def test_rotation_spring_is_smooth_half_a_turn_away(panda: Robot) -> None:
    task = OrientationTask(panda, TIP)
    controller = ImpedanceController(task, task.hold(REST), stiffness=full(3, 4), self_motion_stiffness=0.0)
    law = controller.start(0.0, REST, 0.0 * REST).laws[0]
    R = task.value(REST).reshape(3, 3)
    turned = [(pin.exp3(angle * np.array([0.6, 0.0, 0.8])) @ R).ravel() for angle in (math.pi - 1e-7, math.pi + 1e-7)]
    J = task.linearize(REST)[1]
    one, other = (law.pull(0.0, REST, z, J) for z in turned)
    np.testing.assert_allclose(one, other, atol=1e-3)


def test_damping_ratio_is_that_of_every_mode() -> None:
    M, K = full(7, 5), full(7, 6)
    D = damping_of(M, K, 0.6)
    companion = np.block([[np.zeros((7, 7)), np.eye(7)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    roots = np.linalg.eigvals(companion)
    np.testing.assert_allclose(-roots.real / np.abs(roots), 0.6, atol=1e-9)


# -- pushes ------------------------------------------------------------------------------------------------------------


def settled(controller, q, torque, duration=4.0):
    """Joints at rest, and memory, in MuJoCo under torques that are a function of the joints."""
    plant, loop, dq = MujocoPlant.from_robot(controller.robot), ControlLoop(controller), np.zeros(7)
    for k in range(round(duration / PERIOD)):
        q, dq = plant.advance(q, dq, loop.step(k * PERIOD, q, dq) + torque(q), PERIOD)
    assert np.abs(dq).max() < 1e-5
    return q, loop.state


def test_push_at_elbow_moves_tool_by_its_share_only(pose: PoseTask) -> None:
    controller = ImpedanceController(
        pose, pose.hold(REST), stiffness={"m": 1000.0, "rad": 50.0}, self_motion_stiffness=20.0
    )
    elbow = PositionTask(pose.robot, "panda_link4")
    way = elbow.linearize(REST)[1] @ np.linalg.svd(pose.linearize(REST)[1])[2][-1]
    push = TaskForce(elbow, lambda t: 20.0 * way / np.linalg.norm(way))
    q, state = settled(controller, REST, lambda q: push.torque(0.0, q))
    z, J = pose.linearize(q)
    Q = np.linalg.solve(np.vstack((J, state.chart.Wt)).T, push.torque(0.0, q))
    moved = pose.minus(z, pose.value(REST))
    np.testing.assert_allclose(moved, Q[:6] / np.r_[[1e3] * 3, [50.0] * 3], rtol=0.02, atol=1e-6)
    np.testing.assert_allclose(state.chart.v(q), Q[6:] / 20.0, rtol=1e-6)


def test_push_at_tool_meets_stiffness_of_task(pose: PoseTask) -> None:
    controller = ImpedanceController(pose, pose.hold(REST), stiffness=[400.0, 800.0, 1600.0, 50.0, 50.0, 50.0])
    push = TaskForce(pose, lambda t: [10.0, 10.0, 10.0, 0.0, 0.0, 0.0])
    q, state = settled(controller, REST, lambda q: push.torque(0.0, q))
    moved = pose.minus(pose.value(q), pose.value(REST))
    np.testing.assert_allclose(moved[:3], [10.0 / 400.0, 10.0 / 800.0, 10.0 / 1600.0], rtol=1e-3)
    # The elbow does not feel it.
    np.testing.assert_allclose(state.chart.v(q), 0.0, atol=1e-9)


@pytest.mark.parametrize("consistency", ["static", "dynamic", "stiffness"])
def test_projectors_are_consistent_with_their_weighting(pose: PoseTask, consistency: str) -> None:
    K_q = np.array([30.0, 30.0, 30.0, 30.0, 10.0, 10.0, 10.0])
    law = ProjectedImpedance(
        pose, pose.hold(REST), REST + 0.1, consistency=consistency, stiffness={"m": 900.0, "rad": 40.0},
        joint_stiffness=K_q,
    )  # fmt: skip
    weight = {"static": np.eye(7), "dynamic": pose.robot.mass(REST), "stiffness": np.diag(K_q)}[consistency]
    tau = law.torque(0.0, REST, 0.0 * REST, None) - pose.robot.gravity(REST)
    J = pose.linearize(REST)[1]
    np.testing.assert_allclose(J @ np.linalg.solve(weight, tau), 0.0, atol=1e-10)
    # Along the self-motion the pull is that of the posture.
    own = np.linalg.svd(J)[2][-1]
    np.testing.assert_allclose(own @ tau, own @ (0.1 * K_q), rtol=1e-9)


# -- moving targets ----------------------------------------------------------------------------------------------------


def test_moving_targets_are_followed_without_error(pose: PoseTask) -> None:
    place = pose.robot.placement(REST, TIP)
    turning = PoseTrajectory(
        position=circle(place.translation, 0.08, period=3.0, plane="yz"), orientation=place.rotation
    )
    W = np.linalg.svd(pose.linearize(REST)[1])[2][-1]

    def swing(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        w = 2.0
        return REST + 0.2 * math.sin(w * t) * W, 0.2 * w * math.cos(w * t) * W, -0.2 * w * w * math.sin(w * t) * W

    controller = ImpedanceController(
        pose, turning, posture=swing, damping_ratio=1.0, stiffness={"m": 2e3, "rad": 200.0}
    )
    result = simulate(pose.robot, controller, REST, duration=3.0)
    assert result.ok
    assert np.abs(result.error[-20:]).max() < 1e-4
    chart, t = controller.start(0.0, REST, REST).chart, result.t[-1]
    assert np.abs(chart.v(result.q[-1]) - chart.v(swing(t)[0])).max() < 1e-3


def test_run_counts_changes_of_charts_and_not_those_of_the_memory(task: PositionTask) -> None:
    path = figure_eight(task.value(REST), 0.1, period=2.0, plane="yz")
    controller = ImpedanceController(task, path, atlas=Atlas(task, threshold=0.97, metric="inertial"))
    run = simulate_sampled(task.robot, controller, REST, duration=0.5, control_period=2e-3)
    assert len(run.switches) == run.chart[-1] > 0


def test_feedforward_is_bounded_up_to_the_edge_of_its_chart(task: PositionTask) -> None:
    """A law that fades out may be carried there, where [G'; Wᵀ] is singular."""
    path = figure_eight(task.value(REST), 0.1, period=2.0, plane="yz")
    both = [
        ImpedanceController(task, path, feedforward=on, atlas=Atlas(task, metric="inertial")) for on in (True, False)
    ]
    laws = [controller.start(0.0, REST, 0.0 * REST).laws[0] for controller in both]
    way, dq, sizes, margins = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0]), np.full(7, 0.3), [], []
    for s in np.linspace(0.0, 1.2, 250):
        z, J = task.linearize(REST + s * way)
        one, other = (law.torque(0.3, REST + s * way, dq, z, J) for law in laws)
        sizes.append(np.abs(one - other).max())
        margins.append(laws[0].chart.margin(J))
    assert min(margins) < 0.02
    assert max(sizes) < 10.0 * sizes[0]
    # Well inside nothing is taken away: it is what errors need to obey their equation.
    assert sizes[int(np.argmax(np.array(margins) < 0.7))] > 0.3 * sizes[0]


def test_feedforward_is_gone_where_targets_rest(pose: PoseTask) -> None:
    """A target that comes to rest leaves the law of one that is held, whatever the speed."""
    z, rest = pose.value(REST), np.zeros(7)
    moving = PoseTrajectory(position=circle(z[:3], 1e-12, period=3.0), orientation=z[3:].reshape(3, 3))
    q, dq = REST + 0.05, np.linspace(-1.0, 1.0, 7)
    one, other = (
        (law := ImpedanceController(pose, reference)).torque(0.0, q, dq, law.start(0.0, REST, rest))
        for reference in (moving, pose.hold(REST))
    )
    np.testing.assert_allclose(one, other, atol=1e-6)


# -- gains that are refused --------------------------------------------------------------------------------------------

ASYMMETRIC = np.diag([500.0] * 6) + np.eye(6, k=1)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"stiffness": [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]}, "at least 0 in every direction"),
        ({"stiffness": ASYMMETRIC}, "must be symmetric"),
        ({"stiffness": np.diag([500.0] * 6) - 600.0 * np.ones((6, 6))}, "least eigenvalue"),
        ({"stiffness": 500.0}, "for coordinates in m and rad"),
        ({"stiffness": [500.0, 500.0]}, "got shape"),
        ({"stiffness": {"m": 500.0}}, "lacks rx, ry, rz"),
        ({"stiffness": {"m": 500.0, "deg": 50.0}}, "no unit or label"),
        ({"stiffness": [math.nan] * 6}, "must be finite"),
        ({"damping": -2.0 * np.eye(6)}, "the damping must be at least 0"),
        ({"damping_ratio": 0.0}, "the damping ratio must be"),
        ({"damping_ratio": 70.0}, "0.7 is usual"),
        ({"self_motion_stiffness": -3.0}, "the self-motion stiffness must be at least 0"),
        ({"self_motion_stiffness": [1.0, 2.0]}, "got shape"),
        ({"axes": "base"}, "axes must be 'world' or 'tool'"),
        ({"posture": [0.0, 0.0]}, "the posture must be 7 numbers"),
        ({"posture": "there"}, "the posture must be"),
        ({"largest_error": {"mm": 3.0}}, "largest_error must be"),
        ({"blend": 0.0}, "the time of a blend"),
        ({"tank": -1.0}, "the energy of the tank"),
    ],
)
def test_gains_without_sense_are_refused(pose: PoseTask, settings, words: str) -> None:
    with pytest.raises(InputError, match=words):
        ImpedanceController(pose, pose.hold(REST), **settings)


def test_impedance_refuses_wrong_frames_and_tasks(panda: Robot, task: PositionTask) -> None:
    with pytest.raises(InputError, match="has not"):
        ImpedanceController(task, task.hold(REST), axes="tool")
    axis = AxisTask(panda, TIP)
    with pytest.raises(InputError, match="fixed axes"):
        ImpedanceController(axis, axis.hold(REST))


# -- modes and energy --------------------------------------------------------------------------------------------------


def energy(controller, t, q, dq, state):
    found = controller.energies(t, q, dq, state)
    return found.kinetic + found.springs + found.tank


def test_modes_change_without_jump_and_without_energy(pose: PoseTask) -> None:
    soft = ImpedanceController(pose, pose.hold(REST), stiffness={"m": 300.0, "rad": 20.0}, tank=0.3)
    modes = [soft.with_mode(stiffness={"m": 3000.0, "rad": 200.0}), soft.led("elbow"), soft.led("tool"), soft]
    plant, loop = MujocoPlant.from_robot(pose.robot), ControlLoop(soft)
    q, dq, last, work, energies = REST + 0.1, np.zeros(7), None, 0.0, []
    start = energy(soft, 0.0, q, dq, soft.start(0.0, q, dq))
    for k in range(2000):
        t = k * PERIOD
        if k % 400 == 200:
            loop.controller = modes[k // 400 % 4]
        push = 20.0 * np.sin(5.0 * t) * np.array([0.0, 1.0, -0.5, 0.2, 0.0, 0.1, 0.0])
        tau = loop.step(t, q, dq)
        assert last is None or np.abs(tau - last).max() < 1.5, k
        assert loop.state.tank >= 0.0
        q_next, dq = plant.advance(q, dq, tau + push, PERIOD)
        work += push @ (q_next - q)
        q, last = q_next, tau
        energies.append(energy(loop.controller, t, q, dq, loop.state) - start - work)
    assert max(energies) < 0.02


def test_modes_in_quick_succession_wait_for_the_tank(pose: PoseTask) -> None:
    """An arm at rest fills no tank, so no mode may bring in energy, however soon the next one follows."""
    soft = ImpedanceController(pose, pose.hold(REST), stiffness={"m": 300.0, "rad": 20.0}, tank=0.0)
    loop, q, rest, energies = ControlLoop(soft), REST + 0.1, np.zeros(7), []
    for k in range(40):
        loop.controller = soft.with_mode(stiffness={"m": 400.0 + 100.0 * k, "rad": 20.0})
        loop.step(0.02 * k, q, rest)
        energies.append(energy(loop.controller, 0.02 * k, q, rest, loop.state))
    np.testing.assert_allclose(energies, energies[0], rtol=1e-12)


@pytest.mark.parametrize("shaped", [False, True])
def test_powers_are_the_rate_of_the_energy(pose: PoseTask, shaped: bool) -> None:
    """Kinetic and spring energy, by differences along the motion, with moving targets and every addition."""
    robot, place, push = pose.robot, pose.robot.placement(REST, TIP), np.array([0.0, 8.0, 0.0, 0.0, 0.5, 0.0])
    path = PoseTrajectory(position=circle(place.translation, 0.1, period=2.0, plane="yz"), orientation=place.rotation)
    W = np.linalg.svd(pose.linearize(REST)[1])[2][-1]
    controller = ImpedanceController(
        pose, path, posture=lambda t: (REST + 0.3 * math.sin(t) * W, 0.3 * math.cos(t) * W, -0.3 * math.sin(t) * W),
        wrench=lambda t: push, inertia={"m": 6.0, "rad": 0.3} if shaped else None, compensate_external=not shaped,
        safety=Safety(velocity_cutoff=20.0, friction=Friction(viscous=0.5), limit_stiffness=20.0, limit_zone=2.0),
    )  # fmt: skip
    loop, q, dq, step = ControlLoop(controller), REST + 0.05, np.linspace(-0.5, 0.5, 7), 1e-5
    for k in range(30):
        loop.step(k * PERIOD, q, dq)
        q, dq = q + PERIOD * dq, dq - 0.002
    t, state, external = 29 * PERIOD, loop.state, pose.linearize(q)[1].T @ push
    ddq = robot.forward_dynamics(q, dq, controller.torque(t, q, dq, state) + external)
    ends = [controller.energies(t + s, q + s * dq, dq + s * ddq, state) for s in (-step, step)]
    rate = sum(sign * (end.kinetic + end.springs) for sign, end in zip((-1.0, 1.0), ends, strict=True)) / (2.0 * step)
    found = controller.energies(t, q, dq, state)
    assert len(found.injected) == 5
    assert all(abs(power) > 1e-4 for power in found.injected.values()), found.injected
    assert sum(found.injected.values()) - found.damping + external @ dq == pytest.approx(rate, rel=1e-5)


@given(st.integers(0, 1000))
def test_law_is_finite_at_any_state(panda: Robot, seed: int) -> None:
    random = np.random.default_rng(seed)
    pose = PoseTask(panda, TIP)
    controller = ImpedanceController(pose, pose.hold(REST))
    state = controller.start(0.0, REST, 0.0 * REST)
    q, dq = random.uniform(-math.pi, math.pi, 7), random.normal(size=7)
    assert np.isfinite(controller.torque(0.0, q, dq, state)).all()
    tau, later = controller.step(1.0, q, dq, state)
    assert np.isfinite(tau).all()
    # A step returns the torque of the memory that it returns.
    np.testing.assert_array_equal(tau, controller.torque(1.0, q, dq, later))


# -- external forces, safety -------------------------------------------------------------------------------------------


def test_observer_finds_a_held_torque_in_a_moving_arm(panda: Robot) -> None:
    observer, plant = MomentumObserver(panda, 100.0), MujocoPlant.from_robot(panda)
    q, dq, push = REST.copy(), np.linspace(-0.5, 0.5, 7), np.array([3.0, -2.0, 1.0, 4.0, 0.5, -0.3, 0.2])
    observed = observer.start(0.0, q, dq)
    for k in range(200):
        tau = panda.gravity(q) + np.sin(9.0 * k * PERIOD) * np.array([5.0, 5.0, 2.0, 2.0, 0.5, 0.3, 0.1])
        q, dq = plant.advance(q, dq, tau + push, PERIOD)
        observed = observer.update((k + 1) * PERIOD, q, dq, observed, tau)
    np.testing.assert_allclose(observed.external, push, atol=0.02)


def test_compensation_keeps_tool_still_under_push_at_elbow(pose: PoseTask) -> None:
    controller = ImpedanceController(pose, pose.hold(REST), observer=50.0, compensate_external=True)
    push = TaskForce(PositionTask(pose.robot, "panda_link4"), lambda t: [10.0, 15.0, 5.0])
    q, state = settled(controller, REST, lambda q: push.torque(0.0, q))
    assert np.abs(pose.minus(pose.value(q), pose.value(REST))[:3]).max() < 1e-6
    assert np.abs(state.chart.v(q)).max() > 0.01
    powers = controller.energies(4.0, q, 0.0 * q + 0.1, state).injected
    assert set(powers) == {"moving targets", "compensation of external forces"}


@pytest.mark.parametrize(("mass", "observer", "off"), [(8.0, None, 0.01), (2.0, None, 0.01), (4.0, 400.0, 0.1)])
def test_designed_inertia_is_that_of_the_response(
    pose: PoseTask, mass: float, observer: float | None, off: float
) -> None:
    """A sudden push is answered as by a mass on a spring with a damper, in closed form."""
    push, K, zeta = np.array([0.0, 6.0, 0.0, 0.0, 0.0, 0.0]), 800.0, 0.5
    controller = ImpedanceController(
        pose, pose.hold(REST), stiffness={"m": K, "rad": 60.0}, inertia={"m": mass, "rad": 0.1}, damping_ratio=zeta,
        observer=observer, wrench=None if observer else lambda t: push,
    )  # fmt: skip
    plant, loop, force = MujocoPlant.from_robot(pose.robot), ControlLoop(controller), TaskForce(pose, lambda t: push)
    q, dq, moved = REST, np.zeros(7), []
    for k in range(400):
        tau = loop.step(k * PERIOD, q, dq)
        moved.append(pose.minus(pose.value(q), pose.value(REST)))
        q, dq = plant.advance(q, dq, tau + force.torque(0.0, q), PERIOD)
    t, w = PERIOD * np.arange(400), math.sqrt(K / mass)
    wd = w * math.sqrt(1.0 - zeta**2)
    answer = (6.0 / K) * (1.0 - np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t)))
    found = np.array(moved)
    assert np.abs(found[:, 1] - answer).max() < off * answer.max()
    assert np.abs(found[:, [0, 2]]).max() < off * answer.max()
    assert "inertia shaping" in controller.energies(0.4, q, dq, loop.state).injected


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"inertia": {"m": 5.0, "rad": 0.1}}, "external forces must be known"),
        ({"inertia": {"m": 0.0, "rad": 0.1}, "observer": 50.0}, "above 0"),
        ({"inertia": [1.0] * 6, "observer": 50.0, "compensate_external": True}, "give one of the three"),
        ({"compensate_external": True}, "external forces must be known"),
        ({"force": ForceGoal({"z": -5.0})}, "external forces must be known"),
        ({"force": ForceGoal({"up": -5.0}), "observer": 50.0}, "no coordinate of the task"),
        ({"observer": 0.0}, "the rate of the observer"),
    ],
)
def test_forces_without_sense_are_refused(pose: PoseTask, settings, words: str) -> None:
    with pytest.raises(InputError, match=words):
        ImpedanceController(pose, pose.hold(REST), **settings)


def test_safety_refuses_friction_without_torque() -> None:
    with pytest.raises(InputError, match=r"torque\(dq\)"):
        Safety(friction=0.3)
    with pytest.raises(InputError, match="the cutoff"):
        Safety(velocity_cutoff=0.0)


@pytest.mark.parametrize("axes", ["world", "tool"])
def test_force_goal_is_reached_against_a_soft_wall(pose: PoseTask, axes: str) -> None:
    """A wall of 5 kN/m below the tool, or in front of it along its own slanting z-axis, felt through the observer."""
    goal = ForceGoal({"z": 10.0 if axes == "tool" else -10.0})
    controller = ImpedanceController(pose, pose.hold(REST), force=goal, observer=100.0, damping_ratio=1.0, axes=axes)
    z, force = pose.value(REST), []
    into = z[3:].reshape(3, 3)[:, 2] if axes == "tool" else np.array([0.0, 0.0, -1.0])
    across = np.eye(3) - np.outer(into, into)

    def wall(q: np.ndarray) -> np.ndarray:
        here, J = pose.linearize(q)
        force.append(5000.0 * max(into @ (here[:3] - z[:3]) - 0.002, 0.0))
        return -force[-1] * into @ J[:3]

    q, _ = settled(controller, REST, wall, duration=3.0)
    assert abs(force[-1] - 10.0) < 0.05
    assert np.abs(across @ pose.minus(pose.value(q), z)[:3]).max() < 1e-3


def test_self_motion_yields_before_the_task() -> None:
    tau, own, limits = np.array([5.0, -9.0]), np.array([1.0, -4.0]), np.array([10.0, 7.0])
    np.testing.assert_allclose(yielded(tau, own, limits), [4.5, -7.0])
    np.testing.assert_allclose(yielded(tau, own, np.array([10.0, 4.0])), [4.0, -5.0])
    np.testing.assert_allclose(yielded(tau, own, np.array([10.0, 20.0])), tau)


def test_joint_limits_push_self_motion_only(pose: PoseTask) -> None:
    q = REST.copy()
    plain = ImpedanceController(pose, pose.hold(q))
    guarded = plain.with_mode(safety=Safety(limit_stiffness=100.0, limit_zone=4.0))
    rest = 0.0 * q
    one, other = (law.torque(0.0, q, rest, law.start(0.0, q, rest)) for law in (guarded, plain))
    more = one - other
    chart = plain.start(0.0, q, rest).chart
    assert np.abs(more).max() > 1.0
    np.testing.assert_allclose(more, chart.V @ (chart.V.T @ more), atol=1e-10)


def test_modes_with_additions_change_without_jump(pose: PoseTask) -> None:
    friction = Friction(viscous=0.3, coulomb=0.2)
    full = ImpedanceController(
        pose, pose.hold(REST), observer=50.0, compensate_external=True,
        safety=Safety(velocity_cutoff=50.0, friction=friction, limit_stiffness=20.0, limit_zone=1.0),
    )  # fmt: skip
    bare = full.with_mode(observer=None, compensate_external=False, safety=None)
    plant, loop = MujocoPlant.from_robot(pose.robot), ControlLoop(full)
    q, dq, last = REST + 0.05, np.zeros(7), None
    for k in range(800):
        if k % 200 == 100:
            loop.controller = (bare, full)[k // 200 % 2]
        tau = loop.step(k * PERIOD, q, dq)
        assert k % 200 != 100 or np.abs(tau - last).max() < 0.3, k
        last = tau
        q, dq = plant.advance(q, dq, tau + np.array([5.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]) * min(k / 50, 1.0), PERIOD)


@pytest.mark.parametrize(
    ("kind", "given", "diagonal"),
    [
        ("pose", (800.0, 30.0), [800.0] * 3 + [30.0] * 3),
        ("pose", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        ("position", (700.0,), [700.0] * 3),
        ("position", (), [1000.0] * 3),
    ],
)
def test_options_make_an_impedance(panda: Robot, kind: str, given: tuple[float, ...], diagonal: list[float]) -> None:
    task = TASKS[kind](panda, TIP)
    options = ControlOptions(controller="impedance", stiffness=given, self_motion_stiffness=7.0)
    controller = options.make(task, task.hold(REST), REST, 1e-3)
    assert isinstance(controller, ImpedanceController)
    np.testing.assert_array_equal(np.diag(controller.gains.stiffness), diagonal)
    np.testing.assert_array_equal(np.diag(controller.gains.self_motion_stiffness), 7.0)
