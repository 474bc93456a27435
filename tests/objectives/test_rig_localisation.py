"""Information of all cameras of a rig on its body, against the Jacobians of its parts and a calculation by hand."""

from dataclasses import replace

import numpy as np
import pytest
from support.paper import paper_camera, paper_room, paper_scene
from support.references import view_matrices

from lmd.evaluation.accuracy import predicted_errors
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.objectives.localisation.information import deviation_per_variance
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

pytestmark = pytest.mark.long

SCENE = replace(paper_scene(paper_room(spacing=2.0), orientations=pdf.grid_with_ends(6)), tag=Tag(0.1))
FAR = paper_camera(focal_length=8.0)
RIG = Rig((Mount(SCENE.camera, (0.15, 0.0, 0.3)), Mount(FAR, (-0.15, 0.1, 0.2), yaw=2.0, pitch=-0.3)))
DEPLOYMENT = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))
LOCALISATION = Localisation(n=2, tolerance=0.01)


def body_matrices(scene, deployment, position, axes):
    """Information on position and rotation of the body by each landmark, `(A, K, 6, 6)`, scaled to the first camera."""
    total = 0.0
    first = deviation_per_variance(scene.cameras[0], 1.0)
    for camera, offsets, turned in zip(scene.cameras, *scene.camera.views(axes), strict=True):
        alone, gain = replace(scene, camera=camera), (first / deviation_per_variance(camera, 1.0)) ** 2
        parts = []
        for offset, axis in zip(offsets, turned, strict=True):
            moved = np.eye(6)  # of the camera, by what the body does
            moved[:3, 3:] = -np.cross(np.eye(3), -offset)
            its = view_matrices(alone, deployment, position + offset, axis[None])[0]
            parts.append(gain * moved.T @ its @ moved)
        total = total + np.array(parts)
    return total


def test_the_views_of_a_rig_are_those_of_the_sum_of_its_cameras_matrices():
    scene = replace(SCENE, camera=RIG)
    evaluator, axes = Evaluator(scene, threads=2), scene.orientations.axes
    views = localised_views(
        evaluator, DEPLOYMENT.positions[None], DEPLOYMENT.normals[None], 2, LOCALISATION.precision(scene), keep=True
    )
    limit, weight = LOCALISATION.precision(scene).position, evaluator.weights[0]
    finite = 0
    for p, position in enumerate(evaluator.positions[::5]):
        each = body_matrices(scene, DEPLOYMENT, position, axes)
        enough = (np.trace(each, axis1=2, axis2=3) > 0.0).sum(axis=1) >= 2
        expected = np.full(len(axes), np.inf)
        expected[enough] = np.trace(np.linalg.inv(each.sum(axis=1)[enough])[:, :3, :3], axis1=1, axis2=2)
        np.testing.assert_allclose(views.variances[0, 5 * p, : len(axes)], expected, rtol=1e-4)
        assert views.covered[0, 5 * p] == weight[: len(axes)][enough].sum()
        assert views.localised[0, 5 * p] == weight[: len(axes)][expected <= limit].sum()
        finite += enough.sum()
    assert finite > 50


def test_a_rig_of_one_camera_at_the_origin_gets_the_figures_of_the_camera():
    alone, rig = (replace(SCENE, camera=camera) for camera in (SCENE.camera, Rig((Mount(SCENE.camera),))))
    figures = [
        predicted_errors(problem, DEPLOYMENT, problem.evaluator)
        for problem in (Problem(scene, LOCALISATION, UniformDeployment(60), threads=2) for scene in (alone, rig))
    ]
    np.testing.assert_allclose(figures[0][0], figures[1][0], rtol=1e-6)
    np.testing.assert_array_equal(figures[0][1], figures[1][1])


@pytest.mark.parametrize("by_reference", [False, pytest.param(True, marks=pytest.mark.thorough("lmd/objectives"))])
def test_what_poses_gain_are_differences_of_log_determinants(by_reference):
    room = paper_room(spacing=3.0)
    scene = paper_scene(room, orientations=pdf.grid_with_ends(4), occlusion="none", thold=0.15)
    scene = replace(scene, camera=RIG, tag=Tag(0.3))
    landmarks, axes = RandomDeployment(8).draw(room, np.random.default_rng(0)), scene.orientations.axes
    each = np.concatenate([body_matrices(scene, landmarks, p, axes) for p in room.grid()])  # (V, K, 6, 6)
    weights = np.tile(scene.orientations.weight, len(room.grid())) / len(room.grid())
    scale = deviation_per_variance(SCENE.camera, LOCALISATION.pixel_noise)
    prior = np.diag(np.repeat([(scale / 0.05) ** 2, scale**2], 3))  # 5 tolerances, and a radian
    known, evaluator = np.broadcast_to(prior, each[:, 0].shape), Evaluator(scene, threads=2, by_reference=by_reference)
    chosen = LOCALISATION.selection(evaluator, np.ones(len(evaluator.positions)))
    for k in range(3):
        before = weights @ np.linalg.slogdet(known)[1]
        expected = [weights @ np.linalg.slogdet(known + each[:, j])[1] - before for j in range(8)]
        np.testing.assert_allclose(chosen.gains(landmarks), expected, rtol=1e-6, atol=1e-9)
        assert np.max(expected) > 0.1
        chosen.add(landmarks[k : k + 1])
        known = known + each[:, k]
