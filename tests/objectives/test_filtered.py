"""Filtered poses along drives, against the reference and against matrices that share no code with it."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.field import check_field
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import lil_matrix
from scipy.sparse.linalg import splu
from support.drives import DEPLOYMENT, MOTION, SCENE, along
from support.paper import paper_room, paper_scene
from support.references import view_matrices
from support.strategies import (
    BENT,
    deployments,
    distorted_cameras,
    fiducial_scenes,
    is_bent,
    rig_scenes_with_deployments,
    scenes,
    seeds,
)
from support.thorough import examples

from lmd.geometry.se3 import camera_pose, inverse
from lmd.geometry.trajectory import Trajectory
from lmd.objectives.filtered import Drives, Filtered
from lmd.objectives.filtered.evaluation import (
    filtered_poses,
    frame_information,
    reference_filter,
    reference_information,
)
from lmd.objectives.filtered.lanes import ENTRIES
from lmd.objectives.localisation.information import deviation_per_variance
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

pytestmark = pytest.mark.long


def drives_in(room, rng, most=11, **changes):
    """Drives that jump from one random pose to the next: frames that share nothing."""
    made = []
    for _ in range(rng.integers(1, most)):
        frames = int(rng.integers(2, 7))
        time = np.cumsum(rng.uniform(0.1, 1.0, frames))
        angles = rng.uniform(-np.pi, np.pi, frames), rng.uniform(-0.6, 0.6, frames), rng.uniform(-0.5, 0.5, frames)
        made.append(Trajectory(time, camera_pose(room.sample(frames, rng), *angles)))
    return Drives(made, **({"turn_noise": 0.01, "motion_noise": 0.05} | changes))


def tagged(scene, tag):
    return Scene(scene.room, scene.camera, scene.pdf, scene.visibility, tag)


points_and_tags = st.builds(tagged, scenes(), st.sampled_from([Tag(), Tag(0.1), Tag(0.3)]))
bent = fiducial_scenes(distorted_cameras(BENT).filter(is_bent))
single_cameras = st.one_of(points_and_tags, bent)
settings = st.fixed_dictionaries(
    {
        "n": st.integers(1, 2),
        "tolerance": st.sampled_from([0.01, 0.05, 0.3]),
        "rotation_tolerance": st.sampled_from([None, 0.02, 0.3]),
        "pixel_noise": st.sampled_from([0.5, 0.02]),
    }
)


def check_reference(scene, deployment, seed, asked):
    """Fast paths count the same frames, and the covariances are equal to the bit."""
    drives = drives_in(scene.room, np.random.default_rng(seed))
    scene, objective = along(scene, drives), Filtered(drives=drives, **asked)
    landmarks = deployment.positions[None], deployment.normals[None]
    slow, fast = Evaluator(scene, by_reference=True), Evaluator(scene, threads=2)
    precision, limits = objective.asked(scene), objective.limits(scene)
    expected = reference_information(scene, deployment, precision, objective.n, drives)
    found = frame_information(fast, deployment, precision, objective.n, drives)
    np.testing.assert_array_equal(found.informed, expected.informed)
    np.testing.assert_array_equal(found.sums, expected.sums)
    np.testing.assert_array_equal(
        filtered_poses(drives, found, limits).covariances, reference_filter(drives, expected, limits).covariances
    )
    np.testing.assert_array_equal(objective.values(fast, *landmarks), objective.values(slow, *landmarks))


@examples(40)
@given(data=st.data(), scene=single_cameras, seed=seeds, asked=settings)
def test_frames_are_filtered_as_the_reference_says(data, scene, seed, asked):
    check_reference(scene, data.draw(deployments(scene.room)), seed, asked)


@examples(10)
@given(case=rig_scenes_with_deployments(), seed=seeds, asked=settings)
def test_frames_of_a_rig_are_filtered_as_the_reference_says(case, seed, asked):
    check_reference(*case, seed, asked)


def check_moves(data, scene, seed, asked):
    deployment, targets = data.draw(deployments(scene.room)), data.draw(deployments(scene.room, most=6))
    rng = np.random.default_rng(seed)
    drives = drives_in(scene.room, rng)
    check_field(Filtered(drives=drives, **asked), along(scene, drives), deployment, targets, rng)


@examples(60)
@given(data=st.data(), scene=points_and_tags, seed=seeds, asked=settings)
def test_after_any_moves_the_frames_are_those_of_a_full_evaluation(data, scene, seed, asked):
    """Compiling takes 10 s."""
    check_moves(data, scene, seed, asked)


@pytest.mark.thorough("lmd/incremental", "lmd/objectives/filtered", "lmd/objectives/localisation", "lmd/sight")
@examples(60)
@given(data=st.data(), scene=bent, seed=seeds, asked=settings)
def test_after_any_moves_behind_a_bent_lens_the_frames_are_those_of_a_full_evaluation(data, scene, seed, asked):
    check_moves(data, scene, seed, asked)


@pytest.mark.thorough("lmd/incremental", "lmd/objectives/filtered", "lmd/objectives/localisation", "lmd/sight")
def test_large_tags_hide_each_other_along_drives():
    tag, rng = Tag(0.4), np.random.default_rng(0)
    scene = replace(paper_scene(paper_room(spacing=2.0)), tag=tag, visibility=Fiducial(tag))
    drives = drives_in(scene.room, rng, most=40)
    objective, scene = Filtered(drives=drives, tolerance=0.05), along(scene, drives)
    deployment, targets = (RandomDeployment(count).draw(scene.room, rng) for count in (100, 60))
    state = objective.field(Evaluator(scene, threads=1)).state(deployment)
    assert (state.hidden > 0).sum() > 50
    check_field(objective, scene, deployment, targets, rng)


def adjoint(pose):
    """Ad of a pose on body twists (w, v)."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = pose[:3, :3]
    matrix[3:, :3] = np.cross(np.eye(3), -pose[:3, 3]) @ pose[:3, :3]
    return matrix


def driven_case(seed=0, noise=(0.001, 0.005), tag=SCENE.tag, pixel_noise=0.5, **start):
    drives = Drives([MOTION.draw(SCENE, np.random.default_rng([seed, i])) for i in range(3)], *noise, **start)
    scene = along(replace(SCENE, tag=tag), drives)
    return Evaluator(scene, threads=1), Filtered(drives=drives, tolerance=0.02, pixel_noise=pixel_noise)


def body_informations(evaluator, objective, deployment=DEPLOYMENT):
    """Information of each frame on the body twist (w, v), from the Jacobians of the corners' bearings."""
    scene, drives = evaluator.scene, objective.drives
    scale = deviation_per_variance(scene.cameras[0], objective.pixel_noise) ** -2
    scale *= 0.25 if scene.tag.is_point else 1.0  # its four corners are one
    matrices = []
    for pose, axes in zip(drives.poses, drives.axes, strict=True):
        world = view_matrices(scene, deployment, pose[:3, 3], axes[None])[0].sum(axis=0)  # on (v, w)
        turn = np.zeros((6, 6))  # (v, w) of the world from (w, v) of the body
        turn[:3, 3:] = turn[3:, :3] = pose[:3, :3]
        matrices.append(scale * turn.T @ world @ turn)
    return matrices


FEW_POINTS = DEPLOYMENT[::4]  # a view of them leaves directions undetermined
VAGUE = {"tag": Tag(), "pixel_noise": 0.05, "start_position": 100.0, "start_attitude": 3.0}


@pytest.mark.parametrize(("case", "deployment", "error"), [({}, DEPLOYMENT, 2e-6), (VAGUE, FEW_POINTS, 1e-4)])
def test_the_covariance_is_that_of_the_filter_in_the_frame_of_the_body(case, deployment, error):
    evaluator, objective = driven_case(**case)
    drives, informations = objective.drives, body_informations(evaluator, objective, deployment)
    found = objective.poses(evaluator, deployment).covariances
    seen = 0
    for d, drive in enumerate(drives.trajectories):
        p = np.diag(np.repeat([drives.start_attitude, drives.start_position], 3) ** 2)
        for t, time in enumerate(drive.time):
            if t > 0:
                step = adjoint(inverse(drive.poses[t]) @ drive.poses[t - 1])
                noise = np.repeat([drives.turn_noise, drives.motion_noise], 3) ** 2
                p = step @ p @ step.T + np.diag(noise) * (time - drive.time[t - 1])
            f = drives.first[d] + t
            p = np.linalg.inv(np.linalg.inv(p) + informations[f])
            seen += informations[f].any()
            expected = np.trace(p[3:, 3:]), np.trace(p[:3, :3])
            got = found[f, [0, 3, 5]].sum(), found[f, [15, 18, 20]].sum()
            np.testing.assert_allclose(got, expected, rtol=error)  # sums are rounded to a quantum
    assert seen > 10


@pytest.mark.parametrize("start", [{}, {"start_position": 1e6}, {"start_attitude": 1e6}])
def test_an_absurd_first_estimate_or_odometry_makes_no_pose_known(start):
    evaluator, objective = driven_case(noise=(1e6, 1e6), tag=Tag(), pixel_noise=1e-3, **start)
    found = objective.poses(evaluator, FEW_POINTS[:2])
    assert (np.linalg.eigvalsh(found.covariances[:, ENTRIES]) > -1e-6).all()
    assert not found.known.any()


def test_the_last_covariance_is_the_marginal_of_all_poses_together():
    """A smoother of all poses, as one sparse matrix; the last of its marginals is what a filter knows at the end."""
    evaluator, objective = driven_case(seed=1, noise=(0.01, 0.03))
    drives, informations = objective.drives, body_informations(evaluator, objective)
    found = objective.poses(evaluator, DEPLOYMENT).covariances
    for d, drive in enumerate(drives.trajectories):
        frames = len(drive.time)
        matrix = lil_matrix((6 * frames, 6 * frames))
        start = np.repeat([drives.start_attitude, drives.start_position], 3) ** -2.0
        matrix[:6, :6] = np.diag(start)
        for t in range(frames):
            here = slice(6 * t, 6 * t + 6)
            matrix[here, here] += informations[drives.first[d] + t]
            if t > 0:
                both = slice(6 * t - 6, 6 * t + 6)
                step = adjoint(inverse(drive.poses[t]) @ drive.poses[t - 1])
                known = np.repeat([drives.turn_noise, drives.motion_noise], 3) ** -2.0
                jacobian = np.hstack([-step, np.eye(6)])
                weight = np.diag(known / (drive.time[t] - drive.time[t - 1]))
                matrix[both, both] += jacobian.T @ weight @ jacobian
        last = np.zeros((6 * frames, 6))
        last[-6:] = np.eye(6)
        marginal = splu(matrix.tocsc()).solve(last)[-6:]
        f = drives.first[d + 1] - 1
        got = found[f, [0, 3, 5]].sum(), found[f, [15, 18, 20]].sum()
        np.testing.assert_allclose(got, (np.trace(marginal[3:, 3:]), np.trace(marginal[:3, :3])), rtol=2e-6)


def test_without_tags_the_pose_drifts_as_the_odometry_does():
    drives = Drives([MOTION.draw(SCENE, np.random.default_rng(3))], 0.0, 0.1, start_position=0.2, start_attitude=1e-6)
    objective = Filtered(drives=drives, n=100, thold_p=0.0)
    evaluator = Evaluator(along(SCENE, drives), threads=1)
    found = objective.poses(evaluator, DEPLOYMENT).covariances[:, [0, 3, 5]].sum(axis=1)
    np.testing.assert_allclose(found, 3 * (0.2**2 + 0.1**2 * drives.trajectories[0].time), rtol=1e-6)
