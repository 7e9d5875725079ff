"""The page of the bench in Markdown, made of its table of results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eos_pin.experiments.bench.harness import FREE_RATES, ROBOTS, ROUGH, TASK_RATES
from eos_pin.experiments.bench.laws import LAWS, STATED_ERROR
from eos_pin.experiments.bench.settings import RATE, SETTINGS, USUAL
from eos_pin.experiments.bench.trial import DURATION, LOST, OFF, PERIOD, SETTLED, SIZE
from eos_pin.experiments.bench.verdict import ALIKE, Verdict, enough, verdict
from eos_pin.experiments.trial import Row

HEAD = """# Control laws compared

<!-- Written by `{command}`; changes go into eos_pin/experiments/bench/page.py. -->
"""
#: Families of laws that published comparisons rank.
EIGHT: tuple[str, ...] = ("velocity-integrated", "velocity", "null-space-dynamics", "acceleration")
EIGHT += ("acceleration-torque", "gauss", "decoupled", "decoupled-springs")


def page(rows: Sequence[Row], command: str, figure: str = "") -> str:
    """The page "Control laws compared".

    Args:
        rows: Results, see `bench`.
        command: Command that writes it.
        figure: Name of the figure; empty for none.
    """
    robots, laws = (list(dict.fromkeys(row[name] for row in rows)) for name in ("robot", "law"))
    settings = list(dict.fromkeys(row["setting"] for row in rows))
    verdicts = [verdict(rows, setting) for setting in settings]
    parts = [
        HEAD.format(command=command),
        _counts(rows, verdicts, robots, laws, command),
        _in_short(verdicts),
        _where(verdicts),
        "## Task error, relative to EOS\n\nMedian over robots and seeds of the ratio of root-mean-square task errors "
        "in runs that are paired; below 1 is better than EOS. **Bold** is the best of its column, or not shown to be "
        f"worse than the best. † some runs were lost, ‡ half of them or more (an error of {LOST:g} m or an early end).",
        _ratios(verdicts, laws),
        f"![Task errors relative to EOS]({figure})" if figure else "",
        "## Other figures\n\nMedians over all runs that were not lost. Drift is the largest change of a joint over the "
        f"second round; torque is the root mean square from {SETTLED:g} s on, roughness that of its second differences "
        "at 100 Hz, where chattering and noise show; time is that of a whole run on this machine, plant included.",
        _others(rows, laws),
        _findings(verdicts, rows, laws),
        _how(rows),
    ]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _counts(
    rows: Sequence[Row], verdicts: Sequence[Verdict], robots: Sequence[str], laws: Sequence[str], command: str
) -> str:
    """Numbers of runs and pairs, and settings that were left out."""
    pairs = f"{verdicts[0].pairs} pairs of runs for each two laws in each of {len(verdicts)} settings"
    if len({v.pairs for v in verdicts}) > 1:
        counts = _list([f"{v.pairs} with {SETTINGS[v.setting].title}" for v in verdicts])
        pairs = f"so many pairs for each two laws: {counts}"
    missing = [name for name in USUAL if name not in {v.setting for v in verdicts}]
    left = f" Not run for this page: {_settings(missing)}." if missing else ""
    whole = len(LAWS) * len(ROBOTS) * len(USUAL) * 20
    if len(rows) < whole:
        others = "other robots and settings" if missing else "other robots"
        left += f" That is {len(rows) / whole:.1%} of the whole bench, so it says little about {others}."
    return (
        f"{len(laws)} laws on {', '.join(robots)}: {len(rows):,} runs, {pairs}."
        f"{left} `{command}` runs all on three robots with 20 seeds, keeps what is finished, and writes "
        "this page."
    )


def _title(law: str) -> str:
    return LAWS[law].title if law in LAWS else law


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def _settings(names: Sequence[str]) -> str:
    return _list([SETTINGS[name].title for name in names])


def _in_short(verdicts: Sequence[Verdict]) -> str:
    """Winners, and settings without one."""
    lines = ["## In short", ""]
    won = {v.winner: [w.setting for w in verdicts if w.winner == v.winner] for v in verdicts if v.winner}
    for law, where in sorted(won.items(), key=lambda item: -len(item[1])):
        lines.append(f"* **{_title(law)}** is better than every other law with {_settings(where)}.")
    none = [v.setting for v in verdicts if not v.winner]
    if none:
        lines.append(f"* No winner with {_settings(none)}: several laws are as good, as far as these runs show.")
    needed = enough(len(verdicts[0].standings))
    few = [v.setting for v in verdicts if not v.decided]
    if few:
        there = "all settings" if len(few) == len(verdicts) else _settings(few)
        lines.append(f"* Fewer than {needed} pairs with {there}: nothing can be shown there.")
    return "\n".join(lines)


def _where(verdicts: Sequence[Verdict]) -> str:
    """Settings in which EOS is worse than the best law."""
    lines = ["## Where EOS is not the best", ""]
    fine = []
    for v in verdicts:
        own = next((s for s in v.standings if s.law == "eos"), None)
        if own is None:
            continue
        if own.best:
            fine.append(v.setting)
            continue
        best = v.standings[0]
        lines.append(
            f"* {SETTINGS[v.setting].title}: {_title(best.law)} has {1.0 / own.ratio:.2f} times its error (EOS "
            f"{own.ratio:.2f} times, 95 % interval {own.low:.2f} to {own.high:.2f}, p = {own.p:.2g}, {v.pairs} pairs)."
        )
    lines.append(
        f"* Among the best, or not shown to be worse, it is with {_settings(fine)}." if fine else
        "* There is no setting here in which it is among the best."
    )  # fmt: skip
    return "\n".join(lines)


def _ratios(verdicts: Sequence[Verdict], laws: Sequence[str]) -> str:
    lines = ["| law | " + " | ".join(SETTINGS[v.setting].title for v in verdicts) + " |"]
    lines.append("|---" * (len(verdicts) + 1) + "|")
    for law in laws:
        cells = []
        for v in verdicts:
            s = next(s for s in v.standings if s.law == law)
            text = f"{s.to_eos:.2f}" if s.to_eos < 100.0 else ">100" if s.to_eos >= 100.0 else ""
            mark = "‡" if s.lost * 2 >= v.pairs else "†" if s.lost else ""
            cells.append((f"**{text}**" if s.best and v.decided else text) + mark)
        lines.append(f"| {_title(law)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _others(rows: Sequence[Row], laws: Sequence[str]) -> str:
    lines = [
        "| law | source | rates found [1/s] | drift [mrad, mm] | torque [N m] | roughness [N m] | time [s] | lost |"
    ]
    lines.append("|---" * 8 + "|")
    for law in laws:
        own = [row for row in rows if row["law"] == law]
        good = [row for row in own if row["error"] < LOST]
        rates = {row["robot"]: f"{row['task_rate']:g}/{row['free_rate']:g}" for row in own}
        medians = [
            _median([scale * row[name] for row in good])
            for name, scale in (("drift", 1e3), ("torque", 1.0), ("roughness", 1.0), ("seconds", 1.0))
        ]
        source = LAWS[law].source if law in LAWS else ""
        lost = f"{len(own) - len(good)} of {len(own)}"
        lines.append(f"| {_title(law)} | {source} | {', '.join(rates.values())} | {' | '.join(medians)} | {lost} |")
    return "\n".join(lines)


def _median(values: Sequence[float]) -> str:
    finite = [value for value in values if np.isfinite(value)]
    return f"{np.median(finite):.3g}" if finite else "–"


def _overall(verdicts: Sequence[Verdict], laws: Sequence[str]) -> dict[str, float]:
    """Geometric mean over settings of the median ratio to EOS."""
    logs: dict[str, list[float]] = {law: [] for law in laws}
    for v in verdicts:
        for s in v.standings:
            logs[s.law].append(np.log(s.to_eos))
    return {law: float(np.exp(np.mean(values))) for law, values in logs.items()}


def _findings(verdicts: Sequence[Verdict], rows: Sequence[Row], laws: Sequence[str]) -> str:
    """The findings of two papers, and whether they are found again."""
    lines = ["## Findings of others, found again or not", ""]
    overall = _overall(verdicts, laws)
    eight = sorted((law for law in EIGHT if law in laws), key=lambda law: overall[law])
    if len(eight) > 1:
        place = 1 + eight.index("acceleration") if "acceleration" in eight else 0
        ranked = "; ".join(f"{_title(law)} {overall[law]:.2f}" for law in eight)
        verdict_of_paper = (
            "found again" if place == 1 else f"not found here, where it is number {place} of {len(eight)}"
        )
        lines.append(
            "* Nakanishi et al. (2008), as recollected, prefer simplified acceleration 1 of their eight, and find that "
            f"laws in forces suffer from errors of the mass matrix. The preference is {verdict_of_paper} "
            f"(geometric mean over the settings of the error relative to EOS: {ranked}). Here every law gets its gains "
            "by a search."
        )
        if eight[0] == "velocity-integrated":
            lines.append(
                "* The integrated velocity is ahead of the eight because its desired joints integrate the task error: "
                "it has an integral term, which no other law here has."
            )
    lost = {law: np.mean([row["error"] >= LOST for row in rows if row["law"] == law]) for law in laws}
    if {"successive-static", "successive-dynamic"} <= set(laws):
        ratio = overall["successive-static"] / overall["successive-dynamic"]
        found = "Found again" if ratio > 1.0 + ALIKE else "Not found here"
        lines.append(
            "* Dietrich et al. (2015): projectors of static consistency let lower levels disturb the task, those of "
            f"dynamic consistency do not. {found}: the error with the static one is {ratio:.2f} times that with the "
            "dynamic one."
        )
    if {"least-torque", "least-torque-damped"} <= set(laws):
        share = lost["least-torque"], lost["least-torque-damped"]
        found = "Found again" if share[0] > share[1] else "Not found here"
        lines.append(
            "* Hollerbach and Suh (1987): least torques alone are unstable over long motions, with damping in the null "
            f"space they are not. {found}: {share[0]:.0%} of the runs without damping are lost, {share[1]:.0%} with."
        )
    if "sliding-mode" in laws:
        lines.append(
            f"* Sliding mode is made for a model error of {STATED_ERROR:.0%} of masses, centres and moments. In its "
            "boundary layer it is PD control with the mass matrix, as EOS, so with the same gains and the same noise "
            f"the errors are about the same (geometric mean {overall['sliding-mode']:.2f} times those of EOS); what it "
            "has beside is a bound on them, and a switching term that is cut. `python benchmarks/sliding_mode.py` "
            "compares the two at equal gains."
        )
    return "\n".join(lines) if len(lines) > 2 else ""


def _how(rows: Sequence[Row]) -> str:
    laws = {row["law"] for row in rows}
    times = [row["seconds"] for row in rows if np.isfinite(row["seconds"])]
    total = float(np.sum(times))
    whole = len(LAWS) * len(ROBOTS) * len(USUAL) * 20
    return f"""## How it is done

The tool follows a figure eight of {SIZE:.0%} of the robot's reach in {PERIOD:g} s, twice; the error counts from
{SETTLED:g} s of {DURATION:g} s on. A seed draws the joints at the start ({OFF:g} rad off), the plant's bodies and the
noise: runs of one seed differ in the law only. Torques are held at {RATE:g} Hz unless the setting says otherwise. Each
law has two rates, ω of the task (kp = ω², kd = 2ω) and one of the posture or of v, found on each robot among
{len(TASK_RATES)} × {len(FREE_RATES)} pairs in runs of a setting of their own (model 15 % off, noise, 2 ms delay,
friction), by task error and, among about equal ones, by drift. Pairs do not count whose torque is rougher than
{ROUGH:.0%} of the torque itself: task errors fall with rising gains far beyond what a motor bears. So all laws have
about the same noise in their torques, and differ by what they make of it. That is a small search, the same for all: a
law whose best gains lie elsewhere is better than it looks here.

The laws of others are in `eos_pin.control.rivals`, such as `eos_pin.control.rivals.sliding.SlidingModeController`: for
comparisons, and no part of the names at the top of the package.

Runs are paired by robot and seed. A law is worse than the best where its median ratio is above {1.0 + ALIKE:g}, its
bootstrap interval lies above 1, and Wilcoxon's signed-rank test rejects at 5 % after Holm's correction for all laws of
the setting. With less than {enough(len(laws))} pairs of so many laws that test cannot reject. The {len(rows):,} runs
took {total / 60.0:.1f} minutes of one core; the whole bench of {whole:,} would take
{whole * total / len(times) / 3600.0:.1f} hours of one core.
{_at_the_edge(rows)}"""


def _at_the_edge(rows: Sequence[Row]) -> str:
    """Number of searches for gains that ended at the highest rate of the task that is offered."""
    found = {(row["robot"], row["law"]): row["task_rate"] for row in rows}
    high = sum(rate == max(TASK_RATES) for rate in found.values())
    most = max(TASK_RATES)
    return f"Of the {len(found)} searches {high} ended at the highest rate of the task that is tried, {most:g} 1/s."
