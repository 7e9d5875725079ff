"""Tasks: what the robot must do, as a smooth function z = G(q) of its joints, Eq. (1).

A point z is always a flat array. For a position or a centre of mass it is the vector itself; for an orientation it
is the rotation matrix row by row (9 numbers), for a pose the position followed by it (12). `minus` and `plus` are
the group's own difference and step, so that no caller has to know which kind of task it drives. Velocities dz and
rows of J are those of a point and of an angular velocity in the axes of the world (LOCAL_WORLD_ALIGNED); the drift
Ġ'ẏ is the classical acceleration at ÿ = 0.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin.arrays import Array, Jacobian, JointVector, TaskVector, Vector, vector
from eos_pin.errors import InputError
from eos_pin.robot import Robot

#: A flat task point, `Task.size` numbers.
Point: TypeAlias = Float[np.ndarray, " size"]
#: What a caller may give for a point: numbers, a rotation or homogeneous matrix, a `pin.SE3`.
PointLike: TypeAlias = "Sequence[float] | Array | pin.SE3"

_WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


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


class Task(ABC):
    """A smooth function z = G(q) of the joints with its first two derivatives.

    Attributes:
        robot: Robot whose joints it depends on.
        m: Dimension of the task.
        size: Length of the flat array z; m for a vector task, more for a rotation or a pose.
        labels: Name of each of the m coordinates.
        units: Unit of each of the m coordinates.
    """

    robot: Robot
    m: int
    size: int
    labels: tuple[str, ...]
    units: tuple[str, ...]

    def __init__(self, robot: Robot, labels: Sequence[str], units: Sequence[str], size: int | None = None) -> None:
        self.robot = robot
        self.labels, self.units = tuple(labels), tuple(units)
        self.m = len(self.labels)
        self.size = self.m if size is None else size
        self._model = robot.model
        self._data = robot.model.createData()
        self._rest = np.zeros(robot.n)
        if self.m > robot.n:
            raise InputError(
                f"{self!r} has {self.m} coordinates, but {robot.name!r} has only {robot.n} joints; choose a smaller task"
            )

    # -- one pass over Pinocchio for each order of derivative -------------------------------------------------------

    def value(self, q: JointVector) -> Point:
        """Task point z = G(q); Eq. (1)."""
        pin.forwardKinematics(self._model, self._data, q)
        return self._z(self._data)

    def linearize(self, q: JointVector) -> tuple[Point, Jacobian]:
        """Task point z and Jacobian J = G'(q), (m, n); Eq. (2)."""
        pin.computeJointJacobians(self._model, self._data, q)
        return self._z(self._data), self._J(self._data)

    def at(self, q: JointVector, dq: JointVector) -> TaskPoint:
        """Task point, Jacobian, velocity and drift at the state (q, dq)."""
        data = self._data
        pin.forwardKinematics(self._model, data, q, dq, self._rest)
        pin.computeJointJacobians(self._model, data)
        J = self._J(data)
        return TaskPoint(self._z(data), J, J.dot(dq), self._drift(data))

    @abstractmethod
    def _z(self, data: pin.Data) -> Point:
        """Task point, after a pass that computed the placements."""

    @abstractmethod
    def _J(self, data: pin.Data) -> Jacobian:
        """Jacobian, after a pass that computed the joint Jacobians."""

    @abstractmethod
    def _drift(self, data: pin.Data) -> TaskVector:
        """Drift, after a pass at zero joint acceleration."""

    # -- the group the points live in; a vector space unless a task says otherwise ----------------------------------

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        """Step that leads from z0 to z1, so that `plus(z0, minus(z1, z0))` is z1 [m, rad]."""
        return z1 - z0

    def plus(self, z: Point, delta: TaskVector) -> Point:
        """Point reached from z by the step `delta` [m, rad]."""
        return z + delta

    def local_rate(self, delta: TaskVector, dz: TaskVector) -> TaskVector:
        """Time derivative of the local coordinates `delta = minus(z, z_bar)` where z moves with velocity dz."""
        return dz

    def point(self, value: PointLike) -> Point:
        """Flat task point from what a person writes.

        Raises:
            InputError: Wrong shape, not finite, or not a rotation.
        """
        return vector(value, self.size, f"a point of {self!r}")  # type: ignore[arg-type]

    # -- identity ----------------------------------------------------------------------------------------------------

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Plain values from which `task_from` makes the same task on the same robot."""

    def __repr__(self) -> str:
        words = [f"{key}={value!r}" for key, value in self.describe().items() if key != "kind" and value]
        return f"{type(self).__name__}({', '.join(words)})"


class PositionTask(Task):
    """Position of a frame's origin along some axes of the world [m].

    Args:
        robot: The robot.
        frame: Frame whose origin is placed.
        axes: Which coordinates count, such as `"xyz"`, `"xy"` or `"z"`.
    """

    def __init__(self, robot: Robot, frame: str, axes: str = "xyz") -> None:
        self.frame, self.axes = frame, axes
        self._rows = _rows(axes)
        self._id = robot.frame_id(frame)
        super().__init__(robot, list(axes), ["m"] * len(axes))

    def _z(self, data: pin.Data) -> Point:
        return pin.updateFramePlacement(self._model, data, self._id).translation[self._rows].copy()

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, _WORLD)[:3][self._rows]

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, _WORLD).linear[self._rows]

    def describe(self) -> dict[str, Any]:
        return {"kind": "position", "frame": self.frame, "axes": self.axes}


class RelativePositionTask(PositionTask):
    """Position of a frame's origin seen from another frame, in that frame's axes [m].

    The reference frame may be fixed (a table) or move with the robot (the other hand of a two-armed robot).

    Args:
        robot: The robot.
        frame: Frame whose origin is placed.
        reference: Frame it is seen from.
        axes: Which coordinates count, such as `"xyz"`.
    """

    def __init__(self, robot: Robot, frame: str, reference: str, axes: str = "xyz") -> None:
        self.reference = reference
        self._reference_id = robot.frame_id(reference)
        super().__init__(robot, frame, axes)

    def _z(self, data: pin.Data) -> Point:
        frame = pin.updateFramePlacement(self._model, data, self._id)
        reference = pin.updateFramePlacement(self._model, data, self._reference_id)
        return reference.actInv(frame).translation[self._rows].copy()

    def _J(self, data: pin.Data) -> Jacobian:
        R, rho, J, J_ref = self._relative(data)
        return (R.T @ (J[:3] - J_ref[:3] + pin.skew(rho) @ J_ref[3:]))[self._rows]

    def _drift(self, data: pin.Data) -> TaskVector:
        R, rho, _, _ = self._relative(data)
        velocity, acceleration = (
            [read(self._model, data, i, _WORLD) for i in (self._id, self._reference_id)]
            for read in (pin.getFrameVelocity, pin.getFrameClassicalAcceleration)
        )
        omega, alpha = velocity[1].angular, acceleration[1].angular
        slide = velocity[0].linear - velocity[1].linear - np.cross(omega, rho)
        # Acceleration seen from a frame that turns: minus Euler, centrifugal and Coriolis terms.
        seen = (
            acceleration[0].linear
            - acceleration[1].linear
            - np.cross(alpha, rho)
            - np.cross(omega, np.cross(omega, rho))
            - 2.0 * np.cross(omega, slide)
        )
        return (R.T @ seen)[self._rows]

    def _relative(self, data: pin.Data) -> tuple[Array, Array, Array, Array]:
        frame = pin.updateFramePlacement(self._model, data, self._id)
        reference = pin.updateFramePlacement(self._model, data, self._reference_id)
        J, J_ref = (pin.getFrameJacobian(self._model, data, i, _WORLD) for i in (self._id, self._reference_id))
        return reference.rotation.copy(), frame.translation - reference.translation, J, J_ref

    def describe(self) -> dict[str, Any]:
        return {"kind": "relative_position", "frame": self.frame, "reference": self.reference, "axes": self.axes}


class OrientationTask(Task):
    """Orientation of a frame on SO(3) [rad].

    z is the rotation matrix, dz the angular velocity in world axes, `minus(R1, R0)` the rotation vector of R1 R0ᵀ.

    Args:
        robot: The robot.
        frame: Frame that is oriented.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("rx", "ry", "rz"), ["rad"] * 3, 9)

    def _z(self, data: pin.Data) -> Point:
        return pin.updateFramePlacement(self._model, data, self._id).rotation.flatten()

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, _WORLD)[3:]

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, _WORLD).angular

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return pin.log3(z1.reshape(3, 3).dot(z0.reshape(3, 3).T))

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return pin.exp3(delta).dot(z.reshape(3, 3)).ravel()

    def local_rate(self, delta: TaskVector, dz: TaskVector) -> TaskVector:
        # Jlog3 is for a velocity in the moving frame; transposed it is for one in the frame at rest.
        return pin.Jlog3(pin.exp3(delta)).T.dot(dz)

    def point(self, value: PointLike) -> Point:
        return _rotation(value.rotation if isinstance(value, pin.SE3) else value, f"a point of {self!r}")

    def describe(self) -> dict[str, Any]:
        return {"kind": "orientation", "frame": self.frame}


class PoseTask(Task):
    """Pose of a frame on SE(3): position [m] and orientation [rad].

    z is the position followed by the rotation matrix, dz = (velocity of the origin, angular velocity) in world axes.
    `minus` is the logarithm whose curves are straight lines with a constant axis of rotation: the geodesics of SE(3).

    Args:
        robot: The robot.
        frame: Frame that is placed.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("x", "y", "z", "rx", "ry", "rz"), ["m"] * 3 + ["rad"] * 3, 12)

    def _z(self, data: pin.Data) -> Point:
        placement = pin.updateFramePlacement(self._model, data, self._id)
        z = np.empty(12)
        z[:3] = placement.translation
        z[3:] = placement.rotation.ravel()
        return z

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, _WORLD)

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, _WORLD).vector

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        delta = np.empty(6)
        delta[:3] = z1[:3] - z0[:3]
        delta[3:] = pin.log3(z1[3:].reshape(3, 3).dot(z0[3:].reshape(3, 3).T))
        return delta

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return np.concatenate((z[:3] + delta[:3], pin.exp3(delta[3:]).dot(z[3:].reshape(3, 3)).ravel()))

    def local_rate(self, delta: TaskVector, dz: TaskVector) -> TaskVector:
        return np.concatenate((dz[:3], pin.Jlog3(pin.exp3(delta[3:])).T.dot(dz[3:])))

    def point(self, value: PointLike) -> Point:
        name = f"a point of {self!r}"
        if not isinstance(value, pin.SE3):
            array = np.asarray(value, dtype=float)
            if array.shape != (4, 4):
                array = vector(array, 12, f"{name}, a pin.SE3, a 4 × 4 matrix or a flat point,")
                return np.concatenate((array[:3], _rotation(array[3:], name)))
            value = pin.SE3(np.ascontiguousarray(array[:3, :3]), array[:3, 3].copy())
        return np.concatenate((vector(value.translation, 3, name), _rotation(value.rotation, name)))

    def describe(self) -> dict[str, Any]:
        return {"kind": "pose", "frame": self.frame}


class HeadingTask(Task):
    """Heading of a frame on a planar robot: its angle about the world's z axis [rad].

    Args:
        robot: A robot whose revolute joints all turn about the world's z axis.
        frame: Frame whose heading counts.

    Raises:
        InputError: The frame can turn about another axis; use `OrientationTask`.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.frame = frame
        self._id = robot.frame_id(frame)
        super().__init__(robot, ("heading",), ("rad",))
        tilting = pin.computeFrameJacobian(self._model, self._data, self._rest, self._id, _WORLD)[3:5]
        if np.abs(tilting).max() > 1e-9:
            raise InputError(f"frame {frame!r} of {robot.name!r} also turns about x or y; use OrientationTask")

    def _z(self, data: pin.Data) -> Point:
        R = pin.updateFramePlacement(self._model, data, self._id).rotation
        return np.array([math.atan2(R[1, 0], R[0, 0])])

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.getFrameJacobian(self._model, data, self._id, _WORLD)[5:]

    def _drift(self, data: pin.Data) -> TaskVector:
        return pin.getFrameClassicalAcceleration(self._model, data, self._id, _WORLD).angular[2:]

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return np.array([math.remainder(z1[0] - z0[0], math.tau)])

    def describe(self) -> dict[str, Any]:
        return {"kind": "heading", "frame": self.frame}


class ComTask(Task):
    """Position of the robot's centre of mass along some axes of the world [m].

    Args:
        robot: The robot.
        axes: Which coordinates count, such as `"xyz"` or `"xy"`.
    """

    def __init__(self, robot: Robot, axes: str = "xyz") -> None:
        self.axes = axes
        self._rows = _rows(axes)
        super().__init__(robot, list(axes), ["m"] * len(axes))

    def _z(self, data: pin.Data) -> Point:
        # The level is explicit: Pinocchio's shortest form would compute the positions again.
        pin.centerOfMass(self._model, data, pin.KinematicLevel.POSITION, False)
        return data.com[0][self._rows].copy()

    def _J(self, data: pin.Data) -> Jacobian:
        return pin.jacobianCenterOfMass(self._model, data, False)[self._rows]

    def _drift(self, data: pin.Data) -> TaskVector:
        pin.centerOfMass(self._model, data, pin.KinematicLevel.ACCELERATION, False)
        return data.acom[0][self._rows].copy()

    def describe(self) -> dict[str, Any]:
        return {"kind": "com", "axes": self.axes}


class StackedTask(Task):
    """Several tasks at once, their coordinates one after the other.

    Args:
        tasks: Two or more tasks of the same robot.

    Raises:
        InputError: No tasks, tasks of different robots, or more coordinates than joints.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        if not tasks:
            raise InputError("StackedTask needs at least one task")
        if any(task.robot is not tasks[0].robot for task in tasks):
            raise InputError("the parts of a StackedTask must belong to one Robot object, these belong to several")
        self.tasks = tuple(tasks)
        labels = [f"{label}{i}" if len(tasks) > 1 else label for i, t in enumerate(tasks, 1) for label in t.labels]
        if len({label for t in tasks for label in t.labels}) == sum(t.m for t in tasks):
            labels = [label for t in tasks for label in t.labels]
        units = [unit for t in tasks for unit in t.units]
        super().__init__(tasks[0].robot, labels, units, sum(t.size for t in tasks))
        self._slices = []
        point = step = 0
        for task in tasks:
            self._slices.append((task, slice(point, point + task.size), slice(step, step + task.m)))
            point, step = point + task.size, step + task.m

    def _z(self, data: pin.Data) -> Point:
        return np.concatenate([task._z(data) for task in self.tasks])

    def _J(self, data: pin.Data) -> Jacobian:
        return np.concatenate([task._J(data) for task in self.tasks])

    def _drift(self, data: pin.Data) -> TaskVector:
        return np.concatenate([task._drift(data) for task in self.tasks])

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return np.concatenate([task.minus(z1[p], z0[p]) for task, p, _ in self._slices])

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return np.concatenate([task.plus(z[p], delta[d]) for task, p, d in self._slices])

    def local_rate(self, delta: TaskVector, dz: TaskVector) -> TaskVector:
        return np.concatenate([task.local_rate(delta[d], dz[d]) for task, _, d in self._slices])

    def point(self, value: PointLike) -> Point:
        array = vector(value, self.size, f"a point of {self!r}")  # type: ignore[arg-type]
        return np.concatenate([task.point(array[p]) for task, p, _ in self._slices])

    def describe(self) -> dict[str, Any]:
        return {"kind": "stacked", "tasks": [task.describe() for task in self.tasks]}


def task_from(robot: Robot, description: Mapping[str, Any]) -> Task:
    """Task that `Task.describe` described, on `robot`.

    Raises:
        InputError: The description is not of a task this version knows.
    """
    words = dict(description)
    kind = words.pop("kind", None)
    if kind == "stacked":
        return StackedTask([task_from(robot, part) for part in words["tasks"]])
    kinds = {
        "position": PositionTask,
        "relative_position": RelativePositionTask,
        "orientation": OrientationTask,
        "pose": PoseTask,
        "heading": HeadingTask,
        "com": ComTask,
    }
    try:
        return kinds[kind](robot, **words)  # type: ignore[index,abstract]
    except (KeyError, TypeError) as error:
        raise InputError(f"not the description of a task: {dict(description)!r}; kinds are {sorted(kinds)}") from error


def _rows(axes: str) -> slice:
    """Rows of a 3-vector that `axes` names; every subset of three is a slice, which reads without copying a list."""
    rows = ["xyz".find(axis) for axis in axes]
    if not rows or min(rows) < 0 or rows != sorted(set(rows)):
        raise InputError(f"axes must be some of 'x', 'y', 'z' in this order, such as 'xyz' or 'xy'; got {axes!r}")
    step = rows[1] - rows[0] if len(rows) > 1 else 1
    return slice(rows[0], rows[-1] + 1, step)


def _rotation(value: PointLike, name: str) -> Vector:
    """Flat rotation matrix, its rounding errors removed.

    Raises:
        InputError: Not 9 numbers, or not orthonormal to 1e-6.
    """
    R = vector(np.ravel(np.asarray(value, dtype=float)), 9, f"the rotation of {name}").reshape(3, 3)
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
        raise InputError(f"the rotation of {name} must be a 3 × 3 matrix with orthonormal columns and determinant 1")
    X, _, Yt = np.linalg.svd(R)
    return (X @ Yt).ravel()
