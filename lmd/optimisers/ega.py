"""The elimination genetic algorithm of the paper (Sec. IV-B)."""

import numpy as np

from lmd.core.checks import FloatArray, InputError, choice, integer, real
from lmd.optimisers.base import AskTell
from lmd.optimisers.operators import exchange, filled_up, recombination_range, reset, run_of_genes


class EGA(AskTell):
    """Elimination genetic algorithm, the nine-tuple (W, Fit, pop_0, M, Q, Y_min, Y_max, Psi, T).

    In each generation the best chromosome survives unchanged, so the best fitness never falls. The Q worst chromosomes
    are replaced by random chromosomes. The others form the recombinant pool, exchange a run of genes and mutate. Fit is
    the problem's fitness, pop_0 the problem's start (filled up with random chromosomes), T the budget.

    The parameters fix choices that the paper leaves open. The defaults follow the text of the paper literally.

    Args:
        population: M.
        eliminated: Q, with Q + 1 <= M.
        recombination_min, recombination_max: Y_min and Y_max, the shortest and longest run of genes exchanged, as
            fractions of the chromosome: the printed 100 and 300 of 450 genes.
        mutation_probability: Psi, for each gene of a recombined chromosome.
        partner: `pool` pairs the chromosomes of the pool at random, and each pair exchanges a run of genes; `survivor`
            gives each chromosome a run of the survivor's genes.
        acceptance: `always` lets a child replace its parent; `if_better` does so only if the child's fitness is not
            lower.
        mutation: `reset` draws a new gene; `gaussian` moves the gene by a normal step.
        mutation_scale: standard deviation of the normal step (genes span 1).
        encoding: W, see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(
        self,
        population: int = 30,
        eliminated: int = 7,
        recombination_min: float = 100 / 450,
        recombination_max: float = 300 / 450,
        mutation_probability: float = 0.1,
        partner: str = "pool",
        acceptance: str = "always",
        mutation: str = "reset",
        mutation_scale: float = 0.05,
        encoding: str | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(seed, encoding)
        self.population_size = self.start_size = integer("population", population, low=2)
        self.eliminated = integer("eliminated", eliminated, low=0)
        if self.eliminated + 1 > self.population_size:
            raise InputError(f"eliminated = {eliminated} leaves no survivor among {population}.", "eliminated")
        self.recombination_min, self.recombination_max = recombination_range(recombination_min, recombination_max)
        self.mutation_probability = real("mutation_probability", mutation_probability, low=0.0, high=1.0)
        self.partner = choice("partner", partner, ("pool", "survivor"))
        self.acceptance = choice("acceptance", acceptance, ("always", "if_better"))
        self.mutation = choice("mutation", mutation, ("reset", "gaussian"))
        self.mutation_scale = real("mutation_scale", mutation_scale, above=0.0)
        self.population: FloatArray | None = None  # (M, dim), the survivor first
        self.fitness: FloatArray

    def _ask(self) -> FloatArray:
        if self.population is None:
            return filled_up(self.start, self.population_size, self.rng)
        pool = self.population[1 : self.population_size - self.eliminated]
        newcomers = self.rng.random((self.eliminated, self.dim))
        return np.vstack([self._mutate(self._recombine(pool)), newcomers])

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        if self.population is not None:
            parents, parent_fitness = self.population[1:], self.fitness[1:]
            if self.acceptance == "if_better":
                worse = fitness < parent_fitness
                worse[len(worse) - self.eliminated :] = False  # eliminated chromosomes are replaced in any case
                genes = np.where(worse[:, None], parents, genes)
                fitness = np.where(worse, parent_fitness, fitness)
            genes = np.vstack([self.population[:1], genes])
            fitness = np.concatenate([self.fitness[:1], fitness])
        order = np.argsort(-fitness, kind="stable")
        self.population, self.fitness = genes[order], fitness[order]

    def _recombine(self, pool: FloatArray) -> FloatArray:
        """Children `(M - 1 - Q, dim)` of the pool, row i descending from parent i."""
        assert self.population is not None
        shortest, longest = self.recombination_min, self.recombination_max
        if self.partner == "pool":
            return exchange(self.rng, pool, shortest, longest)
        children = pool.copy()
        for child in children:
            run = run_of_genes(self.rng, self.dim, shortest, longest)
            child[run] = self.population[0, run]
        return children

    def _mutate(self, genes: FloatArray) -> FloatArray:
        """Mutate each gene with the probability Psi."""
        if self.mutation == "reset":
            return reset(self.rng, genes, self.mutation_probability)
        mutates = self.rng.random(genes.shape) < self.mutation_probability
        return genes + mutates * self.rng.normal(0.0, self.mutation_scale, genes.shape)
