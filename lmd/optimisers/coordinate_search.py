"""Coordinate search, the simplest direct search: one gene at a time moves up or down by the gene's step."""

from collections.abc import Generator

import numpy as np

from lmd.core.checks import FloatArray, real
from lmd.optimisers.base import AskTell


class CoordinateSearch(AskTell):
    """Coordinate search on the unit box, with a step for each gene (Kolda, Lewis and Torczon, SIAM Review 45, 2003,
    section 1.1).

    Each sweep visits the genes of the best candidate in random order. A move that raises the fitness is kept, and the
    gene's step is doubled. A move that leaves the fitness unchanged is also kept, as many deployments have equal
    fitness. If both directions lower the fitness, the step is halved. When all steps are below `least`, they are reset
    to `step`.

    Args:
        step: first step of each gene; the range of a gene is [0, 1].
        least: step below which a gene is no longer moved.
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: not 0 < `least` <= `step` <= 1.
    """

    def __init__(self, step: float = 0.1, least: float = 1e-3, encoding: str | None = None, seed: int = 0) -> None:
        super().__init__(seed, encoding)
        self.step = real("step", step, above=0.0, high=1.0)
        self.least = real("least", least, above=0.0, high=self.step)
        self.search: Generator[FloatArray, float, None] | None = None
        self.candidate: FloatArray

    def _ask(self) -> FloatArray:
        if self.search is None:
            self.search = self._searched()
            self.candidate = next(self.search)
        return self.candidate[None]

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        assert self.search is not None, "it was asked"
        self.candidate = self.search.send(float(fitness[0]))

    def _searched(self) -> Generator[FloatArray, float, None]:
        """Yield candidates `(dim,)` and receive the fitness of each."""
        best = self.start[0]
        known = yield best
        steps = np.full(self.dim, self.step)
        while True:
            if steps.max() < self.least:
                steps[:] = self.step
            for gene in self.rng.permutation(self.dim):
                for direction in (1.0, -1.0):
                    tried = best.copy()
                    tried[gene] = np.clip(tried[gene] + direction * steps[gene], 0.0, 1.0)
                    fitness = yield tried
                    if fitness >= known:
                        steps[gene] = min(2.0 * steps[gene], 1.0) if fitness > known else steps[gene]
                        best, known = tried, fitness
                        break
                else:
                    steps[gene] /= 2.0
