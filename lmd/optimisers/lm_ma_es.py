"""LM-MA-ES, the limited-memory matrix adaptation evolution strategy of Loshchilov, Glasmachers and Beyer (2017).

The covariance is learnt as m directions in place of a matrix, in time and memory O(m dim), with m about log(dim).
pycma, cmaes, pymoo and nevergrad do not have this method.
"""

import math

import numpy as np

from lmd.core.checks import FloatArray, integer, real
from lmd.optimisers.base import AskTell

SMALLEST_STEP, LARGEST_STEP = 1e-6, 1e3  # sigma beyond which the strategy starts anew from the best genes


class LMMAES(AskTell):
    """LM-MA-ES on the unit box; candidates outside are reflected at its sides.

    The mean begins at the start; when the step has vanished, the strategy begins anew at the best genes.

    Args:
        step: initial standard deviation sigma_0 (genes span 1).
        population: lambda; None for 4 + 3 ln(dim).
        directions: m; None for 4 + 3 ln(dim).
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(
        self,
        step: float = 0.1,
        population: int | None = None,
        directions: int | None = None,
        encoding: str | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(seed, encoding)
        self.step = real("step", step, above=0.0)
        self.population = None if population is None else integer("population", population, low=4)
        self.directions = None if directions is None else integer("directions", directions, low=1)
        self.strategy: _Strategy | None = None
        self.best: tuple[float, FloatArray] = (-math.inf, np.empty(0))

    def _ask(self) -> FloatArray:
        if self.strategy is None:
            self.strategy = _Strategy(self, self.start[0])
        elif not SMALLEST_STEP <= self.strategy.sigma <= LARGEST_STEP:
            self.strategy = _Strategy(self, self.best[1])
        genes = self.strategy.ask(self.rng)
        return 1.0 - np.abs(1.0 - genes % 2.0)  # reflected at 0 and 1

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        assert self.strategy is not None, "it was asked"
        first = int(np.argmax(fitness))
        if fitness[first] >= self.best[0]:
            self.best = (float(fitness[first]), genes[first].copy())
        self.strategy.tell(fitness)


class _Strategy:
    """State of the strategy from one mean on; the names of the paper are y, sigma, p_sigma, m_i, z and d."""

    def __init__(self, settings: LMMAES, mean: FloatArray) -> None:
        dim = len(mean)
        usual = 4 + int(3.0 * math.log(dim))
        self.size, kept = settings.population or usual, settings.directions or usual
        weights = math.log(self.size / 2 + 0.5) - np.log(np.arange(1, self.size // 2 + 1))
        self.weights = weights / weights.sum()
        self.mass = 1.0 / float((self.weights**2).sum())  # mu_w
        powers = np.arange(kept)
        # c_sigma and c_c,i exceed 1 if there are few genes.
        self.path_rate = min(2.0 * self.size / dim, 1.0)
        self.rates = np.minimum(self.size / 4.0**powers / dim, 1.0)
        self.shares = 1.0 / (1.5**powers * dim)  # c_d,i
        self.mean, self.sigma = mean.copy(), settings.step
        self.path, self.kept = np.zeros(dim), np.zeros((kept, dim))
        self.generation = 0

    def ask(self, rng: np.random.Generator) -> FloatArray:
        self.z = rng.standard_normal((self.size, len(self.mean)))
        self.d = self.z.copy()
        # d <- (1 - c_d,j) d + c_d,j m_j (m_j^T d)
        for share, kept in zip(self.shares[: self.generation], self.kept[: self.generation], strict=True):
            self.d = (1.0 - share) * self.d + share * np.outer(self.d @ kept, kept)
        return np.asarray(self.mean + self.sigma * self.d)

    def tell(self, fitness: FloatArray) -> None:
        best = np.argsort(-fitness, kind="stable")[: len(self.weights)]
        self.mean = self.mean + self.sigma * (self.weights @ self.d[best])
        z, rate = self.weights @ self.z[best], self.path_rate
        # p_sigma <- (1 - c_sigma) p_sigma + sqrt(mu_w c_sigma (2 - c_sigma)) sum_i w_i z_i
        self.path = (1.0 - rate) * self.path + math.sqrt(self.mass * rate * (2.0 - rate)) * z
        rates = self.rates[:, None]
        self.kept = (1.0 - rates) * self.kept + np.sqrt(self.mass * rates * (2.0 - rates)) * z
        # sigma <- sigma exp(c_sigma / 2 (|p_sigma|^2 / dim - 1))
        self.sigma *= math.exp(rate / 2.0 * (float(self.path @ self.path) / len(z) - 1.0))
        self.generation += 1
