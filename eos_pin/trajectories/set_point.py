"""`SetPoint`: a reference that is moved while it runs, smooth and within bounds of velocity, acceleration and jerk."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from eos_pin._arrays import JointVector, TaskVector, Vector, VectorLike, broadcast, checked, frozen_copy, number, vector
from eos_pin.errors import InputError, MissingDependencyError
from eos_pin.tasks.base import Point, Task
from eos_pin.trajectories.base import Target, Trajectory

#: Angle below which factors of the exponential map are summed as series [rad].
SMALL = 0.02


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motion of the coordinates about a base point from one order to the next.

    Attributes:
        t: Time at which it begins [s].
        base: Task point about which the coordinates are counted.
        course: Ruckig's trajectory; None at rest.
    """

    t: float
    base: Point
    course: Any = None


class SetPoint(Trajectory):
    """A task point that is moved by orders at run time, without steps in position, velocity or acceleration.

    From where it is when an order comes, the point moves to its goal in the least time that the bounds allow, by
    Ruckig. Rotations are rotation vectors about the place where an order found them, so their bounds hold for those;
    on the way from rest they are those of the angle. Times that were asked for before an order keep their targets.

    Args:
        task: The task: one with vectors as points, an orientation or a pose.
        z: Where it is at the start, a point of the task.
        velocity: Largest speed of each coordinate, one number or (m,) [m/s, rad/s].
        acceleration: Largest acceleration, likewise.
        jerk: Largest jerk, likewise.
        stale: Time after which a velocity that was not renewed brakes [s].

    Raises:
        InputError: A bound is not above 0, or the task has points of another kind.
        MissingDependencyError: Ruckig is not installed.
    """

    @checked
    def __init__(
        self,
        task: Task,
        z: Point,
        *,
        velocity: float | VectorLike,
        acceleration: float | VectorLike,
        jerk: float | VectorLike,
        stale: float = 0.2,
    ) -> None:
        try:
            import ruckig
        except ImportError as error:
            raise MissingDependencyError("a SetPoint", "ruckig", "pip install 'eos-pin[online]'") from error
        if not task.is_vector and (task.m, task.size) not in ((3, 9), (6, 12)):
            raise InputError(f"a SetPoint moves vectors, orientations and poses, not points of {task!r}")
        self.task, self._ruckig = task, ruckig
        self._bounds = []
        for name, given in (("velocity", velocity), ("acceleration", acceleration), ("jerk", jerk)):
            bound = broadcast(given, task.m, f"the {name} bounds of a SetPoint")
            if not ((bound > 0.0) & np.isfinite(bound)).all():
                raise InputError(f"the {name} bounds of a SetPoint must be above 0, got {bound.tolist()}")
            self._bounds.append(bound.tolist())
        self._stale = number(stale, "the time after which a velocity is stale", above=0.0)
        self._planner = ruckig.Ruckig(task.m)
        self._motions = [_Motion(-math.inf, frozen_copy(task.point(z)))]
        #: Latest time that was asked for, and time at which a velocity becomes stale.
        self._asked, self._ends = -math.inf, math.inf

    def move_to(self, z: Point, t: float) -> float:
        """Order the point to move to a goal and to rest there.

        Args:
            z: The goal, a point of the task.
            t: Time of the order [s].

        Returns:
            Time at which it arrives [s].

        Raises:
            InputError: The goal is no point of the task, or the time lies before the last order.
        """
        goal = self.task.point(z)
        return self._begin(t, math.inf, lambda base: self.task._minus(goal, base))

    def drive(self, dz: VectorLike, t: float) -> None:
        """Order the point to take a velocity, such as that of a joystick; it brakes unless it is renewed in time.

        Args:
            dz: Velocity, (m,) [m/s, rad/s]; beyond its bounds it is shortened.
            t: Time of the order [s].

        Raises:
            InputError: It is no velocity of the task, or the time lies before the last order.
        """
        asked = vector(dz, self.task.m, "the velocity of a SetPoint")
        fastest = np.array(self._bounds[0])
        t = number(t, "the time of an order")
        asked = asked / max(1.0, float((np.abs(asked) / fastest).max()))
        self._begin(t, t + self._stale, None, asked)

    def stop(self, t: float) -> float:
        """Order the point to brake to rest; returns the time at which it rests [s].

        Raises:
            InputError: The time lies before the last order.
        """
        return self._begin(t, math.inf, None, np.zeros(self.task.m))

    def __call__(self, t: float) -> Target:
        t = t if type(t) is float else number(t, "t")
        if t > self._ends:
            self._begin(self._ends, math.inf, None, np.zeros(self.task.m), late=True)
        self._asked = max(self._asked, t)
        motion = next((found for found in reversed(self._motions) if found.t <= t), self._motions[0])
        x, dx, ddx = self._coordinates(motion, max(t, motion.t))
        z = self.task._plus(motion.base, x)
        if self.task.is_vector:
            return Target(z, dx, ddx)
        turn = slice(self.task.m - 3, self.task.m)
        dx[turn], ddx[turn] = rotation_rates(x[turn], dx[turn].copy(), ddx[turn].copy())
        return Target(z, dx, ddx)

    def _coordinates(self, motion: _Motion, t: float) -> tuple[Vector, Vector, Vector]:
        if motion.course is None:
            return np.zeros(self.task.m), np.zeros(self.task.m), np.zeros(self.task.m)
        x, dx, ddx = motion.course.at_time(t - motion.t)
        return np.array(x), np.array(dx), np.array(ddx)

    def _begin(
        self, t: float, ends: float, way: Any, velocity: TaskVector | None = None, *, late: bool = False
    ) -> float:
        """Plan the motion for an order, from the target at its time or the latest one that was asked for."""
        t = number(t, "the time of an order")
        if t < self._motions[-1].t:
            raise InputError(f"orders must not go back in time: got {t:g} s after {self._motions[-1].t:g} s")
        # An order that comes between two steps counts from the time for which a command went out already.
        if not late:
            t = max(t, self._asked)
            if t > self._ends:
                self._begin(self._ends, math.inf, None, np.zeros(self.task.m), late=True)
        self._ends = math.inf
        now = self(t)
        given, m = self._ruckig.InputParameter(self.task.m), self.task.m
        given.current_position, given.current_velocity, given.current_acceleration = (
            [0.0] * m, now.dz.tolist(), now.ddz.tolist(),
        )  # fmt: skip
        given.max_velocity, given.max_acceleration, given.max_jerk = self._bounds
        if velocity is None:
            given.target_position = way(now.z).tolist()
            # Along a straight line, and about one axis, where it can be.
            given.synchronization = self._ruckig.Synchronization.Phase
        else:
            given.control_interface = self._ruckig.ControlInterface.Velocity
            given.target_velocity = velocity.tolist()
        course = self._ruckig.Trajectory(m)
        result = self._planner.calculate(given, course)
        if result.value < 0:
            raise InputError(f"no motion within the bounds was found for this order; Ruckig's result is {result.name}")
        self._motions = [*self._motions[-1:], _Motion(t, now.z, course)]
        self._ends = ends
        return float(t + course.duration)


def rotation_rates(x: Vector, dx: JointVector, ddx: JointVector) -> tuple[Vector, Vector]:
    """Angular velocity and acceleration of exp(x), in the axes in which x is given.

    With A = (1 − cos θ)/θ² and B = (θ − sin θ)/θ³, ω = ẋ + A x × ẋ + B x × (x × ẋ), and α is its derivative.

    Args:
        x: Rotation vector, (3,).
        dx: Its velocity.
        ddx: Its acceleration.
    """
    square = float(x.dot(x))
    angle = math.sqrt(square)
    if angle < SMALL:
        A, B = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        a, b = -1.0 / 12.0 + square / 180.0, -1.0 / 60.0 + square / 1260.0
    else:
        sine, cosine = math.sin(angle), math.cos(angle)
        A, B = (1.0 - cosine) / square, (angle - sine) / (square * angle)
        a, b = (sine / angle - 2.0 * A) / square, (A - 3.0 * B) / square
    along = float(x.dot(dx))
    once, twice = np.cross(x, dx), np.cross(x, np.cross(x, dx))
    omega = dx + A * once + B * twice
    alpha = (
        ddx
        + A * np.cross(x, ddx)
        + B * (np.cross(dx, once) + np.cross(x, np.cross(x, ddx)))
        + along * (a * once + b * twice)
    )
    return omega, alpha
