"""`ControlLoop`: what it does about bad input, and that its torque stays bounded."""

from __future__ import annotations

import numpy as np
import pytest
from checks import REST

from eos_pin import ControlLoop, EosController, Hold, InputError, OpenLoop, PositionTask, Robot, StateError

STILL = np.zeros(7)


@pytest.fixture
def loop(panda: Robot) -> ControlLoop:
    task = PositionTask(panda, "panda_hand_tcp")
    return ControlLoop(EosController(task, Hold(task.value(REST))))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("q", "dq", "told"),
    [
        (np.full(7, np.nan), STILL, "q must be finite"),
        (REST, np.full(7, np.inf), "dq must be finite"),
        (REST[:6], STILL, "q must be 7 numbers"),
        (REST, np.zeros((7, 1)), "dq must be 7 numbers"),
        ("abcdefg", STILL, "must be numbers"),
        (None, STILL, "q must be"),
    ],
)
def test_bad_state_is_refused_and_the_loop_goes_on(loop: ControlLoop, q: object, dq: object, told: str) -> None:
    first = loop.step(0.0, REST, STILL)
    state = loop.state
    with pytest.raises(StateError, match=told):
        loop.step(0.001, q, dq)  # type: ignore[arg-type]
    assert loop.state is state
    assert np.array_equal(loop.step(0.002, REST, STILL), first)


def test_clock_that_runs_backwards_is_refused(loop: ControlLoop) -> None:
    loop.step(1.0, REST, STILL)
    with pytest.raises(StateError, match="monotonic"):
        loop.step(0.5, REST, STILL)
    with pytest.raises(StateError, match="time"):
        loop.step(float("nan"), REST, STILL)
    with pytest.raises(StateError, match="time"):
        loop.step(float("inf"), REST, STILL)
    loop.step(1.0, REST, STILL)
    loop.reset()
    loop.step(0.0, REST, STILL)


def test_jump_is_refused_once_and_believed_when_it_stays(loop: ControlLoop) -> None:
    loop.step(0.0, REST, STILL)
    elsewhere = REST + np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(StateError, match=r"q\[2\] jumped by 0.5"):
        loop.step(0.001, elsewhere, STILL)
    assert np.isfinite(loop.step(0.002, elsewhere, STILL)).all()
    # A long gap with a joint that moves is not a jump.
    loop.step(1.002, elsewhere + 0.4, np.full(7, 0.4))


def test_torques_are_cut_at_the_limits_and_the_loop_reports_it(panda: Robot) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    far = Hold(task.value(REST) + np.array([5.0, 0.0, 0.0]))
    loop = ControlLoop(EosController(task, far, kp=1e4))
    tau = loop.step(0.0, REST, STILL)
    assert loop.saturated
    assert (np.abs(tau) <= panda.effort).all()
    own = ControlLoop(EosController(task, far), torque_limits=1.0)
    assert np.abs(own.step(0.0, REST, STILL)).max() <= 1.0
    some = ControlLoop(EosController(task, far, kp=1e4), torque_limits=[np.inf] * 6 + [0.01])
    assert abs(some.step(0.0, REST, STILL)[6]) <= 0.01
    free = ControlLoop(EosController(task, far, kp=1e4), torque_limits=False)
    assert (np.abs(free.step(0.0, REST, STILL)) > panda.effort).any()
    assert not free.saturated


@pytest.mark.parametrize("limits", [True, False])
def test_torque_that_is_not_finite_never_leaves_the_loop(limits: bool) -> None:
    loop = ControlLoop(OpenLoop(lambda t: [1.0, np.nan if t > 0.0 else 2.0]), torque_limits=limits)
    loop.step(0.0, [0.0, 0.0], [0.0, 0.0])
    with pytest.raises(StateError, match=r"OpenLoop has no finite torque at t = 1.0 s"):
        loop.step(1.0, [0.0, 0.0], [0.0, 0.0])


def test_lists_and_a_controller_without_robot_are_welcome() -> None:
    loop = ControlLoop(OpenLoop(lambda t: [1.0, 2.0]))
    assert loop.step(0.0, [0.0, 0.0], [0.0, 0.0]).tolist() == [1.0, 2.0]


@pytest.mark.usefixtures("unchecked")
def test_bad_settings_are_refused(panda: Robot) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    controller = EosController(task, Hold(task.value(REST)))
    with pytest.raises(InputError, match="above 0"):
        ControlLoop(controller, torque_limits=-1.0)
    with pytest.raises(InputError, match="jump"):
        ControlLoop(controller, jump=0.0)


def test_control_loop_reports_deficit_out_of_reach(panda: Robot) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    far = ControlLoop(EosController(task, Hold(task.value(REST) + np.array([2.0, 0.0, 0.0]))))
    assert far.task_deficit(0.0, REST, STILL) is None
    q, dq = REST, STILL
    for k in range(2000):
        tau = far.step(1e-3 * k, q, dq)
        assert np.all(np.abs(tau) <= panda.effort)
        dq = dq + 1e-3 * panda.forward_dynamics(q, dq, tau)
        q = q + 1e-3 * dq
    lost = far.task_deficit(2.0, q, dq)
    assert lost is not None
    assert np.abs(lost).max() > 1.0
    near = ControlLoop(EosController(task, Hold(task.value(REST) + 0.1)))
    near.step(0.0, REST, STILL)
    np.testing.assert_allclose(near.task_deficit(0.0, REST, STILL), 0.0, atol=1e-9)  # type: ignore[arg-type]
    assert ControlLoop(OpenLoop(lambda t: np.zeros(7))).task_deficit(0.0, REST, STILL) is None
