"""The information of a view against its 6 x 6 matrix, and against that of the pixels by OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.paper import paper_camera, paper_room, paper_scene
from support.references import view_matrices

from lmd.geometry.se3 import axis_and_right, camera_pose, exp
from lmd.geometry.squares import corners, upright
from lmd.objectives.localisation import reference
from lmd.objectives.localisation.information import (
    deviation_per_variance,
    log_det,
    precision,
    rotation_variance,
    variance,
)
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.reference import coverage_caps

EDGE, NOISE = 0.1, 0.5
SCENE = replace(paper_scene(paper_room()), tag=Tag(EDGE))


def pixel_covariance(camera, pose, points):
    """Of the pose times exp(w, v), for one pixel of noise, by differences of OpenCV's projection, `(6, 6)`."""
    by_opencv = cv2.fisheye.projectPoints if camera.distortion_model == "equidistant" else cv2.projectPoints
    matrix, numbers, step = np.diag([*camera.focal_pixels, 1.0]), np.array(camera.distortion or [0.0] * 4), 1e-6

    def image(at):
        local = (points - at[:3, 3]) @ at[:3, :3]
        return by_opencv(local[:, None], np.zeros(3), np.zeros(3), matrix, numbers)[0].ravel()

    slopes = [(image(pose @ exp(step * way)) - image(pose @ exp(-step * way))) / (2.0 * step) for way in np.eye(6)]
    return np.linalg.inv(np.array(slopes) @ np.array(slopes).T)


def views(count, rng, deployment, least, scene=SCENE):
    """Poses, information and corners of random views that cover at least a given number of landmarks."""
    asked = precision(scene.camera, scene.tag, NOISE, 0.02)
    all_corners = corners(deployment.positions, deployment.normals, upright(deployment.normals)[1], EDGE)
    found = []
    while len(found) < count:
        yaw, pitch = rng.uniform(-np.pi, np.pi, 16), rng.uniform(-np.pi / 2, np.pi / 2, 16)
        poses = camera_pose(scene.room.sample(1, rng)[0], yaw, pitch, np.zeros(16))
        position, axes = poses[0, :3, 3], axis_and_right(poses)
        caps = coverage_caps(scene, deployment, position, axes)
        information = reference.view_information(scene, deployment, asked, position, axes)[0]
        for a in np.flatnonzero(caps.sum(axis=1) >= least)[: count - len(found)]:
            found.append((poses[a], information[:, a], all_corners[caps[a]].reshape(-1, 3)))
    return found


def test_the_fifteen_numbers_are_those_of_the_matrix():
    rng = np.random.default_rng(0)
    deployment = RandomDeployment(90).draw(SCENE.room, rng)
    for pose, information, _ in views(50, rng, deployment, 2):
        matrix = view_matrices(SCENE, deployment, pose[:3, 3], axis_and_right(pose[None]))[0].sum(axis=0)
        inverse = np.linalg.inv(matrix)
        value, fixed = variance(information, 0, 1)
        assert fixed
        assert value == pytest.approx(np.trace(inverse[:3, :3]), rel=1e-4)
        turned, _ = rotation_variance(information, 0, 1)
        assert turned == pytest.approx(np.trace(inverse[3:, 3:]), rel=1e-4)
        assert log_det(information, 0, 1) == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-6)


RATIONAL = {"distortion": (0.15, -0.04, 0.001, 0.0, 0.004, 0.5, -0.07, 0.006, 0.001, 0.0, -0.002, 0.001)}
# 69 degrees from the axis to the borders, 86 to the corners.
FISHEYE = {"distortion": (0.003, 0.001, -0.002, 0.0002), "distortion_model": "equidistant"}
FISHEYE |= {"pixel_width": 0.0075, "pixel_height": 0.0075}


@pytest.mark.parametrize(
    ("lens", "count", "off"), [({}, 1500, 0.01), (RATIONAL, 400, 0.02), (FISHEYE, 400, 0.02)], ids=str
)
def test_it_stands_for_the_information_of_the_pixels(lens, count, off):
    rng, camera = np.random.default_rng(1), paper_camera(**lens)
    scene = replace(SCENE, camera=camera, visibility=Fiducial(Tag(EDGE))) if lens else SCENE
    deployment = UniformDeployment(90).draw(SCENE.room, rng)
    scale, exact, predicted = deviation_per_variance(camera, NOISE), [], []
    for pose, information, points in views(count, rng, deployment, 2, scene):
        predicted.append(scale * np.sqrt(variance(information, 0, 1)[0]))
        exact.append(NOISE * np.sqrt(np.trace(pixel_covariance(camera, pose, points)[3:, 3:])))
    ratio = np.array(predicted) / np.array(exact)
    assert np.median(ratio) == pytest.approx(1.0, abs=off)
    assert (np.abs(np.quantile(ratio, [0.05, 0.95]) - 1.0) < 0.06).all()
    other_side = (np.array(predicted) <= 0.02) != (np.array(exact) <= 0.02)
    assert other_side.mean() < 0.01
