"""Memory of `ImpedanceController` from one call to the next, and the energy tank in it."""

from __future__ import annotations

import math
from typing import NamedTuple

from eos_pin._arrays import JointVector
from eos_pin.charts.chart import Chart
from eos_pin.control.compliant.additions import Sampled
from eos_pin.control.compliant.law import ImpedanceLaw
from eos_pin.tasks.base import Point

#: Part of the power taken by the dampers that fills the tank.
FILLING = 0.5


class ImpedanceState(NamedTuple):
    """Laws that act, the last of them the one in charge; those before fade out as it fades in.

    Attributes:
        laws: The laws, oldest first.
        weights: Their weights at time t; they sum to 1.
        t: Time of the weights and the tank [s].
        tank: Energy in the tank [J].
        number: Number of charts before the one it is on.
        checked: Joints at which the margin of the chart was last looked at.
        sampled: Memory of additions; None where there are none.
        carried: Torque of the additions of the mode before, which fades out; None where there is none [N m or N].
        since: Time since which the additions of this mode fade in [s].
    """

    laws: tuple[ImpedanceLaw, ...]
    weights: tuple[float, ...]
    t: float
    tank: float
    number: int
    checked: JointVector
    sampled: Sampled | None = None
    carried: JointVector | None = None
    since: float = -math.inf

    @property
    def chart(self) -> Chart:
        """Chart of the law in charge."""
        return self.laws[-1].chart

    def part(self, t: float, blend: float) -> float:
        """Part of the additions of this mode that acts at time t; those of the mode before have the rest."""
        return min((t - self.since) / blend, 1.0)

    def left(self, t: float, blend: float) -> JointVector | None:
        """Part of the torque by additions of the mode before that still acts at time t; None if there is none."""
        return None if self.carried is None else (1.0 - self.part(t, blend)) * self.carried

    def weights_at(self, t: float, blend: float) -> tuple[float, ...]:
        """Weights at a later time, if no energy is lacking."""
        if len(self.laws) == 1 or t <= self.t:
            return self.weights
        return faded(self.weights, (t - self.t) / blend)

    def energy(self, t: float, q: JointVector, z: Point) -> float:
        """Energy of the springs [J]."""
        laws = zip(self.weights, self.laws, strict=True)
        return sum(weight * law.energy(t, q, z) for weight, law in laws)

    def paid(self, t: float, q: JointVector, z: Point, blend: float, most: float) -> ImpedanceState:
        """The state with weights at time t, as far as the tank has the energy that the change of weights needs.

        Args:
            t: Time [s].
            q: Joints.
            z: Task point there.
            blend: Time in which a law fades in [s].
            most: Energy that the tank can hold [J].
        """
        weights = self.weights_at(t, blend)
        # At the earlier time: what targets do meanwhile is their own power.
        energies = [law.energy(self.t, q, z) for law in self.laws]
        needed = sum((b - a) * u for a, b, u in zip(self.weights, weights, energies, strict=True))
        if needed > self.tank:
            part = self.tank / needed
            weights = tuple(a + part * (b - a) for a, b in zip(self.weights, weights, strict=True))
            needed = self.tank
        tank = min(max(self.tank - needed, 0.0), most)
        if weights[-1] >= 1.0:
            return self._replace(laws=self.laws[-1:], weights=(1.0,), t=t, tank=tank)
        return self._replace(weights=weights, t=t, tank=tank)


def faded(weights: tuple[float, ...], more: float) -> tuple[float, ...]:
    """Weights where the last is greater by `more`, at most 1, and the others share the rest as before."""
    last = weights[-1] + more
    if last >= 1.0:
        return (*(0.0 for _ in weights[1:]), 1.0)
    left = (1.0 - last) / (1.0 - weights[-1])
    return (*(left * weight for weight in weights[:-1]), last)
