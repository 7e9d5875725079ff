"""The best ways through layers of postures: dynamic programming, of closed paths for all starts at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eos_pin._arrays import Array
from eos_pin._kernels.dispatch import use_compiled

#: What a jump costs; more than any motion.
RECONFIGURATION = 1e6
#: Most postures at which closed ways begin.
STARTS = 100
#: Most laps in which postures that no closed way leads through are left out.
LAPS = 8


class Steps(NamedTuple):
    """Steps from one layer to the next.

    Attributes:
        start: Number of the posture each begins at.
        end: Number of the posture it ends at, in rising order.
        cost: Its cost.
    """

    start: Int[Array, " E"]
    end: Int[Array, " E"]
    cost: Float[Array, " E"]


def open_ways(
    nodes: Sequence[Array],
    steps: Sequence[Steps],
    scale: Array,
    most: int,
    first: Float[Array, " K"],
    *,
    end: int | None = None,
    jumps: bool = False,
) -> list[Array]:
    """The best ways from any posture of the first layer to one of the last, those that differ, as joints (L, n).

    Args:
        nodes: Postures of each layer, (n, K).
        steps: Steps from each layer to the next.
        scale: Motion of each joint that counts like a radian, (n,).
        most: How many ways.
        first: Cost of the first postures.
        end: Number of the last posture; None for any.
        jumps: Whether a jump to any posture is allowed, at the price of `RECONFIGURATION`.
    """
    values, back = [first], list[Array]()
    for k, step in enumerate(steps):
        value, via = (one[:, 0] for one in relaxed(values[-1].reshape(-1, 1), *step, nodes[k + 1].shape[1]))
        if jumps and np.isfinite(values[-1]).any():
            best = int(values[-1].argmin())
            jump = values[-1][best] + RECONFIGURATION
            worse = value > jump
            value[worse], via[worse] = jump, best
        values.append(value)
        back.append(via)
    ends = [int(e) for e in np.argsort(values[-1], kind="stable") if np.isfinite(values[-1][e])]
    if end is not None:
        ends = [e for e in ends if e == end]
    ways: list[Array] = []
    for index in ends[: 20 * most]:
        row = [nodes[-1][:, index]]
        for k in range(len(nodes) - 1, 0, -1):
            index = int(back[k - 1][index])
            row.append(nodes[k - 1][:, index])
        _add(ways, np.array(row[::-1]), scale)
        if len(ways) == most:
            break
    return ways


def closed_ways(
    nodes: Sequence[Array], steps: Sequence[Steps], scale: Array, most: int, *, begin: int | None = None
) -> list[Array]:
    """The best ways that end where they begin, those that differ: one search for each start, all starts at once.

    Arguments as in `open_ways`; the last steps lead to the first layer. `begin` is the number of the first posture; for
    any, every few of them is a start.
    """
    counts = [layer.shape[1] for layer in nodes]
    kept = _on_rounds(counts, steps)
    starts = np.arange(0, counts[0], max(1, -(-counts[0] // STARTS))) if begin is None else np.array([begin])
    starts = starts[kept[0][starts]]
    if not len(starts):
        return []
    value = np.full((counts[0], len(starts)), np.inf)
    value[starts, np.arange(len(starts))] = 0.0
    back: list[Array] = []
    for k, (start, end, cost) in enumerate(steps):
        following = (k + 1) % len(nodes)
        good = kept[k][start] & kept[following][end]
        value, via = relaxed(value, start[good], end[good], cost[good], counts[following])
        back.append(via)
    totals = value[starts, np.arange(len(starts))]
    ways: list[Array] = []
    for column in np.argsort(totals, kind="stable")[: 20 * most].tolist():
        if not np.isfinite(totals[column]):
            break
        index, row = int(starts[column]), list[Array]()
        for k in range(len(steps) - 1, -1, -1):
            index = int(back[k][index, column])
            row.append(nodes[k][:, index])
        _add(ways, np.array(row[::-1]), scale)
        if len(ways) == most:
            break
    return ways


def _on_rounds(counts: Sequence[int], steps: Sequence[Steps]) -> list[Bool[Array, " K"]]:
    """Masks of postures that steps lead to and on from, lap after lap; all of a closed way are among them."""
    kept, before = [np.ones(count, bool) for count in counts], -1
    for _ in range(LAPS):
        if (left := sum(int(mask.sum()) for mask in kept)) == before:
            break
        before = left
        for k, (start, end, _) in enumerate(steps):
            _only(kept[(k + 1) % len(kept)], end[kept[k][start]])
        for k in range(len(steps) - 1, -1, -1):
            start, end, _ = steps[k]
            _only(kept[k], start[kept[(k + 1) % len(kept)][end]])
    return kept


def _only(mask: Bool[Array, " K"], some: Int[Array, " E"]) -> None:
    """Leave out all but some."""
    of = np.zeros(len(mask), bool)
    of[some] = True
    mask &= of


def _add(ways: list[Array], way: Array, scale: Array) -> None:
    """Add a way unless one of the others is nearly the same."""
    if all(np.abs((way - other) / scale).max(axis=1).mean() > 0.5 for other in ways):
        ways.append(way)


@use_compiled
def relaxed(
    value: Float[Array, "K S"], start: Int[Array, " E"], end: Int[Array, " E"], cost: Float[Array, " E"], count: int
) -> tuple[Float[Array, "count S"], Int[Array, "count S"]]:
    """Least costs of the postures of the next layer, and where they come from (−1: nowhere), for many starts.

    Args:
        value: Costs of the postures of a layer, a column for each start.
        start: Postures that steps begin at.
        end: Postures that they end at, in rising order.
        cost: Their costs. Of steps that reach the least cost the first counts.
        count: Number of postures of the next layer.
    """
    out, via = np.full((count, value.shape[1]), np.inf), np.full((count, value.shape[1]), -1, dtype=np.intc)
    if not len(end):
        return out, via
    # A row for each step: minima of neighbouring rows are the fastest ones.
    total = value[start] + cost[:, None]
    ends, first = np.unique(end, return_index=True)
    best = np.minimum.reduceat(total, first, axis=0)
    # The first step of those that reach the least cost.
    reached = total == np.repeat(best, np.diff(np.append(first, len(end))), axis=0)
    number = np.arange(len(end), dtype=np.intc)[:, None]
    chosen = np.minimum.reduceat(np.where(reached, number, number[-1]), first, axis=0)
    out[ends], via[ends] = best, np.where(np.isfinite(best), start[chosen], -1)
    return out, via
