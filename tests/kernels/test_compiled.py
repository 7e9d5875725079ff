"""Compiled kernels give what their plain forms give, to rounding, in at least 1,000 states each."""

from __future__ import annotations

import inspect
import math
import os
import pickle
import subprocess
import sys
import types
import weakref
from itertools import cycle, product

import numpy as np
import pinocchio as pin
import pytest
from checks import EXACT, all_tasks, compiled_only, exact, random_state, tip

from eos_pin import (
    Atlas,
    Chart,
    EosController,
    Hold,
    ImpedanceController,
    InputError,
    JointLimits,
    LimitedEosController,
    OrientationTask,
    PoseTask,
    PositionTask,
    Track,
)
from eos_pin._arrays import JointVector, border
from eos_pin._kernels import tracing
from eos_pin._kernels.dispatch import COMPILED, DONE, REFERENCES, UNDECIDED, WITH_PLAIN_FORMS, kernels, use_compiled
from eos_pin._kernels.kinematics import MOST_NODES, SHORTEST
from eos_pin._kernels.ways import relaxed
from eos_pin.control import loop
from eos_pin.control._regularize import AccelerationMap
from eos_pin.control._smallest_change import SmallestChange
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.simulation import _systems
from eos_pin.tasks._flat import ORTHONORMAL
from eos_pin.trajectories.base import Target
from eos_pin.trajectories.harmonic import Waves

pytestmark = [
    compiled_only,
    # Calls by the ten thousand.
    pytest.mark.usefixtures("unchecked"),
]
TASKS = [(name, task) for name, task in all_tasks() if isinstance(task, PositionTask | OrientationTask | PoseTask)]
frame_tasks = pytest.mark.parametrize("task", [task for _, task in TASKS], ids=[name for name, _ in TASKS])
#: So many states at least are computed by both forms; of one task where there are several.
STATES = 1000
SHARE = -(-STATES // len(TASKS))


def both(name, *arguments):
    """The results of the compiled and of the plain form."""
    return getattr(kernels, name)(*arguments), REFERENCES[name](*arguments)


def plain_form(kernel):
    """The plain form of a compiled object, made from the same arguments."""
    kind, arguments = kernel.__reduce__()
    return REFERENCES[kind.__name__](
        *(plain_form(part) if isinstance(part, kernels.Frame) else part for part in arguments)
    )


def states(robot, seed, count):
    """Random joints and velocities."""
    random = np.random.default_rng(seed)
    lower, upper = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    return zip(random.uniform(lower, upper, (count, robot.n)), random.normal(size=(count, robot.n)), strict=True)


def vectors(seed, count=STATES):
    """A random generator and a size for each state."""
    random = np.random.default_rng(seed)
    return [(random, int(random.integers(1, 13))) for _ in range(count)]


def test_kernels_are_compiled_with_a_compiler():
    assert loop, _systems  # they choose kernels, and have been imported
    assert kernels is not None
    assert set(REFERENCES) == {name for module in WITH_PLAIN_FORMS for name in COMPILED[module]}
    assert set(vars(kernels)) == {name for names in COMPILED.values() for name in names}


def test_relaxed_is_equal_in_both_forms_where_costs_tie_and_postures_are_not_reached():
    assert relaxed is kernels.relaxed
    random = np.random.default_rng(0)
    for edges, before, after, starts in ((0, 3, 4, 2), (60, 9, 12, 5), (400, 20, 15, 7)):
        end = np.sort(random.integers(after - 2, size=edges))
        value = np.where(random.random((before, starts)) < 0.4, np.inf, random.integers(3, size=(before, starts)))
        cost = random.integers(3, size=edges).astype(float)
        compiled, plain = both("relaxed", value, random.integers(before, size=edges), end, cost, after)
        np.testing.assert_array_equal(compiled[0], plain[0])
        np.testing.assert_array_equal(compiled[1], plain[1])
        assert np.isinf(compiled[0][-1]).all()
        assert (compiled[1][-1] == -1).all()


def test_kernel_that_is_not_listed_is_refused():
    def log3():
        """The name of something else that `parts` imports."""

    with pytest.raises(AssertionError, match="not in the list"):
        use_compiled(log3)


# -- smaller kernels ------------------------------------------------------------------------------------------------


def test_state_monitors_agree():
    accepted = 0
    for random, n in vectors(1):
        first = random.normal(), random.normal(size=n), random.uniform(0.1, 10.0)
        watches = both("StateMonitor", *first)
        for _ in range(4):
            t, q, dq = first[0] + random.normal(0.3), first[1] + 0.3 * random.normal(size=n), random.normal(size=n)
            if random.random() < 0.2:
                (q if random.random() < 0.5 else dq)[random.integers(n)] = random.choice([np.nan, np.inf, -np.inf])
            compiled, plain = (watch.accepts(t, q, dq) for watch in watches)
            assert compiled is plain
            accepted += compiled
            for one, other in zip(*(watch.last for watch in watches), strict=True):
                np.testing.assert_array_equal(one, other)
    assert STATES <= accepted < 4 * STATES
    t, q = watches[0].last
    for watch in (watches[0], pickle.loads(pickle.dumps(watches[0])), watches[1]):
        assert watch.accepts(t + 1.0, q, q)
        watch.last = t, q
        assert not watch.accepts(t - 1.0, q, q)


@pytest.mark.parametrize(
    "q", [[0.0, 0.0], None, "ab", np.zeros(3), np.zeros((2, 1)), np.zeros(2, int), np.zeros(4)[::2]]
)
def test_state_monitor_leaves_unusual_states_to_a_closer_look(q):
    zero = np.zeros(2)
    watch = kernels.StateMonitor(0.0, zero, 1.0)
    for state in ((0.0, q, zero), (0.0, zero, q), (None, zero, zero), ("now", zero, zero)):
        assert watch.accepts(*state) is False
    assert kernels.within_limits_fast(q, np.ones(2)) is False


def test_accepted_arguments_are_the_same_ones():
    class Owner:
        """An object with methods."""

    owners, names, taken = [Owner() for _ in range(6)], ("self", "t", "q", "z", "flag", "rest"), 0
    forms = border.compiled.Accepted(names), border.Accepted(names)
    for random, n in vectors(4):
        owner, R = owners[random.integers(6)], pin.exp3(random.normal(size=3))
        if random.random() < 0.3:
            marks = {"self": None, "t": 0.0, "q": ((n, 2), ()), "z": ((10,), (1,)), "flag": bool}
            for form in forms:
                form.remember(weakref.ref(owner), marks)
        q = random.choice([1.0, 1.0, 1.0, np.nan, np.inf]) * random.normal(size=(random.choice([n, n, n, 3]), 2))
        q = (q, np.asfortranarray(q), q[::-1], q.astype(np.float32), q.tolist())[
            random.choice([0, 0, 0, 1, 1, 2, 3, 4])
        ]
        z = np.append(random.normal(), R.ravel()) * random.choice([1.0, 1.0, 1.0, -1.0, 1.01])
        t, flag = random.choice([1.5, 1.5, 1.5, -1.0, np.nan, np.inf]).item(), [True, True, True, 1][random.integers(4)]
        for arguments in ((owner, t, q, z), (owner, t, q), (owner, t), (owner,), (), (owner, t, q, z, flag, 1, 2)):
            for named in ({}, {"flag": flag}, {"rest": 1}, {"other": None}):
                compiled, plain = (form(arguments, named) for form in forms)
                assert compiled is plain
                taken += compiled
    assert taken > STATES
    owner = owners.pop()
    entry = pickle.loads(pickle.dumps(forms[0]))
    assert not entry((owner,), {})


def test_border_is_the_same_compiled_and_plain():
    """Results, errors and what a function is made of; methods, too, and arguments in any order and of any kind."""
    random, forms = np.random.default_rng(5), []
    for bordered in (border.compiled.bordered, border.bordered):

        class Owner:
            n = 3

            def scaled(self, q: JointVector, by: float = 2.0) -> JointVector:
                """Joints times a number."""
                return by * q

            scaled = bordered(scaled, border._Border(scaled))

        forms.append(Owner())
    compiled, plain = forms
    assert compiled.scaled.__doc__ == "Joints times a number."
    assert inspect.signature(compiled.scaled) == inspect.signature(plain.scaled)
    assert isinstance(compiled.scaled.unchecked, types.FunctionType)
    taken = 0
    for _ in range(STATES):
        q = random.normal(size=random.choice([3, 3, 3, 2])) * random.choice([1.0, 1.0, np.nan])
        q = (q, q.tolist(), q[::-1], "abc", None)[random.choice([0, 0, 0, 1, 2, 3, 4])]
        by = (2.5, 2, math.inf, "x")[random.choice([0, 0, 1, 2, 3])]
        for args, kwargs in (
            ((q,), {}),
            ((q, by), {}),
            ((q,), {"by": by}),
            ((), {"by": by, "q": q}),
            ((), {}),
            ((q, by, 1), {}),
        ):
            found = []
            for owner in forms:
                try:
                    found.append(owner.scaled(*args, **kwargs).tolist())
                except (InputError, TypeError) as error:
                    found.append(f"{type(error).__name__}: {error}")
            assert found[0] == found[1]
            taken += isinstance(found[0], list)
    assert taken > 0.5 * STATES


def test_checks_of_torques_agree():
    inside = 0
    for random, n in vectors(2):
        tau, per_limit = random.normal(size=n), random.uniform(0.0, 0.8, n)
        compiled, plain = both("within_limits_fast", tau, per_limit)
        assert compiled is plain
        inside += compiled
        tau[0] = np.nan
        assert both("within_limits_fast", tau, per_limit) == (False, False)
    assert 0.2 * STATES < inside < 0.95 * STATES


def test_curves_agree():
    for random, width in vectors(3):
        terms, m = random.integers(0, 5), random.integers(1, 7)
        blocks = [random.normal(size=(2 * terms + 1, columns)) for columns in (width, m, m)]
        compiled = Waves(random.normal(), 10.0 * random.random(terms), *blocks).at
        t = 10.0 * random.normal()
        expected = plain_form(compiled)(t)
        for found in (compiled(t), pickle.loads(pickle.dumps(compiled))(t)):
            assert type(found) is type(expected) is Target
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_allclose(one, other, rtol=0.0, atol=100.0 * EXACT)


def test_pose_differences_agree():
    random = np.random.default_rng(4)
    for _ in range(STATES):
        poses = [np.concatenate((random.normal(size=3), pin.exp3(2.0 * random.normal(size=3)).ravel())) for _ in "ab"]
        compiled, plain = both("pose_difference", *poses)
        np.testing.assert_array_equal(compiled[:3], plain[:3])
        # Half a turn away a rotation vector and its opposite are the same.
        np.testing.assert_allclose(pin.exp3(compiled[3:]), pin.exp3(plain[3:]), atol=1e-7)
    with pytest.raises(ValueError, match="a vector of 12 numbers"):
        kernels.pose_difference(poses[0], np.zeros(3))


def test_flat_poses_agree():
    random, found = np.random.default_rng(5), 0
    for _ in range(STATES):
        matrix = pin.SE3(pin.exp3(random.normal(size=3)), random.normal(size=3)).homogeneous
        flat = np.concatenate((matrix[:3, 3], matrix[:3, :3].ravel()))
        for given in (matrix, flat):
            results = both("flat_pose", given, ORTHONORMAL)
            # Whether what is right to rounding counts as such is a matter of rounding.
            for result in results:
                assert result is None or np.array_equal(result, flat)
            found += None not in [None if result is None else "pose" for result in results]
        disturbed = np.eye(4)
        disturbed[[0, 3], [1, 2]] += random.choice([0.0, 1e-9, 1.0, np.nan, np.inf])
        for wrong in (flat[:11], matrix[:3], -matrix, np.diag([1.0, 1.0, -1.0, 1.0]), disturbed):
            compiled, plain = both("flat_pose", wrong, ORTHONORMAL)
            assert (compiled is None) == (plain is None)
    assert found >= STATES


def test_parts_of_newtons_method_agree():
    random, regular = np.random.default_rng(6), 0
    for _ in range(3 * STATES):
        m, more = random.integers(1, 8), random.integers(0, 5)
        J, U = random.normal(size=(m, m + more)), random.normal(size=(m + more, m))
        u, error, base = random.normal(size=m), random.normal(size=m), random.normal(size=m + more)
        assert both("largest", error) == (np.abs(error).max(),) * 2
        compiled, plain = both("on_chart_inverse", J, U)
        if (condition := np.linalg.cond(J @ U)) > 1e6:
            continue
        assert (compiled is None) == (plain is None) == (np.linalg.det(J @ U) < 0.0)
        if compiled is not None:
            regular += 1
            np.testing.assert_allclose(compiled, plain, rtol=0.0, atol=EXACT * condition * np.abs(plain).max())
            for one, other in zip(*both("newton_step", base, U, u, plain, error), strict=True):
                np.testing.assert_allclose(one, other, rtol=0.0, atol=1e3 * EXACT * (1.0 + np.abs(plain).max()))
    assert regular >= STATES
    assert kernels.on_chart_inverse(0.0 * J, U) is None
    assert kernels.largest(np.array([1.0, np.nan, 3.0])) != kernels.largest(np.array([1.0, np.nan, 3.0]))


def test_kernels_take_or_refuse_arrays_of_another_kind():
    """A task of one's own may return what it likes."""
    J, U, base = np.ones((2, 3)) + np.eye(2, 3), np.eye(3, 2), np.arange(3.0)
    B, error, rows = np.eye(2), np.array([1.0, 2.0]), np.eye(3)[2:]
    expected = kernels.newton_step(base, U, error, B, error)
    drive = kernels.AccelerationMap(rows, rows, np.eye(3)[:2], None, np.inf, 1.0, 1.0, 1.0)
    for kind in (np.float32, int, np.longdouble):
        found = kernels.newton_step(base.astype(kind), U, error.astype(kind), B.astype(kind), error.astype(kind))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other)
        np.testing.assert_allclose(kernels.on_chart_inverse(J.astype(kind), U), kernels.on_chart_inverse(J, U))
        assert kernels.largest(error.astype(kind)) == 2.0
        np.testing.assert_allclose(drive(J.astype(kind), base.astype(kind), base)[1], drive(J, base, base)[1])
    for one, other in zip(
        kernels.newton_step(base[::-1][::-1], U, error, B, np.repeat(error, 2)[::2]), expected, strict=True
    ):
        np.testing.assert_allclose(one, other)
    with pytest.raises(ValueError, match="a vector of 2 numbers"):
        kernels.newton_step(base, U, error, B, np.ones(3))
    with pytest.raises(ValueError, match="a matrix of 2 x 3 numbers"):
        kernels.on_chart_inverse(J.T, U)


def test_state_rates_agree():
    for random, n in vectors(7):
        dq, ddq, tau = random.normal(size=(3, n))
        for arguments in ((dq, ddq, tau), (dq[::-1], ddq, tau)):
            np.testing.assert_allclose(*both("state_rate", *arguments), rtol=0.0, atol=100.0 * EXACT)


# -- the control step -----------------------------------------------------------------------------------------------


@frame_tasks
def test_tasks_of_frames_agree(task):
    plain, count = plain_form(task.kernel), 0
    for q, dq in states(task.robot, 8, SHARE):
        count += 1
        for name, arguments in (("value", (q,)), ("linearize", (q,)), ("at", (q, dq))):
            compiled, expected = getattr(task, name)(*arguments), getattr(plain, name)(*arguments)
            assert type(compiled) is type(expected)
            for one, other in zip(*([compiled], [expected]) if name == "value" else (compiled, expected), strict=True):
                assert one.shape == other.shape
                np.testing.assert_allclose(one, other, rtol=0.0, atol=EXACT * (1.0 + 10.0 * np.abs(dq).max() ** 2))
    assert count * len(TASKS) >= STATES


@frame_tasks
def test_acceleration_maps_agree(task):
    random, regular, fading = np.random.default_rng(9), 0, 0
    while regular < SHARE:
        q_bar, _ = random_state(task.robot, random)
        if np.linalg.cond(task.linearize(q_bar)[1]) > 1e3:
            continue
        # Every other chart has a metric.
        metric = ("identity", "inertial")[regular // 10 % 2]
        drive = AccelerationMap(Chart.from_base(task, q_bar, metric=metric))
        compiled, plain = drive._kernel, plain_form(drive._kernel)
        for _ in range(10):
            J = task.linearize(q_bar + 0.3 * random.normal(size=task.robot.n))[1]
            F, dq = random.normal(size=task.robot.n), random.choice([1.0, 10.0]) * random.normal(size=task.robot.n)
            one, other = compiled(J, F, dq), plain(J, F, dq)
            A = np.vstack((J, drive.chart.Wt))
            if np.linalg.cond(A) < 1e6:
                assert one[0] == other[0]
            if one[0] != DONE or other[0] != DONE:
                fading += 1
                continue
            regular += 1
            np.testing.assert_allclose(one[1], other[1], rtol=0.0, atol=exact(A, scale=10.0 * np.abs(other[1]).max()))
            assert one[2] == pytest.approx(other[2], abs=exact(A, A))
    assert compiled(0.0 * J, F, dq)[0] == plain(0.0 * J, F, dq)[0] == UNDECIDED
    assert compiled(J, F, np.nan * dq)[0] == plain(J, F, np.nan * dq)[0] == UNDECIDED


@frame_tasks
def test_tracking_laws_agree(task):
    robot, random, regular = task.robot, np.random.default_rng(10), 0
    m, r = task.m, robot.n - task.m
    variants, metrics = list(product([True, False], [True, False])), cycle(["identity", "inertial"])
    while regular < SHARE:
        q_bar = random_state(robot, random)[0]
        if np.linalg.norm(np.linalg.pinv(task.linearize(q_bar)[1]), 2) > 10.0:
            continue
        gains = random.uniform(5.0, 10.0, (4, robot.n))
        track = Track(random.uniform(-0.1, 0.1, r), kp=gains[2, :r], kd=gains[3, :r])
        options = {"kp": gains[0, :m], "kd": gains[1, :m], "atlas": Atlas(task, metric=next(metrics))}
        controller = EosController(task, Hold(task.value(q_bar), m), track, **options)
        law = pickle.loads(pickle.dumps(controller.start(0.0, q_bar, 0.0 * q_bar).law))
        plain = plain_form(law)
        for moving, carried in variants:
            q, dq = q_bar + random.uniform(-0.1, 0.1, robot.n), random.uniform(-2.0, 2.0, robot.n)
            dz_d, ddz_d = moving * random.normal(size=(2, m))
            state = q, dq, task.value(q_bar), dz_d, ddz_d, random.normal(size=r) if carried else None
            one, other = law(*state), plain(*state)
            if one[0] != DONE or other[0] != DONE:
                continue
            regular += 1
            tolerance = exact(np.vstack((one[3], plain.Wt)), scale=100.0)
            np.testing.assert_allclose(one[1], other[1], rtol=0.0, atol=tolerance)
            assert one[2] == pytest.approx(other[2], abs=tolerance)
            np.testing.assert_allclose(one[3], other[3], rtol=0.0, atol=10.0 * EXACT)


def test_plain_tracking_law_is_the_law_in_full(panda):
    """Against `EosController.asked` and one solve with [G'; Vᵀ]."""
    task, random = PoseTask(panda, tip(panda)), np.random.default_rng(11)
    q_bar = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    controller = EosController(task, Hold(task.value(q_bar), 6))
    state = controller.start(0.0, q_bar, 0.0 * q_bar)
    for form in (state.law, plain_form(state.law)):
        q, dq = q_bar + random.uniform(-0.1, 0.1, 7), random.uniform(-1.0, 1.0, 7)
        status, ddq, margin, J = form(q, dq, *controller.reference(0.0), None)
        F = controller.asked(0.0, q, dq, state.chart, task.at(q, dq))
        assert status == DONE
        np.testing.assert_allclose(ddq, np.linalg.solve(np.vstack((J, state.chart.Vt)), F), atol=1e-10)
        assert 0.0 < margin <= state.chart.margin(J) + 1e-12


@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_limits_agree(panda, period):
    task, random, active = PositionTask(panda, tip(panda)), np.random.default_rng(12), 0
    limits = JointLimits.from_robot(panda)
    controller = LimitedEosController(
        task, Hold(task.value(0.5 * (panda.lower + panda.upper))), limits=limits, control_period=period
    )
    compiled, plain = controller._within, plain_form(controller._within)
    for _ in range(STATES):
        size = random.choice([1.0, 30.0, 1000.0])
        # A beta distribution that favours the ends of the range.
        q = panda.lower + (panda.upper - panda.lower) * random.beta(0.5, 0.5, 7)
        dq, ddq = panda.velocity * random.normal(size=7) / 3.0, size * random.normal(size=7)
        J = task.linearize(q)[1]
        one, other = compiled(q, dq, ddq, J), plain(q, dq, ddq, J)
        active += one[1].any()
        for x, y in zip(one, other, strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-6, atol=1e-6 * size)
    assert STATES // 10 < active < STATES


@pytest.mark.parametrize("size", [(3, 7), (6, 7), (2, 4)], ids=str)
def test_programs_of_the_smallest_change_agree(size):
    """Of the compiled form and of daqp, which the compiled one asks where it does not find the solution itself."""
    (m, n), random, asked = size, np.random.default_rng(14), 0
    program = SmallestChange(m, n).program
    model, *rest = program.__reduce__()[1]

    def solve():
        nonlocal asked
        asked += 1
        return model.solve()

    counted = kernels.ChangeProgram(types.SimpleNamespace(update=model.update, solve=solve), *rest)
    plain = plain_form(program)
    for _ in range(STATES):
        J, root = random.normal(size=(m, n)), random.normal(size=(n, n))
        # From one bound that demands a change to many.
        lower = random.uniform(-10.0, random.choice([0.2, 0.5, 5.0]), 2 * n)
        upper = lower + random.exponential(50.0, 2 * n)
        # Torques for it, mostly.
        lower[n:], upper[n:] = np.minimum(20.0 * lower[n:], -1.0), np.maximum(20.0 * upper[n:], 1.0)
        given = J, root @ root.T + 0.1 * np.eye(n), lower, upper
        (status, change), (expected_status, expected) = counted(*given), plain(*given)
        assert status == expected_status
        if status == DONE:
            np.testing.assert_allclose(change, expected, atol=2e-6 * (1.0 + np.abs(expected).max()))
    assert STATES // 20 < asked < 4 * STATES // 5


def test_limits_far_from_all_of_them_change_nothing(panda):
    """The box in which the plain form looks no further lies where the bounds leave room."""
    task = PositionTask(panda, tip(panda))
    controller = LimitedEosController(task, Hold(task.value(0.5 * (panda.lower + panda.upper))))
    plain, random = plain_form(controller._within), np.random.default_rng(13)
    for _ in range(STATES):
        # On the surface of the box.
        x = random.uniform(-1.0, 1.0, 28)
        x[random.integers(28)] = random.choice([-1.0, 1.0])
        q, dq, ddq, _ = (x / plain._per_half).reshape(4, 7)
        q = plain._middle + q
        least, most = controller.limits.accelerations(q, dq, controller.control_period)
        assert (ddq - least >= 20.0 - 1e-9).all()
        assert (most - ddq >= 20.0 - 1e-9).all()


# -- kinematics of many states --------------------------------------------------------------------------------------


@frame_tasks
def test_kinematics_of_many_states_agree(task):
    kinematics = task.kinematics
    assert kinematics.compiled
    Q = np.array([q for q, _ in states(task.robot, 14, STATES // 2)])
    Z, J = kinematics.linearize(Q)
    plain_Z, plain_J = kinematics._plain.linearize(Q)
    np.testing.assert_allclose(Z, plain_Z, atol=10.0 * EXACT)
    np.testing.assert_allclose(J, plain_J, atol=10.0 * EXACT)
    np.testing.assert_allclose(kinematics.value(Q), plain_Z, atol=10.0 * EXACT)
    steps, plain_steps = kinematics.minus(Z[1:], Z[:-1]), kinematics._plain.minus(Z[1:], Z[:-1])
    # Half a turn away a rotation vector and its opposite are the same.
    small = (np.linalg.norm(plain_steps[:, -3:], axis=1) < 3.0) | (task.m == task.size)
    assert len(TASKS) * small.sum() >= STATES
    np.testing.assert_allclose(steps[small], plain_steps[small], atol=1e-9)


def test_searches_agree(panda):
    task, random = PoseTask(panda, tip(panda)), np.random.default_rng(15)
    Q = random.uniform(0.8 * panda.lower + 0.2 * panda.upper, 0.2 * panda.lower + 0.8 * panda.upper, (STATES, 7))
    Z = task.kinematics.value(Q)
    starts = Q + 0.1 * random.normal(size=Q.shape)
    arguments = Z, panda.lower, panda.upper, 1e-10, 10, False
    found, left, steps = task.kinematics._chain.search(starts, *arguments)
    plain, plain_left, plain_steps = task.kinematics._plain.search(starts, *arguments)
    done = (left <= 1e-10) & (plain_left <= 1e-10)
    assert done.sum() >= 0.9 * STATES
    np.testing.assert_array_equal(left <= 1e-10, plain_left <= 1e-10)
    np.testing.assert_allclose(found[done], plain[done], atol=1e-7)
    np.testing.assert_array_equal(steps[done], plain_steps[done])


def test_tangents_and_traces_agree(panda):
    task = PoseTask(panda, tip(panda))
    kinematics, random = task.kinematics, np.random.default_rng(16)
    nodes, units = [], []
    while sum(map(len, nodes)) < STATES:
        q = random.uniform(panda.lower, panda.upper)
        z = task.value(q)
        curve = kinematics.trace(q)
        if curve.ends != ("closed", "closed"):
            continue
        plain, _, end = tracing.trace(
            kinematics._plain, q, z, kinematics.revolute, 1.0, 0.1, 0.2, 300.0, SHORTEST, 1e-11, MOST_NODES
        )
        assert end == tracing.CLOSED
        np.testing.assert_allclose(curve.q, plain, atol=1e-7)
        T, regular = kinematics.tangents(curve.q, z)
        plain_T, plain_regular = tracing.tangents(kinematics._plain, curve.q, z)
        np.testing.assert_allclose(T, plain_T, atol=1e-9)
        np.testing.assert_allclose(regular, plain_regular, atol=1e-10)
        nodes.append(curve.q)
        units.append(curve.t)
    Q, T = np.concatenate(nodes), np.concatenate(units)
    shifted = Q + 0.01 * random.normal(size=Q.shape)
    arguments = shifted, T, nodes[0][:-1], units[0][:-1], kinematics.revolute
    number, gap = kernels.nearest(*arguments[:4], kinematics.revolute.astype(np.uint8))
    plain_number, plain_gap = tracing.nearest(*arguments)
    np.testing.assert_array_equal(number, plain_number)
    np.testing.assert_allclose(gap, plain_gap, atol=10.0 * EXACT)


def test_distances_agree(panda):
    capsules = {f"panda_link{i}": Capsule([0, 0, 0], [0, 0.02, 0.1], 0.06) for i in (2, 4, 6)}
    scene = Scene([Box([0.4, 0.1, 0.6], [0.2, 0.1, 0.3], [0.8, 0.6, 0.0, 0.0])])
    clear = Clearances(Bodies.of(panda, capsules), scene)
    Q = np.array([q for q, _ in states(panda, 17, STATES)]).T
    compiled = clear.pairs(Q)
    assert clear._chain is not None
    clear._chain = None
    np.testing.assert_allclose(compiled, clear.pairs(Q), atol=1e-12)


# -- the whole ------------------------------------------------------------------------------------------------------


def test_tasks_are_copied_with_their_kernels(panda):
    q, dq = random_state(panda, seed=3)
    task = PoseTask(panda, tip(panda))
    expected = task.at(q, dq)
    for kernel in (pickle.loads(pickle.dumps(task.kernel)), pickle.loads(pickle.dumps(plain_form(task.kernel)))):
        task.value(0.0 * q)
        for one, other in zip(kernel.at(q, dq), expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=0.0, atol=10.0 * EXACT)


STEP = """
import numpy as np
import eos_pin
from eos_pin._kernels.dispatch import kernels
robot = eos_pin.load_robot("panda", chain_to="panda_hand_tcp")
task = eos_pin.PoseTask(robot, "panda_hand_tcp")
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
loop = eos_pin.ControlLoop(eos_pin.EosController(task, eos_pin.Hold(task.value(q + 0.1), 6)))
print(kernels is None, *loop.step(0.0, q, 0.1 * q))
"""


def test_plain_kernels_do_it_all_where_nothing_is_compiled():
    found = {}
    for switch in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-c", STEP], env=os.environ | {"EOS_PIN_COMPILED": switch}, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        without, *torque = done.stdout.split()
        assert without == str(switch == "0")
        found[switch] = np.array(torque, dtype=float)
    np.testing.assert_allclose(found["1"], found["0"], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("kind", [PositionTask, OrientationTask, PoseTask])
def test_springs_are_those_of_the_plain_form(panda, kind) -> None:
    task = kind(panda, "panda_hand_tcp")
    hold = task.hold(np.full(7, 0.4))
    for q, dq in states(panda, 5, 50):
        law = ImpedanceController(task, hold, damping_ratio=0.8).start(0.0, q, dq).laws[0].at_rest
        state = dq, *task.linearize(q), 0.3 * dq
        np.testing.assert_allclose(law(*state), plain_form(law)(*state), rtol=1e-10, atol=1e-8)
