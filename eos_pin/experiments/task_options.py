"""The task of a run in plain values, as the command line has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eos_pin._arrays import JointVector, checked, vector
from eos_pin.errors import InputError
from eos_pin.experiments.applicability import DIRECTED, POINTED, TaskKind
from eos_pin.robot.postures import by_name, in_order

# Everything else is imported where it is used, so that `eos-pin --help` does not wait for it.
if TYPE_CHECKING:
    from eos_pin.robot.model import Robot
    from eos_pin.tasks.base import Task
    from eos_pin.trajectories.base import Trajectory


@checked
@dataclass(frozen=True)
class TaskOptions:
    """Task of the robot.

    Attributes:
        task: Kind: position, pose (with orientation), point-axis (position and the direction of the tool's axis,
            free to turn about it), axis, look-at (the tool's axis points at --point), orientation, heading (planar
            robots), distance (from --point), com (centre of mass), relative-pose (of the frame, seen --seen-from
            another), or joints (--combine).
        axes: Axes that count, such as xy; by default all along which the frame can move.
        q0: Joints at the start [rad or m]: all in order, or some by name, such as panda_joint4=-2; by default, and for
            those not named, a posture far from singular and from the limits.
        tool_axis: Axis of the frame that axis, point-axis and look-at direct: x, y, z, -x, -y, -z, or three numbers.
        point: Point of the world that look-at looks at, or distance counts from [m]. What look-at looks at may move:
            through the rows t [s], x, y, z [m] of a CSV file, or "0 0.9 0 0.3; 2 0.9 0.4 0.3; 4 0.9 0 0.3".
        combine: Coordinates of the task joints, each a sum of joints by name, such as elbow=1 or elbow=1,wrist=-0.5.
        tolerance: Half widths of bands in which coordinates are kept instead of being tracked, such as rz=0.2 z=0.005
            or cone=0.26: x, y, z [m], a turn rx, ry or rz about an axis of the frame, the cone of an axis [rad]. Plans
            and the controllers eos and eos-limited keep them.
        further: Kind of a further task that the self-motion does, as far as the task allows: to keep an orientation (so
            the roll of a tool whose axis is directed), an axis or the centre of mass where it is at the start, to look
            at --point, or to keep the distance from it.
        further_path: Path of the further task, where it is not to stay: a CSV file or way points, as in --path. Of an
            orientation also rows of t [s] and a turn [rad] about --tool-axis from the start, such as
            "0 0; 2 1.5; 4 0", for the roll of a tool. A path that ends where it begins repeats.
    """

    task: TaskKind = "position"
    axes: str = ""
    q0: tuple[float | str, ...] = ()
    tool_axis: str = "z"
    point: tuple[float | str, ...] = ()
    combine: tuple[str, ...] = ()
    tolerance: tuple[str, ...] = ()
    further: Literal["none", "orientation", "axis", "look-at", "distance", "com"] = "none"
    further_path: str = ""

    @checked
    def make(self, robot: Robot, *, kept: bool = False, led: bool = False) -> tuple[Task, JointVector]:
        """The task, and the joints to start from.

        Args:
            robot: The robot.
            kept: Whether a plan or a controller keeps its tolerance.
            led: Whether a controller does a further task and follows a point that moves.
        """
        from eos_pin.experiments.defaults import make_task, rest_posture
        from eos_pin.tasks.tolerance import ToleranceTask

        if not led and (
            self.further != "none" or self.further_path or any(isinstance(word, str) for word in self.point)
        ):
            raise InputError(
                "a further task and a point that moves are for `eos-pin track` and `eos-pin rehearse`; leave out "
                "--further and --further-path here, and give --point as three numbers"
            )
        task = whole = make_task(robot, self.task, axes=self.axes, **self.chosen(robot, self.task))
        if self.tolerance:
            if not kept:
                raise InputError(
                    "a tolerance is kept by plans, and by the controllers eos and eos-limited of `eos-pin track`; "
                    "leave out --tolerance here"
                )
            task = ToleranceTask(whole, _numbers(self.tolerance, "--tolerance", "half widths by name, such as rz=0.2"))
        words = [word for word in self.q0 if isinstance(word, str)]
        if not words:
            return task, vector([float(x) for x in self.q0], robot.n, "q0") if self.q0 else rest_posture(whole)
        named = {joint: value for joint, value in by_name(words, "q0").items() if value is not None}
        if len(named) < len(self.q0):
            raise InputError(
                f"q0 is all {robot.n} joints in order, or some as joint=value; got {' '.join(map(str, self.q0))}"
            )
        return task, in_order(named, robot.joint_names, rest_posture(whole), "q0")

    @checked
    def make_further(self, robot: Robot, q: JointVector) -> tuple[Task, Trajectory] | None:
        """The further task and its path from the joints q; None without one."""
        if self.further == "none":
            return None
        from eos_pin.experiments.defaults import make_task

        task = make_task(robot, self.further, **self.chosen(robot, self.further))
        return task, self._further_path(task, q) if self.further_path else task.aim(q)

    def _further_path(self, task: Task, q: JointVector) -> Trajectory:
        """The path of the further task."""
        from eos_pin.experiments.path_files import path_from_csv
        from eos_pin.tasks.axis import tool_axis
        from eos_pin.trajectories.pose import Turned
        from eos_pin.trajectories.spline import check_rows, cubic_spline
        from eos_pin.trajectories.waypoints import is_table, read_waypoints

        path = self.further_path
        if self.further == "look-at":
            raise InputError("--further-path is not for --further look-at: where the tool looks, --point moves")
        if not is_table(path):
            raise InputError(
                f"--further-path is the name of a .csv file or way points separated by semicolons; got {path!r}"
            )
        if self.further == "orientation" and (rows := read_waypoints(path)).values is not None:
            turns = rows.values if rows.t is None else np.column_stack((rows.t, rows.values))
            if turns.shape[1] == 2:
                check_rows(rows)
                angle = cubic_spline(turns[:, 1:], turns[:, 0] - turns[0, 0])
                return Turned(task.value(q).reshape(3, 3), tool_axis(self.tool_axis), angle)
        if self.tool_axis != TaskOptions.tool_axis and not {self.task, self.further} & {*DIRECTED}:
            raise InputError(f"--tool-axis {self.tool_axis} does not apply: no task and no turn is about it")
        return path_from_csv(path, task, q)

    @checked
    def chosen(self, robot: Robot, kind: str) -> dict[str, Any]:
        """Frame, tool axis and point for a task of a kind; those of another kind that is asked for are left out."""
        chosen: dict[str, Any] = {"frame": robot.options.get("chain_to", "")}
        kinds = {self.task, self.further}
        # A path of an orientation may be turns about the axis.
        turned = self.further == "orientation" and self.further_path
        if kind in DIRECTED or not (turned or kinds & {*DIRECTED}):
            chosen["tool_axis"] = self.tool_axis
        if kind == "relative-pose":
            chosen["seen_from"] = robot.options.get("branch_to", "")
        if self.combine and (kind == "joints" or self.task != "joints"):
            wanted = "factors of joints by name, such as elbow=1,wrist=-0.5"
            chosen["combinations"] = [_numbers(row.split(","), "--combine", wanted) for row in self.combine]
        if self.point and (kind in POINTED or not kinds & {*POINTED}):
            chosen["point"] = self._centre()
        return chosen

    def _centre(self) -> tuple[float, ...] | Trajectory:
        """The point, or its motion."""
        from eos_pin.trajectories.spline import cubic_spline, spline_from_csv
        from eos_pin.trajectories.waypoints import is_table, read_waypoints

        words = [word for word in self.point if isinstance(word, str)]
        if not words:
            return tuple(float(x) for x in self.point)
        if len(self.point) > 1 or not is_table(words[0]):
            raise InputError(
                "--point is three numbers, a .csv file with the columns t, x, y, z, or rows t x y z separated by "
                f"semicolons; got {' '.join(map(str, self.point))!r}"
            )
        if ";" not in words[0]:
            return spline_from_csv(words[0])
        rows = read_waypoints(words[0]).values
        if rows is None or rows.shape[1] != 4:
            raise InputError(f"each row of --point is t [s], x, y, z [m]; got {words[0]!r}")
        return cubic_spline(rows[:, 1:], rows[:, 0])


def _numbers(words: Sequence[str], option: str, wanted: str) -> dict[str, float]:
    """Numbers by name, as name=number."""
    made = {}
    for text in words:
        name, _, number = text.partition("=")
        try:
            made[name] = float(number)
        except ValueError:
            raise InputError(f"{option} takes {wanted}; got {text!r}") from None
    return made
