"""The redundancy map and the figure of a plan."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure

from eos_pin import PoseTask, PositionTask, load_robot, plan, self_motion_manifold
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.planning.obstacles.scene import Box, Capsule, Scene
from eos_pin.plots import plan as drawing
from eos_pin.plots.plan import KINDS, picture, redundancy_map, redundancy_strips

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda", chain_to="panda_hand_tcp")


def straight(panda, task):
    start = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    pose = panda.placement(start, "panda_hand_tcp")
    points = [pin.SE3(pose.rotation, pose.translation + np.array([0.0, y, 0.0])) for y in np.linspace(0.0, 0.1, 5)]
    return plan(task, points if task.m == 6 else [p.translation for p in points], start=start)


def test_redundancy_map_has_all_components_and_the_plan_lies_where_it_is_allowed(panda, monkeypatch):
    monkeypatch.setattr(drawing, "PLACES", 8)
    found = straight(panda, PoseTask(panda, "panda_hand_tcp"))
    bodies = Bodies.of(panda, {"panda_link4": Capsule([0, 0, 0], [0, 0, 0], 0.06)})
    elbow = panda.placement(found.q[0], "panda_link4").translation
    clearances = Clearances(bodies, Scene([Box(elbow + np.array([0.0, 0.3, 0.0]), [0.1, 0.1, 0.1])]))
    strips = redundancy_strips(found, clearances)
    for place, t in ((0, found.start), (7, found.end)):
        whole = self_motion_manifold(found.task, found.path(t).z)
        lengths = [np.ptp(strip.columns[place][0]) for strip in strips if place in strip.columns]
        np.testing.assert_allclose(sorted(lengths), sorted(one.length for one in whole.components), rtol=0.01)
    own, others = Figure().subplots(2, 1)
    handles = redundancy_map([own, others], found, strips)
    (mesh,), (line,) = own.collections, own.lines
    image = np.ma.filled(mesh.get_array().astype(float), np.nan)
    grid = np.asarray(mesh.get_coordinates())[:, 0, 1]
    assert {0.0, 1.0} <= set(np.unique(image[np.isfinite(image)]))
    rows = np.clip(np.searchsorted(grid, line.get_ydata()) - 1, 0, len(image) - 1)
    assert (image[rows, np.arange(8)] == 0.0).all()
    assert abs(line.get_ydata()[0]) < 1e-6
    assert {handle.get_label() for handle in handles} <= {"plan", *(name for name, _ in KINDS)}
    bands = [np.asarray(mesh.get_coordinates())[[0, -1], 0, 1] for mesh in others.collections]
    assert len(bands) == len(strips) - 1
    assert all(above[0] > below[1] for below, above in pairwise(bands))


def test_picture_of_a_plan_with_more_redundancy_has_the_cost(panda):
    figure = picture(straight(panda, PositionTask(panda, "panda_hand_tcp")))
    assert "cost" in figure.axes[0].get_ylabel()
    assert len(figure.axes) == 2
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [joint.name for joint in panda.joints]
