"""Kinematics of a task on many states at once, compiled where that is possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin._kernels import tracing
from eos_pin._kernels.dispatch import kernels
from eos_pin._kernels.flat import Part, chain_arguments, flat_model
from eos_pin._kernels.plain import PlainChain, TaskFunctions
from eos_pin._kernels.tracing import CLOSED, ENDS, Curve
from eos_pin.errors import EosError, InputError, SingularError

#: Largest difference from Pinocchio that is rounding, relative to the robot's reach and to 1 rad.
ROUNDING = 1e-11
#: States that are compared with Pinocchio when a task is first used.
COMPARED = 16
#: Step of a trace that ends it at a singularity, where it still fails.
SHORTEST = 1e-7
#: Most nodes of a trace to one side.
MOST_NODES = 20000


@runtime_checkable
class FramedTask(TaskFunctions, Protocol):
    """A task and, where it is made of frames, its parts."""

    robot: Any

    def frame_parts(self) -> tuple[Part, ...] | None:
        """Frames and the parts of their poses that are the task; None where it is something else."""


class Found(NamedTuple):
    """Joints that a search ended at, one row for each start that was tried.

    Attributes:
        q: Joints, (K, n).
        residual: Task error that is left, the largest entry, (K,) [m, rad].
        steps: Steps that were tried, (K,).
        found: Whether the residual is within the tolerance, (K,).
    """

    q: Float[Array, "K n"]
    residual: Float[Array, " K"]
    steps: Int[Array, " K"]
    found: Bool[Array, " K"]


class Kinematics:
    """Task points, Jacobians and searches for many states at once; `Task.kinematics` holds it.

    The kernel is compared with the task, which asks Pinocchio, on random states when it is made, and every point that a
    search finds is computed once more by the task. One object is for one thread.

    Args:
        task: The task.

    Attributes:
        task: The task.
        n: Number of joints.
        m: Dimension of the task.
        compiled: Whether the compiled kernel computes.
        revolute: Which joints turn, (n,).

    Raises:
        EosError: The kernel and the task differ.
    """

    def __init__(self, task: FramedTask) -> None:
        self.task = task
        self.n, self.m, self.size = int(task.robot.n), task.m, task.size
        self._plain = PlainChain(task, self.n)
        self._chain = self._kernel()
        self.compiled = self._chain is not self._plain
        if self.compiled:
            self._compare()

    def _kernel(self) -> Any:
        """The compiled kernel, or the plain one where the task is not made of frames, or too large."""
        parts = self.task.frame_parts()
        arguments = chain_arguments(self.task.robot.model, parts) if kernels and parts else None
        if arguments is not None and self.n <= kernels.LARGEST[0] and self.m <= kernels.LARGEST[1]:
            return kernels.Chain(*arguments)
        return self._plain

    def __getstate__(self) -> dict[str, Any]:
        # A compiled kernel is made anew in a copy.
        return {name: value for name, value in vars(self).items() if name != "_chain"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._chain = self._kernel()

    @cached_property
    def revolute(self) -> Bool[Array, " n"]:
        """Mask of the joints that turn."""
        return np.array([joint.kind != "prismatic" for joint in self.task.robot.joints])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.task.robot.joints)

    def value(self, Q: Array) -> Float[Array, "K size"]:
        """Task points of states, (K, n)."""
        return self._chain.value(self._states(Q))

    def linearize(self, Q: Array) -> tuple[Float[Array, "K size"], Float[Array, "K m n"]]:
        """Task points and Jacobians of states, (K, n)."""
        return self._chain.linearize(self._states(Q))

    def minus(self, Z1: Array, Z0: Array) -> Float[Array, "K m"]:
        """Steps from Z0 to Z1 [m, rad]; either may have one row for all."""
        return self._chain.minus(self._points(Z1), self._points(Z0))

    def residual(self, Q: Array, Z: Array) -> Float[Array, " K"]:
        """Largest entry of each state's task error, as the task itself has it [m, rad]."""
        return np.abs(self._plain.minus(self._plain.value(Q), self._points(Z))).max(axis=1, initial=0.0)

    def project(
        self,
        Q: Array,
        Z: Array,
        *,
        lower: Array | None = None,
        upper: Array | None = None,
        tol: float = 1e-10,
        most: int = 60,
        checked: bool = True,
    ) -> Found:
        """Joints at task points, from each state by the shortest steps, so that near ones stay near.

        Levenberg and Marquardt's method; joints stay within bounds if there are any.

        Args:
            Q: Where to begin, (K, n).
            Z: Task point of each state, or one for all, (K, size) or (size,).
            lower: Least value of each joint; none by default.
            upper: Largest value of each joint; none by default.
            tol: Largest task error that may be left [m, rad].
            most: Most steps.
            checked: Whether the task itself computes the errors that are left once more; for points that are checked
                later anyway it may be left out.

        Raises:
            InputError: Wrong shapes.
            EosError: The task does not confirm a point that was found.
        """
        Q, Z = self._states(Q), self._points(Z)
        if len(Z) not in (1, len(Q)):
            raise InputError(f"one task point is needed for each of the {len(Q)} states, or one for all; got {len(Z)}")
        least = self._none[0] if lower is None else np.ascontiguousarray(lower, dtype=float)
        largest = self._none[1] if upper is None else np.ascontiguousarray(upper, dtype=float)
        if least.shape != (self.n,) or largest.shape != (self.n,):
            raise InputError(f"bounds must be {self.n} numbers each, got {least.shape} and {largest.shape}")
        q, left, steps = self._chain.search(Q, Z, least, largest, tol, most, False)
        found = left <= tol
        if checked and self.compiled and found.any():
            self._confirm(q[found], Z[found[: len(Z)]] if len(Z) > 1 else Z, tol)
        return Found(q, left, steps, found)

    def search(
        self,
        q: JointVector,
        z: Vector,
        bounds: tuple[JointVector, JointVector],
        others: Callable[[int], Float[Array, "L n"]],
        *,
        tol: float = 1e-10,
        most: int = 60,
    ) -> tuple[JointVector, float]:
        """Search for joints at a task point from one state, then from others, until one leads there.

        Arguments are not checked, and what is found is not confirmed: that is for the caller, who computes its task
        error anyway.

        Args:
            q: Where to begin first, (n,).
            z: Task point, (size,).
            bounds: Least and largest value of each joint.
            others: Draws so many more states, (L, n), or fewer where there are no more.
            tol: Largest task error that may be left [m, rad].
            most: Most steps from each state.

        Returns:
            Joints and their task error; the least that was found.
        """
        # Views into larger arrays are copied; the kernels need numbers side by side.
        q, z, lower, upper = map(np.ascontiguousarray, (q, z, *bounds))
        chain = self._chain
        best, least = chain.one(q, z, lower, upper, tol, most)
        count = 4
        while least > tol and len(starts := others(count)):
            found, left, _ = chain.search(starts, z[None], lower, upper, tol, most, True)
            i = int(left.argmin())
            if left[i] < least:
                best, least = found[i], float(left[i])
            count *= 2
        return best, least

    def trace(
        self,
        q: Array,
        *,
        z: Array | None = None,
        step: float = 0.1,
        turn: float = 0.2,
        length: float = 300.0,
        tol: float = 1e-11,
        checked: bool = True,
    ) -> Curve:
        """The whole curve of self-motion through a state, of a task with one redundant joint.

        Args:
            q: Joints, (n,).
            z: Task point there; by default that of q.
            step: Largest step of one joint from node to node, as it is predicted [rad or m].
            turn: Largest angle between the unit vectors of neighbouring nodes [rad].
            length: A curve that is not closed within this length ends there, to both sides.
            tol: Largest task error of a node [m, rad].
            checked: Whether the task itself computes the error of each node once more.

        Raises:
            InputError: Wrong shapes, or the degree of redundancy is not one.
            SingularError: The task is singular at q.
            EosError: The task does not confirm a node.
        """
        q = self._states(np.atleast_2d(q))[0]
        z = self._one(self.value(q[None])[0] if z is None else z)
        Q, T, end = self._traced(q, z, 1.0, step, turn, length, tol)
        if not len(Q):
            J = self.linearize(q[None])[1][0]
            values = np.linalg.svd(J, compute_uv=False)
            rank = int((values > tracing.REGULAR * values[0]).sum())
            raise SingularError(
                f"{self.task!r} is singular at q = {q.tolist()}, where self-motions meet or end; start from another "
                "posture",
                rank,
                values.tolist(),
            )
        ends, winding = (ENDS[end], ENDS[end]), np.zeros(self.n, dtype=np.int64)
        if end == CLOSED:
            winding = np.where(self.revolute, np.round((Q[-1] - Q[0]) / (2.0 * np.pi)), 0.0).astype(np.int64)
        else:
            before, unit, other = self._traced(q, z, -1.0, step, turn, length, tol)
            Q, T = np.concatenate((before[:0:-1], Q)), np.concatenate((-unit[:0:-1], T))
            ends = ENDS[other], ENDS[end]
        if checked and self.compiled:
            self._confirm(Q, z, tol)
        return Curve(Q, T, ends, winding)

    def tangents(self, Q: Array, z: Array) -> tuple[Float[Array, "K n"], Float[Array, " K"]]:
        """Unit vectors of the self-motion at states, and the regularity of each, 0 at a singularity; see `trace`."""
        self._one_redundant()
        return self._tracing.tangents(self._chain, self._states(Q), self._one(z))

    def nearest(self, Q: Array, T: Array, curve: Curve) -> tuple[Int[Array, " K"], Float[Array, "K n"]]:
        """Node of a curve nearest to each state where the curve runs along T; see `tracing.nearest`."""
        return self._tracing.nearest(
            self._states(Q), self._states(T), self._states(curve.q), self._states(curve.t), self._revolute
        )

    def links(self, Q: Array, frames: Sequence[int]) -> Float[Array, "K L 12"]:
        """Flat poses of frames, by their numbers in the Pinocchio model: position, then rotation row by row."""
        Q = self._states(Q)
        if not self.compiled:
            robot = self.task.robot
            names = [robot.model.frames[frame].name for frame in frames]
            poses = [[robot.placement(q, name) for name in names] for q in Q]
            flat = [[np.concatenate((p.translation, p.rotation.ravel())) for p in row] for row in poses]
            return np.reshape(flat, (len(Q), len(names), 12))
        flat_joints = flat_model(self.task.robot.model)
        assert flat_joints is not None
        carried = [flat_joints.carried(self.task.robot.model, frame) for frame in frames]
        joints = np.array([joint for joint, _ in carried], dtype=np.int32)
        return self._chain.links(Q, joints, np.reshape([tip for _, tip in carried], (len(carried), 12)))

    def _traced(
        self, q: JointVector, z: Array, direction: float, step: float, turn: float, length: float, tol: float
    ) -> tuple[Float[Array, "K n"], Float[Array, "K n"], int]:
        self._one_redundant()
        return self._tracing.trace(
            self._chain, q, z, self._revolute, direction, step, turn, length, SHORTEST, tol, MOST_NODES
        )

    @cached_property
    def _revolute(self) -> Array:
        """Mask of the joints that turn, as the kernels take it."""
        return self.revolute.astype(np.uint8) if self.compiled else self.revolute

    @property
    def _tracing(self) -> Any:
        return kernels if self.compiled else tracing

    def _one_redundant(self) -> None:
        if self.n - self.m != 1:
            raise InputError(
                f"the self-motion of {self.task!r} is a curve where the robot has one joint more than the task has "
                f"coordinates; here it has {self.n} joints and {self.m} coordinates"
            )

    # -- borders -----------------------------------------------------------------------------------------------------

    def _confirm(self, Q: Array, Z: Array, tol: float) -> None:
        """Compute the kernel's solutions once more with the task itself."""
        self.confirm(float(self.residual(Q, Z).max()), tol)

    def confirm(self, worst: float, tol: float) -> None:
        """Refuse an error of joints that were found, as the task itself computes it.

        Raises:
            EosError: It is beyond the tolerance.
        """
        if not worst <= tol + self._rounding:
            raise EosError(
                f"the compiled kinematics found joints at which {self.task!r} has an error of {worst:.3g}, more than "
                f"{tol:.3g}: please report it, and set EOS_PIN_COMPILED=0 in the environment to go on"
            )

    def _compare(self) -> None:
        """Compare the kernel with the task on random states."""
        robot = self.task.robot
        lower, upper = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
        Q = np.random.default_rng(0).uniform(lower, upper, (COMPARED, self.n))
        Z, J = self._plain.linearize(Q)
        z, jacobians = self._chain.linearize(Q)
        turned = np.roll(Z, 1, axis=0)
        differences = (
            z - Z,
            jacobians - J,
            self._chain.minus(Z, turned) - self._plain.minus(Z, turned),
        )
        worst = max(float(np.abs(difference).max()) for difference in differences)
        if not worst <= 100.0 * self._rounding:
            raise EosError(
                f"the compiled kinematics of {self.task!r} differ from the task's own by {worst:.3g}. If the task is a "
                "class of your own that changes what it derives from, let its frame_parts() return None; otherwise "
                "please report it, and set EOS_PIN_COMPILED=0 in the environment to go on"
            )

    @cached_property
    def _none(self) -> tuple[JointVector, JointVector]:
        """Infinite bounds, for joints without limits."""
        return np.full(self.n, -np.inf), np.full(self.n, np.inf)

    @cached_property
    def _rounding(self) -> float:
        return ROUNDING * max(1.0, self.task.robot.reach)

    def _states(self, Q: Array) -> Float[Array, "K n"]:
        Q = np.ascontiguousarray(Q, dtype=float)
        if Q.ndim != 2 or Q.shape[1] != self.n:
            raise InputError(f"states must be of shape (K, {self.n}), got {Q.shape}")
        return Q

    def _one(self, z: Array) -> Vector:
        """One task point."""
        Z = self._points(z)
        if len(Z) != 1:
            raise InputError(f"one task point is needed, got {len(Z)}")
        return Z[0]

    def _points(self, Z: Array) -> Float[Array, "K size"]:
        Z = np.ascontiguousarray(np.atleast_2d(Z), dtype=float)
        if Z.ndim != 2 or Z.shape[1] != self.size:
            raise InputError(f"task points must be of shape (K, {self.size}), got {Z.shape}")
        return Z
