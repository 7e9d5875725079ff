"""`Runner`: a control loop on a robot, from a soft start to a standstill, with a watchdog."""

from __future__ import annotations

import gc
import math
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic, perf_counter
from typing import Literal, TypeAlias

import numpy as np

from eos_pin._arrays import JointVector, PositiveOrInfinite, checked, number
from eos_pin.control.hardware.connection import Connection, Sample
from eos_pin.control.hardware.log import RunLog
from eos_pin.control.kinematic import KinematicLoop
from eos_pin.control.loop import ControlLoop
from eos_pin.errors import EosError, HardwareError, InputError, StateError
from eos_pin.trajectories.pace import Clock

RunStatus: TypeAlias = Literal["finished", "stopped", "failed"]
#: Rate at which a robot without a paced path is braked [1/s], and at which speed it counts as standing [rad/s or m/s].
BRAKE, STANDS = 10.0, 5e-3
#: Width of the bins in which latencies are counted [s], and their number.
BIN, BINS = 1e-6, 50_000


@dataclass(frozen=True)
class RunReport:
    """Account of a run on a robot.

    Attributes:
        status: Whether it ran to its end, was stopped, or failed.
        message: Reason of a stop or a failure.
        seconds: Length of the run, on the robot's clock.
        samples: Number of states that were read.
        refused: States that the loop could not use; the command before stayed.
        missed: Deadlines that were missed: commands later than a control period after their state, and states that
            never came.
        latency_median: Time from a state to its command: its median, to 1e-6 s [s].
        latency_p999: The same: exceeded by one of a thousand.
        latency_max: The same: the worst.
    """

    status: RunStatus
    message: str
    seconds: float
    samples: int
    refused: int
    missed: int
    latency_median: float
    latency_p999: float
    latency_max: float

    @property
    def ok(self) -> bool:
        """Whether the run did not fail."""
        return self.status != "failed"


class Runner:
    """A control loop that drives a robot through its connection.

    `run` reads states and writes commands until it is over. Meanwhile `pause`, `resume`, `set_speed` and `stop` may be
    called from other threads, as `run` and the connection are used by one thread only. Ctrl-C is a `stop`; a second one
    is an emergency stop.

    A stop is graceful: the path comes to rest, with the task still on it, and the run is over when the robot stands. A
    torque loop without a clock brakes each joint. A watchdog in a thread of its own calls `Connection.emergency_stop`
    where no command was written for too long, whatever the cause; so does an error in the loop.

    A state that the loop refuses is answered by the command before (a velocity by zero); several in a row end the run.

    Args:
        connection: Connection to the robot.
        loop: A `ControlLoop` for torques, or a `KinematicLoop` for positions or velocities. `soft_start` and
            `torque_rate` of a `ControlLoop` are its start-up ramp.
        clock: The clock by which the controller's path and objective are paced, see `PacedPath`; a `KinematicLoop` has
            its own pace. Made with speed 0 it starts softly, as `run` sets the speed to 1.
        log: Log of the run, which is closed at its end.
        watchdog: Time without a command after which the robot is stopped [s].
        stop_time: Longest time that a graceful stop may take before it is an emergency stop [s].
        most_refused: Refused states in a row that are borne.
        priority: Priority of the loop among the real-time threads of the machine (SCHED_FIFO), from 1 to 99; 0 leaves
            it among all others. It takes a right that users usually lack, and Linux.

    Raises:
        InputError: Loop and connection do not fit each other, or a number is out of its range.
    """

    @checked
    def __init__(
        self,
        connection: Connection,
        loop: ControlLoop | KinematicLoop,
        *,
        clock: Clock | None = None,
        log: RunLog | None = None,
        watchdog: float = 0.1,
        stop_time: float = 5.0,
        most_refused: int = 5,
        priority: int = 0,
    ) -> None:
        kinematic = isinstance(loop, KinematicLoop)
        if kinematic is (connection.command == "torque"):
            wanted = "ControlLoop" if kinematic else "KinematicLoop"
            raise InputError(f"this robot takes commands of {connection.command}: give it a {wanted}")
        if kinematic and clock is not None:
            raise InputError("a KinematicLoop has a pace of its own; leave out the clock")
        self.connection, self.loop, self.clock, self._log = connection, loop, clock, log
        self.watchdog = number(watchdog, "the watchdog's time", above=0.0)
        self.stop_time = number(stop_time, "the time of a stop", above=0.0)
        if most_refused < 0:
            raise InputError(f"the most refused states in a row, most_refused, must be at least 0, got {most_refused}")
        if not 0 <= priority <= 99:
            raise InputError(f"a priority is a whole number from 0 to 99, got {priority}")
        self.most_refused, self.priority = most_refused, priority
        self._speed, self._stop, self._emergency = 1.0, "", ""
        self._over = threading.Event()

    # -- from other threads ------------------------------------------------------------------------------------------

    @checked
    def set_speed(self, speed: float) -> None:
        """Run along the path at another speed, as soon as a change that is under way is over.

        Raises:
            InputError: The speed is negative, or there is no clock whose speed could be changed.
        """
        if isinstance(self.loop, ControlLoop) and self.clock is None:
            raise InputError("a torque loop is slowed by the clock of its path; make the runner with that clock")
        self._speed = number(speed, "the speed", at_least=0.0)

    def pause(self) -> None:
        """Come to rest on the path, and hold there."""
        self.set_speed(0.0)

    @checked
    def resume(self, speed: float = 1.0) -> None:
        """Go on along the path."""
        self.set_speed(speed)

    def stop(self, reason: str = "asked for") -> None:
        """Come to rest and end the run."""
        self._stop = self._stop or reason

    # -- the run -----------------------------------------------------------------------------------------------------

    @checked
    def run(self, duration: PositiveOrInfinite = math.inf) -> RunReport:
        """Drive the robot until a time is over, it is stopped, or something fails.

        Args:
            duration: Length of the run on the robot's clock [s]; it then comes to rest as after `stop`.

        Returns:
            An account of the run; errors of the robot and of the loop are in its message.

        Raises:
            InputError: The duration is not positive, or the priority is not granted.
        """
        duration = math.inf if duration == math.inf else number(duration, "the duration", above=0.0)
        with _scheduled(self.priority):
            return self._run(duration)

    def _run(self, duration: float) -> RunReport:
        self._begin()
        watch = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        status: RunStatus = "finished"
        message = ""
        # What is there already need not be looked through for garbage during the run.
        gc.freeze()
        try:
            with self._interruptible():
                self.connection.open()
                self._fed = monotonic()
                watch.start()
                while not self._standing:
                    self._period(duration)
                self._over.set()
                self.connection.close()
            if self._stop:
                status, message = "stopped", self._stop
        except BaseException as error:
            self.connection.emergency_stop()
            if not isinstance(error, EosError):
                raise
            status, message = "failed", self._emergency or str(error)
        finally:
            gc.unfreeze()
            self._over.set()
            if self._log is not None:
                self._log.close()
        counted, many = np.cumsum(self._latencies), max(self._samples, 1)
        part = {p: float(BIN * np.searchsorted(counted, p * many)) for p in (0.5, 0.999)}
        return RunReport(
            status, message, self._t - self._t_first if self._samples else 0.0, self._samples, self._refused,
            self._missed, part[0.5], part[0.999], self._worst,
        )  # fmt: skip

    def _begin(self) -> None:
        self._over.clear()
        self._stop = self._emergency = ""
        self._samples = self._refused = self._missed = self._in_a_row = 0
        self._latencies, self._worst = [0] * (BINS + 1), 0.0
        self._t_first = self._t = self._since = math.nan
        self._last: JointVector | None = None
        self._standing = False
        self.loop.reset()

    def _period(self, duration: float) -> None:
        """One state and its command."""
        sample = self.connection.read()
        begun = perf_counter()
        if not self._samples:
            self._t_first = sample.t
            self._check_gravity(sample)
        else:
            gap = (sample.t - self._t) / self.connection.control_period
            self._missed += max(round(gap) - 1, 0) if math.isfinite(gap) else 0
        self._samples += 1
        self._t = sample.t
        t = sample.t - self._t_first
        if self._stop or t >= duration:
            command = self._braked(t, sample)
        else:
            self._paced(t, self._speed)
            command = self._command(t, sample)
        if self._emergency:
            raise HardwareError(self._emergency)
        self.connection.write(command)
        self._fed = monotonic()
        latency = perf_counter() - begun
        self._latencies[min(int(latency / BIN), BINS)] += 1
        self._worst = max(self._worst, latency)
        self._missed += int(latency / self.connection.control_period)
        self._last = command
        if self._log is not None:
            self._log.add(sample, command, latency)

    def _command(self, t: float, sample: Sample) -> JointVector:
        """Command of the loop; that of the period before where the loop refuses the state."""
        try:
            if isinstance(self.loop, ControlLoop):
                command = self.loop.step(t, sample.q, sample.dq)
            else:
                both = self.loop.step(t, sample.q)
                command = both.q if self.connection.command == "position" else both.dq
            self._in_a_row = 0
        except StateError:
            self._refused += 1
            self._in_a_row += 1
            if self._last is None or self._in_a_row > self.most_refused:
                raise
            command = np.zeros_like(self._last) if self.connection.command == "velocity" else self._last
        return command

    def _paced(self, t: float, speed: float) -> None:
        """Bring the path to a speed."""
        if isinstance(self.loop, KinematicLoop):
            self.loop.pace = speed
        elif self.clock is not None and self.clock(t)[1] != speed and not self.clock.changing(t):
            self.clock.set_speed(t, speed)

    def _braked(self, t: float, sample: Sample) -> JointVector:
        """Command on the way to a standstill."""
        if math.isnan(self._since):
            self._since = t
        if t - self._since > self.stop_time:
            raise HardwareError(f"the robot did not come to rest within {self.stop_time:g} s and was stopped at once")
        self._paced(t, 0.0)
        paced = self.clock is not None or isinstance(self.loop, KinematicLoop)
        at_rest = self.clock is None or self.clock(t)[1] == 0.0
        if isinstance(self.loop, KinematicLoop):
            # Its commands, not the measured joints, say whether it is at rest.
            before = self.loop.path_delay
            command = self._command(t, sample)
            at_rest = self.loop.path_delay - before >= 0.999 * self.connection.control_period
        elif paced:
            command = self._command(t, sample)
        else:
            controller = self.loop.controller
            command = controller._holding_torque(sample.q)
            if controller.robot is not None:
                robot = controller.robot
                command = np.clip(command - BRAKE * robot._mass(sample.q).dot(sample.dq), -robot.effort, robot.effort)
        self._standing = at_rest and float(np.abs(sample.dq).max()) < STANDS
        return command

    def _check_gravity(self, sample: Sample) -> None:
        """Refuse to begin where gravity would be compensated twice, or not at all."""
        if not isinstance(self.loop, ControlLoop) or self.loop.controller.robot is None:
            return
        controller, robot = self.loop.controller, self.loop.controller.robot
        carries = bool(np.any(controller._holding_torque(sample.q)))
        if carries and self.connection.compensates_gravity:
            raise HardwareError(
                "the robot adds the torque of gravity itself, and the controller would add it again; make the "
                "controller with gravity=False"
            )
        if not carries and not self.connection.compensates_gravity and np.any(robot._gravity(sample.q)):
            raise HardwareError("neither robot nor controller compensates gravity; give the controller gravity=True")

    def _watch(self) -> None:
        """Stop the robot where no command was written for too long."""
        while not self._over.wait(0.25 * self.watchdog):
            silent = monotonic() - self._fed
            if silent > self.watchdog:
                self._emergency = f"no command was written for {silent:.3g} s, so the watchdog stopped the robot"
                self.connection.emergency_stop()
                return

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Ctrl-C as a stop, and a second one as an emergency stop, where this is the main thread."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(*_: object) -> None:
            if self._stop:
                self._emergency = "interrupted twice"
                self.connection.emergency_stop()
            self.stop("interrupted")

        before = signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


@contextmanager
def _scheduled(priority: int) -> Iterator[None]:
    """The calling thread, and those that it starts, with a real-time priority.

    Raises:
        InputError: The machine does not grant it.
    """
    if not priority:
        yield
        return
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError) as error:
        raise InputError(
            f"this machine does not grant the real-time priority {priority} ({error}); on Linux it takes root, or a "
            "line such as `@realtime - rtprio 99` in /etc/security/limits.conf. Leave the priority out otherwise"
        ) from error
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)
