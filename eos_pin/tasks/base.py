"""Tasks: coordinates of the motion to be controlled, smooth functions z = G(q) of the joints, Eq. (1).

A point z is always a flat array. For a position or a centre of mass it is the vector itself; for an orientation it
is the rotation matrix row by row (9 numbers), for a pose the position followed by it (12). `minus` and `plus` are
the group's own difference and step, so that no caller has to know which kind of task it drives. Velocities dz and
rows of J are those of a point and of an angular velocity in the axes of the world (LOCAL_WORLD_ALIGNED); the drift
Ġ'ẏ is the classical acceleration at ÿ = 0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Checked,
    Jacobian,
    JointVector,
    TaskVector,
    by_value,
    checked,
    unchecked,
    vector,
)
from eos_pin._kernels.flat import Part
from eos_pin._kernels.kinematics import Kinematics
from eos_pin._kernels.overrides import stands_for
from eos_pin.errors import InputError
from eos_pin.robot._data import workspace
from eos_pin.robot.model import Robot
from eos_pin.robot.postures import JointsLike
from eos_pin.tasks._balls import Ball
from eos_pin.tasks._flat import Channel as Channel
from eos_pin.tasks._flat import Kind as Kind
from eos_pin.tasks._flat import Point as Point
from eos_pin.tasks._flat import PointLike as PointLike
from eos_pin.tasks.target import Hold, Target

#: The axes of velocities and Jacobians.
WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

KINDS: dict[str, type[Task]] = {}
#: The hooks of a task by their names before 0.2, and the methods that call them.
_HOOKS = {"_z": "compute_point", "_J": "compute_jacobian", "_drift": "compute_drift"}
_EVALUATIONS = ("value", "linearize", "at")


@by_value
class TaskPoint(NamedTuple):
    """A task and its derivatives at one state.

    Attributes:
        z: Task point G(q).
        J: Jacobian G'(q), (m, n).
        dz: Task velocity G' dq [m/s, rad/s].
        drift: Ġ' dq, the task acceleration at ddq = 0 [m/s², rad/s²].
    """

    z: Point
    J: Jacobian
    dz: TaskVector
    drift: TaskVector


#: A task point from a tuple of its parts, in half the time that `TaskPoint(…)` takes.
_task_point = partial(tuple.__new__, TaskPoint)


class Task(Checked, ABC):
    """A smooth function z = G(q) of the joints with its first two derivatives.

    A task of one's own is a subclass that defines the three hooks `compute_point`, `compute_jacobian` and
    `compute_drift`; `value`, `linearize` and `at` call them after the passes over Pinocchio that each needs. In a hook,
    `frame_placement`, `frame_jacobian`, `frame_velocity` and `frame_acceleration` read frames. A task whose points are
    no vector space also defines `minus` and `plus`. See docs/extending.md and examples/08_own_task.py. One object is
    for one thread.

    Attributes:
        robot: Robot whose joints it depends on.
        m: Dimension of the task.
        size: Length of the flat array z; m for a vector task, more for a rotation or a pose.
        labels: Name of each of the m coordinates.
        units: Unit of each of the m coordinates.
        frame: Frame whose path is drawn in pictures and replays; empty where no frame stands for the task.
        axes: Axes of space, such as `"xyz"`, along which the first coordinates of z are a place [m]; empty where they
            are none.
        seen_from: Frame in whose axes that place is; empty for the world.
        kind: Name of the kind of task, given where the class is defined.
        arguments: Names of what its constructor takes besides the robot; attributes of the same names keep it.
        kernel: Object that computes `value`, `linearize` and `at` in one call; None where the hooks do.
        is_vector: Whether `minus` is z1 − z0.
        is_curved: Whether the axes of dz turn from point to point, so that `tracking_acceleration` compares velocities.
        moves: Whether z depends on the time as well, see `set_time`.
        rotations: Where rotation matrices, row by row, begin in z; None where only `point` tells which numbers are a z.
    """

    robot: Robot
    m: int
    size: int
    labels: tuple[str, ...]
    units: tuple[str, ...]
    frame: str = ""
    axes: str = ""
    seen_from: str = ""
    kind: str = ""
    arguments: tuple[str, ...] = ()
    kernel: Any = None
    is_vector: bool = True
    is_curved: bool = False
    moves: bool = False
    rotations: tuple[int, ...] | None = ()
    #: Whether the placements of all frames are computed before the hooks; the package's own tasks compute theirs.
    _needs_frames: bool = True
    #: Whether `value`, `linearize` and `at` are what the hooks give.
    _by_hooks: bool = True

    def __init_subclass__(cls, kind: str = "", **rest: Any) -> None:
        """Make the task known to `task_from_description` under the name `kind`.

        Raises:
            InputError: The class defines a hook by its name before 0.2.
        """
        super().__init_subclass__(**rest)
        for old, new in _HOOKS.items():
            if callable(vars(cls).get(old)):
                raise InputError(
                    f"{cls.__name__} defines {old}, a hook of 0.1; since 0.2 it is called {new}: rename it"
                )
        # What a subclass defines counts, whatever short cuts the class above it has.
        hooks = tuple(_HOOKS.values())
        stands_for(cls, "_needs_frames", *hooks, off=True)
        stands_for(cls, "_by_hooks", *_EVALUATIONS, off=False)
        stands_for(cls, "kernel", *hooks, *_EVALUATIONS)
        stands_for(cls, "is_vector", "minus", off=False)
        stands_for(cls, "rotations", "point")
        stands_for(cls, "frame_parts", *hooks, *_EVALUATIONS, "minus", "plus", off=Task.frame_parts)
        if kind:
            cls.kind = kind
            KINDS[kind] = cls

    def __init__(self, robot: Robot, labels: Sequence[str], units: Sequence[str], size: int | None = None) -> None:
        self.robot = robot
        self.labels, self.units = tuple(labels), tuple(units)
        self.m = len(self.labels)
        self.size = self.m if size is None else size
        self._model = robot.model
        self._data = workspace(robot.model)
        self._rest = np.zeros(robot.n)
        if self.m > robot.n:
            raise InputError(
                f"{self!r} has {self.m} coordinates, but {robot.name!r} only {robot.n} joints; choose a smaller task"
            )

    # -- one pass over Pinocchio for each order of derivative -------------------------------------------------------

    @checked
    def value(self, q: JointVector) -> Point:
        """Task point z = G(q); Eq. (1)."""
        pin.forwardKinematics(self._model, self._data, q)
        if self._needs_frames:
            pin.updateFramePlacements(self._model, self._data)
        return self._compute_point(self._data)

    @checked
    def linearize(self, q: JointVector) -> tuple[Point, Jacobian]:
        """Task point z and Jacobian J = G'(q), (m, n); Eq. (2)."""
        pin.computeJointJacobians(self._model, self._data, q)
        if self._needs_frames:
            pin.updateFramePlacements(self._model, self._data)
        return self._compute_point(self._data), self._matrix(self._compute_jacobian(self._data))

    @checked
    def at(self, q: JointVector, dq: JointVector) -> TaskPoint:
        """Task point, Jacobian, velocity and drift at the state (q, dq)."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, dq, self._rest)
        pin.computeJointJacobians(model, data)
        if self._needs_frames:
            pin.updateFramePlacements(model, data)
        J = self._matrix(self._compute_jacobian(data))
        return _task_point((self._compute_point(data), J, J.dot(dq), self._compute_drift(data)))

    @checked
    def set_time(self, t: float) -> Task:
        """Set the time of evaluations from here on, where the task `moves` [s]; 0 at first. Returns itself."""
        return self

    def check_still(self, user: str) -> None:
        """Refuse a task that `moves` where `user` takes it for a function of the joints alone."""
        if self.moves:
            raise InputError(f"{user} needs a task that is at rest, {self!r} moves. Use EosController or KinematicLoop")

    def _matrix(self, J: Array) -> Jacobian:
        """J as a matrix; with one joint, Pinocchio's bindings return a vector instead of a column."""
        return J if J.ndim == 2 else J[:, None]

    # -- the hooks, and what they may read ---------------------------------------------------------------------------

    @abstractmethod
    @checked
    def compute_point(self, data: pin.Data) -> Point:
        """Hook: task point z = G(q), (size,), no view of `data`, which has placements of joints and frames; Eq. (1)."""

    @abstractmethod
    @checked
    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        """Hook: Jacobian G'(q), (m, n); Eq. (2). In `data` are placements and joint Jacobians."""

    @abstractmethod
    @checked
    def compute_drift(self, data: pin.Data) -> TaskVector:
        """Hook: drift Ġ'dq, (m,) [m/s², rad/s²]. In `data` are velocities and accelerations at ddq = 0, too."""

    @checked
    def frame_placement(self, data: pin.Data, frame: int) -> pin.SE3:
        """Placement of the frame with the number `robot.frame_id(name)` in the world, for hooks."""
        return pin.updateFramePlacement(self._model, data, frame)

    @checked
    def frame_jacobian(self, data: pin.Data, frame: int) -> Float[np.ndarray, "6 n"]:
        """Jacobian of a frame, (6, n): velocity of its origin, then angular velocity, in the axes of the world."""
        return pin.getFrameJacobian(self._model, data, frame, WORLD).reshape(6, -1)

    @checked
    def frame_velocity(self, data: pin.Data, frame: int) -> pin.Motion:
        """Velocity of a frame's origin and angular velocity in the axes of the world, for `compute_drift`."""
        return pin.getFrameVelocity(self._model, data, frame, WORLD)

    @checked
    def frame_acceleration(self, data: pin.Data, frame: int) -> pin.Motion:
        """Acceleration of a frame's origin and angular acceleration in the axes of the world, for `compute_drift`."""
        return pin.getFrameClassicalAcceleration(self._model, data, frame, WORLD)

    # -- many states at once -----------------------------------------------------------------------------------------

    @cached_property
    def kinematics(self) -> Kinematics:
        """Task points, Jacobians and searches for many states at once, compiled where the task is made of frames."""
        return Kinematics(self)

    def frame_parts(self) -> tuple[Part, ...] | None:
        """Frames and the parts of their poses that are the task, for compiled kinematics; None for other tasks."""
        return None

    def __getstate__(self) -> dict[str, Any]:
        # Compiled kinematics are made anew where the task is unpickled.
        return {key: value for key, value in self.__dict__.items() if key != "kinematics"}

    # -- the group the points live in; by default a vector space ----------------------------------------------------

    @checked
    def minus(self, z1: Point, z0: Point) -> TaskVector:
        """Step that leads from z0 to z1 [m, rad]; `plus` undoes it."""
        return z1 - z0

    @checked
    def plus(self, z: Point, delta: TaskVector) -> Point:
        """Point reached from z by the step `delta` [m, rad]."""
        return z + delta

    @checked
    def local_rate(self, delta: TaskVector, dz: TaskVector, z_bar: Point | None = None) -> TaskVector:
        """Time derivative of the local coordinates `delta = minus(z, z_bar)` where z moves with velocity dz.

        Only where `is_curved` does it depend on z_bar.
        """
        return dz

    @checked
    def local_margin(self, delta: TaskVector) -> float:
        """Positive where `delta` is well inside the domain of the local coordinates; 1 at its centre."""
        return 1.0

    @checked
    def tracking_acceleration(
        self, z: Point, dz: TaskVector, target: Target, kp: TaskVector, kd: TaskVector
    ) -> TaskVector:
        """Task acceleration with which the error obeys ε̈ + kd ε̇ + kp ε = 0; Eqs. (33), (36).

        Args:
            z: Task point.
            dz: Task velocity.
            target: Point, velocity and acceleration to be tracked.
            kp: Gain on the error, (m,) [1/s²].
            kd: Gain on its rate, (m,) [1/s].
        """
        z_d, dz_d, ddz_d = target
        pull = kp * self._minus(z_d, z)
        pull += kd * (dz_d - dz)
        return pull + ddz_d

    @checked
    def channels(self) -> tuple[Channel, ...]:
        """Parts of a point z, one after the other; by default all of it are numbers."""
        return (Channel(slice(0, self.size), "number"),)

    @property
    def whole(self) -> Task:
        """Task of all coordinates of a point z, where only some are tracked; otherwise the task itself."""
        return self

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the coordinates that are kept in a band about their target and not tracked; by default none."""
        return ()

    @checked
    def used(self, z: Float[Array, "K size"], targets: Float[Array, "#K size"]) -> Float[Array, "K B 2"]:
        """Distance from the target in each of the `bands`, in parts of its half width: vectors of length 1 at most.

        A band of a number has one component, that of a cone two.
        """
        return np.zeros((len(z), 0, 2))

    def _rates(self, z: Array, dz: Array, ddz: Array) -> tuple[Array, Array]:
        """Velocities and accelerations of this task from those of the whole one at points z, (K, …)."""
        return dz, ddz

    @property
    def form(self) -> tuple[Kind, ...]:
        """Kinds of the parts of a point z, such as `("number", "rotation")` of a pose."""
        return tuple(kind for _, kind in self.channels())

    @property
    def lengths(self) -> tuple[str, ...]:
        """Names of the first coordinates of z that are lengths, for paths: `axes`, or else labels with the unit m."""
        part, kind = self.channels()[0]
        first = zip(self.labels[: part.stop], self.units, strict=False)
        return tuple(self.axes) or tuple(label for label, unit in first if unit == "m" and kind == "number")

    @checked
    def balls(self) -> tuple[Ball, ...]:
        """Balls that lengths among the coordinates of z never leave, to refuse points out of reach; by default none."""
        return ()

    @checked
    def point(self, value: PointLike) -> Point:
        """Flat task point from a point in any accepted form.

        Raises:
            InputError: Wrong shape, not finite, or not a rotation.
        """
        return vector(value, self.size, self._point_name)  # type: ignore[arg-type]

    _point_name = cached_property(lambda self: f"a point of {self!r}")

    @checked
    def hold(self, q: JointsLike) -> Hold:
        """Trajectory that rests at the task point of the joints q.

        Args:
            q: Joints, (n,) or by name [rad or m].

        Raises:
            InputError: Not joints of this robot.
        """
        return Hold(self.value(self.robot.posture(q)), self.m)

    @checked
    def aim(self, q: JointsLike) -> Hold:
        """Goal of a run from the joints q without a path: to stay, unless the task has a goal of its own."""
        return self.hold(q)

    # -- the same without checks, for inner loops ----------------------------------------------------------------------

    _value = unchecked(value)
    _linearize = unchecked(linearize)
    _at = unchecked(at)
    _set_time = unchecked(set_time)
    _minus = unchecked(minus)
    _plus = unchecked(plus)
    _local_rate = unchecked(local_rate)
    _local_margin = unchecked(local_margin)
    _tracking_acceleration = unchecked(tracking_acceleration)
    _compute_point = unchecked(compute_point)
    _compute_jacobian = unchecked(compute_jacobian)
    _compute_drift = unchecked(compute_drift)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the choice of a task, such as one that leaves no redundancy."""
        none = f"{self!r} takes all {self.m} joints (r = 0): there is no self-motion, and laws for it change nothing"
        return (none,) if self.m == self.robot.n else ()

    # -- identity ----------------------------------------------------------------------------------------------------

    def describe(self) -> dict[str, Any]:
        """Plain values from which `task_from_description` makes the same task on the same robot."""
        return {"kind": self.kind} | {name: getattr(self, name) for name in self.arguments}

    def __repr__(self) -> str:
        words = [f"{key}={value!r}" for key, value in self.describe().items() if key != "kind" and value]
        return f"{type(self).__name__}({', '.join(words)})"
