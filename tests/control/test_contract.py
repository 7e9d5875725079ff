"""The contract of controllers and objectives: the drivers ask nothing else, and whatever a subclass defines counts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import eos_pin
from eos_pin import (
    Atlas,
    Controller,
    ControlLoop,
    EosController,
    Harmonic,
    Hold,
    InputError,
    LimitedEosController,
    Objective,
    OpenLoop,
    PositionTask,
    Robot,
    Target,
    Track,
    simulate,
    simulate_extended,
    simulate_sampled,
)

pytestmark = pytest.mark.usefixtures("unchecked")

TIP = "panda_hand_tcp"
Q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.8, 0.7])


@pytest.fixture(scope="module")
def task(panda):
    return PositionTask(panda, TIP)


def target_of(task):
    return Hold(task.value(Q) + np.array([0.02, 0.0, -0.01]))


# -- no short cut is taken past what a subclass defines --------------------------------------------------------------


class Stiff(EosController):
    """A task law of one's own."""

    def task_acceleration(self, t, point):
        return 3.0 * super().task_acceleration(t, point)


class Shoved(EosController):
    """The whole law of one's own."""

    def asked(self, t, q, dq, chart, point):
        F = super().asked(t, q, dq, chart, point)
        F[0] += 1.0
        return F


class LimitedStiff(LimitedEosController):
    def task_acceleration(self, t, point):
        return 3.0 * super().task_acceleration(t, point)


class Pushing(Track):
    """Tracking with a push."""

    def acceleration(self, t, q, dq, chart):
        return super().acceleration(t, q, dq, chart) + 2.0


class Plain(Track):
    """Tracking, and nothing of its own."""


def expected_torque(controller, q, dq, state):
    """The law by its parts, without any short cut."""
    task, chart = controller.task, state.chart
    point = task.at(q, dq)
    F_z = controller.task_acceleration(0.0, point) - point.drift
    F = np.concatenate((F_z, controller.self_motion.acceleration(0.0, q, dq, chart)))
    F[0] += isinstance(controller, Shoved)
    return task.robot.inverse_dynamics(q, dq, np.linalg.solve(np.vstack((point.J, chart.Vt)), F))


@pytest.mark.parametrize("kind", [EosController, Stiff, Shoved, LimitedEosController, LimitedStiff])
@pytest.mark.parametrize("objective", [Track, Plain, Pushing])
def test_own_law_and_own_objective_count(task, kind, objective):
    controller = kind(task, target_of(task), objective())
    q, dq = Q + 0.01, np.linspace(-0.1, 0.1, 7)
    state = controller.start(0.0, Q, 0.0 * Q)
    expected = expected_torque(controller, q, dq, state)
    np.testing.assert_allclose(controller.torque(0.0, q, dq, state), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(controller.evaluate(0.0, q, dq, state).tau, expected, rtol=1e-9, atol=1e-9)
    loop = ControlLoop(controller)
    loop.step(0.0, Q, 0.0 * Q)
    np.testing.assert_allclose(loop.step(0.001, q, dq), expected, rtol=1e-9, atol=1e-9)


def test_own_law_of_a_subclass_of_a_subclass_counts(task):
    class Stiffer(Stiff):
        """Inherits a law that is not built in."""

    kinds = (EosController, Stiff, Stiffer)
    taus = [kind(task, target_of(task)) for kind in kinds]
    taus = [controller.torque(0.0, Q, 0.0 * Q, controller.start(0.0, Q, 0.0 * Q)) for controller in taus]
    np.testing.assert_array_equal(taus[1], taus[2])
    assert np.abs(taus[0] - taus[1]).max() > 0.1


def test_compiled_law_is_used_for_built_in_hooks_only(task):
    def law(kind, objective):
        return kind(task, target_of(task), objective).start(0.0, Q, 0.0 * Q).law

    for kind, objective in ((EosController, Track()), (EosController, Plain()), (LimitedEosController, None)):
        assert law(kind, objective) is not None
    for kind, objective in ((Stiff, Track()), (Shoved, Track()), (LimitedStiff, None), (EosController, Pushing())):
        assert law(kind, objective) is None


class Swaying(Hold):
    """A hold that moves all the same."""

    def __call__(self, t):
        z, dz, ddz = super().__call__(t)
        return Target(z + 0.1 * np.sin(t), dz + 0.1 * np.cos(t), ddz - 0.1 * np.sin(t))


def test_own_hold_of_the_self_motion_counts(task):
    v = np.zeros(4)
    harmonic = Harmonic(v, np.full((1, 4), 0.1), np.zeros((1, 4)), 2.0 * np.pi)
    taus = []
    for reference in (Swaying(v), harmonic, Hold(v)):
        controller = EosController(task, target_of(task), Track(reference))
        taus.append(controller.torque(0.7, Q, 0.0 * Q, controller.start(0.0, Q, 0.0 * Q)))
    np.testing.assert_allclose(taus[0], taus[1], atol=1e-12)
    assert np.abs(taus[0] - taus[2]).max() > 0.1


class Held(Objective):
    """An own law whose compiled form is stated, and told of a change."""

    def __init__(self, v_d):
        self.v_d, self.users = np.array(v_d), []

    def acceleration(self, t, q, dq, chart):
        return 50.0 * (self.v_d - chart.v(q)) - 10.0 * chart.dv(dq)

    def held_law(self, r):
        return np.full(r, 50.0), np.full(r, 10.0), self.v_d

    def add_user(self, controller):
        self.users.append(controller)

    def move(self, v_d):
        self.v_d = np.array(v_d)
        for user in self.users:
            user.renew()


def test_own_objective_may_state_its_compiled_form(task):
    objective = Held(np.full(4, 0.1))
    controller = EosController(task, target_of(task), objective)
    state = controller.start(0.0, Q, 0.0 * Q)
    for v_d in (np.full(4, 0.1), np.full(4, -0.2)):
        objective.move(v_d)
        np.testing.assert_allclose(
            controller.torque(0.0, Q, 0.0 * Q, state), expected_torque(controller, Q, 0.0 * Q, state), atol=1e-9
        )


# -- the contract is all that drivers ask ----------------------------------------------------------------------------


class Bare(Controller):
    """The least a controller is."""

    def torque(self, t, q, dq, state):
        return -1.0 * dq


class Full(Controller):
    """A controller that answers every question."""

    def __init__(self, task, reference):
        self.robot, self.task, self.reference, self.atlas = task.robot, task, reference, Atlas(task)

    def start(self, t, q, dq):
        return self.atlas.start(q)

    def torque(self, t, q, dq, state):
        point = self.task.at(q, dq)
        force = 4000.0 * (self.reference(t).z - point.z) - 200.0 * point.dz
        return point.J.T @ force - 2.0 * dq + self.robot.gravity(q)

    def evaluate(self, t, q, dq, state, tau=None):
        found = super().evaluate(t, q, dq, state, tau)
        return found._replace(deficit_from_singularity=np.zeros(3), deficit_from_limits=np.array([0.5, 0.0, 0.0]))

    def chart(self, state):
        return state

    def self_motion_target(self, t, state):
        return Target(np.full(4, t), np.ones(4), np.zeros(4))

    def task_deficit(self, t, q, dq, state):
        return np.array([0.5, 0.0, 0.0])

    def holding_torque(self, q):
        return np.full(7, 0.25)

    def broken_limits(self, t, q, dq, tau):
        return "joint 3 was too fast"


RUNS = {
    "continuous": simulate,
    "extended": lambda plant, controller, q, **more: simulate_extended(
        plant, controller, q, atlas=Atlas(PositionTask(plant, TIP)), **more
    ),
    "sampled": simulate_sampled,
}


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_bare_controller_runs_in_every_driver(panda, run):
    result = run(panda, Bare(), Q, duration=0.02)
    assert result.status == "finished"
    assert "Bare has no attribute task and no reference" in result.message
    assert result.v_ref.size == 0 or np.isnan(result.v_ref).all()
    assert np.isnan(result.task_deficit).all()


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_full_controller_is_recorded_by_every_driver(panda, task, run):
    result = run(panda, Full(task, target_of(task)), Q, duration=0.02)
    assert (result.labels, result.units, result.frame) == (("x", "y", "z"), ("m",) * 3, TIP)
    np.testing.assert_allclose(result.v_ref, np.tile(result.t[:, None], 4))
    np.testing.assert_allclose(result.v[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(result.error, result.z_ref - result.z)
    np.testing.assert_array_equal(result.deficit_from_limits[:, 0], 0.5)
    np.testing.assert_array_equal(result.task_deficit, result.deficit_from_limits)
    assert result.status == "degraded"
    assert "joint 3 was too fast" in result.message


def test_control_loop_asks_own_controller(task):
    loop = ControlLoop(Full(task, target_of(task)), torque_limits=np.full(7, 0.1), soft_start=1.0)
    np.testing.assert_allclose(loop.step(0.0, Q, 0.0 * Q), 0.1)
    loop = ControlLoop(Full(task, target_of(task)), torque_limits=False, soft_start=1.0)
    np.testing.assert_allclose(loop.step(0.0, Q, 0.0 * Q), 0.25)
    np.testing.assert_array_equal(loop.task_deficit(0.0, Q, 0.0 * Q), [0.5, 0.0, 0.0])
    loop = ControlLoop(Bare(), soft_start=1.0)
    np.testing.assert_allclose(loop.step(0.0, Q, 0.0 * Q), 0.0)
    assert loop.task_deficit(0.0, Q, 0.0 * Q) is None


def test_controller_refuses_a_plant(panda, ur5, task):
    class Picky(Bare):
        def check_plant(self, plant: Robot) -> None:
            if plant.n != 6:
                raise InputError("needs six joints")

    with pytest.raises(InputError, match="needs six joints"):
        simulate(panda, Picky(), Q, duration=0.01)
    assert simulate(ur5, Picky(), np.zeros(6), duration=0.01).ok
    with pytest.raises(InputError, match=r"for 7 joints, the plant .* has 6"):
        simulate(ur5, Full(task, target_of(task)), np.zeros(6), duration=0.01)


def test_open_loop_states_that_it_has_no_task(panda):
    assert OpenLoop(lambda t: np.zeros(7)).unset == ()
    assert Bare().unset == ("task", "reference")
    assert simulate(panda, OpenLoop(lambda t: np.zeros(7)), Q, duration=0.01).message == ""


def test_tasks_are_not_asked_for_their_types():
    package = Path(eos_pin.__file__).parent
    # A tolerance is another kind of task altogether, and has a whole task to ask.
    forbidden = re.compile(r"(isinstance|hasattr|getattr)\((self\.)?_?task,(?! (Tolerance|LookAt)Task)|type\(task\)")
    # The border asks every argument.
    for path in set(package.rglob("*.py")) - set(package.glob("_arrays/*")):
        found = [line for line in path.read_text(encoding="utf-8").splitlines() if forbidden.search(line)]
        assert not found, f"{path.relative_to(package)}: {found}"


def test_drivers_and_controllers_have_no_type_tests():
    package = Path(eos_pin.__file__).parent
    forbidden = re.compile(
        r"getattr\((self\.)?_?(controller|task|objective|reference|system\.controller)\b|type\([a-z_.]+\) is |"
        r"(isinstance|hasattr)\((self\.)?_?(controller|task|objective|reference|self_motion|track)\b"
    )
    for room in ("simulation", "control"):
        for path in (package / room).glob("*.py"):
            found = [line for line in path.read_text(encoding="utf-8").splitlines() if forbidden.search(line)]
            assert not found, f"{room}/{path.name}: {found}"
