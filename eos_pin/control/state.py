"""Memory of `EosController` and of `KinematicLoop` from one call to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from eos_pin._arrays import JointVector, SelfMotionVector, TaskVector
from eos_pin.charts.chart import Chart
from eos_pin.control._regularize import AccelerationMap
from eos_pin.tasks.base import Point

#: Rate at which the acceleration that is carried over to the next chart is forgotten [1/s], and that for every radian
#: per second of joint speed: it has to be gone before a fast robot is through with the chart.
FORGETTING, PER_SPEED = 20.0, 10.0
#: Time after which nothing is left of it to rounding [s].
LONG_AGO = 40.0 / FORGETTING


@dataclass(frozen=True, eq=False)
class EosState:
    """State of `EosController` between calls.

    Attributes:
        drive: What turns the law into joint accelerations on the chart it is on.
        number: How many charts came before it.
        law: The law and `drive` in one, compiled, where there is that.
        since: Time from which the chart is used [s].
        carried: What the self-motion acceleration lacked then to that on the chart before, (r,); None on the first.
        made_of: Stands for the gains and targets that `drive` and `law` were made of.
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
        """Acceleration that is still carried at time t, with joints at these velocities, (r,); None if nothing is."""
        if self.carried is None or t - self.since >= LONG_AGO:
            return None
        rate = max(FORGETTING, PER_SPEED * math.sqrt(dq.dot(dq)))
        return math.exp(rate * (self.since - t)) * self.carried


@dataclass(frozen=True, eq=False)
class KinematicState:
    """Memory of a `KinematicLoop` from one step to the next: the last command, and the targets it had."""

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
