"""Loss of fitness without each tag, without each pair of tags, and as tags are removed one by one."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.words import few
from lmd.objectives.crowd import target_of
from lmd.objectives.reference_field import field_of
from lmd.objectives.without import removal_order, without_landmarks
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
    order: IntArray
    """`(K,)` indices of the landmarks in the order of `removal_order`."""
    left: FloatArray
    """`(K,)` fitness after each removal in that order."""

    @property
    def table(self) -> dict[str, FloatArray | IntArray]:
        """Columns, `(K,)` each, the largest loss first.

        `id`; `fitness_without` and `fitness_loss` without this landmark alone; `removed`, its place from 1 in the order
        of removal, and `fitness_left` after it and those before it are removed.
        """
        alone = np.diagonal(self.without)
        lost = self.fitness - alone
        order, place = np.argsort(-lost, kind="stable"), np.argsort(self.order)
        return {
            "id": self.ids[order],
            "fitness_without": alone[order],
            "fitness_loss": lost[order],
            "removed": place[order] + 1,
            "fitness_left": self.left[place][order],
        }

    @property
    def tables(self) -> dict[str, dict[str, FloatArray | IntArray]]:
        """See `lmd.evaluation.Study.tables`."""
        return {"losses": self.table}

    @property
    def idle(self) -> IntArray:
        """Ids of the landmarks whose removal does not change the fitness."""
        return np.sort(self.ids[np.abs(np.diagonal(self.without) - self.fitness) <= FITNESS_ROUNDING])

    @property
    def harmful(self) -> dict[int, float]:
        """Gain of fitness by removing each landmark that lowers it, keyed by id, the largest gain first."""
        gained = np.diagonal(self.without) - self.fitness
        worst = np.argsort(-gained, kind="stable")
        return {int(self.ids[i]): float(gained[i]) for i in worst if gained[i] > FITNESS_ROUNDING}

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
        """Text for a terminal: tags with the largest losses, tags that can be spared, idle tags, and harmful tags."""
        table = self.table
        dearest = [row for row in zip(table["id"], table["fitness_loss"], strict=True) if row[1] > FITNESS_ROUNDING]
        going = zip(self.ids[self.order], self.left, strict=True)
        idle = few(self.idle, TAGS_LISTED)
        return (
            f"tags that matter most, and the points of fitness lost without each: {_listed(dearest)}\n"
            f"tags that may go first, one after the other, and the fitness left in %: {_listed(going)}\n"
            f"tags that hurt, and the points of fitness gained without each: {_listed(self.harmful.items())}\n"
            f"idle tags, without any one of which nothing is lost: {idle or 'none'}"
        )


def _listed(tags: Iterable[tuple[int, float]]) -> str:
    """Ids of the first tags, each with a fraction in per cent; `none` for no tag."""
    return ", ".join(f"{number} ({100.0 * each:.2f})" for number, each in islice(tags, TAGS_LISTED)) or "none"


def losses(problem: Problem, deployment: Deployment) -> Losses:
    """Measure the fitness without each landmark, without each pair, and as landmarks are removed one by one.

    Args:
        problem: problem whose objective has a field.
        deployment: K landmarks.

    Raises:
        InputError: the objective has no field.
    """
    field = field_of(problem.objective, problem.fitness_evaluator)
    target = target_of(problem.objective, field, problem.fitness_evaluator, problem.fitness_relevance)
    pairs = without_landmarks(field, target, deployment)
    return Losses(deployment.ids, problem.fitness_of(deployment), pairs, *removal_order(field, target, deployment))
