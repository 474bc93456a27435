"""The two poses of a single tag: the closed form against IPPE, without noise, with it, and on rendered frames."""

from dataclasses import replace
from statistics import NormalDist

import cv2
import numpy as np
import pytest
from support.paper import paper_camera, paper_room, paper_scene

from lmd.geometry.projection import intrinsics, project
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.ambiguity import CONFIDENCE, mirrored_square, resolved
from lmd.objectives.localisation.information import deviation_per_variance, precision
from lmd.objectives.localisation.reference import mirrored_probabilities
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

CAMERA = paper_camera(image_width=640, image_height=480, principal_point=(320.0, 240.0))
FOCAL = float(np.sqrt(np.prod(CAMERA.focal_pixels)))
NORMAL, UP, RIGHT = np.eye(3)[[0]], np.eye(3)[[2]], np.eye(3)[[1]]


def square(edge):
    """A tag at the origin that faces along x."""
    return corners(np.zeros((1, 3)), NORMAL, UP, edge)[0]


def looking(distance, incidence, around, off=0.0):
    """The pose of a camera that sees the origin at an incidence from the side `around`, `off` its axis, degrees."""
    slant, side = np.radians([incidence, around])
    away = np.array([np.cos(slant), np.sin(slant) * np.cos(side), np.sin(slant) * np.sin(side)])
    return camera_pose(distance * away, np.arctan2(-away[0], -away[1]) + np.radians(off), np.arcsin(-away[2]))


def residual(pose, edge):
    """sqrt(S), pixels."""
    offset, depth = -pose[:3, 3], -pose[:3, 2] @ pose[:3, 3]
    square_ = mirrored_square((offset, edge / 2.0 * RIGHT[0], edge / 2.0 * UP[0]))
    return FOCAL * np.sqrt(square_ / depth**3)


def by_ippe(image, edge):
    """Squared residuals, and R from the world to the camera, of IPPE's two poses, refined; the better first."""
    points, matrix, found = square(edge), intrinsics(CAMERA), []
    for each in zip(*cv2.solvePnPGeneric(points, image, matrix, None, flags=cv2.SOLVEPNP_IPPE)[1:3], strict=True):
        turn, shift = cv2.solvePnPRefineLM(points, image, matrix, None, *each)
        off = cv2.projectPoints(points, turn, shift, matrix, None)[0][:, 0] - image
        found.append(((off**2).sum(), cv2.Rodrigues(turn)[0]))
    return sorted(found, key=lambda one: one[0])


def share_wrong(pose, edge, images):
    """Fraction of draws in which the better pose is the mirrored one."""
    normal, line = pose[:3, :3].T @ NORMAL[0], pose[:3, :3].T @ pose[:3, 3] / -np.linalg.norm(pose[:3, 3])
    mirrored = 2.0 * (normal @ line) * line - normal
    turned = (by_ippe(image, edge)[0][1] @ NORMAL[0] for image in images)
    return np.mean([each @ mirrored > each @ normal for each in turned])


@pytest.mark.parametrize(("off", "within"), [(0.0, 0.04), (15.0, 0.06), (25.0, 0.09)])
def test_the_closed_form_is_the_residual_of_the_other_pose(off, within):
    for edge, distance in ((0.05, 1.0), (0.1, 4.0), (0.2, 4.0)):
        for incidence in (20.0, 40.0, 65.0):
            for around in (0.0, 20.0, 45.0, 100.0, 225.0):
                pose = looking(distance, incidence, around, off)
                best, other = by_ippe(project(CAMERA, pose, square(edge)), edge)
                assert best[0] < 1e-9
                assert residual(pose, edge) == pytest.approx(np.sqrt(other[0]), rel=within)


@pytest.mark.parametrize(("distance", "incidence", "around"), [(1.5, 10.0, 0.0), (2.0, 30.0, 45.0), (3.0, 50.0, 160.0)])
def test_noise_makes_the_wrong_pose_the_better_one_as_often_as_predicted(distance, incidence, around):
    rng, edge, noise, count = np.random.default_rng(0), 0.12, 0.5, 1000
    pose = looking(distance, incidence, around, 5.0)
    images = project(CAMERA, pose, square(edge)) + rng.normal(0.0, noise, (count, 4, 2))
    expected = NormalDist().cdf(-residual(pose, edge) / (2.0 * noise))
    assert 0.03 < expected < 0.4
    error = np.sqrt(expected * (1.0 - expected) / count)
    assert share_wrong(pose, edge, images) == pytest.approx(expected, abs=4.0 * error + 0.1 * expected)


def test_a_precision_asks_for_the_confidence():
    tag, noise = Tag(0.1), 0.5
    scale = deviation_per_variance(CAMERA, noise)
    asked = resolved(precision(CAMERA, tag, noise, 0.05), scale)
    least = np.sqrt(asked.residual) * FOCAL  # pixels
    assert NormalDist().cdf(least / (2.0 * noise)) == pytest.approx(CONFIDENCE)


def test_only_views_of_a_single_tag_hang_on_it():
    scene = replace(paper_scene(paper_room(spacing=1.5)), tag=Tag(0.1))
    deployment, evaluator = UniformDeployment(60).draw(scene.room, np.random.default_rng()), Evaluator(scene, threads=1)

    def values(n, ambiguity, tolerance=0.2):
        objective = Localisation(n, tolerance=tolerance, ambiguity=ambiguity)
        return objective.values(evaluator, deployment.positions[None], deployment.normals[None])

    one, anyhow, two = values(1, "resolved"), values(1, "ignored"), values(2, "resolved")
    np.testing.assert_array_equal(two, values(2, "ignored"))
    assert (two <= one).all()
    assert (one <= anyhow).all()
    assert two.mean() < one.mean() < anyhow.mean()
    # At a tolerance that is small for the tag's edge an image that fixes the position tells the two poses apart, too.
    np.testing.assert_array_equal(values(1, "resolved", 0.01), values(1, "ignored", 0.01))
    points = replace(scene, tag=Tag())
    assert Localisation(1).precision(points) == Localisation(1, ambiguity="ignored").precision(points)


def test_the_probability_of_views_is_that_of_the_formula():
    """A second camera in the place of the first doubles S."""
    poses = np.stack([looking(d, i, 30.0, off) for d, i, off in ((2.0, 20.0, 0.0), (1.0, 60.0, 15.0), (3.0, 5.0, 3.0))])
    scene, sigma, edge = paper_scene(camera=CAMERA), np.array([0.5, 4.0, 1.0]), 0.15
    sides = edge / 2.0 * np.stack([RIGHT.repeat(3, axis=0), UP.repeat(3, axis=0)])
    one = mirrored_probabilities(scene, poses, np.zeros((3, 3)), sides, np.ones((1, 3), dtype=bool), sigma)
    roots = np.array([residual(pose, edge) for pose in poses]) / (2.0 * sigma)
    assert one == pytest.approx([NormalDist().cdf(-min(root, 4.0 * 2.3263478740408408)) for root in roots], rel=1e-6)
    assert 1e-6 < one.min() < one.max() < 0.5
    twice = replace(scene, camera=Rig((Mount(CAMERA), Mount(CAMERA))))
    both = mirrored_probabilities(twice, poses, np.zeros((3, 3)), sides, np.ones((2, 3), dtype=bool), sigma)
    assert both[2] == pytest.approx(NormalDist().cdf(-np.sqrt(2.0) * roots[2]), rel=1e-6)
