"""Metrics of a plan, updated while tags are moved, and the gain of the objective by one more tag at each place."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import kernel
from lmd.core.layers import layers
from lmd.incremental.field import BOUND, NO_UNITS, SETTLE, in_order, moved, perform, places_of, runner
from lmd.objectives.base import incremental
from lmd.objectives.reference_field import field_of
from lmd.objectives.without import AWAY
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.poses import Cells, wall_cells
from lmd.space.surface import SurfaceArrays

CANDIDATES = 3000  # approximate number of candidate places in a room
CANDIDATE_BATCH = 64  # number of candidate places between two checks whether the result is still wanted


class Values:
    """The objective's values at the grid's positions, and the metrics, for a deployment that changes.

    When tags move, only the changes of values are computed (`lmd.incremental.field`), which is fast. All values are
    computed again when the number or sizes of tags change. Results equal those of `Problem` bit for bit.

    Args:
        problem: scene and objective; the problem's number of landmarks does not matter.
        deployment: K landmarks.

    Raises:
        InputError: the objective has no field (incremental evaluator), or there is too little memory.
    """

    def __init__(self, problem: Problem, deployment: Deployment) -> None:
        self._problem = problem
        self._grid = _FieldValues(problem, problem.evaluator, deployment)
        sampled = problem.fitness_evaluator is not problem.evaluator
        self._climbed = _FieldValues(problem, problem.fitness_evaluator, deployment) if sampled else self._grid

    def update(self, deployment: Deployment) -> None:
        """Replace the deployment by `deployment`, and update the values.

        Raises:
            InputError: there is too little memory.
        """
        self._grid.update(deployment)
        if self._climbed is not self._grid:
            self._climbed.update(deployment)

    def values(self) -> FloatArray:
        """See `Problem.values`."""
        return self._grid.values()

    def metrics(self) -> dict[str, float]:
        """See `Problem.metrics`."""
        problem = self._problem
        return problem.figures(self.values(), float(problem.fitness_from(self._climbed.values())))


class _FieldValues:
    """Values of the objective at the positions of an `Evaluator`.

    When tags move, the objective's incremental evaluator (`lmd.incremental.field`) updates the values.
    """

    def __init__(self, problem: Problem, evaluator: Evaluator, deployment: Deployment) -> None:
        self._objective, self._evaluator = problem.objective, evaluator
        self._begin(deployment)

    def _begin(self, deployment: Deployment) -> None:
        self._edges = deployment.edges_of(self._evaluator.scene.tag)
        self._field = field_of(self._objective, self._evaluator.sized(self._edges))
        state: Any = self._field.state(deployment)
        self._state, self._scratches = state, layers(self._field.scratch(state), 1)

    def update(self, deployment: Deployment) -> None:
        """Move those landmarks whose poses differ between the present and the given deployment."""
        if np.array_equal(deployment.edges_of(self._evaluator.scene.tag), self._edges):
            steps, poses = moved(places_of(deployment), self._state)
            runner(self._field, perform)(steps, poses, self._field, self._state, self._scratches, NO_UNITS)
        else:
            self._begin(deployment)

    def values(self) -> FloatArray:
        """Value at each position of the evaluator, `(P,)`."""
        return np.asarray(self._state.units[self._field.index_of] / PROBABILITY_ONE)


@kernel
def _add_up(units, relevance, value):  # type: ignore[no-untyped-def]
    """Write the objective's mean value for each of N deployments into `value` `(N,)`; means are in [0, 1].

    Row i of `units` `(N, Q)` has the objective's values for deployment i at Q positions, as integers: multiples of
    1 / `PROBABILITY_ONE`. `relevance` `(Q,)` are the weights of the positions, with the sum 1.
    """
    for i in range(len(units)):
        total = 0.0
        for p in range(units.shape[1]):
            total += relevance[p] * (units[i, p] / PROBABILITY_ONE)
        value[i] = total


def candidate_cells(problem: Problem) -> Cells:
    """About `CANDIDATES` cells of a coarse grid on the surfaces.

    The centres of the cells are the candidate places for one more tag.
    """
    room = problem.scene.footprints.hanging
    surfaces = SurfaceArrays.of(room.surfaces())
    cells = wall_cells(room, math.sqrt(float(surfaces.area.sum()) / CANDIDATES))
    poses = cells.poses
    return cells.picked(surfaces.allow(poses.surfaces, surfaces.coordinates(poses.surfaces, poses.positions)))


def additions(
    problem: Problem, deployment: Deployment, poses: Deployment, wanted: Callable[[], bool] = lambda: True
) -> FloatArray | None:
    """Increase (gain) of the objective's mean value by one more tag, for each of N poses of this tag.

    The mean is over positions, weighted by relevance. Unlike the fitness, the mean also distinguishes places where a
    new tag lifts no position over the threshold. Gains are exact, occlusion by the new tag included.

    Args:
        problem: scene and objective; gains are computed on its grid.
        deployment: K landmarks.
        poses: N candidate poses, with their surfaces.
        wanted: function that is called repeatedly, and returns False to stop.

    Returns:
        gains `(N,)`, NaN where the new tag with its white margin would overlap another tag; None if `wanted` returned
        False.

    Raises:
        InputError: the objective has no field (incremental evaluator).
    """
    objective = incremental(problem.objective)
    more = deployment + Deployment(AWAY[None, :3], AWAY[None, 3:])
    field = field_of(problem.objective, problem.evaluator.sized(more.edges))
    target = objective.target(in_order(field, problem.relevance))
    state = field.state(more)
    scratches, places = layers(field.scratch(state), 1), np.hstack([poses.positions, poses.normals])
    steps = np.zeros((len(poses), 2, 4), dtype=np.int64)
    steps[:, :, 0], steps[:, :, 1], steps[:, :, 2] = (BOUND, SETTLE), len(deployment), poses.surfaces[:, None]
    units = np.empty((2 * CANDIDATE_BATCH, field.size), dtype=np.int64)
    value = np.empty(len(poses))
    for first in range(0, len(poses), CANDIDATE_BATCH):
        if not wanted():
            return None
        part = slice(first, first + CANDIDATE_BATCH)
        tried = steps[part].reshape(-1, 4)
        runner(field, perform)(tried, np.repeat(places[part], 2, axis=0), field, state, scratches, units)
        _add_up(units[1 : len(tried) : 2], target.relevance, value[part])
    before = float((target.relevance * (state.units / PROBABILITY_ONE)).sum())
    taken = np.zeros(len(poses), dtype=np.bool_)
    for k in range(len(deployment)):
        taken |= problem.scene.footprints.touched(poses, deployment[k : k + 1])
    return np.where(taken, np.nan, value - before)
