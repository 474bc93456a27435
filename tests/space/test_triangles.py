import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from support.tables import rows
from support.thorough import SHARE

from lmd.space.triangles import Triangles

TOLERANCE = 1e-6
SIZE = np.array([6.0, 5.0, 3.0])


def of(mesh):
    return Triangles.of(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), TOLERANCE)


def furnished(rng, things=6, detail=1):
    """A room of boxes, balls and sheets in all directions."""
    parts = [trimesh.creation.box(bounds=[[0, 0, 0], SIZE])]
    for i in range(things):
        sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
        kinds = (trimesh.creation.icosphere(detail, 0.4), trimesh.creation.box((0.8, 0.5, 0.7)), sheet)
        thing = kinds[i % 3].copy()
        thing.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        thing.apply_translation(rng.uniform(0.2, 0.8, 3) * SIZE)
        parts.append(thing)
    return trimesh.util.concatenate(parts)


def lines(rng, count):
    return rng.uniform(0.0, 1.0, (2, count, 3)) * SIZE


def by_trimesh(mesh, starts, ends):
    """Return whether a segment hits a triangle strictly between its ends, by trimesh and the R-tree."""
    hits, ray, _ = mesh.ray.intersects_location(starts, ends - starts)
    before = np.linalg.norm(hits - starts[ray], axis=1) < np.linalg.norm(ends - starts, axis=1)[ray]
    return np.bincount(ray[before], minlength=len(starts)) > 0


@pytest.mark.slow
def test_lines_of_sight_are_those_of_trimesh():
    rng, asked = np.random.default_rng(0), 0
    while asked < SHARE * 50_000:
        mesh = furnished(rng, things=9)
        starts, ends = lines(rng, 1500)
        assert_array_equal(of(mesh).clear(starts, ends), ~by_trimesh(mesh, starts, ends))
        asked += len(starts)


@pytest.mark.parametrize("divided", [0, 3])
def test_nothing_slips_through_edges_and_corners(divided):
    # From the middle of a ball through every corner, and through points on every edge.
    ball = trimesh.creation.icosphere(divided, 1.0)
    corners, edges = ball.vertices, ball.vertices[ball.edges_unique]
    share = np.random.default_rng(0).random((len(edges), 1))
    targets = np.concatenate([corners, edges.mean(axis=1), edges[:, 0] + share * (edges[:, 1] - edges[:, 0])])
    assert not of(ball).clear(np.zeros(3), 2.0 * targets).any()
    assert not of(ball).clear(2.0 * targets, np.zeros(3)).any()
    assert of(ball).clear(np.zeros(3), 0.9 * targets).all()


@pytest.mark.parametrize(("start", "end", "clear"), rows(__file__, "lines of sight beside a box"))
def test_what_touches_a_box_is_clear_and_what_enters_is_not(start, end, clear):
    box = of(trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]]))
    for one, two in ((start, end), (end, start)):
        assert box.clear(np.array(one, dtype=float), np.array(two, dtype=float)) == clear


def test_distances_are_those_of_trimesh():
    rng = np.random.default_rng(1)
    mesh = furnished(rng)
    points, _ = lines(rng, 300)
    exact = trimesh.proximity.closest_point(mesh, points)[1]
    assert_allclose(of(mesh).distance(points, 100.0), exact, atol=1e-12)
    assert_allclose(of(mesh).distance(points, 0.3), np.minimum(exact, 0.3), atol=1e-12)


def test_a_way_keeps_its_clearance_all_along():
    rng = np.random.default_rng(2)
    triangles, (starts, ends) = of(furnished(rng)), lines(rng, 300)
    along = starts + np.linspace(0.0, 1.0, 2001)[:, None, None] * (ends - starts)
    nearest = triangles.distance(along, 1.0).min(axis=0)
    sure = np.abs(nearest - 0.2) > 2e-3
    assert_array_equal(triangles.keeps_away(starts, ends, 0.2)[sure], nearest[sure] > 0.2)
