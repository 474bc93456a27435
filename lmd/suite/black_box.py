"""Problems as functions on the unit box, for optimisers of other libraries."""

from collections.abc import Mapping, Sequence

import numpy as np

from lmd.core.checks import FloatArray, seed_number
from lmd.evaluation.validation import validation_metrics
from lmd.optimisers.encoding import LandmarkGenome
from lmd.problem import Genome, Problem, checked_genes
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig

IMPOSSIBLE = -1.0
"""Value of a candidate whose tags do not all find room, or whose cameras are not admissible; below every fitness."""


class BlackBox:
    """Problem as a function of genes, to be maximised.

    Genes are numbers in [0, 1] that encode a deployment or cameras. Values of the function are in [0, 1], or
    `IMPOSSIBLE` for tags that do not find room or cameras that are not admissible.

    Args:
        problem: the problem.
        name: name of the problem in messages and records.
        encoding: encoding of landmarks, see `lmd.optimisers.encoding.make_encoding`; ignored if the problem places
            cameras.

    Raises:
        InputError: the encoding is unknown.
    """

    objectives: Sequence[str]
    """Names of the objectives; most problems have a single objective."""

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
        """Draw a random candidate from which a search may start; return its genes `(d,)`."""
        return self.genome.draw_genes(np.random.default_rng(seed_number(seed)))

    def __call__(self, genes: FloatArray) -> FloatArray:
        """Values of candidates.

        Args:
            genes: genes in [0, 1] of B candidates, `(B, d)`, or of a single candidate, `(d,)`.

        Returns:
            fitness to be maximised, `(B,)`, or a number for a single candidate. With M > 1 objectives the shape is `(B,
            M)`, or `(M,)` for a single candidate.

        Raises:
            InputError: the genes have another shape, are not numbers, or lie outside [0, 1].
        """
        try:
            is_one = np.ndim(genes) == 1
        except ValueError:  # rows of different lengths, which are refused below
            is_one = False
        if is_one:
            value: FloatArray = self._values(checked_genes(genes, self.dim)[None])[0]
            return value
        return self._values(checked_genes(genes, "B", self.dim))

    def deployment(self, genes: FloatArray) -> Deployment:
        """Landmarks that the genes `(d,)` of a candidate encode."""
        return self.problem.labelled(self.genome.deployment(genes))

    def rig(self, genes: FloatArray) -> Rig | None:
        """Cameras that the genes `(d,)` of a candidate encode; None if the problem places landmarks."""
        return self.genome.rig(genes)

    def score(self, genes: FloatArray, seed: int = 0) -> Mapping[str, float]:
        """Metrics of a candidate, keyed by name: on the problem's grid, and off the grid (`lmd.evaluation.validation`).

        Args:
            genes: genes of the candidate, `(d,)`.
            seed: seed of the random poses off the grid.
        """
        rig, deployment = self.rig(genes), self.deployment(genes)
        scored = self.problem if rig is None else self.problem.with_rig(rig)
        return scored.metrics(deployment) | validation_metrics(scored, deployment, seed)

    def _values(self, genes: FloatArray) -> FloatArray:
        """Fitness `(B,)` of candidates whose genes `(B, d)` have been checked; `(B, M)` for M > 1 objectives."""
        fitness = self.genome.fitness_of_genes(genes)
        return np.where(np.isfinite(fitness), fitness, IMPOSSIBLE)
