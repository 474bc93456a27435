"""The two poses of a body whose cameras see a single tag: the closed form against a fit to all images; kernels."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from contracts.field import check_field
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from support.paper import one_position_room, paper_camera, paper_scene
from support.strategies import deployments, rig_scenes_with_deployments, seeds
from support.thorough import examples

from lmd.geometry.projection import intrinsics, project
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners
from lmd.objectives.localisation import Localisation, reference
from lmd.objectives.localisation.ambiguity import mirrored_numbers, residual_ratio, rig_ratio
from lmd.objectives.localisation.evaluation import localised_views
from lmd.objectives.localisation.rig import images_of, located
from lmd.scene import pdf
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

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


def test_cameras_farther_apart_tell_more():
    def share(ambiguity, baseline):
        sides = zip((paper_camera(), paper_camera(focal_length=5.5)), (0.0, baseline), strict=True)
        rig = Rig(tuple(Mount(camera, (0.0, y, 0.0)) for camera, y in sides))
        orientations = pdf.OrientationPdf(np.array([0.3]), np.zeros(1), np.ones(1))
        scene = paper_scene(one_position_room(), orientations=orientations, thold=0.05)
        tag = np.array([[[3.0, 3.9, 2.2]]]), np.array([[[0.0, -1.0, 0.0]]])
        evaluator = Evaluator(replace(scene, camera=rig, tag=Tag(0.15)), threads=1)
        return Localisation(1, tolerance=1.0, pixel_noise=1.0, ambiguity=ambiguity).values(evaluator, *tag)[0, 0]

    assert share("ignored", 0.02) == 1.0
    assert share("resolved", 0.02) == 0.0
    assert share("resolved", 0.4) == 1.0


# Rotations are asked for too, as moves of a rig take 14 s to compile for each combination of what is asked.
objectives = st.builds(
    Localisation,
    n=st.just(1),
    tolerance=st.sampled_from([0.02, 0.1, 0.5]),
    rotation_tolerance=st.sampled_from([0.02, 10.0, 10.0]),
    coverage_weight=st.sampled_from([0.0, 0.0, 0.3, 1.0]),
)


@examples(50)
@given(
    data=st.data(),
    case=rig_scenes_with_deployments(),
    objective=objectives,
    edge=st.sampled_from([0.1, 0.3]),
    seed=seeds,
)
def test_the_reference_evaluations_and_any_moves_agree_to_the_bit(data, case, objective, edge, seed):
    scene, deployment = replace(case[0], tag=Tag(edge)), case[1]
    evaluator, axes, asked = Evaluator(scene, threads=1), scene.orientations.axes, objective.precision(scene)
    expected = np.array(
        [
            reference.localised(scene, deployment, objective.n, objective.precision(scene), p, axes)
            for p in evaluator.positions
        ]
    )
    views = localised_views(evaluator, deployment.positions[None], deployment.normals[None], 1, asked)
    np.testing.assert_array_equal(views.localised[0], expected @ evaluator.weights[0, : len(axes)])
    moments = images_of(evaluator, deployment)
    found = located(evaluator, deployment, moments, 1, asked)
    np.testing.assert_array_equal(found, expected[moments.place, moments.orientation])
    check_field(objective, scene, deployment, data.draw(deployments(scene.room, most=6)), np.random.default_rng(seed))
