"""Objectives of the self-motion: laws for F_v, the self-motion part of F* in Eqs. (36), (39), (41), (45).

An objective never disturbs the task: whatever acceleration it asks of v, the chart's [G'; Wᵀ] keeps z on its own law.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable
from weakref import WeakSet

from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    Checked,
    Jacobian,
    JointVector,
    NonNegative,
    SelfMotionVector,
    TaskVector,
    VectorLike,
    broadcast,
    by_value,
    checked,
    frozen_copy,
    gains,
    unchecked,
    vector,
    vector_of,
)
from eos_pin._kernels.overrides import stands_for
from eos_pin.charts.chart import Chart
from eos_pin.control._sampled_law import SelfTargets, decay
from eos_pin.errors import InputError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Hold, Target, Trajectory


@runtime_checkable
class Renewed(Protocol):
    """Protocol of a controller that can renew the parts it has made of an objective."""

    def renew(self) -> None:
        """Make them anew at the next torque."""


class Further(NamedTuple):
    """State of a further task that the self-motion tracks.

    Attributes:
        task: The task.
        error: Its error, (m₂,) [m, rad].
        deficit: Acceleration that limits take from it, (m₂,) [m/s², rad/s²].
    """

    task: Task
    error: TaskVector
    deficit: TaskVector


class Objective(Checked, ABC):
    """A law for the self-motion.

    A law of one's own is a subclass that defines `acceleration`, see docs/extending.md and
    examples/09_own_objective.py; every other method has a default.
    """

    #: Whether F_v is the same beside any motion of the task: not in a class that defines `acceleration_beside`.
    independent: bool = True

    def __init_subclass__(cls, **rest: Any) -> None:
        stands_for(cls, "independent", "acceleration_beside", off=False)
        super().__init_subclass__(**rest)

    @abstractmethod
    @checked
    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        """Commanded self-motion acceleration F_v, (r,)."""

    @checked
    def acceleration_beside(
        self, t: float, q: JointVector, dq: JointVector, chart: Chart, J: Jacobian, task: TaskVector
    ) -> SelfMotionVector:
        """F_v where the task has the Jacobian J and is given the acceleration `task`, its drift left out, (m,).

        For laws that take account of how the task moves the robot; by default `acceleration`.
        """
        return self._acceleration(t, q, dq, chart)

    @checked
    def target(self, t: float, r: int) -> Target | None:
        """Self-motion (v, dv, ddv) that it tracks; None if it tracks none."""
        return None

    @checked
    def target_on(self, t: float, chart: Chart) -> Target | None:
        """The same on a chart, for laws that track joints."""
        return self._target(t, chart.r)

    @checked
    def held_law(self, r: int) -> tuple[SelfMotionVector, SelfMotionVector, SelfMotionVector] | None:
        """Gains kp and kd and constant v_d, (r,) each, where `acceleration` is kp (v_d − v) − kd dv; None elsewhere.

        Compiled control is made of them. A law whose values may change must then notify its users, see `add_user`.
        """
        return None

    @checked
    def joint_acceleration(self, t: float, q: JointVector, dq: JointVector, robot: Robot) -> JointVector | None:
        """Acceleration (n,) asked of all joints by a law that follows joints; None where none are followed.

        It leads on where the task alone no longer says how to move, at its singularities.
        """
        return None

    @checked
    def sampled_targets(self, t: float, period: float, step: float, r: int) -> SelfTargets:
        """Targets around time t, for a loop that commands motion; by default the law counts as an acceleration.

        Args:
            t: Time [s].
            period: Control period [s].
            step: Time of the path that goes by meanwhile [s].
            r: Degree of redundancy.
        """
        return SelfTargets(self, period)

    @checked
    def add_user(self, controller: Renewed) -> None:
        """Note a controller whose `renew()` is to be called when the values of `held_law` change."""

    @checked
    def check_start(self, t: float, q: JointVector, chart: Chart) -> None:
        """Refuse joints at the start, or a robot or task, that the law is not made for.

        Raises:
            PlanError: It follows joints that are far away, or those of another robot or task.
        """

    @checked
    def joint_distances(self, t: Float[Array, " T"], q: Float[Array, "T n"], robot: Robot) -> Float[Array, " T"] | None:
        """Largest difference of a joint from the joints that are followed, at each time; None where none are."""
        return None

    @checked
    def further(self, t: float, q: JointVector, change: JointVector) -> Further | None:
        """Further task that is tracked, where limits change the joint acceleration by `change`; None where none is."""
        return None

    @checked
    def check(self, n: int, r: int) -> None:
        """Refuse a robot or a task that it does not fit.

        Args:
            n: Number of joints.
            r: Degree of redundancy.

        Raises:
            InputError: It does not fit.
        """

    _acceleration = unchecked(acceleration)
    _acceleration_beside = unchecked(acceleration_beside)
    _joint_acceleration = unchecked(joint_acceleration)
    _target = unchecked(target)
    _target_on = unchecked(target_on)
    _held_law = unchecked(held_law)
    _sampled_targets = unchecked(sampled_targets)
    _add_user = unchecked(add_user)
    _further = unchecked(further)
    _check = unchecked(check)


class Track(Objective):
    """Track self-motion v_d(t) with exponentially decaying error; lower rows of Eqs. (36), (45).

    `reference`, `kp` and `kd` may be assigned at any time, and count from the next step on.

    Args:
        reference: v_d, as a trajectory or a constant; by default 0, the value of v at the start of a run.
        kp: Gain on v, one number or (r,) [1/s²].
        kd: Gain on dv, one number or (r,) [1/s]; 2 √kp is critically damped.
    """

    @checked
    def __init__(
        self,
        reference: Trajectory | VectorLike | None = None,
        *,
        kp: float | VectorLike = 100.0,
        kd: float | VectorLike = 20.0,
    ) -> None:
        #: Controllers that are notified of assignments, and make anew what they made of the old values.
        self.users: WeakSet[Any] = WeakSet()
        self._laws: dict[int, tuple[SelfMotionVector, SelfMotionVector, Trajectory]] = {}
        self._factors: tuple[Any, Any] = (None, None)
        self.reference: Trajectory | None
        self.reference, self.kp, self.kd = reference, kp, kd  # type: ignore[assignment]

    def __init_subclass__(cls, **rest: Any) -> None:
        # A law of one's own counts.
        stands_for(cls, "held_law", "acceleration", "acceleration_beside", off=Objective.held_law)
        stands_for(cls, "sampled_targets", "acceleration", "acceleration_beside", off=Objective.sampled_targets)
        super().__init_subclass__(**rest)

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "reference" and value is not None and not isinstance(value, Trajectory):
            value = Hold(vector(value, None, "v_d"))
        elif name in ("kp", "kd"):
            value = frozen_copy(gains(value, None, f"the self-motion gain {name}"))
        if name not in ("reference", "kp", "kd"):
            super().__setattr__(name, value)
            return
        before, made = getattr(self, name, None), self._laws
        super().__setattr__(name, value)
        super().__setattr__("_laws", {})
        try:
            # What does not fit where it is in use is refused here, not in the middle of a run.
            for r in made:
                self._law(r)
        except InputError:
            super().__setattr__(name, before)
            super().__setattr__("_laws", made)
            raise
        for user in self.users:
            user.renew()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "users": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, users=WeakSet())

    @checked
    def law(self, r: int) -> tuple[SelfMotionVector, SelfMotionVector, Trajectory]:
        """Gains kp and kd, (r,) each, and reference for r self-motion coordinates; checked once."""
        if r not in self._laws:
            reference = self.reference or Hold([0.0] * r)  # type: ignore[arg-type]
            vector(reference(0.0).z, r, "v_d")
            kp, kd = (
                frozen_copy(broadcast(k, r, f"the self-motion gain {name}"))
                for k, name in ((self.kp, "kp"), (self.kd, "kd"))
            )
            self._laws[r] = kp, kd, reference
        return self._laws[r]

    _law = unchecked(law)

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        kp, kd, reference = self._law(chart.r)
        if (held := reference.constant) is not None:
            # The everyday case, without terms that are zero.
            pull = kp * (held - chart._v(q))
            pull -= kd * chart._dv(dq)
            return pull
        v_d, dv_d, ddv_d = reference(t)
        return ddv_d + kd * (dv_d - chart._dv(dq)) + kp * (v_d - chart._v(q))

    def held_law(self, r: int) -> tuple[SelfMotionVector, SelfMotionVector, SelfMotionVector] | None:
        kp, kd, reference = self._law(r)
        return None if (held := reference.constant) is None else (kp, kd, held)

    def sampled_targets(self, t: float, period: float, step: float, r: int) -> SelfTargets:
        kp, kd, reference = self._law(r)
        made_of, factors = self._factors
        # The gains are others after every assignment.
        if made_of is None or made_of[0] is not kp or made_of[1] is not kd or made_of[2] != period:
            factors = decay(kp, kd, period)
            self._factors = (kp, kd, period), factors
        if (held := reference.constant) is not None:
            return SelfTargets(reference, period, held, held, held, factors)
        at, later = reference(t), reference(t + step)
        return SelfTargets(reference, period, at.z, later.z, at.z - step * at.dz, factors)

    def add_user(self, controller: Renewed) -> None:
        self.users.add(controller)

    def target(self, t: float, r: int) -> Target:
        return self._law(r)[2](t)

    def check(self, n: int, r: int) -> None:
        self._law(r)


@checked
@dataclass(frozen=True)
class Damp(Objective):
    """Bring the self-motion to rest wherever it is: F_v = −kd dv. With kd = 0, leave v alone (end of Sec. 6.2).

    Attributes:
        kd: Damping [1/s].
    """

    kd: NonNegative = 20.0

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        return -self.kd * chart._dv(dq)


def posture_value(law: Any, name: str, value: Any) -> Any:
    """Checked, read-only copy of a value assigned to q, kp or kd of a posture law; all else as it is."""
    if name == "q":
        return frozen_copy(vector(value, law.q.size if "q" in vars(law) else None, "the posture"))
    return frozen_copy(gains(value, law.q.size, "a posture gain")) if name in ("kp", "kd") else value


class Posture(Objective):
    """Draw the joints towards a posture, as far as the task allows: F_v = Wᵀ(kp (q_rest − q) − kd dq).

    Continuous joints go the shorter way round, see `Robot.way`. `q`, `kp` and `kd` may be assigned at any time.

    Args:
        q: Posture, (n,) [rad or m].
        kp: Gain, one number or (n,) [1/s²].
        kd: Damping, one number or (n,) [1/s].
    """

    @checked
    def __init__(self, q: VectorLike, *, kp: float | VectorLike = 100.0, kd: float | VectorLike = 20.0) -> None:
        self.q: JointVector
        self.q, self.kp, self.kd = q, kp, kd  # type: ignore[assignment]

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, posture_value(self, name, value))

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        if self.q.size != q.size:
            self._check(q.size, chart.r)
        return chart._dv(self.kp * chart.task.robot._way(q, self.q) - self.kd * dq)

    def check(self, n: int, r: int) -> None:
        if self.q.size != n:
            raise InputError(f"the posture has {self.q.size} joints, the robot {n}")


@by_value
@checked
@dataclass(frozen=True, eq=False)
class ReduceKineticEnergy(Objective):
    """Lower the kinetic energy T: F_v = −gain Vᵀ∇T; Eq. (39).

    Attributes:
        robot: Robot whose energy counts.
        gain: Factor of the gradient; the paper's is 1.
        gradient: `"velocity"` takes ∇T = ∂T/∂dq = M dq, which damps; `"configuration"` takes ∂T/∂q, the other reading
            of the paper, which does not damp.
    """

    robot: Robot
    gain: NonNegative = 1.0
    gradient: Literal["velocity", "configuration"] = "velocity"

    def __post_init__(self) -> None:
        self.robot.check_dynamics()

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        return -self.gain * chart._along(self.energy_gradient(q, dq))

    @checked
    def energy_gradient(self, q: JointVector, dq: JointVector) -> JointVector:
        """∇T, (n,)."""
        if self.gradient == "velocity":
            return self._unloaded._inverse_dynamics(q, 0.0 * dq, dq)  # M dq
        return self.robot._energy_slope(q, dq)

    @cached_property
    def _unloaded(self) -> Robot:
        """The robot without gravity, whose inverse dynamics at rest is a product with M."""
        return self.robot.with_gravity(0.0)


@by_value
@checked
@dataclass(frozen=True, eq=False)
class DescendPotential(Objective):
    """Descend a potential U_p of the joints: F_v = −gain Vᵀ∇U_p − kd dv; Eq. (41), where kd is 0.

    Attributes:
        gradient: ∇U_p as a function of q, (n,).
        gain: Factor of the gradient.
        kd: Damping of the self-motion [1/s].
    """

    gradient: Callable[[JointVector], JointVector]
    gain: NonNegative = 1.0
    kd: NonNegative = 0.0

    def acceleration(self, t: float, q: JointVector, dq: JointVector, chart: Chart) -> SelfMotionVector:
        slope = vector_of("gradient of a DescendPotential", q.size, self.gradient, q)
        return chart._along(-self.gain * slope) - self.kd * chart._dv(dq)
