"""Additions to an impedance that keep a memory or bring in power: observer, compensation, forces, safety."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import Array, Jacobian, JointVector, TaskVector, Vector, vector_of
from eos_pin.control.compliant.forces import ForceGoal
from eos_pin.control.compliant.gains import Square
from eos_pin.control.compliant.law import ImpedanceLaw
from eos_pin.control.compliant.observer import MomentumObserver, Observed
from eos_pin.control.compliant.safety import Safety, pulled_back
from eos_pin.control.compliant.shaping import shaping_torque
from eos_pin.tasks.base import Point, Task


class Sampled(NamedTuple):
    """Memory of the additions from one period to the next.

    Attributes:
        t: Time [s].
        dq: Filtered joint velocities.
        observed: State of the observer; None without.
        integral: Integrals of force errors, (m,).
        added: Torque of all additions [N m or N].
        tau: Torque of the controller; None before the first step.
    """

    t: float
    dq: JointVector
    observed: Observed | None
    integral: TaskVector
    added: JointVector
    tau: JointVector | None = None


@dataclass(frozen=True, eq=False)
class Additions:
    """Additions to the law of a mode.

    Attributes:
        task: The task.
        safety: Filter, friction, limits.
        observer: Observer of external torques; None without.
        wrench: Function of time that returns the force of the environment on the task, (m,) [N, N m]; None without.
        compensate: Whether the external force on z is compensated.
        goal: Forces that are wanted; None without.
        inertia: Designed inertia of the task, (m, m); None for the robot's own.
    """

    task: Task
    safety: Safety
    observer: MomentumObserver | None
    wrench: Callable[[float], Any] | None
    compensate: bool
    goal: ForceGoal | None
    inertia: Square | None = None

    @cached_property
    def active(self) -> bool:
        """Whether there are any."""
        safety = self.safety
        parts = self.observer, self.wrench, self.goal, self.inertia, safety.friction, safety.velocity_cutoff
        return any(part is not None for part in parts) or bool(safety.limit_stiffness or safety.yielding)

    def start(self, t: float, q: JointVector, dq: JointVector) -> Sampled | None:
        """Memory at the start."""
        if not self.active:
            return None
        observed = None if self.observer is None else self.observer.start(t, q, dq)
        return Sampled(t, dq.copy(), observed, np.zeros(self.task.m), np.zeros(q.size))

    def advance(
        self, law: ImpedanceLaw, t: float, q: JointVector, dq: JointVector, J: Jacobian, last: Sampled
    ) -> Sampled:
        """Memory a period later.

        Args:
            law: Law of the mode.
            t: Time [s].
            q: Joints.
            dq: Measured joint velocities.
            J: Jacobian at q.
            last: Memory before.
        """
        past, observed, integral = t - last.t, last.observed, last.integral
        if not past > 0.0:
            return last
        if self.observer is not None:
            if observed is None or last.tau is None:
                observed = self.observer.start(t, q, dq)
            else:
                observed = self.observer.update(t, q, dq, observed, last.tau)
        now = last._replace(t=t, dq=self.safety._filtered(past, last.dq, dq), observed=observed)
        if self.goal is not None and (force := self.external_force(t, law.frame(J), now)) is not None:
            # The robot exerts the opposite of the force that acts on it.
            exerted = -force if (T := law.axes(t)) is None else -T.T @ force
            integral = self.goal._integrated(integral, exerted, past, self.task, law.force_rates)
        return now._replace(integral=integral)

    def velocity(self, t: float, dq: JointVector, sampled: Sampled) -> JointVector:
        """Joint velocities for the damping."""
        return self.safety._filtered(t - sampled.t, sampled.dq, dq) if t > sampled.t else sampled.dq

    def external_force(self, t: float, A: Array, sampled: Sampled) -> Vector | None:
        """Force of the environment on z, (m,) [N, N m], measured or else observed; None where it is not known."""
        if self.wrench is not None:
            return vector_of("the measured wrench", self.task.m, self.wrench, t)
        if sampled.observed is None or (Q := pulled_back(A, sampled.observed.external)) is None:
            return None
        return Q[: self.task.m]

    def torques(
        self, law: ImpedanceLaw, t: float, q: JointVector, dq: JointVector, J: Jacobian, sampled: Sampled
    ) -> dict[str, JointVector]:
        """Torque of each addition but the shaping of inertia, by name.

        Args:
            law: Law of the mode.
            t: Time [s].
            q: Joints.
            dq: Joint velocities.
            J: Jacobian at q.
            sampled: Memory.
        """
        found, m, A = {}, self.task.m, law.frame(J)
        if self.safety.friction is not None:
            found["friction compensation"] = -self.safety.friction.torque(dq)
        if self.compensate and (force := self.external_force(t, A, sampled)) is not None:
            found["compensation of external forces"] = -force.dot(A[:m])
        if self.goal is not None:
            wanted = self.goal._wanted(self.task) + sampled.integral
            found["wanted forces"] = (wanted if (T := law.axes(t)) is None else T @ wanted).dot(J)
        if self.safety.limit_stiffness:
            away = self.safety._limit_torque(self.task.robot, q)
            if away is not None and (Q := pulled_back(A, away)) is not None:
                found["joint limits"] = Q[m:].dot(A[m:])
        return found

    def shaping(
        self, law: ImpedanceLaw, t: float, q: JointVector, dq: JointVector, z: Point, J: Jacobian, tau: JointVector,
        sampled: Sampled,
    ) -> JointVector | None:  # fmt: skip
        """Torque that designs the inertia of the task, beside all other torque `tau`; None where it is the robot's."""
        if self.inertia is None:
            return None
        force = self.external_force(t, law.frame(J), sampled)
        if force is None:
            return None
        # A wrench that is measured acts on the task alone; what the observer finds may act anywhere.
        observed = None if self.wrench is not None or sampled.observed is None else sampled.observed.external
        external = J.T @ force if observed is None else observed
        dq = self.velocity(t, dq, sampled)
        return shaping_torque(law, self.inertia, t, q, dq, z, J, tau=tau, external=external, force=force)
