"""A run as plain settings."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from eos_pin._arrays import JointVector, checked
from eos_pin.control.base import Controller
from eos_pin.errors import InputError, Renamed, UnknownNameError
from eos_pin.experiments.options import (
    ControlOptions,
    PathOptions,
    RobotOptions,
    RunOptions,
    TaskOptions,
    check_options,
)
from eos_pin.robot.model import Robot
from eos_pin.simulation._recorder import Observer
from eos_pin.simulation._storage import provenance
from eos_pin.simulation.result import Result

#: What is known of one run: its settings and its figures by name.
Row: TypeAlias = dict[str, Any]

#: Runs of one sweep, at most.
MOST_RUNS = 100_000
GROUPS: Mapping[str, type] = {
    "robot": RobotOptions,
    "task": TaskOptions,
    "path": PathOptions,
    "control": ControlOptions,
    "simulation": RunOptions,
}
#: Group of each setting, and what a setting of few values may be.
PLACES = {field.name: group for group, kind in GROUPS.items() for field in fields(kind)}
CHOICES = {
    name: get_args(hint)
    for kind in GROUPS.values()
    for name, hint in get_type_hints(kind).items()
    if get_origin(hint) is Literal
}
#: Figures that a row has from `Result.summary`.
MEASURED = (
    "status",
    "message",
    "task_error_max",
    "self_motion_error_max",
    "given_up_seconds",
    "chart_switches",
    "kinetic_energy_mean",
    "torque_max",
    "limit_ratio_max",
    "cpu_seconds",
)


@checked
@dataclass(frozen=True)
class Trial:
    """One closed-loop run in plain values, with the settings and defaults of `eos-pin track`.

    A subclass may add fields of its own, run a controller of its own in `run`, and measure in `figures`.

    Attributes:
        robot: Which robot.
        task: Task of the robot.
        path: Where it should go.
        control: How it is controlled.
        simulation: How it is simulated.
        seed: Seed of everything random.
    """

    robot: RobotOptions
    task: TaskOptions = TaskOptions()
    path: PathOptions = PathOptions()
    control: ControlOptions = ControlOptions()
    simulation: RunOptions = RunOptions()
    seed: int = 0

    of = Renamed("from_settings")

    def __post_init__(self) -> None:
        settings = self.settings
        for name, choices in CHOICES.items():
            if settings[name] not in choices:
                raise UnknownNameError(name.replace("_", " "), str(settings[name]), choices)

    @classmethod
    @checked
    def from_settings(cls, robot: str, **settings: Any) -> Trial:
        """The run with these settings, named as the options of `eos-pin track` are, such as `kp=50, model_error=0.1`.

        Raises:
            UnknownNameError: There is no such setting, or it has no such value.
        """
        own = {field.name for field in fields(cls)} - set(GROUPS)
        groups: dict[str, Row] = {name: {} for name in GROUPS}
        rest: Row = {}
        for name, value in {"robot": robot, **settings}.items():
            if name not in PLACES and name not in own:
                raise UnknownNameError("setting", name, [*PLACES, *own])
            (groups[PLACES[name]] if name in PLACES else rest)[name] = _plain(value, name)
        return cls(**{name: kind(**groups[name]) for name, kind in GROUPS.items()}, **rest)

    @property
    def settings(self) -> Row:
        """All settings by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        grouped = {name: value for group in GROUPS for name, value in vars(values.pop(group)).items()}
        return grouped | values

    @cached_property
    def key(self) -> str:
        """A name that the same run has at any time and place; another where a version or a file it reads is another."""
        paths = [Path(self.robot.robot), Path(self.path.path)]
        digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()]
        # 50 and 50.0 are the same gain.
        settings = json.loads(json.dumps(self.settings, default=str), parse_int=float)
        text = json.dumps([type(self).__qualname__, settings, digests, _versions()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    def prepare(self) -> tuple[Robot, Controller, JointVector, float]:
        """Robot, controller, joints at the start and length of the run [s].

        Raises:
            EosError: The settings do not fit the robot, or each other.
        """
        check_options(self.task, self.path, self.control, self.simulation)
        robot = self.robot.load()
        task, q = self.task.make(robot)
        path = self.path.make(task, q)
        return robot, self.control.make(task, path, q, self.simulation.control_period), q, self.path.length(path)

    @checked
    def run(self, observer: Observer | None = None) -> Result:
        """Run it; `observer` is called with (t, q) of every sample."""
        return self.simulation.run(*self.prepare(), seed=self.seed, observer=observer)

    @checked
    def figures(self, result: Result) -> Row:
        """The run's row of the table, in plain values: the chief figures of `Result.summary`."""
        summary = result.summary()
        drift = summary["joint_drift_per_cycle"] or [math.nan]
        found = {name: summary[name] for name in MEASURED} | {"ended": summary["duration"]}
        return found | {"first_drift": drift[0], "last_drift": drift[-1]}


def trials(kind: type[Trial] = Trial, /, **settings: Any) -> list[Trial]:
    """Every combination of settings: a list, range or array is swept, anything else is the same in all runs.

    Args:
        kind: Kind of run for each combination.
        **settings: Settings as in `Trial.from_settings`; `robot` must be among them.

    Raises:
        UnknownNameError: There is no such setting, or it has no such value.
        InputError: No robot, or too many combinations.
    """
    if "robot" not in settings:
        raise InputError('trials need a robot, such as robot="panda" or robot=["panda", "xarm7"]')
    axes = [value if isinstance(value, list | range | np.ndarray) else [value] for value in settings.values()]
    count = math.prod(len(axis) for axis in axes)
    if count > MOST_RUNS:
        raise InputError(f"these settings make {count:,} runs; up to {MOST_RUNS:,} are possible. Take fewer of each")
    return [kind.from_settings(**dict(zip(settings, values, strict=True))) for values in itertools.product(*axes)]


@cache
def _versions() -> dict[str, str]:
    return dict(provenance()["versions"])


def _plain(value: Any, name: str) -> Any:
    """The same as the options hold it: text, truth, number, None, path, or a tuple of these."""
    if value is None or isinstance(value, str | bool | Path):
        return value
    if isinstance(value, numbers.Real):
        return int(value) if isinstance(value, numbers.Integral) else float(value)
    if isinstance(value, Mapping):
        # Joints by name, as on the command line.
        return tuple(f"{key}={_plain(item, name)!r}" for key, item in value.items())
    if isinstance(value, Sequence | np.ndarray):
        return tuple(_plain(item, name) for item in value)
    raise InputError(f"the setting {name} must be text, a number or a few of these, got {value!r}")
