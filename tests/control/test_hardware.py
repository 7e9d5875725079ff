"""The loop of a robot: from a soft start to a standstill, whatever happens meanwhile."""

from __future__ import annotations

import csv
import inspect
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from checks import REST

from eos_pin import ControlLoop, EosController, InputError, KinematicLoop, PositionTask, Robot, circle
from eos_pin.control.hardware import franka
from eos_pin.control.hardware.connection import Connection, Sample
from eos_pin.control.hardware.franka import FrankaConnection
from eos_pin.control.hardware.log import FLUSH, RunLog
from eos_pin.control.hardware.runner import Runner
from eos_pin.errors import HardwareError
from eos_pin.simulation.mujoco import MujocoPlant
from eos_pin.simulation.rehearsal import MujocoConnection
from eos_pin.trajectories.pace import Clock, PacedPath

# In real time, which the first checks of types would take.
pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(autouse=True)
def _patient_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may take longer than the watchdog bears by default."""
    monkeypatch.setitem(inspect.unwrap(Runner.__init__).__kwdefaults__, "watchdog", 5.0)


class Recorded(MujocoConnection):
    """A stand-in whose clock is its own; it remembers its joints, and calls a function at each state."""

    def __init__(self, plant: Robot, visit: Any = None, **options: Any) -> None:
        super().__init__(MujocoPlant.from_robot(plant), REST, real_time=False, **options)
        self.visit, self.seen, self.stops = visit, [], 0

    def read(self) -> Sample:
        sample = super().read()
        self.seen.append((sample.t, sample.q, sample.dq))
        if self.visit is not None:
            self.visit(sample.t)
        return sample

    def emergency_stop(self) -> None:
        self.stops += 1
        super().emergency_stop()


def paced(robot: Robot, **options: Any) -> tuple[ControlLoop, Clock, Any]:
    """A torque loop on a circle at the pace of a clock, and that circle."""
    task = PositionTask(robot, "panda_hand_tcp")
    path, clock = circle(task.value(REST), 0.05, period=2.0, plane="yz"), Clock(speed=0.0)
    return ControlLoop(EosController(task, PacedPath(path, clock), **options), soft_start=0.1), clock, path


def test_run_starts_and_ends_at_rest_on_its_path(panda: Robot, tmp_path: Path) -> None:
    loop, clock, path = paced(panda)
    connection = Recorded(panda)
    log = RunLog(tmp_path / "log.csv", [joint.name for joint in panda.joints], "torque")
    report = Runner(connection, loop, clock=clock, log=log).run(2.0)
    assert report.ok
    assert (report.status, report.refused, connection.stops) == ("finished", 0, 0)
    t, q, dq = connection.seen[-1]
    assert t > 2.0
    assert np.abs(dq).max() < 5e-3
    # It stands where the path was stopped, beyond 2 s by the time that this took.
    task = loop.controller.task
    assert np.abs(task.value(q) - path(clock(t)[0]).z).max() < 2e-3
    table = np.loadtxt(log.path, delimiter=",", skiprows=1)
    assert table.shape == (report.samples, 1 + 3 * 7 + 1)
    assert np.array_equal(table[:, 1:8], [row[1] for row in connection.seen])
    with open(log.path) as file:
        names = next(csv.reader(file))
    assert names[:2] == ["t", "q_panda_joint1"]
    assert names[15] == "tau_panda_joint1"
    # Torque begins with that of gravity.
    assert np.abs(table[0, 15:22] - panda.gravity(REST)).max() < 1e-6


def test_path_pauses_and_goes_on_at_other_speeds(panda: Robot) -> None:
    loop, clock, _ = paced(panda)
    speeds = {500: 0.0, 1200: 0.5}

    def ask(t: float) -> None:
        if round(1e3 * t) in speeds:
            runner.set_speed(speeds[round(1e3 * t)])

    connection = Recorded(panda, ask)
    runner = Runner(connection, loop, clock=clock)
    assert runner.run(2.0).ok
    held = np.array([np.abs(dq).max() for t, _, dq in connection.seen if 1.15 < t < 1.2])
    assert held.max() < 0.05
    assert [clock(s)[1] for s in (0.45, 1.1, 1.9)] == pytest.approx([1.0, 0.0, 0.5], abs=0.02)


def test_loop_without_a_clock_brakes_joints_and_cannot_pause(panda: Robot) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    loop = ControlLoop(EosController(task, circle(task.value(REST), 0.05, period=2.0, plane="yz")))
    runner = Runner(Recorded(panda, lambda t: runner.stop("enough") if t > 0.7 else None), loop)
    report = runner.run()
    assert (report.status, report.message) == ("stopped", "enough")
    assert 0.7 < report.seconds < 2.0
    with pytest.raises(InputError, match="clock"):
        runner.pause()


@pytest.mark.parametrize("command", ["position", "velocity"])
def test_kinematic_loop_drives_a_robot_that_takes_positions_or_velocities(panda: Robot, command: Any) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    path = circle(task.value(REST), 0.05, period=2.0, plane="yz")
    loop = KinematicLoop(task, path, control_period=4e-3)
    connection = Recorded(panda, command=command, control_period=4e-3)
    report = Runner(connection, loop).run(1.0)
    assert report.status == "finished", report.message
    errors = [np.abs(task.value(q) - path(t).z).max() for t, q, _ in connection.seen if 0.8 < t < 1.0]
    # Positions follow their commands with the delay of the servo loop.
    assert max(errors) < {"position": 8e-3, "velocity": 2e-3}[command]
    with pytest.raises(InputError, match="KinematicLoop"):
        Runner(Recorded(panda, command=command), paced(panda)[0])
    with pytest.raises(InputError, match="ControlLoop"):
        Runner(Recorded(panda), loop)


def test_watchdog_stops_the_robot_when_the_loop_hangs(panda: Robot) -> None:
    loop, clock, _ = paced(panda)
    began = []

    def hang(t: float) -> None:
        if t > 0.05:
            began.append(time.monotonic())
            time.sleep(0.3)

    connection = Recorded(panda, hang)
    report = Runner(connection, loop, clock=clock, watchdog=0.05).run(1.0)
    assert report.status == "failed"
    assert "watchdog" in report.message
    assert connection.stops >= 1
    assert len(began) == 1


def test_states_that_cannot_be_used_are_borne_for_a_while(panda: Robot) -> None:
    loop, clock, _ = paced(panda)

    class Blind(Recorded):
        blind = (0.1, 0.103)

        def read(self) -> Sample:
            sample = super().read()
            return sample._replace(q=np.full(7, np.nan)) if self.blind[0] < sample.t < self.blind[1] else sample

    connection = Blind(panda)
    report = Runner(connection, loop, clock=clock).run(0.3)
    assert (report.status, report.refused) == ("finished", 2)
    loop, clock, _ = paced(panda)
    connection = Blind(panda)
    connection.blind = (0.1, 1.0)
    report = Runner(connection, loop, clock=clock).run(0.3)
    assert (report.status, report.refused) == ("failed", 6)
    assert "finite" in report.message
    assert connection.stops == 1


def test_gravity_that_is_compensated_twice_or_not_at_all_is_refused(panda: Robot) -> None:
    loop, clock, _ = paced(panda)
    report = Runner(Recorded(panda, compensates_gravity=True), loop, clock=clock).run(0.1)
    assert "gravity=False" in report.message
    loop, clock, _ = paced(panda, gravity=False)
    report = Runner(Recorded(panda), loop, clock=clock).run(0.1)
    assert "neither" in report.message
    report = Runner(Recorded(panda, compensates_gravity=True), loop, clock=clock).run(0.1)
    assert report.ok, report.message


def test_bad_arguments_of_a_runner_are_refused(panda: Robot) -> None:
    loop, _, _ = paced(panda)
    for wrong in ({"watchdog": 0.0}, {"stop_time": -1.0}, {"most_refused": -1}, {"priority": 100}):
        with pytest.raises(InputError):
            Runner(Recorded(panda), loop, **wrong)
    with pytest.raises(InputError, match="duration"):
        Runner(Recorded(panda), loop).run(0.0)
    with pytest.raises(InputError, match="command must be"):
        Recorded(panda, command="force")


SCRIPT = """
import sys
import numpy as np
from eos_pin.control.hardware.log import RunLog
from eos_pin.control.hardware.connection import Sample
import time
log = RunLog(sys.argv[1], ["a", "b"], "torque")
print("ready", flush=True)
k = 0
while True:
    log.add(Sample(time.time(), np.zeros(2), np.zeros(2)), np.full(2, k), 0.0)
    k += 1
    time.sleep(0.001)
"""


def test_log_of_a_killed_process_lacks_a_tenth_of_a_second_at_most(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(file)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.5)
    os.kill(process.pid, signal.SIGKILL)
    killed = time.time()
    process.wait()
    process.stdout.close()
    lines = file.read_text().splitlines()
    rows = [row for row in (line.split(",") for line in lines[1:]) if len(row) == 8]
    assert len(lines) - 1 - len(rows) <= 1
    assert FLUSH <= 0.05
    assert killed - float(rows[-1][0]) < 0.1
    assert [float(row[5]) for row in rows] == list(range(len(rows)))


# -- Franka, without the robot -------------------------------------------------------------------------------------


class FakeRobot:
    """What `pylibfranka.Robot` has of what is used, moved by MuJoCo."""

    made: ClassVar[list[FakeRobot]] = []

    def __init__(self, robot_ip_address: str, realtime_config: str = "kEnforce") -> None:
        self.address, self.config, self.stopped = robot_ip_address, realtime_config, False
        FakeRobot.made.append(self)

    def automatic_error_recovery(self) -> None: ...

    def stop(self) -> None:
        self.stopped = True

    def start_torque_control(self) -> FakeExchange:
        return FakeExchange(self, "torque")

    def start_joint_velocity_control(self, arg0: str) -> FakeExchange:
        return FakeExchange(self, "velocity")

    def start_joint_position_control(self, arg0: str) -> FakeExchange:
        return FakeExchange(self, "position")


class FakeExchange:
    """The same of `pylibfranka.ActiveControlBase`."""

    plant: MujocoPlant
    fails_at = np.inf

    def __init__(self, robot: FakeRobot, command: Any) -> None:
        self.robot = robot
        self.inner = MujocoConnection(
            self.plant, REST, command=command, real_time=False, compensates_gravity=command == "torque"
        )
        self.messages: list[Any] = []
        robot.exchange = self

    def readOnce(self) -> tuple[Any, Any]:
        sample = self.inner.read()
        if sample.t > self.fails_at or self.robot.stopped:
            raise FakeError("communication_constraints_violation")
        state = SimpleNamespace(q=sample.q.tolist(), dq=sample.dq.tolist(), q_d=sample.q.tolist())
        return state, SimpleNamespace(to_sec=lambda: 1e-3)

    def writeOnce(self, arg0: Any) -> None:
        self.messages.append(arg0)
        self.inner.write(np.array(arg0.values))


class FakeCommand:
    """The same of `pylibfranka.Torques`, `JointVelocities` and `JointPositions`."""

    def __init__(self, arg0: list[float]) -> None:
        assert len(arg0) == 7
        self.values, self.motion_finished = arg0, False


class FakeError(RuntimeError): ...


@pytest.fixture
def fake(panda: Robot, monkeypatch: pytest.MonkeyPatch) -> Any:
    library = SimpleNamespace(
        Robot=FakeRobot,
        RealtimeConfig=SimpleNamespace(kEnforce="kEnforce", kIgnore="kIgnore"),
        ControllerMode=SimpleNamespace(JointImpedance="JointImpedance"),
        Torques=FakeCommand,
        JointVelocities=FakeCommand,
        JointPositions=FakeCommand,
        **dict.fromkeys(franka.ERRORS, FakeError),
    )
    monkeypatch.setattr(franka, "_imported", lambda: library)
    monkeypatch.setattr(FakeExchange, "plant", MujocoPlant.from_robot(panda), raising=False)
    FakeRobot.made.clear()
    return library


def test_franka_runs_from_start_to_standstill(panda: Robot, fake: Any) -> None:
    loop, clock, _ = paced(panda, gravity=False)
    report = Runner(FrankaConnection("172.16.0.2"), loop, clock=clock).run(1.0)
    assert report.ok, report.message
    (robot,) = FakeRobot.made
    assert (robot.address, robot.config) == ("172.16.0.2", "kEnforce")
    messages = robot.exchange.messages
    assert messages[-1].motion_finished
    assert not any(message.motion_finished for message in messages[:-1])
    assert not robot.stopped


@pytest.mark.parametrize("command", ["velocity", "position"])
def test_franka_takes_velocities_and_positions(panda: Robot, fake: Any, command: Any) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    loop = KinematicLoop(task, circle(task.value(REST), 0.05, period=2.0, plane="yz"), control_period=1e-3)
    report = Runner(FrankaConnection("172.16.0.2", command=command, real_time=False), loop).run(0.02)
    assert report.ok, report.message
    (robot,) = FakeRobot.made
    assert robot.config == "kIgnore"
    assert robot.exchange.messages[-1].motion_finished


def test_error_of_the_franka_ends_the_run_with_its_words(
    panda: Robot, fake: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FakeExchange, "fails_at", 0.2)
    loop, clock, _ = paced(panda, gravity=False)
    report = Runner(FrankaConnection("172.16.0.2"), loop, clock=clock).run(1.0)
    assert report.status == "failed"
    assert "172.16.0.2" in report.message
    assert "communication_constraints_violation" in report.message
    assert FakeRobot.made[0].stopped


def test_fake_has_the_signatures_of_pylibfranka() -> None:
    """Pybind11 writes them into docstrings; `argN` are arguments without names."""
    library = pytest.importorskip("pylibfranka")
    pairs = {library.Robot: FakeRobot, library.ActiveControlBase: FakeExchange, library.Torques: FakeCommand}
    pairs |= {library.JointVelocities: FakeCommand, library.JointPositions: FakeCommand}
    seen = 0
    for real, fake_class in pairs.items():
        for name, method in vars(fake_class).items():
            if not callable(method) or (name.startswith("_") and name != "__init__"):
                continue
            if real is library.ActiveControlBase and name == "__init__":
                continue  # only a robot makes one
            text = getattr(real, name).__doc__
            names = [re.findall(r"[(,] ?(\w+): [a-z]", line)[1:] for line in text.splitlines() if "self: " in line]
            assert list(method.__code__.co_varnames[1 : method.__code__.co_argcount]) in names, (real, name, text)
            seen += 1
    assert seen >= 11
    for name in (*franka.ERRORS, "RealtimeConfig", "ControllerMode"):
        assert hasattr(library, name)
    assert {"q", "dq", "q_d"} <= set(dir(library.RobotState))
    assert {"kEnforce", "kIgnore"} <= set(library.RealtimeConfig.__members__)
    assert "JointImpedance" in library.ControllerMode.__members__
    assert library.Torques([0.0] * 7).motion_finished is False


def test_missing_pylibfranka_is_named_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    with pytest.raises(ImportError, match=r"pip install 'eos-pin\[franka\]'"):
        FrankaConnection("172.16.0.2")


def test_connection_that_dies_is_an_error_of_the_run(panda: Robot) -> None:
    class Dead(Connection):
        def read(self) -> Sample:
            raise HardwareError("no answer")

    assert Runner(Dead(), paced(panda)[0]).run(1.0).message == "no answer"
    assert threading.active_count() < 20
