"""Continuous joints come wrapped or not, wherever joints are taken: encoders report one angle of many alike."""

from __future__ import annotations

import math
from types import SimpleNamespace

import checks
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eos_pin import (
    Atlas,
    Avoidance,
    Chart,
    ControlLoop,
    EosController,
    Hold,
    JointLimits,
    LimitedEosController,
    PositionTask,
    Posture,
    Robot,
    StateError,
    Track,
    load_robot,
    simulate,
    simulate_extended,
    simulate_sampled,
)
from eos_pin.control.operational import BASELINES
from eos_pin.simulation._recorder import joint_run
from eos_pin.simulation.kinematic import chart_following, rate_control
from eos_pin.trajectories.harmonic import circle

URDF = """<robot name="swivel">
  <link name="base"/>
  {links}
</robot>"""
LINK = """
  <link name="link{i}">
    <inertial><origin xyz="0 0.01 0.1"/><mass value="1.5"/>
      <inertia ixx="0.01" iyy="0.012" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="joint{i}" type="{kind}"><origin xyz="0 0 0.25"/><parent link="{parent}"/><child link="link{i}"/>
    <axis xyz="{axis}"/><limit lower="-2.5" upper="2.8" effort="80" velocity="4"/></joint>"""
KINDS = ("continuous", "revolute", "continuous", "continuous", "revolute", "continuous")
AXES = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "1 0 0", "0 1 0")
READY = np.array([0.4, 0.5, -0.3, 0.9, 0.2, -0.8])
TURNING = np.array([kind == "continuous" for kind in KINDS])


@pytest.fixture(scope="module")
def swivel(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Arm of six joints, four of them continuous and two with limits."""
    parents = ["base", *(f"link{i}" for i in range(1, 6))]
    rows = enumerate(zip(KINDS, parents, AXES, strict=True), 1)
    links = "".join(LINK.format(i=i, kind=kind, parent=parent, axis=axis) for i, (kind, parent, axis) in rows)
    path = tmp_path_factory.mktemp("swivel") / "swivel.urdf"
    path.write_text(URDF.format(links=links), encoding="utf-8")
    return load_robot(path)


@pytest.fixture(scope="module")
def task(swivel: Robot) -> PositionTask:
    return PositionTask(swivel, "link6")


@pytest.fixture(autouse=True)
def kernel_of_the_build(task: PositionTask) -> None:
    """The task keeps its kernel, and each build has its own."""
    vars(task).pop("kernel", None)


#: Whole turns that an encoder may be off, for each joint.
turned = arrays(np.int64, 6, elements=st.integers(-3, 3)).map(lambda k: math.tau * k * TURNING)


def wrapped(q: np.ndarray) -> np.ndarray:
    """What an encoder reports."""
    return np.where(TURNING, (q + np.pi) % math.tau - np.pi, q)


def same(one: object, other: object, tolerance: float = 1e-9) -> None:
    """Equal, compared with the largest entry."""
    size = max(1.0, float(np.abs(np.asarray(other)).max(initial=0.0)))
    np.testing.assert_allclose(one, other, rtol=0.0, atol=tolerance * size)  # type: ignore[arg-type]


def test_robot_lists_its_continuous_joints(swivel: Robot) -> None:
    assert swivel.continuous.tolist() == TURNING.tolist()
    assert [joint.kind for joint in swivel.joints] == list(KINDS)
    model = pin.Model()
    for i, joint in enumerate((pin.JointModelRX(), pin.JointModelPY(), pin.JointModelHZ(0.1), pin.JointModelRZ())):
        model.addJoint(i, joint, pin.SE3.Random(), f"joint{i}")
        model.appendBodyToJoint(i + 1, pin.Inertia.Random(), pin.SE3.Identity())
    model.upperPositionLimit[:] = [np.inf, np.inf, np.inf, 1.0]
    # A slider and a screw do not come back, and a joint with one limit has an end.
    assert Robot(model).continuous.tolist() == [True, False, False, False]


@given(q=arrays(float, 6, elements=st.floats(-20.0, 20.0)), goal=arrays(float, 6, elements=st.floats(-20.0, 20.0)))
def test_pull_to_a_posture_is_the_shorter_way_and_continuous(swivel: Robot, q: np.ndarray, goal: np.ndarray) -> None:
    way = swivel.way(q, goal)
    np.testing.assert_array_equal(way[~TURNING], (goal - q)[~TURNING])
    turn = (goal - q)[TURNING]
    shorter = np.arctan2(np.sin(turn), np.cos(turn))
    near = np.abs(shorter) < 0.75 * np.pi
    np.testing.assert_allclose(way[TURNING][near], shorter[near], atol=1e-12)
    assert (np.abs(way[TURNING]) <= np.abs(shorter) + 1e-12).all()
    assert (way[TURNING] * shorter >= -1e-12).all() or np.abs(np.abs(shorter) - np.pi).min() < 1e-9
    step = 1e-7 * np.ones(6)
    assert np.abs(swivel.way(q + step, goal) - way).max() <= 3.1e-7


@settings(max_examples=3)
@given(turn=turned, data=st.data())
def test_takers_of_joints_give_the_same_for_wrapped_joints(
    swivel: Robot, task: PositionTask, turn: np.ndarray, data: st.DataObject
) -> None:
    small = arrays(float, 6, elements=st.floats(-0.3, 0.3))
    base = READY + data.draw(small)
    q, dq = base + data.draw(small), data.draw(small)
    off = q + turn
    same(swivel.unwrap(off, near=q), q)

    chart = Chart.from_base(task, base)
    same(chart.v(off), chart.v(q))
    same(chart.u(off), chart.u(q))
    one, other = chart.point(off, dq), chart.point(q, dq)
    for name in ("v", "dw", "H", "E"):
        same(getattr(one, name), getattr(other, name))
    same(Chart.from_base(task, off, previous=chart).v_bar, chart.v(q))
    assert chart.room(off) == pytest.approx(chart.room(q))

    z, limits = task.value(base), JointLimits.from_robot(swivel, braking=5.0)
    posture, posture_off = base, base + turn
    for goal in (posture, posture_off):
        laws = [Posture(goal)] if goal is posture else [Posture(goal), Track(kp=10.0)]
        controllers = [
            *(EosController(task, Hold(z), law) for law in laws),
            *(LimitedEosController(task, Hold(z), law, limits=limits) for law in laws),
            *(make(task, Hold(z), goal) for make in BASELINES.values()),
        ]
        for controller in controllers:
            state = controller.start(0.0, base, dq)
            same(controller.torque(0.0, off, dq, state), controller.torque(0.0, q, dq, state), 1e-8)
            same(controller.step(0.0, off, dq, state)[0], controller.step(0.0, q, dq, state)[0], 1e-8)
            taus = [controller.torque(0.0, at, dq, controller.start(0.0, at, dq)) for at in (off, q)]
            same(taus[0], taus[1], 1e-8)
    same(Posture(posture_off).acceleration(0.0, q, dq, chart), Posture(posture).acceleration(0.0, q, dq, chart))
    # Obstacles are far; only the posture pulls.
    free = SimpleNamespace(robot=swivel, closest_pairs=lambda t, q, within: [])
    steps = []
    for goal, at in ((posture, q), (posture_off, q), (posture, off)):
        law = Avoidance.__new__(Avoidance)
        values = {
            "clearance": free,
            "influence_distance": 0.1,
            "room": 0.1,
            "posture": goal,
            "pull": 0.4,
            "damping": 3.0,
        }
        for name, value in (values | {"longest": 0.02}).items():
            object.__setattr__(law, name, value)
        steps.append(law.step(0.0, at, chart))
    same(steps[1], steps[0])
    same(steps[2], steps[0])


@settings(max_examples=3)
@given(turn=turned)
def test_inverse_kinematics_starts_from_wrapped_joints(swivel: Robot, task: PositionTask, turn: np.ndarray) -> None:
    q, atlas = READY, Atlas(task)
    path = task.value(q) + np.linspace(0.0, 0.15, 7)[:, None] * [0.0, 1.0, -0.5]
    for chart in (None, Chart.from_base(task, q + 0.1)):
        one, other = atlas.follow(q + turn, path, chart=chart), atlas.follow(q, path, chart=chart)
        assert one.complete
        same(one.v, other.v)
        # From a chart that is given they are near its base; else near where they came from.
        same(one.q - (turn if chart is None else 0.0), other.q)
        found = atlas.solve(q + turn, path[-1], chart=chart)
        assert found.found
        same(swivel.unwrap(found.q, q), swivel.unwrap(atlas.solve(q, path[-1], chart=chart).q, q))
    jumped = atlas.solve(q + turn, path[-1], strategies=["search"])
    assert jumped.found
    assert (np.abs(jumped.q - q - turn)[TURNING] <= np.pi + 1e-9).all()


def motion(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Three turns of the first joint and one or two of others, to and fro, through every seam."""
    much = np.array([19.5, 0.2, 8.0, -13.0, 0.3, 7.0])
    return READY + 0.5 * much * (1.0 - math.cos(2.0 * t)), much * math.sin(2.0 * t)


def controllers(task: PositionTask) -> list[EosController]:
    path = circle(task.value(READY), 0.1, period=2.0)
    return [
        EosController(task, path, Track([0.2, 0.0, -0.1])),
        EosController(task, path, Posture(READY + math.tau)),
        EosController(task, path, Track(circle([0.0, 0.0, 0.0], 0.1, period=2.0))),
        LimitedEosController(task, path),
        BASELINES["null-space-posture"](task, path, READY),  # type: ignore[list-item]
    ]


LAWS = ["v held", "posture", "v on a circle", "limited", "operational space"]


@pytest.mark.usefixtures("unchecked", "build")
@pytest.mark.parametrize(("noise", "jump"), [(0.0, math.inf), (3e-3, 0.4)])
@pytest.mark.parametrize("law", range(len(LAWS)), ids=LAWS)
def test_control_loop_accepts_wrapped_angles(
    swivel: Robot, task: PositionTask, noise: float, jump: float, law: int
) -> None:
    random = np.random.default_rng(1)
    states = [(t, *motion(t)) for t in np.arange(0.0, 3.2, 1e-2)]
    states = [(t, q + noise * random.normal(size=6), dq) for t, q, dq in states]
    controller = controllers(task)[law]
    loops = ControlLoop(controller, jump=jump), ControlLoop(controller, jump=jump)
    for t, q, dq in states:
        tau, seen = loops[0].step(t, q, dq), loops[1].step(t, wrapped(q), dq)
        same(seen, tau, 1e-7)
    same(loops[1].task_deficit(t, wrapped(q), dq), loops[0].task_deficit(t, q, dq), 1e-6)


@pytest.mark.usefixtures("unchecked", "build")
def test_control_loop_counts_turns_while_joints_rest_at_the_seam(swivel: Robot, task: PositionTask) -> None:
    """Noise throws an angle at the seam to and fro by a whole turn, each time a state of its own."""
    q = np.array([np.pi, 0.5, -np.pi, 0.9, 0.2, np.pi])
    random = np.random.default_rng(2)
    loop, still = ControlLoop(EosController(task, Hold(task.value(q)))), np.zeros(6)
    for k in range(200):
        noise = 1e-4 * random.normal(size=6)
        tau = loop.step(1e-3 * k, wrapped(q + noise), still)
        # 1e-4 rad are worth about that much of the gain.
        assert np.abs(tau - swivel.gravity(q)).max() < 1.0


@pytest.mark.usefixtures("unchecked", "build")
def test_control_loop_looks_ahead_over_a_gap(swivel: Robot, task: PositionTask) -> None:
    loop, speed = ControlLoop(EosController(task, Hold(task.value(READY)))), np.array([5.0, 0, 0, 0, 0, 0])
    other = ControlLoop(loop.controller)
    for loop_, shape in ((loop, wrapped), (other, np.array)):
        loop_.step(0.0, shape(READY), speed)
        # 5 rad later: less than a turn further, and not 1.28 rad back.
        loop_.step(1.0, shape(READY + speed), speed)
    assert loop.state.chart.v(READY) == pytest.approx(other.state.chart.v(READY), abs=1e-9)


@pytest.mark.usefixtures("unchecked", "build")
def test_control_loop_refuses_a_jump_of_wrapped_angles_once(swivel: Robot, task: PositionTask) -> None:
    loop, still = ControlLoop(EosController(task, Hold(task.value(READY)))), np.zeros(6)
    loop.step(0.0, READY, still)
    there = wrapped(READY + 3.0 * np.eye(6)[0])
    with pytest.raises(StateError, match=r"q\[0\] jumped by 3 in"):
        loop.step(0.001, there, still)
    assert np.isfinite(loop.step(0.002, there, still)).all()
    with pytest.raises(StateError, match="6 numbers"):
        loop.step(0.003, np.zeros(5), still)
    # A joint with limits has no turns to count.
    with pytest.raises(StateError, match=r"q\[1\] jumped by 6"):
        loop.step(0.004, there + math.tau * np.eye(6)[1], still)


@pytest.mark.usefixtures("unchecked", "build")
def test_control_loop_closed_over_several_turns(swivel: Robot, task: PositionTask) -> None:
    """The base turns round and round under a task that does not feel it: v goes on, through chart after chart."""
    task = PositionTask(swivel, "link6", "z")
    z, turns = task.value(READY), np.zeros(5)
    along = Chart.from_base(task, READY).Vt[:, 0]
    turns[:] = 14.0 * along / np.linalg.norm(along)
    goal = Track(turns, kp=16.0, kd=8.0)
    ends = []
    for shape in (np.array, wrapped):
        loop, q, dq = ControlLoop(EosController(task, Hold(z), goal)), READY, np.zeros(6)
        for k in range(2500):
            tau = loop.step(2e-3 * k, shape(q), dq)
            dq = dq + 2e-3 * swivel.forward_dynamics(q, dq, tau)
            q = q + 2e-3 * dq
        ends.append(q)
        assert np.abs(task.value(q) - z).max() < 2e-3
    assert np.abs(ends[0] - READY)[TURNING].max() > math.tau
    same(ends[1], ends[0], 1e-6)


@pytest.mark.usefixtures("unchecked")
def test_runs_from_wrapped_joints_are_the_same(swivel: Robot, task: PositionTask) -> None:
    turn = math.tau * np.array([1, 0, -2, 1, 0, -1])
    path = circle(task.value(READY), 0.05, period=0.3)

    def runs(q: np.ndarray) -> list:
        return [
            simulate(swivel, EosController(task, path, Posture(READY)), q, duration=0.6),
            simulate_extended(swivel, EosController(task, path), q, atlas=Atlas(task), duration=0.6),
            simulate_sampled(swivel, EosController(task, path), q, duration=0.6),
            chart_following(task, path, q, duration=0.6),
            rate_control(task, path, q, duration=0.6),
        ]

    for one, other in zip(runs(READY + turn), runs(READY), strict=True):
        assert one.ok
        same(one.q - turn, other.q, 1e-6)
        same(one.tau, other.tau, 1e-5)
        same(one.joint_drift_per_cycle, other.joint_drift_per_cycle, 1e-6)


def test_whole_turns_are_counted_beside_the_drift(swivel: Robot, task: PositionTask, tmp_path) -> None:
    t = np.linspace(0.0, 3.0, 31)
    q = READY + np.outer(t, [math.tau, 0.01, -2.0 * math.tau, 0.0, 0.0, 0.02])
    z = np.array([task.value(row) for row in q])
    for joints, turns in ((q, [2, 2, 2]), (wrapped(q), [0, 0, 0])):
        run = joint_run(task, t, joints, z, period=1.0)
        np.testing.assert_allclose(run.joint_drift_per_cycle, 0.02, atol=1e-12)
        assert run.summary()["joint_turns_per_cycle"] == turns
    run = joint_run(task, t, q, z, period=1.0)
    assert run.turns_per_cycle.tolist() == [[1, 0, -2, 0, 0, 0]] * 3
    assert type(run).load(run.save(tmp_path / "run")).turns_per_cycle.tolist() == run.turns_per_cycle.tolist()
    # A whole turn of a joint with limits is a drift.
    moved = READY + np.outer(t, [0.0, math.tau, 0.0, 0.0, 0.0, 0.0])
    run = joint_run(task, t, moved, z, period=1.0)
    np.testing.assert_allclose(run.joint_drift_per_cycle, math.tau)


def test_robot_without_continuous_joints_keeps_every_angle() -> None:
    panda = checks.robot("panda")
    q = np.full(7, 9.0)
    assert not panda.turns
    assert panda.unwrap(q, np.zeros(7)) is q
    np.testing.assert_array_equal(panda.way(q, np.zeros(7)), -q)
