"""The arcs of a component on which joints are within limits and clear of collision."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from eos_pin._arrays import Array, JointVector, Vector
from eos_pin.planning.manifolds.components import TAU, Component

#: A turning point this close to a limit is computed exactly before it is compared with it [rad or m].
NEAR = 0.02
#: Arcs end by so much before the limit is reached, lest rounding lead across it [rad or m].
INSIDE = 1e-12
#: Arc length to which the ends of arcs at collisions are found.
BISECTED = 1e-6


class Arc(NamedTuple):
    """A connected piece of a component that is within limits and clear.

    Attributes:
        component: Number of the component.
        start: Arc length where it starts.
        end: Arc length where it ends; on a closed component it may be beyond one round or several.
        shift: Whole turns that are added to the component's joints to be within limits, (n,).
        closed: Whether it is the whole of a closed component, so that its ends are one point.
        causes: Causes of its start and of its end: `"lower limit of NAME"`, `"upper limit of NAME"`,
            `"collision"`, `"singularity"`, `"length"` where the curve was not followed any further; empty where it is
            closed.
    """

    component: int
    start: float
    end: float
    shift: Int[Array, " n"]
    closed: bool
    causes: tuple[str, str]

    @property
    def length(self) -> float:
        """Arc length from start to end."""
        return self.end - self.start


#: A piece of one round: start, end, whole turns of each joint, causes.
_Piece = tuple[float, float, tuple[int, ...], tuple[str, str]]

_OPEN = {"singular": "singularity", "long": "length", "closed": ""}


def arcs_within(component: Component, number: int, lower: JointVector, upper: JointVector) -> list[Arc]:
    """Arcs of a component on which all joints are within limits, from the start of the component on.

    Args:
        component: The component.
        number: Its number, which the arcs keep.
        lower: Least value of each joint, −inf for none.
        upper: Largest value of each joint, inf for none.
    """
    n = component.kinematics.n
    start, end = (_OPEN[kind] for kind in component.curve.ends)
    limited = np.isfinite(lower) | np.isfinite(upper)
    spans = [_spans(component, joint, lower[joint], upper[joint]) for joint in np.flatnonzero(limited).tolist()]
    pieces: list[_Piece] = [(0.0, component.length, (0,) * n, (start, end))]
    if not all(spans):
        return []
    flat = [span for several in spans for span in several]
    monotone = _monotone(component, lower, upper, limited)
    cuts = _cuts(component, flat, monotone)
    own: dict[int, list[tuple[float, float, int, tuple[str, str]]]] = {}
    for span, some in zip(flat, cuts, strict=True):
        x_start = float(monotone[span.joint][1][0])
        own.setdefault(span.joint, []).extend(_inside(component, span, some, x_start, (start, end)))
    for joint, parts in own.items():
        pieces = [both for piece in pieces for part in parts if (both := _overlap(piece, part, joint))]
    return sorted(
        _joined(component, number, pieces, np.where(limited, component.winding, 0)), key=lambda arc: arc.start
    )


class _Span(NamedTuple):
    """The limits of one joint, moved by whole turns to where the component is."""

    joint: int
    turn: int
    lower: float
    upper: float


def _spans(component: Component, joint: int, lower: float, upper: float) -> list[_Span]:
    """Its limits where its values on the component reach."""
    which, _, bends = component.bends
    x = component.curve.q[:, joint]
    bends = bends[which == joint]
    # What the cubics get wrong must not lose one.
    least, most = (
        float(end(x.min() if end is min else x.max(), end(bends, default=x[0]) + slack))
        for end, slack in ((min, -NEAR), (max, NEAR))
    )
    if not component.kinematics.revolute[joint]:
        return [_Span(joint, 0, lower, upper)] if least <= upper and most >= lower else []
    # Without a lower limit any turn will do that is below the upper one; the turn next to it is taken.
    first = math.ceil(((lower if np.isfinite(lower) else upper - TAU) - most) / TAU)
    last = math.floor(((upper if np.isfinite(upper) else lower + TAU) - least) / TAU)
    return [_Span(joint, turn, lower - TAU * turn, upper - TAU * turn) for turn in range(first, last + 1)]


def _monotone(
    component: Component, lower: JointVector, upper: JointVector, limited: Array
) -> dict[int, tuple[Array, Array]]:
    """For each limited joint arc lengths between which it goes one way only, and its values there."""
    joint, s, x = component.bends
    off = np.full(len(s), np.inf)
    for bound in (lower[joint], upper[joint]):
        with np.errstate(invalid="ignore"):
            gap = x - bound
            gap = np.where(component.kinematics.revolute[joint], gap - TAU * np.round(gap / TAU), gap)
        off = np.fmin(off, np.abs(gap))
    near = np.flatnonzero(off < NEAR)
    if len(near):
        s, x = s.copy(), x.copy()
        s[near] = component.refine_bends(joint[near], s[near])
        x[near] = component.at(s[near])[np.arange(len(near)), joint[near]]
    found = {}
    for i in np.flatnonzero(limited).tolist():
        own = joint == i
        at = np.concatenate((component.nodes, s[own]))
        order = np.argsort(at, kind="stable")
        found[i] = at[order], np.concatenate((component.curve.q[:, i], x[own]))[order]
    return found


def _cuts(
    component: Component, spans: Sequence[_Span], monotone: dict[int, tuple[Array, Array]]
) -> list[tuple[Array, Array]]:
    """For each span the arc lengths at which the joint crosses its lower and its upper bound."""
    rows: list[tuple[Array, ...]] = []
    sizes = []
    for span in spans:
        s, x = monotone[span.joint]
        for limit in (span.lower, span.upper):
            side = x >= limit
            i = np.flatnonzero(side[1:] != side[:-1])
            sizes.append(len(i))
            rows.append((s[i], s[i + 1], x[i], x[i + 1], np.full(len(i), limit), np.full(len(i), span.joint)))
    if not rows:
        return []
    low, high, x_low, x_high, bound, joint = (np.concatenate(column) for column in zip(*rows, strict=True))
    roots = np.split(_roots(component, low, high, x_low, x_high, bound, joint.astype(int)), np.cumsum(sizes)[:-1])
    return list(zip(roots[::2], roots[1::2], strict=True))


def _roots(
    component: Component, low: Vector, high: Vector, x_low: Vector, x_high: Vector, bound: Vector, joint: Array
) -> Vector:
    """Arc lengths between `low` and `high` at which each joint has the value `bound`; Newton's method, safeguarded."""
    if not len(low):
        return low
    rows, rising = np.arange(len(low)), x_high > x_low
    root = low + (high - low) * (bound - x_low) / (x_high - x_low)
    for _ in range(60):
        q = component.at(root)
        left = q[rows, joint] - bound
        above = left >= 0.0
        high, low = np.where(above == rising, root, high), np.where(above == rising, low, root)
        done = (np.abs(left) <= INSIDE) | (high - low <= 1e-13)
        if done.all():
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = root - left / component.along(q)[rows, joint]
        ahead = np.where((ahead > low) & (ahead < high), ahead, 0.5 * (low + high))
        root = np.where(done, root, ahead)
    return root


def _inside(
    component: Component, span: _Span, cuts: tuple[Array, Array], x: float, ends: tuple[str, str]
) -> list[tuple[float, float, int, tuple[str, str]]]:
    """Intervals of arc length on which a joint is within a span, x being its value at the start."""
    name = component.kinematics.joint_names[span.joint]
    beyond = [x < span.lower, x >= span.upper]
    events = sorted((float(s), bound) for bound, some in enumerate(cuts) for s in some)
    causes = (f"lower limit of {name}", f"upper limit of {name}")
    pieces, start, first = [], 0.0, ends[0]
    for s, bound in events:
        if not any(beyond) and start < s:
            pieces.append((start, s, span.turn, (first, causes[bound])))
        beyond[bound] = not beyond[bound]
        start, first = s, causes[bound]
    if not any(beyond) and start < component.length:
        pieces.append((start, component.length, span.turn, (first, ends[1])))
    return pieces


def _overlap(piece: _Piece, other: tuple[float, float, int, tuple[str, str]], joint: int) -> _Piece | None:
    """Intersection of two pieces."""
    a, first = max((piece[0], piece[3][0]), (other[0], other[3][0]), key=lambda end: end[0])
    b, last = min((piece[1], piece[3][1]), (other[1], other[3][1]), key=lambda end: end[0])
    if not a < b:
        return None
    shift = (*piece[2][:joint], other[2], *piece[2][joint + 1 :])
    return a, b, shift, (first, last)


def _joined(component: Component, number: int, pieces: Sequence[_Piece], winding: Array) -> list[Arc]:
    """Arcs from pieces of one round, joined where one goes on in the next round."""
    length = component.length
    heads = {piece[2]: piece for piece in pieces if piece[0] == 0.0} if component.closed else {}
    tails = {tuple(np.add(piece[2], winding).tolist()) for piece in pieces if piece[1] == length}
    arcs = []
    for piece in pieces:
        whole = piece[0] == 0.0 and piece[1] == length
        if component.closed and whole and not winding.any():
            arcs.append(Arc(number, 0.0, length, np.array(piece[2]), True, ("", "")))
            continue
        if component.closed and piece[0] == 0.0 and piece[2] in tails:
            continue
        end, last, rounds = piece, piece, 0
        while component.closed and last[1] == length:
            following = heads.get(tuple(np.add(last[2], winding).tolist()))
            if following is None:
                break
            end, last, rounds = following, following, rounds + 1
        causes = piece[3][0], end[3][1]
        arcs.append(Arc(number, piece[0], end[1] + rounds * length, np.array(piece[2]), False, causes))
    return arcs


def clear_arcs(
    component: Component, arc: Arc, collision: Callable[[JointVector], bool], spacing: float = 0.05
) -> list[Arc]:
    """Arcs on which a robot does not collide.

    Args:
        component: The component of the arc.
        arc: An arc within limits.
        collision: Whether the robot collides at joints.
        spacing: Arc length from look to look; a collision on less than that may be missed.
    """
    count = max(2, math.ceil(arc.length / spacing) + 1)
    s = np.linspace(arc.start, arc.end, count)
    q = arc_joints(component, arc, s)
    free = np.array([not collision(x) for x in q])
    if free.all():
        return [arc]

    def edge(clear: float, hit: float) -> float:
        while abs(hit - clear) > BISECTED:
            middle = 0.5 * (clear + hit)
            if collision(arc_joints(component, arc, np.array([middle]))[0]):
                hit = middle
            else:
                clear = middle
        return clear

    bounds = np.flatnonzero(free[1:] != free[:-1])
    starts = [arc.start] if free[0] else []
    starts += [edge(s[i + 1], s[i]) for i in bounds if free[i + 1]]
    ends = [edge(s[i], s[i + 1]) for i in bounds if free[i]]
    ends += [arc.end] if free[-1] else []
    found = []
    for start, end in zip(starts, ends, strict=True):
        causes = (
            arc.causes[0] if start == arc.start and not arc.closed else "collision",
            arc.causes[1] if end == arc.end and not arc.closed else "collision",
        )
        found.append(arc._replace(start=start, end=end, closed=False, causes=causes))
    if arc.closed and len(found) > 1 and free[0]:
        # The first and the last are one, across the seam.
        first, *others, last = found
        found = [*others, last._replace(end=first.end + component.length)]
    return found


def arc_joints(component: Component, arc: Arc, s: Vector) -> Float[Array, "K n"]:
    """Joints of an arc at arc lengths."""
    return component.at(s) + TAU * arc.shift
