"""The time of a plan: whether velocities, accelerations and torques are within limits, and the fastest time that is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from eos_pin._arrays import Array, Vector, VectorLike, checked
from eos_pin.errors import InputError, MissingDependencyError, PlanError
from eos_pin.planning.limit_use import LimitUse, MotionLimits, limit_use, motion_of, torques_of
from eos_pin.planning.plans import Plan
from eos_pin.trajectories.timed import Pace, TimedPath

#: Pieces of the path for the fastest time, for each knot, the fewest and the most.
PIECES, FEW, MANY = 4, 400, 2000
#: How often a plan is slowed down at most.
MOST_LOOKS = 5
#: Stands for a limit that there is none of.
FAR = 1e6
#: Nodes and weights of the integral of time over a piece of the path.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def check_limits(plan: Plan, limits: MotionLimits) -> LimitUse:
    """Parts of the limits that a plan uses.

    Raises:
        PlanError: A limit is exceeded; the message names it, the excess and the place.
    """
    use = limit_use(plan, limits)
    if not use.kept:
        error = PlanError(
            f"the pace of the plan is too fast: {use.message}. Give it more time, or let `fastest` (--timing fastest) "
            "choose it",
            None,
            1.0,
        )
        error.info = {"limit_use": use.as_dict()}
        raise error
    return use


def measured(plan: Plan, limits: MotionLimits | None = None) -> Plan:
    """The plan with the parts of limits that it uses, and its duration, in its `info`."""
    use = limit_use(plan, limits)
    parts = {
        f"{what}_part_max": None if one is None else one.ratio
        for what, one in (("velocity", use.velocity), ("acceleration", use.acceleration), ("torque", use.torque))
    }
    info = {**plan.info, "duration": plan.end - plan.start, **parts, "limit_use": use.as_dict()}
    return replace(plan, info=info)


def in_time(
    plan: Plan, timed: bool, acceleration: float | VectorLike | None, torque: float | VectorLike | bool
) -> Plan:
    """The plan within limits of acceleration and torque, or a refusal; slowed down where its pace was not given.

    Args:
        plan: The plan.
        timed: Whether its pace was given.
        acceleration: Largest accelerations, as in `MotionLimits.of`.
        torque: Largest torques, as in `MotionLimits.of`.

    Raises:
        PlanError: A limit is exceeded at the given pace, or at any pace.
    """
    if acceleration is None and torque is False:
        return plan
    limits = MotionLimits.of(plan.robot, velocity=np.inf, acceleration=acceleration, torque=torque)
    if timed:
        check_limits(plan, limits)
    else:
        plan = slowed(plan, limits)
    return measured(plan, replace(limits, velocity=plan.robot.velocity))


def slowed(plan: Plan, limits: MotionLimits) -> Plan:
    """The plan with its pace slowed down evenly until all limits are kept; as it is where they are.

    Raises:
        PlanError: Gravity alone needs more torque than there is.
    """
    # Where it was slowed down it is looked at in other places, too.
    for _ in range(MOST_LOOKS):
        factor = _slowness(plan, limits)
        if factor <= 1.0:
            break
        pace = plan.pace
        if pace is None:
            times, ones = np.array((plan.start, plan.end)), np.ones(2)
            pace = Pace(times, times, ones, 0.0 * ones)
        plan = _at_pace(plan, pace.slowed(factor))
    return plan


@checked
def fastest(plan: Plan, limits: MotionLimits | None = None) -> Plan:
    """The plan in the least time that velocity, acceleration and torque limits allow.

    By toppra on a grid of places on the path; between them the acceleration goes from one value to the next, so that
    it is continuous. An open plan begins and ends at rest; a closed one passes its seam at speed. Joints of the result
    are those of the plan, at other times; they have the task exactly. A path that rests at its ends in its own time
    already is left and reached more slowly than could be.

    Args:
        plan: The plan, at any pace.
        limits: The limits; by default the robot's velocity limits. Without limits of acceleration or torque a plan
            cannot begin or end at rest, so one of them is needed.

    Raises:
        MissingDependencyError: toppra is not installed.
        InputError: No limit of acceleration or torque.
        PlanError: No pace keeps the limits: gravity alone needs more torque than there is, or the joints jump.
    """
    plan.check_continuous()
    limits = limits or MotionLimits.of(plan.robot)
    if not (np.isfinite(limits.acceleration).all() or np.isfinite(limits.torque).all()):
        raise InputError(
            "the fastest time needs a limit of each joint's acceleration or torque; give the accelerations "
            "(--acceleration), one number or one for each joint"
        )
    own = plan if plan.pace is None else replace(plan, path=plan.untimed, times=plan.pace.place(plan.times))
    still = motion_of(own)
    _, gravity = torques_of(own.robot, still, limits)
    _refuse_weight(own, still.t, gravity, limits)
    return slowed(_at_pace(own, _paced(*_profile(own, limits), own.closed)), limits)


def _refuse_weight(plan: Plan, times: Vector, gravity: Array, limits: MotionLimits) -> None:
    parts = np.abs(gravity) / limits.torque
    row, joint = np.unravel_index(int(parts.argmax()), parts.shape)
    if parts[row, joint] >= 1.0:
        raise PlanError(
            f"no pace keeps the torque limits: at {times[row]:.4g} s holding still takes {parts[row, joint]:.4g} times "
            f"the torque of {plan.robot.joints[joint].name!r}. Plan with a cost that keeps torques small, or another "
            "path"
        )


def _slowness(plan: Plan, limits: MotionLimits) -> float:
    """Least factor of all times with which the limits are kept, at least 1."""
    motion = motion_of(plan)
    tau, gravity = torques_of(plan.robot, motion, limits)
    _refuse_weight(plan, motion.t, gravity, limits)
    moving = tau - gravity
    with np.errstate(divide="ignore", invalid="ignore"):
        # Of a torque the part of motion falls with the square of the factor, gravity stays.
        room = np.where(moving > 0.0, limits.torque - gravity, limits.torque + gravity)
        squares = np.abs(moving) / room
    parts = (
        np.abs(motion.dq) / limits.velocity,
        np.sqrt(np.abs(motion.ddq) / limits.acceleration),
        np.sqrt(np.where(np.isfinite(limits.torque), squares, 0.0)),
    )
    most = max(float(part.max()) for part in parts)
    return most * (1.0 + 1e-12) if most > 1.0 else 1.0


def _at_pace(plan: Plan, pace: Pace) -> Plan:
    """The plan at a pace that runs over its whole path in its own time."""
    knots = plan.times if plan.pace is None else plan.pace.place(plan.times)
    return replace(plan, path=TimedPath(plan.untimed, pace), times=pace.time(knots))


def _profile(plan: Plan, limits: MotionLimits) -> tuple[Vector, Vector]:
    """Places, evenly apart, and squares of the speed there: toppra's answer."""
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError as error:
        raise MissingDependencyError("the fastest time", "toppra", "pip install 'eos-pin[timing]'") from error
    import logging

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    count = int(np.clip(PIECES * len(plan.times), FEW, MANY))
    places = np.linspace(plan.start, plan.end, count + 1)
    path = _path_of(toppra, plan, places)

    def both(most: Vector) -> Array:
        # toppra knows no infinite limits: those that are missing are far away.
        far = np.where(np.isfinite(most), most, FAR)
        return np.stack((-far, far), axis=1)

    kinds: list[Any] = [constraint.JointVelocityConstraint(both(limits.velocity))]
    if np.isfinite(limits.acceleration).any():
        kinds.append(constraint.JointAccelerationConstraint(both(limits.acceleration)))
    if np.isfinite(limits.torque).any():
        dynamics, friction = plan.robot.inverse_dynamics, np.zeros(plan.robot.n)
        kinds.append(constraint.JointTorqueConstraint(dynamics, both(limits.torque), friction))

    def solved(first: float, last: float, grid: Vector) -> Vector:
        instance = algorithm.TOPPRA(kinds, path, gridpoints=grid, solver_wrapper="seidel")
        _, speeds, _ = instance.compute_parameterization(first, last)
        if speeds is None or not np.isfinite(speeds).all():
            raise PlanError(
                "no pace within the limits was found along this plan: its joints turn too sharply somewhere. Plan it "
                "with more points, or allow more acceleration or torque"
            )
        return np.asarray(speeds) ** 2

    if not plan.closed:
        return places, solved(0.0, 0.0, places)
    # In the middle of three rounds the start and the end at rest are forgotten; the seam is then passed at one speed.
    period = plan.end - plan.start
    grid = np.concatenate((places[:-1], places[:-1] + period, places + 2.0 * period))
    x = solved(0.0, 0.0, grid)[count : 2 * count + 1]
    if abs(x[0] - x[-1]) > 1e-6 * x.max():
        seam = float(np.sqrt(min(x[0], x[-1])))
        x = solved(seam, seam, places)
    return places, x


def _path_of(toppra: Any, plan: Plan, places: Vector) -> Any:
    """The joints as toppra takes a path; a closed plan goes on for ever."""
    from scipy.interpolate import CubicSpline

    joints = plan.joints(places)
    if plan.closed:
        joints[-1] = joints[0]
    curve = CubicSpline(places, joints, bc_type="periodic" if plan.closed else "not-a-knot")
    period = plan.end - plan.start

    class JointPath(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        """Joints over the place."""

        def __call__(self, positions: Any, order: int = 0) -> Any:
            return curve(positions, nu=order)

        @property
        def dof(self) -> int:
            return joints.shape[1]

        @property
        def path_interval(self) -> Array:
            return np.array((plan.start, plan.start + (3.0 if plan.closed else 1.0) * period))

        @property
        def waypoints(self) -> tuple[Array, Array]:
            return places, joints

    return JointPath()


def _paced(places: Vector, x: Vector, closed: bool) -> Pace:
    """Pace from squares of the speed, which are linear between places; averaged over one piece to be smooth.

    The average of x over the length of a piece is made of parabolas that meet at the places and halfway between them:
    the acceleration goes on a straight line from one piece's to the next one's. At rest x goes on with the other sign,
    so that the average rests as well.
    """
    h = float(places[1] - places[0])
    before, after = (x[-2], x[1]) if closed else (-x[1], -x[-2])
    wide = np.concatenate(([before], x, [after]))
    slopes = np.diff(wide) / (2.0 * h)
    s = np.empty(2 * len(places) - 1)
    square, bend = np.empty_like(s), np.empty_like(s)
    s[::2], s[1::2] = places, 0.5 * (places[1:] + places[:-1])
    square[::2], square[1::2] = (wide[:-2] + 6.0 * x + wide[2:]) / 8.0, 0.5 * (x[1:] + x[:-1])
    bend[::2], bend[1::2] = 0.5 * (slopes[1:] + slopes[:-1]), slopes[1:-1]
    square = np.maximum(square, 0.0)
    times = np.concatenate(([0.0], np.cumsum(_durations(square, bend, 0.5 * h))))
    return Pace(places[0] + times, s, np.sqrt(square), bend)


def _durations(x: Vector, u: Vector, d: float) -> Array:
    """Time of each piece of length d from squares of the speed and accelerations at its ends, ∫ ds / √x."""
    y = 0.5 * (_NODES + 1.0)
    # At rest the integrand is infinite; places are taken as d y² from there, which makes it smooth.
    e, weights = np.tile(y, (len(x) - 1, 1)), np.tile(0.5 * _WEIGHTS, (len(x) - 1, 1))
    rests, stops = x[:-1] == 0.0, x[1:] == 0.0
    e[rests], weights[rests] = y**2, _WEIGHTS * y
    e[stops], weights[stops] = 1.0 - y**2, _WEIGHTS * y
    e, start, slope, change = d * e, x[:-1, None], u[:-1, None], np.diff(u)[:, None]
    squares = start + 2.0 * slope * e + change / d * e * e
    return d * (weights / np.sqrt(np.maximum(squares, 1e-300))).sum(axis=1)
