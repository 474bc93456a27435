"""Information of all cameras of a rig on its body, against the Jacobians of its parts and a calculation by hand."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.field import check_field
from hypothesis import given
from hypothesis import strategies as st
from support.paper import facing, one_position_room, paper_camera, paper_room, paper_scene
from support.references import view_matrices
from support.strategies import deployments, rig_scenes_with_deployments, seeds
from support.thorough import examples

from lmd.evaluation.accuracy import predicted_errors
from lmd.objectives.localisation import Localisation, reference
from lmd.objectives.localisation.evaluation import localised_views
from lmd.objectives.localisation.information import deviation_per_variance
from lmd.objectives.localisation.rig import RigImages, body_sums
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
    moments = RigImages(one, one, one + 1, np.full((1, 3), 2.0), axes, seen)
    told = body_sums(evaluator, deployment, moments, asked)[0]
    np.testing.assert_allclose(told[:6], [2.0 / r**2, 0.0, 0.0, 0.0, 0.0, 2.0 / r**2], atol=1e-9)
    np.testing.assert_allclose(told[6:15], 0.0, atol=1e-9)
    np.testing.assert_allclose(told[15:21], [2.0, 0.0, 0.0, 0.0, 0.0, 2.0], atol=1e-9)


tags = st.sampled_from([Tag(), Tag(0.1), Tag(0.3)])


def localisations(rotations):
    return st.builds(
        Localisation,
        n=st.integers(1, 3),
        tolerance=st.sampled_from([0.005, 0.02, 0.1, 0.5, np.inf]),
        rotation_tolerance=rotations,
        coverage_weight=st.sampled_from([0.0, 0.0, 0.3, 1.0]),
        ambiguity=st.just("ignored"),
    )


def check_evaluation(scene, deployment, objective):
    """The views are those of the reference, to the bit."""
    evaluator, axes = Evaluator(scene, threads=1), scene.orientations.axes
    views = localised_views(
        evaluator, deployment.positions[None], deployment.normals[None], objective.n, objective.precision(scene)
    )
    located = [
        reference.localised(scene, deployment, objective.n, objective.precision(scene), p, axes)
        for p in evaluator.positions
    ]
    np.testing.assert_array_equal(views.localised[0], np.array(located) @ evaluator.weights[0, : len(axes)])


several = {
    "case": rig_scenes_with_deployments(),
    "objective": localisations(st.sampled_from([0.003, 0.02, 10.0])),
    "tag": tags,
}


@examples(40)
@given(**several)
def test_the_evaluation_is_that_of_the_reference_to_the_bit(case, objective, tag):
    """`test_rig_ambiguity` has moves."""
    scene, deployment = case
    check_evaluation(replace(scene, tag=tag), deployment, objective)


@pytest.mark.thorough("lmd/incremental", "lmd/objectives/localisation", "lmd/sight")
@examples(40)
@given(data=st.data(), seed=seeds, **several)
def test_after_any_moves_the_evaluation_is_that_of_the_reference(data, seed, case, objective, tag):
    """Moves for which what is asked of several landmarks is compiled in 13 s."""
    scene, deployment = replace(case[0], tag=tag), case[1]
    check_field(objective, scene, deployment, data.draw(deployments(scene.room, most=6)), np.random.default_rng(seed))


@examples(20)
@given(case=rig_scenes_with_deployments(fiducial=True), objective=localisations(st.none()))
def test_what_a_detector_sees_from_a_rig_is_evaluated_as_the_reference_does(case, objective):
    """Moves add what landmarks tell by the same function, which would take as long to compile again."""
    check_evaluation(*case, objective)


def selected(scene):
    evaluator = Evaluator(scene, threads=2)
    return LOCALISATION.selection(evaluator, np.ones(len(evaluator.positions)))


def test_what_poses_gain_are_differences_of_log_determinants():
    room = paper_room(spacing=3.0)
    scene = paper_scene(room, orientations=pdf.grid_with_ends(4), occlusion="none", thold=0.15)
    scene = replace(scene, camera=RIG, tag=Tag(0.3))
    landmarks, axes = RandomDeployment(8).draw(room, np.random.default_rng(0)), scene.orientations.axes
    each = np.concatenate([body_matrices(scene, landmarks, p, axes) for p in room.grid()])  # (V, K, 6, 6)
    weights = np.tile(scene.orientations.weight, len(room.grid())) / len(room.grid())
    scale = deviation_per_variance(SCENE.camera, LOCALISATION.pixel_noise)
    prior = np.diag(np.repeat([(scale / 0.05) ** 2, scale**2], 3))  # 5 tolerances, and a radian
    known, chosen = np.broadcast_to(prior, each[:, 0].shape), selected(scene)
    for k in range(3):
        before = weights @ np.linalg.slogdet(known)[1]
        expected = [weights @ np.linalg.slogdet(known + each[:, j])[1] - before for j in range(8)]
        np.testing.assert_allclose(chosen.gains(landmarks), expected, rtol=1e-6, atol=1e-9)
        assert np.max(expected) > 0.1
        chosen.add(landmarks[k : k + 1])
        known = known + each[:, k]
