"""Searches that solve integer programs again and again: their books, choices and stops. Some 30 s of processor time."""

from functools import partial

import numpy as np
import pytest
from contracts.optimiser import check_going_on, same_run
from lattices import PLENTY, SPACING, best_of_all, problem

from lmd.core.checks import InputError
from lmd.objectives.localisation import Localisation
from lmd.optimisers.adaptive_lattice import AdaptiveLattice, _around
from lmd.optimisers.lattice import Program, covers_of, lattice_of, placed
from lmd.optimisers.ledger import Budget
from lmd.optimisers.neighbourhoods import LargeNeighbourhoods
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.tag import Tag

harder = partial(problem, count=4, thold_p=0.2, occlusion="paper")
neighbourhoods = partial(LargeNeighbourhoods, spacing=SPACING, freed=2, candidates=10, patience=5)
adaptive = partial(AdaptiveLattice, spacing=SPACING, finest=0.7, nodes=3)


@pytest.fixture(
    params=[neighbourhoods, pytest.param(adaptive, marks=pytest.mark.slow)], ids=["neighbourhoods", "adaptive"]
)
def make(request):
    return request.param


def test_every_round_is_paid_for(make):
    p, optimiser = harder(), make()
    result = optimiser.run(p, PLENTY)
    assert result.fitness == p.metrics(result.deployment)["fitness"] > 0.0
    views = round((result.evaluations - 2 - optimiser.rounds) * p.count)
    lattice = len(lattice_of(p, SPACING))
    assert views == lattice if make is neighbourhoods else lattice < views <= lattice + 8 * p.count * optimiser.rounds
    best = [record.best_fitness for record in result.history]
    assert best == sorted(best)
    assert len(best) == optimiser.rounds + 2


def test_no_round_begins_that_the_budget_does_not_pay_for(make):
    p = harder()
    needed = 2 + len(lattice_of(p, SPACING)) / p.count
    for limit in (int(needed) + 1, int(needed) + 3):
        assert needed <= make().run(harder(), Budget(limit)).evaluations <= limit
    with pytest.raises(InputError, match=r"takes .* evaluations, more than the 5 of the budget"):
        make().run(harder(), Budget(5))
    assert make().run(harder(), Budget(10**6, seconds=1e-3)).evaluations == pytest.approx(needed)


def test_a_run_that_goes_on_ends_as_if_it_had_not_been_stopped(make, tmp_path):
    whole = make().run(harder(), PLENTY)
    check_going_on(make, harder, whole, tmp_path)
    same_run(make().run(harder(), PLENTY), whole)


def test_the_result_is_no_worse_than_the_greedy_choice(make):
    p, optimiser = harder(), make()
    optimiser.lattice = lattice_of(p, SPACING)
    greedy = p.fitness_of(placed(p, optimiser.lattice, optimiser._greedy(p)))
    assert make().run(p, PLENTY).fitness >= greedy


def test_a_neighbourhood_of_all_landmarks_and_poses_gives_the_best_of_all_choices():
    p = problem()
    found = LargeNeighbourhoods(SPACING, freed=3, candidates=1000, nodes=10_000, patience=1).run(p, PLENTY)
    assert found.fitness >= best_of_all(problem()) > 0.0


def test_a_lattice_that_is_refined_is_no_worse_than_the_lattice():
    found = AdaptiveLattice(SPACING, finest=0.4, nodes=10_000).run(problem(), PLENTY)
    assert found.fitness >= best_of_all(problem()) > 0.0


def test_a_neighbourhood_frees_some_landmarks_and_opens_some_poses():
    p = problem(count=6, thold_p=0.3)
    poses = lattice_of(p, SPACING)

    def stays(seed):
        optimiser = neighbourhoods(seed=seed)
        optimiser.lattice, optimiser.covers = poses, covers_of(p, poses)
        optimiser.taken = optimiser._greedy(p)
        for optimiser.rounds in range(20):
            _, stay, most = optimiser._neighbourhood(p)
            assert stay.sum() == p.count - 2
            assert (stay <= optimiser.taken).all()
            assert (most[optimiser.taken > 0] == 2).all()
            assert (most[optimiser.taken == 0] > 0).sum() <= 10
            yield tuple(stay.tolist())

    first = list(stays(0))
    assert len(set(first)) > 5
    assert first == list(stays(0)) != list(stays(1))


def test_neighbours_of_a_pose_lie_a_pitch_away_on_its_surface():
    p = problem(count=2, n=1, tag=Tag(0.3))
    chosen = p.draw(np.random.default_rng(3))
    around = _around(p, chosen, 0.2)
    assert len(around) == 16
    away = np.abs(around.positions - np.repeat(chosen.positions, 8, axis=0))
    assert away.max() <= 0.2 + 1e-9
    np.testing.assert_array_equal(around.surfaces, np.repeat(chosen.surfaces, 8))
    for k in range(len(around)):
        p.scene.footprints.check(around[k : k + 1])


def test_papers_of_tags_do_not_overlap(make):
    p = problem(count=3, n=1, tag=Tag(0.8), thold_p=0.3)
    p.scene.footprints.check(make(spacing=1.0).run(p, PLENTY).deployment)


def test_fixed_landmarks_stay(make):
    hangs = UniformDeployment(3).draw(problem().scene.room, np.random.default_rng(0))
    p = harder(fixed=hangs, start=RandomDeployment(3))
    result = make().run(p, PLENTY)
    np.testing.assert_array_equal(result.deployment.positions[:3], hangs.positions)


def test_a_margin_raises_the_threshold_of_the_program():
    p = problem()
    poses = lattice_of(p, SPACING)
    covers = covers_of(p, poses)
    plain, higher = Program.of(p, poses, covers), Program.of(p, poses, covers, margin=0.1)
    assert higher.threshold == pytest.approx(plain.threshold + 0.1)
    assert Program.of(p, poses, covers, margin=1.0).threshold <= 1.0


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: LargeNeighbourhoods(spacing=0), r"^spacing must be greater than 0"),
        (lambda: LargeNeighbourhoods(freed=0), r"^freed must be at least 1"),
        (lambda: LargeNeighbourhoods(candidates=0), r"^candidates must be at least 1"),
        (lambda: LargeNeighbourhoods(patience=0.5), r"^patience must be a whole number"),
        (lambda: LargeNeighbourhoods(nodes=0), r"^nodes must be at least 1"),
        (lambda: AdaptiveLattice(margin=-0.1), r"^margin must be in \[0, 1\], got -0.1"),
        (lambda: AdaptiveLattice(finest=2.0), r"^finest must be at most 1"),
    ],
)
def test_impossible_parameters_are_refused(build, message):
    with pytest.raises(InputError, match=message):
        build()


def test_other_objectives_are_refused(make):
    p = problem()
    with pytest.raises(InputError, match="plain coverage at the grid's own"):
        make().check(Problem(p.scene, Localisation(), p.start, 1))


def test_a_state_of_another_problem_is_refused(make):
    optimiser = make()
    optimiser.run(harder(), Budget(30))
    state = optimiser.state()
    wrong = {"taken": state["taken"] + 1} if make is neighbourhoods else {"pitch": 2.0}
    with pytest.raises(InputError, match=r"^(taken must|pitch must be at most 1\.5)"):
        make().restore(state | wrong, harder())
