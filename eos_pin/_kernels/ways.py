"""The best ways through layers of postures: dynamic programming, of closed paths for all starts at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from eos_pin._arrays import Array

#: What a jump costs; more than any motion.
RECONFIGURATION = 1e6
#: Most postures at which closed ways begin.
STARTS = 100


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
        value, via = _relaxed(values[-1], step, nodes[k + 1].shape[1])
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


def closed_ways(nodes: Sequence[Array], steps: Sequence[Steps], scale: Array, most: int) -> list[Array]:
    """The best ways that end where they begin, those that differ: one search for each start, all starts at once.

    Arguments as in `open_ways`; the last steps lead to the first layer. Of many first postures every few is a start.
    """
    count = nodes[0].shape[1]
    starts = np.arange(0, count, max(1, -(-count // STARTS)))
    value = np.full((len(starts), count), np.inf)
    value[np.arange(len(starts)), starts] = 0.0
    back: list[Array] = []
    for k, step in enumerate(steps):
        value, via = _relaxed_all(value, step, nodes[(k + 1) % len(nodes)].shape[1])
        back.append(via)
    totals = value[np.arange(len(starts)), starts]
    ways: list[Array] = []
    for start in np.argsort(totals, kind="stable")[: 20 * most].tolist():
        if not np.isfinite(totals[start]):
            break
        index, row = int(starts[start]), list[Array]()
        for k in range(len(steps) - 1, -1, -1):
            index = int(back[k][start, index])
            row.append(nodes[k][:, index])
        _add(ways, np.array(row[::-1]), scale)
        if len(ways) == most:
            break
    return ways


def _add(ways: list[Array], way: Array, scale: Array) -> None:
    """Add a way unless one of the others is nearly the same."""
    if all(np.abs((way - other) / scale).max(axis=1).mean() > 0.5 for other in ways):
        ways.append(way)


def _relaxed(value: Array, steps: Steps, count: int) -> tuple[Array, Array]:
    """Least cost of each posture of the next layer, and where it comes from."""
    out, via = np.full(count, np.inf), np.full(count, -1)
    if len(steps.end):
        total = value[steps.start] + steps.cost
        order = np.lexsort((total, steps.end))
        ends, first = np.unique(steps.end[order], return_index=True)
        out[ends], via[ends] = total[order][first], steps.start[order][first]
    return out, via


def _relaxed_all(value: Array, steps: Steps, count: int) -> tuple[Array, Array]:
    """The same for many starts, the rows of `value`."""
    S = len(value)
    out, via = np.full((S, count), np.inf), np.full((S, count), -1, dtype=np.int32)
    if not len(steps.end):
        return out, via
    # A row for each step: minima of neighbouring rows are the fastest ones.
    total = value.T[steps.start] + steps.cost[:, None]
    ends, first = np.unique(steps.end, return_index=True)
    best = np.minimum.reduceat(total, first, axis=0)
    # The first step of those that reach the least cost.
    reached = total == np.repeat(best, np.diff(np.append(first, len(steps.end))), axis=0)
    number = np.arange(len(steps.end), dtype=np.int32)[:, None]
    chosen = np.minimum.reduceat(np.where(reached, number, number[-1]), first, axis=0)
    out[:, ends], via[:, ends] = best.T, steps.start[chosen].T
    return out, via
