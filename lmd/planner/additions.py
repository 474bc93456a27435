"""What one tag more would add, wherever it may hang: the colours of the surfaces.

A landmark that nobody sees is moved from place to place (`lmd.incremental.field`). A move is settled, so that shadows
count, but never accepted.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import kernel
from lmd.core.layers import layers
from lmd.incremental.field import BOUND, SETTLE, in_order, perform, runner, total_worth
from lmd.objectives.base import incremental
from lmd.objectives.reference_field import field_of
from lmd.objectives.without import AWAY
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.poses import Cells, wall_cells
from lmd.space.surface import SurfaceArrays

CANDIDATES = 3000  # candidate places in a room, about
CANDIDATE_BATCH = 64  # places between two looks at whether anybody still wants to know


class Additions(NamedTuple):
    """What a tag at each of N places would add, `(N,)` each; NaN where its paper would overlap another.

    fitness: to the fitness. value: to the mean of the objective's value over the positions, weighted by their
    relevance; it tells places apart also where none lifts a position over a threshold.
    """

    fitness: FloatArray
    value: FloatArray


@kernel
def _add_up(units, target, fitness, value):  # type: ignore[no-untyped-def]
    """Write the fitness and the mean value of each row of `units` `(N, Q)`."""
    for i in range(len(units)):
        fitness[i] = total_worth(target, units[i])
        total = 0.0
        for p in range(units.shape[1]):
            total += target.relevance[p] * (units[i, p] / PROBABILITY_ONE)
        value[i] = total


def candidate_cells(problem: Problem) -> Cells:
    """A coarse grid of places where a tag may hang, about `CANDIDATES` of them."""
    room = problem.scene.plates.hanging
    surfaces = SurfaceArrays.of(room.surfaces())
    cells = wall_cells(room, math.sqrt(float(surfaces.area.sum()) / CANDIDATES))
    poses = cells.poses
    return cells.picked(surfaces.allow(poses.surfaces, surfaces.coordinates(poses.surfaces, poses.positions)))


def additions(
    problem: Problem, deployment: Deployment, poses: Deployment, wanted: Callable[[], bool] = lambda: True
) -> Additions | None:
    """What a tag at each of N poses would add to a deployment.

    Args:
        problem: what the tags are for; they are judged on its grid.
        deployment: K landmarks.
        poses: N places, with their surfaces.
        wanted: asked now and then whether to go on.

    Returns:
        None if it was not to go on.

    Raises:
        InputError: the objective has no field.
    """
    objective = incremental(problem.objective)
    # Out of reach, it changes nothing of what the others are worth.
    more = deployment + Deployment(AWAY[None, :3], AWAY[None, 3:])
    field = field_of(problem.objective, problem.evaluator.sized(more.edges))
    target = objective.target(in_order(field, problem.relevance))
    state = field.state(more)
    scratches, places = layers(field.scratch(state), 1), np.hstack([poses.positions, poses.normals])
    steps = np.zeros((len(poses), 2, 4), dtype=np.int64)
    steps[:, :, 0], steps[:, :, 1], steps[:, :, 2] = (BOUND, SETTLE), len(deployment), poses.surfaces[:, None]
    units = np.empty((2 * CANDIDATE_BATCH, field.size), dtype=np.int64)
    fitness, value = np.empty(len(poses)), np.empty(len(poses))
    for first in range(0, len(poses), CANDIDATE_BATCH):
        if not wanted():
            return None
        part = slice(first, first + CANDIDATE_BATCH)
        tried = steps[part].reshape(-1, 4)
        runner(field, perform)(tried, np.repeat(places[part], 2, axis=0), field, state, scratches, units)
        _add_up(units[1 : len(tried) : 2], target, fitness[part], value[part])
    before = float((target.relevance * (state.units / PROBABILITY_ONE)).sum())
    taken = np.zeros(len(poses), dtype=np.bool_)
    for k in range(len(deployment)):
        taken |= problem.scene.plates.touched(poses, deployment[k : k + 1])
    gained = (fitness - total_worth(target, state.units), value - before)
    return Additions(*(np.where(taken, np.nan, gain) for gain in gained))
