"""Operators of the paper's genetic algorithms (Sec. IV-B)."""

import numpy as np

from lmd.core.checks import FloatArray, real


def filled_up(start: FloatArray, size: int, rng: np.random.Generator) -> FloatArray:
    """Cut the start to `size`, or fill it up with uniform genes, `(size, dim)`."""
    missing = max(size - len(start), 0)
    return np.vstack([start[:size], rng.random((missing, start.shape[1]))])


def recombination_range(shortest: float, longest: float) -> tuple[float, float]:
    """Check Y_min and Y_max, fractions of the chromosome.

    Raises:
        InputError: not 0 <= shortest <= longest <= 1.
    """
    longest = real("recombination_max", longest, low=0.0, high=1.0)
    return real("recombination_min", shortest, low=0.0, high=longest), longest


def run_of_genes(rng: np.random.Generator, dim: int, shortest: float, longest: float) -> slice:
    """Draw a run of genes in a chromosome of `dim` genes; the run is between `shortest` and `longest` times `dim`
    long.
    """
    length = int(rng.integers(round(shortest * dim), round(longest * dim), endpoint=True))
    first = int(rng.integers(0, dim - length, endpoint=True))
    return slice(first, first + length)


def exchange(rng: np.random.Generator, parents: FloatArray, shortest: float, longest: float) -> FloatArray:
    """Pair up parents at random and exchange a run of genes in each pair, `(B, dim)`; an unpaired parent is copied."""
    children = parents.copy()
    order = rng.permutation(len(parents))
    for i, j in zip(order[0::2], order[1::2], strict=False):
        run = run_of_genes(rng, parents.shape[1], shortest, longest)
        children[i, run], children[j, run] = parents[j, run], parents[i, run]
    return children


def reset(rng: np.random.Generator, genes: FloatArray, probability: float) -> FloatArray:
    """Draw a new value of each gene with `probability`."""
    mutates = rng.random(genes.shape) < probability
    return np.where(mutates, rng.random(genes.shape), genes)
