"""What is changed while a loop runs counts from the next step on, or is refused; compiled and not alike."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable

import numpy as np
import pytest
from checks import REST

from eos_pin import (
    Atlas,
    ControlLoop,
    Damp,
    EosController,
    EosError,
    Hold,
    InputError,
    JointLimits,
    LimitedEosController,
    OpenLoop,
    OperationalSpaceController,
    OrientationTask,
    PoseTask,
    PositionTask,
    Posture,
    PostureNullSpace,
    Robot,
    SingularError,
    StackedTrajectory,
    Target,
    Track,
    Trajectory,
    circle,
    simulate_sampled,
)
from eos_pin.control.operational import BASELINES
from eos_pin.experiments.options import RunOptions

STATE = REST + 0.02, np.array([0.1, -0.2, 0.05, 0.1, 0.0, -0.1, 0.2])
TIP = "panda_hand_tcp"
AHEAD = np.array([0.1, 0.0, 0.0])
NEW = np.array([0.4, -0.1, 0.2, 0.0])


@pytest.fixture
def task(panda: Robot) -> PositionTask:
    return PositionTask(panda, TIP)


def loop_of(controller: EosController) -> ControlLoop:
    """A loop that runs, with its chart at REST."""
    loop = ControlLoop(controller)
    loop.step(0.0, REST, np.zeros(7))
    return loop


def expected(controller: EosController) -> np.ndarray:
    """The torque of a fresh loop with the new controller, begun at the same state."""
    fresh = loop_of(controller)
    return fresh.step(0.001, *STATE)


CHANGES: dict[str, tuple[Callable[[EosController], None], dict]] = {
    "kp": (lambda c: setattr(c, "kp", 300.0), {"kp": 300.0}),
    "kd": (lambda c: setattr(c, "kd", [5.0, 10.0, 15.0]), {"kd": [5.0, 10.0, 15.0]}),
    "self_motion": (lambda c: setattr(c, "self_motion", Track(NEW)), {"self_motion": Track(NEW)}),
    "another kind": (lambda c: setattr(c, "self_motion", Damp(3.0)), {"self_motion": Damp(3.0)}),
    "v target": (lambda c: setattr(c.self_motion, "reference", NEW), {"self_motion": Track(NEW)}),
    "v gain": (lambda c: setattr(c.self_motion, "kp", 7.0), {"self_motion": Track(kp=7.0)}),
    "v damping": (lambda c: setattr(c.self_motion, "kd", [1.0, 2.0, 3.0, 4.0]), {"self_motion": Track(kd=[1.0, 2.0, 3.0, 4.0])}),  # noqa: E501
    "feedforward": (lambda c: setattr(c, "feedforward", False), {"feedforward": False}),
    "gravity": (lambda c: setattr(c, "gravity", False), {"gravity": False}),
    "atlas": (lambda c: setattr(c, "atlas", Atlas(c.task, threshold=0.9)), {}),
}  # fmt: skip


@pytest.mark.usefixtures("build", "unchecked")
@pytest.mark.parametrize("kind", [EosController, LimitedEosController])
@pytest.mark.parametrize("name", CHANGES)
def test_assigned_attributes_count_from_the_next_step_on(task: PositionTask, kind: type, name: str) -> None:
    change, arguments = CHANGES[name]
    path = circle(task.value(REST), 0.1, period=2.0)
    before = loop_of(kind(task, path)).step(0.001, *STATE)
    controller = kind(task, path)
    loop = loop_of(controller)
    change(controller)
    tau = loop.step(0.001, *STATE)
    np.testing.assert_allclose(tau, expected(kind(task, path, **arguments)), atol=1e-9)
    assert np.abs(tau - before).max() > 0.01 or name == "atlas"
    # So they do for a memory of before, wherever one is handed over.
    state = kind(task, path).start(0.0, REST, np.zeros(7))
    np.testing.assert_allclose(controller.torque(0.001, *STATE, state), tau, atol=1e-9)
    np.testing.assert_allclose(controller.evaluate(0.001, *STATE, state).tau, tau, atol=1e-9)
    for use_compiled in (copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))):
        np.testing.assert_allclose(
            use_compiled.torque(0.001, *STATE, use_compiled.start(0.0, REST, REST)), tau, atol=1e-9
        )


@pytest.mark.usefixtures("build", "unchecked")
def test_limits_and_period_count_from_the_next_step_on(task: PositionTask, panda: Robot) -> None:
    far = Hold(task.value(REST) + 0.3)
    tight = JointLimits.from_robot(panda, velocity=0.1, acceleration=0.5, braking=0.5)
    controller = LimitedEosController(task, far)
    loop = loop_of(controller)
    before = loop.step(0.001, *STATE)
    controller.limits = tight
    tau = loop.step(0.001, *STATE)
    np.testing.assert_allclose(tau, expected(LimitedEosController(task, far, limits=tight)), atol=1e-9)
    assert np.abs(tau - before).max() > 0.1
    controller.control_period = 0.02
    np.testing.assert_allclose(
        loop.step(0.001, *STATE),
        expected(LimitedEosController(task, far, limits=tight, control_period=0.02)),
        atol=1e-9,
    )
    with pytest.raises(InputError, match="control period"):
        controller.control_period = -1.0
    with pytest.raises(ValueError, match="read-only"):
        tight.torque[0] = 5.0


@pytest.mark.usefixtures("build", "unchecked")
def test_objectives_that_a_controller_holds_may_change(task: PositionTask) -> None:
    hold = Hold(task.value(REST))
    posture = Posture(REST)
    loop = loop_of(EosController(task, hold, posture))
    posture.q, posture.kp = REST + 0.1, 30.0
    np.testing.assert_allclose(
        loop.step(0.001, *STATE), expected(EosController(task, hold, Posture(REST + 0.1, kp=30.0))), atol=1e-9
    )
    law = PostureNullSpace(REST)
    loop = loop_of(OperationalSpaceController(task, hold, law))  # type: ignore[arg-type]
    law.kd = 3.0
    wanted = OperationalSpaceController(task, hold, PostureNullSpace(REST, kd=3.0))
    np.testing.assert_allclose(loop.step(0.001, *STATE), expected(wanted), atol=1e-9)  # type: ignore[arg-type]
    for what in (posture, law):
        with pytest.raises(InputError, match="7 numbers"):
            what.kp = [1.0, 2.0]
        with pytest.raises(InputError, match="7 numbers"):
            what.q = np.zeros(3)


@pytest.mark.usefixtures("build", "unchecked")
def test_track_shared_by_two_tasks_goes_on_for_both(panda: Robot, task: PositionTask) -> None:
    shared = Track()
    pose = PoseTask(panda, TIP)
    one = loop_of(EosController(task, Hold(task.value(REST)), shared))
    two = loop_of(EosController(pose, Hold(pose.value(REST), 6), shared))
    state = one.state
    one.step(0.001, *STATE)
    two.step(0.001, *STATE)
    assert one.state is state
    shared.kp = 1.0
    for loop, goal, m in ((one, task, 3), (two, pose, 6)):
        wanted = EosController(goal, Hold(goal.value(REST), m), Track(kp=1.0))
        np.testing.assert_allclose(loop.step(0.001, *STATE), expected(wanted), atol=1e-9)
    # Four gains do not fit the second.
    with pytest.raises(InputError, match="self-motion gain"):
        shared.kp = [1.0, 2.0, 3.0, 4.0]
    assert shared.kp == 1.0


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("kp", [1.0, 2.0], "task gain kp"),
        ("kd", "soft", "task gain kd"),
        ("reference", Hold([1.0, 2.0]), "does not fit the task"),
        ("reference", Hold([1.0, 2.0, 3.0], m=6), "velocity components"),
        ("self_motion", Track([1.0]), "v_d must be 4"),
        ("self_motion", Posture([1.0]), "the posture has 1 joints"),
        ("task", None, "loop.controller = "),
        ("robot", None, "loop.controller = "),
    ],
)
def test_controller_refuses_bad_assignment_and_keeps_old_value(
    task: PositionTask, name: str, value: object, told: str
) -> None:
    controller = EosController(task, Hold(task.value(REST)))
    loop = loop_of(controller)
    tau = loop.step(0.001, *STATE)
    before = getattr(controller, name)
    with pytest.raises(InputError, match=told):
        setattr(controller, name, value)
    assert getattr(controller, name) is before
    np.testing.assert_array_equal(loop.step(0.001, *STATE), tau)
    with pytest.raises(InputError, match="v_d must be 4"):
        controller.self_motion.reference = [1.0, 2.0]  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="own task object"):
        controller.atlas = Atlas(PositionTask(task.robot, TIP))
    with pytest.raises(ValueError, match="read-only"):
        controller.kp[0] = 5.0
    np.testing.assert_array_equal(loop.step(0.001, *STATE), tau)


class Swaying(Hold):
    """A Hold of one's own that moves."""

    def __call__(self, t: float) -> Target:
        return Target(self.z + math.sin(t), *super().__call__(t)[1:])


class Swinging(Trajectory):
    """The same, as a plain trajectory."""

    def __init__(self, z: np.ndarray) -> None:
        self.z = z

    def __call__(self, t: float) -> Target:
        return Target(self.z + math.sin(t), 0.0 * self.z, 0.0 * self.z)


@pytest.mark.usefixtures("build", "unchecked")
def test_targets_of_ones_own_kind_are_asked_every_time(task: PositionTask) -> None:
    taus = []
    for kind in (Swaying, Swinging):
        loop = loop_of(EosController(task, Hold(task.value(REST)), Track(kind(np.zeros(4)))))
        taus.append(loop.step(1.0, REST, np.zeros(7)))
        stacked = StackedTrajectory((kind(np.zeros(3)), circle([0.0, 0.0], 0.1, period=4.0)))
        assert stacked(1.0).z[0] == pytest.approx(math.sin(1.0))
    np.testing.assert_allclose(taus[1], taus[0], atol=1e-9)
    assert np.abs(taus[0] - task.robot.gravity(REST)).max() > 1.0


# -- another controller ------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("build", "unchecked")
@pytest.mark.parametrize("name", CHANGES)
def test_another_controller_for_the_same_task_goes_on_on_the_chart(task: PositionTask, panda: Robot, name: str) -> None:
    path, arguments = circle(task.value(REST), 0.1, period=2.0), CHANGES[name][1]
    same = PositionTask(panda, TIP)
    for goal in (task, same):
        loop = loop_of(EosController(task, path))
        loop.step(0.0005, REST + 0.01, np.zeros(7))
        chart = loop.state.chart
        loop.controller = EosController(goal, path, **arguments)
        tau = loop.step(0.001, *STATE)
        np.testing.assert_allclose(tau, expected(EosController(task, path, **arguments)), atol=1e-9)
        np.testing.assert_array_equal(loop.state.chart.V, chart.V)
        assert loop.state.chart.task is goal


@pytest.mark.usefixtures("build", "unchecked")
def test_another_task_starts_where_the_robot_is(task: PositionTask, panda: Robot) -> None:
    pose = PoseTask(panda, TIP)
    loop = loop_of(EosController(task, Hold(task.value(REST))))
    q, still = REST + 0.01, np.zeros(7)
    loop.step(0.001, q, still)
    others = [
        EosController(pose, Hold(pose.value(q), 6)),
        BASELINES["null-space-posture"](task, Hold(task.value(q)), q),
        LimitedEosController(task, Hold(task.value(q))),
        EosController(OrientationTask(panda, TIP), Hold(pose.value(q)[3:], 3)),
        OpenLoop(lambda t: panda.gravity(q)),
        EosController(task, Hold(task.value(q))),
    ]
    for k, controller in enumerate(others):
        loop.controller = controller
        assert loop.controller is controller
        # Each holds the robot where it is, so nothing but gravity is left.
        np.testing.assert_allclose(loop.step(0.002 + k, q, still), panda.gravity(q), atol=1e-6)
    # What the loop watches goes on as well.
    with pytest.raises(EosError, match="jumped"):
        loop.step(0.003 + k, q + 1.0, still)


@pytest.mark.usefixtures("build", "unchecked")
def test_controller_that_cannot_take_over_is_refused_and_the_old_one_goes_on(panda: Robot, ur5: Robot) -> None:
    task, stretched = PositionTask(panda, TIP), np.zeros(7)
    pose = PoseTask(panda, TIP)
    first = EosController(task, Hold(task.value(REST)))
    loop = ControlLoop(first, torque_limits=np.full(7, 50.0))
    tau = loop.step(0.0, REST, np.zeros(7))
    with pytest.raises(InputError, match="does not fit this robot and task"):
        loop.controller = EosController(task, Hold(task.value(REST)), Track([1.0, 2.0]))
    other = PositionTask(ur5, ur5.frames[-1])
    with pytest.raises(InputError, match="6 numbers"):
        loop.controller = EosController(other, Hold(other.value(np.zeros(6))))
    assert loop.controller is first
    np.testing.assert_array_equal(loop.step(0.001, REST, np.zeros(7)), tau)
    singular = ControlLoop(BASELINES["null-space-damping"](task, Hold(task.value(stretched)), stretched))
    singular.step(0.0, stretched, np.zeros(7))
    with pytest.raises(SingularError):
        singular.controller = EosController(pose, Hold(pose.value(stretched), 6))
    assert np.isfinite(singular.step(0.001, stretched, np.zeros(7))).all()


def test_robot_with_another_number_of_joints_starts_a_run(panda: Robot, ur5: Robot) -> None:
    task = PositionTask(panda, TIP)
    loop = loop_of(EosController(task, Hold(task.value(REST))))
    q = np.array([0.1, -1.0, 1.2, 0.3, 0.8, 0.2])
    other = PositionTask(ur5, ur5.frames[-1])
    loop.controller = EosController(other, Hold(other.value(q)))
    np.testing.assert_allclose(loop.step(0.0, q, np.zeros(6)), ur5.gravity(q), atol=1e-8)


def test_memory_of_another_task_is_refused(panda: Robot) -> None:
    position, pose = PositionTask(panda, TIP), PoseTask(panda, TIP)
    state = EosController(pose, Hold(pose.value(REST), 6)).start(0.0, REST, np.zeros(7))
    controller = EosController(position, Hold(position.value(REST)))
    with pytest.raises(InputError, match="take_over"):
        controller.torque(0.0, REST, np.zeros(7), state)
    taken = controller.take_over(0.0, REST, np.zeros(7), state)
    np.testing.assert_allclose(controller.torque(0.0, REST, np.zeros(7), taken), panda.gravity(REST), atol=1e-9)


# -- torques that change slowly ----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("build", "unchecked")
def test_control_loop_limits_the_rate_of_torque(panda: Robot, task: PositionTask) -> None:
    far = EosController(task, Hold(task.value(REST) + AHEAD))
    step = ControlLoop(far).step(0.0, REST, np.zeros(7)) - panda.gravity(REST)
    assert np.abs(step).max() > 10.0
    for rate in (1000.0, [1000.0, 500.0, 1000.0, 200.0, 1000.0, 50.0, 1000.0]):
        loop = ControlLoop(far, torque_rate=rate)
        q, dq, last = REST, np.zeros(7), panda.gravity(REST)
        for k in range(800):
            tau = loop.step(1e-3 * k, q, dq)
            assert (np.abs(tau - last) <= 1e-3 * np.asarray(rate) + 1e-9).all()
            if k == 0:
                np.testing.assert_allclose(tau, panda.gravity(REST), atol=1e-9)
                assert loop.slowed
            last = tau
            dq = dq + 1e-3 * panda.forward_dynamics(q, dq, tau)
            q = q + 1e-3 * dq
        assert not loop.slowed
        assert np.abs(task.value(q) - far.reference(0.0).z).max() < 0.01
        loop.reset()
        np.testing.assert_allclose(loop.step(0.0, q, 0.0 * q), panda.gravity(q), atol=1e-9)


@pytest.mark.usefixtures("build", "unchecked")
def test_control_loop_starts_softly(panda: Robot, task: PositionTask) -> None:
    far, still = EosController(task, Hold(task.value(REST) + AHEAD)), np.zeros(7)
    whole = ControlLoop(far).step(0.0, REST, still)
    measured = panda.gravity(REST) + np.array([0.5, -0.3, 0.2, 0.1, 0.0, 0.1, -0.1])
    for first in (None, measured):
        loop = ControlLoop(far, soft_start=0.5, first_torque=first)
        taus = np.array([loop.step(1e-3 * k, REST, still) for k in range(600)])
        np.testing.assert_allclose(taus[0], panda.gravity(REST) if first is None else measured, atol=1e-9)
        # Smooth: the largest step is one and a half times the mean.
        assert (np.abs(np.diff(taus, axis=0)) <= 1.51 * np.abs(whole - taus[0]) / 500 + 1e-9).all()
        np.testing.assert_allclose(taus[500:], np.tile(whole, (100, 1)), atol=1e-9)
        # Another controller begins where the last one was.
        near = EosController(task, Hold(task.value(REST)))
        loop.controller = near
        np.testing.assert_allclose(loop.step(0.6, REST, still), whole, atol=1e-9)
        np.testing.assert_allclose(loop.step(1.2, REST, still), panda.gravity(REST), atol=1e-9)


@pytest.mark.usefixtures("unchecked")
def test_soft_start_without_gravity_or_robot_begins_at_zero_or_as_given(panda: Robot, task: PositionTask) -> None:
    """A robot that compensates gravity by itself is given none at the start; of an unknown robot nothing is known."""
    loop = ControlLoop(EosController(task, Hold(task.value(REST)), gravity=False), torque_rate=100.0)
    np.testing.assert_allclose(loop.step(0.0, REST, np.zeros(7)), 0.0, atol=1e-12)
    blind = ControlLoop(OpenLoop(lambda t: [5.0, 1.0]), torque_rate=[10.0, 20.0], first_torque=[1.0, 1.0])
    assert blind.step(0.0, [0.0, 0.0], [0.0, 0.0]).tolist() == [1.0, 1.0]
    np.testing.assert_allclose(blind.step(0.1, [0.0, 0.0], [0.0, 0.0]), [2.0, 1.0])
    for wrong in ({"torque_rate": 0.0}, {"torque_rate": [1.0, 2.0]}, {"soft_start": -1.0}):
        with pytest.raises(InputError, match="must be"):
            ControlLoop(loop.controller, **wrong)
    with pytest.raises(InputError, match="must be"):
        ControlLoop(loop.controller, soft_start=1.0, first_torque=[1.0])
    with pytest.raises(InputError, match="there is no ramp"):
        ControlLoop(loop.controller, first_torque=[1.0] * 7)


@pytest.mark.usefixtures("unchecked")
def test_sampled_run_limits_the_rate_of_torque(panda: Robot, task: PositionTask) -> None:
    far = EosController(task, Hold(task.value(REST) + AHEAD))
    run = simulate_sampled(panda, far, REST, duration=0.3, record_rate=1000.0, torque_rate=300.0, soft_start=0.1)
    assert np.abs(np.diff(run.tau, axis=0)).max() <= 0.3 + 1e-9
    np.testing.assert_allclose(run.tau[0], panda.gravity(REST), atol=1e-9)
    assert run.info["arguments"]["torque_rate"] == 300.0
    assert run.info["arguments"]["soft_start"] == 0.1


@pytest.mark.usefixtures("unchecked")
def test_options_limit_the_rate_of_torque(panda: Robot, task: PositionTask) -> None:
    with pytest.raises(InputError, match="--control-rate 1000"):
        _ = RunOptions(torque_rate=100.0).control_period
    options = RunOptions(control_rate=500.0, torque_rate=200.0, soft_start=0.05)
    run = options.run(panda, EosController(task, Hold(task.value(REST) + AHEAD)), REST, 0.1)
    # Samples are taken every 10 ms.
    assert np.abs(np.diff(run.tau, axis=0)).max() <= 2.0 + 1e-9


@pytest.mark.usefixtures("unchecked")
def test_curves_are_values(task: PositionTask) -> None:
    path = circle([0.0, 0.0], 0.1, period=4.0)
    for change in (lambda: setattr(path.waves, "phase", 1.0), lambda: setattr(path, "period", 1.0)):
        with pytest.raises(AttributeError, match="cannot assign"):
            change()
    with pytest.raises(ValueError, match="read-only"):
        path.waves.frequencies[0] = 3.0
