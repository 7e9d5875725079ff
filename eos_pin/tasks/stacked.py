"""Several tasks at once, and tasks from their descriptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    TaskVector,
    Vector,
    checked,
    vector,
)
from eos_pin._kernels.flat import Part
from eos_pin._kernels.kinematics import Kinematics
from eos_pin.errors import InputError, UnknownNameError
from eos_pin.robot.model import Robot
from eos_pin.tasks._balls import Ball
from eos_pin.tasks.base import KINDS, Channel, Point, PointLike, Task, TaskPoint
from eos_pin.tasks.target import Target


class StackedTask(Task, kind="stacked"):
    """Several tasks at once, their coordinates one after the other.

    Args:
        tasks: Two or more tasks of the same robot.

    Raises:
        InputError: No tasks, tasks of different robots, or more coordinates than joints.
    """

    @checked
    def __init__(self, tasks: Sequence[Task]) -> None:
        if not tasks:
            raise InputError("StackedTask needs at least one task")
        if any(task.robot is not tasks[0].robot for task in tasks):
            raise InputError("the parts of a StackedTask must belong to one Robot object, these belong to several")
        self.tasks = tuple(tasks)
        self._needs_frames = any(task._needs_frames for task in tasks)
        labels = [f"{label}{i}" if len(tasks) > 1 else label for i, t in enumerate(tasks, 1) for label in t.labels]
        if len({label for t in tasks for label in t.labels}) == sum(t.m for t in tasks):
            labels = [label for t in tasks for label in t.labels]
        units = [unit for t in tasks for unit in t.units]
        super().__init__(tasks[0].robot, labels, units, sum(t.size for t in tasks))
        # Its points begin with those of the first task.
        self.frame, self.axes, self.seen_from = tasks[0].frame, tasks[0].axes, tasks[0].seen_from
        self.is_curved = any(task.is_curved for task in tasks)
        self.moves = any(task.moves for task in tasks)
        self._by_hooks = all(task._by_hooks for task in tasks)
        self._slices = []
        point = step = 0
        for task in tasks:
            self._slices.append((task, slice(point, point + task.size), slice(step, step + task.m)))
            point, step = point + task.size, step + task.m
        if None not in (type(self).rotations, *(task.rotations for task in tasks)):
            self.rotations = tuple(part.start + i for task, part, _ in self._slices for i in task.rotations or ())
        else:
            self.rotations = None

    def compute_point(self, data: pin.Data) -> Point:
        return np.concatenate([task._compute_point(data) for task in self.tasks])

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return np.concatenate([self._matrix(task._compute_jacobian(data)) for task in self.tasks])

    def compute_drift(self, data: pin.Data) -> TaskVector:
        return np.concatenate([task._compute_drift(data) for task in self.tasks])

    # A part with another way to its values than the hooks is asked itself.
    def value(self, q: JointVector) -> Point:
        return super()._value(q) if self._by_hooks else np.concatenate([task._value(q) for task in self.tasks])

    def linearize(self, q: JointVector) -> tuple[Point, Jacobian]:
        if self._by_hooks:
            return super()._linearize(q)
        z, J = zip(*(task._linearize(q) for task in self.tasks), strict=True)
        return np.concatenate(z), np.concatenate(J)

    def at(self, q: JointVector, dq: JointVector) -> TaskPoint:
        if self._by_hooks:
            return super()._at(q, dq)
        return TaskPoint(*map(np.concatenate, zip(*(task._at(q, dq) for task in self.tasks), strict=True)))

    def set_time(self, t: float) -> Task:
        for task in self.tasks:
            task._set_time(t)
        return self

    def frame_parts(self) -> tuple[Part, ...] | None:
        parts = [task.frame_parts() for task in self.tasks]
        return None if None in parts else tuple(part for some in parts for part in some or ())

    def channels(self) -> tuple[Channel, ...]:
        return tuple(
            Channel(slice(p.start + part.start, p.start + part.stop), kind)
            for task, p, _ in self._slices
            for part, kind in task.channels()
        )

    def balls(self) -> tuple[Ball, ...]:
        return tuple(
            ball._replace(rows=slice(p.start + ball.rows.start, p.start + ball.rows.stop))
            for task, p, _ in self._slices
            for ball in task.balls()
        )

    # -- parts with tolerances ---------------------------------------------------------------------------------------

    @cached_property
    def whole(self) -> Task:
        """Stack of the whole tasks; itself where no part has a tolerance."""
        if all(task.whole is task for task in self.tasks):
            return self
        return StackedTask([task.whole for task in self.tasks])

    @cached_property
    def tracked(self) -> Task:
        """Stack of the tracked coordinates of the parts; itself where no part has a tolerance."""
        parts: list[Any] = list(self.tasks)
        return self if self.whole is self else StackedTask([p if p.whole is p else p.tracked for p in parts])

    def _seen(self, z: Array) -> Array:
        """Point of the tracked stack, of a point of this one; several in rows."""
        parts: list[tuple[Any, slice, slice]] = self._slices
        seen = [z[..., p] if task.whole is task else task._seen(z[..., p]) for task, p, _ in parts]
        return np.concatenate(seen, axis=-1)

    @cached_property
    def kinematics(self) -> Kinematics:
        return Kinematics(self) if self.whole is self else TrackedKinematics(self)

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the bands of all parts, with the number of the part where two have the same."""
        names = [(name, i) for i, task in enumerate(self.tasks, 1) for name in task.bands]
        alone = len({name for name, _ in names}) == len(names)
        return tuple(name if alone else f"{name}{i}" for name, i in names)

    def used(self, z: Float[Array, "K size"], targets: Float[Array, "#K size"]) -> Float[Array, "K B 2"]:
        return np.concatenate([task.used(z[:, p], targets[:, p]) for task, p, _ in self._slices], axis=1)

    def _rates(self, z: Array, dz: Array, ddz: Array) -> tuple[Array, Array]:
        parts, start = [], 0
        for task, p, _ in self._slices:
            of_part = slice(start, start := start + task.whole.m)
            parts.append(task._rates(z[:, p], dz[:, of_part], ddz[:, of_part]))
        return tuple(map(np.hstack, zip(*parts, strict=True)))  # type: ignore[return-value]

    # -- points ------------------------------------------------------------------------------------------------------

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return np.concatenate([task._minus(z1[p], z0[p]) for task, p, _ in self._slices])

    def plus(self, z: Point, delta: TaskVector) -> Point:
        return np.concatenate([task._plus(z[p], delta[d]) for task, p, d in self._slices])

    def local_rate(self, delta: TaskVector, dz: TaskVector, z_bar: Point | None = None) -> TaskVector:
        return np.concatenate(
            [
                task._local_rate(delta[d], dz[d], z_bar[p])
                if task.is_curved and z_bar is not None
                else task._local_rate(delta[d], dz[d])
                for task, p, d in self._slices
            ]
        )

    def local_margin(self, delta: TaskVector) -> float:
        return min(task._local_margin(delta[d]) for task, _, d in self._slices)

    def tracking_acceleration(
        self, z: Point, dz: TaskVector, target: Target, kp: TaskVector, kd: TaskVector
    ) -> TaskVector:
        z_d, dz_d, ddz_d = target
        return np.concatenate(
            [
                task._tracking_acceleration(z[p], dz[d], Target(z_d[p], dz_d[d], ddz_d[d]), kp[d], kd[d])
                for task, p, d in self._slices
            ]
        )

    @checked
    def point(self, value: PointLike) -> Point:
        array = vector(value, self.size, self._point_name)  # type: ignore[arg-type]
        return np.concatenate([task.point(array[p]) for task, p, _ in self._slices])

    def describe(self) -> dict[str, Any]:
        return {"kind": "stacked", "tasks": [task.describe() for task in self.tasks]}


class TrackedKinematics(Kinematics):
    """Kinematics of the tracked coordinates, with points of the whole task."""

    def __init__(self, task: Any) -> None:
        super().__init__(task.tracked)
        self._whole, self._seen = task.whole.kinematics, task._seen

    def value(self, Q: Array) -> Float[Array, "K size"]:
        return self._whole.value(Q)

    def linearize(self, Q: Array) -> tuple[Float[Array, "K size"], Float[Array, "K m n"]]:
        return self.value(Q), super().linearize(Q)[1]

    def search(self, q: JointVector, z: Vector, *arguments: Any, **options: Any) -> tuple[JointVector, float]:
        return super().search(q, self._one(z), *arguments, **options)

    def _points(self, Z: Array) -> Float[Array, "K size"]:
        Z = np.atleast_2d(Z)
        return super()._points(self._seen(Z) if Z.shape[1] == self._whole.size else Z)


@checked
def task_from_description(robot: Robot, description: Mapping[str, Any]) -> Task:
    """Task that `Task.describe` described, on `robot`.

    Raises:
        InputError: The description is not of a task of this version.
        UnknownNameError: The robot has no such frame.
    """
    words = dict(description)
    kind = words.pop("kind", None)
    # A task that nothing has used so far is not loaded yet, and not among the kinds.
    room = import_module("eos_pin.tasks")
    for name in room.__all__:
        getattr(room, name)
    try:
        if kind == StackedTask.kind:
            return StackedTask([task_from_description(robot, part) for part in words["tasks"]])
        if "whole" in words:
            within: Any = KINDS[kind]
            task: Task = within(task_from_description(robot, words["whole"]), words["tolerance"])
            return task
        return KINDS[kind](robot, **words)
    except UnknownNameError:
        raise
    except (KeyError, TypeError) as error:
        kinds = ", ".join(sorted(KINDS))
        raise InputError(f"not the description of a task: {dict(description)!r}; the kinds are {kinds}") from error
