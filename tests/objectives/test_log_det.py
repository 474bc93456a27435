"""The surrogate of greedy selection, and its bound, against the determinants of 6 x 6 matrices."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from support.paper import paper_room, paper_scene
from support.references import view_matrices

from lmd.evaluation.bounds import GUARANTEE, selection_upper_bound
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses
from lmd.space.space import Relevance

SPACING = 4.0  # 24 poses
OBJECTIVE = Localisation(sampling=None)


def small_scene(**visibility):
    heavy = Relevance(regions=[{"low": [0, 0, 0], "high": [3, 5, 6], "weight": 3.0}])
    scene = paper_scene(paper_room(spacing=3.0, relevance=heavy), orientations=pdf.grid_with_ends(4), **visibility)
    return replace(scene, tag=Tag(0.3))


SCENE = small_scene(occlusion="none", thold=0.15)
POSES = candidate_poses(SCENE.footprints.hanging, SPACING)


def information(scene, deployment):
    """Of each landmark in all views, `(K, V, 6, 6)`."""
    parts = [view_matrices(scene, deployment, p, scene.orientations.axes) for p in scene.room.grid()]
    return np.concatenate(parts).transpose(1, 0, 2, 3)


def mean_log_det(scene, matrices):
    """f less its value for no landmark, of matrices `(V, 6, 6)`: 5 tolerances and a radian are known beforehand."""
    scale = OBJECTIVE.pixel_noise / np.sqrt(np.prod(scene.camera.focal_pixels))
    prior = np.diag(np.repeat([(scale / 0.1) ** 2, scale**2], 3))
    relevance = scene.room.relevance.weights(scene.room.grid())
    weights = np.outer(relevance / relevance.sum(), scene.orientations.weight).reshape(-1)
    return weights @ np.linalg.slogdet(prior + matrices)[1] - np.linalg.slogdet(prior)[1]


def selection(by_reference=False):
    evaluator = Evaluator(SCENE, threads=2, by_reference=by_reference)
    return OBJECTIVE.selection(evaluator, SCENE.room.relevance.weights(evaluator.positions))


@pytest.mark.parametrize("by_reference", [False, True])
def test_gains_are_differences_of_log_determinants(by_reference):
    landmarks = RandomDeployment(12).draw(SCENE.room, np.random.default_rng(0))
    each, chosen = information(SCENE, landmarks), selection(by_reference)
    for k in range(5):
        before = mean_log_det(SCENE, each[:k].sum(axis=0))
        expected = [mean_log_det(SCENE, each[:k].sum(axis=0) + one) - before for one in each]
        np.testing.assert_allclose(chosen.gains(landmarks), expected, rtol=1e-6, atol=1e-9)
        assert np.max(expected) > 0.1
        chosen.add(landmarks[k : k + 1])


@pytest.mark.parametrize("count", [1, 2, 3])
def test_no_choice_of_poses_exceeds_the_bound_and_greedy_keeps_its_promise(count):
    problem = Problem(SCENE, OBJECTIVE, RandomDeployment(count + 2), threads=1)
    each, bound = information(SCENE, POSES), selection_upper_bound(problem, count, SPACING)
    best = max(mean_log_det(SCENE, each[list(some)].sum(axis=0)) for some in combinations(range(len(POSES)), count))
    assert GUARANTEE * best < bound.greedy <= best * (1.0 + 1e-6)
    assert best * (1.0 - 1e-6) <= bound.grid < 1.5 * best
    assert bound.share == bound.greedy / bound.grid


def test_the_bound_is_the_same_on_any_number_of_threads_and_one_for_coverage():
    problems = [Problem(SCENE, objective, RandomDeployment(6), threads=threads)
                for objective in (OBJECTIVE, Coverage(2, 0.5)) for threads in (1, 3)]  # fmt: skip
    one, same, covered, as_covered = (selection_upper_bound(problem, 6, SPACING) for problem in problems)
    assert (one, covered) == (same, as_covered)
    assert 0.0 < covered.greedy <= covered.grid
