"""Blur measured at the edges of rendered tags; some 3 seconds."""

import numpy as np
import pytest
from support import walks

from lmd.detection.detectors import Detections
from lmd.detection.images import blur_of, blurred
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag

TAG, CAMERA = Tag(0.2), Camera(2.2, 0.0055, 0.0055, (320.0, 240.0), 640, 480, 0.0)
TAGS = np.stack([walks.on_wall(0, along, 1.2) for along in (0.42, 0.5, 0.58)])
POSE = camera_pose(TAGS[1, :3, 3] + [0.1, 1.2, 0.1], np.pi, 0.0, 0.05)


def blur(imaging):
    """Of one view of three tags, whose corners are exact."""
    room = TaggedRoom(TAG, np.arange(3), TAGS[:, :3, 3], TAGS[:, :3, 2], TAGS[:, :3, 1])
    renderer = Renderer(CAMERA, room, imaging)
    image = renderer.frame(POSE, np.random.default_rng(0))
    return blur_of(image, Detections(np.arange(3), renderer.corners(POSE)), TAG.modules)


@pytest.mark.parametrize("sigma", [1.0, 2.0])
def test_the_blur_of_the_lens_is_found(sigma):
    assert blur(Imaging(psf_sigma=sigma, noise=1.0)) == pytest.approx(sigma, abs=0.3)


def test_the_smear_of_a_camera_that_moves_is_found():
    assert blur(Imaging(psf_sigma=0.5, noise=1.0, motion_blur=8.0)) > 2.0 * blur(Imaging(psf_sigma=0.5, noise=1.0))


def test_small_tags_say_nothing():
    small = Detections(np.array([1]), np.array([[[1, 1], [5, 1], [5, 5], [1, 5]]]))
    assert np.isnan(blur_of(np.zeros((9, 9), dtype=np.uint8), small, 8))


def test_frames_are_blurred_beside_the_others():
    assert blurred(np.array([0.6, 0.7, 2.1, np.nan, 0.6])).tolist() == [False, False, True, False, False]
    assert not blurred(np.array([0.3, 0.3, 0.9])).any()  # sharp enough
    assert not blurred(np.full(3, np.nan)).any()
