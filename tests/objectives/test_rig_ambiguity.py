"""The two poses of a body whose cameras see a single tag: the closed form against a fit to all images; kernels."""

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from support.paper import paper_camera

from lmd.geometry.projection import intrinsics, project
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners
from lmd.objectives.localisation.ambiguity import mirrored_numbers, residual_ratio, rig_ratio

pytestmark = pytest.mark.long

NORMAL, UP, RIGHT = np.eye(3)[0], np.eye(3)[2], np.eye(3)[1]
# Of a tag at the origin that faces along x.
CAMERAS = [paper_camera(focal_length=f) for f in (3.0, 5.0, 4.0)]


def square(edge):
    return corners(np.zeros(3), NORMAL, UP, edge)


def seen_from(centre, off):
    """The pose of a camera that sees the origin `off` its axis, rad."""
    towards = -centre / np.linalg.norm(centre)
    return camera_pose(centre, np.arctan2(towards[0], towards[1]) + off, np.arcsin(towards[2]))


def residual(poses, edge):
    """sqrt(S) over all cameras, pixels."""
    total = np.zeros(5)
    for camera, pose in zip(CAMERAS, poses, strict=False):
        offset, depth = -pose[:3, 3], -pose[:3, 2] @ pose[:3, 3]
        numbers = mirrored_numbers((offset, edge / 2.0 * RIGHT, edge / 2.0 * UP), 1.0)
        total += np.prod(camera.focal_pixels) * np.array(numbers) / depth**3
    return np.sqrt(rig_ratio(*total, 1.0))


def other_residual(poses, edge):
    """The root of the least squared residual of a fit to all images that begins where an image's other pose is."""
    points, images = square(edge), []
    for camera, pose in zip(CAMERAS, poses, strict=False):
        images.append(project(camera, pose[None], points)[0])

    def off(motion):
        moved = Rotation.from_rotvec(motion[:3]).apply(points) + motion[3:]
        found = [project(c, pose[None], moved)[0] for c, pose in zip(CAMERAS, poses, strict=False)]
        return (np.array(found) - images).ravel()

    found = []
    for camera, pose, image in zip(CAMERAS, poses, images, strict=False):
        solved = cv2.solvePnPGeneric(points, image, intrinsics(camera), None, flags=cv2.SOLVEPNP_IPPE)
        for turn, shift in zip(*solved[1:3], strict=True):
            start = Rotation.from_matrix(pose[:3, :3] @ cv2.Rodrigues(turn)[0])
            motion = np.append(start.as_rotvec(), pose[:3, :3] @ shift[:, 0] + pose[:3, 3])
            found.append(2.0 * least_squares(off, motion, method="lm").cost)
    return np.sqrt(min(each for each in found if each > 1e-6))


@pytest.mark.parametrize("baseline", [0.03, 0.1, 0.3])
def test_the_closed_form_is_the_residual_of_the_other_pose_in_all_images(baseline):
    rng = np.random.default_rng(0)
    for edge, distance, incidence, count in (
        (0.1, 2.0, 30.0, 2),
        (0.15, 3.0, 50.0, 2),
        (0.1, 3.0, 40.0, 3),
        (0.2, 4.0, 25.0, 3),
    ):
        around = rng.uniform(-np.pi, np.pi)
        away = np.array(
            [1.0, np.tan(np.radians(incidence)) * np.cos(around), np.tan(np.radians(incidence)) * np.sin(around)]
        )
        centre = distance * away / np.linalg.norm(away)
        poses = [seen_from(centre + rng.normal(0.0, baseline / 2.0, 3), rng.uniform(-0.2, 0.2)) for _ in range(count)]
        assert residual(poses, edge) == pytest.approx(other_residual(poses, edge), rel=0.05)


def test_a_camera_alone_tells_as_much_as_without_a_rig():
    tag = (1.0, 2.0, 0.5), 0.05 * RIGHT, 0.05 * UP
    assert rig_ratio(*mirrored_numbers(tag, 1e-5), 1e-5) == pytest.approx(residual_ratio(tag, 1e-5), rel=1e-9)


# Rotations are asked for too, as moves of a rig take 14 s to compile for each combination of what is asked.
