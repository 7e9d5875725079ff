"""Tolerances: a task some of whose coordinates are not tracked but kept within bands about their target."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import Array, Jacobian, TaskVector, Vector, checked, number
from eos_pin._kernels.kinematics import Kinematics
from eos_pin.errors import InputError
from eos_pin.tasks import _sphere
from eos_pin.tasks._balls import Ball
from eos_pin.tasks.axis import AxisTask, PointAxisTask
from eos_pin.tasks.base import Channel, Point, PointLike, Task
from eos_pin.tasks.orientation import OrientationTask, PoseTask
from eos_pin.tasks.position import PositionTask
from eos_pin.tasks.stacked import StackedTask, TrackedKinematics
from eos_pin.tasks.target import Target

#: Rotations about an axis of the frame, by name.
TURNS = {"rx": 0, "ry": 1, "rz": 2}
#: Largest half widths of rotations [rad].
WIDEST_TURN, WIDEST_CONE = math.pi, 0.5 * math.pi


class ToleranceTask(Task, kind="tolerance"):
    """A task some of whose coordinates may be anywhere in a band about their target; the others are tracked.

    z and a target have all coordinates of the whole task; m, dz, J and `minus` are of those that are tracked. The
    others are self-motion with limits, which plans keep. Half widths have the names x, y, z (along the axes of the
    world [m]), rx, ry or rz (a turn about that axis of the frame [rad]) and cone (angle between the axis and its target
    [rad]). In a pose, cone goes with one of the turns, whose axis it is about, and the turn is what a rotation has
    besides the shortest one that tilts the axis.

    Args:
        whole: A `PositionTask`, `OrientationTask`, `PoseTask` or `PointAxisTask`.
        tolerance: Half width of each band by name.

    Raises:
        InputError: The task has no such coordinate, or nothing would be left to be tracked.
    """

    is_curved = True
    _needs_frames = False

    @checked
    def __init__(self, whole: Task, tolerance: Mapping[str, float]) -> None:
        self._whole = whole
        self.tolerance = {name: number(width, f"the tolerance {name}", above=0.0) for name, width in tolerance.items()}
        self._check()
        axes = whole.axes
        self._places = [axes.index(name) for name in self.tolerance if name in axes]
        self._turned = next((np.eye(3)[TURNS[name]] for name in self.tolerance if name in TURNS), None)
        kept = "".join(axis for axis in axes if axis not in self.tolerance)
        rotates, directed = isinstance(whole, (PoseTask, OrientationTask)), isinstance(whole, PointAxisTask)
        parts: list[Task] = [PositionTask(whole.robot, whole.frame, kept)] if kept else []
        # Rows of the linear map from points of the whole task to those of what is tracked.
        rows = [np.eye(whole.size)[axes.index(axis)] for axis in kept]
        if "cone" not in self.tolerance and (rotates or directed):
            if rotates and self._turned is not None:
                parts.append(AxisTask(whole.robot, whole.frame, self._turned))
                rows += list(np.kron(np.eye(3), self._turned) @ np.eye(whole.size)[len(axes) :])
            else:
                rest: Task = whole
                if axes:
                    rest = (
                        whole.tasks[1] if isinstance(whole, StackedTask) else OrientationTask(whole.robot, whole.frame)
                    )
                parts.append(rest)
                rows += list(np.eye(whole.size)[len(axes) :])
        if not parts:
            raise InputError(
                f"with the tolerance {', '.join(self.tolerance)} nothing of {whole!r} is left to be tracked"
            )
        self.tracked = parts[0] if len(parts) == 1 else StackedTask(parts)
        self._map = np.array(rows)
        super().__init__(whole.robot, self.tracked.labels, self.tracked.units, whole.size)
        self.frame, self.axes = whole.frame, whole.axes if not self._places else ""

    def _check(self) -> None:
        whole, names = self.whole, set(self.tolerance)
        possible = list(whole.axes) if isinstance(whole, (PositionTask, PoseTask, PointAxisTask)) else []
        if isinstance(whole, (PoseTask, OrientationTask)):
            possible += [*TURNS, "cone"]
        elif isinstance(whole, PointAxisTask):
            possible.append("cone")
        if not names or not names <= set(possible):
            raise InputError(
                f"{whole!r} takes tolerances of {', '.join(possible) or 'nothing'}; got {', '.join(names) or 'none'}"
            )
        turns = names & set(TURNS)
        if len(turns) > 1 or ("cone" in names and not turns and not isinstance(whole, PointAxisTask)):
            raise InputError(
                "a rotation has a tolerance of one of rx, ry and rz, and of a cone about that axis; for a tool that "
                "may turn freely about its axis choose the task point-axis"
            )
        for name in turns | (names & {"cone"}):
            widest = WIDEST_CONE if name == "cone" else WIDEST_TURN
            if self.tolerance[name] > widest:
                raise InputError(f"the tolerance {name} is at most {widest:.4g} rad, got {self.tolerance[name]:g}")

    @property
    def whole(self) -> Task:
        """Task of all coordinates."""
        return self._whole

    def channels(self) -> tuple[Channel, ...]:
        return self.whole.channels()

    def balls(self) -> tuple[Ball, ...]:
        return self.whole.balls()

    # -- bands -------------------------------------------------------------------------------------------------------

    def used(self, z: Float[Array, "K size"], targets: Float[Array, "#K size"]) -> Float[Array, "K B 2"]:
        if len(targets) not in (1, len(z)):
            raise InputError(f"targets must be one or as many as the {len(z)} points, got {len(targets)}")
        parts = []
        for place, name in zip(self._places, (name for name in self.tolerance if name in self.whole.axes), strict=True):
            gap = (z[:, place] - targets[:, place]) / self.tolerance[name]
            parts.append(np.column_stack((gap, np.zeros(len(gap)))))
        first = len(self.whole.axes)
        if isinstance(self.whole, PointAxisTask):
            if "cone" in self.tolerance:
                a, a_d = z[:, first:], np.broadcast_to(targets[:, first:], (len(z), 3))
                along = np.einsum("kij,kj->ki", _sphere.bases(a_d), a)
                parts.append(_tilt(along, (a * a_d).sum(axis=1)) / self.tolerance["cone"])
        elif self._turned is not None:
            R, R_d = (np.reshape(x[:, first:], (-1, 3, 3)) for x in (z, targets))
            E = np.einsum("kji,kjl->kil", np.broadcast_to(R_d, R.shape), R)
            c = int(self._turned.argmax())
            b, d = (c + 1) % 3, (c + 2) % 3
            if "cone" in self.tolerance:
                parts.append(_tilt(E[:, [b, d], c], E[:, c, c]) / self.tolerance["cone"])
            # The turn that is left when the shortest rotation has tilted the axis.
            turn = np.arctan2(E[:, d, b] - E[:, b, d], E[:, b, b] + E[:, d, d])
            width = next(self.tolerance[name] for name in self.tolerance if name in TURNS)
            parts.append(np.column_stack((turn, np.zeros(len(turn)))) / width)
        return np.stack(parts, axis=1)

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the bands in the order of `used`."""
        order = [name for name in self.tolerance if name in self.whole.axes]
        order += ["cone"] if "cone" in self.tolerance else []
        return (*order, *(name for name in self.tolerance if name in TURNS))

    # -- what is tracked ---------------------------------------------------------------------------------------------

    def compute_point(self, data: pin.Data) -> Point:
        return self.whole._compute_point(data)

    def compute_jacobian(self, data: pin.Data) -> Jacobian:
        return self.tracked._compute_jacobian(data)

    def compute_drift(self, data: pin.Data) -> TaskVector:
        return self.tracked._compute_drift(data)

    def _seen(self, z: Array) -> Array:
        """Point of the tracked task, of a point of the whole one; several in rows."""
        return z.dot(self._map.T)

    def minus(self, z1: Point, z0: Point) -> TaskVector:
        return self.tracked._minus(self._seen(z1), self._seen(z0))

    def plus(self, z: Point, delta: TaskVector) -> Point:
        """Point a step further in the tracked coordinates; the others stay, and a rotation turns the shortest way."""
        ahead = z.copy()
        places = len(self.whole.axes)
        kept = [i for i in range(places) if i not in self._places]
        ahead[kept] += delta[: len(kept)]
        if len(delta) > len(kept):
            before, after = z[places:], self.tracked._plus(self._seen(z), delta)[len(kept) :]
            if len(after) == len(before):
                ahead[places:] = after
            else:
                turn = pin.Quaternion.FromTwoVectors(before.reshape(3, 3) @ self._turned, after)
                ahead[places:] = (turn.toRotationMatrix() @ before.reshape(3, 3)).ravel()
        return ahead

    def local_rate(self, delta: TaskVector, dz: TaskVector, z_bar: Point | None = None) -> TaskVector:
        if not self.tracked.is_curved or z_bar is None:
            return self.tracked._local_rate(delta, dz)
        return self.tracked._local_rate(delta, dz, self._seen(z_bar))

    def local_margin(self, delta: TaskVector) -> float:
        return self.tracked._local_margin(delta)

    def tracking_acceleration(
        self, z: Point, dz: TaskVector, target: Target, kp: TaskVector, kd: TaskVector
    ) -> TaskVector:
        seen = Target(self._seen(target.z), target.dz, target.ddz)
        return self.tracked._tracking_acceleration(self._seen(z), dz, seen, kp, kd)

    def _rates(self, z: Array, dz: Array, ddz: Array) -> tuple[Array, Array]:
        """Velocities and accelerations of the tracked task, from those of the whole one; in rows.

        Args:
            z: Task points, (K, size).
            dz: Velocities of the whole task.
            ddz: Its accelerations.
        """
        places = len(self.whole.axes)
        kept = [i for i in range(places) if i not in self._places]
        if self.tracked.m == len(kept):
            return dz[:, kept], ddz[:, kept]
        if self.whole.size - places == self.tracked.size - len(kept):
            return tuple(np.delete(x, self._places, axis=1) for x in (dz, ddz))  # type: ignore[return-value]
        a = self._seen(z)[:, len(kept) :]
        omega, alpha = dz[:, places:], ddz[:, places:]
        da = np.cross(omega, a)
        turned = _sphere.coordinates(a, da, np.cross(alpha, a) + np.cross(omega, da))
        return tuple(np.hstack((x[:, kept], more)) for x, more in zip((dz, ddz), turned, strict=True))  # type: ignore[return-value]

    @cached_property
    def kinematics(self) -> Kinematics:
        return TrackedKinematics(self)

    @checked
    def point(self, value: PointLike) -> Point:
        return self.whole.point(value)

    def describe(self) -> dict[str, Any]:
        return {"kind": self.kind, "whole": self.whole.describe(), "tolerance": dict(self.tolerance)}

    def __repr__(self) -> str:
        return f"ToleranceTask({self.whole!r}, {self.tolerance})"


def _tilt(along: Float[Array, "K 2"], cosine: Vector) -> Float[Array, "K 2"]:
    """Tilts as vectors whose length is the angle, from their sines along two axes and their cosines."""
    sine = np.sqrt((along * along).sum(axis=1))
    return along * (np.arctan2(sine, cosine) / np.where(sine > 0.0, sine, 1.0))[:, None]
