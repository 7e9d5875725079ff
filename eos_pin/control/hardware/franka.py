"""`FrankaConnection`: Franka's robots, through `pylibfranka`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType
from typing import Any

import numpy as np

from eos_pin._arrays import JointVector, checked
from eos_pin.control.hardware.connection import CommandKind, Connection, Sample
from eos_pin.errors import HardwareError, MissingDependencyError

#: Errors of pylibfranka, which have no base in common.
ERRORS = (
    "FrankaException", "ControlException", "CommandException", "NetworkException", "InvalidOperationException",
    "RealtimeException",
)  # fmt: skip


class FrankaConnection(Connection):
    """A Franka robot, by torques, joint velocities or joint positions at 1 kHz.

    The robot compensates gravity and its joints' friction, so a torque controller is made with `gravity=False`. Torques
    that change by more than 1 N m from one period to the next are refused by the robot: a `ControlLoop` for it has
    `torque_rate=1000` or less.

    Args:
        address: Address of the robot in the network.
        command: Kind of command that it takes.
        real_time: Whether a kernel without real-time scheduling is refused.

    Raises:
        MissingDependencyError: pylibfranka is not installed.
        InputError: There are no such commands.
    """

    compensates_gravity = True

    @checked
    def __init__(self, address: str, *, command: CommandKind = "torque", real_time: bool = True) -> None:
        self.command, self.control_period = command, 1e-3
        self._address, self._real_time, self._library = address, real_time, _imported()
        self._robot: Any = None
        self._exchange: Any = None
        self._t, self._rest = 0.0, [0.0] * 7

    def open(self) -> None:
        library = self._library
        config = library.RealtimeConfig.kEnforce if self._real_time else library.RealtimeConfig.kIgnore
        with self._own_errors():
            self._robot = library.Robot(self._address, config)
            self._robot.automatic_error_recovery()
            if self.command == "torque":
                self._exchange = self._robot.start_torque_control()
            elif self.command == "velocity":
                self._exchange = self._robot.start_joint_velocity_control(library.ControllerMode.JointImpedance)
            else:
                self._exchange = self._robot.start_joint_position_control(library.ControllerMode.JointImpedance)
        self._t = 0.0

    def read(self) -> Sample:
        with self._own_errors():
            state, passed = self._exchange.readOnce()
        self._t += passed.to_sec()
        # Where it is commanded to be, for a last command that moves nothing.
        self._rest = list(state.q_d)
        return Sample(self._t, np.array(state.q, dtype=float), np.array(state.dq, dtype=float))

    def write(self, command: JointVector) -> None:
        self._send(command.tolist(), last=False)

    def close(self) -> None:
        if self._exchange is not None:
            rest = self._rest if self.command == "position" else [0.0] * 7
            self._send(rest, last=True)
            self._exchange = None

    def emergency_stop(self) -> None:
        if self._robot is not None:
            # It may have stopped by itself, and reports that already.
            with suppress(Exception):
                self._robot.stop()

    def _send(self, values: list[float], *, last: bool) -> None:
        library = self._library
        kind = {"torque": library.Torques, "velocity": library.JointVelocities, "position": library.JointPositions}
        with self._own_errors():
            message = kind[self.command](values)
            message.motion_finished = last
            self._exchange.writeOnce(message)

    @contextmanager
    def _own_errors(self) -> Iterator[None]:
        """Turn errors of the robot into `HardwareError`."""
        try:
            yield
        except tuple(getattr(self._library, name) for name in ERRORS) as error:
            raise HardwareError(f"the robot at {self._address} reports: {error}") from error


def _imported() -> ModuleType:
    try:
        import pylibfranka
    except ImportError as error:
        raise MissingDependencyError("a FrankaConnection", "pylibfranka", "pip install 'eos-pin[franka]'") from error
    return pylibfranka
