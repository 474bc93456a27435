"""Free regions of occupancy grids become rooms, in the frame of the map."""

import math

import numpy as np
import pytest
import shapely
from contracts.space import check_space
from numpy.testing import assert_allclose
from support.rooms import FREE, OCCUPIED, UNKNOWN, box, hall, write_map

from lmd.formats.plans import read_plan_room
from lmd.scene.deployment_sources import RandomDeployment
from lmd.space.free_region import OccupancyGrid, plan_of_grid


def room_of(path, spacing=0.5, **more):
    return read_plan_room(None, 2.5, {"height": [0.5, 1.0], "clearance": 0.3}, spacing, path=path, **more)


def plan_of(grey, tolerance=0.1, speck=0.2, passage=0.3, start=None, origin=(-0.5, -0.5, 0.0)):
    """Plan of grey values, whose first row has the lowest y; cells are 5 cm wide."""
    grid = OccupancyGrid("map", grey.astype(int), 0.05, origin, grey == OCCUPIED, grey == FREE)
    return plan_of_grid(grid, tolerance, speck, passage, start)


def polygon(plan):
    outer, *holes = plan.rings
    return shapely.Polygon(outer, holes)


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.0])
@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_the_room_is_in_the_frame_of_the_map(tmp_path, yaw, mode):
    grey = hall()
    box(grey, 2.0, 1.0, 2.6, 1.6, OCCUPIED)
    room = room_of(write_map(tmp_path, grey, mode=mode, origin=[-3.25, 7.5, yaw]), margin=0.1)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    corners = np.array([[0, 0], [6, 0], [6, 4], [0, 4]]) + 0.5
    for ring, expected in (
        (room.plan.outline, corners),
        (room.plan.holes[0], np.array([[2, 1], [2.6, 1], [2.6, 1.6], [2, 1.6]]) + 0.5),
    ):
        expected = shapely.Polygon(expected @ turn.T + [-3.25, 7.5])
        assert shapely.Polygon(ring).symmetric_difference(expected).area < 1e-9
    assert len(room.surfaces()) == 8
    hung = RandomDeployment(50).draw(room, np.random.default_rng(0)).positions
    walls = shapely.Polygon(room.plan.outline, room.plan.holes).boundary
    assert shapely.distance(walls, shapely.points(hung[:, :2])).max() < 1e-3
    check_space(room_of(write_map(tmp_path, grey, origin=[0.1, 0.2, yaw]), spacing=1.5))


def test_walls_are_within_the_tolerance_of_the_contour():
    """Walls with noise of a cell on a map that is turned against its picture."""
    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[0:260, 0:260]
    for angle in (0.0, 0.2, 0.7):
        x = 0.05 * ((columns - 130) * math.cos(angle) + (rows - 130) * math.sin(angle))
        y = 0.05 * ((rows - 130) * math.cos(angle) - (columns - 130) * math.sin(angle))
        noisy = np.maximum(np.abs(x) - 3.0, np.abs(y) - 2.0) + rng.uniform(-0.025, 0.025, x.shape)
        grey = np.where(noisy < 0.0, FREE, np.where(noisy < 0.2, OCCUPIED, UNKNOWN)).astype(np.uint8)
        found = shapely.Polygon(plan_of(grey, origin=(-6.5, -6.5, 0.0)).rings[0])
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        true = shapely.Polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) @ turn.T + 0.025)
        assert len(found.exterior.coords) <= 9
        assert shapely.hausdorff_distance(found.boundary, true.boundary, 0.01) < 0.05
        assert abs(found.area / true.area - 1.0) < 0.02


def test_the_largest_free_region_is_the_room_and_others_are_named():
    grey = hall(8.0)
    box(grey, 5.0, 0.0, 5.1, 4.0, OCCUPIED)
    box(grey, 2.0, 2.0, 2.1, 2.1, OCCUPIED)  # noise
    plan = plan_of(grey)
    assert polygon(plan).bounds == pytest.approx((0, 0, 5, 4))
    assert len(plan.rings) == 1
    told, start = plan.note.split("start = ")
    assert told.startswith("map: a free area of 11.6 m2 is left out")
    assert "1 groups of cells smaller than 0.2 m count as free" in start
    other = plan_of(grey, start=tuple(map(float, start[1 : start.index("]")].split(","))), speck=0.05)
    assert polygon(other).bounds == pytest.approx((5.1, 0, 8, 4))
    assert len(plan_of(grey, speck=0.05).rings) == 2


def test_rays_through_a_gap_are_left_out_and_doors_are_not():
    grey = hall()
    box(grey, 6.0, 1.0, 6.5, 1.15, FREE)  # through a window
    assert polygon(plan_of(grey)).bounds[2] < 6.2
    assert polygon(plan_of(grey, passage=0.1)).bounds[2] > 6.4
    box(grey, 3.0, 0.0, 3.1, 4.0, OCCUPIED)
    box(grey, 3.0, 1.0, 3.1, 1.8, FREE)
    assert polygon(plan_of(grey)).area == pytest.approx(24 - 0.32, abs=0.2)


def test_nothing_hangs_where_the_map_has_no_wall(tmp_path):
    grey = hall()
    box(grey, 5.9, -0.1, 6.2, 4.1, UNKNOWN)  # the eastern wall was never seen
    box(grey, 1.0, -0.1, 2.5, 0.0, UNKNOWN)  # 1.5 m of the southern wall were never seen
    room = room_of(write_map(tmp_path, grey))
    for surface in room.surfaces():
        a, b = (surface.point(at, 1.0) for at in (0.0, surface.extent[0]))
        assert min(a[0], b[0]) < 5.8, "the eastern edge carries landmarks"
        if abs(a[1]) < 0.01 and abs(b[1]) < 0.01:
            bounds = np.array([part.bounds for part in shapely.get_parts(surface.allowed)])
            assert_allclose(np.sort(bounds[:, [0, 2]], axis=0), [[0.0, 1.15], [2.35, 5.9]], atol=0.1)
    assert sum(surface.is_upright for surface in room.surfaces()) == 3


def test_pillars_that_touch_by_a_corner_are_one():
    grey = hall()
    for i in range(6):
        box(grey, 2.0 + 0.3 * i, 1.0 + 0.3 * i, 2.3 + 0.3 * i, 1.3 + 0.3 * i, OCCUPIED)
    box(grey, 0.0, 2.0, 0.3, 2.3, OCCUPIED)
    box(grey, 0.3, 2.3, 0.6, 2.6, OCCUPIED)
    plan = plan_of(grey, tolerance=0.01)
    assert len(plan.rings) == 2
    assert polygon(plan).area == pytest.approx(24 - 8 * 0.09, abs=0.02)
