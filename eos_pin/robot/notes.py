"""Notes on a loaded robot: changes, missing parts and odd numbers; each kind is one sentence."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from eos_pin.robot._parts import listed, reach_of

#: No robot reaches as far as this; what does has its lengths in another unit [m].
FAR = 50.0
#: Less, or more, than this in all is no mass of a robot [kg].
LIGHT, HEAVY = 1e-3, 1e4
#: A joint turns by no more than this [rad]; limits from here to two full turns in degrees are presumably degrees.
MANY_TURNS, DEGREES = 25.0, 720.0


class Notes:
    """Notes of one robot, collected while it is read; joints or links of one kind of note share a sentence."""

    def __init__(self) -> None:
        self._named: dict[str, list[str]] = {}

    def add(self, sentence: str, name: str = "") -> None:
        """Take down a sentence.

        Args:
            sentence: The sentence; `@` stands for what it is about.
            name: Subject of the note, such as a joint.
        """
        names = self._named.setdefault(sentence, [])
        if name and name not in names:
            names.append(name)

    def sentences(self) -> tuple[str, ...]:
        """All notes, in the order in which their kinds came up."""
        return tuple(sentence.replace("@", listed(names)) for sentence, names in self._named.items())


def oddities(model: pin.Model, end: str = "") -> tuple[str, ...]:
    """Notes about numbers that are presumably in another unit, and about bodies that cannot exist.

    They do no harm by themselves: all is used as it stands.

    Args:
        model: The model.
        end: Frame that the chain ends at; empty for a whole robot.
    """
    notes = Notes()
    reach, bodies = reach_of(model, end), list(model.inertias)[1:]
    if reach > FAR:
        unit = "millimetres" if reach > 10.0 * FAR else "centimetres"
        notes.add(f"the robot reaches {reach:,.0f} m; a URDF counts in metres, and its lengths look like {unit}")
    for i in range(1, model.njoints):
        if model.joints[i].nv != 1 or model.joints[i].shortname().startswith("JointModelP"):
            continue
        k = model.joints[i].idx_v
        ends = [abs(x) for x in (model.lowerPositionLimit[k], model.upperPositionLimit[k])]
        if MANY_TURNS < max(ends) <= DEGREES:
            notes.add("limits of more than 25 rad look like degrees; a URDF counts in radians: @", model.names[i])
    mass = sum(body.mass for body in bodies)
    if mass > HEAVY or 0.0 < mass < LIGHT:
        notes.add(f"what moves has a mass of {mass:,.3g} kg in all; are these other units?")
    for i, body in enumerate(bodies, 1):
        if not is_physical(body):
            notes.add(
                "the inertia of what these joints move is that of no real body; used as it stands: @", model.names[i]
            )
        elif reach > 0.0 < body.mass and np.linalg.eigvalsh(body.inertia)[-1] > body.mass * reach**2:
            notes.add(
                "the inertia of what these joints move is that of a body larger than the robot; used as it stands: @",
                model.names[i],
            )
    return notes.sentences()


def is_physical(inertia: pin.Inertia) -> bool:
    """Whether a distribution of mass has this inertia: no principal moment exceeds the sum of the others."""
    if not np.isfinite(inertia.inertia).all():
        return False
    moments = np.linalg.eigvalsh(inertia.inertia)
    # Many files state moments to three digits.
    return bool(inertia.mass >= 0.0 and moments.sum() - 2.0 * moments[-1] >= -2e-3 * np.abs(moments).max())
