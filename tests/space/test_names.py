import floor_plans
import pytest

from lmd.space.cuboid import Cuboid
from lmd.space.names import name_for_people

RACK = {"low": [4, 0.5, 0.5], "high": [5, 1.5, 1.5], "faces": ["x_min", "top"]}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("wall_0", "wall 1"),
        ("hole_0_wall_1", "pillar 1, side 2"),
        ("obstacle_0_x_min", "rack, side x_min"),
        ("obstacle_0_top", "rack, top"),
        ("obstacle_1_top", "obstacle 1, top"),
        ("ceiling", "ceiling"),
    ],
)
def test_a_surface_of_a_floor_plan_has_a_name_for_people(name, words):
    another = {**RACK, "low": [2.5, 0.5, 0.5], "high": [3.5, 1.5, 1.5]}
    room = floor_plans.lab(obstacles=[{**RACK, "name": "rack"}, another])
    (surface,) = [surface for surface in room.surfaces() if surface.name == name]
    assert name_for_people(surface, room.fixtures()) == words


def test_other_names_stay():
    for surface in Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5).surfaces():
        assert name_for_people(surface) == surface.name
