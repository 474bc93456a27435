from dataclasses import replace

import numpy as np
import pytest
from support.tables import rows

from lmd.detection.corner_errors import apparent_edge, incidence, pitch
from lmd.geometry.camera import Camera
from lmd.geometry.projection import blur_disc, blur_sigma, project
from lmd.geometry.se3 import camera_pose
from lmd.scene.tag import Tag

CAMERA = Camera(5.0, 0.0058, 0.005, (800.0, 600.0), 1600.0, 1200.0, 10.0, 1778.0)
TAG = Tag(0.16, "36h11")


def views(count, rng):
    """Cameras and one tag in front of each, at random."""
    poses = camera_pose(rng.normal(size=(count, 3)), *rng.uniform(-1.5, 1.5, (3, count)))
    local = rng.uniform([-0.8, -0.6, 1.0], [0.8, 0.6, 1.0], (count, 3)) * rng.uniform(0.5, 6.0, (count, 1))
    centres = (poses[:, :3, :3] @ local[..., None])[..., 0] + poses[:, :3, 3]
    normals = rng.normal(size=(count, 3))
    return poses, centres, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def derivative(camera, pose, centre, normal, step=1e-5):
    """d(pixel)/d(metre) in the tag's plane by central differences of the projector, (2, 2)."""
    basis = np.linalg.svd(normal[None])[2][1:]
    ends = project(camera, pose, centre + step * np.concatenate([basis, -basis]))
    return (ends[:2] - ends[2:]).T / (2.0 * step)


@pytest.mark.parametrize(("model", "distortion"), rows(__file__, "lenses of tags"))
def test_pitch_and_edge_are_those_of_the_projector(model, distortion):
    camera = replace(CAMERA, distortion=distortion, distortion_model=model)
    for pose, centre, normal in zip(*views(200, np.random.default_rng(0)), strict=True):
        jacobian = derivative(camera, pose, centre, normal)
        arguments = (camera, pose, centre[None], normal[None], TAG)
        smallest = np.linalg.svd(jacobian, compute_uv=False)[1]
        np.testing.assert_allclose(pitch(*arguments), smallest * 0.16 / 8, rtol=1e-5, atol=1e-6)
        area = abs(np.linalg.det(jacobian))
        np.testing.assert_allclose(apparent_edge(*arguments), np.sqrt(area) * 0.16, rtol=1e-5, atol=1e-6)


def test_pitch_by_hand():
    # Face to face 2 m ahead: 5 / 0.0058 / 2 = 431.03 pixels a metre across, 500 down, and a module has 2 cm.
    pose, centre = camera_pose([0.0, 0.0, 0.0], 0.0, 0.0), np.array([[0.0, 2.0, 0.0]])
    facing = np.array([[0.0, -1.0, 0.0]])
    assert pitch(CAMERA, pose, centre, facing, TAG) == pytest.approx(8.6207, abs=1e-4)
    assert apparent_edge(CAMERA, pose, centre, facing, TAG) == pytest.approx(np.sqrt(431.0345 * 500.0) * 0.16, abs=1e-3)
    leaning = np.array([[np.sin(np.pi / 3), -np.cos(np.pi / 3), 0.0]])
    assert pitch(CAMERA, pose, centre, leaning, TAG) == pytest.approx(8.6207 / 2.0, abs=1e-4)
    assert incidence(pose, centre, leaning) == pytest.approx(np.pi / 3)
    assert incidence(pose, centre, -facing) == pytest.approx(np.pi)


def test_shapes_and_what_is_behind():
    poses, centres, normals = views(5, np.random.default_rng(1))
    all_pairs = pitch(CAMERA, poses, centres, normals, TAG)
    assert all_pairs.shape == (5, 5)
    one = pitch(CAMERA, poses[2], centres[3:4], normals[3:4], TAG)
    np.testing.assert_allclose(all_pairs[2, 3], one[0])
    behind = poses[0, :3, 3] - poses[0, :3, 2]
    assert np.isnan(pitch(CAMERA, poses[0], behind[None], normals[:1], TAG)).all()


def test_blur_is_that_of_the_depth_of_field():
    near, far = CAMERA.depth_of_field(3.0)
    np.testing.assert_allclose(blur_disc(CAMERA, [near, far]), 3.0)
    assert blur_disc(CAMERA, 1.778) == 0.0
    assert blur_sigma(CAMERA, near, 0.5) == pytest.approx(np.hypot(0.5, 0.75))
    at_infinity = Camera(4.0, 0.003, 0.003, (800.0, 600.0), 1600.0, 1200.0, 1.5, float("inf"))
    np.testing.assert_allclose(blur_disc(at_infinity, at_infinity.depth_of_field(3.0)[0]), 3.0)
