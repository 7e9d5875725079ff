"""`ImpedanceController`: springs and dampers of the task, and others of the self-motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from eos_pin._arrays import Jacobian, JointVector, VectorLike, checked, number, of_type
from eos_pin.charts.atlas import Atlas
from eos_pin.charts.chart import Chart
from eos_pin.control.base import Controller
from eos_pin.control.compliant.additions import Additions
from eos_pin.control.compliant.energy import Energies, energies_of
from eos_pin.control.compliant.forces import ForceGoal
from eos_pin.control.compliant.gains import GainLike, clips_of, gain_matrix, plain, ratio
from eos_pin.control.compliant.law import HERE, Gains, ImpedanceLaw, PostureLike, checked_posture
from eos_pin.control.compliant.memory import FILLING, ImpedanceState
from eos_pin.control.compliant.observer import MomentumObserver
from eos_pin.control.compliant.safety import Safety, pulled_back, yielded
from eos_pin.control.compliant.springs import check_tool_axes, rotation_rows
from eos_pin.errors import InputError, SingularError
from eos_pin.robot.model import Robot
from eos_pin.tasks.base import Point, Task
from eos_pin.trajectories.base import Hold, Target, Trajectory, check_reference

#: Stiffness where none is given: of lengths [N/m] and angles [N m/rad], and of the self-motion [N m/rad or N/m].
STIFFNESS, SELF_MOTION_STIFFNESS = {"m": 1000.0, "rad": 50.0}, 20.0
#: Damping of a part that is led by hand: of lengths [N s/m] and angles [N m s/rad], and of the self-motion [N m s/rad].
LED, LED_SELF_MOTION = {"m": 20.0, "rad": 1.0}, 2.0
#: So many laws fade into each other before another chart has to wait.
MOST_LAWS = 4
#: Motion of the joints after which the margin of the chart is looked at again [rad or m].
LOOK = 0.05


class ImpedanceController(Controller):
    """Impedance in (z, v): a spring and a damper for the task, and others for the self-motion.

    tau = g(q) + G'ᵀ(K_z e_z − D_z dz) + W(K_v e_v − D_v dv) with e_v = Wᵀ(q_d − q), for targets at rest: the forces on
    w = (z, v) pulled back to the joints by H⁻ᵀ = [G'ᵀ, W]. The robot keeps its own inertia. Both springs come to
    rest together, as z and v are coordinates: the posture needs not fit the task's target. A force on the robot is
    answered by each for itself, K_z e_z = −(Hᵀτ_ext)_z and K_v e_v = −(Hᵀτ_ext)_v at rest.

    With targets at rest the law is passive, and so are changes of charts and modes: the new law fades in while the old
    one fades out, and energy that this needs comes from a tank that damping fills; where the tank is empty the change
    waits. Moving targets bring in power; `energies` has it. See docs/impedance.md.

    A controller is never changed. `with_mode` makes another, and `loop.controller = …` goes over without a jump.

    Args:
        task: The task: of numbers, angles and rotations.
        reference: Trajectory of the task; `"here"` for the point where the controller begins.
        stiffness: K_z, one for each coordinate [N/m, N m/rad], by unit or label such as `{"m": 800, "rad": 40}`, or a
            symmetric (m, m) matrix.
        self_motion_stiffness: K_v, one number, (r,) or (r, r) [N m/rad; N/m for sliding joints].
        damping_ratio: Damping ratio of all modes whose damping is not given.
        damping: D_z, in the forms of the stiffness [N s/m, N m s/rad].
        self_motion_damping: D_v, one number, (r,) or (r, r) [N m s/rad].
        posture: Joints q_d at which the spring of the self-motion is anchored, (n,), or a function of time that
            returns them with two derivatives, such as a plan; `"here"` for those where the controller begins, None for
            those where the run began.
        axes: Axes of stiffness and damping of the task: `"world"`, or `"tool"` for those of the tool's target.
        feedforward: Whether velocities and accelerations of moving targets are used.
        largest_error: Errors at which springs stop growing, by `"m"`, `"rad"` and `"v"`; by default they do not. The
            stiffest direction stops at that error, others where they have the same energy.
        blend: Time in which one chart or mode goes over to the next [s].
        tank: Energy in the tank at the start, and the most that it holds [J].
        safety: Filter of velocities, friction, joint limits, torque limits; by default none.
        observer: Rate of a momentum observer of external torques [1/s]; None without. It needs a sampled loop.
        wrench: Measured force of the environment on the task, as a function of time, (m,) [N, N m]; it is used in the
            place of the observer.
        inertia: M_d of the task, in the forms of the stiffness, to be felt in the place of the robot's own [kg, kg m²].
            It needs the external force; damping by a ratio is then for it.
        compensate_external: Whether the external force on z is compensated, so that pushes leave the task where it is.
        force: Forces wanted along some coordinates of the task.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.

    Raises:
        InputError: A gain is negative, not symmetric, of another size or in one number for metres and radians; the
            damping ratio is none; the axes are unknown, or the tool's where the task has no orientation; the reference
            or the posture does not fit.
        RobotError: The robot lacks mass.
    """

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory | str,
        *,
        stiffness: GainLike | None = None,
        self_motion_stiffness: float | VectorLike = SELF_MOTION_STIFFNESS,
        damping_ratio: float = 0.7,
        damping: GainLike | None = None,
        self_motion_damping: float | VectorLike | None = None,
        posture: PostureLike = None,
        axes: Literal["world", "tool"] = "world",
        feedforward: bool = True,
        largest_error: dict[str, float] | None = None,
        blend: float = 0.2,
        tank: float = 2.0,
        safety: Safety | None = None,
        observer: float | None = None,
        wrench: Callable[[float], Any] | None = None,
        inertia: GainLike | None = None,
        compensate_external: bool = False,
        force: ForceGoal | None = None,
        atlas: Atlas | None = None,
    ) -> None:
        self._settings = {key: value for key, value in locals().items() if key not in ("self", "task", "__class__")}
        task.robot.check_dynamics()
        self.task: Task = task
        self.robot: Robot = task.robot
        if atlas is not None and atlas.task is not task:
            raise InputError("the atlas must be made of the controller's own task object: atlas=Atlas(task)")
        self.atlas = atlas or Atlas(task)
        if isinstance(reference, str) and reference != HERE:
            raise InputError(f"the reference must be a trajectory or 'here', got {reference!r}")
        #: None where it is the point where the controller begins.
        self.reference: Trajectory | None = None
        if not isinstance(reference, str):
            check_reference(task, reference)
            self.reference = reference
        self.posture = checked_posture(posture, task.robot.n)
        rotations = rotation_rows(task)
        if axes == "tool":
            check_tool_axes(task, rotations)
        if force is not None:
            force._check(task)
        labels, units = task.labels, task.units
        r = task.robot.n - task.m
        own, one = [f"v{k + 1}" for k in range(r)], ["rad"] * r
        if stiffness is None:
            stiffness = [STIFFNESS.get(unit, STIFFNESS["rad"]) for unit in units]
        self.gains = Gains(
            stiffness=gain_matrix(stiffness, labels, units, "the stiffness"),
            self_motion_stiffness=gain_matrix(self_motion_stiffness, own, one, "the self-motion stiffness"),
            damping=None if damping is None else gain_matrix(damping, labels, units, "the damping"),
            self_motion_damping=None
            if self_motion_damping is None
            else gain_matrix(self_motion_damping, own, one, "the self-motion damping"),
            damping_ratio=ratio(damping_ratio, "the damping ratio"),
            axes=axes,
            clips=clips_of(largest_error),
            feedforward=feedforward,
            free=() if force is None else tuple(force._rows(task)),
        )
        shaped = None if inertia is None else gain_matrix(inertia, labels, units, "the inertia", definite=True)
        if shaped is not None and (compensate_external or force is not None):
            raise InputError(
                "a designed inertia answers to the external force, which compensate_external takes away and a "
                "ForceGoal sets: give one of the three"
            )
        if (compensate_external or force is not None or shaped is not None) and observer is None and wrench is None:
            raise InputError("external forces must be known: give observer=50.0 or a measured wrench")
        self.additions = Additions(
            task=task,
            safety=safety or Safety(),
            observer=None if observer is None else MomentumObserver(task.robot, observer),
            wrench=wrench,
            compensate=compensate_external,
            goal=force,
            inertia=shaped,
        )
        self.blend = number(blend, "the time of a blend", above=0.0)
        self.tank = number(tank, "the energy of the tank", at_least=0.0)

    def __setattr__(self, name: str, value: Any) -> None:
        if "tank" in vars(self) and not name.startswith("_"):
            raise InputError(
                f"the {name} of an ImpedanceController cannot be changed. Make another one, and let the running loop "
                "take it over: loop.controller = loop.controller.with_mode(…)"
            )
        super().__setattr__(name, value)

    # -- modes -------------------------------------------------------------------------------------------------------

    @checked
    def with_mode(self, **changes: Any) -> ImpedanceController:
        """The same controller with other settings, to be assigned to `loop.controller`.

        Args:
            changes: Arguments of the constructor, such as `stiffness`, `posture="here"`.

        Raises:
            InputError: A setting is unknown or does not fit.
        """
        unknown = sorted(changes.keys() - self._settings.keys())
        if unknown:
            raise InputError(f"a mode has no {', '.join(unknown)}; it has {', '.join(self._settings)}")
        return type(self)(self.task, **{**self._settings, **changes})

    @checked
    def led(self, part: str, damping: GainLike | None = None) -> ImpedanceController:
        """Mode in which a person leads a part of the robot by hand: no stiffness there, and little damping.

        Args:
            part: `"elbow"`: the self-motion, while the task is held; or `"tool"`: the task, while v is held.
            damping: Damping of that part, in the forms of the constructor.

        Raises:
            InputError: No such part, or the damping does not fit.
        """
        if part == "elbow":
            damping = LED_SELF_MOTION if damping is None else damping
            return self.with_mode(self_motion_stiffness=0.0, self_motion_damping=damping, posture=HERE)
        if part != "tool":
            raise InputError(f"'elbow' or 'tool' is led, got {part!r}")
        if damping is None:
            damping = [LED.get(unit, LED["rad"]) for unit in self.task.units]
        return self.with_mode(stiffness=[0.0] * self.task.m, damping=damping, reference=HERE, axes="world")

    # -- the contract of controllers ---------------------------------------------------------------------------------

    def start(self, t: float, q: JointVector, dq: JointVector) -> ImpedanceState:
        chart = self.atlas.start(q)
        anchor = q.copy() if self.posture is None else self.posture
        sampled = self.additions.start(t, q, dq)
        return ImpedanceState((self._law(chart, q, anchor),), (1.0,), t, self.tank, 0, q.copy(), sampled)

    def take_over(self, t: float, q: JointVector, dq: JointVector, state: Any) -> ImpedanceState:
        """Memory in which this mode fades in; from another controller, or another task, that at the start of a run."""
        if not isinstance(state, ImpedanceState) or (
            state.chart.task is not self.task
            and (state.chart.task.robot, state.chart.task.describe()) != (self.robot, self.task.describe())
        ):
            return self._start(t, q, dq)
        # Weights move on before another law comes in, and what that needs is paid.
        state = self._paid(t, q, dq, state, *self.task._linearize(q))
        anchor = state.laws[-1].anchor if self.posture is None else self.posture
        before, sampled = state.sampled, self.additions.start(t, q, dq)
        if before is not None and sampled is not None:
            sampled = sampled._replace(dq=before.dq, observed=before.observed or sampled.observed, tau=before.tau)
        carried = state.left(t, self.blend) if before is None else before.added
        following = self._followed(t, state, self._law(state.chart, q, anchor))
        return following._replace(sampled=sampled, carried=carried, since=t)

    def _law(self, chart: Chart, q: JointVector, anchor: Any) -> ImpedanceLaw:
        reference = self.reference or Hold(self.task._value(q), self.task.m)
        anchor = q.copy() if isinstance(anchor, str) else anchor
        return ImpedanceLaw(chart, self.gains, reference, anchor, q, self.robot)

    def _followed(self, t: float, state: ImpedanceState, law: ImpedanceLaw) -> ImpedanceState:
        """The state in which a law begins to fade in."""
        pairs = [pair for pair in zip(state.weights_at(t, self.blend), state.laws, strict=True) if pair[0]]
        weights, laws = zip(*pairs, (0.0, law), strict=True)
        return state._replace(laws=laws, weights=weights, t=t, tank=min(state.tank, self.tank))

    def torque(self, t: float, q: JointVector, dq: JointVector, state: ImpedanceState) -> JointVector:
        return self._torques(t, q, dq, state, *self.task._linearize(q))[0]

    def _torques(
        self, t: float, q: JointVector, dq: JointVector, state: ImpedanceState, z: Point, J: Jacobian
    ) -> tuple[JointVector, JointVector | None]:
        """Torque, and that of all additions in it; None without any."""
        sampled, weights = state.sampled, state.weights_at(t, self.blend)
        gravity = self.robot._gravity(q)
        tau, seen = gravity.copy(), dq if sampled is None else self.additions.velocity(t, dq, sampled)
        for weight, law in zip(weights, state.laws, strict=True):
            if weight:
                tau += weight * law.torque(t, q, seen, z, J)
        if sampled is None and state.carried is None:
            return tau, None
        law, added = state.laws[-1], np.zeros(q.size)
        if sampled is not None:
            part = state.part(t, self.blend)
            added += part * sum(self.additions.torques(law, t, q, dq, J, sampled).values())
            shaping = self.additions.shaping(law, t, q, dq, z, J, tau + added, sampled)
            if shaping is not None:
                added += part * shaping
        if (left := state.left(t, self.blend)) is not None:
            added += left
        tau += added
        if self.additions.safety.yielding and (np.abs(tau) > self.robot.effort).any():
            A, m = law.frame(J), self.task.m
            Q = pulled_back(A, tau - gravity)
            tau = tau if Q is None else yielded(tau, Q[m:].dot(A[m:]), self.robot.effort)
        return tau, added

    def step(
        self, t: float, q: JointVector, dq: JointVector, state: ImpedanceState
    ) -> tuple[JointVector, ImpedanceState]:
        z, J = self.task._linearize(q)
        if len(state.laws) > 1 or state.tank < self.tank:
            state = self._paid(t, q, dq, state, z, J)
        far = q - state.checked
        if far.dot(far) > LOOK * LOOK:
            state = state._replace(checked=q.copy())
            if self._validity(t, q, dq, state) <= 0.0:
                state = self._update(t, q, dq, state)
        sampled = state.sampled
        if state.carried is not None and state.part(t, self.blend) >= 1.0:
            state = state._replace(carried=None)
        if sampled is None and state.carried is None and len(state.laws) == 1 and state.tank >= self.tank:
            tau = state.laws[0].torque(t, q, dq, z, J)
            tau += self.robot._gravity(q)
            return tau, state
        if sampled is None:
            return self._torques(t, q, dq, state, z, J)[0], state
        sampled = self.additions.advance(state.laws[-1], t, q, dq, J, sampled)
        state = state._replace(sampled=sampled)
        tau, added = self._torques(t, q, dq, state, z, J)
        assert added is not None
        return tau, state._replace(sampled=sampled._replace(added=added, tau=tau))

    def _paid(
        self, t: float, q: JointVector, dq: JointVector, state: ImpedanceState, z: Point, J: Jacobian
    ) -> ImpedanceState:
        """The state with weights and tank at time t."""
        if not t > state.t:
            return state
        taken = sum(w * law.power(dq, J) for w, law in zip(state.weights, state.laws, strict=True))
        state = state._replace(tank=state.tank + FILLING * (t - state.t) * taken)
        return state.paid(t, q, z, self.blend, self.tank)

    def validity(self, t: float, q: JointVector, dq: JointVector, state: ImpedanceState) -> float:
        _, J = self.task._linearize(q)
        chart, threshold = state.chart, self.atlas.threshold
        try:
            margin = chart._margin(J, enough=threshold) - threshold
        except SingularError:
            # No chart can be made here; the law needs none until the task has full rank again.
            return 1.0
        return min(margin, chart._room(q))

    def update(self, t: float, q: JointVector, dq: JointVector, state: ImpedanceState) -> ImpedanceState:
        if len(state.laws) >= MOST_LAWS and state.weights_at(t, self.blend)[-1] < 1.0:
            # The law needs no inverse of [G'; Wᵀ], so a worn chart serves until the last changes are through.
            return state
        q = state.chart._unwrap(q)
        try:
            chart = self.atlas.next(state.chart, q)
        except SingularError:
            return state
        last = state.laws[-1]
        law = ImpedanceLaw(chart, last.gains, last.reference, last.anchor, q, self.robot)
        following = self._followed(t, state, law)._replace(number=state.number + 1, checked=q.copy())
        # On another chart external forces have other parts on z.
        return following if state.sampled is None else following._replace(carried=state.sampled.added, since=t)

    def chart(self, state: ImpedanceState) -> Chart:
        return state.chart

    def self_motion_target(self, t: float, state: ImpedanceState) -> Target | None:
        """Self-motion that the spring is anchored at."""
        chart, anchor = state.chart, state.laws[-1].anchor
        rest = np.zeros(chart.r)
        if not callable(anchor):
            return Target(chart._v(anchor), rest, rest)
        q, dq, ddq = anchor(t)
        return Target(chart._v(q), chart._dv(dq), chart._dv(ddq))

    # -- energy ------------------------------------------------------------------------------------------------------

    @checked
    def energies(self, t: float, q: JointVector, dq: JointVector, state: Any) -> Energies:
        """Energies in a state, and the power that the law brings in there.

        Args:
            t: Time [s].
            q: Joints.
            dq: Joint velocities.
            state: Memory.
        """
        of_type(state, "the memory of an ImpedanceController", ImpedanceState)
        return energies_of(self.additions, self.blend, t, q, dq, state)

    def describe(self) -> dict[str, Any]:
        gains = self.gains
        return super().describe() | {
            "stiffness": plain(gains.stiffness),
            "self_motion_stiffness": plain(gains.self_motion_stiffness),
            "damping": None if gains.damping is None else plain(gains.damping),
            "self_motion_damping": None if gains.self_motion_damping is None else plain(gains.self_motion_damping),
            "damping_ratio": gains.damping_ratio,
            "axes": gains.axes,
            "blend": self.blend,
            "tank": self.tank,
            "observer": None if self.additions.observer is None else self.additions.observer.rate,
            "inertia": None if self.additions.inertia is None else plain(self.additions.inertia),
            "compensate_external": self.additions.compensate,
            "force": None if self.additions.goal is None else dict(self.additions.goal.forces),
            "robot": self.robot.name,
            "reference": HERE if self.reference is None else type(self.reference).__name__,
            **self.atlas.describe(),
        }
