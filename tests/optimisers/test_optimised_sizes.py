"""Optimisers place tags of several sizes: each keeps its own, and what is reported is what an evaluation finds."""

from dataclasses import replace

import numpy as np
import pytest
from floor_plans import lab
from paper import paper_camera

from lmd.core.checks import InputError
from lmd.evaluation.bounds import Search, fitness_upper_bound
from lmd.evaluation.selection_bound import selection_upper_bound
from lmd.objectives.coverage import Coverage
from lmd.optimisers.annealing import Annealing, Stage
from lmd.optimisers.annealing.surrogate import Surrogate
from lmd.optimisers.composition import composition
from lmd.optimisers.greedy import Greedy, GreedyDeployment
from lmd.optimisers.ledger import Budget
from lmd.optimisers.milp import Milp
from lmd.optimisers.random_search import RandomSearch
from lmd.optimisers.selection import Paper, Tags, candidates, select
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

EDGES, COUNTS = (0.05, 0.1, 0.3), (10, 6, 2)
COVERAGE = Coverage(2, 0.6)


def scene(tag):
    orientations = pdf.grid_with_ends(6, [(-0.4, 0.5), (0.3, 0.5)])
    return Scene(lab(spacing=1.0), paper_camera(), orientations, Fiducial(tag))


TAG = Tag(0.1, edges=EDGES, counts=COUNTS)
OWN = np.repeat(EDGES, COUNTS)


@pytest.fixture(scope="module")
def problem():
    return Problem(scene(TAG), COVERAGE, RandomDeployment(len(OWN)), threads=1)


@pytest.mark.parametrize(
    "optimiser",
    # The walk is compiled for one more kind of sight.
    [RandomSearch(), *(pytest.param(each, marks=pytest.mark.slow) for each in (Annealing(walkers=1), Greedy()))],
)
def test_the_fitness_is_that_of_the_result_and_each_landmark_keeps_its_size(problem, optimiser):
    result = optimiser.run(problem, Budget(40, None))
    np.testing.assert_array_equal(result.deployment.edges, OWN)
    assert result.fitness == problem.fitness_of(result.deployment)
    problem.scene.plates.check(result.deployment)
    counts = Evaluator(scene(TAG), threads=1).counts(result.deployment)  # by the edges of the deployment itself
    np.testing.assert_array_equal(counts, problem.evaluator.counts(replace(result.deployment, edges=None)))


@pytest.mark.slow  # the walk for one more kind of sight
def test_landmarks_of_different_sizes_exchange_their_places(problem):
    rng, surrogate = np.random.default_rng(0), Surrogate(problem, 1, 0.35)
    start = problem.draw(rng)
    surrogate.prepare(start, start, False, 1.0, 1.0, rng)
    stage = Stage([1e3] * 2, [0.05] * 2, [0.1] * 2, exchange=1.0)
    surrogate.walk(100, stage.settings(0.0, 0.1), rng)
    here = surrogate.here()
    places = [np.array(sorted(each.positions.tolist())) for each in (here, start)]
    np.testing.assert_array_equal(*places)
    assert (here.positions != start.positions).any(axis=1).sum() > 5
    problem.scene.plates.check(replace(here, edges=problem.edges))
    values = surrogate._walkers[0].state.units[surrogate._field.index_of]
    np.testing.assert_array_equal(values, problem.evaluator.units(here.positions[None], here.normals[None], 2)[0])


def test_selection_takes_no_more_of_a_size_than_there_are():
    plates, evaluator = scene(TAG).plates, Evaluator(scene(TAG).sized(OWN), threads=1)
    poses, relevance = candidates(plates, OWN, 0.8), np.ones(len(evaluator.positions))
    chosen, _ = select(COVERAGE.selection(evaluator, relevance), poses, Tags(OWN), plates)
    np.testing.assert_array_equal(np.sort(poses.edges[chosen]), OWN)
    plates.check(poses[chosen])


def test_selection_takes_no_more_paper_than_there_is_and_leaves_less_than_a_tag():
    plates, evaluator, area = scene(TAG).plates, Evaluator(scene(TAG).sized(OWN), threads=1), 0.3
    poses, relevance = candidates(plates, np.array(EDGES), 0.8), np.ones(len(evaluator.positions))
    chosen, _ = select(COVERAGE.selection(evaluator, relevance), poses, Paper(area, plates), plates)
    used = (plates.papers(poses[chosen]) ** 2).sum()
    assert area - plates.edge**2 < used <= area
    counts = composition(scene(replace(TAG, counts=None)), COVERAGE, area, threads=1)
    assert 0.0 < (np.array(counts) * (1.25 * np.array(EDGES)) ** 2).sum() <= area
    with pytest.raises(InputError, match=r"^paper = 0\.001 square metres is too little for a tag: it takes 0\.00391"):
        composition(scene(TAG), COVERAGE, 0.001)


def test_a_greedy_start_has_the_sizes_asked_for():
    start = GreedyDeployment(len(OWN), scene(TAG), COVERAGE, 0.8, threads=1)
    np.testing.assert_array_equal(np.sort(start.draw(lab(), np.random.default_rng()).edges), OWN)


@pytest.mark.parametrize(
    "ask",
    [
        lambda problem: fitness_upper_bound(problem, problem.count, Search(1.0, 1, 0.1)),
        lambda problem: selection_upper_bound(problem, problem.count, 1.0),
        lambda problem: Milp().check(problem),
    ],
)
def test_what_knows_one_size_says_so(problem, ask):
    with pytest.raises(InputError, match=r"works with tags of one size, not with edges of 0\.05, 0\.1, 0\.3 m\."):
        ask(problem)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"counts": (1, 2)}, r"^counts = \[1, 2\] must say how many tags have each of edges = \[0\.05, 0\.1, 0\.3\]\."),
        ({"counts": (0, 0, 0)}, r"^counts = \[0, 0, 0\] must say"),
        ({"counts": (1, -2, 3)}, r"^counts must be"),
        ({"edges": None}, r"^counts = \[10, 6, 2\] must say how many tags have each of edges = \[\]\."),
        ({"paper": 0.0}, r"^paper must be"),
        ({"paper": 1.0, "edges": None, "counts": None}, r"^paper = 1 square metres needs edges"),
    ],
)
def test_a_bad_tag_is_refused(settings, message):
    with pytest.raises(InputError, match=message):
        replace(TAG, **settings)


def test_counts_of_another_number_of_tags_are_refused():
    with pytest.raises(InputError, match=r"^counts = \[10, 6, 2\] are not 5 tags\.$"):
        TAG.in_turn(5)
