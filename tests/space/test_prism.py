import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.rooms import DOOR, L_SHAPE, PILLAR, RACK, hangs_properly, lab, plan_of, prisms, star
from support.thorough import examples

from lmd.optimisers.encoding import make_encoding
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.tag import Tag
from lmd.sight.poses import candidate_poses, wall_cells
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism

GROUND = shapely.Polygon(L_SHAPE, [PILLAR]).difference(shapely.box(0, 3, 0.5, 4))
seeds = st.integers(0, 2**32 - 1)


def surface(room, name):
    return next(s for s in room.surfaces() if s.name == name)


def test_walls_go_from_each_vertex_to_the_next():
    room = Prism(FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK]), Reachable((1.0, 1.0)), 0.5)
    walls = [f"wall_{i}" for i in range(6)] + [f"hole_0_wall_{i}" for i in range(4)]
    names = [*walls, "floor", "ceiling", "obstacle_0_x_max", "obstacle_0_top"]
    assert [s.name for s in room.surfaces()] == names
    for name, start, end, normal in [
        ("wall_0", [0, 0, 0], [6, 0, 2.5], [0, 1, 0]),
        ("wall_2", [3, 2, 0], [6, 2, 2.5], [0, -1, 0]),
        ("wall_5", [0, 0, 0], [0, 4, 2.5], [1, 0, 0]),
        ("hole_0_wall_0", [1.25, 1.25, 0], [1.75, 1.25, 2.5], [0, -1, 0]),
        ("floor", [0, 0, 0], [6, 4, 0], [0, 0, 1]),
        ("obstacle_0_x_max", [0.5, 3, 0], [0.5, 4, 1.75], [1, 0, 0]),
    ]:
        on = surface(room, name)
        assert_array_equal([on.point(0, 0), on.point(*on.extent), on.normal], [start, end, normal])


def test_areas_are_what_is_left_of_the_faces():
    room = Prism(FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK], keep_out=[DOOR]), Reachable((1, 1)), 0.5)
    areas = {s.name: s.area for s in room.surfaces()}
    assert_allclose(areas["wall_0"], 6 * 2.5 - 2)  # the door
    assert_allclose(areas["floor"], 24 - 6 - 0.25 - 0.5)  # the corner, the pillar, the rack
    assert_allclose(areas["ceiling"], 24 - 6 - 0.25)
    assert_allclose(areas["wall_5"], 4 * 2.5 - 1.75)  # the rack stands against it
    assert_allclose(areas["obstacle_0_top"], 0.5)
    assert_allclose(surface(lab(band=[0.25, 2.25], margin=0.125), "wall_1").area, 1.75 * 2)
    apart = lab(margin=0.125, keep_out=[DOOR], band=None)  # also from the frame of the door, which is 1 x 2 m
    assert_allclose(surface(apart, "wall_0").area, 5.75 * 2.25 - 1.25 * 2.0)


def test_a_keep_out_is_measured_from_the_left_as_one_stands_before_its_wall():
    # Before wall 2, over y = 2, low x is on the left; before wall 5, over x = 0, low y.
    parts = [
        {"surface": "wall_2", "from_left": [0, 1], "from_below": [0, 2]},
        {"surface": "wall_5", "corners": [[0, 0], [1, 0], [1, 1], [0, 1]]},
    ]
    room = Prism(FloorPlan(L_SHAPE, 2.5, keep_out=parts), Reachable((1, 1)), 0.5)
    marks = np.array([[5.5, 2, 1], [3.5, 2, 1], [0, 3.5, 0.5], [0, 0.5, 0.5]])
    normals = np.array([[0, -1, 0], [0, -1, 0], [1, 0, 0], [1, 0, 0]])
    for k, free in enumerate([True, False, True, False]):
        hung = Deployment(marks[k : k + 1], normals[k : k + 1]).with_surfaces(room)
        assert (hung.fault(room) is None) == free


@examples(40)
@given(prisms(), seeds)
def test_positions_are_in_the_room_and_free(room, seed):
    rng = np.random.default_rng(seed)
    grid, jittered, drawn = room.grid(), room.jittered_grid(3, rng), room.sample(50, rng)
    assert 3 * len(grid) == len(jittered)
    for points in (grid, jittered, drawn, room.sample_evenly(50, rng)):
        assert room.contains(points).all()
        on_ground = shapely.points(points[:, :2])
        assert (shapely.distance(room.plan.ground, on_ground) <= 2e-6).all()
        for obstacle in room.plan.obstacles:
            inside = ((points > np.array(obstacle.low) + 2e-6) & (points < np.array(obstacle.high) - 2e-6)).all(axis=1)
            assert not inside.any()


def test_every_position_that_is_spread_evenly_is_uniform_where_the_camera_may_be():
    # Two narrow arms of unlike length: most points of the box around them cannot be reached.
    room = Prism(FloorPlan([[0, 0], [9, 0], [9, 1], [1, 1], [1, 4], [0, 4]], 2.5), Reachable((0.5, 2.0)), 0.25)
    rng = np.random.default_rng(0)
    drawn = np.stack([room.sample_evenly(8, rng) for _ in range(800)])
    expected = (room.sample(200_000, rng)[:, 0] > 1.0).mean()
    error = np.sqrt(expected * (1.0 - expected) / len(drawn))
    assert (abs((drawn[..., 0] > 1.0).mean(axis=0) - expected) < 4.5 * error).all()
    many = np.array([(room.sample_evenly(500, rng)[:, 0] > 1.0).mean() for _ in range(40)])
    assert many.mean() == pytest.approx(expected, abs=0.005)
    assert many.std() < 0.5 * np.sqrt(expected * (1.0 - expected) / 500)


def test_positions_of_one_cell_are_spread_over_it_and_come_in_the_order_of_the_grid():
    room = Prism(FloorPlan([[0, 0], [3, 0], [3, 2], [0, 2]], 2.5), Reachable((0.5, 2.0)), 0.5)
    drawn = room.jittered_grid(5, np.random.default_rng(0)).reshape(5, -1, 3)
    from_grid = (drawn - room.grid()) / 0.5 + 0.5
    assert ((from_grid > 0.0) & (from_grid < 1.0)).all()
    assert_array_equal(
        np.sort(np.floor(5 * from_grid), axis=0), np.broadcast_to(np.arange(5)[:, None, None], from_grid.shape)
    )


NOTCHES = [[-3.9, 4.6], [-2.1, 2.1], [-2.5, 1.6], [-1.9, 0.7], [-5.7, -1.8], [0, -4], [4.8, -3.6], [1.7, -1]]


@pytest.mark.parametrize("seed", [None, *range(30)])
def test_what_is_in_the_room_is_in_the_polygon_also_beyond_its_hull(seed):
    rng = np.random.default_rng(seed or 0)
    polygon = shapely.Polygon(NOTCHES) if seed is None else star(rng)
    low, high = np.array(polygon.bounds).reshape(2, 2)
    points = rng.uniform(low - 2.0, high + 2.0, (2000, 2))
    sure = shapely.distance(polygon.boundary, shapely.points(points)) > 1e-4
    inside = plan_of(shapely.orient_polygons(polygon)).contains(np.pad(points, [(0, 0), (0, 1)], constant_values=1.0))
    np.testing.assert_array_equal(inside[sure], shapely.contains_xy(polygon, *points[sure].T))


def test_no_tag_hangs_on_a_face_where_a_pillar_stands_before_it():
    box = {"low": [0.5, 2.0, 0.0], "high": [4.0, 2.5, 1.8], "faces": ["y_min"]}
    pillar = [[1, 1], [2, 1], [2, 2], [1, 2]]
    plan = FloorPlan([[0, 0], [8, 0], [8, 6], [0, 6]], 2.5, holes=[pillar], obstacles=[box], surfaces=["wall_0"])
    *_, face = plan.carriers
    assert_allclose(face.area, 2.5 * 1.8)  # by hand: 3.5 m wide, less the metre of the pillar


def test_positions_keep_their_clearance():
    room = lab(spacing=0.125, clearance=0.25)
    for points in (
        room.grid(),
        room.jittered_grid(1, np.random.default_rng(0)),
        room.sample(500, np.random.default_rng(1)),
    ):
        below = points[:, 2] < 1.75
        assert (shapely.distance(GROUND.exterior, shapely.points(points[below, :2])) >= 0.25 - 2e-6).all()
        assert (
            shapely.distance(shapely.box(1.25, 1.25, 1.75, 1.75), shapely.points(points[:, :2])) >= 0.25 - 2e-6
        ).all()


@examples(25)
@given(prisms(), seeds)
def test_what_is_drawn_decoded_and_pushed_hangs_where_it_may(room, seed):
    rng = np.random.default_rng(seed)
    deployment = RandomDeployment(30).draw(room, rng)
    assert hangs_properly(room, deployment.positions, deployment.surfaces).all()
    assert (room.surfaces_of(deployment.positions, deployment.normals) >= 0).all()
    encoding = make_encoding("wall", room, True)
    genes = rng.random((3, 30 * encoding.genes_per_landmark))
    positions, _, surfaces = encoding.decode(genes)
    assert hangs_properly(room, positions.reshape(-1, 3), surfaces.ravel()).all()
    back, _, there = encoding.decode(encoding.encode(deployment)[None])
    assert_allclose(back[0], deployment.positions, atol=1e-7)
    assert_array_equal(there[0], deployment.surfaces)


@pytest.mark.parametrize("kind", ["wall", "paper"])
def test_genes_mean_places_where_tags_may_hang(kind):
    footprints = Footprints(lab(margin=0.05), Tag(0.2, quiet_zone=0.0))
    encoding = make_encoding(kind, footprints.hanging, True)
    genes = np.random.default_rng(0).random((4, 25 * encoding.genes_per_landmark))
    positions, _, surfaces, fits = footprints.pushed(*encoding.decode(genes), np.full(25, np.nan))
    assert fits.all()
    assert hangs_properly(footprints.room, positions.reshape(-1, 3), surfaces.ravel(), 0.2).all()
    start = footprints.draw(RandomDeployment(25), np.random.default_rng(1))
    back, _, there = encoding.decode(encoding.encode(start)[None])
    assert_allclose(back[0], start.positions, atol=1e-5)
    assert_array_equal(there[0], start.surfaces)


def test_genes_reach_each_part_of_a_wall_that_has_several_names():
    room = Prism(FloorPlan([[0, 0], [3, 0], [6, 0], [6, 4], [0, 4]], 2.5), Reachable((0.5, 1.5), 0.5), 0.5)
    encoding = make_encoding("paper", room, flush=True)
    _, _, surfaces = encoding.decode(np.random.default_rng(0).random((2000, 5 * 10)))
    counts = np.bincount(surfaces.ravel(), minlength=7)
    assert counts[0] == pytest.approx(counts[1], rel=0.1)  # of some 1,400 each
    assert counts.min() > 0


def test_uniform_and_candidates_hang_where_they_may():
    footprints = Footprints(lab(), Tag(0.15, quiet_zone=0.0))
    uniform = footprints.draw(UniformDeployment(28), np.random.default_rng(0))
    poses = candidate_poses(footprints.hanging, 0.2)
    for deployment in (uniform, poses):
        assert hangs_properly(footprints.room, deployment.positions, deployment.surfaces, 0.15).all()
    cells = wall_cells(footprints.hanging, 0.2)
    area = 4.0 * np.linalg.norm(cells.half_u, axis=1) * np.linalg.norm(cells.half_v, axis=1)
    assert_allclose(area.sum(), sum(s.area for s in footprints.hanging.surfaces()))


def test_random_landmarks_are_uniform_over_slanting_regions():
    plan = FloorPlan([[0, 0], [4, 0], [0, 4]], 2.5, surfaces=["floor"])
    points = RandomDeployment(20_000).draw(Prism(plan, Reachable((1, 1)), 0.5), np.random.default_rng(0)).positions
    assert_allclose(points[:, :2].mean(axis=0), 4.0 / 3.0, atol=0.03)
    for share, side in ((0.25, 2.0), (0.5, 4.0 * np.sqrt(0.5))):  # of a triangle alike
        assert (points[:, 0] + points[:, 1] < side).mean() == pytest.approx(share, abs=0.01)
