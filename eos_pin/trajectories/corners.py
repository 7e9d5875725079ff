"""Way points joined by straight lines of the task: corners that are rounded, or stopped at."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, number
from eos_pin.errors import InputError

# The command line has the names of corners without waiting for Pinocchio.
if TYPE_CHECKING:
    from eos_pin.tasks.base import Task

Corners: TypeAlias = Literal["smooth", "round", "stop"]
#: Time of a line with rest at both ends, as a multiple of that at its largest speed.
STOPPING = 1.875
#: Places on a corner between the end of the one line, −1, and the start of the other, 1.
CORNER = np.linspace(-1.0, 1.0, 13)[1:-1]
#: Steps on the lines, in steps on the smallest corner, and the most of them.
STRIDE, MOST = 8.0, 20_000
#: Acceleration of a path without times, in units of its largest speed a second.
AGILITY = 2.0
#: Without a `blend` a corner takes this part of the shorter of its two lines.
PART = 0.1


def check_corners(corners: str, blend: float | None, timed: bool) -> None:
    """Refuse a way to pass way points that is not known, or that does not apply.

    Args:
        corners: How way points are passed.
        blend: Size of rounded corners.
        timed: Whether the way points have times.

    Raises:
        InputError: As said.
    """
    if blend is not None and corners != "round":
        raise InputError(f"a blend of {blend:g} does not apply: corners are {corners}; choose round")
    if timed and corners == "round":
        raise InputError(
            "a rounded path does not reach its way points, so that it has no times at them; leave them out"
        )


def rounded(
    task: Task, points: Float[Array, "K size"], blend: float | None = None, *, closed: bool = False
) -> Float[Array, "L size"]:
    """Points along straight lines through way points, whose corners are rounded with continuous curvature.

    The lines are those of `Task.plus`: for a pose the origin moves straight and the rotation has a constant axis. A
    corner is a polynomial of degree five; it passes its way point at a distance of 3/8 of the blend at most.

    Args:
        task: The task.
        points: Way points; of a closed path the last is the first again.
        blend: Distance from a way point at which the path leaves the line [m], or [rad] where the line only turns; half
            a line at most. By default a tenth of the shorter of the two lines.
        closed: Whether the first way point is a corner, too; the path then begins where that corner ends.

    Raises:
        InputError: The blend is not positive, or so small that the path would have too many points.
    """
    if blend is not None:
        number(blend, "the blend of corners", above=0.0)
    forth = [task._minus(b, a) for a, b in pairwise(points)]
    back = [task._minus(a, b) for a, b in pairwise(points)]
    lengths = [_length(task, line) for line in forth]
    count = len(lengths)
    # Corner k lies between the lines k − 1 and k.
    sizes = np.zeros(count + 1)
    for k in range(0 if closed else 1, count):
        shorter = min(lengths[k - 1], lengths[k])
        sizes[k] = min(PART * shorter if blend is None else blend, 0.5 * shorter)
    if closed:
        sizes[-1] = sizes[0]
    least, whole = min(sizes[sizes > 0.0], default=sum(lengths)), sum(lengths)
    stride = STRIDE * least * (CORNER[1] - CORNER[0])
    if whole > MOST * stride:
        raise InputError(
            f"corners of {least:.2g} m or rad on a path of {whole:.3g} take too many points; choose a blend of "
            f"{whole / MOST * least / stride:.2g} or more, and leave out way points that are closer together"
        )

    def corner(k: int) -> list[Array]:
        into, out = sizes[k] / lengths[k - 1] * back[k - 1], sizes[k] / lengths[k] * forth[k]
        return [task._plus(points[k], _bend(-s) * into + _bend(s) * out) for s in CORNER.tolist()]

    rows: list[Array] = []
    for k, (line, length) in enumerate(zip(forth, lengths, strict=True)):
        if k:
            rows += corner(k)
        room = length - sizes[k] - sizes[k + 1]
        ways = sizes[k] + room * np.linspace(0.0, 1.0, math.ceil(room / stride) + 1)
        rows += [task._plus(points[k], way / length * line) for way in ways.tolist()]
    if closed:
        rows += [*corner(0), rows[0]]
    return np.array(rows)


def paced(steps: Float[Array, "K m"], *, closed: bool = False) -> Float[Array, " L"]:
    """Times for points at speed 1 or less, slower where the way bends and, if it does not repeat, from and to rest.

    Args:
        steps: Ways from point to point, in units of which one a second is the largest speed.
        closed: Whether the last point is the first again.

    Returns:
        Increasing times from 0 on, (K + 1,).
    """
    lengths = np.linalg.norm(steps, axis=1)
    along = steps / lengths[:, None]
    before, after = np.roll(along, 1, axis=0), along
    bends = np.linalg.norm(after - before, axis=1) / (0.5 * (np.roll(lengths, 1) + lengths))
    squares = np.append(np.minimum(1.0, AGILITY / np.maximum(bends, AGILITY)), 1.0)
    squares[0], squares[-1] = (squares[0], squares[0]) if closed else (0.0, 0.0)
    # Forwards and backwards, twice where the end is the beginning: no speed that cannot be reached, or left, in time.
    for order in (range(len(lengths)), range(len(lengths) - 1, -1, -1)) * (2 if closed else 1):
        for k in order:
            most = squares[[k, k + 1]].min() + 2.0 * AGILITY * lengths[k]
            squares[[k, k + 1]] = np.minimum(squares[[k, k + 1]], most)
        if closed:
            squares[[0, -1]] = squares[[0, -1]].min()
    speeds = np.sqrt(squares)
    return np.concatenate(([0.0], np.cumsum(2.0 * lengths / (speeds[:-1] + speeds[1:]))))


def _length(task: Task, line: Array) -> float:
    """Length of a line [m]; its angle [rad] where it has none."""
    metres = float(np.linalg.norm([value for value, unit in zip(line, task.units, strict=True) if unit == "m"]))
    return metres if metres > 1e-9 else float(np.linalg.norm(line))


def _bend(s: float) -> float:
    """Part of the line that a corner leads to: 0 for s = −1 and s for s = 1, both with the line's slope and no bend."""
    return 0.5 * (s + 0.375 + s * s * (0.75 - 0.125 * s * s))
