"""Options that apply only with others: one that would change nothing is refused, with the reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

from eos_pin.errors import InputError

#: Options by name, as the command line has them.
Settings: TypeAlias = Mapping[str, Any]


class Rule(NamedTuple):
    """Condition under which some options apply.

    Attributes:
        names: Names of the options.
        applies: Whether they change anything beside the others.
        reason: Why they do not, and what to do.
    """

    names: tuple[str, ...]
    applies: Callable[[Settings], bool]
    reason: str


TaskKind: TypeAlias = Literal[
    "position", "pose", "point-axis", "axis", "look-at", "orientation", "heading", "distance", "com", "relative-pose",
    "joints",
]  # fmt: skip
#: Kinds of task that direct an axis of the tool, and that need a point of the world.
DIRECTED, POINTED = ("axis", "point-axis", "look-at"), ("look-at", "distance")
EOS = ("eos", "eos-limited")
DRAWN = ("eight", "circle", "line")


def _is_sampled(s: Settings) -> bool:
    return s["control_rate"] is not None or s["plant"] == "mujoco"


def _is_torque(s: Settings) -> bool:
    return bool(s["command"] == "torque")


def _is_random(s: Settings) -> bool:
    return bool(s["noise"] or s["dropout"] or s["model_error"] or s["self_motion"] == "planned")


RULES = (
    Rule(
        (
            "controller",
            "plant",
            "substeps",
            "noise",
            "delay",
            "dropout",
            "friction",
            "push",
            "push_time",
            "torque_limits",
            "torque_rate",
            "soft_start",
            "model_error",
            "method",
            "rtol",
        ),
        _is_torque,
        "positions and velocities go to an ideal joint servo; leave --command out for torques",
    ),
    Rule(("acceleration",), lambda s: not _is_torque(s), "torques are commanded; add --command position"),
    Rule(
        (
            "task",
            "axes",
            "tool_axis",
            "further",
            "further_path",
            "path",
            "size",
            "plane",
            "period",
            "self_motion",
            "v",
            "swing",
        ),
        lambda s: s["plan"] is None,
        "--plan has a task, a path and a self-motion of its own; leave one of them out",
    ),
    Rule(("size", "plane", "period"), lambda s: s["path"] in DRAWN, "it belongs to the paths eight, circle and line"),
    Rule(("corners", "blend"), lambda s: s["path"] not in (*DRAWN, "hold"), "it belongs to way points"),
    Rule(("blend",), lambda s: s["corners"] == "round", "it belongs to --corners round"),
    Rule(("cycles",), lambda s: s["duration"] is None, "the duration is given; leave one of them out"),
    Rule(("cycles",), lambda s: s["path"] != "hold", "a robot that holds still has no rounds; give --duration"),
    Rule(
        ("self_motion", "v", "swing", "kp", "kd", "kp_self_motion", "kd_self_motion"),
        lambda s: s["controller"] in EOS,
        "other controllers have gains and laws of the self-motion of their own; use --controller eos or eos-limited",
    ),
    Rule(
        ("chart_margin", "metric"),
        lambda s: s["controller"] in (*EOS, "impedance"),
        "traditional controllers have no charts; use --controller eos, eos-limited or impedance",
    ),
    Rule(
        ("stiffness", "self_motion_stiffness", "damping_ratio"),
        lambda s: s["controller"] == "impedance",
        "it belongs to --controller impedance",
    ),
    Rule(("v", "swing"), lambda s: s["self_motion"] == "hold", "v is commanded with --self-motion hold only"),
    Rule(
        ("kp_self_motion",),
        lambda s: s["self_motion"] in ("hold", "posture", "planned"),
        "it belongs to --self-motion hold, posture and planned",
    ),
    Rule(
        ("kd_self_motion",),
        lambda s: s["self_motion"] in ("hold", "posture", "damp", "planned"),
        "it belongs to --self-motion hold, posture, damp and planned",
    ),
    Rule(
        ("further",),
        lambda s: s["controller"] in EOS and s["self_motion"] != "planned",
        "it is done by the self-motion of the controllers eos and eos-limited, where no plan leads that",
    ),
    Rule(("further_path",), lambda s: s["further"] != "none", "there is no further task; add --further orientation"),
    Rule(("substeps",), _is_sampled, "it belongs to sampled runs; add --control-rate 1000"),
    Rule(("push_time",), lambda s: s["push"] is not None, "there is no push; add --push FX FY FZ"),
    Rule(("method", "rtol"), lambda s: not _is_sampled(s), "it belongs to continuous runs; leave --control-rate out"),
    Rule(("seed",), _is_random, "nothing is random; add --noise, --dropout or --model-error"),
)


def check_applicable(settings: Settings, defaults: Settings) -> None:
    """Refuse an option that is not at its default and changes nothing.

    Args:
        settings: All options of a run by name; rules about options that are not among them are left out.
        defaults: Their defaults.

    Raises:
        InputError: An option does not apply.
    """
    for rule in RULES:
        for name in rule.names:
            if name not in settings or settings[name] == defaults[name] or rule.applies({**defaults, **settings}):
                continue
            option = name.replace("_", "-")
            raise InputError(f"--{option} {_shown(settings[name])} does not apply: {rule.reason}")


def _shown(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
