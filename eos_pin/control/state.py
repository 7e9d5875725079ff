"""Memory of `EosController` and of `KinematicLoop` from one call to the next, and the command of the latter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import Jacobian, JointVector, SelfMotionVector, TaskVector, by_value
from eos_pin.charts.chart import Chart
from eos_pin.control._regularize import AccelerationMap
from eos_pin.control._sampled_law import SelfTargets
from eos_pin.errors import StateError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point

#: Decay rate of the offset after a change of charts (`EosState.carried`) [1/s], and the same for every rad/s of joint
#: speed, so that the offset vanishes before a fast robot leaves the chart.
FORGETTING, PER_SPEED = 20.0, 10.0
#: Time after which nothing is left of it to rounding [s].
LONG_AGO = 40.0 / FORGETTING


@by_value
class Command(NamedTuple):
    """Command for joints that take positions or velocities.

    Attributes:
        q: Positions at the end of the period, (n,) [rad or m]. Continuous joints count turns from the first state on.
        dq: Velocities that lead there when they are held over the period, (n,) [rad/s or m/s].
    """

    q: JointVector
    dq: JointVector


@dataclass(frozen=True, eq=False)
class EosState:
    """State of `EosController` between calls.

    Attributes:
        drive: Map from the law to joint accelerations on the chart it is on.
        number: Number of charts before it.
        law: The law and `drive` in one, compiled, where there is that.
        since: Time from which the chart is used [s].
        carried: Offset of the self-motion acceleration that makes the torque continuous at `since`, (r,); it decays.
            None on the first chart.
        made_of: Object that stands for the gains and targets of which `drive` and `law` were made.
    """

    drive: AccelerationMap
    number: int = 0
    law: Any = None
    since: float = 0.0
    carried: SelfMotionVector | None = None
    made_of: object = None

    @property
    def chart(self) -> Chart:
        """The chart it is on."""
        return self.drive.chart

    def left(self, t: float, dq: JointVector) -> SelfMotionVector | None:
        """Offset `carried`, decayed until time t at these joint velocities, (r,); None if nothing is left."""
        if self.carried is None or t - self.since >= LONG_AGO:
            return None
        rate = max(FORGETTING, PER_SPEED * math.sqrt(dq.dot(dq)))
        return math.exp(rate * (self.since - t)) * self.carried


class KinematicState(NamedTuple):
    """Memory of a `KinematicLoop` from one step to the next: the last command, and the targets it had.

    The compiled `KinematicStep` takes it and makes the next one; a tuple, as that is the quickest.
    """

    t: float
    q: JointVector
    dq: JointVector
    measured: JointVector
    z: Point
    on: EosState
    deficit: TaskVector
    limited: bool
    lag: float
    # At the step before: task point and targets, and whose targets they were.
    z_before: Point
    z_d: Point
    reference: object
    v_d: Any = None
    objective: object = None
    # Pace of the path over the last period, and how far path time is behind at its start [s].
    pace: float = 1.0
    behind: float = 0.0

    def seen(self, q: JointVector, robot: Robot, period: float, jump: float, most_lag: float) -> KinematicState:
        """The state with new measured joints.

        Args:
            q: The joints, by the angles nearest to the command.
            robot: The robot.
            period: Control period [s].
            jump: Distance by which a measured joint may move [rad or m].
            most_lag: Distance by which it may be away from its command [rad or m].

        Raises:
            StateError: A joint jumped, or does not follow its command.
        """
        moved = np.abs(q - self.measured)
        allowed = jump + 2.0 * np.abs(self.dq) * period
        joint = int(np.argmax(moved - allowed))
        if moved[joint] > allowed[joint]:
            raise StateError(
                f"no command for this state: q[{joint}] jumped by {moved[joint]:.3g}, more than {allowed[joint]:.3g}. "
                "If the next state agrees with this one, the loop goes on"
            )
        away = np.abs(q - self.q)
        joint = int(np.argmax(away))
        if away[joint] > most_lag:
            raise StateError(
                f"no command for this state: joint {robot.joints[joint].name!r} is {away[joint]:.3g} away from its "
                f"command, more than {most_lag:.3g}; the robot does not follow. reset() the loop to begin where it is"
            )
        return self._replace(measured=q, lag=float(away[joint]))


class Solved(NamedTuple):
    """Joint acceleration of the law at one pace, its chart, whether no direction fades, Jacobian, and the goals."""

    a: JointVector
    on: EosState
    limitless: bool
    J: Jacobian
    goal: Point
    v_d: SelfTargets
