"""Moving one landmark: what a trial found becomes true, and can be taken back; and the views of a whole deployment."""

from typing import Any

import numpy as np

from lmd.core.bits import ONE, ZERO, lowest
from lmd.core.compiled import borrowing, inner
from lmd.incremental.move import list_touched
from lmd.incremental.state import State
from lmd.objectives.localisation.information import WIDTH
from lmd.objectives.localisation.state import LocalisationState, blank_state, localisation_scratch
from lmd.objectives.localisation.trial import VIEW, add_shares, list_changes, mixed, moments_of, row_meets
from lmd.sight.kernels import sum_weights

VIEW_BYTES = 8 * (WIDTH + 3)  # of a view: its sums, and three lists of views


@inner
def change_sums(k, sign, field, state, scratch):
    """Change the sums by the move tried last, or with a `sign` of -1 back; landmark k is still where it was."""
    if not field.asks:
        return
    sums, caps = state.sums, scratch.caps
    sight, axes = field.coverage.sight, field.coverage.axes
    offsets, moments, goes = scratch.offsets, scratch.moments, scratch.goes
    words = np.uint64(caps.shape[1])
    for p in scratch.coverage.listed[: list_touched(k, state.coverage, scratch.coverage)]:
        for e in range(list_changes(np.uint64(k), p, field, state, scratch)):
            for w in range(words):
                left = caps[e, w]
                while left:
                    bit = lowest(left)
                    left &= left - ONE
                    view, a = (p * words + w) * VIEW + bit, w * VIEW + bit
                    add_shares(field.precision, sums, view, e, a, sign, sight, axes, offsets, moments, goes)


@inner
def exchange(first, last, state, scratch):
    """Exchange what state and scratch know of the values at the positions from the first up to the last."""
    for p in range(first, last):
        state.units[p], scratch.units[p] = scratch.units[p], state.units[p]
        state.located[p], scratch.located[p] = scratch.located[p], state.located[p]
        for w in range(state.localised.shape[1]):
            state.localised[p, w], scratch.localised[p, w] = scratch.localised[p, w], state.localised[p, w]


@borrowing
def _fill(field, state, scratch):
    """Sum up what all landmarks tell, and find the values."""
    known, weights, row, sums = state.coverage, field.coverage.weights, scratch.row, state.sums
    sight, axes = field.coverage.sight, field.coverage.axes
    offsets, moments, goes = scratch.offsets, scratch.moments, scratch.goes
    landmarks, normals, positions = state.landmarks, state.normals, field.coverage.positions
    words = np.uint64(state.localised.shape[1])
    for p in range(np.uint64(len(state.units))):
        for i in range(np.uint64(known.caps.shape[0]) if field.asks else ZERO):
            if known.reachable[i, p] & (known.hidden[i, p] == 0):
                x, y, z = (
                    landmarks[0, i] - positions[0, p],
                    landmarks[1, i] - positions[1, p],
                    landmarks[2, i] - positions[2, p],
                )
                offsets[0, 0], offsets[0, 1], offsets[0, 2], goes[0] = x, y, z, ZERO
                moments_of(x, y, z, normals[0, i], normals[1, i], normals[2, i], field.precision, i, moments[0])
                for w in range(words):
                    left = known.caps[i, p, w]
                    while left:
                        bit = lowest(left)
                        left &= left - ONE
                        view, a = (p * words + w) * VIEW + bit, w * VIEW + bit
                        add_shares(field.precision, sums, view, ZERO, a, 1.0, sight, axes, offsets, moments, goes)
        for w in range(words):
            has = known.counts.enough[p, w]
            left, good = has if field.asks else ZERO, ZERO if field.asks else has
            while left:
                bit = lowest(left)
                left &= left - ONE
                v = (p * words + w) * VIEW + bit
                for j in range(np.uint64(WIDTH)):
                    row[ZERO, j] = state.sums[v, j]
                good |= np.uint64(row_meets(field.precision, row)) << bit
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
