import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import SIDE_WALLS, experiment_room, paper_room
from support.strategies import rooms

from lmd.core.checks import InputError
from lmd.space.cuboid import WALLS, Cuboid
from lmd.space.relevance import Relevance


@pytest.mark.parametrize(("positions", "shape", "count"), [("cells", (12, 7, 9), 756), ("vertices", (13, 8, 10), 1040)])
def test_paper_room_has_756_cells_or_1040_vertices(positions, shape, count):
    room = paper_room(positions=positions)
    assert room.grid_shape() == shape
    assert room.grid().shape == (count, 3)


def test_experiment_room_has_147_cells():
    assert experiment_room().grid_shape() == (7, 7, 3)
    assert len(experiment_room().grid()) == 147


def test_paper_cells_are_centred_on_half_metres():
    grid = paper_room().grid()
    assert_allclose(grid[0], [1.0, 1.0, 1.0])
    assert_allclose(grid[1], [1.0, 1.0, 1.5])
    assert_allclose(grid[-1], [6.5, 4.0, 5.0])


def test_vertices_reach_the_corners_of_the_reachable_box():
    grid = paper_room(positions="vertices").grid()
    assert_allclose([grid[0], grid[-1]], [[0.75, 0.75, 0.75], [6.75, 4.25, 5.25]])


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


def test_spacing_may_differ_per_axis():
    assert paper_room(spacing=(1.0, 0.5, 4.5)).grid_shape() == (6, 7, 1)


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


@pytest.mark.parametrize(
    ("name", "corner", "far_corner", "normal"),
    [
        ("x_min", [0, 0, 0], [0, 5, 6], [1, 0, 0]),
        ("x_max", [7.5, 0, 0], [7.5, 5, 6], [-1, 0, 0]),
        ("y_min", [0, 0, 0], [7.5, 0, 6], [0, 1, 0]),
        ("y_max", [0, 5, 0], [7.5, 5, 6], [0, -1, 0]),
        ("floor", [0, 0, 0], [7.5, 5, 0], [0, 0, 1]),
        ("ceiling", [0, 0, 6], [7.5, 5, 6], [0, 0, -1]),
    ],
)
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


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"size": (7.5, 5.0)}, r"^size .*\[7\.5, 5\.0\]"),
        ({"size": (7.5, 5.0, 0.0)}, r"^size\[2\] .*0\.0"),
        ({"size": (7.5, math.nan, 6.0)}, r"^size\[1\] .*nan"),
        ({"size": "big"}, r"^size .*'big'"),
        ({"reachable_size": (6.0, 5.1, 4.5)}, r"^reachable_size = \[6\.0, 5\.1, 4\.5\] exceeds size"),
        ({"reachable_size": (6.0, -1.0, 4.5)}, r"^reachable_size\[1\] .*-1\.0"),
        ({"spacing": 0.0}, r"^spacing .*0\.0"),
        ({"spacing": math.inf}, r"^spacing .*inf"),
        ({"spacing": (0.5, 0.5)}, r"^spacing .*\[0\.5, 0\.5\]"),
        ({"positions": "corners"}, r"^positions must be one of cells, vertices, got 'corners'"),
        ({"walls": ()}, r"^walls .*\(\)"),
        ({"walls": [["floor"]]}, r"^walls must be one of .*got \['floor'\]"),
        ({"walls": "floor"}, r"^walls .*'floor'"),
        ({"walls": ("floor", "floor")}, r"^walls .*each once"),
        ({"walls": ("floor", "roof")}, r"^walls .*'roof'"),
    ],
)
def test_a_bad_room_is_refused_by_name(change, named):
    with pytest.raises(InputError, match=named):
        paper_room(**change)


UPPER_HALF = {"low": [0, 0, 3.0], "high": [7.5, 5, 6], "weight": 3}


def test_every_position_matters_alike_by_default():
    assert_array_equal(paper_room().relevance.weights(paper_room().grid()), np.ones(756))


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


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"background": -1.0}, r"^background .*-1\.0"),
        ({"background": math.nan}, r"^background .*nan"),
        ({"regions": [{"low": [0, 0, 0], "weight": 1}]}, r"regions\[0\] must have the keys low, high and weight"),
        ({"regions": [UPPER_HALF, UPPER_HALF | {"weight": -2}]}, r"regions\[1\]\.weight .*-2"),
        ({"regions": [UPPER_HALF | {"low": [0, 0]}]}, r"regions\[0\]\.low .*\[0, 0\]"),
        ({"regions": [UPPER_HALF | {"low": [8, 0, 0]}]}, r"regions\[0\] is empty"),
        ({"regions": "all"}, r"^regions must be a list, got 'all'"),
        ({"regions": 5}, r"^regions must be a list, got 5"),
        ({"regions": [UPPER_HALF], "path": "w.csv"}, r"^path = 'w\.csv' cannot be given beside regions"),
    ],
)
def test_a_bad_relevance_is_refused_by_name(change, named):
    with pytest.raises(InputError, match=named):
        Relevance(**change)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("x,y,z,weight\n1,1,1,-3", r"table\.csv has a negative weight, -3"),
        ("x,y,z,weight\n1,1,2,1", r"table\.csv has no weight for the position \(1, 1, 1\)"),
        ("x,y,z,weight\n1,1,1,0", r"every position the weight 0"),
        ("x,y,z\n1,1,1", r"table\.csv lacks the column 'weight'"),
    ],
)
def test_a_bad_relevance_file_is_refused_by_name(write, text, named):
    with pytest.raises(InputError, match=named):
        Relevance(path=write(text)).weights(np.ones((1, 3)))


@pytest.mark.parametrize("low", [[20.0, 20.0, 20.0], [0.0, 0.0, 0.0]])  # out of the room, and between its positions
def test_a_region_without_a_position_is_refused(low):
    empty = {"low": low, "high": [value + 0.5 for value in low], "weight": 2}
    message = (
        r"^regions\[1\] from .* to .* holds no position; they are from \[1\.0, 1\.0, 1\.0\] to \[6\.5, 4\.0, 5\.0\]"
    )
    with pytest.raises(InputError, match=message):
        Relevance(regions=[UPPER_HALF, empty]).weights(paper_room().grid())


def test_an_irrelevant_room_is_refused():
    with pytest.raises(InputError, match="every position the weight 0"):
        Relevance(background=0.0).weights(np.ones((2, 3)))
