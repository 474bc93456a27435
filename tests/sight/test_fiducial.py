"""Visibility by a detector: the equations against independent ones, and every fast path against the reference."""

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts.criterion import check_counts, check_every_path, tilted
from hypothesis import given
from support.paper import paper_camera, paper_room
from support.strategies import unit_vectors

from lmd.detection.corner_errors import apparent_edge, incidence, pitch
from lmd.geometry.camera import Camera
from lmd.geometry.projection import blur_sigma, depth_in_focus, project, to_camera
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.geometry.squares import VERTICAL_TOLERANCE, corners, upright
from lmd.scene import pdf
from lmd.scene.criteria import sized
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits, measured
from lmd.sight.obstacles import half_edge
from lmd.sight.views import visible

pytestmark = pytest.mark.slow  # images, or kernels of a second model of sight


LENSES = {
    "none": {},
    "barrel": {"distortion": (-0.12, 0.01, 0.002, -0.003)},
    "pincushion": {"distortion": (0.1, 0.02, -0.003, 0.001, 0.01)},
    "rational": {"distortion": (0.15, -0.04, 0.001, 0.0, 0.004, 0.5, -0.07, 0.006, 0.001, 0.0, -0.002, 0.001)},
    # 82 degrees from the axis to the borders, 103 to the corners.
    "fisheye": {
        "distortion": (0.003, 0.001, -0.002, 0.0002),
        "distortion_model": "equidistant",
        "pixel_width": 0.009,
        "pixel_height": 0.009,
    },
}


def fiducial_scene(room=None, orientations=None, edge=0.1, lens="none", **fiducial):
    camera, orientations = paper_camera(**LENSES[lens]), orientations or pdf.grid_with_ends()
    return Scene(room or paper_room(), camera, orientations, Fiducial(Tag(edge), **fiducial))


@given(unit_vectors)
def test_tags_hang_upright(normal):
    right, up = upright(normal)
    np.testing.assert_allclose(np.stack([right, up, normal]) @ np.stack([right, up, normal]).T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(up, normal), right, atol=1e-12)
    assert (up[2] > 0.0 and abs(right[2]) < 1e-15) if np.hypot(*normal[:2]) > VERTICAL_TOLERANCE else up[1] > 0.9


def by_the_detection_package(scene, deployment, poses):
    """Whether each pose sees each tag, nobody hiding it, by the functions that judge rendered tags; and how surely."""
    camera, fiducial, limits = scene.camera, scene.visibility, scene.visibility.limits
    centres, normals, tag = deployment.positions, deployment.normals, scene.visibility.tag
    depth = depth_in_focus(camera, to_camera(poses, centres))
    with np.errstate(all="ignore"):
        sigma = np.hypot(blur_sigma(camera, depth, fiducial.psf_sigma), fiducial.motion_blur / math.sqrt(12.0))
        least = np.hypot(limits.pitch, limits.blur * sigma)
        square = corners(centres, normals, upright(normals)[1], tag.picture_edge)
        points = project(camera, poses, square.reshape(-1, 3)).reshape(*depth.shape, 4, 2)
        if camera.lens is not None:  # which need not show what is between the corners
            points = np.concatenate([points, project(camera, poses, centres)[..., None, :]], axis=-2)
        size = np.array([camera.image_width, camera.image_height])
        inside = np.minimum(points, size - points).min(axis=(-1, -2)) - limits.margin
        ratios = [
            pitch(camera, poses, centres, normals, tag) / least - 1.0,
            apparent_edge(camera, poses, centres, normals, tag) / limits.edge - 1.0,
            np.cos(incidence(poses, centres, normals)) - math.cos(math.radians(limits.incidence)),
            inside / size.max(),
        ]
    slack = np.min(np.where(np.isnan(ratios), -1.0, ratios), axis=0)
    return slack > 0.0, np.abs(slack) > 1e-6


@pytest.mark.parametrize("lens", LENSES)
def test_the_reference_sees_some_tags_and_not_others(lens):
    scene, rng = fiducial_scene(lens=lens), np.random.default_rng(0)
    deployment = RandomDeployment(60).draw(scene.room, rng)
    position, poses = np.array([3.0, 2.0, 2.0]), camera_pose(np.array([3.0, 2.0, 2.0]), *rng.uniform(-3, 3, (3, 500)))
    seen = reference.coverage_caps(scene, deployment, position, axis_and_right(poses))
    expected, sure = by_the_detection_package(scene, deployment, poses)
    np.testing.assert_array_equal(seen[sure], expected[sure])
    assert 0.02 < seen.mean() < 0.2
    assert sure.mean() > 0.99


def test_without_limits_of_pitch_and_blur_the_area_alone_decides():
    """The slope of the bound of the depth is zero there, and every tag was unreached."""
    sharp = Camera(2.0, 0.01, 0.01, (400.0, 300.0), 800, 600, 0.0)
    scene = replace(fiducial_scene(limits=Limits(0.0, 1.8, 16.0, 83.0, 3.0), psf_sigma=0.0), camera=sharp)
    deployment = RandomDeployment(60).draw(scene.room, np.random.default_rng(0))
    axes, position = scene.orientations.axes, np.array([3.0, 2.0, 2.0])
    expected = reference.coverage_caps(scene, deployment, position, axes)
    seen = visible(Evaluator(scene, threads=1), deployment, np.tile(position, (len(axes), 1)), axes)
    np.testing.assert_array_equal(seen, expected)
    assert expected.any()


def check_paths(scene, deployment, targets, n, rng):
    """Every path; behind a lens evaluations alone: `test_field_laws` has its moves, which take long to compile."""
    if scene.camera.lens is not None:
        check_counts(scene, deployment, n)
    else:
        check_every_path(scene, deployment, targets, n, rng)


DETECTORS = sorted({detector for detector, _ in measured()})


@pytest.mark.parametrize(
    ("detector", "lens", "edge"),
    [
        *((detector, "none", edge) for detector, edge in zip(DETECTORS, np.resize([0.05, 0.1, 0.3], 9), strict=False)),
        ("aruco", "barrel", 0.3),
        ("apriltag", "pincushion", 0.1),
        ("aruco", "rational", 0.05),
        *(("apriltag", "fisheye", edge) for edge in (0.05, 0.1, 0.3)),
    ],
)
def test_every_path_is_exact_in_the_papers_room(detector, lens, edge):
    rng = np.random.default_rng(0)
    orientations = pdf.OrientationPdf(*rng.uniform(-1.5, 1.5, (2, 64)), np.full(64, 1 / 64), roll=rng.normal(size=64))
    scene = fiducial_scene(paper_room(spacing=1.5), orientations, edge, lens, detector=detector)
    deployment, targets = (RandomDeployment(40).draw(scene.room, rng) for _ in range(2))
    for one in (deployment, tilted(deployment, rng)):
        check_paths(scene, one, targets, 2, rng)


@pytest.mark.parametrize("lens", LENSES)
def test_the_sight_of_a_tag_has_the_numbers_of_a_scene_with_tags_of_its_size(lens):
    plain = fiducial_scene(lens=lens)
    scene = plain.sized(np.resize([0.05, 0.1, 0.3], 24))
    assert np.shape(half_edge(scene.sight)) == (24,)
    for k, edge in enumerate(scene.edges):
        mine, alone = sized(scene.sight, k), plain.sized(np.array([edge])).sight
        parts = ([getattr(each, "flat", each), *getattr(each, "pinholes", ())] for each in (mine, alone))
        for one, other in zip(*parts, strict=True):
            assert one._replace(inset=0.0, reach=0.0) == other._replace(inset=0.0, reach=0.0)


def test_a_plate_hides_what_is_behind_it_and_never_what_is_on_its_wall():
    camera, normal = np.array([2.0, 2.0, 2.0]), np.array([0.0, -1.0, 0.0])
    scene = fiducial_scene()
    axes = axis_and_right(camera_pose(camera, 0.0, 0.0)[None])

    def seen(*offsets):
        deployment = Deployment(camera + np.array(offsets), np.tile(normal, (len(offsets), 1)))
        return reference.coverage_caps(scene, deployment, camera, axes)[0].tolist()

    assert seen((0.0, 2.0, 0.0)) == [True]
    assert seen((0.0, 2.0, 0.0), (0.0, 1.0, 0.0)) == [False, True]  # in the way
    # The paper of the nearer one, 12.5 cm, just reaches the line to the corner of the farther, or does not.
    assert seen((0.0, 2.0, 0.0), (0.0875 - 1e-6, 1.0, 0.0)) == [False, True]
    assert seen((0.0, 2.0, 0.0), (0.0875 + 1e-6, 1.0, 0.0)) == [True, True]
    assert seen((0.0, 2.0, 0.0), (0.05, 2.0, 0.05)) == [True, True]  # on the same wall, though they overlap
    deployment = RandomDeployment(300).draw(scene.room, np.random.default_rng(0))
    unhidden = scene.sight.among(*scene.room.bounds(), deployment.positions.T[None], deployment.normals.T[None])
    assert unhidden.reach > 0.0  # a camera may stand in the plane of a footprint ...
    evaluator = Evaluator(scene, threads=1)
    args = evaluator.positions.min(axis=0), evaluator.positions.max(axis=0)
    assert scene.sight.among(*args, deployment.positions.T[None], deployment.normals.T[None]).reach > 0.0  # overhang
    inside = (deployment.positions > 0.2) & (deployment.positions < scene.room.size - np.array(0.2))
    inner = deployment[inside.sum(axis=1) == 2]
    assert len(inner) > 200
    assert scene.sight.among(*args, inner.positions.T[None], inner.normals.T[None]).reach < 0.0


def test_limits_of_ones_own():
    limits = {"pitch": 1.0, "blur": 1.0, "edge": 12.0, "incidence": 80.0, "margin": 2.0}
    assert Fiducial(Tag(0.1, "7x7_50"), limits=limits).limits.edge == 12.0
    assert Fiducial(Tag(0.1), limits={"margin": 9.0}).limits.margin == 9.0


def test_without_roll_a_landscape_image_sees_wider_than_high():
    room, one = paper_room(), np.array([1.0])
    seen = []
    for roll in (0.0, math.pi / 2):
        scene = fiducial_scene(room, pdf.OrientationPdf(np.zeros(1), np.zeros(1), one, roll=roll))
        camera = np.array([3.75, 2.5, 3.0])
        wide = Deployment(camera + np.array([[1.8, 2.4, 0.0], [0.0, 2.4, 1.8]]), np.tile([0.0, -1.0, 0.0], (2, 1)))
        seen.append(reference.coverage_caps(scene, wide, camera, scene.orientations.axes)[0].tolist())
    assert seen == [[True, False], [False, True]]
    assert isinstance(scene.camera, Camera)
