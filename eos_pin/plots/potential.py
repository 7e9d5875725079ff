"""Figure of the potential energy along a self-motion manifold, with its equilibria."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from eos_pin.planning.manifolds.equilibria import Equilibrium
from eos_pin.planning.manifolds.manifold import SelfMotionManifold
from eos_pin.plots._style import BLUE, PAGE, style

#: Points of a curve.
POINTS = 400
SHADE = "#c8c8c8"


def potential(manifold: SelfMotionManifold, found: Sequence[Equilibrium]) -> Figure:
    """Potential energy along each component of a manifold with one redundant joint.

    Where joints are beyond their limits the figure is shaded; filled marks are stable equilibria, open ones unstable.
    """
    robot, count = manifold.task.robot, len(manifold.components)
    columns = 1 if count < 3 else 2
    rows = -(-count // columns)
    with style():
        figure = Figure(figsize=(PAGE, 0.25 * PAGE * rows + 0.1 * PAGE), layout="constrained")
        axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for ax in axes.flat[count:]:
            ax.set_visible(False)
        for i, (component, ax) in enumerate(zip(manifold.components, axes.flat, strict=False)):
            s = np.linspace(0.0, component.length, POINTS)
            energy = [robot._potential_energy(q) for q in component.at(s)]
            ax.plot(s, energy, color=BLUE)
            allowed = np.zeros(POINTS, dtype=bool)
            for arc in (arc for arc in manifold.arcs if arc.component == i):
                for k in range(-2, 3) if component.closed else range(1):
                    place = s + k * component.length
                    allowed |= (place >= arc.start) & (place <= arc.end)
            ax.fill_between(
                s, 0.0, 1.0, where=~allowed, transform=ax.get_xaxis_transform(), color=SHADE, alpha=0.5, lw=0
            )
            for each in (each for each in found if each.component == i):
                ax.plot(each.s, each.potential, "o", color=BLUE, mfc=BLUE if each.stable else "white", ms=5, zorder=3)
            ax.set_title(f"component {i}" + (", closed" if component.closed else ""), loc="left")
            ax.set_xlim(0.0, component.length)
        for ax in axes[:, 0]:
            ax.set_ylabel("potential energy [J]")
        for ax in axes[-1]:
            ax.set_xlabel("arc length [rad]")
        figure.suptitle("● stable   ○ unstable   shaded: beyond joint limits", x=0.01, ha="left", size=7)
    return figure
