"""What `EosController` remembers from one call to the next, and what it tells about one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from eos_pin.arrays import JointVector, SelfMotionVector, TaskVector
from eos_pin.charts import Chart
from eos_pin.driving import Drive
from eos_pin.tasks import Point


@dataclass(frozen=True, eq=False)
class EosMemory:
    """What `EosController` remembers.

    Attributes:
        drive: What turns the law into joint accelerations on the chart it is on.
        number: How many charts came before it.
        law: The law and `drive` in one, compiled, where there is that.
        since: Time from which the chart is used [s].
        carried: What the self-motion acceleration lacked then to that on the chart before, (r,); None on the first.
        made_of: The versions of the controller and of its `Track` that `drive` and `law` were made of.
    """

    drive: Drive
    number: int = 0
    law: Any = None
    since: float = 0.0
    carried: SelfMotionVector | None = None
    made_of: tuple[Any, Any] = (None, None)

    @property
    def chart(self) -> Chart:
        """The chart it is on."""
        return self.drive.chart


class Observation(NamedTuple):
    """What `EosController` does in one state.

    Attributes:
        tau: Joint torques [N m or N].
        z: Task point.
        dz: Task velocity [m/s, rad/s].
        to_singularity: Task acceleration given up because the task is nearly singular, (m,).
        to_limits: Task acceleration given up to limits, (m,).
    """

    tau: JointVector
    z: Point
    dz: TaskVector
    to_singularity: TaskVector
    to_limits: TaskVector
