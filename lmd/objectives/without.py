"""What is left of a deployment without one landmark, or without two: all of them, exactly.

A landmark is taken away by a move (`field`) to a place from where nobody sees it. Only the views that it or its shadow
changes are looked at again, so all pairs of 90 landmarks cost no more than a hundred evaluations. What is lost hides
nothing any more.
"""

import numpy as np

from lmd.checks import FloatArray
from lmd.compiled import kernel
from lmd.deployment import Deployment
from lmd.objectives.field import Field, Target, accept, bound, total_worth, undo

# Out of reach, and with its back to every camera: position, metres, and normal.
AWAY = np.array([0.0, 0.0, 1e6, 0.0, 0.0, 1.0])


@kernel
def _without(field, target, away, state, first, second, fitness):  # type: ignore[no-untyped-def]
    """Write the fitness without landmarks i and j to `fitness` `(K, K)`.

    A move is not settled: what is left out until then is what the landmark hides, and is hidden by, at its new place.
    """
    for i in range(len(fitness)):
        bound(field, i, away, -1, state, first)
        accept(field, i, state, first)
        fitness[i, i] = total_worth(target, state.units)
        for j in range(i + 1, len(fitness)):
            bound(field, j, away, -1, state, second)
            fitness[i, j] = fitness[j, i] = total_worth(target, second.units)
        undo(field, i, state, first)


def without_landmarks(field: Field, target: Target, deployment: Deployment) -> FloatArray:
    """The fitness without landmarks i and j, `(K, K)`; without i alone for i = j.

    Args:
        field: values of positions.
        target: what they are worth.
        deployment: K landmarks.
    """
    state, fitness = field.state(deployment), np.empty((len(deployment), len(deployment)))
    _without(field, target, AWAY, state, field.scratch(state), field.scratch(state), fitness)
    return fitness
