"""The figures of a deployment that changes a little at a time."""

from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.layers import layers
from lmd.incremental.field import NO_UNITS, moved, perform, places_of, runner
from lmd.objectives.reference_field import field_of
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE


class Values:
    """The objective's values for a deployment, and its figures, equal to those of `Problem` to the last bit.

    Where tags have only moved, they are updated (`lmd.incremental.field`); where there are more or fewer, computed
    anew.

    Args:
        problem: what the deployment is for; its count does not matter.
        deployment: K landmarks.

    Raises:
        InputError: the objective has no field, or so many landmarks do not fit into memory.
    """

    def __init__(self, problem: Problem, deployment: Deployment) -> None:
        self._problem = problem
        self._grid = _Followed(problem, problem.evaluator, deployment)
        sampled = problem.fitness_evaluator is not problem.evaluator
        self._climbed = _Followed(problem, problem.fitness_evaluator, deployment) if sampled else self._grid

    def follow(self, deployment: Deployment) -> None:
        """Go over to another deployment.

        Raises:
            InputError: so many landmarks do not fit into memory.
        """
        for followed in {id(part): part for part in (self._grid, self._climbed)}.values():
            followed.follow(deployment)

    def values(self) -> FloatArray:
        """See `Problem.values`."""
        return self._grid.values()

    def metrics(self) -> dict[str, float]:
        """See `Problem.metrics`."""
        problem = self._problem
        figures = problem.objective.figures(self.values(), problem.relevance)
        fitness = problem.objective.fitness(self._climbed.values(), problem.fitness_relevance)
        return {**figures, "fitness": float(fitness)}


class _Followed:
    """The values at the positions of one evaluator."""

    def __init__(self, problem: Problem, evaluator: Evaluator, deployment: Deployment) -> None:
        self._objective, self._evaluator = problem.objective, evaluator
        self._begin(deployment)

    def _begin(self, deployment: Deployment) -> None:
        self._edges = deployment.edges_of(self._evaluator.scene.tag)
        self._field = field_of(self._objective, self._evaluator.sized(self._edges))
        state: Any = self._field.state(deployment)
        self._state, self._scratches = state, layers(self._field.scratch(state), 1)

    def follow(self, deployment: Deployment) -> None:
        """Move what hangs elsewhere."""
        if np.array_equal(deployment.edges_of(self._evaluator.scene.tag), self._edges):
            steps, poses = moved(places_of(deployment), self._state)
            runner(self._field, perform)(steps, poses, self._field, self._state, self._scratches, NO_UNITS)
        else:
            self._begin(deployment)

    def values(self) -> FloatArray:
        """The value at each position of the evaluator, `(P,)`."""
        return np.asarray(self._state.units[self._field.index_of] / PROBABILITY_ONE)
