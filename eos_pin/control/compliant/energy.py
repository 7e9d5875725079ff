"""Energies of an impedance-controlled robot, and the power that parts of its law bring in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eos_pin._arrays import JointVector
from eos_pin.control.compliant.additions import Additions
from eos_pin.control.compliant.memory import ImpedanceState

#: Step of a difference over time [s].
STEP = 1e-5


class Energies(NamedTuple):
    """Energies of an impedance-controlled robot in one state, and the power that its law brings in.

    Attributes:
        kinetic: Kinetic energy of the robot [J].
        springs: Energy of the springs [J].
        tank: Energy in the tank [J].
        damping: Power that the dampers take [W].
        injected: Power brought in by each part of the law that is not passive, by name [W]. With the power of external
            torques their sum, less that of the damping, is the rate of kinetic and spring energy.
    """

    kinetic: float
    springs: float
    tank: float
    damping: float
    injected: dict[str, float]


def energies_of(
    additions: Additions, blend: float, t: float, q: JointVector, dq: JointVector, state: ImpedanceState
) -> Energies:
    """Energies in a state, and the power that the law brings in there."""
    z, J = additions.task._linearize(q)
    springs, kinetic = state.energy(t, q, z), additions.task.robot._kinetic_energy(q, dq)
    pairs = list(zip(state.weights_at(t, blend), state.laws, strict=True))
    damping = sum(weight * law.power(dq, J) for weight, law in pairs)
    # What the laws do with true velocities is what springs give and dampers take; the rest comes from moving targets,
    # which also draw the springs.
    done = sum(weight * float(law.torque(t, q, dq, z, J).dot(dq)) for weight, law in pairs)
    given = sum(weight * float(law.pull(t, q, z, J).dot(dq)) for weight, law in pairs)
    # Some targets begin at time 0.
    before = t - STEP if t > STEP else t
    drawn = (state.energy(t + STEP, q, z) - state.energy(before, q, z)) / (t + STEP - before)
    injected = {"moving targets": done - given + damping + drawn}
    if state.sampled is not None:
        seen = additions.velocity(t, dq, state.sampled)
        own = sum((weight * law.torque(t, q, seen, z, J) for weight, law in pairs), np.zeros(q.size))
        if seen is not dq:
            injected["filter of velocities"] = float(own.dot(dq)) - done
        part = state.part(t, blend)
        added = additions.torques(state.laws[-1], t, q, dq, J, state.sampled)
        tau = additions.task.robot._gravity(q) + own + part * sum(added.values())
        shaping = additions.shaping(state.laws[-1], t, q, dq, z, J, tau, state.sampled)
        if shaping is not None:
            added["inertia shaping"] = shaping
        injected |= {name: part * float(torque.dot(dq)) for name, torque in added.items()}
    if (left := state.left(t, blend)) is not None:
        injected["mode before"] = float(left.dot(dq))
    return Energies(kinetic, springs, state.tank, damping, injected)
