"""Random search, the baseline of all optimisers."""

from lmd.core.checks import FloatArray, integer
from lmd.optimisers.base import AskTell
from lmd.optimisers.operators import filled_up


class RandomSearch(AskTell):
    """Random search: the start, then uniform genes.

    Args:
        batch: deployments drawn at a time; the result does not depend on the number.
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
        """Do nothing, as random search learns nothing from the fitness."""
