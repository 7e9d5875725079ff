"""Verdicts of the bench: which laws are best in a setting, by runs that are paired."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from eos_pin._arrays import Array
from eos_pin.experiments.bench.trial import LOST
from eos_pin.experiments.trial import Row

#: Laws whose errors differ by less than this part are alike, however sure the difference is.
ALIKE = 0.05
#: Confidence of intervals, level of tests, resamples of a bootstrap, and pairs from which a verdict is given.
CONFIDENCE, RESAMPLES, ENOUGH = 0.95, 2000, 6


def enough(laws: int) -> int:
    """Pairs from which a verdict can be given: Holm's test rejects nothing with less, however clear the difference is.

    Args:
        laws: Number of laws.
    """
    # The signed-rank test of n pairs has probabilities from 2/2ⁿ on.
    return max(ENOUGH, 1 + math.ceil(math.log2(max(laws - 1, 1) / (1.0 - CONFIDENCE))))


@dataclass(frozen=True)
class Standing:
    """A law beside the best one in a setting; ratios are of task errors in paired runs.

    Attributes:
        law: Name of the law.
        error: Median task error over all runs [m].
        lost: Runs that ended early or went astray.
        ratio: Median ratio to the best law.
        low: Lower end of its interval.
        high: Upper end.
        p: Probability of such differences where there are none: Wilcoxon's signed-rank test, after Holm.
        to_eos: Median ratio to EOS; NaN where it did not run.
        best: Whether it is the best, or not shown to be worse.
    """

    law: str
    error: float
    lost: int
    ratio: float
    low: float
    high: float
    p: float
    to_eos: float
    best: bool


@dataclass(frozen=True)
class Verdict:
    """Standings of all laws in one setting, the best first.

    Attributes:
        setting: Name of the setting.
        pairs: Paired runs of each two laws.
        standings: The laws.
    """

    setting: str
    pairs: int
    standings: tuple[Standing, ...]

    @property
    def best(self) -> tuple[str, ...]:
        """Laws that are best, or not shown to be worse than the best."""
        return tuple(standing.law for standing in self.standings if standing.best)

    @property
    def decided(self) -> bool:
        """Whether there are pairs enough for any difference to be shown."""
        return self.pairs >= enough(len(self.standings))

    @property
    def winner(self) -> str:
        """The law that is better than every other; empty where none is."""
        return self.best[0] if len(self.best) == 1 and self.decided else ""


def verdict(rows: Sequence[Row], setting: str) -> Verdict:
    """Verdict over one setting.

    Runs are paired by robot and seed. The best law is that with the least median of log errors, each less the median
    of its pair. Another law is worse where its median ratio to the best is above 1 + `ALIKE`, its bootstrap interval
    lies above 1 and Holm's test rejects; else both are best.

    Args:
        rows: Results, see `bench`.
        setting: Name of the setting.
    """
    table: dict[str, dict[tuple[str, int], float]] = {}
    for row in rows:
        if row["setting"] == setting:
            table.setdefault(row["law"], {})[row["robot"], row["seed"]] = max(row["error"], 1e-12)
    shared = sorted(set.intersection(*(set(runs) for runs in table.values())))
    laws = list(table)
    errors = np.log([[table[law][pair] for pair in shared] for law in laws])
    scores = np.median(errors - np.median(errors, axis=0), axis=1)
    order = np.argsort(scores, kind="stable")
    apart = errors - errors[order[0]]
    p = np.array([_signed_rank(row) for row in apart])
    others = order[1:]
    p[others] = _holm(p[others])
    standings = []
    for k in order:
        low, high = _interval(apart[k])
        ratio = float(np.exp(np.median(apart[k])))
        worse = ratio > 1.0 + ALIKE and low > 1.0 and p[k] < 1.0 - CONFIDENCE
        to_eos = float(np.exp(np.median(errors[k] - errors[laws.index("eos")]))) if "eos" in laws else np.nan
        lost = int((errors[k] >= np.log(LOST)).sum())
        error = float(np.exp(np.median(errors[k])))
        standings.append(Standing(laws[k], error, lost, ratio, low, high, float(p[k]), to_eos, not worse))
    return Verdict(setting, len(shared), tuple(standings))


def _interval(apart: Float[Array, " k"]) -> tuple[float, float]:
    """Bootstrap interval of the median ratio, by percentiles."""
    if len(apart) < 2 or not np.ptp(apart):
        ratio = float(np.exp(np.median(apart)))
        return ratio, ratio
    found = stats.bootstrap(
        (apart,), np.median, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="percentile",
        vectorized=True, random_state=np.random.default_rng(0),
    ).confidence_interval  # fmt: skip
    return float(np.exp(found.low)), float(np.exp(found.high))


def _signed_rank(apart: Float[Array, " k"]) -> float:
    """Probability of differences like these, or larger, where there are none."""
    return float(stats.wilcoxon(apart).pvalue) if apart.any() and len(apart) > 1 else 1.0


def _holm(p: Float[Array, " k"]) -> Float[Array, " k"]:
    """Probabilities of several tests, adjusted after Holm."""
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return adjusted
