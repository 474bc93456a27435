import numpy as np
import pytest
import shapely
from numpy.testing import assert_array_equal
from support.rooms import L_SHAPE, PILLAR, blocks, lab, plan_of, random_boxes, star
from support.tables import rows
from support.thorough import SHARE

from lmd.space.blockers import Blockers
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Obstacle
from lmd.space.surface import PLACEMENT_TOLERANCE

LINES = SHARE * 100_000


def on_ground(points, z=1.0):
    return np.insert(np.asarray(points, dtype=float), 2, z, axis=-1)


def clear_on_ground(plan, starts, ends):
    return plan.blockers.clear(on_ground(starts), on_ground(ends)) if plan.blockers else np.ones(len(starts), bool)


def covered(polygon, starts, ends):
    """Return by shapely whether the closed polygon contains the whole line."""
    shapely.prepare(polygon)
    return shapely.covers(polygon, shapely.linestrings(np.stack([starts, ends], axis=1)))


def within(polygon, rng, count):
    """Random points of a polygon."""
    low, high = np.array(polygon.bounds[:2]), np.array(polygon.bounds[2:])
    points = rng.uniform(low, high, (4 * count, 2))
    return points[shapely.contains_xy(polygon, points)][:count]


@pytest.mark.slow
@pytest.mark.parametrize("shape", [blocks, star])
def test_lines_of_sight_over_random_floor_plans_are_those_of_shapely(shape):
    rng, lines = np.random.default_rng(1), 0
    while lines < LINES:
        polygon = shape(rng)
        starts, ends = within(polygon, rng, 2000), within(polygon, rng, 2000)
        count = min(len(starts), len(ends))
        starts, ends = starts[:count], ends[:count]
        assert_array_equal(clear_on_ground(plan_of(polygon), starts, ends), covered(polygon, starts, ends))
        lines += count


@pytest.mark.slow
def test_lines_through_corners_and_along_walls_are_those_of_shapely():
    # All coordinates are multiples of a quarter, so that many lines run exactly through corners and along walls.
    rng, lines = np.random.default_rng(2), 0
    places = np.stack(np.meshgrid(*2 * [np.arange(0.0, 5.01, 0.25)]), axis=-1).reshape(-1, 2)
    while lines < LINES:
        polygon = blocks(rng)
        inside = places[shapely.covers(polygon, shapely.points(places))]
        starts, ends = inside[rng.integers(len(inside), size=(2, 2000))]
        apart = (starts != ends).any(axis=1)
        starts, ends = starts[apart], ends[apart]
        assert_array_equal(clear_on_ground(plan_of(polygon), starts, ends), covered(polygon, starts, ends))
        lines += len(starts)


@pytest.mark.slow
def test_lines_between_boxes_are_those_of_a_mesh():
    trimesh = pytest.importorskip("trimesh")
    rng, size, lines = np.random.default_rng(3), np.array([5.0, 4.0, 3.0]), 0
    while lines < LINES:
        boxes = random_boxes(rng, 8, size)
        blockers = Blockers.of([Obstacle(*box.tolist()).body for box in boxes])
        mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=box) for box in boxes])
        points = rng.uniform(0.0, 1.0, (2, 4000, 3)) * size
        starts, ends = points[:, ~blockers.inside(points).any(axis=0)]
        hits, ray, _ = mesh.ray.intersects_location(starts, ends - starts)
        before = np.linalg.norm(hits - starts[ray], axis=1) < np.linalg.norm(ends - starts, axis=1)[ray]
        hit = np.bincount(ray[before], minlength=len(starts)) > 0
        assert_array_equal(blockers.clear(starts, ends), ~hit)
        lines += len(starts)


def test_whole_numbers_of_bodies_are_found():
    plan = FloorPlan(L_SHAPE, 2.5, holes=[PILLAR])
    assert_array_equal(plan.blockers.first, [0, 2, 6])  # a corner of two walls, and four sides
    assert FloorPlan([[0, 0], [3, 0], [3, 2], [0, 2]], 2.5).blockers is None


@pytest.mark.parametrize(("start", "end", "clear"), rows(__file__, "lines of sight in the lab"))
def test_what_touches_is_clear_and_what_enters_is_not(start, end, clear):
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    for one, two in ((start, end), (end, start)):
        assert lab().clear(one, two) == clear


def test_a_line_that_enters_less_than_the_tolerance_is_clear():
    for depth, clear in ((0.5, True), (2.0, False)):
        y = 3.0 + depth * PLACEMENT_TOLERANCE
        assert lab().clear(np.array([2.0, y, 1.0]), np.array([0.0, y, 1.0])) == clear
