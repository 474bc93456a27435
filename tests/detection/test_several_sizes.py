"""Tags of three sizes in one map: what OpenCV finds of their rendered image is what OpenCV projects. Takes a second."""

import cv2
import numpy as np
import pytest

from lmd.detection.detectors import ArucoDetector
from lmd.detection.frames import overlapping, qualities, tagged_room
from lmd.estimation.sensors import observation
from lmd.evaluation.maps import MountedTags
from lmd.formats.tag_maps import read_deployment
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

ROOM = Cuboid((4.0, 3.0, 3.0), (2.0, 1.0, 1.0), 0.5)
CAMERA = Camera(5.0, 0.0116, 0.0116, (400.0, 300.0), 800.0, 600.0, 0.0, distortion=(-0.05, 0.01, 0.001, -0.001))
POSE = camera_pose([1.95, 2.2, 1.45], 0.1, 0.05, 0.1)
# id, edge, x and z on the wall y = 3
TAGS = ((7, 0.06, 1.75, 1.55), (3, 0.1, 2.25, 1.6), (12, 0.2, 2.1, 1.35), (9, 0.06, 1.72, 1.3))
MAP = "# id length x y z yaw pitch roll\n" + "".join(
    f"{number} {edge} {x} 3 {z} 0 0 1.5707963267948966\n" for number, edge, x, z in TAGS
)  # Clover's


@pytest.fixture
def renderer(tmp_path):
    path = tmp_path / "map.txt"
    path.write_text(MAP)
    # The edge of the tag holds for none: the map says all.
    hung = read_deployment(path, family="4x4_50").with_surfaces(ROOM)
    return Renderer(CAMERA, tagged_room(ROOM, hung, Tag(0.5, "4x4_50")), Imaging(texture=4.0))


def by_opencv():
    """Corners from the top left clockwise, `(K, 4, 2)`, projected by OpenCV alone."""
    wall = [
        [(x + a * edge / 2.0, 3.0, z + b * edge / 2.0) for a, b in ((-1, 1), (1, 1), (1, -1), (-1, -1))]
        for _, edge, x, z in TAGS
    ]
    turn, (focal, centre) = POSE[:3, :3].T, (5.0 / 0.0116, (400.0, 300.0))
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    points = np.array(wall).reshape(-1, 3)
    image, _ = cv2.projectPoints(
        points, cv2.Rodrigues(turn)[0], -turn @ POSE[:3, 3], matrix, np.array(CAMERA.distortion)
    )
    return image.reshape(-1, 4, 2)


def test_each_size_is_where_opencv_projects_it(renderer):
    expected = by_opencv()
    np.testing.assert_allclose(renderer.corners(POSE), expected, atol=1e-6)
    assert not overlapping(renderer.room).any()
    found = ArucoDetector("4x4_50").detect(renderer.frame(POSE, np.random.default_rng(0)))
    assert sorted(found.ids) == sorted(number for number, *_ in TAGS)
    corners = found.corners[[found.ids.tolist().index(number) for number, *_ in TAGS]]
    off = np.linalg.norm(corners - expected, axis=-1)
    assert off.max() < 0.6
    assert np.abs((corners - expected).mean(axis=(0, 1))).max() < 0.15  # no half pixel


def test_each_size_is_as_far_as_it_is(renderer):
    edges = np.array([edge for _, edge, *_ in TAGS])
    seen = np.ones((1, len(TAGS)), dtype=bool)
    observed = observation(CAMERA, edges, seen, by_opencv(), np.ones(len(TAGS)))
    centres = np.array([[x, 3.0, z] for _, _, x, z in TAGS])
    np.testing.assert_allclose(observed.points[0], (centres - POSE[:3, 3]) @ POSE[:3, :3], atol=1e-4)
    pitch, _, edge, _ = (values[0] for values in qualities(renderer, POSE[None]))
    np.testing.assert_allclose(pitch[3] / pitch[2] / (edges[3] / edges[2]), 1.0, atol=0.2)
    sides = np.linalg.norm(by_opencv() - np.roll(by_opencv(), 1, axis=1), axis=-1)
    np.testing.assert_allclose(edge, sides.mean(axis=1), rtol=0.02)


def test_an_estimate_takes_the_corners_of_each_size(renderer, tmp_path):
    hung = read_deployment(tmp_path / "map.txt", family="4x4_50")
    points = MountedTags.of(hung).points(Tag(0.5, "4x4_50"))
    np.testing.assert_allclose(points, renderer.room.corners, atol=1e-12)
