"""Exact fitness of a deployment without one or two landmarks, and while landmarks are removed one by one.

A landmark is removed by a move to a place where no camera sees it and where it hides no other landmark. Only the
affected views are evaluated again, so all pairs of 90 landmarks cost no more than a hundred evaluations. The step
`bound` of `lmd.incremental.field` gives exact values for such a move, so the step `settle` is left out.
"""

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.layers import layers
from lmd.incremental.field import ACCEPT, BOUND, UNDO, Field, Target, perform, runner, total_fitness
from lmd.scene.deployment import Deployment

# Pose of a removed landmark: position out of reach, metres, and a normal that faces no camera.
AWAY = np.array([0.0, 0.0, 1e6, 0.0, 0.0, 1.0])


def without_landmarks(field: Field, target: Target, deployment: Deployment) -> FloatArray:
    """Fitness without each pair of landmarks, `(K, K)`: entry (i, j) is the fitness without landmarks i and j, and
    entry (i, i) the fitness without landmark i.

    Args:
        field: incremental evaluator of the values.
        target: function that computes the fitness from the values.
        deployment: K landmarks.
    """
    state, count = field.state(deployment), len(deployment)
    scratches, fitness = layers(field.scratch(state), 2), np.empty((count, count))
    units, poses = np.empty((count + 3, field.size), dtype=np.int64), np.tile(AWAY, (count + 3, 1))
    for i in range(count):
        others = [(BOUND, j, -1, 1) for j in range(i + 1, count)]
        steps = np.array([(BOUND, i, -1, 0), (ACCEPT, i, -1, 0), *others, (UNDO, i, -1, 0)])
        runner(field, perform)(steps, poses, field, state, scratches, units)
        for j in range(i, count):
            fitness[i, j] = fitness[j, i] = total_fitness(target, units[1 + j - i])
    return fitness


def removal_order(field: Field, target: Target, deployment: Deployment) -> tuple[IntArray, FloatArray]:
    """Greedy order of removal: each step removes the landmark without which the fitness is greatest. Among several such
    landmarks, the step removes the one with the lowest index.

    Args:
        field: incremental evaluator of the values.
        target: function that computes the fitness from the values.
        deployment: K landmarks.

    Returns:
        Indices of the landmarks, `(K,)`, and the fitness after each removal, `(K,)`.
    """
    state, count = field.state(deployment), len(deployment)
    scratches, run = layers(field.scratch(state), 1), runner(field, perform)
    units, poses = np.empty((count, field.size), dtype=np.int64), np.tile(AWAY, (count, 1))
    left, order, fitness = list(range(count)), np.empty(count, dtype=np.int64), np.empty(count)
    for k in range(count):
        run(np.array([(BOUND, i, -1, 0) for i in left]), poses, field, state, scratches, units)
        tried = [total_fitness(target, units[row]) for row in range(len(left))]
        best = int(np.argmax(tried))
        order[k], fitness[k] = left.pop(best), tried[best]
        run(np.array([(which, order[k], -1, 0) for which in (BOUND, ACCEPT)]), poses, field, state, scratches, units)
    return order, fitness
