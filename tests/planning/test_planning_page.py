"""What docs/planning.md shows runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "planning.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("unchecked")
def test_example_of_manifolds_runs_and_finds_postures_within_limits():
    section = PAGE[PAGE.index("## Self-motion manifolds") : PAGE.index("## Scenes")]
    (example,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    names = {}
    exec(compile(example, "planning.md", "exec"), names)
    robot, task, z = names["robot"], names["task"], names["manifold"].z
    for q in (*names["postures"], names["near"], names["centred"]):
        assert ((robot.lower <= q) & (q <= robot.upper)).all()
        assert np.abs(task.minus(task.value(q), z)).max() < 1e-9
    # The posture that the point was made from is on the manifold.
    assert np.abs(names["near"] - names["q"]).max() < 1e-6
