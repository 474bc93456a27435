"""Loss of fitness when each tag or each pair of tags is removed, and when tags are removed one after the other."""

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
    """Fitness of a deployment after landmarks are removed."""

    ids: IntArray
    """Ids of K landmarks, `(K,)`."""
    fitness: float
    """Fitness with all landmarks."""
    without: FloatArray
    """Fitness if landmarks i and j are removed, `(K, K)`; on the diagonal, if only landmark i is removed."""
    order: IntArray
    """Indices of the landmarks in the order of removal, `(K,)`: each removal leaves the greatest fitness, see
    `removal_order`.
    """
    left: FloatArray
    """Fitness that remains after each removal in the order `order`, `(K,)`."""

    @property
    def table(self) -> dict[str, FloatArray | IntArray]:
        """Columns of a table of the landmarks, `(K,)` each; the landmark with the largest loss comes first.

        The columns are `id`, and `fitness_without` and `fitness_loss` if only this landmark is removed. Two columns
        refer to a removal of landmarks one after the other, each time the one with the least loss. `removed` is the
        place of the landmark in this order, from 1, and `fitness_left` the fitness after its removal.
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
        """Gain of fitness when a harmful landmark, which lowers the fitness, is removed. The gains are keyed by the id
        of the landmark, with the largest gain first.
        """
        gained = np.diagonal(self.without) - self.fitness
        worst = np.argsort(-gained, kind="stable")
        return {int(self.ids[i]): float(gained[i]) for i in worst if gained[i] > FITNESS_ROUNDING}

    def metrics(self) -> dict[str, float]:
        """Metrics: the least and the mean fitness after the loss of one landmark, and the least and the mean fitness
        after the loss of two landmarks.
        """
        one, two = np.diagonal(self.without), self.without[np.triu_indices(len(self.ids), 1)]
        return {
            f"fitness_without_{name}_{kind}": float(figure(left))
            for name, left in (("one", one), ("two", two))
            if left.size
            for kind, figure in (("worst", np.min), ("mean", np.mean))
        }

    def to_text(self) -> str:
        """Text for a terminal: the tags whose removal costs most fitness, the first tags in the order of removal,
        harmful tags, and tags without effect.
        """
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
    """Text that lists the first `TAGS_LISTED` of `tags`, such as `7 (12.30), 4 (0.85)`; `none` if there is no tag.

    `tags` are pairs: the id of a tag, and a fraction, such as a loss of fitness. The text gives the fraction in per
    cent.
    """
    return ", ".join(f"{number} ({100.0 * each:.2f})" for number, each in islice(tags, TAGS_LISTED)) or "none"


def losses(problem: Problem, deployment: Deployment) -> Losses:
    """Measure the fitness without each landmark, without each pair of landmarks, and while landmarks are removed one
    after the other.

    Args:
        problem: problem whose objective has a field, the incremental evaluator of `lmd.incremental.field`.
        deployment: K landmarks.

    Raises:
        InputError: the objective has no field.
    """
    field = field_of(problem.objective, problem.fitness_evaluator)
    target = target_of(problem.objective, field, problem.fitness_evaluator, problem.fitness_relevance)
    pairs = without_landmarks(field, target, deployment)
    return Losses(deployment.ids, problem.fitness_of(deployment), pairs, *removal_order(field, target, deployment))
