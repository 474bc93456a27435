"""The standard genetic algorithm with which the paper compares (Sec. V-A)."""

import numpy as np

from lmd.core.checks import FloatArray, integer, real
from lmd.optimisers.base import AskTell
from lmd.optimisers.operators import exchange, filled_up, recombination_range, reset


class SGA(AskTell):
    """Standard genetic algorithm.

    In each generation M parents are drawn with a probability proportional to their fitness (by a roulette wheel, so one
    chromosome can be drawn often). The parents pair up, exchange a run of genes and mutate; the children replace the
    population. So the population can get worse; the result is the best chromosome of all generations.

    Args:
        population: M.
        recombination_min, recombination_max: the shortest and longest run of genes exchanged, as fractions of the
            chromosome.
        mutation_probability: probability of a new gene.
        survivors: number of best chromosomes that take the place of the worst children; 0 as in the paper.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(
        self,
        population: int = 30,
        recombination_min: float = 100 / 450,
        recombination_max: float = 300 / 450,
        mutation_probability: float = 0.1,
        survivors: int = 0,
        encoding: str | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(seed, encoding)
        self.population_size = self.start_size = integer("population", population, low=2)
        self.recombination_min, self.recombination_max = recombination_range(recombination_min, recombination_max)
        self.mutation_probability = real("mutation_probability", mutation_probability, low=0.0, high=1.0)
        self.survivors = integer("survivors", survivors, low=0, high=self.population_size - 1)
        self.population: FloatArray | None = None  # (M, dim)
        self.fitness: FloatArray

    def _ask(self) -> FloatArray:
        if self.population is None:
            return filled_up(self.start, self.population_size, self.rng)
        parents = self.population[self._roulette()]
        children = exchange(self.rng, parents, self.recombination_min, self.recombination_max)
        return reset(self.rng, children, self.mutation_probability)

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        if self.population is not None and self.survivors:
            best = np.argsort(-self.fitness, kind="stable")[: self.survivors]
            worst = np.argsort(fitness, kind="stable")[: self.survivors]
            genes, fitness = genes.copy(), fitness.copy()
            genes[worst], fitness[worst] = self.population[best], self.fitness[best]
        self.population, self.fitness = genes, fitness

    def _roulette(self) -> np.ndarray:
        """Indices of M parents. A failed evaluation has no share of the wheel; if all evaluations failed, the shares
        are equal.
        """
        share = np.maximum(self.fitness, 0.0)
        if not share.any():
            share = np.ones(len(share))
        return self.rng.choice(len(share), size=len(share), p=share / share.sum())
