"""`MujocoConnection`: MuJoCo in the place of a robot, in real time, for rehearsals of a `Runner`."""

from __future__ import annotations

import math
from time import perf_counter, sleep

import numpy as np

from eos_pin._arrays import JointVector, checked, number
from eos_pin.control.hardware.connection import CommandKind, Connection, Sample
from eos_pin.errors import HardwareError
from eos_pin.robot.postures import JointsLike
from eos_pin.simulation.mujoco import MujocoPlant

#: The end of a wait is not slept but watched for [s].
SPIN = 3e-4
#: Damping of the servo loop of joints that are commanded by velocity or position, times the period.
SERVO = 0.5


class MujocoConnection(Connection):
    """A stand-in for a robot: MuJoCo moves it as time goes by, whether commands come in time or not.

    A torque is held until the next one; one that comes after the end of its period counts from the period in which it
    came. Joints that are commanded by velocity or position follow through a servo loop, as in the robots that take
    such commands. After an emergency stop the joints are locked.

    Args:
        plant: The robot.
        q: Joints at the start, (n,) or some by name.
        command: Kind of command that it takes.
        control_period: Time from one state to the next [s].
        compensates_gravity: Whether it adds the torque of gravity itself.
        real_time: Whether it waits for the clock; without, each period takes no longer than its computation, and no
            command is late.

    Raises:
        InputError: Wrong joints, period or kind of command.
    """

    @checked
    def __init__(
        self,
        plant: MujocoPlant,
        q: JointsLike,
        *,
        command: CommandKind = "torque",
        control_period: float = 1e-3,
        compensates_gravity: bool = False,
        real_time: bool = True,
    ) -> None:
        self.plant, self.command = plant, command
        self.control_period = number(control_period, "the control period", above=0.0)
        self.compensates_gravity = compensates_gravity and command == "torque"
        self._real_time, self._locked = real_time, False
        self._q, self._dq = np.array(plant.posture(q)), np.zeros(plant.n)
        self._asked: JointVector | None = None
        self._period, self._began = -1, math.nan

    def open(self) -> None:
        self._began, self._period, self._locked = perf_counter(), -1, False

    def read(self) -> Sample:
        next_period = self._period + 1
        if self._real_time:
            due = self._began + next_period * self.control_period
            left = due - perf_counter()
            if left > SPIN:
                sleep(left - SPIN)
            while perf_counter() < due:
                pass
            next_period = max(next_period, self._now())
        self._advance(next_period)
        return Sample(next_period * self.control_period, self._q.copy(), self._dq.copy())

    def write(self, command: JointVector) -> None:
        if self._real_time:
            self._advance(self._now())
        self._asked = command.copy()

    def emergency_stop(self) -> None:
        self._locked = True

    def _now(self) -> int:
        """Number of the period that the clock is in."""
        return int((perf_counter() - self._began) / self.control_period)

    def _advance(self, period: int) -> None:
        """Move on to the start of a period.

        Raises:
            HardwareError: The robot was stopped.
        """
        if self._locked:
            self._dq = np.zeros(self.plant.n)
            raise HardwareError("the robot was stopped, its joints are locked")
        for _ in range(max(self._period, 0), period):
            self._q, self._dq = self.plant.advance(self._q, self._dq, self._torque(), self.control_period)
        self._period = max(self._period, period)

    def _torque(self) -> JointVector:
        """Torque that a command makes in the state that is reached; before the first one it holds the robot."""
        q, dq, asked = self._q, self._dq, self._asked
        if asked is None:
            return self.plant.gravity(q)
        if self.command == "torque":
            return asked + self.plant.gravity(q) if self.compensates_gravity else asked
        rate = SERVO / self.control_period
        ddq = rate * (asked - dq) if self.command == "velocity" else 0.25 * rate**2 * (asked - q) - rate * dq
        return self.plant.inverse_dynamics(q, dq, ddq)
