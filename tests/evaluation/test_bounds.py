import itertools
from dataclasses import replace

import numpy as np
import pytest
from contracts.criterion import check_gains, check_slack, cover_matrix
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.sparse import block_array, csr_array, eye_array, kron
from support.paper import paper_room, paper_scene
from support.small import make
from support.strategies import fiducial_scenes, scenes, scenes_with_boundary_landmarks, scenes_with_deployments, seeds
from support.thorough import examples

from lmd.core.checks import InputError
from lmd.evaluation.bounds import (
    Search,
    affordable,
    average_upper_bound,
    fewest_landmarks,
    fitness_upper_bound,
    selection_upper_bound,
)
from lmd.evaluation.relaxation import Relaxation, TimeLimit
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.optimisers.greedy import GreedyDeployment
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.tag import Tag
from lmd.sight.poses import candidate_poses, covered_amounts, gains
from lmd.space.space import Relevance
from pipelines.stored_runs import TABLE_3

COARSE = Search(spacing=1.0, iterations=150, tolerance=1e-4)


def small_problem(count=12, n=2, thold_p=0.3, threads=None, relevance=None, **visibility):
    room = paper_room(spacing=2.0, relevance=relevance or Relevance())
    scene = paper_scene(room, orientations=pdf.grid_with_ends(6), **visibility)
    return Problem(scene, Coverage(n, thold_p), RandomDeployment(count), threads=threads)


@pytest.fixture(scope="module")
def cover():
    """What each pose of the coarse grid covers, whatever is to be reached with how many of them."""
    scene = small_problem().scene
    return cover_matrix(scene, candidate_poses(scene.room, COARSE.spacing))


def exact_bound(problem, cover, count, threshold, shares):
    """max F over the grid by HiGHS: variables x (poses), m (position, axis), q (positions)."""
    weights = problem.scene.pdf.by_axis.weight
    size, axes = len(shares), len(weights)
    rows = block_array(
        [
            [csr_array(-cover.T / problem.objective.n), eye_array(size * axes), None],
            [None, csr_array(-kron(eye_array(size), weights[None]) / threshold), eye_array(size)],
        ]
    )
    cost = np.concatenate([np.zeros(len(cover) + size * axes), -shares])
    total = np.concatenate([np.ones(len(cover)), np.zeros(size * axes + size)])[None]
    bounds = [(0, None)] * len(cover) + [(None, 1)] * (size * axes + size)
    solved = linprog(cost, rows, np.zeros(rows.shape[0]), total, [count], bounds, method="highs")
    assert solved.success
    return -solved.fun


def test_candidates_are_the_centres_of_cells_on_every_wall():
    room = paper_room()
    poses = candidate_poses(room, 0.25)
    assert len(poses) == 2 * (30 * 20 + 30 * 24 + 20 * 24)
    assert (poses.with_surfaces(room).surfaces >= 0).all()
    for wall in room.surfaces():
        mine = (poses.normals == wall.normal).all(axis=1)
        a, b = wall.coordinates(poses.positions[mine])
        np.testing.assert_allclose(wall.point(a, b), poses.positions[mine], atol=1e-12)
        np.testing.assert_allclose(np.unique(a.round(9)), np.arange(0.125, wall.extent[0], 0.25))
        np.testing.assert_allclose(np.unique(b.round(9)), np.arange(0.125, wall.extent[1], 0.25))
    assert len(candidate_poses(room, 100.0)) == 6


@examples(40)
@given(st.one_of(scenes_with_deployments(), scenes_with_boundary_landmarks()), seeds)
def test_gains_and_amounts_follow_the_reference(drawn, seed):
    check_gains(*drawn, np.random.default_rng(seed))


@examples(40)
@given(st.one_of(scenes(), fiducial_scenes()), seeds, st.sampled_from([0.1, 0.5, 2.0]))
def test_a_cell_earns_at_least_what_any_landmark_in_it_does(scene, seed, spacing):
    check_slack(scene, spacing, np.random.default_rng(seed))


@examples(30)
@given(seeds, st.floats(0.05, 1.0), st.integers(1, 3), st.integers(1, 30))
def test_every_dual_bounds_every_distribution_of_landmarks(seed, threshold, n, count):
    problem, rng = small_problem(threads=1), np.random.default_rng(seed)
    poses = candidate_poses(problem.scene.room, 1.0)
    shares = rng.dirichlet(np.ones(len(problem.evaluator.positions)))
    relaxation = Relaxation(problem.evaluator, shares, n, threshold)
    _, dual = relaxation.smoothed(covered_amounts(problem.evaluator, poses, rng.random(len(poses))), 0.3)
    x = count * rng.dirichlet(np.full(len(poses), 0.1))
    bound = dual.bound(count, gains(problem.evaluator, poses, dual.prices).max())
    assert relaxation.value(covered_amounts(problem.evaluator, poses, x)) <= bound + 1e-12


@pytest.mark.parametrize("occlusion", ["none", "paper", "line_of_sight"])
@pytest.mark.parametrize(("n", "thold_p"), [(1, 0.4), (2, 0.3), (3, 1.0), (2, 0.0)])
def test_no_deployment_exceeds_the_bounds(n, thold_p, occlusion):
    problem = small_problem(20, n, thold_p, occlusion=occlusion, relevance=Relevance(
        regions=[{"low": [0, 0, 0], "high": [3, 5, 6], "weight": 3.0}]))  # fmt: skip
    search = Search(spacing=0.7, iterations=40)
    average, qualified = average_upper_bound(problem, 20, search), fitness_upper_bound(problem, 20, search)
    rng = np.random.default_rng(0)
    tried = [problem.start.draw(problem.scene.room, rng) for _ in range(30)]
    tried.append(make("annealing").run(problem, Budget(100)).deployment)
    for deployment in tried:
        metrics = problem.metrics(deployment)
        assert metrics["average_coverage_probability"] <= average.walls + 1e-12
        assert metrics["fitness"] <= qualified.walls + 1e-12
    for bound in (average, qualified):
        assert 0.0 <= bound.fractional <= bound.grid + 1e-12 <= bound.walls + 2e-12 <= 1.0 + 2e-12


def test_what_hangs_already_counts_and_lowers_the_bounds():
    free = small_problem()
    fixed = UniformDeployment(8).draw(free.scene.room, np.random.default_rng())
    problem = Problem(free.scene, free.objective, RandomDeployment(4), fixed=fixed)
    found = make("annealing").run(problem, Budget(200)).deployment
    deployments = [found, *(problem.draw(np.random.default_rng(seed)) for seed in range(10))]
    for method, key in ((average_upper_bound, "average_coverage_probability"), (fitness_upper_bound, "fitness")):
        bound = method(problem, 12, COARSE)
        assert max(problem.metrics(deployment)[key] for deployment in deployments) <= bound.walls + 1e-12
        assert bound.walls < 0.95 * method(free, 12, COARSE).walls
    choice, of_all = selection_upper_bound(problem, 12, 1.0), selection_upper_bound(free, 12, 1.0)
    assert choice.greedy <= choice.grid < of_all.grid
    assert fewest_landmarks(problem, 0.0, COARSE) == 9


@pytest.mark.parametrize("climbs", ["mean", "qualified"])
def test_nothing_localises_more_often_than_the_bounds_allow(climbs):
    scene = replace(small_problem().scene, tag=Tag(0.2))
    objective = Localisation(tolerance=0.1, thold_p=0.1, climbs=climbs, sampling=Sampling(2, 4))
    problem = Problem(scene, objective, UniformDeployment(20))
    search = Search(spacing=0.7, iterations=40)
    average, fitness = average_upper_bound(problem, 20, search), fitness_upper_bound(problem, 20, search)
    for source in (UniformDeployment(20), GreedyDeployment(20, scene, objective, spacing=0.7)):
        metrics = problem.metrics(source.draw(scene.room, np.random.default_rng(0)))
        assert 0.0 < metrics["localised_share"] <= average.walls < 1.0
        assert metrics["fitness"] <= fitness.walls


@pytest.mark.parametrize(("n", "count"), [(1, 6), (2, 12), (3, 12)])
def test_both_bounds_agree_with_a_linear_program(n, count, cover):
    problem = small_problem(count, n, 0.3)
    size = len(problem.relevance)
    shares = np.full(size, 1.0 / size)
    for method, threshold in ((average_upper_bound, 1.0), (fitness_upper_bound, 0.3)):
        bound, exact = method(problem, count, COARSE), exact_bound(problem, cover, count, threshold, shares)
        assert bound.fractional <= exact + 1e-9
        assert exact - 1e-9 <= bound.grid <= exact + 1e-3


def test_the_fewest_landmarks_are_where_the_bound_reaches_the_target():
    problem = small_problem(thold_p=0.5)
    fewest = fewest_landmarks(problem, 0.6, COARSE)
    assert fewest > 3
    assert fitness_upper_bound(problem, fewest, COARSE).walls >= 0.6 - 1e-9
    assert fitness_upper_bound(problem, fewest - 2, COARSE).fractional < 0.6
    assert fewest_landmarks(problem, 0.0, COARSE) == 2


def test_where_nothing_can_be_seen_the_bound_says_so_and_no_target_is_in_reach():
    problem = small_problem(n=1, thold_p=1.0, thold=5.0)
    bound = average_upper_bound(problem, 12, COARSE)
    assert bound.walls <= COARSE.tolerance
    assert bound.fractional == 0.0
    with pytest.raises(InputError, match=r"^target = 1 cannot be reached with 10000 landmarks\."):
        fewest_landmarks(problem, 1.0, COARSE)


def test_the_result_does_not_depend_on_threads():
    one, two = (average_upper_bound(small_problem(threads=threads), 12, COARSE) for threads in (1, 3))
    assert (one.walls, one.grid, one.fractional) == (two.walls, two.grid, two.fractional)


@pytest.fixture
def ticking(monkeypatch):
    """A clock that goes on by a second whenever it is asked."""
    seconds = itertools.count()
    for module in ("relaxation", "bounds"):
        monkeypatch.setattr(f"lmd.evaluation.{module}.clock", seconds.__next__)


@pytest.mark.usefixtures("ticking")
@pytest.mark.parametrize("seconds", [1, 40, 80])
def test_a_bound_that_the_time_ends_holds_and_says_what_was_cut_short(seconds):
    problem = small_problem()
    whole, limit = average_upper_bound(problem, 12, COARSE), TimeLimit(seconds)
    early = average_upper_bound(problem, 12, replace(COARSE, limit=limit))
    assert min(early.walls, early.grid) >= whole.fractional - 1e-9
    assert limit.cut[0].startswith("the multipliers after ")
    assert (early.walls == 1.0) == (seconds == 1)


@pytest.mark.usefixtures("ticking")
def test_a_greedy_choice_that_the_time_ends_is_bounded_too():
    problem = small_problem()
    whole, limit = selection_upper_bound(problem, 12, 1.0), TimeLimit(3)
    early = selection_upper_bound(problem, 12, 1.0, limit)
    assert limit.cut == ["the greedy choice after 0 of 12 landmarks"]
    assert (early.greedy, early.guarantee) == (0.0, 0.0)
    assert early.grid >= whole.grid


@pytest.mark.usefixtures("ticking")
def test_poses_are_as_far_apart_as_it_takes_for_the_time_to_suffice():
    problem, far = small_problem(), replace(COARSE, spacing=0.5)
    assert affordable(problem, 12, far).spacing == 0.5  # no limit
    coarser = affordable(problem, 12, replace(far, limit=TimeLimit(100)))
    assert 0.5 < coarser.spacing < 8.0


def test_the_papers_row_of_ega_exceeds_what_any_deployment_reaches():
    """Its printed P_2, P_3 and P_4 with P_1 >= P_2, at the low end of their rounding, against the proven 64.1082 %."""
    p2, p3, p4 = (TABLE_3[n, 0.65].average_coverage_probability - 0.5e-4 for n in (2, 3, 4))
    assert (p2 + p2 + p3 + p4) / 4.0 > 0.641082
