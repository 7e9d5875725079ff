"""Runs of the bench: gains by the same search for every law, then every law, robot, setting and seed."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from eos_pin._arrays import checked, number
from eos_pin.errors import InputError
from eos_pin.experiments.bench.laws import chosen_laws
from eos_pin.experiments.bench.settings import chosen_settings
from eos_pin.experiments.bench.trial import LOST, BenchTrial
from eos_pin.experiments.sweeps import sweep, write_table
from eos_pin.experiments.trial import Row

#: Rates among which those of each law are chosen, of the task and of what is left free [1/s].
#: The former in steps of about 2^(1/4): errors fall with their square, so that wide steps would decide between laws.
TASK_RATES = (16.0, 19.0, 23.0, 27.0, 32.0, 38.0, 45.0, 54.0, 64.0, 76.0, 91.0, 108.0, 128.0)
FREE_RATES = (2.0, 8.0)
#: Roughness of the torque in the search, as a part of the torque itself, up to which gains count: noise and delay make
#: it grow with them, and no motor bears it as far as errors fall.
ROUGH = 0.05
#: Errors of the search that are taken for equal, as a ratio; of these gains those with the least drift count.
EQUAL = 1.1
#: First seed of the runs in which gains are found; no other runs have it.
TUNING_SEED = 100_000
#: Robots where none is named.
ROBOTS = ("panda", "xarm7", "ur5")
#: Columns of the table of results.
COLUMNS: tuple[str, ...] = ("robot", "law", "setting", "seed", "task_rate", "free_rate", "status", "error", "error_max")
COLUMNS += ("drift", "torque", "roughness", "seconds")

#: Rates of a law on a robot, by both names.
Gains: TypeAlias = dict[tuple[str, str], tuple[float, float]]
Observer: TypeAlias = Callable[[str, int, int], object]


@checked
def bench(
    robots: Sequence[str] = (),
    *,
    laws: Sequence[str] = (),
    settings: Sequence[str] = (),
    seeds: int = 20,
    tuning_seeds: int = 1,
    folder: str | Path = "runs/bench",
    jobs: int = 1,
    observer: Observer | None = None,
) -> list[Row]:
    """Run laws on robots in settings, and keep a table of all that is finished in the folder, `results.csv`.

    Each law gets its two rates on each robot by the same search: every pair of a few, in runs of a setting of their
    own, with seeds of their own. Of the pairs whose torques are smooth enough those with about the least median task
    error count, and of these that with the least drift of the joints. Seeds are done one after the other, each for all
    laws, so the table is whole after each. Runs with the same seed have the same plant, start and noise.

    Args:
        robots: Names or URDF files; by default three.
        laws: Names of laws; by default all.
        settings: Names of settings; by default the usual ones.
        seeds: Number of seeds.
        tuning_seeds: Number of seeds in the search for gains.
        folder: Where finished runs are kept; the same call goes on where it was.
        jobs: Runs at the same time.
        observer: Called with what is being done, and the numbers of runs done and of all in it.

    Raises:
        UnknownNameError: There is no such law or setting.
        InputError: A number is not above 0.
    """
    laws, settings = chosen_laws(laws), chosen_settings(settings)
    robots = tuple(robots) or ROBOTS
    for value, name in ((seeds, "the number of seeds"), (tuning_seeds, "the number of seeds of the search")):
        if number(value, name, at_least=1) != int(value):
            raise InputError(f"{name} must be a whole number, got {value}")
    tell = observer or (lambda what, done, of: None)
    folder = Path(folder)
    run: dict[str, Any] = {"folder": folder / "finished", "jobs": jobs}
    gains = find_gains(robots, laws, tuning_seeds, run, tell)
    rows: list[Row] = []
    for seed in range(int(seeds)):
        trials = [
            BenchTrial.from_settings(robot, law=law, setting=setting, seed=seed, task_rate=rates[0], free_rate=rates[1])
            for setting in settings
            for (robot, law), rates in gains.items()
        ]
        found = sweep(trials, observer=partial(tell, f"seed {seed + 1} of {seeds}"), **run)
        rows += [_slim(row) for row in found]
        write_table(rows, folder / "results.csv")
    return rows


def find_gains(robots: Sequence[str], laws: Sequence[str], seeds: int, run: dict[str, Any], tell: Observer) -> Gains:
    """Rates of each law on each robot that are best in the setting for gains: by task error, then by drift.

    Pairs with rougher torques than `ROUGH` count only where a law has no others.
    """
    places = [(robot, law) for robot in robots for law in laws]
    pairs = [(task, free) for task in TASK_RATES for free in FREE_RATES]
    trials = [
        BenchTrial.from_settings(
            robot, law=law, setting="tuning", seed=TUNING_SEED + seed, task_rate=task, free_rate=free
        )
        for robot, law in places
        for task, free in pairs
        for seed in range(int(seeds))
    ]
    rows = sweep(trials, observer=partial(tell, "gains"), **run)
    found = [_slim(row) for row in rows]
    shape = len(places), len(pairs), int(seeds)
    errors, drifts, torques, roughness = (
        np.median(np.reshape([_number(row[name]) for row in found], shape), axis=2)
        for name in ("error", "drift", "torque", "roughness")
    )
    smooth = np.isfinite(roughness) & (roughness <= ROUGH * torques)
    errors = np.where(smooth | ~smooth.any(axis=1, keepdims=True), errors, np.inf)
    best = np.where(errors <= EQUAL * errors.min(axis=1, keepdims=True), drifts, np.inf)
    # Where nothing has a drift, the error decides.
    best = np.where(np.isfinite(best).any(axis=1, keepdims=True), best, errors).argmin(axis=1)
    return {place: pairs[k] for place, k in zip(places, best, strict=True)}


def _number(value: float | None) -> float:
    return np.inf if value is None or np.isnan(value) else float(value)


def _slim(row: Row) -> Row:
    """The columns of the table; a run that could not even begin counts as lost."""
    return {name: row.get(name) for name in COLUMNS} | {"error": row.get("error", LOST)}


@checked
def read_results(path: str | Path) -> list[Row]:
    """Rows of a table of results.

    Raises:
        InputError: There is no such file, or it is not such a table.
    """
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            rows: list[Row] = list(csv.DictReader(file))
        for row in rows:
            for name in ("task_rate", "free_rate", "error", "error_max", "drift", "torque", "roughness", "seconds"):
                row[name] = float(row[name]) if row[name] else float("nan")
            row["seed"] = int(row["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is no table of the bench: {error}. `eos-pin bench` writes one") from error
    if not rows:
        raise InputError(f"{path} has no runs. `eos-pin bench` writes a table with runs")
    return rows
