"""Additions to an impedance that keep a memory or bring in power: observer, compensation, forces, safety."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import Array, JointVector, TaskVector, Vector, vector_of
from eos_pin.control.compliant.forces import ForceGoal
from eos_pin.control.compliant.observer import MomentumObserver, Observed
from eos_pin.control.compliant.safety import Safety, pulled_back
from eos_pin.tasks.base import Task


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
    """

    task: Task
    safety: Safety
    observer: MomentumObserver | None
    wrench: Callable[[float], Any] | None
    compensate: bool
    goal: ForceGoal | None

    @cached_property
    def active(self) -> bool:
        """Whether there are any."""
        safety = self.safety
        return bool(
            self.observer or self.wrench or self.goal or safety.velocity_cutoff or safety.friction is not None
            or safety.limit_stiffness or safety.yielding
        )  # fmt: skip

    def start(self, t: float, q: JointVector, dq: JointVector) -> Sampled | None:
        """Memory at the start."""
        if not self.active:
            return None
        observed = None if self.observer is None else self.observer.start(t, q, dq)
        return Sampled(t, dq.copy(), observed, np.zeros(self.task.m), np.zeros(q.size))

    def advance(self, t: float, q: JointVector, dq: JointVector, A: Array, last: Sampled) -> Sampled:
        """Memory a period later.

        Args:
            t: Time [s].
            q: Joints.
            dq: Measured joint velocities.
            A: [G'; Wᵀ] at q.
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
        if self.goal is not None and (force := self.external_force(t, A, now)) is not None:
            # The robot exerts the opposite of the force that acts on it.
            integral = self.goal._integrated(integral, -force, past, self.task)
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

    def torques(self, t: float, q: JointVector, dq: JointVector, A: Array, sampled: Sampled) -> dict[str, JointVector]:
        """Torque of each addition, by name.

        Args:
            t: Time [s].
            q: Joints.
            dq: Joint velocities.
            A: [G'; Wᵀ] at q.
            sampled: Memory.
        """
        found, m = {}, self.task.m
        if self.safety.friction is not None:
            found["friction compensation"] = -self.safety.friction.torque(dq)
        if self.compensate and (force := self.external_force(t, A, sampled)) is not None:
            found["compensation of external forces"] = -force.dot(A[:m])
        if self.goal is not None:
            found["wanted forces"] = (self.goal._wanted(self.task) + sampled.integral).dot(A[:m])
        if self.safety.limit_stiffness:
            away = self.safety._limit_torque(self.task.robot, q)
            if away is not None and (Q := pulled_back(A, away)) is not None:
                found["joint limits"] = Q[m:].dot(A[m:])
        return found
