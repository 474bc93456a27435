"""Doors, windows and furniture: what they are, and what they cover of a surface."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rooms import DOOR, L_SHAPE, PILLAR, RACK, lab, mesh_room
from support.tables import rows

from lmd.space.fixture import Fixture
from lmd.space.floor_plan import FloorPlan


def box_of(low, high):
    return np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3).astype(float)


def surfaces(room):
    return {surface.name: surface for surface in room.surfaces()}


@pytest.mark.parametrize(("name", "low", "high", "kind"), rows(__file__, "kinds of fixtures"))
def test_the_kind_is_that_of_the_name_or_of_the_shape(name, low, high, kind):
    assert Fixture(name, box_of(low, high)).kind == kind


def test_a_floor_plan_has_its_keep_outs_and_obstacles_by_their_names_or_numbers():
    screen = {"surface": "wall_1", "from_left": [0.5, 1.0], "from_below": [1, 2]}
    room = lab(keep_out=[DOOR, screen], obstacles=[{**RACK, "name": "rack"}])
    fixtures = {fixture.name: fixture for fixture in room.fixtures()}
    assert list(fixtures) == ["door", "keep_out 1", "rack"]
    walls = surfaces(room)
    # As one stands before them: the door is from 0.5 to 1.5 m, the rack stands at the right end of wall 5.
    assert_allclose(fixtures["door"].on(walls["wall_0"]).bounds, (0.5, 0.0, 1.5, 2.0))
    assert_allclose(fixtures["keep_out 1"].on(walls["wall_1"]).bounds, (0.5, 1.0, 1.0, 2.0))
    assert_allclose(fixtures["rack"].on(walls["wall_5"]).bounds, (3.0, 0.0, 4.0, 1.75))
    assert_allclose(fixtures["rack"].on(walls["floor"]).bounds, (0.0, 3.0, 0.5, 4.0))
    for name in ("wall_0", "wall_3", "ceiling"):
        assert fixtures["rack"].on(walls[name]).is_empty
    for name, face in walls.items():
        assert fixtures["rack"].has(face) == name.startswith("obstacle_0")
    assert fixtures["rack"].on(walls["obstacle_0_x_max"]).is_empty


def test_a_mesh_has_the_objects_that_are_no_wall(tmp_path):
    plan = FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK])
    room = mesh_room(tmp_path / "lab.glb", plan, keep_out=[{**DOOR, "surface": "shell_2"}])
    same = {fixture.name: fixture for fixture in lab().fixtures()}
    box, door = room.fixtures()
    assert (box.name, box.kind, door.name) == ("box_0", "furniture", "door")
    assert_allclose(box.footprint.bounds, same["obstacle 0"].footprint.bounds, atol=1e-6)
    assert_allclose(door.on(surfaces(room)["shell_2"]).bounds, (0.5, 0.0, 1.5, 2.0), atol=1e-6)
    plain = mesh_room(tmp_path / "lab.stl", plan)
    assert not plain.fixtures()  # the file names nothing
