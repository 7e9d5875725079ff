"""What pages show that is made of their own code: `python docs/figures.py`; the build of the site makes the rest."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def learning_curve() -> Path:
    """Learning curve of the example in learning.md, with the return of an arm whose self-motion rests."""
    from matplotlib.figure import Figure

    from eos_pin.plots.pages import save, style

    (code,) = re.findall(r"```python\n(.*?)```", (HERE / "learning.md").read_text(encoding="utf-8"), re.DOTALL)
    made: dict[str, Any] = {}
    exec(compile(code, "learning.md", "exec"), made)
    with style():
        figure = Figure((5.0, 2.6), layout="constrained")
        ax = figure.add_subplot()
        rounds = range(1, 1 + len(made["curve"]))
        ax.plot(rounds, made["curve"], "o-", label="mean of the policies tried")
        ax.axhline(made["before"][0], color="0.6", linestyle="--", label="v held")
        ax.axhline(made["after"][0], color="#009E73", linestyle=":", label="learned, mean policy")
        ax.set(xlabel="round of the cross-entropy method, ten policies each", ylabel="return of an episode")
        ax.set_xticks(list(rounds))
        ax.legend()
        return save(figure, HERE / "learning.png")


def explorer(folder: Path) -> Path:
    """The explorer of the tutorial, one file."""
    import numpy as np

    from eos_pin import PoseTask, load_robot
    from eos_pin.viewer.explorer import write_explorer

    robot = load_robot("panda", chain_to="panda_hand_tcp")
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    return write_explorer(folder / "explore-panda.html", PoseTask(robot, "panda_hand_tcp"), q)


if __name__ == "__main__":
    print(learning_curve())
