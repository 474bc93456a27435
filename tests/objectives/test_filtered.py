"""Filtered poses along drives, against the reference and against matrices that share no code with it."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.field import check_field
from support.drives import DEPLOYMENT, MOTION, SCENE, along
from support.paper import paper_room, paper_scene
from support.product import jumping
from support.references import view_matrices

from lmd.geometry.se3 import inverse
from lmd.objectives.filtered import Drives, Filtered
from lmd.objectives.filtered.lanes import ENTRIES
from lmd.objectives.localisation.information import deviation_per_variance
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

pytestmark = pytest.mark.long


@pytest.mark.thorough("lmd/incremental", "lmd/objectives/filtered", "lmd/objectives/localisation", "lmd/sight")
def test_large_tags_hide_each_other_along_drives():
    tag, rng = Tag(0.4), np.random.default_rng(0)
    scene = replace(paper_scene(paper_room(spacing=2.0)), tag=tag, visibility=Fiducial(tag))
    drives = jumping(scene.room, rng, most=40)
    objective, scene = Filtered(drives=drives, tolerance=0.05), along(scene, drives)
    deployment, targets = (RandomDeployment(count).draw(scene.room, rng) for count in (100, 60))
    state = objective.field(Evaluator(scene, threads=1)).state(deployment)
    assert (state.hidden > 0).sum() > 20
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
