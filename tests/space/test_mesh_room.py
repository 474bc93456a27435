import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import paper_camera
from support.rooms import DOOR, L_SHAPE, PILLAR, RACK, hangs_properly, mesh_room, walls_of

from lmd.core.checks import InputError
from lmd.formats.meshes import read_mesh_room
from lmd.geometry.se3 import camera_pose
from lmd.geometry.trajectory import Trajectory
from lmd.optimisers.encoding import make_encoding
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.paper import Visibility
from lmd.sight.reference import counts as reference_counts
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism
from lmd.space.space import check_inside

L = FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK])
BOX = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], 2.5)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """The L with its pillar and its rack."""
    return mesh_room(tmp_path_factory.mktemp("mesh") / "lab.glb", L)


def surfaces(room):
    return {s.name: s for s in room.surfaces()}


def side_of(surface):
    """Position of the plane of a surface, its normal and its area."""
    return (*np.round([surface.normal @ surface.origin, *surface.normal, surface.area], 5).tolist(),)


def test_patches_are_the_surfaces_of_the_floor_plan(room):
    same = Prism(FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[{**RACK, "faces": ["x_max", "y_min"]}]), (
        Reachable((0.5, 1.5), 0.25)), 0.5)  # fmt: skip
    assert sorted(map(side_of, room.surfaces())) == sorted(map(side_of, same.surfaces()))
    assert_array_equal(room.grid(), same.grid())


def test_patches_have_the_names_of_their_objects_or_numbers_from_the_largest(room, tmp_path):
    assert list(surfaces(room))[:2] == ["shell_0", "shell_1"]
    assert {"box_0_1", "box_0_2"} <= set(surfaces(room))  # side and front; its top is above the camera
    plain = list(surfaces(mesh_room(tmp_path / "lab.stl", L)))
    assert plain[:3] == ["patch_0", "patch_1", "patch_2"]


@pytest.mark.parametrize("inverted", [False, True])
def test_normals_point_to_where_the_camera_is_whichever_way_the_file_has_them(inverted, tmp_path):
    mesh = walls_of(BOX)
    if inverted:
        mesh.invert()
    mesh.export(tmp_path / "box.ply")
    room = read_mesh_room(str(tmp_path / "box.ply"), {"height": [0.5, 1.5], "clearance": 0.5}, 0.5)
    assert len(room.surfaces()) == 6
    for surface in room.surfaces():
        middle = surface.point(*(length / 2 for length in surface.extent))
        assert ((room.grid() - middle) @ surface.normal > 0).all()
        assert_allclose(np.cross(surface.u, surface.v), surface.normal)


@pytest.mark.parametrize("name", ["box.glb", "box.obj", "box.stl", "box.ply"])
def test_scale_and_axes_are_those_of_the_file(name, tmp_path):
    mesh = walls_of(BOX)
    mesh.apply_scale(1000.0)
    mesh.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # y up
    mesh.export(tmp_path / name)
    up = {} if name == "box.glb" else {"up": "y"}
    room = read_mesh_room(str(tmp_path / name), {"height": [0.5, 1.5]}, 0.5, scale=0.001, **up)
    assert_allclose(room.bounds(), [[0, 0, 0], [6, 4, 2.5]], atol=1e-6)


TAGS = pytest.param(Fiducial(Tag(0.15)), id="fiducial", marks=pytest.mark.thorough("lmd/sight", "lmd/space"))


@pytest.mark.parametrize("visibility", [pytest.param(Visibility(thold=0.1), id="paper"), TAGS])
@pytest.mark.parametrize("plan", [L, BOX], ids=["L", "cuboid"])
def test_counts_are_those_of_the_floor_plan_and_of_the_reference(plan, visibility, tmp_path):
    mesh = mesh_room(tmp_path / "room.ply", plan)
    same = Prism(plan, Reachable((0.5, 1.5), 0.25), 0.5)
    if plan is BOX:
        mesh = mesh_room(tmp_path / "room.ply", plan, height=(0.75, 1.75))
        same = Cuboid((6.0, 4.0, 2.5), (5.5, 3.5, 1.0), 0.5)
        assert_array_equal(mesh.grid(), same.grid())
    rng = np.random.default_rng(0)
    footprints = Footprints(same, Tag(0.2, quiet_zone=0.0))
    drawn = [footprints.draw(RandomDeployment(20), rng), footprints.draw(UniformDeployment(24), rng)]
    for deployment in drawn:
        scenes = [Scene(place, paper_camera(), pdf.grid_with_ends(6), visibility) for place in (same, mesh)]
        here, there = (Evaluator(scene, threads=2).counts(deployment) for scene in scenes)
        assert_array_equal(here, there)
        assert_array_equal(there, reference_counts(scenes[1], deployment))
        assert there.any()


def test_positions_are_free_and_keep_their_clearance(room):
    rng = np.random.default_rng(0)
    same = Prism(L, Reachable((0.5, 1.5), 0.25), 0.5)
    drawn = room.sample(500, rng)
    for points in (drawn, room.jittered_grid(1, rng)):
        assert room.contains(points).all()
        assert same.contains(points).all()
    tried = rng.uniform([0, 0, 0], [6, 4, 2.5], (3000, 3))
    sure = np.abs(same.plan.contains(tried, 1e-3).astype(int) - same.plan.contains(tried)) == 0
    assert_array_equal(room.contains(tried)[sure], same.contains(tried)[sure])


def test_a_box_may_be_given_for_the_positions(tmp_path):
    reachable = {"low": [0.5, 0.5, 1.0], "high": [5.5, 3.5, 1.0]}
    mesh_room(tmp_path / "lab.ply", L)
    room = read_mesh_room(str(tmp_path / "lab.ply"), reachable, 0.5)
    assert set(room.grid()[:, 2]) == {1.0}
    assert Prism(L, Reachable((0.5, 1.5)), 0.5).contains(room.grid()).all()


def test_tags_hang_where_they_may(room, tmp_path):
    kept = mesh_room(tmp_path / "lab.ply", L, surfaces=["patch_2", "patch_4"], band=[0.25, 2.25], margin=0.1,
                     keep_out=[{**DOOR, "surface": "patch_2"}])  # fmt: skip
    assert_allclose([s.area for s in kept.surfaces()], [5.8 * 2.0 - 1.2 * 1.85, 2.8 * 2.0], atol=1e-6)
    for place in (room, kept):
        footprints = Footprints(place, Tag(0.15, quiet_zone=0.0))
        drawn = footprints.draw(RandomDeployment(20), np.random.default_rng(0))
        assert hangs_properly(place, drawn.positions, drawn.surfaces, 0.15).all()
        assert_array_equal(place.surfaces_of(drawn.positions, drawn.normals), drawn.surfaces)
        encoding = make_encoding("wall", footprints.hanging, True)
        genes = np.random.default_rng(1).random((2, 15 * 3))[:, : 15 * encoding.genes_per_landmark]
        decoded, _, on, fits = footprints.pushed(*encoding.decode(genes), np.full(15, np.nan))
        assert hangs_properly(place, decoded.reshape(-1, 3), on.ravel(), 0.15).all()
        assert fits.all()


def test_a_wall_that_is_not_quite_upright_has_the_band_too(tmp_path):
    mesh = walls_of(BOX)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(1e-6, [1, 0, 0]))
    mesh.export(tmp_path / "tilted.ply")
    room = read_mesh_room(str(tmp_path / "tilted.ply"), {"height": [0.5, 1.5]}, 0.5, band=[1.0, 1.5])
    walls = sorted(surface.area for surface in room.surfaces() if surface.is_upright)
    assert_allclose(walls, [2.0, 2.0, 3.0, 3.0], atol=1e-4)


def test_flights_go_around_what_stands_there(room):
    def flight(*places):
        return Trajectory(
            np.arange(len(places)), camera_pose(np.array(places, dtype=float), *np.zeros((2, len(places))))
        )

    check_inside(flight([5, 1, 1], [2.5, 0.7, 1], [2.5, 3, 1]), room)
    with pytest.raises(
        InputError, match=r"straight path from \(1, 1\.5, 1\) .* through an obstacle .* room from a mesh"
    ):
        check_inside(flight([1, 1.5, 1], [2, 1.5, 1]), room)
    with pytest.raises(InputError, match=r"\(1\.5, 1\.5, 1\), is outside the room from a mesh of 6 x 4 x 2\.5 m"):
        check_inside(flight([1, 1.5, 1], [1.5, 1.5, 1]), room)
    assert not room.passable(np.array([5.0, 1.0, 1.0]), np.array([1.0, 2.5, 1.0]))  # across the corner
    same, rng = Prism(L, Reachable((0.5, 1.5), 0.0), 0.5), np.random.default_rng(3)
    one, two = room.sample(300, rng), room.sample(300, rng)
    assert_array_equal(room.clear(one, two), same.clear(one, two))
    for away, where in ((0.249, True), (0.251, False)):
        legs = np.array([[1.75 + away, 0.5, 1.0], [1.75 + away, 3.0, 1.0]])  # beside the pillar
        assert room.passable(*legs) != where
