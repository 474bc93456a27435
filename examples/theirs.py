"""CMA-ES of the package cma."""

from typing import Any

import cma
import numpy as np

from lmd.core.checks import FloatArray
from lmd.optimisers.wrapped import Wrapped


class Theirs(Wrapped):
    """CMA-ES from the start of the problem."""

    def _open(self, start: FloatArray, rng: np.random.Generator) -> "Session":
        """Begin from genes `(S, dim)`; the library's seed comes from `rng`."""
        options = {"bounds": [0, 1], "seed": int(rng.integers(1, 2**31))}
        return Session(cma.CMAEvolutionStrategy(start[0], 0.1, options))


class Session:
    """A search by the library, which minimises."""

    def __init__(self, strategy: Any) -> None:
        self.strategy = strategy

    def ask(self) -> FloatArray | None:
        """Genes, shape `(B, dim)`; None when the library's optimiser has ended."""
        return None if self.strategy.stop() else np.array(self.strategy.ask())

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        """Take the losses, shape `(B,)`."""
        self.strategy.tell(list(genes), list(losses))
