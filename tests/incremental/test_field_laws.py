"""Laws of every objective, whatever sees the landmarks, where they hang and how large they are."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.criterion import check_counts, check_every_path, check_gains, check_shrunk, check_views
from numpy.testing import assert_array_equal
from support.exact import check_exact
from support.paper import paper_scene
from support.product import MOVES, law
from support.strategies import with_probabilities

from lmd.objectives.coverage import Coverage
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight.evaluator import Evaluator

pytestmark = pytest.mark.long


@law(60)
def test_the_fast_paths_find_what_the_reference_finds(case):
    check_exact(case)


@law(60, "coverage")
def test_counts_are_those_of_the_formulas(case):
    check_counts(case.scene, case.deployment, case.objective.n, threads=3)


@law(40)
def test_neither_the_order_of_landmarks_nor_threads_change_anything(case):
    order = case.rng.permutation(len(case.deployment))
    scene, edges = case.scene, case.scene.edges
    other = scene if edges is None or len(edges) == 1 else scene.sized(np.array(edges)[order])
    shuffled = case.values(Evaluator(other, threads=3), case.deployment[order])
    assert_array_equal(shuffled, case.values(Evaluator(scene, threads=1)))


@law(20, "localisation", "one_tag", "turned")
def test_localisation_without_a_tolerance_is_coverage(case):
    """By the reference, as what stands in the way."""
    anywhere = replace(case.objective, tolerance=np.inf, rotation_tolerance=None, ambiguity="ignored")
    slow, coverage = Evaluator(case.scene, by_reference=True), Coverage(case.objective.n, 0.5)
    assert_array_equal(*(replace(case, objective=each).values(slow) for each in (anywhere, coverage)))


class Alone:
    """The criteria of a scene for each landmark on its own."""

    def __init__(self, scene):
        self._seen, self._edges = scene.visibility, scene.edges or ()

    def __getattr__(self, name):
        return getattr(self._seen, name)

    def covered(self, camera, position, axes, landmarks, normals):
        each = [self._seen.sized((edge,)) for edge in self._edges] or [self._seen] * len(landmarks)
        parts = zip(each, landmarks[:, None], normals[:, None], strict=True)
        return np.hstack([seen.covered(camera, position, axes, *at) for seen, *at in parts])


class Open:
    """A room with nothing in the way."""

    def __init__(self, room):
        self._room = room

    def __getattr__(self, name):
        return getattr(self._room, name)

    def clear(self, starts, ends):
        return np.ones(np.broadcast_shapes(np.shape(starts), np.shape(ends))[:-1], dtype=bool)


@law(20)
def test_what_stands_in_the_way_only_takes_away(case):
    """By the reference alone, for which nothing is compiled."""
    unhidden = replace(case.scene, visibility=Alone(case.scene), room=Open(case.scene.room), crowd=None)
    states = 1 if case.scene.crowd is None else len(case.scene.crowd)
    less, more = (case.values(Evaluator(scene, by_reference=True)) for scene in (case.scene, unhidden))
    assert (less <= np.tile(more, states)).all()


@law(10, "coverage", quick=MOVES)
def test_smaller_tags_hide_less(case):
    check_shrunk(case.scene, case.deployment)


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight", "none"])
def test_moves_among_many_blocks_of_positions_are_exact(occlusion):
    """In the paper's room, with probabilities by position; landmarks come to where they hide each other."""
    scene, rng = with_probabilities(paper_scene(occlusion=occlusion), 1), np.random.default_rng(0)
    deployment, near = RandomDeployment(90).draw(scene.room, rng), rng.integers(90, size=60)
    along = rng.normal(0.0, 0.07, (60, 3)) * (deployment.normals[near] == 0.0)
    places = np.clip(deployment.positions[near] + along, 0.0, scene.room.size)
    check_every_path(scene, deployment, Deployment(places, deployment.normals[near]), 2, rng)


@law(20, "coverage")
def test_single_views_and_single_poses_are_those_of_the_reference(case):
    if case.scene.crowd is None:  # whose views `test_crowd` looks at
        for by_reference in (False, True):
            check_views(case.scene, case.deployment, by_reference)
            if not case.scene.has_several_sizes:
                check_gains(case.scene, case.deployment[:4], case.rng, by_reference)
