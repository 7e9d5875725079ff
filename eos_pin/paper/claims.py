"""The paper's claims, measured.

Every claim is one number and one bound. Drift, tracking errors and energies are taken at or between exact multiples of
the path's period.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from eos_pin.paper.obstacle_examples import Application, panda, planar_chain
from eos_pin.simulation.result import Result

Runs: TypeAlias = Mapping[str, Result]

#: The cited applications, by what they are.
APPLICATIONS: Mapping[str, Callable[[], Application]] = {
    "23 joints and three discs, one of them moving": planar_chain,
    "7-joint arm and a ball": panda,
}
FOOTNOTE = "¹ Full turns of a link are not counted as drift."
#: Later than this the 5.3 energies are averaged [s]: the robot has then come to the path.
SETTLED = 2.0


@dataclass(frozen=True)
class Claim:
    """A claim of the paper in our words, and its measurement.

    Attributes:
        section: Where the paper makes it.
        statement: The claim.
        value: Measured value; not a number where the runs do not decide.
        bound: Value that it is compared with.
        at_least: Whether the value must reach the bound instead of staying below it.
        unit: Unit of both.
        digits: Significant digits that come out the same on every machine; with 0 only the bound does.
    """

    section: str
    statement: str
    value: float
    bound: float
    at_least: bool = False
    unit: str = ""
    digits: int = 0

    @property
    def holds(self) -> bool:
        """Whether the measured value keeps the bound."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    @property
    def measured(self) -> str:
        """The measurement, rounded to digits that are the same on every machine."""
        if self.holds and not self.digits:
            return f"{'≥' if self.at_least else '≤'} {self.bound:g} {self.unit}".strip()
        return f"{self.value:.{self.digits or 2}g} {self.unit}".strip()


def rates_drift(runs: Runs) -> list[Claim]:
    """Claims of Sec. 2.2 and 3."""
    rates, charts = _moved(runs["velocity control"]), _moved(runs["charts"])
    return [
        Claim("2.2", "velocity control by G'† drifts: joints after all cycles", rates, 0.01, True, "m, rad", 3),
        Claim("3", "inverse kinematics on a chart does not: the same", charts, 1e-9, unit="m, rad"),
    ]


def equations_agree(runs: Runs) -> list[Claim]:
    """Claims of Sec. 4.3."""
    joints, extended = runs["joints"], runs["task and self-motion"]
    rows = min(len(joints.t), len(extended.t))
    deviation = float(np.linalg.norm(joints.q[:rows] - extended.q[:rows], axis=1).max())
    count = len(extended.switches) + 1
    charts = "one chart" if count == 1 else f"{count} charts"
    statement = f"both forms of the equations of motion agree, {extended.t[-1]:g} s on {charts}"
    return [Claim("4.3", statement, deviation, 1e-11, unit="m, rad")]


def traditional_drifts(runs: Runs, section: str = "5.1") -> list[Claim]:
    """Claims of Sec. 5.1 and 6.1, and the same with posture control."""
    plain, posture = runs["task-space"], runs["null-space-posture"]
    least, settled = _drift(plain, smallest=True), _drift(posture, since=1)
    return [
        Claim(section, "traditional control follows the path", _late_error(plain), 1e-6, unit="m"),
        Claim(section, "its joints do not repeat: least drift of a cycle¹", least, 0.1, True, "m, rad"),
        Claim(section, "beside it: with posture control they do from cycle 2 on¹", settled, 1e-6, unit="m, rad"),
    ]


def eos_repeats(runs: Runs) -> list[Claim]:
    """Claims of Sec. 5.2."""
    run = runs["eos"]
    apart = _largest(run.q[:, 1] - run.q[:, 2])
    return [
        Claim("5.2", "EOS control follows the path", _late_error(run), 1e-6, unit="m"),
        Claim("5.2", "v = 0 throughout", _largest(run.self_motion_error), 1e-9, unit="m, rad"),
        Claim("5.2", "y2 = y3 throughout", apart, 1e-9, unit="m, rad"),
        Claim(
            "5.2", "the joints repeat: drift of a cycle from the second on", _drift(run, since=1), 1e-8, unit="m, rad"
        ),
    ]


def energy_falls(runs: Runs, note: str = "") -> list[Claim]:
    """Claims of Sec. 5.3; the energies are means after `SETTLED`."""
    T_EOS, T_OS, T_0 = (_mean_energy(runs[name]) for name in ("eos", "task-space-energy", "task-space"))
    return [
        Claim("5.3", f"kinetic energy, mean after 2 s: T_EOS / T_0{note}", T_EOS / T_0, 0.5, digits=3),
        Claim("5.3", f"the same: T_EOS / T_OS{note}", T_EOS / T_OS, 0.95, digits=3),
        Claim("5.3", f"the same: T_OS / T_0{note}", T_OS / T_0, 0.95, digits=3),
        Claim("5.3", f"EOS control follows the path meanwhile{note}", _late_error(runs["eos"]), 1e-6, unit="m"),
    ]


def other_gradient_ends(runs: Runs) -> list[Claim]:
    """Outcome of the other reading of Sec. 5.3."""
    run = runs["eos"]
    end = math.nan if run.ok else float(run.t[-1])
    return [Claim("5.3", "beside it: with ∇T = ∂T/∂y the run ends early, at", end, 18.0, unit="s", digits=2)]


def obstacle_is_avoided(runs: Runs, offset: float = 10.0) -> list[Claim]:
    """Claims of Sec. 5.4."""
    run = runs["eos"]
    distance, spread = float(np.abs(offset + run.q[:, 1]).min()), float(np.ptp(run.v))
    return [
        Claim("5.4", f"the rail clears the obstacle: distance, l = {offset:g} m", distance, 0.0, True, "m", 3),
        Claim("5.4", "following the path is untouched", _late_error(run), 1e-6, unit="m"),
        Claim("5.4", "v is nearly constant: its range", spread, 0.2, unit="m, rad", digits=3),
        Claim(
            "5.4",
            "the joints nearly repeat: drift of a cycle from the second on",
            _drift(run, since=1),
            0.1,
            unit="m, rad",
            digits=2,
        ),
    ]


def chain_repeats(runs: Runs) -> list[Claim]:
    """Claims of Sec. 6.2."""
    run = runs["eos"]
    free = _apart(run, runs["F_v = 0"])
    upright = max(_apart(run, runs[name]) for name in ("eos, gravity", "F_v = 0, gravity"))
    return [
        Claim("6.2", "EOS control of the chain follows the path", _late_error(run), 1e-6, unit="m"),
        Claim("6.2", "v = 0 throughout", _largest(run.self_motion_error), 1e-9, unit="m, rad"),
        Claim("6.2", "all ten joints repeat: drift of any cycle, the first one too", _drift(run), 1e-8, unit="m, rad"),
        Claim("6.2", "one chart suffices: switches", float(len(run.switches)), 0.0, digits=1),
        Claim("6.2", "a zero second row of F* gives the same joints", free, 1e-7, unit="m, rad"),
        Claim("6.2", "so does gravity, with either law (the paper: not with a zero row)", upright, 1e-7, unit="m, rad"),
    ]


def chain_is_calmer(eos: Runs, traditional: Runs) -> list[Claim]:
    """Claims of Sec. 6.2 on kinetic energy."""
    calm, wild = eos["eos"], traditional["task-space"]
    mean = calm.mean(calm.kinetic_energy) / wild.mean(wild.kinetic_energy)
    peak = float(calm.kinetic_energy.max() / wild.kinetic_energy.max())
    return [
        Claim("6.2", "mean kinetic energy, relative to traditional control", mean, 0.2),
        Claim("6.2", "peak kinetic energy, relative to traditional control", peak, 0.2),
    ]


def measure(runs: Mapping[str, Runs]) -> list[Claim]:
    """All claims, from the runs of every example that a claim needs; `scripts/claim_tables.py` lists them."""
    return [
        *rates_drift(runs["2.2"]),
        *equations_agree(runs["4.3 one chart"]),
        *equations_agree(runs["4.3"]),
        *traditional_drifts(runs["5.1"]),
        *eos_repeats(runs["5.2"]),
        *energy_falls(runs["5.3"]),
        *energy_falls(runs["5.3 without gravity"], ", without gravity"),
        *other_gradient_ends(runs["5.3 other gradient"]),
        *obstacle_is_avoided(runs["5.4"]),
        *traditional_drifts(runs["6.1"], "6.1"),
        *chain_repeats(runs["6.2"]),
        *chain_is_calmer(runs["6.2"], runs["6.1"]),
    ]


def obstacles_cleared(name: str, figures: Mapping[str, Any]) -> list[Claim]:
    """Claims of the two applications that the paper cites.

    Args:
        name: Key of `APPLICATIONS`.
        figures: Result of `Application.figures`.
    """
    least = figures["clearance_min_between_points"]
    return [
        Claim("cited", f"{name}: least distance of any body from an obstacle", least, 1e-3, True, "m", 2),
        Claim("cited", "the path is followed meanwhile", figures["task_error_max"], 1e-9, unit="m, rad"),
    ]


def _late_error(run: Result) -> float:
    """Largest task error after the first cycle."""
    return _largest(run.error[run.settled_row :]) if run.cycles > 1 else math.nan


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max())


def _drift(run: Result, *, since: int = 0, smallest: bool = False) -> float:
    """Largest (or smallest) drift of a cycle, from cycle `since` on.

    Full turns of the links do not count: the robots of the paper have two sliders and then links.
    """
    steps = np.diff(run.q[run.cycle_rows][since:], axis=0)
    steps[:, 2:] -= math.tau * np.round(steps[:, 2:] / math.tau)
    drifts = np.abs(steps).max(axis=1)
    return float(drifts.min() if smallest else drifts.max()) if len(drifts) else math.nan


def _moved(run: Result) -> float:
    """Distance of a joint from its start, after the last complete cycle."""
    return _largest(run.q[run.cycle_rows[-1]] - run.q[0])


def _apart(run: Result, other: Result) -> float:
    """Largest difference between the joints of two runs."""
    return _largest(run.q - other.q) if len(run.t) == len(other.t) else math.nan


def _mean_energy(run: Result) -> float:
    """Time average of the kinetic energy after `SETTLED`, to the end of the last complete cycle [J]."""
    rows = slice(int(np.searchsorted(run.t, SETTLED - 1e-9)), int(run.cycle_rows[-1]) + 1)
    t = run.t[rows]
    if not run.ok or len(t) < 2:
        return math.nan
    return float(np.trapezoid(run.kinetic_energy[rows], t) / (t[-1] - t[0]))
