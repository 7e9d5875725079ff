"""The two applications that the paper cites: redundant robots that follow a path and avoid obstacles by v(t).

The references give no numbers that could be repeated, so robots, paths and obstacles are ours.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import coal
import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, JointVector, frozen_copy
from eos_pin.charts.atlas import Atlas
from eos_pin.planning.obstacles.avoidance import Avoidance
from eos_pin.planning.obstacles.clearance import Clearance, Obstacle
from eos_pin.robot.loading import load_robot
from eos_pin.simulation._recorder import joint_run
from eos_pin.simulation.result import Result
from eos_pin.tasks.base import Task
from eos_pin.tasks.orientation import HeadingTask, PoseTask
from eos_pin.tasks.position import PositionTask
from eos_pin.tasks.stacked import StackedTask
from eos_pin.trajectories.base import Trajectory
from eos_pin.trajectories.harmonic import Harmonic, figure_eight
from eos_pin.trajectories.pose import PoseTrajectory
from eos_pin.trajectories.stacked import StackedTrajectory

#: Colours of obstacles at rest, and of those that move; they can be told apart without seeing colours.
RESTING, MOVING = (0.80, 0.47, 0.65, 0.9), (0.90, 0.62, 0.0, 0.9)


@dataclass(frozen=True, eq=False)
class Application:
    """A task path among obstacles, followed by inverse kinematics on charts.

    Attributes:
        task: The task.
        q: Joints at the start.
        path: The task's path.
        avoidance: How v makes way.
        cycles: Rounds of the path.
        rate: Points of the path in each second.
        steps: Steps of v at each point.
    """

    task: Task
    q: JointVector
    path: Trajectory
    avoidance: Avoidance
    cycles: int = 2
    rate: float = 50.0
    steps: int = 2

    @property
    def clearance(self) -> Clearance:
        """Distances of the robot from the obstacles."""
        return self.avoidance.clearance

    @cached_property
    def times(self) -> Float[Array, " T"]:
        """Times at which the points of the path are visited [s]."""
        period = self.path.period
        return frozen_copy(period * np.arange(round(self.cycles * period * self.rate) + 1) / round(period * self.rate))

    def run(self, *, avoiding: bool = True) -> Result:
        """Follow the path: with v making way, or with v constant, for comparison."""
        start, cpu = time.perf_counter(), time.process_time()
        atlas = Atlas(self.task)
        if avoiding:
            found = self.avoidance.follow(atlas, self.q, self.path, self.times, steps=self.steps)
        else:
            found = atlas.follow(self.q, np.array([self.path(t).z for t in self.times.tolist()]))
        spent = {"wall_seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu}
        result = joint_run(
            self.task, self.times[: len(found.q)], found.q, found.z, v=found.v, chart=found.chart,
            period=self.path.period, message=found.message,
        )  # fmt: skip
        return replace(result, info={**result.info, **spent})

    def figures(self, result: Result) -> dict[str, Any]:
        """Measures of a run: the summary of the result, and distances, steps and limits over all of the path."""
        robot, clearance = self.task.robot, self.clearance
        distances = clearance.along(result.t, result.q)
        closest = int(distances.argmin())
        approach = clearance.nearest(float(result.t[closest]), result.q[closest])
        # Between points the joints move on straight lines.
        fine = np.linspace(result.t[0], result.t[-1], 5 * len(result.t) - 4)
        between = np.column_stack([np.interp(fine, result.t, column) for column in result.q.T])
        steps = np.abs(np.diff(result.q, axis=0))
        return result.summary() | {
            "task_error_max": float(np.abs(result.error).max()),
            "clearance_min": float(distances.min()),
            "clearance_min_between_points": float(clearance.along(fine, between).min()),
            "clearance_min_time": float(result.t[closest]),
            "closest_body": approach.body,
            "closest_obstacle": approach.obstacle,
            "joint_step_max": float(steps.max()),
            "joint_speed_max": float((steps / np.diff(result.t)[:, None]).max()),
            "joint_limit_room_min": float(np.minimum(result.q - robot.lower, robot.upper - result.q).min()),
            "points": len(result.t),
            "wall_seconds": result.info["wall_seconds"],
        }


def planar_chain(*, margin: float = 0.3, moving: bool = True, cycles: int = 2) -> Application:
    """A planar robot of 23 joints weaves between three discs, one of which moves, while its tip draws a figure eight.

    Position and heading of the tip leave r = 20.

    Args:
        margin: Distance below which a disc repels [m].
        moving: Whether the third disc moves; if not, it stays where it does not matter.
        cycles: Rounds of the path.
    """
    robot = load_robot("planar_chain_23")
    task = StackedTask([PositionTask(robot, "tip", "xy"), HeadingTask(robot, "tip")])
    # One period of a wave: over the first disc, under the second.
    headings = 1.15 * np.cos(2.0 * np.pi * (np.arange(robot.n) + 0.5) / robot.n)
    q = np.diff(headings, prepend=0.0)
    z, period = task.value(q), 10.0
    eight = figure_eight(z[:2], (0.4, 0.8), period=period)
    nod = Harmonic(z[2:], np.array([[0.6]]), np.zeros((1, 1)), period)

    def orbit(t: float) -> list[float]:
        angle = 2.0 * math.pi * t / period if moving else 0.0
        return [2.1 + 0.25 * math.sin(angle), 0.5 + 0.75 * math.cos(angle), 0.0]

    discs = (
        Obstacle(coal.Cylinder(0.35, 0.2), [1.0, -0.05, 0.0], "disc 1", RESTING),
        Obstacle(coal.Cylinder(0.35, 0.2), [2.95, 0.15, 0.0], "disc 2", RESTING),
        Obstacle(coal.Cylinder(0.25, 0.2), orbit, "moving disc", MOVING),
    )
    avoidance = Avoidance(Clearance(robot, discs), influence_distance=margin, posture=q)
    return Application(task, q, StackedTrajectory((eight, nod)), avoidance, cycles)


def panda(*, task: Literal["pose", "position"] = "pose", margin: float = 0.15, cycles: int = 2) -> Application:
    """The seven-joint Panda draws a figure eight with a ball beside its forearm, which its elbow swings out of.

    A pose leaves r = 1, a position r = 4. Distances are those of the arm's own collision meshes.

    Args:
        task: Task that the hand must keep.
        margin: Distance below which the ball repels [m].
        cycles: Rounds of the path.
    """
    robot = load_robot("panda", chain_to="panda_hand_tcp")
    goal = PoseTask(robot, "panda_hand_tcp") if task == "pose" else PositionTask(robot, "panda_hand_tcp")
    q = frozen_copy(np.array([0.0, -0.6, 0.0, -2.4, 0.0, 1.8, 0.785]))
    z = goal.value(q)
    path: Trajectory = figure_eight(z[:3], (0.12, 0.2), period=10.0, plane="xz")
    if task == "pose":
        path = PoseTrajectory(path, pose=z)
    ball = Obstacle(coal.Sphere(0.07), [0.15, 0.06, 0.83], "ball", RESTING)
    avoidance = Avoidance(
        Clearance(robot, [ball]), influence_distance=margin, posture=q, pull=0.2, damping=1.0, longest=0.012
    )
    return Application(goal, q, path, avoidance, cycles)
