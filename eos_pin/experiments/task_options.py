"""The task of a run in plain values, as the command line has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from eos_pin._arrays import JointVector, checked, vector
from eos_pin.errors import InputError
from eos_pin.robot.postures import by_name, in_order

# Everything else is imported where it is used, so that `eos-pin --help` does not wait for it.
if TYPE_CHECKING:
    from eos_pin.robot.model import Robot
    from eos_pin.tasks.base import Task


@checked
@dataclass(frozen=True)
class TaskOptions:
    """Task of the robot.

    Attributes:
        task: Kind: position, pose (with orientation), point-axis (position and the direction of the tool's axis,
            free to turn about it), axis, look-at (the tool's axis points at --point), orientation, heading (planar
            robots), distance (from --point), or centre of mass.
        axes: Axes that count, such as xy; by default all along which the frame can move.
        q0: Joints at the start [rad or m]: all in order, or some by name, such as panda_joint4=-2; by default, and for
            those not named, a posture far from singular and from the limits.
        tool_axis: Axis of the frame that axis, point-axis and look-at direct: x, y, z, -x, -y, -z, or three numbers.
        point: Point of the world that look-at looks at, or distance counts from [m].
        tolerance: Half widths of bands in which coordinates are kept instead of being tracked, such as rz=0.2 z=0.005
            or cone=0.26: x, y, z [m], a turn rx, ry or rz about an axis of the frame, the cone of an axis [rad]. Plans
            and the controllers eos and eos-limited keep them.
    """

    task: Literal["position", "pose", "point-axis", "axis", "look-at", "orientation", "heading", "distance", "com"] = (
        "position"
    )
    axes: str = ""
    q0: tuple[float | str, ...] = ()
    tool_axis: str = "z"
    point: tuple[float, ...] = ()
    tolerance: tuple[str, ...] = ()

    @checked
    def make(self, robot: Robot, *, kept: bool = False) -> tuple[Task, JointVector]:
        """The task, and the joints to start from.

        Args:
            robot: The robot.
            kept: Whether a plan or a controller keeps its tolerance.
        """
        from eos_pin.experiments.defaults import make_task, rest_posture
        from eos_pin.tasks.tolerance import ToleranceTask

        frame = robot.options.get("chain_to", "")
        task = whole = make_task(
            robot, self.task, frame=frame, axes=self.axes, tool_axis=self.tool_axis, point=self.point or None
        )
        if self.tolerance:
            if not kept:
                raise InputError(
                    "a tolerance is kept by plans, and by the controllers eos and eos-limited of `eos-pin track`; "
                    "leave out --tolerance here"
                )
            task = ToleranceTask(whole, self._tolerance())
        words = [word for word in self.q0 if isinstance(word, str)]
        if not words:
            return task, vector([float(x) for x in self.q0], robot.n, "q0") if self.q0 else rest_posture(whole)
        named = {joint: value for joint, value in by_name(words, "q0").items() if value is not None}
        if len(named) < len(self.q0):
            raise InputError(
                f"q0 is all {robot.n} joints in order, or some as joint=value; got {' '.join(map(str, self.q0))}"
            )
        return task, in_order(named, robot.joint_names, rest_posture(whole), "q0")

    def _tolerance(self) -> dict[str, float]:
        """Half widths by name."""
        made = {}
        for text in self.tolerance:
            name, _, width = text.partition("=")
            try:
                made[name] = float(width)
            except ValueError:
                raise InputError(f"--tolerance takes half widths by name, such as rz=0.2; got {text!r}") from None
        return made
