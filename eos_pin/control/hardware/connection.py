"""`Connection`: the contract between a `Runner` and a robot."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

from eos_pin._arrays import JointVector

#: What a robot is commanded by.
CommandKind: TypeAlias = Literal["torque", "velocity", "position"]


class Sample(NamedTuple):
    """Measured state of a robot.

    Attributes:
        t: Time on the robot's own clock [s].
        q: Joints, (n,) [rad or m].
        dq: Joint velocities, (n,) [rad/s or m/s].
    """

    t: float
    q: JointVector
    dq: JointVector


class Connection:
    """Connection to a robot: measured states in, commands out, once a period.

    A subclass has `read` and `write`, and whatever its robot needs of the others. `read` and `write` are called from
    one thread; `emergency_stop` may be called from another one at any time, and then ends a `read` that waits.

    Attributes:
        command: Kind of command that the robot takes.
        control_period: Time from one state to the next [s].
        compensates_gravity: Whether the robot adds the torque of gravity to commanded torques itself.
    """

    command: CommandKind = "torque"
    control_period: float = 1e-3
    compensates_gravity: bool = False

    def open(self) -> None:
        """Begin the exchange; called once, before the first `read`."""

    def read(self) -> Sample:
        """Wait for the next measured state.

        Raises:
            HardwareError: The robot reports an error, or is not heard any more.
        """
        raise NotImplementedError

    def write(self, command: JointVector) -> None:
        """Send a command for the period that has begun.

        Args:
            command: Torques [N m or N], velocities [rad/s or m/s] or positions [rad or m], (n,), as `command` says.

        Raises:
            HardwareError: The robot refuses it.
        """
        raise NotImplementedError

    def close(self) -> None:
        """End the exchange; the robot stands still."""

    def emergency_stop(self) -> None:
        """Stop the robot at once by its own means, in any state."""
