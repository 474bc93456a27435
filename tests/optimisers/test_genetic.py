"""The paper's genetic algorithms: EGA, and SGA, with which it compares."""

import numpy as np
import pytest

from lmd.optimisers.genetic import EGA, SGA

COPIES = {"mutation_probability": 0.0, "recombination_min": 0.0, "recombination_max": 0.0}


def begun(optimiser, dim, start=None):
    optimiser.dim, optimiser.rng = dim, np.random.default_rng(5)
    optimiser.start = optimiser.rng.random((12, dim)) if start is None else start
    return optimiser


def told(optimiser, fitness=lambda genes: genes.sum(axis=1)):
    """The optimiser after its first population."""
    genes = optimiser.ask()
    optimiser.tell(genes, np.asarray(fitness(genes), dtype=float))
    return optimiser


def ega(dim=20, **parameters):
    return told(begun(EGA(**({"population": 12, "eliminated": 3} | parameters)), dim))


def sga(fitness, dim=20, **parameters):
    """An SGA whose first population was told `fitness`."""
    return told(begun(SGA(**({"population": len(fitness)} | parameters)), dim), lambda _: fitness)


def runs_of(changed):
    """Lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], changed.astype(int), [0]])))
    return list(edges[1::2] - edges[::2])


@pytest.mark.parametrize("make", [EGA, SGA])
def test_the_first_population_is_the_start_filled_up(make):
    first = begun(make(population=12), 20, np.full((1, 20), 0.5)).ask()
    assert first.shape == (12, 20)
    assert (first == 0.5).all(axis=1).tolist() == [True] + [False] * 11


@pytest.mark.parametrize(
    ("fitness", "shares"),
    [
        ([0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3, 0.4]),
        ([-np.inf, np.nan, 0.5, 0.5], [0.0, 0.0, 0.5, 0.5]),  # failed evaluations have no offspring
        ([0.0] * 4, [0.25] * 4),
        ([-np.inf] * 4, [0.25] * 4),
    ],
)
def test_sga_draws_parents_in_proportion_to_their_fitness(fitness, shares):
    optimiser = sga(fitness, **COPIES)
    parents = optimiser.population
    children = np.concatenate([optimiser.ask() for _ in range(400)])
    drawn = (children[:, None] == parents).all(axis=2).mean(axis=0)
    np.testing.assert_allclose(drawn, shares, atol=0.04)


def test_sga_keeps_nothing_from_one_generation_to_the_next():
    optimiser = sga([0.9] + [0.1] * 5, mutation_probability=1.0)
    best = optimiser.population[0]
    optimiser.tell(optimiser.ask(), np.zeros(6))
    assert not (optimiser.population == best).all(axis=1).any()
    assert optimiser.ledger.best_fitness == 0.9


def test_survivors_of_sga_take_the_place_of_the_worst_children():
    optimiser = sga([0.9, 0.8] + [0.1] * 4, mutation_probability=1.0, survivors=2)
    best = optimiser.population[:2].copy()
    children = optimiser.ask()
    optimiser.tell(children, np.array([0.5, 0.0, 0.6, 0.2, 0.3, 0.4]))
    assert (optimiser.population[[1, 3]] == best).all()
    assert (optimiser.population[[0, 2, 4, 5]] == children[[0, 2, 4, 5]]).all()
    assert optimiser.fitness.tolist() == [0.5, 0.9, 0.6, 0.8, 0.3, 0.4]


def test_partners_of_sga_exchange_genes_in_place():
    optimiser = sga([0.5] * 6, mutation_probability=0.0)
    assert (np.isin(optimiser.ask(), optimiser.population)).all()
    assert not (optimiser.ask()[:, None] == optimiser.population).all(axis=2).any(axis=1).all()


def test_the_best_chromosome_of_ega_survives_every_generation():
    optimiser = ega(mutation_probability=1.0)
    for _ in range(20):
        survivor = optimiser.population[0].copy()
        genes = optimiser.ask()
        assert len(genes) == 11
        optimiser.tell(genes, genes.sum(axis=1))
        assert optimiser.population[0].sum() >= survivor.sum()
        assert (optimiser.population == survivor).all(axis=1).any()


def test_ega_eliminates_as_many_as_asked_and_the_rest_only_recombine():
    optimiser = ega(mutation_probability=0.0)
    from_pool = np.isin(optimiser.ask(), optimiser.population[1:9]).all(axis=1)
    assert from_pool.tolist() == [True] * 8 + [False] * 3


@pytest.mark.parametrize("partner", ["pool", "survivor"])
def test_genes_are_exchanged_in_runs_of_the_chosen_length(partner):
    optimiser = ega(mutation_probability=0.0, partner=partner, recombination_min=0.25, recombination_max=0.5)
    parents, children = optimiser.population[1:9], optimiser.ask()[:8]
    if partner == "pool":
        np.testing.assert_array_equal(np.sort(parents, axis=0), np.sort(children, axis=0))
    for parent, child in zip(parents, children, strict=True):
        (length,) = runs_of(parent != child if partner == "pool" else child == optimiser.population[0])
        assert 5 <= length <= 10


def test_children_always_replace_their_parents_by_default():
    literal, picky = ega(), ega(acceptance="if_better")
    for optimiser in (literal, picky):
        told(optimiser, lambda genes: np.full(len(genes), -1.0))
    assert (literal.fitness[1:] == -1.0).all()
    assert (picky.fitness[:9] > -1.0).all()
    assert (picky.fitness[9:] == -1.0).all()  # the eliminated are replaced


def test_each_gene_mutates_with_the_given_probability():
    parameters = COPIES | {"mutation_probability": 0.1}
    for optimiser in (sga([0.5] * 6, dim=4000, **parameters), ega(dim=4000, **parameters)):
        assert np.isin(optimiser.ask()[:6], optimiser.population).mean() == pytest.approx(0.9, abs=0.01)


def test_the_defaults_are_the_printed_parameters():
    optimiser = EGA()
    assert (optimiser.population_size, optimiser.eliminated, optimiser.mutation_probability) == (30, 7, 0.1)
    assert [round(f * 450) for f in (optimiser.recombination_min, optimiser.recombination_max)] == [100, 300]
