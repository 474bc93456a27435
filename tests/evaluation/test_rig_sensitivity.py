"""Fitness of a rig without a camera or without tags, and poses under a wrong map; the kernels are warm."""

from dataclasses import replace

import numpy as np
import pytest
from support.paper import paper_room, paper_scene

from lmd.detection.frames import draw_poses
from lmd.evaluation.maps import MountedTags, map_errors
from lmd.evaluation.sensitivity import MISS_PROBABILITIES, RigViews, sensitivity
from lmd.evaluation.validation import Sample
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE

CAMERA = paper_scene().camera
MOUNTS = (
    Mount(CAMERA, (0.15, 0.0, 0.1)),
    Mount(CAMERA, (-0.15, 0.0, 0.1), yaw=np.pi),
    Mount(CAMERA, yaw=1.0, pitch=0.2),
)
SCENE = replace(
    paper_scene(paper_room(spacing=2.0), orientations=pdf.grid_with_ends(6)), camera=Rig(MOUNTS), tag=Tag(0.15)
)
OBJECTIVE = Localisation(n=2, tolerance=0.03)
PROBLEM = Problem(SCENE, OBJECTIVE, UniformDeployment(20), threads=2)
DEPLOYMENT = PROBLEM.draw(np.random.default_rng(0))


def shares(scene, deployment):
    evaluator = Evaluator(scene, PROBLEM.evaluator.positions, threads=1)
    views = localised_views(
        evaluator, deployment.positions[None], deployment.normals[None], OBJECTIVE.n, OBJECTIVE.precision(scene)
    )
    return [views.localised.mean() / PROBABILITY_ONE, views.covered.mean() / PROBABILITY_ONE]


@pytest.fixture(scope="module")
def moments():
    return RigViews(PROBLEM.evaluator, DEPLOYMENT, OBJECTIVE.n, OBJECTIVE.precision(SCENE))


def test_a_camera_that_fails_leaves_the_rig_of_the_others(moments):
    others = [
        shares(replace(SCENE, camera=Rig(tuple(m for m in MOUNTS if m is not gone))), DEPLOYMENT) for gone in MOUNTS
    ]
    np.testing.assert_allclose(moments.without_cameras(), others, rtol=1e-12)
    assert min(shares(SCENE, DEPLOYMENT)) > 0.1


def test_what_is_left_without_tags_is_what_the_others_are_worth(moments):
    found = moments.lost()
    for i, j in ((0, 0), (5, 5), (0, 1), (3, 11), (17, 2)):
        rest = DEPLOYMENT[np.setdiff1d(np.arange(len(DEPLOYMENT)), [i, j])]
        np.testing.assert_allclose(found[:, i, j], shares(SCENE, rest), rtol=1e-9)


def test_the_more_is_missed_the_less_is_left(moments):
    missed = moments.missed(MISS_PROBABILITIES, np.random.default_rng(0))
    np.testing.assert_allclose(missed[0], shares(SCENE, DEPLOYMENT), rtol=1e-12)
    assert (np.diff(missed, axis=0) < 0.0).all()


def test_the_study_of_a_rig_has_a_table_of_cameras():
    problem = Problem(SCENE, Coverage(2, 0.5), UniformDeployment(12), threads=2)
    found = sensitivity(problem, problem.draw(np.random.default_rng(0)), 0, Sample(groups=2, positions=10, divisions=4))
    assert list(found.tables) == ["assumptions", "misses", "tags", "lost", "cameras"]
    table = found.cameras.set_index("camera")
    assert list(table.index) == [0, 1, 2]
    whole = found.misses.localised_share[0]
    np.testing.assert_allclose(table.localised_share + table.localised_loss, whole)
    assert found.metrics()["camera_1_fails/localised_share"] == table.localised_share[1]
    assert "camera fails" in found.to_text()


def test_a_map_that_is_off_as_a_whole_moves_the_body_by_as_much():
    problem = Problem(SCENE, replace(OBJECTIVE, pixel_noise=1e-9), UniformDeployment(20), threads=2)
    shifted = MountedTags.of(replace(DEPLOYMENT, positions=DEPLOYMENT.positions + np.array([0.003, 0.0, 0.004])))
    poses = draw_poses(SCENE, 60, 0)
    views = map_errors(problem, MountedTags.of(DEPLOYMENT), {"planned": shifted}, poses, np.random.default_rng(0))
    assert len(views) > 20
    assert np.median(views.position_planned) == pytest.approx(0.005, rel=1e-4)
