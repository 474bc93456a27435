"""Crowds: where cylinders stand, and which lines of sight they block by geometry that shares no code with ours."""

import numpy as np
import shapely
from numpy.testing import assert_array_equal
from support.rooms import lab

from lmd.space.crowd import RADIUS, TOP, Crowd, CrowdStates, worst_mean
from lmd.space.cuboid import Cuboid

ROOM = Cuboid((6.0, 4.0, 2.5), (5.0, 3.0, 1.5), 1.0)


def test_cylinders_stand_apart_on_the_free_floor():
    room = lab()
    crowd = Crowd(4, radius=(0.2, 0.4), height=(0.5, 1.9), states=30).drawn(room)
    solids = [shapely.box(*o.low[:2], *o.high[:2]) for o in room.plan.obstacles if o.low[2] < 0.5]
    free = shapely.Polygon(room.plan.outline, room.plan.holes).difference(shapely.union_all(solids))
    for state in crowd.people:
        discs = [shapely.Point(x, y).buffer(r, quad_segs=64) for x, y, r in state[:, : RADIUS + 1]]
        # 16 directions are tested: between two of them a corner may reach into the disc by r (1 - cos(pi / 16)).
        assert all(disc.buffer(-0.02).within(free) for disc in discs)
        assert all(one.disjoint(other) for i, one in enumerate(discs) for other in discs[:i])
    assert_array_equal(crowd.people, Crowd(4, radius=(0.2, 0.4), height=(0.5, 1.9), states=30).drawn(room).people)


def test_the_worst_share_of_the_states_is_rounded_up_to_whole_states():
    counts = [Crowd(1, states=states, fitness="worst").drawn(ROOM).worst_count for states in (1, 10, 20, 21)]
    assert counts == [1, 1, 1, 2]


def lines(rng, count):
    """Lines of sight with a cylinder each: most pass it closely, at any height."""
    camera = rng.uniform([0, 0, 0.3], [6, 4, 2.4], (count, 3))
    target = rng.uniform([0, 0, 0.0], [6, 4, 2.5], (count, 3))
    share = rng.uniform(-0.1, 1.1, (count, 1))
    axis = (camera + share * (target - camera))[:, :2] + rng.normal(0.0, 0.3, (count, 2))
    people = np.column_stack([axis, rng.uniform(0.1, 0.5, count), np.zeros(count), rng.uniform(0.5, 2.0, count)])
    return camera, target, people


def clear(camera, target, person):
    crowd = CrowdStates(Crowd(1, clearance=0.0), person[None, None])
    return bool(crowd.clear(camera, target[None])[0])


def test_a_cylinder_blocks_as_plane_geometry_says():
    rng, blocked = np.random.default_rng(0), 0
    for camera, target, person in zip(*lines(rng, 2000), strict=True):
        disc = shapely.Point(person[:2]).buffer(person[RADIUS], quad_segs=400)
        path = shapely.LineString([camera[:2], target[:2]])
        if abs(path.distance(shapely.Point(person[:2])) - person[RADIUS]) < 1e-3 or disc.contains(
            shapely.Point(camera[:2])
        ):
            continue  # a matter of rounding; or the cylinder would be left out
        within = path.intersection(disc)
        expected = False
        if not within.is_empty:
            along = np.array([path.project(shapely.Point(end)) for end in within.coords]) / path.length
            lowest = (camera[2] + along * (target[2] - camera[2])).min()
            if abs(lowest - person[TOP]) < 1e-3:
                continue
            expected = lowest < person[TOP]
        assert clear(camera, target, person) == (not expected)
        blocked += expected
    assert blocked > 300


def test_a_cylinder_around_the_camera_is_left_out():
    crowd = CrowdStates(Crowd(1, clearance=0.3), np.array([[[2.0, 2.0, 0.25, 0.0, 1.75]]]))
    places = np.array([[2.0, 2.0, 1.0], [2.54, 2.0, 1.0], [2.56, 2.0, 1.0], [2.0, 2.0, 2.0], [2.0, 2.0, 2.1]])
    present = crowd.present(places, np.zeros(5, dtype=int))[:, 0]
    assert present.tolist() == [False, False, True, False, True]
    above = crowd.clear(places[4], np.array([[2.0, 2.0, 0.0], [2.0, 2.0, 1.8], [4.0, 2.0, 2.0]]))
    assert above.tolist() == [False, True, True]


def test_the_mean_of_the_worst():
    assert worst_mean(np.array([[3.0, 1.0, 2.0], [5.0, 4.0, 6.0]]), 2).tolist() == [1.5, 4.5]
