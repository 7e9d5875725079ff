"""`Robot`: a checked rigid-body model and the dynamics Pinocchio computes for it.

This is the border to Pinocchio: what is returned is copied, never a live view into its workspace. Pinocchio
calls joint velocity `v`; here `v` is the paper's self-motion coordinate, so Pinocchio is called positionally.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    VectorLike,
    as_floats,
    checked,
    frozen_copy,
    number,
    unchecked,
    vector,
)
from eos_pin.errors import InputError, RobotError, refuse_unused
from eos_pin.robot._angles import Angles
from eos_pin.robot._data import workspace
from eos_pin.robot._one_degree import one_degree_model
from eos_pin.robot._parts import HasShapes, Joint, find_frame, listed, reach_of
from eos_pin.robot.postures import JointsLike, in_order

#: M(q) counts as singular below this reciprocal condition number: torques would have no meaning.
SINGULAR_MASS = 1e-12

#: The mass matrix of more joints than this would take seconds to check.
MOST_JOINTS = 2000


@checked
@dataclass(frozen=True, eq=False)
class Robot(Angles):
    """A serial robot: n one-degree-of-freedom joints, its inertia, and its shape.

    A robot without inertia has all of kinematics; its dynamics are refused where they are first used. One object is for
    one thread, with all that is made of it; another thread takes `copy.deepcopy(robot)`.

    Made by `eos_pin.load_robot`, by `from_pinocchio`, or directly from a `pin.Model` whose joints all have one degree
    of freedom; the model is copied, so the caller's stays as it is.

    Attributes:
        model: Pinocchio model; treat it as read-only.
        name: Name of the robot.
        source: Where it was loaded from, in a form `load_robot` takes; empty if built in memory.
        options: The arguments of `load_robot` beside `source`, so that a saved run can find its robot again.
        urdf_sha256: Hash of the URDF text; empty if built in memory.
        notes: Changes, missing parts and oddities found when it was loaded, in sentences for people.
        mimics: The joint that each joint should follow, by the name of the follower; only in a `CoupledRobot` it does.
        shapes: Its visual and collision geometry, read when first asked for; None without shapes.

    Raises:
        RobotError: No joints, a joint with other than one degree of freedom, or branches numbered in a mixed order;
            from every method of dynamics: M(q) is singular.
    """

    model: pin.Model
    name: str = ""
    source: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    urdf_sha256: str = ""
    notes: tuple[str, ...] = ()
    mimics: Mapping[str, str] = field(default_factory=dict)
    shapes: HasShapes | None = None
    #: Whether joints may follow others; see `CoupledRobot`.
    _may_follow: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", self.model.copy())
        object.__setattr__(self, "name", self.name or self.model.name)
        if self.n == 0:
            raise RobotError(f"robot {self.name!r} has no moving joints; eos_pin needs at least one")
        if self.n > MOST_JOINTS:
            raise RobotError(
                f"robot {self.name!r} has {self.n} joints; up to {MOST_JOINTS} are possible. Lock some, or load one "
                "chain"
            )
        for i, joint in enumerate(self.model.joints):
            if i and (joint.nq, joint.nv) != (1, 1) and not (self._may_follow and joint.nv == 0):
                advice = (
                    "lock it, or load the chain to one frame" if joint.nv else "make a CoupledRobot, where it follows"
                )
                raise RobotError(
                    f"joint {self.model.names[i]!r} ({joint.shortname()}) has nq = {joint.nq}, nv = {joint.nv}; "
                    f"eos_pin controls robots whose joints are all revolute, continuous or prismatic: {advice}"
                )
        self._check_order()

    @classmethod
    def from_pinocchio(cls, model: pin.Model, name: str = "") -> Robot:
        """Robot from a Pinocchio model, made by hand or read from another format, such as MJCF.

        Args:
            model: The model. Its continuous joints may have two coordinates; a planar joint becomes three joints.
            name: Name of the robot; by default that of the model.

        Raises:
            RobotError: A joint is of another kind, such as a floating base; or the reasons of the constructor.
            InputError: It is no model.
        """
        if not isinstance(model, pin.Model):
            raise InputError(f"a pinocchio.Model is needed, got {model!r}; load_robot takes files and names")
        return cls(one_degree_model(model), name=name)

    def _check_order(self) -> None:
        """Refuse branches whose joints are not numbered one branch after the other."""
        path = [0]
        for i, parent in list(enumerate(self.model.parents))[1:]:
            while path and path[-1] != parent:
                path.pop()
            if not path:
                raise RobotError(
                    f"joint {self.model.names[i]!r} of robot {self.name!r} belongs to a branch that was numbered "
                    "before another one: Pinocchio's mass matrix would be wrong. Add the joints of each "
                    "branch to the model before those of the next, as loading a URDF does"
                )
            path.append(i)

    # -- what the robot is ---------------------------------------------------------------------------------------

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The joints, in the order of q."""
        return tuple(
            Joint(
                name=self.joint_names[i],
                kind=self._kind(i),
                lower=float(self.lower[i]),
                upper=float(self.upper[i]),
                velocity=float(self.velocity[i]),
                effort=float(self.effort[i]),
            )
            for i in range(self.n)
        )

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of q."""
        return tuple(str(self.model.names[int(i)]) for i in self.coordinates.joints)

    def _kind(self, i: int) -> str:
        if self.coordinates.slides[self.coordinates.joints[i]]:
            return "prismatic"
        return "revolute" if np.isfinite(self.lower[i]) or np.isfinite(self.upper[i]) else "continuous"

    @cached_property
    def lower(self) -> JointVector:
        """Lower position limits [rad or m]; −inf where there is none."""
        return _limit(self.model.lowerPositionLimit, -np.inf)

    @cached_property
    def upper(self) -> JointVector:
        """Upper position limits [rad or m]; inf where there is none."""
        return _limit(self.model.upperPositionLimit, np.inf)

    @cached_property
    def velocity(self) -> JointVector:
        """Velocity limits [rad/s or m/s]; inf where the URDF states none or zero."""
        return _bound(self.model.velocityLimit)

    @cached_property
    def effort(self) -> JointVector:
        """Torque limits [N m or N]; inf where the URDF states none or zero."""
        return _bound(self.model.effortLimit)

    @cached_property
    def reach(self) -> float:
        """Length from joint to joint to the last frame [m], a bound of its distance from the base; 1 without extent."""
        return reach_of(self.model, str(self.options.get("chain_to", ""))) or 1.0

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames a task can use, from the base to the tip."""
        return tuple(dict.fromkeys(frame.name for frame in self.model.frames))

    @checked
    def posture(self, values: JointsLike, name: str = "q") -> JointVector:
        """Joints in the order of q, from all of them or some by name (`in_order`); others are as near 0 as they can."""
        if not isinstance(values, Mapping):
            return vector(values, self.n, name)
        return in_order(values, self.joint_names, np.clip(np.zeros(self.n), self.lower, self.upper), name)

    @checked
    def frame_id(self, name: str) -> int:
        """Index of the frame `name`.

        Raises:
            UnknownNameError: There is no such frame; Pinocchio itself would silently answer with the frame count.
        """
        return find_frame(self.model, name)

    @property
    def visual(self) -> pin.GeometryModel | None:
        """Visual geometry; the first access reads the meshes."""
        return self.shapes and self.shapes.visual

    @property
    def collision(self) -> pin.GeometryModel | None:
        """Collision geometry; the first access reads the meshes."""
        return self.shapes and self.shapes.collision

    # -- dynamics ------------------------------------------------------------------------------------------------

    @cached_property
    def _data(self) -> pin.Data:
        """Workspace for kinematics."""
        return workspace(self.model)

    @cached_property
    def _dynamics(self) -> pin.Data:
        """The same workspace for dynamics; its first use checks the inertia."""
        self.check_dynamics()
        return self._data

    def check_dynamics(self) -> None:
        """Refuse a robot whose equations of motion cannot be solved; every method of dynamics does so by itself.

        Raises:
            RobotError: M(q) is singular or not finite; names the joints, and the links without mass.
        """
        if self.lacks_dynamics:
            raise RobotError(self.lacks_dynamics)

    @cached_property
    def lacks_dynamics(self) -> str:
        """Reason why there are no dynamics; empty if M(q) can be inverted."""
        random = np.random.default_rng(0)
        lower, upper = np.maximum(self.lower, -np.pi), np.minimum(self.upper, np.pi)
        # Inertias that are not physical may show in some postures only; with hundreds of joints one takes long enough.
        others = [lower + (upper - lower) * random.random(self.n) for _ in range(4)] if self.n <= 100 else []
        postures = (np.clip(np.zeros(self.n), self.lower, self.upper), *others)
        return next((problem for q in postures if (problem := self._bad_inertia(q))), "")

    def _bad_inertia(self, q: JointVector) -> str:
        """Reason why the mass matrix cannot be inverted at q, with the joints that move no mass; empty if it can."""
        M = pin.crba(self.model, self._data, q, pin.Convention.WORLD)
        where = f"at q = {np.array2string(q, precision=3, threshold=20, max_line_width=1000)}"
        if not np.isfinite(M).all():
            return f"robot {self.name!r} has a mass matrix that is not finite {where}: check the <inertial> elements"
        weightless = [int(self.coordinates.joints[i]) for i in range(self.n) if not M[i, i] > 0.0]
        if weightless:
            beyond = {joint for i in weightless for joint in self.model.subtrees[i]}
            links = [
                frame.name
                for frame in self.model.frames
                if frame.type == pin.FrameType.BODY
                and frame.parentJoint in beyond
                and not self.model.inertias[frame.parentJoint].mass > 0.0
            ]
            advice = f"give mass and inertia to links {listed(links)}" if links else "check the <inertial> elements"
            return (
                f"robot {self.name!r} cannot be controlled by torque: joints "
                f"{listed([self.model.names[i] for i in weightless])} move no mass (M(q) is singular {where}). "
                f"For dynamics, {advice}, or lock these joints; kinematics needs none"
            )
        scale = 1.0 / np.sqrt(np.diag(M))
        eigenvalues = np.linalg.eigvalsh(M * scale * scale[:, None])
        if not eigenvalues[0] > SINGULAR_MASS * eigenvalues[-1]:
            return (
                f"robot {self.name!r} has a mass matrix that is not positive definite {where} (eigenvalues from "
                f"{eigenvalues[0]:.3g} to {eigenvalues[-1]:.3g} after scaling): check the <inertial> elements"
            )
        return ""

    @checked
    def mass(self, q: JointVector) -> Float[Array, "n n"]:
        """Mass matrix M(q), symmetric; Eq. (5)."""
        return pin.crba(self.model, self._dynamics, q, pin.Convention.WORLD)

    @checked
    def bias(self, q: JointVector, dq: JointVector) -> JointVector:
        """Coriolis, centrifugal and gravity torque C(q, dq) dq + g(q) = −R [N m or N]; R as in Eq. (24)."""
        return pin.nonLinearEffects(self.model, self._dynamics, q, dq)

    @checked
    def gravity(self, q: JointVector) -> JointVector:
        """Gravity torque g(q) = −Q^y [N m or N]; Eq. (5)."""
        return pin.computeGeneralizedGravity(self.model, self._dynamics, q)

    @checked
    def inverse_dynamics(self, q: JointVector, dq: JointVector, ddq: JointVector) -> JointVector:
        """Torque M ddq − R that causes the acceleration `ddq` [N m or N]; Eq. (24) without F^z."""
        return pin.rnea(self.model, self._dynamics, q, dq, ddq)

    @checked
    def forward_dynamics(self, q: JointVector, dq: JointVector, tau: JointVector) -> JointVector:
        """Acceleration M⁻¹ (R + tau) [rad/s² or m/s²]; Eq. (31). Add J.T @ F^z to `tau` for a force on the task."""
        return pin.aba(self.model, self._dynamics, q, dq, tau)

    @checked
    def kinetic_energy(self, q: JointVector, dq: JointVector) -> float:
        """Kinetic energy ½ dqᵀ M dq [J]."""
        return float(pin.computeKineticEnergy(self.model, self._dynamics, q, dq))

    @checked
    def potential_energy(self, q: JointVector) -> float:
        """Potential energy of gravity [J]."""
        return float(pin.computePotentialEnergy(self.model, self._dynamics, q))

    @checked
    def energy_slope(self, q: JointVector, dq: JointVector) -> JointVector:
        """Slope ∂T/∂q of the kinetic energy at constant dq [N m or N]."""
        # Ṁ = C + Cᵀ and C dq = Ṁ dq − ∂T/∂q leave Cᵀ dq.
        return pin.computeCoriolisMatrix(self.model, self._dynamics, q, dq).T @ dq

    @checked
    def placement(self, q: JointVector, frame: str) -> pin.SE3:
        """Pose of `frame` in the world."""
        i = self.frame_id(frame)
        pin.forwardKinematics(self.model, self._data, q)
        return pin.updateFramePlacement(self.model, self._data, i).copy()

    # -- the same without checks, for inner loops ----------------------------------------------------------------------

    _mass = unchecked(mass)
    _bias = unchecked(bias)
    _gravity = unchecked(gravity)
    _inverse_dynamics = unchecked(inverse_dynamics)
    _forward_dynamics = unchecked(forward_dynamics)
    _kinetic_energy = unchecked(kinetic_energy)
    _potential_energy = unchecked(potential_energy)
    _energy_slope = unchecked(energy_slope)

    # -- variations ----------------------------------------------------------------------------------------------

    @checked
    def with_gravity(self, gravity: VectorLike | float) -> Robot:
        """Copy in another gravity field.

        Args:
            gravity: Acceleration of gravity [m/s²], a vector, or one number g for (0, 0, −g); 0 for none.
        """
        if as_floats(gravity, "gravity").ndim == 0:
            gravity = [0.0, 0.0, -number(gravity, "gravity")]  # type: ignore[arg-type]
        model = self.model.copy()
        field = vector(gravity, 3, "gravity")
        model.gravity = pin.Motion(field, np.zeros(3))
        return replace(self, model=model, options={**self.options, "gravity": field.tolist()})

    @checked
    def perturbed(self, *, mass: float = 0.0, com: float = 0.0, inertia: float = 0.0, seed: int = 0) -> Robot:
        """Copy with a random model error, to be the plant of a controller whose model has no error.

        It has no `source`: no file describes it.

        Args:
            mass: Largest relative error of each link's mass, such as 0.2.
            com: Largest relative error of each coordinate of the centre of mass.
            inertia: Largest relative error of each principal moment, before the triangle inequality is restored.
            seed: Seed of the errors.
        """
        if not (mass or com or inertia):
            refuse_unused(self.perturbed, "no error is asked for; add mass, com or inertia", seed=seed)
        random, model = np.random.default_rng(seed), self.model.copy()
        for i in range(1, model.njoints):
            body = model.inertias[i]
            if body.mass <= 0.0:
                continue
            factor = 1.0 + mass * random.uniform(-1, 1)
            lever = body.lever * (1.0 + com * random.uniform(-1, 1, 3))
            # Second moments stay positive, so the result is the inertia of a real body.
            moments, axes = np.linalg.eigh(body.inertia)
            second = np.maximum(0.5 * moments.sum() - moments, 0.0) * (1.0 + inertia * random.uniform(-1, 1, 3))
            moments = second.sum() - second
            model.inertias[i] = pin.Inertia(body.mass * factor, lever, factor * (axes * moments) @ axes.T)
        return replace(self, model=model, name=f"{self.name} (perturbed)", source="", options={}, urdf_sha256="")

    def __getstate__(self) -> dict[str, Any]:
        # The workspace is made anew where the robot is unpickled.
        return {key: value for key, value in self.__dict__.items() if key not in ("_data", "_dynamics")}

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, n={self.n})"


def _limit(values: Array, absent: float) -> JointVector:
    """Position limits; Pinocchio marks an absent one by the largest float."""
    return frozen_copy(np.where(np.abs(values) >= 1e30, absent, values))


def _bound(values: Array) -> JointVector:
    """Limits of magnitude; a zero in a URDF means that none is given."""
    return frozen_copy(np.where((np.abs(values) >= 1e30) | (values <= 0.0), np.inf, values))
