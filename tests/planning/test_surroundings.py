"""Plans among solids, clear of the robot itself, through narrow passages, and with jumps where nothing else is left."""

from __future__ import annotations

import numpy as np
import pytest
from checks import links

from eos_pin import PositionTask
from eos_pin.errors import PlanError
from eos_pin.planning.attempts import Search
from eos_pin.planning.obstacles.bodies import Bodies
from eos_pin.planning.obstacles.scene import Box, Capsule, Mesh, Scene, sphere
from eos_pin.planning.planner import plan

SIDE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
UP = np.array([0.0, 0.0, 0.1])
PATH = [[0.45, y, 0.35] for y in np.linspace(-0.3, 0.3, 25)]


@pytest.fixture(scope="module")
def elbow(task):
    """Where the elbow is halfway along the path, if nothing is in the way."""
    return task.robot.placement(plan(task, PATH).q[12], "panda_link4").translation


def from_box(p, centre):
    return np.linalg.norm(np.maximum(np.abs(p - centre) - 0.025, 0.0))


def from_post(p, centre):
    return np.linalg.norm(p - np.clip(p, centre - UP, centre + UP)) - 0.02


@pytest.mark.parametrize(
    ("solid", "distance"),
    [
        (lambda c: Scene([Box(c, [0.05, 0.05, 0.05])]), from_box),
        (lambda c: Scene(meshes=[Mesh(c + 0.025 * SIDE)]), from_box),
        (lambda c: Scene([], [sphere(c, 0.03)]), lambda p, c: np.linalg.norm(p - c) - 0.03),
        (lambda c: Scene([], [Capsule(c - UP, c + UP, 0.02)]), from_post),
    ],
    ids=["box", "mesh", "sphere", "capsule"],
)
def test_plan_keeps_clear_of_a_solid_that_the_shortest_motion_touches(task, elbow, solid, distance):
    bodies = Bodies.of(task.robot, {f"panda_link{i}": Capsule([0, 0, 0], [0, 0, 0], 0.06) for i in (4, 6)})
    found = plan(task, PATH, scene=solid(elbow), bodies=bodies, clearance=0.01)
    places = [
        task.robot.placement(q, f"panda_link{i}").translation
        for q in found.joints(np.linspace(found.start, found.end, 400))
        for i in (4, 6)
    ]
    least = min(distance(p, elbow) for p in places) - 0.06
    assert least > 0.01 - 1e-4
    assert found.info["clearance_between_min"] == pytest.approx(least, abs=1e-3)
    assert found.info["clearance_min"] >= 0.01


def points_on(q, radius):
    """Points along the axis of each link, where its capsule of this radius has them."""
    angle = np.cumsum(q)
    along = np.column_stack((np.cos(angle), np.sin(angle)))
    start = np.cumsum(along, axis=0) - along
    return start[:, None] + np.linspace(radius, 1.0 - radius, 81)[:, None] * along[:, None]


def apart(q, radius=0.1):
    """Distance of the axes of links that are no neighbours."""
    on = points_on(q, radius)
    return min(
        np.linalg.norm(on[i][:, None] - on[j], axis=2).min() for j in range(len(q)) for i in range(j - 1)
    )  # fmt: skip


def capsules(robot, radius):
    ends = [radius, 0, 0], [1.0 - radius, 0, 0]
    return Bodies.of(robot, {f"link{k}": Capsule(*ends, radius) for k in range(1, robot.n + 1)})


def test_plan_keeps_links_clear_of_each_other():
    task = PositionTask(links(4), "link5", "xy")
    bodies = capsules(task.robot, 0.1)
    path = [[0.4, y] for y in np.linspace(-1.5, 1.5, 31)]
    both = plan(task, path), plan(task, path, bodies=bodies, self_collision=True)
    least = [min(apart(q) for q in made.joints(np.linspace(made.start, made.end, 200))) for made in both]
    assert least[0] < 0.2 <= least[1] + 1e-3


@pytest.mark.parametrize(
    ("radius", "corners", "clearance"),
    [
        (0.15, [[0.22, 0.06], [0.94, -0.2], [-1.48, 0.15]], 0.0),
        (0.1, [[1.25, -1.48], [-0.22, 0.39], [-0.59, 0.36]], 0.02),
    ],
    ids=["around", "refused"],
)
def test_plan_does_not_step_over_obstacles_between_points(radius, corners, clearance):
    """Links that fold flat just touch each other: too short a piece of a motion for points to lie in.

    That the second path has no motion between its way points 16 and 17 was found by a lattice of all postures.
    """
    task, s = PositionTask(links(4), "link5", "xy"), np.linspace(0.0, 1.0, 31 if clearance else 21)[:, None]
    a, b, c = np.array(corners)
    given = {"bodies": capsules(task.robot, radius), "self_collision": True, "clearance": clearance, "effort": 1}
    path = (1.0 - s) ** 2 * a + 2.0 * s * (1.0 - s) * b + s**2 * c
    if clearance:
        with pytest.raises(PlanError, match=r"falls to 0.0188 m.* that keep 0.021 m at the points") as refused:
            plan(task, path, **given)
        assert {"waypoints", "closed", "seconds"} <= refused.value.info.keys()
        return
    found = plan(task, path, **given)
    between = found.joints(np.linspace(found.start, found.end, 500))
    assert min(apart(q, radius) for q in between) > 2.0 * radius


def test_search_is_refined_in_a_slit_before_it_is_refused(monkeypatch):
    """A link 10 cm thick goes 70 cm deep into a slit 10.2 cm wide."""
    tried, attempt = [], Search._attempt
    monkeypatch.setattr(Search, "_attempt", lambda self, one: tried.append(one) or attempt(self, one))
    task = PositionTask(links(3), "link4", "xy")
    bodies = Bodies.of(task.robot, {"link3": Capsule([0, 0, 0], [1, 0, 0], 0.05)})
    scene = Scene([Box([1.9, side * (0.051 + 0.5), 0.0], [0.8, 1.0, 1.0]) for side in (-1.0, 1.0)])
    found = plan(task, [[x, 0.0] for x in np.linspace(1.2, 2.2, 21)], scene=scene, bodies=bodies)
    assert len(tried) > 1
    assert tried[-1].count > tried[0].count
    # The link's axis may be 1 mm beside the middle, from the tip to the slit's mouth and the link's own end.
    for q in found.joints(np.linspace(found.start, found.end, 300)):
        tip = np.exp(1j * np.cumsum(q)).sum()
        along = np.exp(1j * q.sum())
        if tip.real > 1.6:
            assert abs(along.imag / along.real) * min(tip.real - 1.5, 1.0) < 1.1e-3


def test_jumps_are_as_few_as_can_be():
    """One side of the elbow is within the first joint's limits at the beginning, the other at the end."""
    task = PositionTask(links(2), "link3", "xy")
    direction = np.linspace(-0.9, 0.9, 31)
    path = 2.0 * np.cos(0.25) * np.column_stack((np.cos(direction), np.sin(direction)))
    limits = [-1.0, -2.0], [0.95, 2.0]
    with pytest.raises(PlanError, match="by the upper limit of 'joint1'"):
        plan(task, path, limits=limits, margin=0.0, effort=1)
    found = plan(task, path, limits=limits, margin=0.0, reconfigurations=True)
    assert found.info["reconfigurations"] == 1
    (jump,) = found.info["jumps"]
    # q1 = direction ± 0.25: within [-1, 0.95] on either side.
    assert direction[jump + 1] >= -0.75
    assert direction[jump] <= 0.7
    steps = np.abs(np.diff(found.at_waypoints(), axis=0)).max(axis=1)
    assert (np.flatnonzero(steps > 0.2) == [jump]).all()
