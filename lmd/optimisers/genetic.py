"""The genetic algorithms of the paper (Sec. IV-B and V-A), their operators, and random search as a baseline."""

import numpy as np

from lmd.core.checks import FloatArray, InputError, choice, integer, real
from lmd.optimisers.base import AskTell


def filled_up(start: FloatArray, size: int, rng: np.random.Generator) -> FloatArray:
    """Bring the genes `start` of several candidates to the shape `(size, dim)`: leave out candidates after the first
    `size`, or append candidates with uniform random genes.
    """
    missing = max(size - len(start), 0)
    return np.vstack([start[:size], rng.random((missing, start.shape[1]))])


def recombination_range(shortest: float, longest: float) -> tuple[float, float]:
    """Check and return Y_min and Y_max, the bounds on the number of successive genes that parents exchange.

    Both are fractions of the number of genes of a chromosome.

    Raises:
        InputError: 0 <= shortest <= longest <= 1 does not hold.
    """
    longest = real("recombination_max", longest, low=0.0, high=1.0)
    return real("recombination_min", shortest, low=0.0, high=longest), longest


def run_of_genes(rng: np.random.Generator, dim: int, shortest: float, longest: float) -> slice:
    """Draw a random run of successive genes among the `dim` genes of a chromosome.

    The length of the run is between `shortest` and `longest` times `dim`.
    """
    length = int(rng.integers(round(shortest * dim), round(longest * dim), endpoint=True))
    first = int(rng.integers(0, dim - length, endpoint=True))
    return slice(first, first + length)


def exchange(rng: np.random.Generator, parents: FloatArray, shortest: float, longest: float) -> FloatArray:
    """Pair up `parents` `(B, dim)` at random, and exchange a run of genes in each pair; return the children `(B, dim)`.

    The length of a run is between `shortest` and `longest` times `dim`. A parent without a partner is copied.
    """
    children = parents.copy()
    order = rng.permutation(len(parents))
    for i, j in zip(order[0::2], order[1::2], strict=False):
        run = run_of_genes(rng, parents.shape[1], shortest, longest)
        children[i, run], children[j, run] = parents[j, run], parents[i, run]
    return children


def reset(rng: np.random.Generator, genes: FloatArray, probability: float) -> FloatArray:
    """Return a copy of `genes` in which each gene is replaced by a new random value with the given `probability`."""
    mutates = rng.random(genes.shape) < probability
    return np.where(mutates, rng.random(genes.shape), genes)


class EGA(AskTell):
    """Elimination genetic algorithm, which the paper defines by the nine-tuple (W, Fit, pop_0, M, Q, Y_min, Y_max, Psi,
    T).

    In each generation the best chromosome survives unchanged, so the best fitness never falls. The Q worst chromosomes
    are replaced by random chromosomes. The others form the recombinant pool, exchange a run of genes and mutate. Fit is
    the problem's fitness, pop_0 the problem's start (filled up with random chromosomes), and T the budget.

    Some parameters fix choices that the paper leaves open. The defaults of these parameters follow the text of the
    paper literally.

    Args:
        population: number M of chromosomes.
        eliminated: number Q of chromosomes that are replaced in each generation, with Q + 1 <= M.
        recombination_min, recombination_max: Y_min and Y_max, the shortest and longest run of genes exchanged, as
            fractions of the chromosome; the paper uses 100 and 300 genes of 450.
        mutation_probability: probability Psi that a gene of a recombined chromosome mutates.
        partner: `pool` pairs the chromosomes of the pool at random, and each pair exchanges a run of genes; `survivor`
            gives each chromosome a run of the survivor's genes.
        acceptance: `always` lets a child replace its parent; `if_better` does so only if the child's fitness is not
            lower.
        encoding: encoding W, see `AskTell`.
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
        self.population: FloatArray | None = None  # (M, dim), the survivor first
        self.fitness: FloatArray

    def _ask(self) -> FloatArray:
        if self.population is None:
            return filled_up(self.start, self.population_size, self.rng)
        pool = self.population[1 : self.population_size - self.eliminated]
        newcomers = self.rng.random((self.eliminated, self.dim))
        return np.vstack([reset(self.rng, self._recombine(pool), self.mutation_probability), newcomers])

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
        """Return the genes of the children, one for each parent in `pool`.

        Row i of the result has the genes of the parent in row i of `pool`, apart from an exchanged run. Both arrays
        have one column for each gene.
        """
        assert self.population is not None
        shortest, longest = self.recombination_min, self.recombination_max
        if self.partner == "pool":
            return exchange(self.rng, pool, shortest, longest)
        children = pool.copy()
        for child in children:
            run = run_of_genes(self.rng, self.dim, shortest, longest)
            child[run] = self.population[0, run]
        return children


class SGA(AskTell):
    """Standard genetic algorithm.

    In each generation M parents are drawn with a probability proportional to their fitness (by a roulette wheel, so one
    chromosome can be drawn several times). The parents pair up, exchange a run of genes and mutate; the children
    replace the population. So the population can get worse; the result is the best chromosome of all generations.

    Args:
        population: number M of chromosomes.
        recombination_min, recombination_max: shortest and longest run of exchanged genes, as fractions of the
            chromosome.
        mutation_probability: probability that a gene is replaced by a random value.
        survivors: number of best chromosomes of the old population that replace the worst children; 0 as in the paper.
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
        """Draw the indices of M parents with probabilities in proportion to their fitness.

        A chromosome whose evaluation failed has probability 0; if all evaluations failed, the probabilities are equal.
        """
        share = np.maximum(self.fitness, 0.0)
        if not share.any():
            share = np.ones(len(share))
        return self.rng.choice(len(share), size=len(share), p=share / share.sum())


class RandomSearch(AskTell):
    """Random search: evaluates the start and then uniform random genes.

    Args:
        batch: number of deployments drawn at a time; the result does not depend on it.
        encoding: see `AskTell`; with `wall`, uniform genes are uniform over the walls.
        seed: see `Optimiser`.

    Raises:
        InputError: `batch` is not positive.
    """

    def __init__(self, batch: int = 30, encoding: str | None = None, seed: int = 0) -> None:
        super().__init__(seed, encoding)
        self.batch = integer("batch", batch, low=1)

    def _ask(self) -> FloatArray:
        if not self.ledger.evaluations:
            return filled_up(self.start, self.batch, self.rng)
        return self.rng.random((self.batch, self.dim))

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Do nothing, because random search learns nothing from the fitness."""
