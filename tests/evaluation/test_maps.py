"""Errors of the pose under a wrong map, against geometry."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.paper import X, paper_camera, paper_room, paper_scene

from lmd.detection.frames import draw_poses
from lmd.evaluation.maps import MountedTags, error_quantiles, errors_text, map_errors
from lmd.geometry.se3 import camera_pose
from lmd.objectives.localisation import Localisation
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.tag import Tag

EXACT = 1e-9  # pixels of noise
TAG = Tag(0.2)
AWAY = 2.0  # metres before a tag straight ahead


def problem_of(tag=TAG, noise=EXACT, n=1, start=None):
    scene = replace(paper_scene(paper_room(spacing=1.5)), tag=tag)
    return Problem(scene, Localisation(n, pixel_noise=noise), start or UniformDeployment(30), threads=1)


def before_a_tag():
    """A tag on the wall x = 0, and the pose of a camera that looks straight at it from `AWAY`."""
    tag = Deployment(np.array([[0.0, 2.5, 3.0]]), np.array([X]))
    return MountedTags.of(tag), camera_pose(np.array([[AWAY, 2.5, 3.0]]), np.array([-np.pi / 2.0]), np.array([0.0]))


def errors_of(problem, truth, known, poses):
    views = map_errors(problem, truth, {"planned": known}, poses, np.random.default_rng(0))
    return views.position_planned.to_numpy(), views.attitude_planned.to_numpy()


def moved(hung, turn=(0.0, 0.0, 0.0), about=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    """All tags after one rigid motion: a rotation vector about a point, then a shift."""
    back = Rotation.from_rotvec(turn).as_matrix().T
    positions = (hung.deployment.positions - about) @ back + about + shift
    return MountedTags(
        replace(hung.deployment, positions=positions, normals=hung.deployment.normals @ back), hung.ups @ back
    )


@pytest.mark.parametrize(
    ("turn", "shift", "position", "attitude"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.003, 0.004), 0.005, 0.0),  # shifts the camera as far
        ((0.0, 0.02, 0.0), (0.0, 0.0, 0.0), 2.0 * AWAY * np.sin(0.01), 0.02),  # a tilt swings it about the tag
        ((0.0, 0.0, 0.02), (0.0, 0.0, 0.0), 2.0 * AWAY * np.sin(0.01), 0.02),
        ((0.03, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.03),  # rolls it in place
    ],
)
def test_a_single_tag_that_is_moved_moves_the_camera(turn, shift, position, attitude):
    truth, poses = before_a_tag()
    known = moved(truth, turn, truth.deployment.positions[0], shift)
    found = errors_of(problem_of(), truth, known, poses)
    np.testing.assert_allclose(np.ravel(found), [position, attitude], rtol=1e-3, atol=1e-4)


def test_a_map_that_is_off_as_a_whole_moves_every_pose_with_it():
    problem = problem_of(n=2, start=UniformDeployment(90))
    truth, poses = MountedTags.of(problem.draw(np.random.default_rng(0))), draw_poses(problem.scene, 100, 0)
    turn, shift = np.array([0.01, -0.02, 0.015]), np.array([0.02, 0.01, -0.03])
    views = map_errors(problem, truth, {"planned": moved(truth, turn, shift=shift)}, poses, np.random.default_rng(0))
    seeing = map_errors(problem, truth, {"planned": truth}, poses, np.random.default_rng(0))
    assert len(views) == len(seeing) > 5
    np.testing.assert_allclose(seeing.position_planned, 0.0, atol=1e-5)
    np.testing.assert_allclose(views.attitude_planned, np.linalg.norm(turn), rtol=1e-4)
    carried = poses[:, :3, 3] @ Rotation.from_rotvec(turn).as_matrix().T + shift - poses[:, :3, 3]
    off = np.linalg.norm(carried, axis=1)
    for error in views.position_planned:  # which of the poses see three tags is not said
        assert np.abs(off - error).min() < 1e-4


def test_two_tags_shifted_apart_are_off_as_the_linearised_estimate_says():
    tags = Deployment(np.array([[0.0, 2.1, 3.0], [0.0, 2.9, 3.1]]), np.array([X, X]))
    truth, (_, poses) = MountedTags.of(tags), before_a_tag()
    shifts = np.array([[0.0, -1e-4, 2e-4], [0.0, 2e-4, 1e-4]])
    known = MountedTags(replace(tags, positions=tags.positions + shifts), truth.ups)
    position, _ = errors_of(problem_of(n=2), truth, known, poses)

    def image(points, step):  # of the true corners from a pose moved by a world twist
        turned = poses[0, :3, :3].T @ Rotation.from_rotvec(step[:3]).as_matrix()
        seen = (points - poses[0, :3, 3] - step[3:]) @ turned.T
        return (paper_camera().focal_pixels * seen[:, :2] / seen[:, 2:]).ravel()

    believed, shown = (hung.points(TAG).reshape(-1, 3) for hung in (known, truth))
    rest = image(shown, np.zeros(6)) - image(believed, np.zeros(6))
    steps = 1e-6 * np.eye(6)
    slope = np.column_stack([(image(believed, s) - image(believed, -s)) / 2e-6 for s in steps])
    expected = np.linalg.norm(np.linalg.lstsq(slope, rest, rcond=None)[0][3:])
    assert position == pytest.approx(expected, rel=0.005)


def test_points_need_four_for_a_pose():
    problem = problem_of(Tag(), n=2)
    truth, poses = MountedTags.of(problem.draw(np.random.default_rng(0))), draw_poses(problem.scene, 60, 0)
    views = map_errors(problem, truth, {"planned": truth}, poses, np.random.default_rng(0))
    assert (views.position_planned.isna() == (views.tags < 4)).all()
    assert set(views.tags < 4) == {True, False}
    short = error_quantiles(views)
    assert short.loc["position_planned", "within_50mm"] == (views.position_planned <= 0.05).mean() < 1.0
    assert "position, map as planned [mm]" in errors_text(views, 2)
