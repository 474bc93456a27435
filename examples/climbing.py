"""Steps from the best genes so far."""

from lmd.core.checks import FloatArray
from lmd.optimisers.base import AskTell


class HillClimber(AskTell):
    """Four random steps at a time.

    Args:
        step: standard deviation of each gene.
        seed: of the run.
    """

    def __init__(self, step: float = 0.1, seed: int = 0) -> None:
        super().__init__(seed)
        self.step = step

    def _ask(self) -> FloatArray:
        """Genes in [0, 1], shape `(batch, self.dim)`."""
        if self.best_genes is None:
            return self.start
        return self.best_genes + self.rng.normal(0.0, self.step, (4, self.dim))

    def _tell(self, genes: FloatArray, fitness: FloatArray) -> None:
        """Take the fitness to maximise, shape `(batch,)`; the best genes are kept for you."""
