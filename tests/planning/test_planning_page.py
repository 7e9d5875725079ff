"""What docs/planning.md shows runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "planning.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("unchecked")
def test_examples_of_the_page_run_and_find_postures_within_limits():
    pytest.importorskip("toppra")
    names = {}
    exec(compile("\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)), "planning.md", "exec"), names)
    robot, pose, z = names["robot"], names["pose"], names["manifold"].z
    for q in (*names["postures"], names["near"], names["centred"]):
        assert ((robot.lower <= q) & (q <= robot.upper)).all()
        assert np.abs(pose.minus(pose.value(q), z)).max() < 1e-9
    # The posture that the point was made from is on the manifold.
    assert np.abs(names["near"] - names["q"]).max() < 1e-6
