"""Kinematics of many postures at once: task points, Jacobians, and projection onto the self-motion manifold.

The compiled kernel computes them where there is one for the task; without, the formulas here do. Postures are the
columns of an array (n, K), and every array has K as its last axis: each formula then is a few operations on rows of K
numbers, in which NumPy's price for a call is shared by all postures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from eos_pin._arrays import Array
from eos_pin.robot._coordinates import screw
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task

#: Numbers of a flat pose, and rows of the frame's velocity, that are a part of a kind; of positions, those of the axes.
PLACES = {"position": (range(3), range(3)), "orientation": (range(3, 12), range(3, 6)), "pose": (range(12), range(6))}
#: Longest step of one joint in Newton's method [rad or m].
LONGEST = 0.5
#: What is added to the diagonal of J Jᵀ, relative to its trace, lest it be singular.
FLOOR = 1e-12
#: Slope by which the damping of a search grows with the error.
DAMPING = 0.02


class Placements:
    """Forward kinematics of all joints, each about or along the z axis of a frame of its own.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        model, own = robot.model, robot.coordinates
        self.n = model.nv
        self._column, self._factor, self._offset = (values[1:] for values in own[1:4])
        turned = [np.eye(3)]
        self._steps: list[tuple[int, Array, Array, bool]] = []
        for i in range(1, model.njoints):
            S, prismatic = screw(model, i) / own.factor[i], bool(own.slides[i])
            A = _to_axis(S[:3] if prismatic else S[3:])
            turned.append(A)
            parent, place = int(model.parents[i]), model.jointPlacements[i]
            back = turned[parent].T
            self._steps.append((parent, (back @ place.rotation @ A).T.copy(), back @ place.translation, prismatic))
        self._turned = turned
        self._moved = [[j - 1 for j in model.supports[i] if j] for i in range(model.njoints)]

    def __call__(self, Q: Float[Array, "n K"]) -> list[tuple[Array, Array]]:
        """Rotation (3, 3, K) and origin (3, K) of the frame of each joint, the world first."""
        K = Q.shape[1]
        world = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, K)), np.zeros((3, K))
        placed: list[tuple[Array, Array]] = [world]
        if len(self._column) > self.n:
            Q = self._factor[:, None] * Q[self._column] + self._offset[:, None]
        sines, cosines = np.sin(Q), np.cos(Q)
        for i, (parent, Ct, offset, prismatic) in enumerate(self._steps):
            R, p = placed[parent]
            p = p + np.matmul(offset, R)
            T = np.matmul(Ct, R)
            if prismatic:
                placed.append((T, p + Q[i] * T[:, 2]))
                continue
            s, c = sines[i], cosines[i]
            out = np.empty_like(T)
            out[:, 0] = c * T[:, 0] + s * T[:, 1]
            out[:, 1] = c * T[:, 1] - s * T[:, 0]
            out[:, 2] = T[:, 2]
            placed.append((out, p))
        return placed

    def local(self, joint: int, place: pin.SE3) -> tuple[Array, Array]:
        """Rotation and origin of something fixed to a joint, in the frame that is used for that joint here."""
        back = self._turned[joint].T
        return back @ place.rotation, back @ place.translation

    def jacobian(self, placed: Sequence[tuple[Array, Array]], joint: int, point: Array) -> Float[Array, "6 n K"]:
        """Velocity of a point fixed to a joint, and angular velocity, for each joint's own velocity."""
        J = np.zeros((6, self.n, point.shape[1]))
        for i in self._moved[joint]:
            R, p = placed[i + 1]
            k, axis = self._column[i], self._factor[i] * R[:, 2]
            if self._steps[i][3]:
                J[:3, k] += axis
            else:
                d = point - p
                J[0, k] += axis[1] * d[2] - axis[2] * d[1]
                J[1, k] += axis[2] * d[0] - axis[0] * d[2]
                J[2, k] += axis[0] * d[1] - axis[1] * d[0]
                J[3:, k] += axis
        return J


class Manifold:
    """The self-motion manifolds of a task: its points, Jacobians, and the way onto them, for many postures.

    Args:
        task: The task. Tasks of frames are computed together; any other is asked posture by posture.
    """

    def __init__(self, task: Task) -> None:
        self.task, self.robot, self.n, self.m = task, task.robot, task.robot.n, task.m
        parts = task.frame_parts()
        self._parts = None if parts is None or any(part.kind not in PLACES for part in parts) else parts
        kernel = task.kinematics
        self._kernel = kernel if kernel.compiled else None
        self.placements = Placements(task.robot)
        model = task.robot.model
        frames = [model.frames[part.frame] for part in self._parts or ()]
        self._frames = [(f.parentJoint, *self.placements.local(f.parentJoint, f.placement)) for f in frames]

    def linearize(self, Q: Float[Array, "n K"], Z: Float[Array, "size #K"]) -> tuple[Array, Array]:
        """Task errors `minus(Z, G(Q))`, (m, K), and Jacobians, (m, n, K)."""
        if self._kernel is not None:
            z, jacobians = self._kernel.linearize(Q.T)
            return self._kernel.minus(Z.T, z).T, jacobians.transpose(1, 2, 0)
        if self._parts is None:
            return self._one_by_one(Q, Z)
        placed = self.placements(Q)
        errors, rows, first = [], [], 0
        for part, (joint, R0, p0) in zip(self._parts, self._frames, strict=True):
            R, p = placed[joint]
            point = p + np.matmul(p0, R)
            error, J = np.empty((6, Q.shape[1])), self.placements.jacobian(placed, joint, point)
            here, kept = (part.axes, part.axes) if part.kind == "position" else PLACES[part.kind]
            goal = np.empty((12, Z.shape[1]))
            goal[list(here)] = Z[first : first + len(here)]
            first += len(here)
            error[:3] = goal[:3] - point
            if part.kind != "position":
                error[3:] = log3(goal[3:].reshape(3, 3, -1), np.matmul(R0.T, R))
            errors.append(error[list(kept)])
            rows.append(J[list(kept)])
        if len(rows) == 1:
            return errors[0], rows[0]
        return np.concatenate(errors), np.concatenate(rows)

    def _one_by_one(self, Q: Array, Z: Array) -> tuple[Array, Array]:
        K = Q.shape[1]
        error, J = np.empty((self.m, K)), np.empty((self.m, self.n, K))
        Z = np.broadcast_to(Z, (Z.shape[0], K))
        for k in range(K):
            z, J[:, :, k] = self.task._linearize(np.ascontiguousarray(Q[:, k]))
            error[:, k] = self.task._minus(np.ascontiguousarray(Z[:, k]), z)
        return error, J

    def jacobians(self, Q: Float[Array, "n K"], Z: Float[Array, "size #K"]) -> Float[Array, "m n K"]:
        """Jacobians of the task."""
        return self.linearize(Q, Z)[1]

    def project(
        self, Q: Float[Array, "n K"], Z: Float[Array, "size #K"], *, tol: float = 1e-11, iterations: int = 12
    ) -> tuple[Array, Bool[Array, " K"]]:
        """Postures on the manifolds of Z by the shortest Newton steps from Q, and whether they were found."""
        return self._solve(Q, Z, tol, iterations, None)

    def search(
        self,
        Q: Float[Array, "n K"],
        Z: Float[Array, "size #K"],
        bounds: tuple[Array, Array],
        *,
        tol: float = 1e-10,
        iterations: int = 40,
    ) -> tuple[Array, Bool[Array, " K"]]:
        """The same from far away and within bounds, damped where the error is large."""
        return self._solve(Q, Z, tol, iterations, (bounds[0][:, None], bounds[1][:, None]))

    def _solve(
        self, Q: Array, Z: Array, tol: float, iterations: int, bounds: tuple[Array, Array] | None
    ) -> tuple[Array, Array]:
        if self._kernel is not None:
            least, most = (None, None) if bounds is None else (bounds[0][:, 0], bounds[1][:, 0])
            ended = self._kernel.project(Q.T, Z.T, lower=least, upper=most, tol=tol, most=iterations, checked=False)
            return np.ascontiguousarray(ended.q.T), ended.found.copy()
        Q = np.array(Q)
        Z = np.broadcast_to(Z, (Z.shape[0], Q.shape[1]))
        found = np.zeros(Q.shape[1], bool)
        live = np.arange(Q.shape[1])
        for iteration in range(iterations + 1):
            if not live.size:
                break
            q = Q[:, live]
            e, J = self.linearize(q, Z[:, live])
            size = np.abs(e).max(axis=0)
            done = size <= tol
            found[live[done]] = True
            # What has gone astray is not pursued.
            keep = ~done & np.isfinite(size)
            if iteration == iterations or not keep.any():
                break
            if not keep.all():
                live, q, e, J, size = live[keep], q[:, keep], e[:, keep], J[:, :, keep], size[keep]
            if bounds is not None:
                # A joint at its bound that is pushed outwards stays, and the others make up for it.
                uphill = np.einsum("mnk,mk->nk", J, e)
                stuck = ((q <= bounds[0]) & (uphill < 0.0)) | ((q >= bounds[1]) & (uphill > 0.0))
                J = np.where(stuck, 0.0, J)
            damping = DAMPING * (e * e).sum(axis=0) if bounds is not None else 0.0
            step = shortest(J, e, damping)
            longest = np.abs(step).max(axis=0)
            q = q + step * np.minimum(1.0, LONGEST / np.maximum(longest, 1e-300))
            Q[:, live] = q if bounds is None else np.clip(q, *bounds)
        return Q, found

    def null(self, Q: Float[Array, "n K"], Z: Float[Array, "size #K"]) -> Float[Array, "K n r"]:
        """Orthonormal bases of the null spaces of the Jacobians."""
        J = self.jacobians(Q, Z).transpose(2, 1, 0)
        return np.linalg.qr(J, mode="complete")[0][:, :, self.m :]


def shortest(J: Float[Array, "m n K"], e: Float[Array, "m K"], damping: Array | float) -> Float[Array, "n K"]:
    """Jᵀ(J Jᵀ + damping)⁻¹ e, by Cholesky's method in all columns at once."""
    m = len(e)
    A = np.einsum("ink,jnk->ijk", J, J)
    trace = np.einsum("iik->k", A)
    for i in range(m):
        A[i, i] += damping + FLOOR * trace
    L = A
    y = np.array(e)
    for i in range(m):
        for j in range(i):
            L[i, i] -= L[i, j] ** 2
            y[i] -= L[i, j] * y[j]
        L[i, i] = np.sqrt(np.maximum(L[i, i], 1e-300))
        y[i] /= L[i, i]
        for k in range(i + 1, m):
            for j in range(i):
                L[k, i] -= L[k, j] * L[i, j]
            L[k, i] /= L[i, i]
    for i in reversed(range(m)):
        for j in range(i + 1, m):
            y[i] -= L[j, i] * y[j]
        y[i] /= L[i, i]
    return np.einsum("mnk,mk->nk", J, y)


def log3(R1: Float[Array, "3 3 #K"], R0: Float[Array, "3 3 #K"]) -> Float[Array, "3 K"]:
    """Rotation vectors of R1 R0ᵀ, also near half a turn."""
    E = np.einsum("iak,jak->ijk", R1, R0)
    w = 0.5 * np.stack((E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]))
    cosine = 0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0)
    sine = np.sqrt((w * w).sum(axis=0))
    angle = np.arctan2(sine, cosine)
    out = w * np.where(sine > 1e-8, angle / np.maximum(sine, 1e-300), 1.0)
    for k in np.flatnonzero((sine < 1e-4) & (cosine < 0.0)):
        out[:, k] = pin.log3(np.ascontiguousarray(E[:, :, k]))
    return out


def _to_axis(axis: Array) -> Array:
    """A rotation that turns z to the axis."""
    axis = axis / np.linalg.norm(axis)
    other = np.eye(3)[np.abs(axis).argmin()]
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(axis, x), axis))


def ranges(robot: Robot, margin: float = 0.0) -> tuple[Array, Array]:
    """Bounds of each joint for sampling; without limits a joint has a turn, and a slide twice the reach."""
    far = np.array([robot.reach if joint.kind == "prismatic" else np.pi for joint in robot.joints])
    lower = np.where(np.isfinite(robot.lower), robot.lower + margin, np.minimum(-far, robot.upper - 2.0 * far))
    upper = np.where(np.isfinite(robot.upper), robot.upper - margin, np.maximum(far, robot.lower + 2.0 * far))
    return lower, upper
