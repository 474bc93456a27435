"""Losses of fitness on removal of each tag, and of each pair of tags."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.words import few
from lmd.objectives.crowd import target_of
from lmd.objectives.reference_field import field_of
from lmd.objectives.without import without_landmarks
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

TAGS_LISTED = 8  # largest number of tags listed in a terminal
FITNESS_ROUNDING = 1e-12  # largest difference in fitness that counts as a rounding error


@dataclass(frozen=True)
class Losses:
    """Fitness after removal of landmarks."""

    ids: IntArray
    """Ids of K landmarks, `(K,)`."""
    fitness: float
    """Fitness with all landmarks."""
    without: FloatArray
    """`(K, K)` fitness without landmarks i and j; on the diagonal, without landmark i."""

    @property
    def table(self) -> dict[str, FloatArray | IntArray]:
        """Columns `id`, `fitness_without` and `fitness_loss`, `(K,)` each, the largest loss first."""
        alone = np.diagonal(self.without)
        lost = self.fitness - alone
        order = np.argsort(-lost, kind="stable")
        return {"id": self.ids[order], "fitness_without": alone[order], "fitness_loss": lost[order]}

    @property
    def tables(self) -> dict[str, dict[str, FloatArray | IntArray]]:
        """See `lmd.evaluation.Study.tables`."""
        return {"losses": self.table}

    @property
    def idle(self) -> IntArray:
        """Ids of the landmarks whose removal does not change the fitness."""
        return np.sort(self.ids[np.diagonal(self.without) >= self.fitness - FITNESS_ROUNDING])

    def metrics(self) -> dict[str, float]:
        """Least and mean fitness after the loss of one landmark, and after the loss of two."""
        one, two = np.diagonal(self.without), self.without[np.triu_indices(len(self.ids), 1)]
        return {
            f"fitness_without_{name}_{kind}": float(figure(left))
            for name, left in (("one", one), ("two", two))
            if left.size
            for kind, figure in (("worst", np.min), ("mean", np.mean))
        }

    def to_text(self) -> str:
        """Text for a terminal: the tags with the largest losses, and the idle tags."""
        rows = zip(*self.table.values(), strict=True)
        dearest = [(number, lost) for number, _, lost in rows if lost > FITNESS_ROUNDING]
        most = ", ".join(f"{number} ({100.0 * lost:.2f})" for number, lost in dearest[:TAGS_LISTED])
        idle = few(self.idle, TAGS_LISTED)
        return (
            f"tags that matter most, and the points of fitness lost without each: {most or 'none'}\n"
            f"idle tags, without any one of which nothing is lost: {idle or 'none'}"
        )


def losses(problem: Problem, deployment: Deployment) -> Losses:
    """Measure the fitness without each landmark, and without each pair of landmarks.

    Args:
        problem: problem whose objective has a field.
        deployment: K landmarks.

    Raises:
        InputError: the objective has no field.
    """
    field = field_of(problem.objective, problem.fitness_evaluator)
    target = target_of(problem.objective, field, problem.fitness_evaluator, problem.fitness_relevance)
    return Losses(deployment.ids, problem.fitness_of(deployment), without_landmarks(field, target, deployment))
