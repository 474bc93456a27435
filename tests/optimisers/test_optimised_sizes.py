"""Optimisers place tags of several sizes: each keeps its own, and what is reported is what an evaluation finds."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from support.paper import paper_camera
from support.rooms import lab

from lmd.core.checks import InputError
from lmd.evaluation.bounds import (
    Search,
    average_upper_bound,
    fewest_landmarks,
    fitness_upper_bound,
    selection_upper_bound,
)
from lmd.objectives.coverage import Coverage
from lmd.optimisers.annealing import Annealing, Stage
from lmd.optimisers.annealing.surrogate import Conditions, Surrogate
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.greedy import Greedy, GreedyDeployment
from lmd.optimisers.ledger import Budget
from lmd.optimisers.milp import Milp
from lmd.optimisers.selection import Tags, candidates, composition, select, stock_of_sizes
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
WALK = pytest.mark.thorough("lmd/optimisers", "lmd/incremental")  # the walk is compiled for one more kind of sight


@pytest.fixture(scope="module")
def problem():
    return Problem(scene(TAG), COVERAGE, RandomDeployment(len(OWN)), threads=1)


@pytest.mark.parametrize(
    "optimiser",
    [RandomSearch(), *(pytest.param(each, marks=WALK) for each in (Annealing(walkers=1), Greedy()))],
)
def test_the_fitness_is_that_of_the_result_and_each_landmark_keeps_its_size(problem, optimiser):
    result = optimiser.run(problem, Budget(40, None))
    np.testing.assert_array_equal(result.deployment.edges, OWN)
    assert result.fitness == problem.fitness_of(result.deployment)
    problem.scene.footprints.check(result.deployment)
    counts = Evaluator(scene(TAG), threads=1).counts(result.deployment)  # by the edges of the deployment itself
    np.testing.assert_array_equal(counts, problem.evaluator.counts(replace(result.deployment, edges=None)))


@WALK
def test_landmarks_of_different_sizes_exchange_their_places(problem):
    rng, surrogate = np.random.default_rng(0), Surrogate(problem, 1)
    start = problem.draw(rng)
    stage = Stage([1e3] * 2, [0.05] * 2, [0.1] * 2, exchange=1.0)
    here, _ = surrogate.walk(start, start, Conditions(False, 1.0, 1.0, stage.settings(0.0, 0.1)), 100, rng)
    places = [np.array(sorted(each.positions.tolist())) for each in (here, start)]
    np.testing.assert_array_equal(*places)
    assert (here.positions != start.positions).any(axis=1).sum() > 5
    problem.scene.footprints.check(replace(here, edges=problem.edges))
    values = surrogate._walkers[0].state.units[surrogate._field.index_of]
    np.testing.assert_array_equal(values, problem.evaluator.units(here.positions[None], here.normals[None], 2)[0])


def test_selection_takes_no_more_of_a_size_than_there_are():
    footprints, evaluator = scene(TAG).footprints, Evaluator(scene(TAG).sized(OWN), threads=1)
    poses, relevance = candidates(footprints, OWN, 0.8), np.ones(len(evaluator.positions))
    chosen, _ = select(COVERAGE.selection(evaluator, relevance), poses, Tags(OWN, TAG), footprints)
    np.testing.assert_array_equal(np.sort(poses.edges[chosen]), OWN)
    footprints.check(poses[chosen])


def test_selection_takes_no_more_paper_than_there_is_and_leaves_less_than_a_tag():
    footprints, evaluator, area = scene(TAG).footprints, Evaluator(scene(TAG).sized(OWN), threads=1), 0.3
    poses, relevance = candidates(footprints, np.array(EDGES), 0.8), np.ones(len(evaluator.positions))
    chosen, _ = select(
        COVERAGE.selection(evaluator, relevance), poses, stock_of_sizes(TAG, footprints, area), footprints
    )
    used = (footprints.papers(poses[chosen]) ** 2).sum()
    assert area - footprints.edge**2 < used <= area
    counts = composition(scene(replace(TAG, counts=None, paper=area)), COVERAGE, threads=1)
    assert 0.0 < (np.array(counts) * (1.25 * np.array(EDGES)) ** 2).sum() <= area
    with pytest.raises(InputError, match=r"^paper = 0\.001 m2 is too little: the smallest tag takes 0\.00391"):
        composition(scene(replace(TAG, paper=0.001)), COVERAGE)
    costs = (1.0, 2.0, 10.0)
    bought = composition(scene(replace(TAG, counts=None, costs=costs, budget=15.0)), COVERAGE, threads=1)
    assert 14.0 < np.array(bought) @ costs <= 15.0
    with pytest.raises(InputError, match=r"^budget = 0\.5 is too little: the cheapest tag costs 1\."):
        composition(scene(replace(TAG, costs=costs, budget=0.5)), COVERAGE)


def test_a_greedy_start_has_the_sizes_asked_for():
    start = GreedyDeployment(len(OWN), scene(TAG), COVERAGE, 0.8, threads=1)
    np.testing.assert_array_equal(np.sort(start.draw(lab(), np.random.default_rng()).edges), OWN)


FEW, SPACING = Tag(edges=(0.1, 0.3), counts=(2, 1)), 4.0


@pytest.fixture(scope="module", name="few")
def _few():
    return Problem(scene(FEW), Coverage(2, 0.3), RandomDeployment(3), threads=1)


def test_no_deployment_exceeds_the_bounds(few, monkeypatch):
    monkeypatch.setattr("lmd.evaluation.relaxation.MOST_CELLS", 20_000)  # the bound holds whenever it stops
    search = Search(3.0, 100, 0.02)
    bound, best = average_upper_bound(few, 3, search), fitness_upper_bound(few, 3, search).walls
    assert bound.grid - bound.fractional <= search.tolerance
    assert bound.walls >= bound.grid - search.tolerance
    for seed in range(8):
        drawn = few.draw(np.random.default_rng(seed))
        assert few.values(drawn).mean() <= bound.walls
        assert few.fitness_of(drawn) <= best


def replaced(few, objective):
    return Problem(few.scene, objective, RandomDeployment(few.count), threads=1)


def choices(problem, poses):
    """All choices of two small tags and a large one whose papers do not overlap."""
    small, large = (np.flatnonzero(poses.edges == edge) for edge in FEW.edges)
    footprints = problem.scene.footprints
    touched = np.array([footprints.touched(poses, poses[j : j + 1]) for j in range(len(poses))])
    for i, j in combinations(small, 2):
        for k in large:
            if not (touched[i, j] or touched[i, k] or touched[j, k]):
                yield [i, j, k]


def test_the_integer_program_finds_the_best_of_all_choices(few):
    milp, few = Milp(spacing=SPACING), replaced(few, Coverage(1, 0.05))
    poses = candidates(few.scene.footprints, np.array(FEW.edges), SPACING)
    all_of_them = np.array(list(choices(few, poses)))
    best = few.fitness(poses.positions[all_of_them], poses.normals[all_of_them]).max()
    result = milp.run(few, Budget(10_000))
    assert result.stopped == "proven"
    assert result.fitness == best == milp.figures()["lattice_bound"] > 0.0
    np.testing.assert_array_equal(result.deployment.edges, np.repeat(FEW.edges, FEW.counts))


def test_no_choice_exceeds_the_bound_of_a_selection(few):
    bound = selection_upper_bound(few, 3, SPACING)
    poses = candidates(few.scene.footprints, np.array(FEW.edges), SPACING)
    reached = []
    for chosen in list(choices(few, poses))[::80]:
        selection = few.objective.selection(few.fitness_evaluator, few.fitness_relevance)
        reached.append(0.0)
        for j in chosen:
            reached[-1] += float(selection.gains(poses[[j]])[0])
            selection.add(poses[[j]])
    assert bound.guarantee == 0.5
    assert max(reached) <= bound.grid + 1e-9
    assert bound.greedy <= bound.grid + 1e-9


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda few: fewest_landmarks(few, 0.5, Search()), r"works with tags of one size, not with edges of"),
        (
            lambda few: average_upper_bound(few, 5, Search(2.0)),
            r"^tags have several sizes: how many of each is known for 3, not for 5",
        ),
        (
            lambda few: selection_upper_bound(few, 5, 2.0),
            r"^tags have several sizes: how many of each is known for 3, not for 5\.$",
        ),
    ],
)
def test_what_has_no_meaning_for_several_sizes_says_so(few, ask, message):
    with pytest.raises(InputError, match=message):
        ask(few)
