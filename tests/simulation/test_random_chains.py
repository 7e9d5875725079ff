"""Random robots and tasks, a few of the thousand of benchmarks/random_chains.py."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import random_chains


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("seed", [1, 6, 7, 8, 16, 17, 21, 23])
def test_random_chain_keeps_all_identities(seed: int) -> None:
    figures = random_chains.examine(seed)
    assert figures.wrong == (), figures


@pytest.mark.usefixtures("unchecked")
def test_wrong_figure_is_noticed() -> None:
    figures = random_chains.examine(16)
    for name in random_chains.BOUNDS:
        assert replace(figures, **{name: np.nan}).wrong == (name,)
    assert replace(figures, endings="track singular").wrong == ("endings",)
    assert replace(figures, anywhere="diverged").wrong == ("anywhere",)
