import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.optimisers.ega import EGA


def started(dim=20, start=None, **parameters):
    """An EGA with its first population of 12 told; fitness is the sum of the genes."""
    ega = EGA(**({"population": 12, "eliminated": 3} | parameters))
    ega.dim, ega.rng = dim, np.random.default_rng(5)
    ega.start = ega.rng.random((12, dim)) if start is None else start
    first = ega.ask()
    ega.tell(first, first.sum(axis=1))
    return ega


def runs_of(changed):
    """Lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], changed.astype(int), [0]])))
    return list(edges[1::2] - edges[::2])


def test_the_first_population_is_the_start_filled_up():
    start = np.full((1, 20), 0.5)
    ega = started(start=start)
    assert len(ega.population) == 12
    assert (ega.population == 0.5).all(axis=1).sum() == 1


def test_the_best_chromosome_survives_every_generation():
    ega = started(mutation_probability=1.0)
    for _ in range(20):
        survivor = ega.population[0].copy()
        genes = ega.ask()
        assert len(genes) == 11
        ega.tell(genes, genes.sum(axis=1))
        assert ega.population[0].sum() >= survivor.sum()
        assert (ega.population == survivor).all(axis=1).any()


def test_as_many_are_eliminated_as_asked_and_the_rest_only_recombine():
    ega = started(mutation_probability=0.0)
    genes = ega.ask()
    from_pool = np.isin(genes, ega.population[1:9]).all(axis=1)
    assert from_pool.tolist() == [True] * 8 + [False] * 3


def test_pool_partners_exchange_runs_of_the_chosen_length():
    ega = started(mutation_probability=0.0, recombination_min=0.25, recombination_max=0.5)
    parents, children = ega.population[1:9], ega.ask()[:8]
    np.testing.assert_array_equal(np.sort(parents, axis=0), np.sort(children, axis=0))
    for parent, child in zip(parents, children, strict=True):
        (length,) = runs_of(parent != child)
        assert 5 <= length <= 10


def test_the_survivor_gives_its_genes_in_runs():
    ega = started(mutation_probability=0.0, partner="survivor", recombination_min=0.25, recombination_max=0.5)
    children = ega.ask()[:8]
    for child in children:
        (length,) = runs_of(child == ega.population[0])
        assert 5 <= length <= 10


def test_children_always_replace_their_parents_unless_told_otherwise():
    literal, picky = started(), started(acceptance="if_better")
    for ega in (literal, picky):
        genes = ega.ask()
        ega.tell(genes, np.full(len(genes), -1.0))
    assert (literal.fitness[1:] == -1.0).all()
    assert (picky.fitness[:9] > -1.0).all()
    assert (picky.fitness[9:] == -1.0).all()  # the eliminated do go


@pytest.mark.parametrize("mutation", ["reset", "gaussian"])
def test_each_gene_mutates_with_the_given_probability(mutation):
    ega = started(dim=4000, mutation_probability=0.1, mutation=mutation, recombination_max=0.0, recombination_min=0.0)
    changed = ega.ask()[:8] != ega.population[1:9]
    assert changed.mean() == pytest.approx(0.1, abs=0.01)


def test_the_defaults_are_the_printed_parameters():
    ega = EGA()
    assert (ega.population_size, ega.eliminated, ega.mutation_probability) == (30, 7, 0.1)
    assert [round(f * 450) for f in (ega.recombination_min, ega.recombination_max)] == [100, 300]


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"population": 7, "eliminated": 7}, r"^eliminated = 7 leaves no survivor among 7"),
        ({"population": 1}, r"^population must be at least 2, got 1"),
        ({"recombination_max": 1.5}, r"^recombination_max must be in \[0, 1\], got 1\.5"),
        ({"recombination_min": 0.9}, r"^recombination_min must be in \[0, 0\.666667\], got 0\.9"),
        ({"mutation_probability": 2}, r"^mutation_probability must be in \[0, 1\], got 2"),
        ({"partner": "best"}, r"^partner must be one of pool, survivor, got 'best'"),
        ({"seed": -1}, r"seed must be in \[0, 3\.40282e\+38\], got -1"),
    ],
)
def test_impossible_parameters_are_refused(parameters, message):
    with pytest.raises(InputError, match=message):
        EGA(**parameters)
