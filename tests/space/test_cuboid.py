import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import SIDE_WALLS, experiment_room, paper_room
from support.strategies import rooms
from support.tables import rows

from lmd.space.cuboid import WALLS, Cuboid
from lmd.space.space import Relevance


@pytest.mark.parametrize(
    ("room", "shape", "count"),
    [
        (paper_room(), (12, 7, 9), 756),
        (paper_room(positions="vertices"), (13, 8, 10), 1040),
        (experiment_room(), (7, 7, 3), 147),
        (paper_room(spacing=(1.0, 0.5, 4.5)), (6, 7, 1), 42),
    ],
)
def test_rooms_have_as_many_positions_as_printed(room, shape, count):
    assert room.grid_shape() == shape
    assert room.grid().shape == (count, 3)


@given(rooms())
def test_every_position_lies_in_the_reachable_box_and_the_room(room):
    grid = room.grid()
    assert len(grid) == math.prod(room.grid_shape()) == len(np.unique(grid, axis=0))
    assert (grid >= room.reachable_low - 1e-12).all()
    assert (grid <= room.reachable_high + 1e-12).all()
    assert room.contains(grid).all()


@given(rooms())
def test_the_grid_is_centred_and_no_coarser_than_the_spacing(room):
    grid = room.grid()
    assert_allclose(grid.mean(axis=0), np.array(room.size) / 2.0)
    for axis in range(3):
        gaps = np.diff(np.unique(np.round(grid[:, axis], 9)))
        assert (gaps <= room.spacing[axis] + 1e-8).all()


@given(rooms(), st.sampled_from(WALLS))
def test_wall_normals_point_inwards(room, name):
    wall = next(w for w in room.surfaces() if w.name == name)
    middle = wall.point(wall.extent[0] / 2.0, wall.extent[1] / 2.0)
    assert_allclose(np.stack([wall.u, wall.v, wall.normal]) @ np.stack([wall.u, wall.v, wall.normal]).T, np.eye(3))
    assert wall.normal @ (np.array(room.size) / 2.0 - middle) > 0.0


@given(rooms())
def test_the_six_walls_have_the_corners_and_the_area_of_the_room(room):
    walls, (x, y, z) = room.surfaces(), room.size
    for wall in walls:
        corners = wall.point(*np.meshgrid([0.0, wall.extent[0]], [0.0, wall.extent[1]]))
        assert np.isin(corners / np.array(room.size), [0.0, 1.0]).all()
    assert sum(wall.area for wall in walls) == pytest.approx(2 * (x * y + y * z + z * x))


@pytest.mark.parametrize(("name", "corner", "far_corner", "normal"), rows(__file__, "walls of the paper's room"))
def test_each_wall_is_where_its_name_says(name, corner, far_corner, normal):
    (wall,) = paper_room(walls=(name,)).surfaces()
    assert_array_equal(wall.point(0.0, 0.0), corner)
    assert_array_equal(wall.point(*wall.extent), far_corner)
    assert_array_equal(wall.normal, normal)


@given(rooms(), st.sampled_from(range(6)), st.floats(0, 1), st.floats(0, 1))
def test_wall_coordinates_invert_wall_points(room, index, a, b):
    wall = room.surfaces()[index]
    at = np.array([a, b]) * wall.extent
    assert_allclose(wall.coordinates(wall.point(*at) + 0.3 * wall.normal), at, atol=1e-12)
    assert_allclose(wall.coordinates(wall.point(*at) + 100.0 * wall.v)[1], wall.extent[1])


def test_walls_keep_the_order_asked_for():
    assert [wall.name for wall in experiment_room(walls=["y_max", "floor"]).surfaces()] == ["y_max", "floor"]
    assert tuple(wall.name for wall in experiment_room().surfaces()) == SIDE_WALLS


def test_a_micrometre_outside_is_still_inside():
    inside = paper_room().contains([[0, 0, 0], [7.5, 5, 6], [7.5 + 1e-7, 5, 6], [7.51, 5, 6], [1, -0.01, 1]])
    assert inside.tolist() == [True, True, True, False, False]


UPPER_HALF = {"low": [0, 0, 3.0], "high": [7.5, 5, 6], "weight": 3}


def test_a_region_weighs_what_lies_in_it_and_the_background_the_rest():
    grid = paper_room().grid()
    weights = Relevance(background=0.5, regions=[UPPER_HALF]).weights(grid)
    assert_array_equal(weights, np.where(grid[:, 2] >= 3.0, 3.0, 0.5))


def test_a_later_region_overrides_an_earlier_one():
    corner = {"low": [0, 0, 0], "high": [1, 1, 6], "weight": 0}
    weights = Relevance(regions=[UPPER_HALF, corner]).weights(np.array([[1, 1, 5], [1, 1, 1], [2, 1, 5], [2, 1, 1.0]]))
    assert weights.tolist() == [0.0, 0.0, 3.0, 1.0]


def test_positions_on_the_border_of_a_region_belong_to_it_however_they_were_rounded():
    room = Cuboid(size=(3, 3, 3), reachable_size=(2.1, 2.1, 2.1), spacing=0.3)  # cell centres at 0.6, 0.9, ..., 2.4
    inner = {"low": [0.9, 0.9, 0.9], "high": [2.1, 2.1, 2.1], "weight": 1}
    assert Relevance(background=0, regions=[inner]).weights(room.grid()).sum() == 5**3


def test_a_file_weighs_every_position_in_any_row_order(write):
    grid = experiment_room().grid()
    expected = np.arange(len(grid), dtype=float)
    rows = [f"{x!r},{y!r},{z!r},{w}" for (x, y, z), w in zip(grid.tolist(), expected, strict=True)]
    relevance = Relevance(path=write("\n".join(["x,y,z,weight", *reversed(rows)])))
    assert_array_equal(relevance.weights(grid), expected)
