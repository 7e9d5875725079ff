"""Plans in `eos-pin track`: loaded or made, joined, and a note where the joints will not repeat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eos_pin._arrays import JointVector
from eos_pin.errors import InputError
from eos_pin.experiments.options import ControlOptions

if TYPE_CHECKING:
    from eos_pin.control.following import FollowJoints
    from eos_pin.planning.obstacles.clearance import Obstacle
    from eos_pin.planning.plans import Plan
    from eos_pin.robot.model import Robot
    from eos_pin.simulation.result import Result
    from eos_pin.tasks.base import Task
    from eos_pin.trajectories.base import Trajectory


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan that is followed.

    Attributes:
        task: Its task.
        path: Path of the task.
        law: Law of the self-motion.
        q: Joints at the start.
        dq: Their velocities.
    """

    task: Task
    path: Trajectory
    law: FollowJoints
    q: JointVector
    dq: JointVector


def loaded_plan(
    robot: Robot, file: Path, q0: JointVector | None, control: ControlOptions, frame: str | None = None
) -> Planned:
    """Plan from a file, joined from q0 where that is given; of a frame, where one was asked for."""
    from eos_pin.planning.plans import Plan

    plan = Plan.load(file, robot)
    moved = plan.task.frame
    if frame is not None and frame != moved:
        raise InputError(
            f"{file} has a plan for the frame {moved!r}, not for {frame!r}; leave out --frame and --tool, or plan anew"
        )
    return _followed(plan, q0, control)


def made_plan(task: Task, path: Trajectory, start: JointVector | None, control: ControlOptions, seed: int) -> Planned:
    """Plan for a path, from the joints at the start where they are given."""
    from eos_pin.planning.planner import plan

    return _followed(plan(task, path, start=start, seed=seed), None, control)


def obstacles_in(file: Path | None) -> list[Obstacle]:
    """Solids of a scene file as a replay shows them; none without a file."""
    if file is None:
        return []
    from eos_pin.planning.obstacles.scene import read_scene
    from eos_pin.viewer.solids import obstacles_of

    return obstacles_of(read_scene(file))


def _followed(plan: Plan, q0: JointVector | None, control: ControlOptions) -> Planned:
    from eos_pin.control.following import FollowPlan
    from eos_pin.control.joining import journey

    if control.controller not in ("eos", "eos-limited"):
        raise InputError(f"a plan is followed by the controllers eos and eos-limited, not by {control.controller!r}")
    gains: dict[str, Any] = {"kp": control.kp_self_motion, "kd": control.kd_self_motion}
    if q0 is not None:
        way = journey(plan, q0)
        first = way.joints(0.0)
        return Planned(plan.task, way.path, way.law(**gains), first.q, first.dq)
    first = plan(0.0)
    return Planned(plan.task, plan.path, FollowPlan(plan, **gains), first.q, first.dq)


def repeat_note(robot: Robot, result: Result, self_motion: str) -> str:
    """Warning that the joints of a run do not repeat or left their limits, with a remedy; empty otherwise."""
    summary = result.summary()
    left = bool(len(result.q)) and bool(((result.q < robot.lower) | (result.q > robot.upper)).any())
    causes = []
    if self_motion == "hold" and summary["chart_switches"] and summary["period"]:
        causes.append(f"v is held over {summary['chart_switches'] + 1} charts, so that the joints do not repeat")
    if left:
        causes.append("joints leave their limits")
    if not causes:
        return ""
    return f"Note: {' and '.join(causes)}. Add --self-motion planned, or see `eos-pin plan --help`, for joints that do."
