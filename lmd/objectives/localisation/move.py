"""Moving one landmark: what a trial found becomes true, and can be taken back; and the views of a whole deployment."""

from typing import Any

import numpy as np

from lmd.core.bits import ONE, ZERO, lowest
from lmd.core.compiled import borrowing, inner
from lmd.incremental.counts import ENOUGH
from lmd.incremental.state import FIRST, HIDDEN, LAST, LISTED, SPAN_COUNT, State
from lmd.incremental.trial import list_changing
from lmd.objectives.localisation.changes import VIEW, add_change, list_changes, mixed, note_landmark, row_meets
from lmd.objectives.localisation.information import WIDTH
from lmd.objectives.localisation.state import LOCALISED, LocalisationState, blank_state, localisation_scratch
from lmd.sight.kernels import sum_weights

VIEW_BYTES = 8 * (WIDTH + 3)  # of a view: its sums, and three lists of views


@inner
def change_sums(k, sign, field, state, scratch):
    """Change the sums by the move tried last, or with a `sign` of -1 back; landmark k is still where it was."""
    if not field.asks:
        return
    for p in scratch.coverage.lists[LISTED][: list_changing(state.coverage, np.uint64(k), scratch.coverage)]:
        for e in range(list_changes(np.uint64(k), p, field, state, scratch)):
            add_change(e, p, sign, field, state, scratch)


@inner
def exchange(state, scratch):
    """Exchange what state and scratch know of the values near the move, for one camera and for rigs."""
    first, last, localised = scratch.coverage.lists[FIRST], scratch.coverage.lists[LAST], scratch.sets[LOCALISED]
    for s in range(scratch.coverage.numbers[SPAN_COUNT]):
        for p in range(first[s], last[s]):
            state.units[p], scratch.units[p] = scratch.units[p], state.units[p]
            state.located[p], scratch.located[p] = scratch.located[p], state.located[p]
            for w in range(state.localised.shape[1]):
                state.localised[p, w], localised[p, w] = localised[p, w], state.localised[p, w]


@borrowing
def _fill(field, state, scratch):
    """Sum up what all landmarks tell, and find the values."""
    known, weights, words = state.coverage, field.coverage.weights, np.uint64(state.localised.shape[1])
    for p in range(np.uint64(len(state.units))):
        for i in range(np.uint64(known.caps.shape[0]) if field.asks else ZERO):
            if known.reachable[i, p] & (known.hides[HIDDEN, i, p] == 0):
                note_landmark(ZERO, ZERO, i, p, field, state, scratch)
                add_change(ZERO, p, 1.0, field, state, scratch)
        for w in range(words):
            has = known.counts.sets[ENOUGH, p, w]
            left, good = has if field.asks else ZERO, ZERO if field.asks else has
            while left:
                bit = lowest(left)
                left &= left - ONE
                v = (p * words + w) * VIEW + bit
                good |= np.uint64(row_meets(field.precision, state.sums, v)) << bit
            state.localised[p, w] = good
            state.located[p] += sum_weights(ZERO, good, weights, p, w)
        state.units[p] = mixed(state.located[p], known.units[p], field.weight)


def localisation_state(field: Any, known: State) -> LocalisationState:
    """The views that a deployment localises, ready for moves.

    Args:
        field: a `LocalisationField`.
        known: the coverage of the deployment, which becomes part of the state.
    """
    state = blank_state(known, WIDTH, VIEW_BYTES if field.asks else 0.0)
    _fill(field, state, localisation_scratch(state))
    return state
