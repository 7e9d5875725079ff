"""Distances from obstacles, their slopes, and the law for v that follows them."""

from __future__ import annotations

import math
import pickle
from functools import cache, partial
from itertools import pairwise

import checks
import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import eos_pin
from eos_pin import Atlas, Avoidance, Chart, Clearance, ClosestPair, DescendPotential, Obstacle, PositionTask
from eos_pin.errors import InputError, RobotError, UnknownNameError

#: Coal's tolerance between curved shapes, with room.
DISTANCE = 1e-7
#: Central differences of such distances.
SLOPE = 1e-4

LINK, RADIUS = 0.25, 0.03
DISCS = ((1.0, -0.05, 0.35), (2.95, 0.15, 0.35))


@pytest.fixture(scope="module")
def long_chain():
    return eos_pin.load_robot("planar_chain_23")


@pytest.fixture(scope="module")
def among_discs(long_chain):
    discs = [Obstacle(coal.Cylinder(radius, 0.4), [x, y, 0.0], f"disc {i}") for i, (x, y, radius) in enumerate(DISCS)]
    return Clearance(long_chain, discs, bodies=("base", *(f"link_{i}" for i in range(1, 24))))


def segment_distance(center, start, end):
    """Distance of a point from a segment, in the plane."""
    along = end - start
    s = np.clip((center - start) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(start + s * along - center))


def chain_distance(q, discs):
    """Least distance of the 23 round-ended links from discs, by elementary geometry."""
    heading = np.cumsum(q)
    joints = np.concatenate((np.zeros((1, 2)), np.cumsum(LINK * np.c_[np.cos(heading), np.sin(heading)], axis=0)))
    links = list(pairwise(joints))
    return min(segment_distance(np.array([x, y]), *link) - radius - RADIUS for x, y, radius in discs for link in links)


@cache
def of_body(clearance, body):
    """The same clearance with one body alone."""
    return Clearance(clearance.robot, clearance.obstacles, bodies=(body,))


def slope(clearance, t, q, body, step=1e-6):
    """Slope of the distance of one body by central differences."""
    alone = of_body(clearance, body)

    def distance(q):
        return alone.closest_pairs(t, q)[0].distance

    return np.array([distance(q + step * e) - distance(q - step * e) for e in np.eye(q.size)]) / (2.0 * step)


@given(checks.numbers(23, 0.6))
def test_distances_of_the_chain_are_those_of_segments_and_discs(long_chain, among_discs, q):
    expected = chain_distance(q, DISCS)
    assume(expected > 1e-3)
    assert among_discs.nearest(0.0, q).distance == pytest.approx(expected, abs=DISTANCE)


@pytest.fixture(scope="module")
def among_triangles(panda):
    """Panda's meshes as they are and as SciPy's hulls of their points, each triangle by triangle, and a ball."""
    center, radius = np.array([0.3, 0.1, 0.6]), 0.07
    found = []
    for hulls in (False, True):
        geometry = panda.collision.copy()
        ball = geometry.addGeometryObject(pin.GeometryObject("", 0, 0, pin.SE3(np.eye(3), center), coal.Sphere(radius)))
        for i in range(ball):
            shape = geometry.geometryObjects[i]
            if hulls and isinstance(shape.geometry, coal.BVHModelBase):
                shape.geometry = hull_of(np.asarray(shape.geometry.vertices()))
            if shape.parentJoint:
                geometry.addCollisionPair(pin.CollisionPair(i, ball))
        found.append((geometry, geometry.createData()))
    return Clearance(panda, [Obstacle(coal.Sphere(radius), center)]), found


def hull_of(points):
    """SciPy's convex hull of points as a mesh of triangles."""
    vertices, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    vertices.extend(list(points))
    triangles.extend([coal.Triangle(*map(int, corners)) for corners in ConvexHull(points).simplices])
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(points))
    mesh.addSubModel(vertices, triangles)
    mesh.endModel()
    return mesh


@given(st.data())
def test_distances_of_an_arm_are_those_of_the_hulls_of_its_meshes(panda, among_triangles, data):
    """Panda's meshes have dents of up to 0.1 mm, from which a ball is a little further away than from their hulls."""
    q = data.draw(checks.joints(panda))
    clearance, both = among_triangles
    least = []
    for geometry, workspace in both:
        pin.computeDistances(panda.model, panda.model.createData(), geometry, workspace, q)
        least.append(min(result.min_distance for result in workspace.distanceResults))
    meshes, hulls = least
    assume(hulls > 1e-3)
    distance = clearance.nearest(0.0, q).distance
    assert distance == pytest.approx(hulls, abs=1e-6)
    assert distance < meshes + 1e-6
    assert meshes < distance + 2e-4


@pytest.fixture(scope="module")
def beside_solids(panda):
    """Clearance of panda from a ball, and from a box that moves."""
    ball = Obstacle(coal.Sphere(0.1), [0.3, 0.1, 0.6])
    box = Obstacle(coal.Box(0.1, 0.2, 0.3), lambda t: [0.5, t, 0.3])
    return [Clearance(panda, [obstacle]) for obstacle in (ball, box)]


@given(st.data())
def test_gradient_is_the_slope_on_an_arm(panda, beside_solids, data):
    q = data.draw(checks.joints(panda))
    for clearance in beside_solids:
        for approach in clearance.closest_pairs(0.1, q)[:2]:
            # Where the closest point jumps to another edge or face, there is no slope.
            slopes = [slope(clearance, 0.1, q, approach.body, step) for step in (1e-6, 1e-5)]
            if abs(approach.distance) > 1e-3 and np.abs(slopes[0] - slopes[1]).max() < 1e-6:
                np.testing.assert_allclose(approach.gradient, slopes[0], atol=SLOPE)


@given(checks.numbers(23, 0.4))
def test_gradient_is_the_slope_on_the_chain(among_discs, q):
    near = among_discs.nearest(0.0, q)
    assume(near.distance > 1e-2)
    slopes = [slope(among_discs, 0.0, q, near.body, step) for step in (1e-6, 1e-5)]
    assume(np.abs(slopes[0] - slopes[1]).max() < 1e-3)
    np.testing.assert_allclose(near.gradient, slopes[1], atol=1e-3)


def test_approach_joins_the_nearest_points(panda):
    q, _ = checks.random_state(panda, 3)
    clearance = Clearance(panda, [Obstacle(coal.Sphere(0.05), [0.5, 0.5, 0.9], "ball")])
    closest_pairs = clearance.closest_pairs(0.0, q)
    assert [a.distance for a in closest_pairs] == sorted(a.distance for a in closest_pairs)
    assert {a.body for a in closest_pairs} == set(clearance.bodies)
    for a in closest_pairs:
        assert a.obstacle == "ball"
        assert np.linalg.norm(a.on_body - a.on_obstacle) == pytest.approx(a.distance, abs=1e-9)
        assert np.linalg.norm(a.on_obstacle - [0.5, 0.5, 0.9]) == pytest.approx(0.05, abs=1e-9)
    near = closest_pairs[0]
    assert isinstance(near, ClosestPair)
    assert clearance.nearest(0.0, q).distance == near.distance
    within = 0.5 * (closest_pairs[1].distance + closest_pairs[2].distance)
    assert [a.body for a in clearance.closest_pairs(0.0, q, within=within)] == [a.body for a in closest_pairs[:2]]


def test_moving_obstacles_are_where_they_are_at_that_time(ppr):
    # At q = 0 the only link lies from the origin to (1, 0).
    def pose(t):
        return pin.SE3(pin.utils.rotate("z", 0.5 * math.pi * t), np.array([0.5, 2.0, 0.0]))

    clearance = Clearance(ppr, [Obstacle(coal.Box(1.0, 0.2, 1.0), pose)], bodies=["link"])
    lying, standing = clearance.along([0.0, 1.0], np.zeros((2, 3)))
    assert lying - standing == pytest.approx(0.4, abs=DISTANCE)
    assert clearance.nearest(1.0, np.zeros(3)).distance == standing


def test_overlap_is_negative_and_its_gradient_leads_out(panda):
    q = np.array([0.0, -0.6, 0.0, -2.4, 0.0, 1.8, 0.785])
    center = panda.placement(q, "panda_link5").translation + np.array([0.0, 0.03, -0.03])
    clearance = Clearance(panda, [Obstacle(coal.Sphere(0.05), center)])
    near = clearance.nearest(0.0, q)
    assert near.distance < -0.01
    out = q + 1e-3 * near.gradient
    assert clearance.nearest(0.0, out).distance > near.distance


def test_distances_leave_the_robot_as_it_was(panda):
    kinds = [type(shape.geometry) for shape in panda.collision.geometryObjects]
    clearance = Clearance(panda, [Obstacle(coal.Sphere(0.1), [0.5, 0.0, 0.5])])
    distance = clearance.nearest(0.0, np.zeros(7)).distance
    assert [type(shape.geometry) for shape in panda.collision.geometryObjects] == kinds
    assert pickle.loads(pickle.dumps(clearance)).nearest(0.0, np.zeros(7)).distance == distance


def test_bodies_are_links_that_move_unless_others_are_named(panda):
    ball = Obstacle(coal.Sphere(0.1), [0.0, 0.3, 0.1])
    every = Clearance(panda, [ball])
    assert "panda_link0" not in every.bodies
    assert "panda_link7" in every.bodies
    base = Clearance(panda, [ball], bodies=["panda_link0"]).nearest(0.0, np.zeros(7))
    assert base.body == "panda_link0"
    assert not base.gradient.any()


def test_clearance_refuses_shapes_and_bodies_it_cannot_measure(panda):
    ball = Obstacle(coal.Sphere(0.1), [0.0, 0.3, 0.1])
    with pytest.raises(InputError, match="at least one obstacle"):
        Clearance(panda, [])
    with pytest.raises(UnknownNameError, match="panda_link7"):
        Clearance(panda, [ball], bodies=["panda_lnk7"])
    with pytest.raises(RobotError, match="no collision shapes"):
        Clearance(eos_pin.Robot(panda.model), [ball])


def test_flat_mesh_is_an_obstacle_like_any_other(ppr, tmp_path):
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]]).export(tmp_path / "flat.stl")
    sheet = coal.MeshLoader().load(str(tmp_path / "flat.stl"), np.ones(3))
    clearance = Clearance(ppr, [Obstacle(sheet, [2.0, 0.0, 0.0])], bodies=["link"])
    # The link's end, a ball about (1, 0).
    radius = ppr.collision.geometryObjects[4].geometry.radius
    assert clearance.nearest(0.0, np.zeros(3)).distance == pytest.approx(1.0 - radius, abs=DISTANCE)


def test_potential_is_zero_from_the_margin_on_and_its_gradient_is_its_slope(panda):
    q, _ = checks.random_state(panda, 5)
    ball = Clearance(panda, [Obstacle(coal.Sphere(0.1), [0.3, 0.3, 0.5])])
    reach = ball.nearest(0.0, q).distance
    assert ball.potential(q, influence_distance=0.99 * reach) == 0.0
    assert not ball.potential_gradient(q, influence_distance=0.99 * reach).any()
    margin, step = reach + 0.2, 1e-6
    potential = partial(ball.potential, influence_distance=margin)
    numeric = [potential(q + step * e) - potential(q - step * e) for e in np.eye(7)]
    np.testing.assert_allclose(
        ball.potential_gradient(q, influence_distance=margin), np.array(numeric) / (2.0 * step), atol=1e-6
    )


def test_potential_is_one_that_control_can_descend(panda):
    q, dq = checks.random_state(panda, 5)
    ball = Clearance(panda, [Obstacle(coal.Sphere(0.1), [0.3, 0.3, 0.5])])
    chart = Chart.from_base(PositionTask(panda, "panda_hand_tcp"), q)
    law = DescendPotential(lambda q: ball.potential_gradient(q, influence_distance=0.5), gain=10.0)
    expected = -10.0 * chart.V.T @ ball.potential_gradient(q, influence_distance=0.5)
    np.testing.assert_allclose(law.acceleration(0.0, q, dq, chart), expected, atol=1e-12)


# -- making way ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hand(panda):
    return PositionTask(panda, "panda_hand_tcp")


READY = np.array([0.0, -0.6, 0.0, -2.4, 0.0, 1.8, 0.785])


def far_away(robot):
    return Clearance(robot, [Obstacle(coal.Sphere(0.1), [0.0, 0.0, 9.0])])


def test_avoidance_step_is_zero_far_from_obstacles(panda, hand):
    still = Avoidance(far_away(panda), posture=READY).step(0.0, READY, Chart.from_base(hand, READY))
    np.testing.assert_array_equal(still, np.zeros(4))


def test_step_makes_way_and_none_is_too_long(panda, hand):
    chart = Chart.from_base(hand, READY)
    elbow = panda.placement(READY, "panda_link4").translation
    clearance = Clearance(panda, [Obstacle(coal.Sphere(0.05), elbow + np.array([0.0, 0.15, 0.1]))])
    law = Avoidance(clearance, influence_distance=0.2, longest=0.01)
    dv = law.step(0.0, READY, chart)
    assert np.abs(chart.V @ dv).max() == pytest.approx(0.01)
    after = chart.inverse(hand.value(READY), dv).q
    assert clearance.potential(after, influence_distance=0.2) < clearance.potential(READY, influence_distance=0.2)
    assert clearance.nearest(0.0, after).distance > clearance.nearest(0.0, READY).distance


def test_posture_draws_and_a_limit_repels(panda, hand):
    chart = Chart.from_base(hand, READY)
    away = chart.inverse(hand.value(READY), np.array([0.3, 0.0, 0.0, 0.0])).q
    back = Avoidance(far_away(panda), posture=READY).step(0.0, away, chart)
    assert np.linalg.norm(away + chart.V @ back - READY) < np.linalg.norm(away - READY)
    # The last joint does not move the hand's position, so all of it is self-motion.
    edge = np.array([*READY[:6], panda.upper[6] - 0.05])
    dv = Avoidance(far_away(panda), room=0.1).step(0.0, edge, Chart.from_base(hand, edge))
    off = Chart.from_base(hand, edge).V @ dv
    assert off[6] < 0.0
    np.testing.assert_allclose(off[:6], 0.0, atol=1e-12)


def test_following_keeps_the_task_and_ends_where_the_robot_does(panda, hand):
    z = hand.value(READY)
    clearance = Clearance(panda, [Obstacle(coal.Sphere(0.06), lambda t: [0.1, 0.4 - 0.3 * t, 0.75], "ball")])
    law = Avoidance(clearance, influence_distance=0.15, posture=READY)
    times = np.linspace(0.0, 1.0, 41)
    path = eos_pin.figure_eight(z, 0.1, period=1.0, plane="yz")
    found = law.follow(Atlas(hand), READY, path, times)
    assert found.complete
    errors = [np.abs(hand.value(q) - path(t).z).max() for t, q in zip(times, found.q, strict=True)]
    assert max(errors) <= 1e-10
    np.testing.assert_allclose(
        found.v, [found.charts[k].v(q) for k, q in zip(found.chart, found.q, strict=True)], atol=1e-12
    )
    assert clearance.along(times, found.q).min() > 0.0 > clearance.along(times, np.tile(READY, (41, 1))).min()
    beyond = law.follow(Atlas(hand), READY, eos_pin.line(z, [2.0, 0.0, 0.0], period=4.0), times)
    assert 1 < len(beyond.q) < 41
    assert f"point {len(beyond.q)} of 41" in beyond.message


def test_law_that_makes_no_sense_is_refused(panda, hand):
    clearance = far_away(panda)
    for wrong in ({"influence_distance": 0.0}, {"room": -1.0}, {"damping": 0.0}, {"longest": math.nan}, {"pull": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            Avoidance(clearance, **wrong)
    with pytest.raises(InputError, match="posture"):
        Avoidance(clearance, posture=[0.0])
    with pytest.raises(InputError, match="at least one step"):
        Avoidance(clearance).follow(Atlas(hand), READY, eos_pin.Hold(hand.value(READY)), [0.0], steps=0)
