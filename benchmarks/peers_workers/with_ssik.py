# mypy: disable-error-code="import-not-found,import-untyped"
"""ssik: closed-form self-motion of some arms with seven joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import ssik
from serve import Call, Problem, serve

#: Two pieces are one where their ends are this close, as they are at a fold [rad].
FOLD = 1e-5
#: Points of each piece, and how far they stay from its ends, where its closed form loses digits.
POINTS, ASIDE = 12, 0.05


def build(problem: Problem) -> Mapping[str, Call]:
    """Its manifolds; it has no part in other comparisons."""
    if not hasattr(problem, "base"):
        return {}
    arm = ssik.Manipulator.from_urdf(problem.urdf, base=problem.base, ee=problem.frame)
    if not arm.solver_name.endswith(("spherical_shoulder", "srs")):
        raise NotImplementedError(f"no closed-form manifold for {arm.solver_name}")

    def points(given: np.ndarray) -> np.ndarray:
        """Points of each connected part: its number, then the joints."""
        rows = []
        for number, pieces in enumerate(_glued(arm.self_motion(given.reshape(4, 4)))):
            for chart, low, high in pieces:
                q = chart.q(low + (high - low) * np.linspace(ASIDE, 1.0 - ASIDE, POINTS))
                rows += [[number, *x] for x in q if np.isfinite(x).all()]
        return np.array(rows)

    def located(given: np.ndarray) -> np.ndarray:
        """Whether joints are on its manifold; it confirms parts, too, that its list lacks."""
        return np.array([arm.self_motion(given[:16].reshape(4, 4)).locate(given[16:], 1e-6) is not None], dtype=float)

    def charts(given: np.ndarray) -> np.ndarray:
        """All it knows, without points: what is timed."""
        return np.array([len(arm.self_motion(given.reshape(4, 4)).charts)], dtype=float)

    return {"manifold:points": points, "manifold:located": located, "manifold:charts": charts}


def _glued(family: Any) -> list[list[tuple[Any, float, float]]]:
    """Connected parts: pieces of its charts that meet at their ends, each with its interval."""
    pieces = [(chart, low, high) for chart in family.charts for low, high in chart.domain]
    if family.periodic:
        return [[piece] for piece in pieces]
    part = list(range(len(pieces)))
    ends = [(i, q) for i, (chart, *span) in enumerate(pieces) for q in chart.q(np.array(span))]
    for a, (i, q) in enumerate(ends):
        for j, p in ends[a + 1 :]:
            if np.abs(np.remainder(q - p + np.pi, 2.0 * np.pi) - np.pi).max() <= FOLD:
                part = [part[j] if number == part[i] else number for number in part]
    return [[piece for piece, number in zip(pieces, part, strict=True) if number == each] for each in sorted(set(part))]


if __name__ == "__main__":
    serve(build)
