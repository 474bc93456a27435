"""What all cameras of a rig tell of its body, against the Jacobians of its parts and a calculation by hand."""

from dataclasses import replace

import numpy as np
import pytest
from bearings import view_matrices
from paper import facing, one_position_room, paper_camera, paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.evaluation.accuracy import predicted_errors
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.information import deviation_per_variance
from lmd.objectives.localisation.rig import Moments, body_information
from lmd.objectives.localisation.views import localised_views
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

SCENE = replace(paper_scene(paper_room(spacing=2.0), orientations=pdf.grid_with_ends(6)), tag=Tag(0.1))
FAR = paper_camera(focal_length=8.0)
RIG = Rig((Mount(SCENE.camera, (0.15, 0.0, 0.3)), Mount(FAR, (-0.15, 0.1, 0.2), yaw=2.0, pitch=-0.3)))
DEPLOYMENT = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))
LOCALISATION = Localisation(n=2, tolerance=0.01)


def body_matrices(scene, deployment, position, axes):
    """Information on position and rotation of the body of each landmark, `(A, K, 6, 6)`, in the first one's units."""
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


def test_two_cameras_by_hand():
    """Front and back camera at the body's origin, each with a landmark, a point, at the distance 2 on its axis.

    Each has the information (f / sigma r)^2 on the two directions across, and (f / sigma)^2 on the turns about them:
    with both, position and turn across separate, as the landmarks lie on both sides. The sum on y and z is
    2 (f / sigma r)^2; along x, and for the roll, nothing is known.
    """
    camera = SCENE.camera
    rig = Rig((Mount(camera), Mount(camera, yaw=np.pi)))
    scene = replace(paper_scene(one_position_room()), camera=rig)
    deployment = facing((2.0, 2.0, 2.0), (2.0, 3.9, 2.0), (2.0, 0.1, 2.0))
    evaluator, r = Evaluator(scene, np.array([[2.0, 2.0, 2.0]]), threads=1), 1.9
    axes = np.array([[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]])  # forward along y
    seen = np.array([[[True, False]], [[False, True]]])
    asked, one = LOCALISATION.precision(scene), np.zeros(1, dtype=np.int64)
    moments = Moments(one, one, one + 1, np.full((1, 3), 2.0), axes, seen)
    c, b, a = body_information(evaluator, deployment, moments, asked)
    np.testing.assert_allclose(c[0], np.diag([2.0 / r**2, 0.0, 2.0 / r**2]), atol=1e-9)
    np.testing.assert_allclose(a[0], np.diag([2.0, 0.0, 2.0]), atol=1e-9)
    np.testing.assert_allclose(b[0], 0.0, atol=1e-9)


def test_what_moves_single_landmarks_refuses_a_rig():
    scene = replace(SCENE, camera=RIG)
    with pytest.raises(InputError, match="moving single landmarks for localisation works with a single camera"):
        LOCALISATION.field(Evaluator(scene, threads=1))
