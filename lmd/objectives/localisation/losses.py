"""What is left of a deployment without one landmark, or without two: all of them, exactly.

A landmark is taken away by the moves of `annealing`, to a place from where nobody sees it. Only the views that it or
its shadow changes are looked at again, so that all pairs of 90 landmarks cost little more than some evaluations.
"""

import numpy as np

from lmd.checks import FloatArray
from lmd.compiled import kernel
from lmd.deployment import Deployment
from lmd.objectives.field import accept, bound, undo
from lmd.objectives.localisation.field import LocalisationField
from lmd.sight.kernels import PROBABILITY_ONE

# Out of reach, and with its back to every camera: position, metres, and normal.
AWAY = np.array([0.0, 0.0, 1e6, 0.0, 0.0, 1.0])


@kernel
def _without(field, index_of, away, state, first, second, located, covered):  # type: ignore[no-untyped-def]
    """Add sums over the positions, in units, to `located` and `covered` `(K, K)` of zeros; see `without_landmarks`.

    A move is not settled: what is left out until then is what the landmark hides, and is hidden by, at its new place.
    """
    count = state.landmarks.shape[1]
    for i in range(count):
        bound(field, i, away, -1, state, first)
        accept(field, i, state, first)
        for p in index_of:
            located[i, i] += state.located[p]
            covered[i, i] += state.coverage.units[p]
        for j in range(i + 1, count):
            bound(field, j, away, -1, state, second)
            for p in index_of:
                located[i, j] += second.located[p]
                covered[i, j] += second.coverage.units[p]
            located[j, i], covered[j, i] = located[i, j], covered[i, j]
        undo(field, i, state, first)


def without_landmarks(field: LocalisationField, deployment: Deployment) -> FloatArray:
    """The mean of L and of P_n over the positions without landmarks i and j, `(2, K, K)`; without i alone for i = j.

    What is lost hides nothing any more.

    Args:
        field: the positions.
        deployment: K landmarks.
    """
    count, state = len(deployment), field.state(deployment)
    located, covered = np.zeros((2, count, count))
    _without(field, field.index_of, AWAY, state, field.scratch(state), field.scratch(state), located, covered)
    return np.stack([located, covered]) / (PROBABILITY_ONE * len(field.index_of))
