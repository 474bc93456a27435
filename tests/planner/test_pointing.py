"""Rays into rooms."""

import numpy as np
import pytest
from floor_plans import lab
from paper import paper_room

from lmd.planner.pointing import pointed_at
from lmd.space.surface import SurfaceArrays

WALLS = ("x_min", "x_max", "y_min", "y_max", "floor", "ceiling")


def at(eye, target, room=None, own=-1):
    surfaces = SurfaceArrays.of((room or paper_room()).surfaces())
    eye, target = np.array(eye, dtype=float), np.array(target, dtype=float)
    place = pointed_at(surfaces, eye, target - eye, own)
    if place is None:
        return None
    s, (a, b) = place
    return s, surfaces.origin[s] + a * surfaces.u[s] + b * surfaces.v[s]


@pytest.mark.parametrize("eye", [(3.0, 2.0, 3.0), (3.0, -20.0, 3.0)])
def test_a_ray_goes_through_the_back_of_a_wall_to_the_front_of_the_next(eye):
    s, point = at(eye, (4.0, 5.0, 2.0))
    assert WALLS[s] == "y_max"
    assert point == pytest.approx((4.0, 5.0, 2.0))


def test_of_two_surfaces_the_nearer_one_is_meant():
    rack = next(i for i, surface in enumerate(lab().surfaces()) if surface.name == "obstacle_0_x_max")
    assert at((2.0, 3.5, 1.0), (0.0, 3.5, 1.0), lab())[0] == rack
    assert at((2.0, 2.8, 1.0), (0.0, 2.8, 1.0), lab())[0] != rack


def test_beyond_all_surfaces_and_from_behind_a_tag_stays_in_its_own_plane():
    assert at((-5.0, 2.5, 3.0), (-6.0, 2.5, 3.5)) is None
    assert at((3.0, -5.0, 3.0), (3.0, 0.0, 9.0)) is None
    s, point = at((3.0, -5.0, 3.0), (3.0, 0.0, 9.0), own=WALLS.index("y_min"))
    assert WALLS[s] == "y_min"
    assert point == pytest.approx((3.0, 0.0, 9.0))
    assert at((3.0, -5.0, 3.0), (4.0, -5.0, 3.0), own=WALLS.index("y_min")) is None  # along the plane
