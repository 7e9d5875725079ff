"""Speed override, pause and resume along a plan: the place on its path as a smooth function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from eos_pin._arrays import JointVector, number
from eos_pin.errors import InputError
from eos_pin.trajectories.base import JointTarget, Target, Trajectory

#: Time that a change of speed takes [s].
RAMP = 0.5


@dataclass(frozen=True)
class Change:
    """A change of speed.

    Attributes:
        t: When it begins [s].
        s: Place then [s of the plan].
        before: Speed before.
        after: Speed after it.
        ramp: Time it takes [s].
    """

    t: float
    s: float
    before: float
    after: float
    ramp: float


class Clock:
    """Place s(t) on a plan, with continuous acceleration; 1 is the plan's own speed.

    What was asked for is a list of changes; times before the last change give what they always gave, so that a driver
    may evaluate any time again.

    Args:
        start: Time at which the clock runs from `place` [s].
        place: Place at the start.
        speed: Speed at the start.
    """

    def __init__(self, start: float = 0.0, place: float = 0.0, speed: float = 1.0) -> None:
        self.changes = [Change(start, place, speed, speed, RAMP)]

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Place, speed and acceleration at time t."""
        change = self.changes[0]
        for later in self.changes[1:]:
            if later.t > t:
                break
            change = later
        past, gain = t - change.t, change.after - change.before
        if past <= 0.0:
            return change.s + change.before * past, change.before, 0.0
        if past >= change.ramp:
            end = change.s + 0.5 * (change.before + change.after) * change.ramp
            return end + change.after * (past - change.ramp), change.after, 0.0
        # The speed follows 10 x³ − 15 x⁴ + 6 x⁵ from one value to the other.
        x = past / change.ramp
        place = change.s + change.before * past + gain * change.ramp * x**4 * (2.5 - 3.0 * x + x * x)
        speed = change.before + gain * x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
        return place, speed, gain / change.ramp * 30.0 * (x * (1.0 - x)) ** 2

    def changing(self, t: float) -> bool:
        """Whether a change of speed is under way at time t."""
        last = self.changes[-1]
        return len(self.changes) > 1 and t < last.t + last.ramp

    def set_speed(self, t: float, speed: float, *, ramp: float = RAMP) -> None:
        """Change the speed from time t on; 0 is a pause, and negative speeds go back.

        Raises:
            InputError: A change is under way, or t lies before the last one.
        """
        number(speed, "the speed")
        last = self.changes[-1]
        if self.changing(t):
            raise InputError(
                f"the speed is changing until {last.t + last.ramp:g} s; change it again from then on, not at {t:g} s"
            )
        place, before, _ = self(t)
        self.changes.append(Change(t, place, before, speed, number(ramp, "the ramp", above=0.0)))

    def pause(self, t: float) -> None:
        """Come to rest from time t on."""
        self.set_speed(t, 0.0)

    def resume(self, t: float, speed: float = 1.0) -> None:
        """Go on from time t on."""
        self.set_speed(t, speed)


@dataclass(frozen=True)
class PacedPath(Trajectory):
    """A task path at the pace of a clock.

    Attributes:
        path: The path.
        clock: Place on it over time.
    """

    path: Trajectory
    clock: Clock

    def __call__(self, t: float) -> Target:
        s, ds, dds = self.clock(t)
        z, dz, ddz = self.path(s)
        return Target(z, ds * dz, ds * ds * ddz + dds * dz)


@dataclass(frozen=True)
class PacedJoints:
    """Joints over time at the pace of a clock; for `FollowJoints`.

    Attributes:
        joints: Joints, velocities and accelerations as a function of the place.
        clock: Place over time.
    """

    joints: Callable[[float], tuple[JointVector, JointVector, JointVector]]
    clock: Clock

    def __call__(self, t: float) -> JointTarget:
        s, ds, dds = self.clock(t)
        q, dq, ddq = self.joints(s)
        return JointTarget(q, ds * dq, ds * ds * ddq + dds * dq)
