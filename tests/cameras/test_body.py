"""Bodies, and mounts on them."""

import math

import numpy as np
import pytest
from support.paper import paper_camera

from lmd.cameras.body import FACES, NORMALS, Body, Box
from lmd.cameras.mounts import MountSpace
from lmd.core.checks import InputError
from lmd.scene.rig import Mount, Rig

CUBE = {"low": [-0.4, -0.3, 0.1], "high": [0.4, 0.3, 0.6], "faces": list(FACES)}
CAMERA, OTHER = paper_camera(), paper_camera(focal_length=8.0)  # 86 x 70 degrees, 60 x 47 degrees


def space(count=1, body=None, lenses=(CAMERA,), **limits):
    return MountSpace(body or Body([CUBE]), lenses, count, **limits)


def on_grid(body, centre, rays):
    """The share of rays that enter a box within two metres, from points along them: no code is shared."""
    along = np.linspace(1e-4, 2.0, 4001)[:, None, None] * rays + centre
    inside = [
        ((along > low) & (along < high)).all(axis=-1).any(axis=0) for low, high in zip(*body.corners, strict=True)
    ]
    return np.logical_or.reduce(inside).mean()


def test_the_faces_of_a_box_are_where_they_are_called():
    low, high = np.array(CUBE["low"]), np.array(CUBE["high"])
    for face, normal in zip(Box(**CUBE).surfaces(), NORMALS, strict=True):
        corners = np.array([face.point(a, b) for a in (0.0, face.extent[0]) for b in (0.0, face.extent[1])])
        outer = np.where(normal > 0.0, high, low)[normal != 0.0]
        np.testing.assert_allclose(corners[:, normal != 0.0], np.broadcast_to(outer, (4, 1)))
        np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)][0][normal == 0.0], low[normal == 0.0])
        np.testing.assert_allclose(corners.max(axis=0)[normal == 0.0], high[normal == 0.0])
        np.testing.assert_array_equal(np.cross(face.u, face.v), face.normal)
        assert not face.is_mirrored


def test_what_rays_meet_of_the_body_is_counted():
    body = Body([CUBE, {"low": [0, 0, 0.6], "high": [0.1, 0.1, 1.0], "name": "mast", "faces": ["front"]}])
    rng = np.random.default_rng(0)
    for centre in ([0.42, 0.0, 0.3], [0.0, 0.0, 0.62], [-0.2, 0.05, 0.7], [0.0, 2.0, 0.3]):
        rays = rng.normal(size=(300, 3))
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        assert body.own_part(np.array(centre), rays) == pytest.approx(on_grid(body, np.array(centre), rays), abs=0.01)
    assert body.own_part(np.array([0.0, 0.0, 0.3]), np.eye(3)) == 1.0


def test_mounts_are_on_the_faces_outside_of_what_is_kept_out_and_in_whole_millimetres():
    door = {"surface": "front", "from_left": [0.0, 0.6], "from_below": [0.0, 0.3]}
    s = space(body=Body([CUBE], keep_out=[door], standoff=0.03))
    rng = np.random.default_rng(1)
    fronts = 0
    for _ in range(300):
        mount = s.mount(rng.random(4))
        if mount is None:
            continue
        at = np.array(mount.translation)
        np.testing.assert_array_equal(at, np.round(at, 3))
        beyond = np.maximum(np.array(CUBE["low"]) - at, at - CUBE["high"])
        assert beyond.max() == pytest.approx(0.03, abs=1e-9)
        if at[0] > 0.4:
            fronts += 1
            assert at[2] >= 0.4 - 5e-4
        assert s.own_part(mount) == 0.0
    assert fronts > 3


def test_a_camera_that_sees_its_body_is_turned_away_as_far_as_it_must():
    top = Body([CUBE | {"faces": ["top"]}])
    genes = np.array([0.5, 0.5, 0.5, 0.5])  # the middle of the top, level
    level = space(body=Body([CUBE | {"faces": ["top"]}], own_share=1.0), pitch=(-1.5, 1.5)).mount(genes)
    assert level.pitch == 0.0
    raised = space(body=top, pitch=(-1.5, 1.5)).mount(genes)
    assert -1.5 <= raised.pitch < 0.0  # up
    assert space(body=top, pitch=(-0.1, 0.1)).mount(genes) is None
    front = space(yaw=(-math.pi / 2, math.pi / 2)).mount(np.array([0.01, 0.5, 1.0, 0.5]))
    assert 0.0 < abs(front.yaw) < math.pi / 2
    assert space().own_part(front) == 0.0


def test_genes_mean_mounts_and_mounts_have_genes():
    s = space(3, lenses=(CAMERA, OTHER), roll=(-0.2, 0.2))
    rng = np.random.default_rng(2)
    for _ in range(20):
        mounts = s.mounts(s.draw(rng))
        again = s.mounts(s.genes(Rig(mounts)))
        assert {mount.camera for mount in mounts} <= {CAMERA, OTHER}
        for one, other in zip(mounts, again, strict=True):
            assert one.camera == other.camera
            np.testing.assert_allclose(one.translation, other.translation, atol=1.1e-3)
            np.testing.assert_allclose(one.rotation, other.rotation, atol=2e-3)
    with pytest.raises(InputError, match=r"^rig\[0\] is not a pose that the body allows"):
        space().genes(Rig((Mount(CAMERA, (5.0, 0.0, 0.0)),)))
    with pytest.raises(InputError, match=r"^count = 3, but the rig has 1 cameras"):
        s.genes(Rig((Mount(CAMERA),)))


def test_cameras_are_apart():
    s = space(2, apart=0.3)
    one, near, far = (Mount(CAMERA, (0.42, y, 0.3)) for y in (0.0, 0.1, -0.25))
    assert not s.are_apart([one, near])
    assert s.are_apart([near, far])
