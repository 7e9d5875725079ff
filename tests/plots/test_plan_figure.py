"""The redundancy map and the figure of a plan."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure

from eos_pin import PoseTask, PositionTask, load_robot, plan
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.plots import plan as drawing
from eos_pin.plots.plan import KINDS, picture, redundancy_map

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda", chain_to="panda_hand_tcp")


def straight(panda, task):
    start = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    pose = panda.placement(start, "panda_hand_tcp")
    points = [pin.SE3(pose.rotation, pose.translation + np.array([0.0, y, 0.0])) for y in np.linspace(0.0, 0.1, 5)]
    return plan(task, points if task.m == 6 else [p.translation for p in points], start=start)


def test_redundancy_map_shades_limits_and_collisions_and_the_plan_lies_where_it_is_allowed(panda, monkeypatch):
    monkeypatch.setattr(drawing, "PLACES", 12)
    found = straight(panda, PoseTask(panda, "panda_hand_tcp"))
    bodies = Bodies.of(panda, {"panda_link4": Capsule([0, 0, 0], [0, 0, 0], 0.06)})
    elbow = panda.placement(found.q[0], "panda_link4").translation
    clearances = Clearances(bodies, Scene([Box(elbow + np.array([0.0, 0.3, 0.0]), [0.1, 0.1, 0.1])]))
    ax = Figure().subplots()
    redundancy_map(ax, found, clearances)
    (mesh,), (line,) = ax.collections, ax.lines
    image = np.ma.filled(mesh.get_array().astype(float), np.nan)
    grid = np.asarray(mesh.get_coordinates())[:, 0, 1]
    assert {0.0, 1.0} <= set(np.unique(image[np.isfinite(image)]))
    rows = np.clip(np.searchsorted(grid, line.get_ydata()) - 1, 0, len(image) - 1)
    assert (image[rows, np.arange(12)] == 0.0).all()
    assert abs(line.get_ydata()[0]) < 1e-6
    assert {text.get_text() for text in ax.get_legend().get_texts()} <= {"plan", *(name for name, _ in KINDS)}


def test_picture_of_a_plan_with_more_redundancy_has_the_cost(panda):
    figure = picture(straight(panda, PositionTask(panda, "panda_hand_tcp")))
    assert "cost" in figure.axes[0].get_ylabel()
    assert len(figure.axes) == 2
