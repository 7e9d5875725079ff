"""The impedance of one mode on one chart: its springs, dampers and feed-forward."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from eos_pin._arrays import (
    Array,
    Jacobian,
    JointVector,
    TaskVector,
    Vector,
    VectorLike,
    frozen_copy,
    vector,
    vectors_of,
)
from eos_pin._kernels import plain_springs
from eos_pin._kernels.dispatch import use_compiled
from eos_pin._kernels.plain_springs import shortened, turn_moment
from eos_pin.charts.chart import Chart
from eos_pin.control.compliant.gains import Square, damping_of
from eos_pin.control.compliant.springs import Clip, rotation_rows, tool_axes
from eos_pin.errors import InputError, SingularError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point
from eos_pin.trajectories.base import Target, Trajectory

Springs = use_compiled(plain_springs.Springs)

#: Margin of a chart below which the feed-forward is lessened; atlases leave charts before it by default.
EDGE = 0.4
#: Rate at which an error of a force is forgotten, as a part of the damping over the mass.
FORCE_RATE = 0.5

#: Joints at which the self-motion's spring is anchored: one posture, or joints with two derivatives over time.
Anchor: TypeAlias = "JointVector | Callable[[float], tuple[JointVector, JointVector, JointVector]]"
#: What a user gives for it: likewise, or the joints at hand.
PostureLike: TypeAlias = (
    "VectorLike | Callable[[float], tuple[JointVector, JointVector, JointVector]] | Literal['here'] | None"
)
HERE = "here"


def checked_posture(posture: Any, n: int) -> Any:
    """Anchor of the self-motion's spring; `HERE` or None where it is not known yet.

    Raises:
        InputError: It is none of what a `PostureLike` may be.
    """
    if posture is None or (isinstance(posture, str) and posture == HERE):
        return posture
    if isinstance(posture, str):
        raise InputError(f"the posture must be joints, a function of time, 'here' or None, got {posture!r}")
    if callable(posture):
        vectors_of("joints of the posture", 3, n, posture, 0.0)
        return posture
    return frozen_copy(vector(posture, n, "the posture"))


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of a mode; those of the task along the axes that `axes` names.

    Attributes:
        stiffness: K_z, (m, m).
        self_motion_stiffness: K_v, (r, r).
        damping: D_z, (m, m); None where the ratio gives it.
        self_motion_damping: D_v, (r, r); None where the ratio gives it.
        damping_ratio: Damping ratio.
        axes: `"world"`, or `"tool"` for those of the tool where it should be.
        clips: Errors at which the springs of lengths, of angles and of the self-motion stop growing; infinite for none.
        feedforward: Whether velocities and accelerations of moving targets are used.
        free: Rows of the task along which there is no spring; their damping is as if there were one.
    """

    stiffness: Square
    self_motion_stiffness: Square
    damping: Square | None = None
    self_motion_damping: Square | None = None
    damping_ratio: float = 0.7
    axes: str = "world"
    clips: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    feedforward: bool = True
    free: tuple[int, ...] = ()


class ImpedanceLaw:
    """Forces F on w = (z, v) for one set of gains on one chart; their torque is H⁻ᵀF = G'ᵀF_z + W F_v.

    On its chart and with targets at rest the force is −∂u/∂w − D dw with the energy u of `energy`. It needs no inverse
    of the Jacobian, so that it is defined at singularities as well.

    Args:
        chart: The chart.
        gains: The gains.
        reference: Trajectory of the task.
        anchor: Joints at which the spring of the self-motion is anchored.
        q: Joints at which the damping is designed.
        robot: The robot, with or without gravity.
    """

    def __init__(
        self, chart: Chart, gains: Gains, reference: Trajectory, anchor: Anchor, q: JointVector, robot: Robot
    ) -> None:
        task = chart.task
        self.chart, self.gains, self.reference, self.anchor = chart, gains, reference, anchor
        self._robot, self._weightless = robot, robot.with_gravity(0.0)
        self._way = task.robot._way if task.robot.turns else None
        self._minus = None if task.is_vector else task._minus
        n, m = chart.n, chart.m
        self.m, self._Wt = m, chart.Wt
        self._rotations = rotation_rows(task)
        self._z_d = reference.constant
        self._q_d = None if callable(anchor) else np.asarray(anchor)
        self._moving = self._z_d is None or self._q_d is None
        z_0 = reference(0.0).z if self._z_d is None else self._z_d
        self._T = tool_axes(task, self._rotations, z_0) if gains.axes == "tool" else None
        self._turning = self._T is not None and self._z_d is None
        # [G'; Wᵀ], where G' is filled in; the error; and their parts.
        self._A = np.vstack((task._linearize(q)[1], self._Wt))
        self._G, self._e = self._A[:m], np.zeros(n)
        self._e_z, self._e_v = self._e[:m], self._e[m:]
        self._local_K = np.zeros((n, n))
        self._local_K[:m, :m], self._local_K[m:, m:] = gains.stiffness, gains.self_motion_stiffness
        self.D = D = self._designed(self._along(self._local_K), q)
        self._local_D = self._along(D, back=True)
        #: Rates at which errors of wanted forces are forgotten, where none is given, (m,) [1/s].
        self.force_rates = self._force_rates(q) if gains.free else np.zeros(m)
        self._local_K[list(gains.free)], self._local_K[:, list(gains.free)] = 0.0, 0.0
        self.K = K = self._along(self._local_K)
        self._clips = self._bounds(n)
        #: Springs and dampers in one, where targets are at rest and no spring is bounded.
        self.at_rest: Any = None
        if self._q_d is not None and self._z_d is not None and not self._clips:
            turns = tuple(rows.start for rows, _ in self._rotations)
            self.at_rest = Springs(self._Wt, K, D, self._z_d, self._minus, turns)

    def _along(self, X: Square, back: bool = False) -> Square:
        """A matrix of components along the tool's axes, or `back` to them, for those along the world's."""
        if self._T is None:
            return X
        T, Y = np.eye(len(X)), self._T
        T[: self.m, : self.m] = Y.T if back else Y
        return T @ X @ T.T

    def _designed(self, K: Square, q: JointVector) -> Square:
        """Damping by the gains: as given, or by the ratio for the inertia at q."""
        gains, m = self.gains, self.m
        ratio, given_z, given_v = gains.damping_ratio, gains.damping, gains.self_motion_damping
        D = np.zeros_like(K)
        if given_z is None or given_v is None:
            M = self._mass(q)
            if given_z is None and given_v is None:
                return damping_of(M, K, ratio)
            if given_z is None:
                D[:m, :m] = damping_of(M[:m, :m], K[:m, :m], ratio)
            else:
                D[m:, m:] = damping_of(M[m:, m:], K[m:, m:], ratio)
        if given_z is not None:
            D[:m, :m] = self._along(np.pad(given_z, (0, len(K) - m)))[:m, :m]
        if given_v is not None:
            D[m:, m:] = given_v
        return D

    def _mass(self, q: JointVector) -> Square:
        """Mass matrix HᵀMH of w = (z, v), for G' at q as it is in [G'; Wᵀ]."""
        H = np.linalg.inv(self._A)
        M = H.T @ self._weightless._mass(q) @ H
        return 0.5 * (M + M.T)

    def _force_rates(self, q: JointVector) -> Vector:
        """A part of the damping over the mass along each axis of the gains, where others are free to give way."""
        mobility = self._along(np.linalg.inv(self._mass(q)), back=True)
        return FORCE_RATE * (np.diag(self._local_D) * np.diag(mobility))[: self.m]

    def _bounds(self, n: int) -> tuple[Clip, ...]:
        units, m = np.array(self.chart.task.units), self.m
        turns = units == "rad"
        found = []
        for rows, most in zip((~turns, turns, None), self.gains.clips, strict=True):
            where = slice(m, n) if rows is None else _one_slice(np.flatnonzero(rows))
            K = self._local_K[where, where]
            if np.isfinite(most) and K.any():
                # The stiffest direction stops growing at the error `most`, softer ones later.
                found.append(Clip(where, K, 0.5 * float(np.linalg.eigvalsh(K)[-1]) * most**2))
        return tuple(found)

    def frame(self, J: Jacobian) -> Array:
        """[G'; Wᵀ], in a workspace of the law.

        Args:
            J: Jacobian G'(q).
        """
        self._G[:] = J
        return self._A

    # -- the law -----------------------------------------------------------------------------------------------------

    def torque(self, t: float, q: JointVector, dq: JointVector, z: Point, J: Jacobian) -> JointVector:
        """Torque of springs, dampers and feed-forward, without that of gravity [N m or N].

        Args:
            t: Time [s].
            q: Joints.
            dq: Joint velocities, for the damping.
            z: Task point at q.
            J: Jacobian at q.
        """
        if self.at_rest is not None:
            q_d: JointVector = self._q_d  # type: ignore[assignment]
            away = q_d - q if self._way is None else self._way(q, q_d)
            return self.at_rest(dq, z, J, away)
        A = self._A
        self._G[:] = J
        if self._moving:
            return self._following(t, q, dq, z)
        F = self._spring(q, z, self._z_d, self._q_d)  # type: ignore[arg-type]
        F -= self.D.dot(A.dot(dq))
        return F.dot(A)

    def pull(self, t: float, q: JointVector, z: Point, J: Jacobian) -> JointVector:
        """Torque of the springs alone [N m or N]."""
        self._G[:] = J
        return self._spring(q, z, *self._targets(t)).dot(self._A)

    def designed(
        self, t: float, q: JointVector, z: Point, inertia: Square
    ) -> tuple[TaskVector, Square, Square, Target]:
        """Force of the task's springs, a designed inertia and its damping along the world's axes, and the target."""
        m, target = self.m, self.reference(t)
        spring = self._spring(q, z, *self._targets(t))[:m].copy()
        M = self._along(np.pad(inertia, (0, len(self.K) - m)))[:m, :m]
        given = self.gains.damping
        D = damping_of(M, self.K[:m, :m], self.gains.damping_ratio) if given is None else self.D[:m, :m]
        return spring, M, D, target

    def power(self, dq: JointVector, J: Jacobian) -> float:
        """Power that the dampers take of motion at these joint velocities [W]."""
        self._G[:] = J
        dw = self._A.dot(dq)
        return float(dw.dot(self.D.dot(dw)))

    def energy(self, t: float, q: JointVector, z: Point) -> float:
        """Energy u of the springs [J]."""
        z_d, q_d = self._targets(t)
        self._error(q, z, z_d, q_d)
        for rows, _ in self._rotations:
            shortened(self._e, rows)
        clipped = sum(clip.saved(self._clip_error()) for clip in self._clips)
        return 0.5 * float(self._e.dot(self.K.dot(self._e))) - clipped

    def _targets(self, t: float) -> tuple[Point, JointVector]:
        z_d = self.reference(t).z if self._z_d is None else self._z_d
        q_d = self.anchor(t)[0] if callable(self.anchor) else self.anchor
        if self._turning:
            self._turn(z_d)
        return z_d, q_d

    def axes(self, t: float) -> Square | None:
        """Matrix (m, m) that turns components along the axes of the gains into those of the world; None for these."""
        if self._turning:
            self._turn(self.reference(t).z)
        return self._T

    def _turn(self, z_d: Point) -> None:
        """Turn the gains with the tool's target."""
        self._T = tool_axes(self.chart.task, self._rotations, z_d)
        self.K, self.D = self._along(self._local_K), self._along(self._local_D)

    def _error(self, q: JointVector, z: Point, z_d: Point, q_d: JointVector) -> None:
        if self._minus is None:
            np.subtract(z_d, z, self._e_z)
        else:
            self._e_z[:] = self._minus(z_d, z)
        self._Wt.dot(q_d - q if self._way is None else self._way(q, q_d), self._e_v)

    def _spring(self, q: JointVector, z: Point, z_d: Point, q_d: JointVector) -> Vector:
        """Force −∂u/∂w."""
        e = self._e
        self._error(q, z, z_d, q_d)
        turned = [(rows, *shortened(e, rows)) for rows, _ in self._rotations]
        F = self.K.dot(e)
        if self._clips:
            local = self._clip_error()
            for clip in self._clips:
                F[clip.rows] *= clip.factor(local)
        for rows, eta, two_epsilon in turned:
            turn_moment(F, rows, eta, two_epsilon)
        return F

    def _clip_error(self) -> Vector:
        """The error along the axes of the gains."""
        if self._T is None:
            return self._e
        local = self._e.copy()
        local[: self.m] = self._T.T.dot(self._e_z)
        return local

    def _following(self, t: float, q: JointVector, dq: JointVector, z: Point) -> JointVector:
        """The torque where a target moves: M q̈_r + C(q, q̇) q̇_r + springs + dampers, with q̇_r = H ẇ_d.

        So the error obeys M_w ë + C_w ė + D ė + K e = −Hᵀτ_ext (PD+, Paden and Panja, Int. J. Control 47(6), 1988), and
        the law is continuous where the target comes to rest.
        """
        target = self.reference(t)
        q_d, dq_d, ddq_d = self.anchor(t) if callable(self.anchor) else (self.anchor, None, None)
        if self._turning:
            self._turn(target.z)
        F = self._spring(q, z, target.z, q_d)
        if not self.gains.feedforward:
            F -= self.D.dot(self._A.dot(dq))
            return F.dot(self._A)
        dw, ddw = np.zeros(q.size), np.zeros(q.size)
        dw[: self.m], ddw[: self.m] = target.dz, target.ddz
        if dq_d is not None and ddq_d is not None:
            dw[self.m :], ddw[self.m :] = self._Wt.dot(dq_d), self._Wt.dot(ddq_d)
        F -= self.D.dot(self._A.dot(dq) - dw)
        tau = F.dot(self._A)
        if not (dw.any() or ddw.any()):
            return tau
        part = self._inside()
        if not part:
            return tau
        A = self._A.copy()
        dq_r = np.linalg.solve(A, dw)
        ddw[: self.m] -= self._drift(q, dq, dq_r)
        ddq_r = np.linalg.solve(A, ddw)
        # C(q, a) b is symmetric in a and b, so it is the difference of two squares; likewise below.
        half, rest = 0.5 * (dq + dq_r), 0.5 * (dq - dq_r)
        forward = self._weightless._inverse_dynamics(q, half, ddq_r) - self._weightless._bias(q, rest)
        tau += part * forward
        return tau

    def _inside(self) -> float:
        """Part of the feed-forward that acts: all of it well within the chart, none at its edge.

        A law that fades out may be carried to the edge of its chart, where H grows without bound.
        """
        try:
            margin = self.chart._margin(self._G, enough=EDGE)
        except SingularError:
            return 0.0
        # H grows with 1/margin, and accelerations with its square.
        return min(max(margin / EDGE, 0.0), 1.0) ** 2

    def _drift(self, q: JointVector, dq: JointVector, other: JointVector) -> TaskVector:
        """Ġ'(q, dq) times other joint velocities, (m,)."""
        task = self.chart.task
        found = task._at(q, 0.5 * (dq + other)).drift - task._at(q, 0.5 * (dq - other)).drift
        # Angular velocities are no derivatives of coordinates: their second derivatives lack symmetry by ω × ω'.
        for rows, _ in self._rotations:
            found[rows] += 0.5 * np.cross(self._A[rows].dot(dq), self._A[rows].dot(other))
        return found


def _one_slice(rows: Array) -> slice:
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows.size else slice(0, 0)
