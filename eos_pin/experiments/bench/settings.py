"""Settings of the bench: disturbances of the robot, by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from eos_pin.errors import UnknownNameError

#: Control rate where the setting has none [Hz], and the plant's.
RATE = 500.0


@dataclass(frozen=True)
class Setting:
    """Disturbances of a run.

    Attributes:
        title: Name in tables.
        options: Settings as `RunOptions` has them.
        friction: Viscous and dry friction of each joint, as parts of the torque that holds its inertia: at 1 rad/s² and
            at 1 rad/s [1/s, 1].
        saturation: Torque limits as a part of the largest torque of the undisturbed path; None for none.
        push: Where it is pushed for 0.2 s: `"tool"` or `"elbow"`.
        payload: Mass that the plant carries and no controller models, as a part of the robot's own mass.
        contact: Whether a part of the path leads into a surface; the plant is MuJoCo's.
    """

    title: str
    options: Mapping[str, Any] = field(default_factory=dict)
    friction: float = 0.0
    saturation: float | None = None
    push: str = ""
    payload: float = 0.0
    contact: bool = False


SETTINGS: Mapping[str, Setting] = {
    "exact": Setting("exact model"),
    "model-10": Setting("model 10 % off", {"model_error": 0.1}),
    "model-20": Setting("model 20 % off", {"model_error": 0.2}),
    "model-30": Setting("model 30 % off", {"model_error": 0.3}),
    "friction": Setting("friction", friction=1.0),
    "noise": Setting("noise 1e-4 rad", {"noise": 1e-4}),
    "delay-2": Setting("delay 2 ms", {"delay": 2e-3}),
    "delay-6": Setting("delay 6 ms", {"delay": 6e-3}),
    "rate-200": Setting("200 Hz", {"control_rate": 200.0}),
    "rate-2000": Setting("2,000 Hz", {"control_rate": 2000.0}),
    "saturation": Setting("torque saturation", saturation=0.95),
    "push-tool": Setting("push at the tool", push="tool"),
    "push-elbow": Setting("push at the elbow", push="elbow"),
    "payload": Setting("unknown payload", payload=0.05),
    "mujoco": Setting("MuJoCo, 10 % off", {"plant": "mujoco", "model_error": 0.1}),
    "contact": Setting("contact with foam, MuJoCo", {"plant": "mujoco", "model_error": 0.1}, contact=True),
    "all": Setting(
        "all at once", {"model_error": 0.1, "noise": 3e-5, "delay": 2e-3}, friction=0.5, push="tool", payload=0.02
    ),
    # Not for verdicts: gains are found here.
    "tuning": Setting("tuning", {"model_error": 0.15, "noise": 5e-5, "delay": 2e-3}, friction=0.5),
}
#: Settings of a bench by default: all but that for gains.
USUAL = tuple(name for name in SETTINGS if name != "tuning")


def chosen_settings(names: Iterable[str]) -> tuple[str, ...]:
    """Names of settings, checked; the usual ones where none is given.

    Raises:
        UnknownNameError: There is no such setting.
    """
    names = tuple(names) or USUAL
    for name in names:
        if name not in USUAL:
            raise UnknownNameError("setting", name, USUAL)
    return names
