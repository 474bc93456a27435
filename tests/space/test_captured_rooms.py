"""Rooms as they are captured, in which walls, floor and furniture do not meet as they do in a model."""

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, strategies
from numpy.testing import assert_array_equal
from support.rooms import captured, quad
from support.thorough import examples

from lmd.core.checks import InputError
from lmd.formats.meshes import read_mesh, read_mesh_room
from lmd.optimisers.encoding import make_encoding
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.tag import Tag
from lmd.space.scan import Scan

HEIGHT = {"height": [0.5, 1.9], "clearance": 0.3}


def starts(room, edge, rng):
    """Deployments as optimisers start from them, and as they decode them."""
    footprints = Footprints(room, Tag(edge, quiet_zone=0.0))
    for source in (RandomDeployment(40), RandomDeployment(40), UniformDeployment(8)):
        yield footprints.draw(source, rng)
    encoding = make_encoding("wall", footprints.hanging, True)
    genes = rng.random((1, 20 * encoding.genes_per_landmark))
    positions, normals, surfaces, _ = footprints.pushed(*encoding.decode(genes), np.full(20, np.nan))
    yield Deployment(positions[0], normals[0], surfaces[0])


@given(seed=strategies.integers(0, 2**32 - 1))
@examples(10)
def test_what_is_placed_hangs_in_the_room(seed, tmp_path_factory):
    rng = np.random.default_rng(seed)
    room = read_mesh_room(captured(tmp_path_factory.mktemp("room") / "room.glb", rng), HEIGHT, 0.5, up="z")
    for edge in (0.0, 0.12):
        for deployment in starts(room, edge, rng):
            hung = deployment.movable(room)
            assert_array_equal(hung.surfaces, deployment.surfaces)
            rounded = Deployment(deployment.positions.round(6), deployment.normals)
            assert rounded.with_surfaces(room).fault(room) is None


def shell(*more):
    """A room of 4 x 4 x 2.5 m without a floor, and more quads."""
    x, y, z = np.diag([4.0, 4.0, 2.5])
    walls = [quad(0.0 * x, x, z), quad(0.0 * x, y, z), quad(y, x, z), quad(x, y, z), quad(z, x, y)]
    return [*walls, *more]


def room_of(path, quads, **more):
    scene = trimesh.Scene()
    for i, part in enumerate(quads):
        scene.add_geometry(part, node_name=f"part_{i}")
    scene.export(path)
    return read_mesh_room(path, HEIGHT, 0.5, up="z", **more)


def test_of_patches_in_one_plane_a_landmark_has_the_one_that_it_hangs_on(tmp_path):
    """The rectangle around an L holds what lies in its corner."""
    x, y = 2.0 * np.eye(3)[:2]
    long = trimesh.util.concatenate([quad(at, x, y) for at in (0.0 * x, x, y)])
    long.merge_vertices()
    room = room_of(tmp_path / "room.glb", shell(long, quad(1.01 * (x + y), 0.99 * x, 0.99 * y)))
    floor = [surface for surface in room.surfaces() if surface.normal[2] > 0.9]
    assert [round(surface.area, 2) for surface in floor] == [12.0, 3.92]
    drawn = RandomDeployment(300).draw(room, np.random.default_rng(0))
    assert_array_equal(drawn.movable(room).surfaces, drawn.surfaces)


def test_nothing_hangs_below_the_floor_beyond_a_wall_or_in_furniture(tmp_path):
    x, y, z = np.eye(3)
    wall = quad(-1.0 * x - 0.3 * z, 6.0 * x, 2.8 * z)  # 1 m longer on both sides, and 0.3 m below the floor
    box = trimesh.creation.box(bounds=[[1.0, -0.5, -0.2], [2.0, 0.4, 1.0]])
    room = room_of(tmp_path / "room.glb", [*shell(quad(0.0 * x, 4.0 * x, 4.0 * y), box)[1:], wall])
    (carrier,) = [surface for surface in room.surfaces() if surface.name.startswith("part_6")]
    hanging = shapely.transform(carrier.allowed, lambda at: at + (carrier.origin @ np.array([carrier.u, carrier.v]).T))
    expected = shapely.box(0.0, 0.0, 4.0, 2.5).difference(shapely.box(1.0, 0.0, 2.0, 1.0))
    expected = expected if carrier.u[0] > 0 else shapely.transform(expected, lambda at: at * [-1, 1])
    assert hanging.symmetric_difference(expected).area == pytest.approx(0.0, abs=1e-3)


def test_which_way_is_up_is_asked_where_it_is_hard_to_tell(tmp_path):
    """Walls of a captured room are upright, and turned against the axes of the file."""
    turned = str(captured(tmp_path / "turned.obj", np.random.default_rng(1)))
    assert Scan(read_mesh(turned)).doubt is None
    scene = trimesh.load_scene(turned, split_objects=True, process=False)
    scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # y up
    scene.export(tmp_path / "lying.obj")
    lying = str(tmp_path / "lying.obj")
    with pytest.raises(InputError, match=r"^up must be given for .*: with z up .*; with y up .* m high, .* of floor"):
        Scan(read_mesh(lying))
    assert Scan(read_mesh(lying, up="y")).doubt is None
    assert Scan(read_mesh(lying, up="z")).doubt.startswith("with z up it is ")


def test_a_room_in_line_with_the_axes_is_taken_to_be_wider_than_high(tmp_path):
    tall = trimesh.creation.box(extents=[6.0, 2.5, 4.0])
    tall.export(tmp_path / "tall.stl")
    with pytest.raises(InputError, match=r"^up must be given .* it is 4 m high, with 15 m2 .* it is 2\.5 m high"):
        Scan(read_mesh(tmp_path / "tall.stl"))
    assert Scan(read_mesh(tmp_path / "tall.stl", up="z")).doubt is None
    part = {"surface": "patch_0", "from_left": [0.0, 6.1], "from_below": [0.0, 1.0]}
    with pytest.raises(InputError, match=r"^keep_out\[0\] reaches 0\.1 m beyond patch_0, which is 6 x 4 m\.$"):
        Scan(read_mesh(tmp_path / "tall.stl", up="z"), keep_out=[part])
