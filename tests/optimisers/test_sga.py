import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.optimisers.sga import SGA


def started(fitness, dim=20, **parameters):
    """An SGA whose first population was told `fitness`."""
    sga = SGA(**({"population": len(fitness)} | parameters))
    sga.dim, sga.rng = dim, np.random.default_rng(5)
    sga.start = sga.rng.random((1, dim))
    sga.tell(sga.ask(), np.asarray(fitness, dtype=float))
    return sga


def drawn(sga, generations=400):
    """How often each parent is drawn, as a share; children are copies of their parents."""
    parents = sga.population
    children = np.concatenate([sga.ask() for _ in range(generations)])
    return (children[:, None] == parents).all(axis=2).mean(axis=0)


copies = {"mutation_probability": 0.0, "recombination_min": 0.0, "recombination_max": 0.0}


def test_the_first_population_is_the_start_filled_up():
    sga = SGA(population=6)
    sga.dim, sga.rng, sga.start = 20, np.random.default_rng(5), np.full((1, 20), 0.5)
    first = sga.ask()
    assert first.shape == (6, 20)
    assert (first == 0.5).all(axis=1).tolist() == [True] + [False] * 5


def test_parents_are_drawn_in_proportion_to_their_fitness():
    np.testing.assert_allclose(drawn(started([0.1, 0.2, 0.3, 0.4], **copies)), [0.1, 0.2, 0.3, 0.4], atol=0.04)


def test_failed_evaluations_have_no_offspring():
    np.testing.assert_allclose(drawn(started([-np.inf, np.nan, 0.5, 0.5], **copies)), [0, 0, 0.5, 0.5], atol=0.04)


@pytest.mark.parametrize("fitness", [0.0, -np.inf])
def test_a_population_without_any_fitness_is_drawn_from_evenly(fitness):
    np.testing.assert_allclose(drawn(started([fitness] * 4, **copies)), [0.25] * 4, atol=0.04)


def test_nothing_is_kept_from_one_generation_to_the_next():
    sga = started([0.9] + [0.1] * 5, mutation_probability=1.0)
    best = sga.population[0]
    genes = sga.ask()
    sga.tell(genes, np.zeros(6))
    assert not (sga.population == best).all(axis=1).any()
    assert sga.ledger.best_fitness == 0.9


def test_partners_exchange_genes_in_place():
    sga = started([0.5] * 6, mutation_probability=0.0)
    assert (np.isin(sga.ask(), sga.population)).all()
    assert not (sga.ask()[:, None] == sga.population).all(axis=2).any(axis=1).all()


def test_each_gene_mutates_with_the_given_probability():
    sga = started([0.5] * 6, dim=4000, mutation_probability=0.1, recombination_min=0.0, recombination_max=0.0)
    assert 1.0 - np.isin(sga.ask(), sga.population).mean() == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"population": 1}, r"^population must be at least 2, got 1"),
        ({"recombination_max": 1.5}, r"^recombination_max must be in \[0, 1\], got 1\.5"),
        ({"recombination_min": 0.9}, r"^recombination_min must be in \[0, 0\.666667\], got 0\.9"),
        ({"mutation_probability": 2}, r"^mutation_probability must be in \[0, 1\], got 2"),
    ],
)
def test_impossible_parameters_are_refused(parameters, message):
    with pytest.raises(InputError, match=message):
        SGA(**parameters)
