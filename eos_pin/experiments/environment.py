"""A gymnasium environment whose actions move the task and the self-motion; it needs the extra `learning`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np

from eos_pin._arrays import Array, JointVector, Vector, VectorLike, number, of_type, vector
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.errors import EosError, InputError, MissingDependencyError
from eos_pin.experiments.defaults import rest_posture
from eos_pin.tasks.base import Point, Task
from eos_pin.trajectories.base import Trajectory, check_reference

try:
    import gymnasium
except ImportError as missing:
    raise MissingDependencyError("an environment", "gymnasium", "pip install 'eos-pin[learning]'") from missing

Reward: TypeAlias = "Callable[[SelfMotionEnv], float]"
#: Reward of a step that would leave the joint limits or the reach of the robot.
BLOCKED = -1.0
#: Parts of the task's and of the joints' range in which goals and set-points are.
NEAR, FAR = 0.15, 0.5


def comfort(env: SelfMotionEnv) -> float:
    """Default reward: 0 at the goal with all joints in the middle of their ranges, and less elsewhere."""
    return -float(np.linalg.norm(env.error)) - float(np.mean(env.use**2))


class SelfMotionEnv(gymnasium.Env[Vector, Vector]):
    """A robot whose joints are the exact function y(z, v) of the task and of the self-motion coordinates.

    An action has a number in [−1, 1] for each coordinate of the task and of v; with a `path` the task follows that by
    itself, and the action is that of v alone. The task is met to 1e-10 with any v, so that the use of the
    redundancy is all that is learned. No dynamics are simulated.

    An observation has, in [−1, 1], the place of each joint in its range (sine and cosine of a continuous one), the way
    to the goal as a part of the robot's reach or of half a turn, and with a path that repeats sine and cosine of its
    phase.

    Args:
        task: The task.
        path: Path that the task follows; without one the goal is a random task point nearby.
        q0: Joints at which an episode begins; by default a comfortable posture.
        actions: Rates of z and v, or set-points that they move to.
        task_rate: Rate of z for an action of 1 [m/s, rad/s].
        self_motion_rate: Rate of v for an action of 1 [rad/s, m/s].
        control_period: Time of a step [s].
        duration: Time of an episode [s].
        reward: Reward of a state as a function of this environment; by default `comfort`.

    Attributes:
        q: Joints, (n,).
        z: Task point.
        goal: Task point that is wanted.
        chart: Chart on which v is measured.

    Raises:
        InputError: The task has no self-motion although it follows a path, or an argument does not fit.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  (as gymnasium has it)

    def __init__(
        self,
        task: Task,
        path: Trajectory | None = None,
        *,
        q0: VectorLike | None = None,
        actions: Literal["rates", "set-points"] = "rates",
        task_rate: float = 0.25,
        self_motion_rate: float = 1.0,
        control_period: float = 0.02,
        duration: float = 4.0,
        reward: Reward = comfort,
    ) -> None:
        of_type(task, "task", Task)
        if actions not in ("rates", "set-points"):
            raise InputError(f"actions are 'rates' or 'set-points', got {actions!r}")
        self.task, self.robot, self.path = task, task.robot, path
        if path is not None:
            check_reference(task, path)
            if task.m == self.robot.n:
                raise InputError(f"{task!r} takes all joints: along a path there is nothing left to learn")
        self._atlas, self._reward, self._mode = Atlas(task), reward, actions
        q = rest_posture(task) if q0 is None else self.robot.posture(vector(q0, self.robot.n, "q0"))
        if path is not None:
            q = self._atlas.solve(q, path(0.0).z).q
        self._start = q
        self.control_period = number(control_period, "the control period", above=0.0)
        self._steps = max(1, round(number(duration, "the duration", above=0.0) / self.control_period))
        rates = [number(task_rate, "task_rate", above=0.0)] * task.m
        r = self.robot.n - task.m
        self._rates = np.array(rates + [number(self_motion_rate, "self_motion_rate", above=0.0)] * r)
        self._scale = np.array([self.robot.reach if unit == "m" else math.pi for unit in task.units])
        self._bounded = np.isfinite(self.robot.upper - self.robot.lower) & ~self.robot.continuous
        count = r if path is not None else self.robot.n
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (count,), np.float32)
        self.reset()
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, self._observation().shape, np.float32)

    # -- gymnasium ---------------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Begin an episode; `options={"q": …}` begins it at other joints, where there is no path.

        Raises:
            InputError: The joints do not fit, or an option is unknown.
        """
        super().reset(seed=seed)
        options = options or {}
        if options.keys() - {"q"} or (options and self.path is not None):
            raise InputError(f"an episode has only the option 'q', and along a path none; got {sorted(options)}")
        self.q: JointVector = self.robot.posture(vector(options.get("q", self._start), self.robot.n, "q"))
        self._count = 0
        self.chart: Chart = self._atlas.start(self.q)
        self._origin = self.z = self.task.value(self.q)
        self.v = self.chart.v(self.q)
        self.goal = self._new_goal()
        return self._observation(), {}

    def step(self, action: VectorLike) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Move by an action for one period.

        Returns:
            Observation, reward, whether the path cannot be followed further, whether the time is over, and a dictionary
            with `blocked`: whether the action was refused at a limit.
        """
        given = vector(action, self.action_space.shape[0], "the action")  # type: ignore[index]
        if self.path is not None:
            given = np.concatenate((np.zeros(self.task.m), given))
        dz, dv = np.split(self._moves(np.clip(given, -1.0, 1.0)), [self.task.m])
        self._count += 1
        blocked = not self._go(self._next(dz), self.v + dv)
        # Along a path the action is refused, not the path.
        stuck = blocked and (self.path is None or not self._go(self._next(dz), self.v))
        ended = stuck and self.path is not None
        reward = float(self._reward(self)) + (BLOCKED if blocked else 0.0)
        return self._observation(), reward, ended, self._count >= self._steps, {"blocked": blocked}

    # -- for rewards -------------------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """Time since the episode began [s]."""
        return self._count * self.control_period

    @property
    def error(self) -> Vector:
        """Way to the goal, as parts of the robot's reach and of half a turn, (m,)."""
        return np.asarray(self.task.minus(self.goal, self.z)) / self._scale

    @property
    def use(self) -> Vector:
        """Place of each joint that has limits in its range, −1 at the lower and 1 at the upper one."""
        lower, upper = self.robot.lower[self._bounded], self.robot.upper[self._bounded]
        return np.asarray((2.0 * self.q[self._bounded] - lower - upper) / np.maximum(upper - lower, 1e-9))

    # -- inside ------------------------------------------------------------------------------------------------------

    def _new_goal(self) -> Point:
        if self.path is not None:
            return self.path(0.0).z
        span = np.where(self._bounded, self.robot.upper - self.robot.lower, 2.0)
        q = self.q + NEAR * span * self.np_random.uniform(-1.0, 1.0, self.robot.n)
        return self.task.value(np.clip(q, self.robot.lower, self.robot.upper))

    def _moves(self, action: Vector) -> Vector:
        """Steps of z and v."""
        most = self._rates * self.control_period
        if self._mode == "rates":
            return action * most
        m = self.task.m
        place = self.task.plus(self._origin, FAR * self._scale * action[:m])
        ways = np.concatenate((self.task.minus(place, self.z), math.pi * action[m:] - self.v))
        return np.asarray(np.clip(ways, -most, most))

    def _next(self, dz: Vector) -> Point:
        return self.task.plus(self.z, dz) if self.path is None else self.path(self.t).z

    def _go(self, z: Point, v: Vector) -> bool:
        """Whether z and v were reached within the joint limits."""
        try:
            found = self._atlas.follow(self.q, z[None], v=v, chart=self.chart)
        except EosError:
            return False
        if not found.complete or (found.q[-1] < self.robot.lower).any() or (found.q[-1] > self.robot.upper).any():
            return False
        self.q = found.q[-1]
        self.chart = found.charts[-1]
        self.z, self.v = self.task.value(self.q), self.chart.v(self.q)
        self.goal = self.goal if self.path is None else z
        return True

    def _observation(self) -> Array:
        free = self.q[~self._bounded]
        parts = [self.use, np.sin(free), np.cos(free), self.error]
        if self.path is not None and math.isfinite(self.path.period):
            phase = 2.0 * math.pi * self.t / self.path.period
            parts.append(np.array([math.sin(phase), math.cos(phase)]))
        return np.clip(np.concatenate(parts), -1.0, 1.0).astype(np.float32)


gymnasium.register(id="eos_pin/SelfMotion-v0", entry_point="eos_pin.experiments.environment:SelfMotionEnv")
