"""Problems as functions on the unit box, for optimisers of other libraries."""

from collections.abc import Mapping, Sequence

import numpy as np

from lmd.core.checks import FloatArray, InputError, seed_number
from lmd.evaluation.validation import validation_metrics
from lmd.optimisers.encoding import LandmarkGenome
from lmd.problem import Genome, Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig

IMPOSSIBLE = -1.0
"""Value of a candidate whose papers find no room, or whose cameras are not admissible: below every fitness."""


class BlackBox:
    """A problem as a function of genes in the unit box, to be maximised; every value is in [0, 1], or `IMPOSSIBLE`.

    Args:
        problem: the problem.
        name: name in messages and records.
        encoding: encoding of landmarks, see `lmd.optimisers.encoding.make_encoding`; problems with a genome of their
            own ignore it.

    Raises:
        InputError: there is no such encoding.
    """

    objectives: Sequence[str]
    """Names of the values; a single one for most problems."""

    def __init__(self, problem: Problem, name: str = "problem", encoding: str = "wall") -> None:
        self.problem, self.name = problem, name
        self.genome: Genome = problem.genome or LandmarkGenome(problem, encoding, flush=True)
        self.objectives = (problem.objective.headline.label,)

    @property
    def dim(self) -> int:
        """Number of genes d."""
        return self.genome.dim

    @property
    def lower(self) -> FloatArray:
        """Lower bounds of the genes, zeros `(d,)`."""
        return np.zeros(self.dim)

    @property
    def upper(self) -> FloatArray:
        """Upper bounds of the genes, ones `(d,)`."""
        return np.ones(self.dim)

    def start(self, seed: int = 0) -> FloatArray:
        """Genes `(d,)` of a random candidate to start from."""
        return self.genome.draw_genes(np.random.default_rng(seed_number(seed)))

    def __call__(self, genes: FloatArray) -> FloatArray:
        """Values of candidates.

        Args:
            genes: `(B, d)` genes of B candidates in [0, 1], or `(d,)` of one.

        Returns:
            `(B,)` fitness to be maximised, or a number for one candidate. With M > 1 objectives `(B, M)`, or `(M,)`.

        Raises:
            InputError: the genes have another shape, are no numbers, or lie outside [0, 1].
        """
        given = self._checked(genes)
        values = self._values(np.atleast_2d(given))
        return values if given.ndim > 1 else values[0]

    def deployment(self, genes: FloatArray) -> Deployment:
        """Landmarks of a candidate `(d,)`."""
        return self.problem.labelled(self.genome.deployment(self._one(genes)))

    def rig(self, genes: FloatArray) -> Rig | None:
        """Cameras of a candidate `(d,)`; None where the problem places landmarks."""
        return self.genome.rig(self._one(genes))

    def score(self, genes: FloatArray, seed: int = 0) -> Mapping[str, float]:
        """Figures of a candidate `(d,)` on the problem's grid and off it, see `lmd.evaluation.validation`.

        Args:
            genes: the candidate.
            seed: seed of the sample of poses off the grid.
        """
        rig, deployment = self.rig(genes), self.deployment(genes)
        scored = self.problem if rig is None else self.problem.with_rig(rig)
        return scored.metrics(deployment) | validation_metrics(scored, deployment, seed)

    def _values(self, genes: FloatArray) -> FloatArray:
        """Values of checked candidates `(B, d)`."""
        fitness = self.genome.fitness_of_genes(genes)
        return np.where(np.isfinite(fitness), fitness, IMPOSSIBLE)

    def _one(self, genes: FloatArray) -> FloatArray:
        given = self._checked(genes)
        if given.ndim != 1:
            raise InputError(f"{self.name}: one candidate ({self.dim},) is needed, got shape {given.shape}.", "genes")
        return given

    def _checked(self, genes: FloatArray) -> FloatArray:
        try:
            given = np.asarray(genes, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{self.name}: genes must be numbers, got {genes!r}.", "genes") from None
        if given.ndim not in (1, 2) or given.shape[-1] != self.dim:
            wanted = f"({self.dim},) or (B, {self.dim})"
            raise InputError(f"{self.name}: genes must have the shape {wanted}, got {given.shape}.", "genes")
        if not ((given >= 0.0) & (given <= 1.0)).all():
            wrong = given[~((given >= 0.0) & (given <= 1.0))][0]
            raise InputError(f"{self.name}: genes must be in [0, 1], got {wrong:g}.", "genes")
        return given
