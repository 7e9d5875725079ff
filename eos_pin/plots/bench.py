"""The figure of the bench: task errors of all laws in all settings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from eos_pin._arrays import Array
from eos_pin.plots._style import style

#: Ratios beyond which colours are all the same.
MOST = 8.0


def ratios(titles: Sequence[str], settings: Sequence[str], values: Array, best: Array) -> Figure:
    """Task errors relative to EOS as a map: blue is better, red is worse, a dot marks the best of each setting.

    Args:
        titles: Names of the laws.
        settings: Names of the settings.
        values: Ratios, a row for each law and a column for each setting.
        best: Which of them are best, or not shown to be worse than the best.
    """
    with style():
        figure = Figure(figsize=(1.9 + 0.75 * len(settings), 1.5 + 0.27 * len(titles)), layout="constrained")
        ax = figure.subplots()
        most = np.log2(MOST)
        image = ax.imshow(np.clip(np.log2(values), -most, most), cmap="RdBu_r", vmin=-most, vmax=most, aspect="auto")
        for row, column in zip(*np.nonzero(best), strict=True):
            ax.plot(column, row, "o", color="black", markersize=4.0)
        ax.set_xticks(range(len(settings)), settings, rotation=40, ha="right")
        ax.set_yticks(range(len(titles)), titles)
        ax.grid(visible=False)
        bar = figure.colorbar(image, ax=ax, shrink=0.8)
        ticks = np.arange(-most, most + 0.5)
        bar.set_ticks(ticks.tolist(), labels=[f"{2.0**tick:g}" for tick in ticks])
        bar.set_label("task error relative to EOS")
    return figure
